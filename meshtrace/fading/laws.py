"""The gamma-gamma law as a scipy distribution, stable for any shapes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import interpolate, optimize, special, stats

from meshtrace.models import Floats

# Least n ln(1 + SI) at which the shapes can be separated. With sigma^2 = ln(1 + SI) the skewness of
# ln h spans sigma / 2 over the gamma-gamma laws of one scintillation index, and its standard error
# is sqrt(6 / n): the span is two standard errors at n sigma^2 = 96.
_SAMPLES_TIMES_SI = 96.0
# 4 alpha beta / (alpha + beta)^2 at alpha = 1000 beta, where the law is a gamma law in effect
_LEAST_BALANCE = 4.0 * 1e3 / 1001.0**2


class GammaGamma(stats.rv_continuous):
    r"""Product of two independent gamma variables of unit mean.

    .. math:: f(h) = \frac{2 (\alpha\beta)^{(\alpha+\beta)/2}}{\Gamma(\alpha)\Gamma(\beta)}
              h^{(\alpha+\beta)/2 - 1} K_{\alpha-\beta}(2 \sqrt{\alpha\beta h})

    The interface is that of `scipy.stats` distributions, with the shapes `alpha` and `beta`
    (interchangeable, > 0) and the mean as `scale`; `fit` returns (alpha, beta, 0, mean).

    Notes
    -----
    The density is computed in the logarithm from the scaled Bessel function; where that overflows
    (large orders), from its uniform expansion, with a relative error of 1e-6 at order 5 and less
    above. The distribution function is integrated by a spline in ln h from 40 standard deviations
    below the mean to 12 above; its absolute error is below 1e-8. The hypergeometric closed form
    loses its digits to cancellation for shapes above a few tens.

    References
    ----------
    Al-Habash, Andrews and Phillips (2001), doi:10.1117/1.1386641. DLMF 10.41.4.

    Examples
    --------
    >>> gamma_gamma.pdf(1.0, 4.0, 2.0).round(6), gamma_gamma.cdf([0.5, 1.0], 4.0, 2.0).round(6)
    (np.float64(0.425916), array([0.34934 , 0.637981]))
    """

    def _argcheck(self, alpha: Any, beta: Any) -> Any:
        return np.isfinite(alpha) & (alpha > 0.0) & np.isfinite(beta) & (beta > 0.0)

    def _pdf(self, h: Floats, alpha: Floats, beta: Floats) -> Floats:
        return _law_by_law(_density, h, alpha, beta)

    def _cdf(self, h: Floats, alpha: Floats, beta: Floats) -> Floats:
        return _law_by_law(_probability, h, alpha, beta)

    def _stats(self, alpha: Any, beta: Any) -> tuple[Any, Any, None, None]:
        return np.ones_like(alpha), 1.0 / alpha + 1.0 / beta + 1.0 / (alpha * beta), None, None

    def _rvs(
        self, alpha: Any, beta: Any, size: Any = None, random_state: Any = None
    ) -> Floats | float:
        # Order of the random numbers: sample after sample, in each the factors of alpha first. Thus
        # a matrix of samples (..., n) has the same draws as its samples one by one.
        *samples, n = size or (1,)
        shapes = np.array([alpha, beta], dtype=np.float64).reshape(2, 1)
        factors = random_state.gamma(shapes, 1.0 / shapes, (*samples, 2, n)).prod(axis=-2)
        return factors if size else float(factors[0])

    def fit(self, data: ArrayLike, *args: Any, **kwds: Any) -> tuple[float, float, float, float]:
        """Return the maximum-likelihood (alpha, beta, 0, mean); see `likeliest_gamma_gamma`."""
        best, *_ = likeliest_gamma_gamma(np.asarray(data, dtype=np.float64))
        return best["alpha"], best["beta"], 0.0, best["mean"]


gamma_gamma = GammaGamma(a=0.0, name="gamma_gamma", shapes="alpha, beta")


def likeliest_gamma_gamma(
    gain: Floats, n_effective: float | None = None
) -> tuple[dict[str, float], int, float, str]:
    """Maximise the gamma-gamma likelihood of positive gains, with their moments as first guess.

    Parameters
    ----------
    gain : ndarray, shape (n,)
        Gains > 0 [1] that vary.
    n_effective : float, optional
        Number of independent samples, by default n; alpha = beta is fitted if the shapes are not
        identifiable.

    Returns
    -------
    parameters : dict
        ``alpha``, ``beta`` and ``mean``.
    n_free : int
        Number of free parameters.
    log_likelihood : float
        Maximum of ln(likelihood).
    note : str
        Remark on the fit, empty if there is none.

    Notes
    -----
    The variables are ln(mean) / sigma, ln SI and the balance 4 alpha beta / (alpha + beta)^2. They
    are nearly orthogonal, and the likelihood has a slope at both ends of the balance, where in
    ln(alpha / beta) it would be even (alpha = beta) or flat (alpha infinite).
    """
    log_h = np.log(gain / gain.mean())
    second = float(np.mean(np.exp(2.0 * log_h)))  # E h^2 = 1 + SI
    known = (gain.size if n_effective is None else n_effective) * math.log(second)
    free, log_si = known >= _SAMPLES_TIMES_SI, math.log(second - 1.0)  # free: alpha != beta
    balance = _moment_balance(second, float(np.mean(np.exp(3.0 * log_h)))) if free else 1.0
    sigma = math.sqrt(math.log1p(math.exp(log_si)))
    nodes, weights = _likelihood_nodes(log_h)

    def cost(v: Floats) -> float:
        """Return -ln L per value of h for v = (ln(mean) / sigma, ln SI, balance)."""
        shift = v[0] * sigma  # ln of the law's mean, by which its density is scaled
        log_pdf = _log_pdf(nodes - shift, *_shapes(v[1], v[2])) - shift
        return -float(weights @ log_pdf) / log_h.size

    best = optimize.minimize(
        cost,
        [0.0, log_si, balance],
        method="SLSQP",  # as exact here as L-BFGS-B, which BLAS threads slow down on a busy machine
        jac="3-point",
        bounds=[(-1.0, 1.0), (log_si - 3.0, log_si + 3.0), (_LEAST_BALANCE if free else 1.0, 1.0)],
        options={"finite_diff_rel_step": 1e-4, "ftol": 1e-11},
    )
    note, (alpha, beta) = "", _shapes(best.x[1], best.x[2])
    if not free:
        note = (
            f"alpha and beta cannot be separated: n ln(1 + SI) = {known:.3g}, required "
            f"{_SAMPLES_TIMES_SI:.0f}; fitted with alpha = beta, for the scintillation index only"
        )
    elif best.x[2] > 1.0 - 1e-6:
        note = "alpha = beta fits best; ln(gain) is less skewed than in any gamma-gamma law"
    elif best.x[2] < 1.01 * _LEAST_BALANCE:
        note = "alpha at its limit of 1000 beta: a gamma law of shape beta"
    mean = float(gain.mean()) * math.exp(best.x[0] * math.sqrt(math.log(second)))
    # the density of the gain is that of h = gain / mean, divided by the mean gain
    log_likelihood = -float(best.fun) * log_h.size - gain.size * math.log(gain.mean())
    parameters = {"alpha": alpha, "beta": beta, "mean": mean}
    return parameters, 3 if free else 2, log_likelihood, note


def _law_by_law(
    function: Callable[[Floats, float, float], Floats],
    h: Floats,
    alpha: Floats,
    beta: Floats,
) -> Floats:
    """Return a function of h (n,) and one law, applied to each run of equal shapes in turn."""
    # scipy passes the shapes as arrays, one of each for every h
    h, alpha, beta = np.broadcast_arrays(*(np.atleast_1d(a) for a in (h, alpha, beta)))
    h, alpha, beta = h.ravel(), alpha.ravel(), beta.ravel()
    new = np.flatnonzero((np.diff(alpha) != 0.0) | (np.diff(beta) != 0.0)) + 1
    starts = np.concatenate([[0], new])
    parts = np.split(h, new)
    laws = zip(parts, alpha[starts], beta[starts], strict=True)
    return np.concatenate([function(part, float(a), float(b)) for part, a, b in laws])


def probability_in_log(std_log: float) -> Callable[[Floats], Floats]:
    r"""Return the distribution function of z = (ln h - E ln h) / s for alpha = beta.

    .. math:: s^2 = \operatorname{var} \ln h = 2 \psi'(\alpha), \quad \alpha = \beta

    Parameters
    ----------
    std_log : float
        Standard deviation s of ln h [1], limited to 1e-4 ... 4.

    Notes
    -----
    A few gains determine the mean and the deviation of ln h, but not its shape. With equal shapes
    its skewness is about -s / 2, between 0 (lognormal) and -s (gamma). At the 1 % quantile this law
    is within 0.12 dB of the 200 to 500 gains of the default link over seas of 3, 5 and 13 m/s to
    which it is fitted; a lognormal law is up to 0.6 dB above them.
    """
    s = min(max(std_log, 1e-4), 4.0)
    # shapes at which the variance of ln h is 203 and 2e-10, outside the limits of s^2
    bounds = math.log(0.1), math.log(1e10)
    log_shape = optimize.brentq(lambda u: 2.0 * special.polygamma(1, math.exp(u)) - s**2, *bounds)
    shape = math.exp(log_shape)
    z = np.linspace(-40.0, 12.0, 2048)
    center = 2.0 * float(special.digamma(shape) - log_shape)
    logs = np.log(np.maximum(_probability(np.exp(center + s * z), shape, shape), 1e-300))
    # ln P is interpolated linearly, since P spans hundreds of decades
    return lambda at: np.exp(np.interp(at, z, logs))


def _density(h: Floats, alpha: float, beta: float) -> Floats:
    """Return the density f(h) of one law with unit mean, 0 for h <= 0."""
    density = np.zeros_like(h)
    density[h > 0.0] = np.exp(_log_pdf(np.log(h[h > 0.0]), alpha, beta))
    return density


def _probability(h: Floats, alpha: float, beta: float) -> Floats:
    """Return the distribution function P(h) of one law with unit mean."""
    shapes = np.array([alpha, beta])
    # mean and standard deviation of ln h: sums of the digamma and trigamma functions of both shapes
    center = float(np.sum(special.digamma(shapes) - np.log(shapes)))
    width = math.sqrt(float(np.sum(special.polygamma(1, shapes))))
    t = center + width * np.linspace(-40.0, 12.0, 2048)
    # over t = ln h, in which the density is h f(h)
    integral = interpolate.CubicSpline(t, np.exp(_log_pdf(t, alpha, beta) + t)).antiderivative()
    with np.errstate(divide="ignore"):
        log_h = np.log(np.maximum(h, 0.0))
    return np.clip(integral(np.clip(log_h, t[0], t[-1])) / integral(t[-1]), 0.0, 1.0)


def _log_pdf(log_h: Floats, alpha: float, beta: float) -> Floats:
    """Return ln f(h) of one law with unit mean."""
    half = 0.5 * (alpha + beta)
    log_product = math.log(alpha) + math.log(beta)
    constant = math.log(2.0) - special.gammaln(alpha) - special.gammaln(beta)
    bessel = _log_kv(abs(alpha - beta), 2.0 * np.exp(0.5 * (log_product + log_h)))
    return constant + half * (log_product + log_h) - log_h + bessel


def _log_kv(order: float, x: Floats) -> Floats:
    """Return ln K_order(x), by the uniform expansion where scipy's scaled function overflows."""
    with np.errstate(divide="ignore", over="ignore"):
        scaled = special.kve(order, x)  # K exp(x)
    log_k = np.log(scaled, out=np.full_like(x, math.inf), where=np.isfinite(scaled)) - x
    overflow = ~np.isfinite(scaled)
    if overflow.any():
        z = x[overflow] / order
        root = np.hypot(1.0, z)
        p = 1.0 / root
        # DLMF 10.41.4 with the polynomials U_1 and U_2 of 10.41.10
        u1 = (3.0 * p - 5.0 * p**3) / 24.0
        u2 = (81.0 * p**2 - 462.0 * p**4 + 385.0 * p**6) / 1152.0
        series = 1.0 - u1 / order + u2 / order**2
        eta = root + np.log(z) - np.log1p(root)  # DLMF 10.41.7
        log_k[overflow] = 0.5 * np.log(0.5 * np.pi / (order * root)) - order * eta + np.log(series)
    return log_k


def _moment_balance(second: float, third: float) -> float:
    """Return 4 alpha beta / (alpha + beta)^2 from E h^2 and E h^3, as first guess of a search."""
    # E h^2 = 1 + s + p and E h^3 / E h^2 = 1 + 2 s + 4 p, s = 1/alpha + 1/beta, p = 1/(alpha beta)
    product = 0.5 * (third / second + 1.0) - second
    total = second - 1.0 - product
    # 4 p / s^2, inside the bounds of the search; moments that no law has: shapes nearly equal
    return float(np.clip(4.0 * product / total**2, 0.05, 0.95)) if total > 0.0 else 0.95


def _shapes(log_si: float, balance: float) -> tuple[float, float]:
    """Return (alpha, beta) of a scintillation index and 4 alpha beta / (alpha + beta)^2."""
    root = math.sqrt(max(0.0, 1.0 - balance))
    ratio = (1.0 - root) / (1.0 + root)  # r = beta / alpha <= 1, of balance 4 r / (1 + r)^2
    si = math.exp(log_si)
    # the positive root of SI = (1 + r) / beta + r / beta^2
    beta = (1.0 + ratio + math.sqrt((1.0 + ratio) ** 2 + 4.0 * si * ratio)) / (2.0 * si)
    return beta / ratio, beta


def _likelihood_nodes(log_h: Floats) -> tuple[Floats, Floats]:
    """Return nodes and weights with sum f(log_h) = weights @ f(nodes) for smooth f.

    The weights are those of local cubic interpolation: the logarithm of the density is so smooth
    that 300 Bessel functions in place of one per gain change ln L by less than 1e-4.
    """
    m = 300
    if log_h.size <= 2 * m:
        return log_h, np.ones_like(log_h)
    nodes = np.linspace(log_h.min(), log_h.max(), m)
    u = (log_h - nodes[0]) / (nodes[1] - nodes[0])  # in steps of the nodes
    left = np.clip(u.astype(np.int64), 1, m - 3)
    u = u - left
    # Lagrange's polynomials through the nodes at -1, 0, 1, 2
    basis = (
        u * (u - 1.0) * (2.0 - u) / 6.0,
        (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0,
        (u + 1.0) * u * (2.0 - u) / 2.0,
        (u + 1.0) * u * (u - 1.0) / 6.0,
    )
    parts = [np.bincount(left + k - 1, part, m) for k, part in enumerate(basis)]
    return nodes, np.sum(parts, axis=0)
