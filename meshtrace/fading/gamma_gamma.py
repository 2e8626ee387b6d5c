"""The gamma-gamma law, stable for any shapes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.fading.gains import FloatArray


def gamma_gamma_pdf(gain: ArrayLike, alpha: float, beta: float, mean: float = 1.0) -> FloatArray:
    r"""Return the gamma-gamma probability density.

    .. math:: f(h) = \frac{2 (\alpha\beta)^{(\alpha+\beta)/2}}{\Gamma(\alpha)\Gamma(\beta)}
              h^{(\alpha+\beta)/2 - 1} K_{\alpha-\beta}(2 \sqrt{\alpha\beta h}),
              \quad h = g / \mathrm{mean}

    Parameters
    ----------
    gain : array_like
        Gains [1].
    alpha, beta : float
        Shapes [1] of the two gamma factors, interchangeable.
    mean : float, optional
        Mean gain [1].

    Returns
    -------
    ndarray
        Density [1] per unit of gain; 0 at gains <= 0.

    Raises
    ------
    ValueError
        If a parameter is not positive and finite.

    Notes
    -----
    Computed in the logarithm from the scaled Bessel function; where that overflows (large
    orders), from its uniform expansion, good to 1e-6 of the density at order 5 and better above.

    References
    ----------
    Al-Habash, Andrews and Phillips (2001), doi:10.1117/1.1386641. DLMF 10.41.4.

    Examples
    --------
    >>> gamma_gamma_pdf(1.0, 4.0, 2.0).round(6)
    np.float64(0.425916)
    """
    _check_gamma_gamma(alpha, beta, mean)
    h = np.asarray(gain, dtype=np.float64) / mean
    density = np.zeros_like(h)
    density[h > 0.0] = np.exp(gamma_gamma_log_pdf(np.log(h[h > 0.0]), alpha, beta)) / mean
    return density


def gamma_gamma_cdf(gain: ArrayLike, alpha: float, beta: float, mean: float = 1.0) -> FloatArray:
    """Return the gamma-gamma distribution function, the integral of `gamma_gamma_pdf`.

    Parameters
    ----------
    gain, alpha, beta, mean
        As in `gamma_gamma_pdf`.

    Returns
    -------
    ndarray
        P(g <= gain) [1].

    Raises
    ------
    ValueError
        If a parameter is not positive and finite.

    Notes
    -----
    Spline quadrature in ln h over 40 standard deviations below and 12 above the mean; absolute
    error below 1e-8. The hypergeometric closed form cancels for shapes above a few tens.

    Examples
    --------
    >>> gamma_gamma_cdf([0.5, 1.0, 2.0], 4.0, 2.0).round(6)
    array([0.34934 , 0.637981, 0.883654])
    """
    from scipy import interpolate, special

    _check_gamma_gamma(alpha, beta, mean)
    shapes = np.array([alpha, beta])
    center = float(np.sum(special.digamma(shapes) - np.log(shapes)))
    width = math.sqrt(float(np.sum(special.polygamma(1, shapes))))
    t = center + width * np.linspace(-40.0, 12.0, 2048)
    density = np.exp(gamma_gamma_log_pdf(t, alpha, beta) + t)
    integral = interpolate.CubicSpline(t, density).antiderivative()
    with np.errstate(divide="ignore"):
        log_h = np.log(np.maximum(np.asarray(gain, dtype=np.float64) / mean, 0.0))
    return np.clip(integral(np.clip(log_h, t[0], t[-1])) / integral(t[-1]), 0.0, 1.0)


def sample_gamma_gamma(
    n: int, alpha: float, beta: float, mean: float = 1.0, *, rng: np.random.Generator
) -> FloatArray:
    """Draw gamma-gamma gains: the product of two independent gamma variables.

    Parameters
    ----------
    n : int
        Number of gains.
    alpha, beta, mean : float
        As in `gamma_gamma_pdf`.
    rng : numpy.random.Generator
        Source of random numbers.

    Returns
    -------
    ndarray, shape (n,)
        Gains [1].

    Raises
    ------
    ValueError
        If a parameter is not positive and finite.

    Examples
    --------
    >>> sample_gamma_gamma(3, 4.0, 2.0, rng=np.random.default_rng(1)).shape
    (3,)
    """
    _check_gamma_gamma(alpha, beta, mean)
    return mean * rng.gamma(alpha, 1.0 / alpha, n) * rng.gamma(beta, 1.0 / beta, n)


def gamma_gamma_log_pdf(log_h: FloatArray, alpha: float, beta: float) -> FloatArray:
    """Return ln f(h) for unit mean."""
    from scipy import special

    half = 0.5 * (alpha + beta)
    log_product = math.log(alpha) + math.log(beta)
    constant = math.log(2.0) - special.gammaln(alpha) - special.gammaln(beta)
    bessel = _log_kv(abs(alpha - beta), 2.0 * np.exp(0.5 * (log_product + log_h)))
    return constant + half * (log_product + log_h) - log_h + bessel


def _log_kv(order: float, x: FloatArray) -> FloatArray:
    """Return ln K_order(x), from the uniform expansion where the scaled function overflows."""
    from scipy import special

    with np.errstate(divide="ignore", over="ignore"):
        scaled = special.kve(order, x)
    out = np.log(scaled, out=np.full_like(x, math.inf), where=np.isfinite(scaled)) - x
    lost = ~np.isfinite(scaled)
    if lost.any():
        z = x[lost] / order
        root = np.hypot(1.0, z)
        p = 1.0 / root
        u1 = (3.0 * p - 5.0 * p**3) / 24.0
        u2 = (81.0 * p**2 - 462.0 * p**4 + 385.0 * p**6) / 1152.0
        series = 1.0 - u1 / order + u2 / order**2
        eta = root + np.log(z) - np.log1p(root)
        out[lost] = 0.5 * np.log(0.5 * np.pi / (order * root)) - order * eta + np.log(series)
    return out


def _check_gamma_gamma(alpha: float, beta: float, mean: float) -> None:
    for name, value in (("alpha", alpha), ("beta", beta), ("mean", mean)):
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{name}: {value}, allowed finite > 0")
