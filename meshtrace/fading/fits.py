"""Laws fitted to gains, and how well they fit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.fading.gains import FloatArray, remove_noise
from meshtrace.fading.gamma_gamma import (
    gamma_gamma_cdf,
    gamma_gamma_log_pdf,
    gamma_gamma_pdf,
    sample_gamma_gamma,
)

Model = Literal["lognormal", "gamma-gamma"]

# The log-skewness of gamma-gamma laws of equal scintillation index spans sigma / 2; it takes
# n sigma^2 = 96 samples to see that span at two standard errors sqrt(6 / n).
_SAMPLES_TIMES_SI = 96.0
# 4 alpha beta / (alpha + beta)^2 at alpha = 1000 beta.
_LEAST_BALANCE = 4.0 * 1e3 / 1001.0**2


@dataclass(frozen=True)
class DistributionFit:
    """A law fitted to gains.

    Parameters
    ----------
    model : {"lognormal", "gamma-gamma"}
        The law.
    parameters : dict
        ``mu``, ``sigma`` of ln(gain), or ``alpha``, ``beta``, ``mean``.
    n : int
        Number of gains.
    n_free : int
        Number of free parameters.
    log_likelihood : float
        Maximum of ln(likelihood).
    note : str, optional
        What the reader must know, empty if nothing.
    """

    model: Model
    parameters: dict[str, float]
    n: int
    n_free: int
    log_likelihood: float
    note: str = ""

    @property
    def aic(self) -> float:
        """Akaike's criterion 2 k - 2 ln L; among laws for the same gains the least is best."""
        return 2.0 * self.n_free - 2.0 * self.log_likelihood

    @property
    def scintillation_index(self) -> float:
        """Scintillation index [1] of the law."""
        p = self.parameters
        if self.model == "lognormal":
            return math.expm1(p["sigma"] ** 2)
        return 1.0 / p["alpha"] + 1.0 / p["beta"] + 1.0 / (p["alpha"] * p["beta"])

    def pdf(self, gain: ArrayLike) -> FloatArray:
        """Return the density [1] per unit of gain."""
        if self.model == "gamma-gamma":
            return gamma_gamma_pdf(gain, **self.parameters)
        return np.asarray(self._lognormal().pdf(np.asarray(gain, dtype=np.float64)))

    def cdf(self, gain: ArrayLike) -> FloatArray:
        """Return P(g <= gain) [1]: the outage probability at that gain."""
        if self.model == "gamma-gamma":
            return gamma_gamma_cdf(gain, **self.parameters)
        return np.asarray(self._lognormal().cdf(np.asarray(gain, dtype=np.float64)))

    def sample(self, n: int, *, rng: np.random.Generator) -> FloatArray:
        """Draw n gains [1]."""
        if self.model == "gamma-gamma":
            return sample_gamma_gamma(n, **self.parameters, rng=rng)
        return rng.lognormal(self.parameters["mu"], self.parameters["sigma"], n)

    def _lognormal(self) -> Any:
        from scipy import stats

        return stats.lognorm(self.parameters["sigma"], scale=math.exp(self.parameters["mu"]))


class GoodnessOfFit(NamedTuple):
    """Kolmogorov-Smirnov distance `ks` of a fitted law from `n` samples, and its p-value."""

    model: Model
    ks: float
    p_value: float
    n: int


def fit_lognormal(gain: ArrayLike, gain_stderr: ArrayLike | None = None) -> DistributionFit:
    r"""Fit a lognormal law by maximum likelihood.

    .. math:: \mu = \overline{\ln g'}, \quad \sigma^2 = \overline{(\ln g' - \mu)^2}

    Parameters
    ----------
    gain, gain_stderr
        As in `remove_noise`, which gives the g' of the equation.

    Returns
    -------
    DistributionFit
        Parameters ``mu`` and ``sigma``.

    Raises
    ------
    ValueError
        If a gain is 0, negative or not finite, or no variance is left beside the noise.

    Notes
    -----
    SI = exp(sigma^2) - 1.

    Examples
    --------
    >>> fit_lognormal(np.exp([-0.3, 0.0, 0.3])).scintillation_index  # doctest: +ELLIPSIS
    0.0618...
    """
    g = _fit_sample(gain, gain_stderr)
    log_gain = np.log(g)
    mu, sigma = float(log_gain.mean()), float(log_gain.std())
    log_likelihood = -g.size * (mu + math.log(sigma) + 0.5 * math.log(2.0 * math.pi) + 0.5)
    return DistributionFit("lognormal", {"mu": mu, "sigma": sigma}, g.size, 2, log_likelihood)


def fit_gamma_gamma(
    gain: ArrayLike,
    gain_stderr: ArrayLike | None = None,
    *,
    n_effective: float | None = None,
) -> DistributionFit:
    r"""Fit a gamma-gamma law: moments refined by maximum likelihood.

    .. math:: \mathrm{SI} = 1/\alpha + 1/\beta + 1/(\alpha\beta), \quad
              \overline{h^3} / \overline{h^2} = (1 + 2/\alpha)(1 + 2/\beta)

    Parameters
    ----------
    gain, gain_stderr
        As in `remove_noise`, which is applied first.
    n_effective : float, optional
        Number of independent samples, by default n; decides whether the shapes are identifiable.

    Returns
    -------
    DistributionFit
        Parameters ``alpha >= beta`` (the law does not tell them apart) and ``mean``.

    Raises
    ------
    ValueError
        If a gain is 0, negative or not finite, or no variance is left beside the noise.

    Notes
    -----
    The variance fixes one combination of the shapes; only the skewness tells them apart. The
    skewness of ln h lies between -sigma / 2 (alpha = beta) and -sigma (alpha infinite), with
    sigma^2 = ln(1 + SI), and is known to sqrt(6 / n). Below n sigma^2 = 96 that is too
    coarse at two standard errors: alpha = beta is fitted instead, and `note` says so. alpha is
    limited to 1000 beta, which is a gamma law for every purpose.

    References
    ----------
    Al-Habash, Andrews and Phillips (2001), doi:10.1117/1.1386641.

    Examples
    --------
    >>> g = sample_gamma_gamma(4000, 4.0, 2.0, rng=np.random.default_rng(2))
    >>> fit = fit_gamma_gamma(g)
    >>> round(fit.scintillation_index, 2)  # the law has 0.875
    0.86
    """
    g = _fit_sample(gain, gain_stderr)
    log_h = np.log(g / g.mean())
    second = float(np.mean(np.exp(2.0 * log_h)))
    sigma2 = math.log(second)
    known = (g.size if n_effective is None else n_effective) * sigma2
    free = known >= _SAMPLES_TIMES_SI
    balance = _moment_balance(second, float(np.mean(np.exp(3.0 * log_h)))) if free else 1.0
    v, log_likelihood = _maximize_gamma_gamma(log_h, math.log(second - 1.0), balance, free)
    alpha, beta = _shapes(v[1], v[2])
    mean = float(g.mean()) * math.exp(v[0] * math.sqrt(sigma2))
    return DistributionFit(
        "gamma-gamma",
        {"alpha": alpha, "beta": beta, "mean": mean},
        g.size,
        3 if free else 2,
        log_likelihood - g.size * math.log(g.mean()),
        _gamma_gamma_note(known, v[2]),
    )


def goodness_of_fit(
    model: Model,
    gain: ArrayLike,
    gain_stderr: ArrayLike | None = None,
    *,
    resamples: int = 199,
    seed: int = 0,
) -> GoodnessOfFit:
    r"""Test a law fitted to independent gains by the Kolmogorov-Smirnov distance.

    .. math:: D = \sup_x |F_n(x) - F(x; \hat\theta)|, \quad
              p = (1 + \#\{D^* \ge D\}) / (1 + \mathrm{resamples})

    Parameters
    ----------
    model : {"lognormal", "gamma-gamma"}
        The law, fitted here.
    gain, gain_stderr
        As in `remove_noise`, which is applied first.
    resamples, seed : int, optional
        Number and seed of the synthetic samples.

    Returns
    -------
    GoodnessOfFit
        Distance, p-value and number of gains.

    Raises
    ------
    ValueError
        As the fits.

    Notes
    -----
    The parameters come from the same gains, so the tables of the distance do not hold: D* is
    measured on samples drawn from the fitted law and fitted anew (parametric bootstrap). For a
    series pass gains far enough apart to be independent.

    References
    ----------
    Stute, W., Manteiga, W. G. and Quindimil, M. P. (1993), doi:10.1007/BF02613687.

    Examples
    --------
    >>> g = np.random.default_rng(3).lognormal(-10.0, 0.3, 200)
    >>> goodness_of_fit("lognormal", g).p_value > 0.05
    True
    """
    if model not in ("lognormal", "gamma-gamma"):
        raise ValueError(f"model: {model!r}, allowed 'lognormal', 'gamma-gamma'")
    if resamples < 1:
        raise ValueError(f"resamples: {resamples}, allowed resamples >= 1")
    fit_law = fit_lognormal if model == "lognormal" else fit_gamma_gamma
    g = _fit_sample(gain, gain_stderr)
    fit = fit_law(g)
    rng = np.random.default_rng(seed)
    distance = _ks_distance(g, fit)
    samples = (fit.sample(g.size, rng=rng) for _ in range(resamples))
    beyond = sum(_ks_distance(sample, fit_law(sample)) >= distance for sample in samples)
    return GoodnessOfFit(model, distance, (1.0 + beyond) / (1.0 + resamples), g.size)


def _fit_sample(gain: ArrayLike, gain_stderr: ArrayLike | None) -> FloatArray:
    g = remove_noise(gain, gain_stderr)
    if not g.all():
        zeros = g.size - np.count_nonzero(g)
        raise ValueError(f"gain: {zeros} of {g.size} are 0, allowed gains > 0 for a fit")
    if np.ptp(g) <= 1e-12 * g.max():
        raise ValueError("gain: no variance beside the Monte Carlo noise, allowed gains that vary")
    return g


def _moment_balance(second: float, third: float) -> float:
    """Return 4 alpha beta / (alpha + beta)^2 from the moments of h, kept inside the family."""
    product = 0.5 * (third / second + 1.0) - second
    total = second - 1.0 - product
    return float(np.clip(4.0 * product / total**2, 0.05, 0.95)) if total > 0.0 else 0.95


def _shapes(log_si: float, balance: float) -> tuple[float, float]:
    """Return (alpha, beta) of a scintillation index and 4 alpha beta / (alpha + beta)^2."""
    root = math.sqrt(max(0.0, 1.0 - balance))
    inverse = (1.0 - root) / (1.0 + root)
    si = math.exp(log_si)
    beta = (1.0 + inverse + math.sqrt((1.0 + inverse) ** 2 + 4.0 * si * inverse)) / (2.0 * si)
    return beta / inverse, beta


def _maximize_gamma_gamma(
    log_h: FloatArray, log_si: float, balance: float, free: bool
) -> tuple[FloatArray, float]:
    """Return (ln mean / sigma, ln SI, balance) of the greatest likelihood, and its logarithm.

    The likelihood is even in ln(alpha / beta) and flat at infinite alpha; in the balance
    4 alpha beta / (alpha + beta)^2 it has a slope at both ends, and nearly orthogonal partners.
    """
    from scipy import optimize

    sigma = math.sqrt(math.log1p(math.exp(log_si)))
    nodes, weights = _likelihood_nodes(log_h)

    def cost(v: FloatArray) -> float:
        shift = v[0] * sigma
        log_pdf = gamma_gamma_log_pdf(nodes - shift, *_shapes(v[1], v[2])) - shift
        return -float(weights @ log_pdf) / log_h.size

    best = optimize.minimize(
        cost,
        [0.0, log_si, balance],
        method="SLSQP",  # as exact as L-BFGS-B here, which BLAS threads slow down on a busy machine
        jac="3-point",
        bounds=[(-1.0, 1.0), (log_si - 3.0, log_si + 3.0), (_LEAST_BALANCE if free else 1.0, 1.0)],
        options={"finite_diff_rel_step": 1e-4, "ftol": 1e-11},
    )
    return best.x, -float(best.fun) * log_h.size


def _likelihood_nodes(log_h: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights such that sum f(log_h) = weights @ f(nodes) for a smooth f.

    Local cubic interpolation over 300 nodes: the logarithm of the density is so smooth that 300
    Bessel functions do the work of one per gain, to 1e-4 in ln L.
    """
    m = 300
    if log_h.size <= 2 * m:
        return log_h, np.ones_like(log_h)
    nodes = np.linspace(log_h.min(), log_h.max(), m)
    u = (log_h - nodes[0]) / (nodes[1] - nodes[0])
    left = np.clip(u.astype(np.int64), 1, m - 3)
    u = u - left
    basis = (
        u * (u - 1.0) * (2.0 - u) / 6.0,
        (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0,
        (u + 1.0) * u * (2.0 - u) / 2.0,
        (u + 1.0) * u * (u - 1.0) / 6.0,
    )
    parts = [np.bincount(left + k - 1, part, m) for k, part in enumerate(basis)]
    return nodes, np.sum(parts, axis=0)


def _gamma_gamma_note(known: float, balance: float) -> str:
    if known < _SAMPLES_TIMES_SI:
        return (
            f"alpha and beta cannot be told apart: n ln(1 + SI) = {known:.3g}, needed "
            f"{_SAMPLES_TIMES_SI:.0f}; alpha = beta fitted, only their scintillation index counts"
        )
    if balance > 1.0 - 1e-6:
        return "alpha = beta is the best of the family; the gains are less skewed than that"
    if balance < 1.01 * _LEAST_BALANCE:
        return "alpha at its limit of 1000 beta: a gamma law of shape beta"
    return ""


def _ks_distance(gain: FloatArray, fit: DistributionFit) -> float:
    cdf = fit.cdf(np.sort(gain))
    rank = np.arange(gain.size + 1) / gain.size
    return float(max(np.max(rank[1:] - cdf), np.max(cdf - rank[:-1])))
