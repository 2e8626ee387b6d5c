"""Generators of synthetic gain series: Markov chains and transformed Gaussian series."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from meshtrace.checks import Positive, Seed
from meshtrace.errors import Described, Refused, require_array, require_whole
from meshtrace.fading import (
    Reference,
    autocorrelation,
    block_length,
    effective_samples,
    fit_gamma_gamma,
    fit_lognormal,
)
from meshtrace.fading.distribution import block_means, checked_gain, level_of
from meshtrace.fading.series import correlation_replicates, flat_top
from meshtrace.models import Floats
from meshtrace.stored import Stored, Variable

# Replicates of a block bootstrap: their spread has a relative error of 1 / sqrt(2 * 198) = 5 %.
_RESAMPLES = 199
_MOST_STATES = 64  # tuned: m^2 probabilities to estimate; a byte of `_drawn` holds up to 256
_MOST_SAMPLES = 10**8  # 0.8 GB of gains
# Fewest times that a transition must happen, and fail to happen, for a bootstrap of its error.
_FEWEST_TRANSITIONS = 20
# Standard normal scores z of tabulated quantiles, 0.01 apart: beyond lies one sample in a million.
_SCORES = np.linspace(-4.9, 4.9, 981)
# Highest order k of Mehler's sum; tuned: for a lognormal law of sigma, c_k^2 ~ sigma^(2k) / k!
_HERMITE = 60
_NOTED = 0.1  # tuned: smallest difference of autocorrelations that deserves a note [1]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class ChannelModel(Stored):
    """Base of models of a series of gains, with the correlations of the series and the model.

    Parameters
    ----------
    n : int
        Number of gains of the series.
    time_step : float
        Time step of the series and of the samples [s].
    mean, mean_stderr : float
        Mean gain of the series [1].
    scintillation_index, model_scintillation_index : float
        Scintillation index, Var(g) / E(g)^2, of the series and of the model [1].
    lag : ndarray, shape (m,)
        Lags [s] up to the end of the series' memory.
    autocorrelation, autocorrelation_stderr, model_autocorrelation : ndarray, shape (m,)
        Autocorrelation of the series, its standard error by moving blocks, and that of the
        model [1].
    notes : tuple of str
        Limitations of the model.
    provenance : dict
        Origin of the gains.
    """

    n: int
    time_step: Annotated[float, Variable()]
    mean: Annotated[float, Variable(name="gain_mean")]
    mean_stderr: Annotated[float, Variable(name="gain_mean_stderr")]
    scintillation_index: Annotated[float, Variable()]
    model_scintillation_index: Annotated[float, Variable()]
    lag: Annotated[Floats, Variable("lag")]
    autocorrelation: Annotated[Floats, Variable("lag")]
    autocorrelation_stderr: Annotated[Floats, Variable("lag")]
    model_autocorrelation: Annotated[Floats, Variable("lag")]
    notes: tuple[str, ...] = ()
    provenance: dict[str, Any] = field(default_factory=dict)

    def sample(self, n: Annotated[int, Field(ge=1, le=_MOST_SAMPLES)], seed: Seed = 1) -> Floats:
        """Draw a series of gains from the model.

        Parameters
        ----------
        n : int
            Number of gains.
        seed : int, optional
            Seed of the random numbers.

        Returns
        -------
        ndarray, shape (n,)
            Gains [1] at steps of `time_step`.
        """
        return self._drawn(n, np.random.default_rng(seed))

    @abstractmethod
    def _drawn(self, n: int, rng: np.random.Generator) -> Floats:
        """Draw n gains [1], one per time step."""

    def summary(self) -> str:
        """Return the numbers with their standard errors and units as text for a terminal."""
        return "\n".join([super().summary(), *(f"  note: {note}" for note in self.notes)])


def _series(gain: ArrayLike, dt: float, seed: int) -> tuple[Floats, dict[str, Any]]:
    """Check a series of gains; return it and the fields of `ChannelModel` that describe it."""
    g = checked_gain(gain)
    if np.ptp(g) == 0.0:
        raise Refused("gain", Described("all equal"), "gains that vary")
    rho = autocorrelation(g, max_lag=g.size - 1)
    # beyond its memory the correlation of a series is noise, which no model should follow
    lags = flat_top(rho).size
    replicates = correlation_replicates(g, lags, block_length(g), _RESAMPLES, seed)
    return g, {
        "n": g.size,
        "time_step": dt,
        "mean": float(g.mean()),
        "mean_stderr": float(g.std(ddof=1)) / math.sqrt(effective_samples(g)),
        "scintillation_index": float(g.var(ddof=1) / g.mean() ** 2),
        "lag": dt * np.arange(lags),
        "autocorrelation": rho[:lags],
        "autocorrelation_stderr": replicates.std(axis=1, ddof=1),
    }


def _memory_note(statistics: dict[str, Any], model: Floats, cause: str) -> list[str]:
    """Note a deviation between the autocorrelations of model and series."""
    deviation = model - statistics["autocorrelation"]
    worst = int(np.argmax(np.abs(deviation)))
    # a difference within three standard errors may be chance
    if abs(deviation[worst]) < max(_NOTED, 3.0 * statistics["autocorrelation_stderr"][worst]):
        return []
    return [
        f"the autocorrelation is {model[worst]:.2f} at {statistics['lag'][worst]:.3g} s, "
        f"that of the series {statistics['autocorrelation'][worst]:.2f}: {cause}"
    ]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class MarkovChannel(ChannelModel, kind="markov-channel", title="meshtrace Markov channel"):
    r"""Finite-state Markov channel: states between thresholds, one gain in each.

    .. math:: P_{ij} = n_{ij} / n_i, \quad \pi P = \pi, \quad
              N(h_k) = \frac{1}{\Delta t} \sum_{i > k \ge j} \pi_i P_{ij}

    With one threshold it is the Gilbert-Elliott channel, with a bad state 0 and a good state 1.

    Parameters
    ----------
    threshold : ndarray, shape (m - 1,)
        Gains between the states [1], increasing.
    state_gain : ndarray, shape (m,)
        Mean gain in each state [1].
    steady_state, steady_state_stderr : ndarray, shape (m,)
        Probability of each state [1].
    transition, transition_stderr : ndarray, shape (m, m)
        Probability of the next state, one step on [1].
    n, time_step, mean, mean_stderr, scintillation_index, model_scintillation_index, lag
        As in `ChannelModel`.
    autocorrelation, autocorrelation_stderr, model_autocorrelation, notes, provenance
        As in `ChannelModel`.

    Notes
    -----
    The transitions are those of maximum likelihood. Standard errors are those of moving blocks,
    which hold for a series that is no Markov chain, too; below 20 transitions binomial ones. Wang
    and Moayeri approximate the same probabilities by crossing rates, N(h_k) dt / pi_k to
    neighbouring states only; here the crossing rates are those of the series, and jumps over a
    state are kept.

    A chain of first order forgets how long it has been in a state: with one threshold durations
    are geometric. Waves oscillate: the correlation of their gains turns negative, which no chain
    of levels alone has. `notes` states the largest difference of the correlations.

    References
    ----------
    Gilbert, E. N. (1960), doi:10.1002/j.1538-7305.1960.tb03959.x. Elliott, E. O. (1963),
    doi:10.1002/j.1538-7305.1963.tb00955.x. Wang, H. S. and Moayeri, N. (1995), IEEE Trans. Veh.
    Technol. 44, 163, doi:10.1109/25.350282.

    Examples
    --------
    >>> g = [1.0, 1.0, 1.0, 0.2, 0.2, 1.0, 1.0, 0.2, 1.0, 1.0]
    >>> MarkovChannel.fit(g, 0.1).transition.round(3)
    array([[0.333, 0.667],
           [0.333, 0.667]])
    """

    threshold: Annotated[Floats, Variable("threshold")]
    state_gain: Annotated[Floats, Variable("state")]
    steady_state: Annotated[Floats, Variable("state")]
    steady_state_stderr: Annotated[Floats, Variable("state")]
    transition: Annotated[Floats, Variable("state", "next_state")]
    transition_stderr: Annotated[Floats, Variable("state", "next_state")]

    @classmethod
    def fit(
        cls,
        gain: ArrayLike,
        dt: Positive,
        thresholds: Sequence[float] | int = (0.5,),
        *,
        relative_to: Reference = "mean",
        seed: Seed = 1,
    ) -> Self:
        """Fit a chain to a series of gains.

        Parameters
        ----------
        gain : array_like, shape (n,)
            Channel gains [1] at equal time steps.
        dt : float
            Time step [s].
        thresholds : sequence of float, or int, optional
            Thresholds [1], multiples of the reference; or a number of states, equally probable in
            the series.
        relative_to : {"mean", "median", "absolute"}, optional
            Reference of the thresholds.
        seed : int, optional
            Seed of the resampling that gives the standard errors.

        Raises
        ------
        Refused
            If a value is out of range, or a state is never left.
        """
        g, statistics = _series(gain, dt, seed)
        if isinstance(thresholds, int):
            require_whole(thresholds, 2, _MOST_STATES, "thresholds")
            levels = np.quantile(g, np.arange(1, thresholds) / thresholds)
        else:
            ratios = require_array(thresholds, "thresholds", "increasing numbers > 0").ravel()
            levels = np.array([level_of(g, h, relative_to) for h in ratios])
        if not (0 < levels.size < _MOST_STATES and (np.diff(levels) > 0.0).all()):
            allowed = f"1 to {_MOST_STATES - 1} increasing thresholds, or a number of states"
            raise Refused("thresholds", thresholds, allowed)
        # state i has levels[i - 1] <= gain < levels[i]
        states, n_states = np.searchsorted(levels, g, side="right"), levels.size + 1
        # counts[i, j]: transitions from state i to j, numbered i m + j
        pairs = np.bincount(states[:-1] * n_states + states[1:], minlength=n_states * n_states)
        counts = pairs.reshape(n_states, n_states).astype(np.float64)
        if not counts.sum(axis=1).all():
            absorbing = int(np.argmin(counts.sum(axis=1)))
            allowed = "thresholds between which the gain enters each state and leaves it"
            raise Refused("thresholds", Described(f"state {absorbing} is never left"), allowed)
        transition = counts / counts.sum(axis=1, keepdims=True)
        steady = _steady(transition)
        state_gain = np.bincount(states, g, n_states) / np.bincount(states, minlength=n_states)
        mean = float(steady @ state_gain)
        # the model has one gain per state: the spread of gains within a state is lost
        variance = float(steady @ (state_gain - mean) ** 2)
        # E[h(0) h(t)] = sum_i pi_i h_i (P^t h)_i, here of h less its mean; `expected` is P^t h
        rho, expected = np.empty(statistics["lag"].size), state_gain - mean
        for lag in range(rho.size):
            rho[lag] = (steady * (state_gain - mean)) @ expected / variance
            expected = transition @ expected
        errors = _chain_errors(states, counts, block_length(g), seed)
        return cls(
            **statistics,
            threshold=levels,
            state_gain=state_gain,
            steady_state=steady,
            steady_state_stderr=errors[0],
            transition=transition,
            transition_stderr=errors[1],
            model_scintillation_index=variance / mean**2,
            model_autocorrelation=rho,
            notes=tuple(_memory_note(statistics, rho, "a chain has no memory of the waves' phase")),
        )

    @property
    def level_crossing_rate(self) -> Floats:
        """Downward crossings of each threshold per second [s-1], shape (m - 1,)."""
        flux = self.steady_state[:, None] * self.transition / self.time_step
        return np.array([flux[k:, :k].sum() for k in range(1, self.state_gain.size)])

    @property
    def mean_fade_duration(self) -> Floats:
        """Mean time below each threshold [s], shape (m - 1,)."""
        return np.cumsum(self.steady_state)[:-1] / self.level_crossing_rate

    def states(self, gain: ArrayLike) -> NDArray[np.int64]:
        """Return the state of each gain, 0 below the first threshold.

        Mean values by state are `numpy.bincount(states, values) / numpy.bincount(states)`: the
        error rate of a state is that of `values = comms.budget.ber_of_gains(link, gain)`.
        """
        return np.searchsorted(self.threshold, checked_gain(gain), side="right")

    def _drawn(self, n: int, rng: np.random.Generator) -> Floats:
        first = int(rng.choice(self.steady_state.size, p=self.steady_state))
        uniform = rng.random(n)
        cumulative = np.cumsum(self.transition, axis=1)
        # the sum of a row may round to less than 1: a uniform number above it has no state
        cumulative[:, -1] = 1.0
        # following[i][t]: state at t + 1 after state i at t; Python indexes bytes fast
        following = [
            np.searchsorted(row, uniform, side="right").astype(np.uint8).tobytes()
            for row in cumulative
        ]
        visited = bytearray(n)
        state = first
        for t in range(n):
            visited[t] = state
            state = following[state][t]
        return self.state_gain[np.frombuffer(visited, np.uint8)]

    def _check(self) -> None:
        # `Stored` compares sizes within a dimension only: "threshold", "state", "next_state" differ
        if self.transition.shape != 2 * (self.threshold.size + 1,):
            raise ValueError("other numbers of states than thresholds and one")

    def _headline(self) -> str:
        return f"Markov channel of {self.state_gain.size} states from {self.n} gains"

    def summary(self) -> str:
        """Return the numbers with their standard errors and units as text for a terminal."""
        head, *rest = super().summary().split("\n")
        states = zip(
            self.state_gain, self.steady_state, self.steady_state_stderr,
            1.0 - self.transition.diagonal(), self.transition_stderr.diagonal(), strict=True,
        )  # fmt: skip
        lines = [
            f"  state {i}: gain {gain:.4g}, probability {share:.4g} +- {share_error:.1g}, "
            f"left per step {left:.4g} +- {left_error:.1g}"
            for i, (gain, share, share_error, left, left_error) in enumerate(states)
        ]
        crossings = [
            f"  gain < {h:.4g}: {rate:.4g} crossings per s, mean fade {fade:.4g} s"
            for h, rate, fade in zip(
                self.threshold, self.level_crossing_rate, self.mean_fade_duration, strict=True
            )
        ]
        return "\n".join([head, *lines, *crossings, *rest])


def _steady(transition: Floats) -> Floats:
    """Return the stationary distribution p of a chain, p P = p, shape (m,)."""
    m = len(transition)
    # one of the m equations p P = p follows from the others: the sum of 1 makes p unique
    balance = np.vstack([transition.T - np.eye(m), np.ones(m)])
    probability = np.linalg.lstsq(balance, np.append(np.zeros(m), 1.0))[0]
    probability = np.maximum(probability, 0.0)
    return probability / probability.sum()


def _chain_errors(
    states: NDArray[np.int64], counts: Floats, block: int, seed: int
) -> tuple[Floats, Floats]:
    """Return the standard errors of the probabilities of states and of transitions."""
    n_states = len(counts)
    pair = states[:-1] * n_states + states[1:]
    occurring = np.flatnonzero(counts.ravel())
    # a series has one transition fewer than gains, and no block may exceed it
    block = min(block, pair.size)
    columns = ((pair == state_pair).astype(np.float64) for state_pair in occurring)
    pairs = np.zeros((n_states * n_states, _RESAMPLES))
    pairs[occurring] = block_means(columns, block, _RESAMPLES, seed)
    # P(state i, then j) of each replicate, shape (m, m, resamples); P_ij is this over P(state i)
    joint = pairs.reshape(n_states, n_states, -1)
    marginal = joint.sum(axis=1, keepdims=True)
    # a replicate that never visits a state says nothing about leaving it: nan
    conditional = np.divide(joint, marginal, out=np.full_like(joint, np.nan), where=marginal > 0.0)
    # the variance of n blocks about their mean is too small by the factor (n - 1) / n
    blocks = max(pair.size / block, 2.0)
    stretch = math.sqrt(blocks / (blocks - 1.0))
    departures = counts.sum(axis=1, keepdims=True)
    # resampling says little about a transition that happened once or never: errors of rare ones
    # are binomial, with half a count added so that P_ij is neither 0 nor 1
    smoothed = (counts + 0.5) / (departures + 1.0)
    binomial = np.sqrt(smoothed * (1.0 - smoothed) / departures)
    frequent = np.minimum(counts, departures - counts) >= _FEWEST_TRANSITIONS
    errors = np.where(frequent, stretch * np.nanstd(conditional, axis=-1), binomial)
    return stretch * marginal[:, 0].std(axis=-1), errors


GeneratedLaw = Literal["gamma-gamma", "lognormal", "empirical"]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class TransformedGaussian(
    ChannelModel, kind="transformed-gaussian", title="meshtrace transformed Gaussian series"
):
    r"""Generator of gains: a Gaussian series of a certain correlation, transformed to a law.

    .. math:: g_t = F^{-1}(\Phi(z_t)), \quad
              \rho_g(\tau) = \sum_{k \ge 1} c_k^2 \rho_z(\tau)^k / \sum_{k \ge 1} c_k^2, \quad
              c_k = \mathrm{E}[F^{-1}(\Phi(z)) He_k(z)] / \sqrt{k!}

    Parameters
    ----------
    law : {"gamma-gamma", "lognormal", "empirical"}
        Law F of the gains.
    score : ndarray, shape (q,)
        Standard normal scores.
    gain_quantile : ndarray, shape (q,)
        Gains at these scores [1].
    gaussian_autocorrelation : ndarray, shape (m,)
        Autocorrelation rho_z of the Gaussian series at the lags [1].
    n, time_step, mean, mean_stderr, scintillation_index, model_scintillation_index, lag
        As in `ChannelModel`.
    autocorrelation, autocorrelation_stderr, model_autocorrelation, notes, provenance
        As in `ChannelModel`.

    Notes
    -----
    The sum is Mehler's; it grows with rho_z, as g does with z (Price's theorem), so that each lag
    has one solution. The correlation of the series is kept up to the lag where it becomes
    insignificant and tapered to 0 at twice that lag. Negative values of the spectrum of rho_z, of
    sampling errors or of a law that cannot have the correlation, are set to 0;
    `model_autocorrelation` is what remains.

    In a transformed Gaussian series fades and flashes of equal probability last equally long.
    Those of focused light do not: flashes are short and carry the correlation of the gains, and
    fades last longer than in the model. With a `threshold` u = Phi^-1(F(h)) of fades the
    correlation of the Gaussian series is that of the fades themselves (tetrachoric; Pearson 1900),

    .. math:: P(g_t < h, g_{t + \tau} < h) = \Phi(u)^2 + \int_0^{\rho_z(\tau)}
              \frac{e^{-u^2 / (1 + r)}}{2 \pi \sqrt{1 - r^2}} dr ,

    so that crossing rate and mean duration of these fades are those of the series at its time
    step, up to the negative values of the spectrum. The correlation of the gains is then another.

    References
    ----------
    Grigoriu, M. (1998), Simulation of stationary non-Gaussian translation processes,
    doi:10.1061/(ASCE)0733-9399(1998)124:2(121). Pearson, K. (1900), doi:10.1098/rsta.1900.0022.
    Price, R. (1958), doi:10.1109/TIT.1958.1057444.
    Dietrich, C. R. and Newsam, G. N. (1997), doi:10.1137/S1064827592240555.

    Examples
    --------
    >>> g = np.exp(0.3 * np.convolve(np.random.default_rng(1).normal(size=4000), np.ones(9) / 3.0))
    >>> model = TransformedGaussian.fit(g, 0.01, "lognormal")
    >>> round(model.model_scintillation_index, 2), model.sample(3, seed=1).shape
    (0.09, (3,))
    """

    law: GeneratedLaw
    score: Annotated[Floats, Variable("score")]
    gain_quantile: Annotated[Floats, Variable("score")]
    gaussian_autocorrelation: Annotated[Floats, Variable("lag")]

    @classmethod
    def fit(
        cls,
        gain: ArrayLike,
        dt: Positive,
        law: GeneratedLaw = "gamma-gamma",
        *,
        threshold: Positive | None = None,
        seed: Seed = 1,
    ) -> Self:
        """Fit a generator to a series of gains.

        Parameters
        ----------
        gain : array_like, shape (n,)
            Channel gains [1] at equal time steps.
        dt : float
            Time step [s].
        law : {"gamma-gamma", "lognormal", "empirical"}, optional
            Fitted law, or the gains themselves, whose extremes no sample exceeds.
        threshold : float, optional
            Gain over the mean below which fades come as often as in the series, > 0; by default
            the correlation is that of the gains.
        seed : int, optional
            Seed of the resampling that gives the standard errors.

        Raises
        ------
        Refused
            If a value is out of range, or a law cannot be fitted.
        """
        g, statistics = _series(gain, dt, seed)
        quantile = _quantiles(g, law)
        power = _hermite_powers(quantile)
        mean = float(_WEIGHTS @ quantile)
        # the observed correlation grows with rho_z: a table of steps of 0.001 inverts it
        rho_z = np.linspace(-1.0, 1.0, 2001)
        observed, rho_observed = g, _transformed(rho_z, power)
        if threshold is not None:
            # the indicator of fades: the model shall keep when they come, not how deep they are
            observed = (g < threshold * g.mean()).astype(np.float64)
            if np.ptp(observed) == 0.0:
                raise Refused("threshold", threshold, "a gain that the series crosses")
            rho_observed = _fade_correlation(rho_z, float(observed.mean()))
        target = autocorrelation(observed, max_lag=statistics["lag"].size - 1)
        # tapered to 0: a correlation cut off sharply has a spectrum with negative values
        target *= flat_top(autocorrelation(g, max_lag=g.size - 1))
        gaussian = np.interp(target, rho_observed, rho_z)
        # tuned: a period of 8 times the memory, so that the correlation misses its periodic copy
        size = 8 * gaussian.size
        realizable = np.fft.irfft(_spectrum(gaussian, size), size)[: gaussian.size]
        rho = _transformed(realizable, power)
        cause = "no transformed Gaussian series of this law has the correlation"
        if threshold is not None:
            cause = f"the correlation is that of fades below {threshold:g} of the mean"
        return cls(
            **statistics,
            law=law,
            score=_SCORES,
            gain_quantile=quantile,
            gaussian_autocorrelation=gaussian,
            model_scintillation_index=float(_WEIGHTS @ (quantile - mean) ** 2) / mean**2,
            model_autocorrelation=rho,
            notes=tuple(_memory_note(statistics, rho, cause)),
        )

    def _drawn(self, n: int, rng: np.random.Generator) -> Floats:
        from scipy import fft

        # a transform is periodic: m surplus values separate the end of the series from its start
        size = fft.next_fast_len(n + self.gaussian_autocorrelation.size, real=True)
        white = fft.rfft(rng.standard_normal(size))
        white *= np.sqrt(_spectrum(self.gaussian_autocorrelation, size))
        return np.interp(fft.irfft(white, size)[:n], self.score, self.gain_quantile)

    def _headline(self) -> str:
        return f"Gaussian series of {self.n} gains, transformed to a law: {self.law}"


_WEIGHTS = np.exp(-0.5 * _SCORES**2)
_WEIGHTS /= _WEIGHTS.sum()


def _quantiles(g: Floats, law: GeneratedLaw) -> Floats:
    """Return the gains of a law at the scores."""
    from scipy import special

    if law == "lognormal":
        p = fit_lognormal(g).parameters
        return np.exp(p["mu"] + p["sigma"] * _SCORES)
    if law == "empirical":
        cdf = (np.arange(g.size) + 0.5) / g.size
        return np.interp(_SCORES, special.ndtri(cdf), np.sort(g))
    fitted = fit_gamma_gamma(g, n_effective=effective_samples(g))
    # a table over ln(g / mean), tuned: the law has no closed inverse, its lower tail spans decades
    log_ratio = np.linspace(-16.0, 6.0, 8192)
    cdf = fitted.law.cdf(fitted.parameters["mean"] * np.exp(log_ratio))
    # only where the distribution function grows and is clear of its rounding near 0 and 1 (tuned)
    inside = (cdf > 1e-8) & (cdf < 1.0 - 1e-8) & (np.diff(cdf, prepend=-1.0) > 0.0)
    log_quantile = np.interp(_SCORES, special.ndtri(cdf[inside]), log_ratio[inside])
    return fitted.parameters["mean"] * np.exp(log_quantile)


def _hermite_powers(quantile: Floats) -> Floats:
    """Return c_k^2 / sum c_k^2, k = 1..60, of a function of the scores (`TransformedGaussian`)."""
    from scipy import special

    orders = np.arange(1, _HERMITE + 1)
    he = np.polynomial.hermite_e.hermevander(_SCORES, _HERMITE)[:, 1:]
    power = (quantile * _WEIGHTS @ he) ** 2 / special.factorial(orders)
    return power / power.sum()


def _transformed(rho: Floats, power: Floats) -> Floats:
    """Return the correlations of the transformed series for correlations `rho` of the Gaussian one.

    Mehler's sum of power[k - 1] rho^k from k = 1, see `TransformedGaussian`.
    """
    return rho * np.polynomial.polynomial.polyval(rho, power)


def _fade_correlation(rho: Floats, share: float) -> Floats:
    """Map correlations of the Gaussian series to correlations of the fade indicator (1 in a fade).

    Fades fill `share` of the time; `rho` ascend from -1 to 1. With dr = cos(angle) d(angle),
    r = sin(angle), the integrand of `TransformedGaussian` loses its poles at r = -1 and 1.
    """
    from scipy import integrate, special

    angle = np.arcsin(rho)
    u = special.ndtri(share)
    # 1e-12: at rho = -1 the exponential vanishes, but for u = 0
    density = np.exp(-(u**2) / np.maximum(1.0 + rho, 1e-12)) / (2.0 * math.pi)
    joint = integrate.cumulative_trapezoid(density, angle, initial=0.0)
    joint -= np.interp(0.0, rho, joint)
    return joint / (share * (1.0 - share))


def _spectrum(rho: Floats, size: int) -> Floats:
    """Return the spectrum of a periodic series of correlation rho, >= 0 and of mean 1.

    `rho` holds lags 0, 1, ...; negative lags mirror them at the end of the period of `size`.
    """
    period = np.zeros(size)
    period[: rho.size] = rho
    period[-rho.size + 1 :] = rho[:0:-1]
    # no Gaussian series has negative power: a correlation that needs it is followed only so far
    power = np.maximum(np.fft.rfft(period).real, 0.0)
    # sum over all `size` frequencies: rfft leaves out the mirror images of all but the first and,
    # for an even size, the last
    total = 2.0 * power.sum() - power[0] - (power[-1] if size % 2 == 0 else 0.0)
    return power * (size / total)
