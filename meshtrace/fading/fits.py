"""Fits of fading laws to gains without their Monte Carlo noise, and tests of the fits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.checks import Seed, check_call
from meshtrace.errors import Described, Refused
from meshtrace.fading.distribution import MOST_RESAMPLES, remove_noise
from meshtrace.models import Floats

Law = Literal["lognormal", "gamma-gamma"]


@dataclass(frozen=True)
class DistributionFit:
    """Law fitted to gains by maximum likelihood.

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
        Remark on the fit, empty if there is none.
    """

    model: Law
    parameters: dict[str, float]
    n: int
    n_free: int
    log_likelihood: float
    note: str = ""

    @property
    def aic(self) -> float:
        """Akaike's criterion 2 k - 2 ln L; lower is better among laws for the same gains."""
        return 2.0 * self.n_free - 2.0 * self.log_likelihood

    @property
    def scintillation_index(self) -> float:
        """Scintillation index [1] of the law."""
        p = self.parameters
        if self.model == "lognormal":
            return math.expm1(p["sigma"] ** 2)
        return 1.0 / p["alpha"] + 1.0 / p["beta"] + 1.0 / (p["alpha"] * p["beta"])

    @property
    def law(self) -> Any:
        """Frozen scipy distribution with `pdf`, `cdf` (the outage probability), `rvs`."""
        from scipy import stats

        from meshtrace.fading.laws import gamma_gamma

        p = self.parameters
        if self.model == "lognormal":
            return stats.lognorm(p["sigma"], scale=math.exp(p["mu"]))
        return gamma_gamma(p["alpha"], p["beta"], scale=p["mean"])


class GoodnessOfFit(NamedTuple):
    """Kolmogorov-Smirnov distance `ks` between a fitted law and `n` gains, and its p-value."""

    model: Law
    ks: float
    p_value: float
    n: int


@check_call
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
    Refused
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
    # the density of the gain has a factor 1 / g, whose logarithm adds up to -n mu: with it the AIC
    # is comparable to that of other laws
    log_likelihood = -g.size * (mu + math.log(sigma) + 0.5 * math.log(2.0 * math.pi) + 0.5)
    return DistributionFit("lognormal", {"mu": mu, "sigma": sigma}, g.size, 2, log_likelihood)


@check_call
def fit_gamma_gamma(
    gain: ArrayLike, gain_stderr: ArrayLike | None = None, *, n_effective: float | None = None
) -> DistributionFit:
    r"""Fit a gamma-gamma law by maximum likelihood, from its moments as first guess.

    .. math:: \mathrm{SI} = 1/\alpha + 1/\beta + 1/(\alpha\beta), \quad
              \overline{h^3} / \overline{h^2} = (1 + 2/\alpha)(1 + 2/\beta)

    Parameters
    ----------
    gain, gain_stderr
        As in `remove_noise`, which is applied first.
    n_effective : float, optional
        Number of independent samples, by default n, which decides whether alpha and beta are
        identifiable.

    Returns
    -------
    DistributionFit
        Parameters ``alpha >= beta`` (the law does not tell them apart) and ``mean``.

    Raises
    ------
    Refused
        If a gain is 0, negative or not finite, or no variance is left beside the noise.

    Notes
    -----
    The variance fixes one combination of the shapes; only the skewness separates them. The
    skewness of ln h lies between -sigma / 2 (alpha = beta) and -sigma (alpha infinite), with
    sigma^2 = ln(1 + SI), and its standard error is sqrt(6 / n). Below n sigma^2 = 96 two standard
    errors exceed that range: alpha = beta is fitted instead, and `note` says so. alpha is limited
    to 1000 beta, which is a gamma law for every purpose.

    References
    ----------
    Al-Habash, Andrews and Phillips (2001), doi:10.1117/1.1386641.

    Examples
    --------
    >>> from meshtrace.fading import gamma_gamma
    >>> g = gamma_gamma.rvs(4.0, 2.0, size=4000, random_state=np.random.default_rng(2))
    >>> fit = fit_gamma_gamma(g)
    >>> round(fit.scintillation_index, 2)  # the law has 0.875
    0.86
    """
    from meshtrace.fading.laws import likeliest_gamma_gamma

    g = _fit_sample(gain, gain_stderr)
    parameters, n_free, log_likelihood, note = likeliest_gamma_gamma(g, n_effective)
    return DistributionFit("gamma-gamma", parameters, g.size, n_free, log_likelihood, note)


@check_call
def goodness_of_fit(
    model: Law,
    gain: ArrayLike,
    gain_stderr: ArrayLike | None = None,
    *,
    resamples: Annotated[int, Field(ge=1, le=MOST_RESAMPLES)] = 199,
    seed: Seed = 1,
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
    Refused
        If a gain is 0, negative or not finite, or no variance is left beside the noise.

    Notes
    -----
    As the parameters are fitted to the same gains, the tabulated law of the distance does not hold:
    D* is measured on samples drawn from the fitted law and fitted again (parametric bootstrap). For
    a series pass gains far enough apart to be independent.

    References
    ----------
    Stute, W., Manteiga, W. G. and Quindimil, M. P. (1993), doi:10.1007/BF02613687.

    Examples
    --------
    >>> g = np.random.default_rng(3).lognormal(-10.0, 0.3, 200)
    >>> goodness_of_fit("lognormal", g).p_value > 0.05
    True
    """
    from scipy import stats

    from meshtrace.fading.laws import gamma_gamma

    g = _fit_sample(gain, gain_stderr)
    test = stats.goodness_of_fit(
        stats.lognorm if model == "lognormal" else gamma_gamma,
        g,
        known_params={"loc": 0.0},
        statistic="ks",
        n_mc_samples=resamples,
        rng=np.random.default_rng(seed),
    )
    return GoodnessOfFit(model, float(test.statistic), float(test.pvalue), g.size)


def _fit_sample(gain: ArrayLike, gain_stderr: ArrayLike | None) -> Floats:
    """Return the gains without their noise; refuse zeros, and gains that do not vary."""
    g = remove_noise(gain, gain_stderr)
    if not g.all():
        zeros = g.size - np.count_nonzero(g)
        raise Refused("gain", Described(f"{zeros} of {g.size} are 0"), "gains > 0 for a fit")
    # where `remove_noise` takes the whole spread away, rounding may leave some of it
    if np.ptp(g) <= 1e-12 * g.max():
        reason = Described("no variance above the Monte Carlo noise")
        raise Refused("gain", reason, "gains that vary")
    return g
