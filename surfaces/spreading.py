"""Directional spreading D(theta) [rad-1]: how wave energy is shared among directions.

theta is counted from the down-wind direction. Every function integrates to one over the circle;
`direction_weights` makes the shares on a chosen grid sum to one as well.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BeforeValidator, SerializeAsAny

from meshtrace.registry import Family

from .dispersion import GRAVITY, wavenumber
from .parameters import WIND_SPEED, Positive, Range, finite_array
from .spectra import elfouhaily_delta

_log_gamma = np.vectorize(math.lgamma, otypes=[np.float64])


def ittc(theta: ArrayLike) -> NDArray[np.float64]:
    """Cosine-squared spreading of the ITTC.

    D = (2 / pi) cos^2(theta), |theta| <= pi / 2

    Parameters
    ----------
    theta : array_like
        Angle from the down-wind direction [rad], |theta| <= pi.

    Returns
    -------
    ndarray
        D [rad-1], shape of `theta`.

    Examples
    --------
    >>> ittc([0.0, 2.0]).round(4)
    array([0.6366, 0.    ])
    """
    theta = finite_array("theta", theta)
    return np.where(np.abs(theta) <= 0.5 * math.pi, 2.0 / math.pi * np.cos(theta) ** 2, 0.0)


def cos_2s(theta: ArrayLike, s: ArrayLike) -> NDArray[np.float64]:
    """Cosine-2s spreading of Longuet-Higgins.

    D = 2^(2s-1) Gamma(s+1)^2 / (pi Gamma(2s+1)) cos^2s(theta / 2)

    Parameters
    ----------
    theta : array_like
        Angle from the down-wind direction [rad], |theta| <= pi.
    s : array_like
        Exponent, s >= 0; broadcasts with `theta`.

    Returns
    -------
    ndarray
        D [rad-1], broadcast shape.

    Raises
    ------
    ValueError
        If an exponent is negative or an argument not finite.

    References
    ----------
    Longuet-Higgins, Cartwright and Smith (1963), in Ocean Wave Spectra, Prentice-Hall.

    Examples
    --------
    >>> float(cos_2s(0.0, 0.0)) == 1.0 / (2.0 * math.pi)
    True
    """
    s = finite_array("s", s, 0.0)
    log_scale = (2.0 * s - 1.0) * math.log(2.0) + 2.0 * _log_gamma(s + 1.0)
    scale = np.exp(log_scale - _log_gamma(2.0 * s + 1.0)) / math.pi
    return scale * np.abs(np.cos(0.5 * finite_array("theta", theta))) ** (2.0 * s)


def mitsuyasu_exponent(omega: ArrayLike, omega_p: float, wind_speed: float) -> NDArray[np.float64]:
    """Exponent s of the cosine-2s spreading by Mitsuyasu et al.

    s = s_p (omega / omega_p)^5 below the peak, s_p (omega / omega_p)^-2.5 above,
    s_p = 11.5 (omega_p U / g)^-2.5

    Parameters
    ----------
    omega : array_like
        Angular frequency [rad s-1], omega > 0.
    omega_p : float
        Peak frequency [rad s-1].
    wind_speed : float
        Wind speed U at 10 m [m s-1].

    Returns
    -------
    ndarray
        s, shape of `omega`.

    Raises
    ------
    ValueError
        If a parameter is out of range.

    References
    ----------
    Mitsuyasu et al. (1975), doi:10.1175/1520-0485(1975)005<0750:OOTDSO>2.0.CO;2.
    """
    ratio = finite_array("omega", omega, 0.0) / Range("omega_p", 0.0, unit="rad/s").check(omega_p)
    s_p = 11.5 * (omega_p * WIND_SPEED.check(wind_speed) / GRAVITY) ** -2.5
    return s_p * np.minimum(ratio, 1.0) ** 5.0 * np.maximum(ratio, 1.0) ** -2.5


class SpreadingModel(Family, ABC, frozen=True):
    """A directional spreading: its density and the half-range where it lives."""

    half_range: ClassVar[float] = math.pi

    @abstractmethod
    def density(
        self, omega: ArrayLike, theta: ArrayLike, *, omega_p: float, wind_speed: float
    ) -> NDArray[np.float64]:
        """Return D [rad-1] at omega [rad s-1] and theta [rad], broadcast together."""


class IttcSpreading(SpreadingModel, frozen=True):
    """Cosine-squared spreading of the ITTC (the paper's), see `ittc`."""

    half_range: ClassVar[float] = 0.5 * math.pi
    kind: Literal["ittc"] = "ittc"

    def density(
        self, omega: ArrayLike, theta: ArrayLike, *, omega_p: float, wind_speed: float
    ) -> NDArray[np.float64]:
        """Return D [rad-1]; the same at every frequency."""
        return ittc(theta) * np.ones_like(finite_array("omega", omega))


class Cos2sSpreading(SpreadingModel, frozen=True):
    """Cosine-2s spreading with one exponent, see `cos_2s`.

    Parameters
    ----------
    s : float
        Exponent; 10 is a typical wind sea, larger is narrower.
    """

    kind: Literal["cos2s"] = "cos2s"
    s: Positive = 10.0

    def density(
        self, omega: ArrayLike, theta: ArrayLike, *, omega_p: float, wind_speed: float
    ) -> NDArray[np.float64]:
        """Return D [rad-1]; the same at every frequency."""
        return cos_2s(theta, self.s) * np.ones_like(finite_array("omega", omega))


class MitsuyasuSpreading(SpreadingModel, frozen=True):
    """Cosine-2s spreading that is narrowest at the peak, see `mitsuyasu_exponent`."""

    kind: Literal["mitsuyasu"] = "mitsuyasu"

    def density(
        self, omega: ArrayLike, theta: ArrayLike, *, omega_p: float, wind_speed: float
    ) -> NDArray[np.float64]:
        """Return D [rad-1]."""
        return cos_2s(theta, mitsuyasu_exponent(omega, omega_p, wind_speed))


class ElfouhailySpreading(SpreadingModel, frozen=True):
    """Spreading of the Elfouhaily spectrum, waves travelling down-wind only.

    D = (1 / pi) (1 + Delta(k) cos(2 theta)), |theta| <= pi / 2

    Notes
    -----
    The published form, half as large over the whole circle, is symmetric about the origin: right
    for a frozen surface, but in time half of its waves would run against the wind. Folding it
    keeps the elevation and slope variances along and across the wind.
    """

    half_range: ClassVar[float] = 0.5 * math.pi
    kind: Literal["elfouhaily"] = "elfouhaily"

    def density(
        self, omega: ArrayLike, theta: ArrayLike, *, omega_p: float, wind_speed: float
    ) -> NDArray[np.float64]:
        """Return D [rad-1]."""
        theta = finite_array("theta", theta)
        delta = elfouhaily_delta(wavenumber(omega, capillary=True), wind_speed, omega_p)
        folded = (1.0 + delta * np.cos(2.0 * theta)) / math.pi
        return np.where(np.abs(theta) <= self.half_range, folded, 0.0)


Spreading = Annotated[SerializeAsAny[SpreadingModel], BeforeValidator(SpreadingModel.read)]
"""Any of the spreadings, told apart by `kind`; the bare kind stands for its defaults."""


def direction_grid(half_range: float, d_theta: float) -> NDArray[np.float64]:
    """Directions spaced by `d_theta` and symmetric about the wind.

    Parameters
    ----------
    half_range : float
        pi / 2 or pi [rad]: the largest |theta| with energy.
    d_theta : float
        Distance of neighbouring directions [rad].

    Returns
    -------
    ndarray, shape (n,)
        As many directions as fit; the ends -+pi/2 are included, -pi and pi are not both.

    Raises
    ------
    ValueError
        If `d_theta` is not in (0, half_range].

    Examples
    --------
    >>> [len(direction_grid(math.pi / 2, step)) for step in (math.pi / 5, math.pi / 20)]
    [6, 21]
    """
    Range("d_theta", 0.0, half_range, "rad").check(d_theta)
    fits = math.floor(2.0 * half_range / d_theta * (1.0 + 1e-12))
    n = fits if half_range == math.pi else fits + 1
    return d_theta * (np.arange(n, dtype=np.float64) - 0.5 * (n - 1))


def direction_weights(
    spreading: SpreadingModel,
    omega: ArrayLike,
    theta: NDArray[np.float64],
    d_theta: float,
    *,
    omega_p: float,
    wind_speed: float,
) -> NDArray[np.float64]:
    """Shares D(theta_j) d_theta of the energy, made to sum to one at each frequency.

    Parameters
    ----------
    spreading : SpreadingModel
        The spreading.
    omega : array_like, shape (m,)
        Angular frequencies [rad s-1].
    theta : ndarray, shape (n,)
        Directions of `direction_grid` [rad].
    d_theta : float
        Their distance [rad].
    omega_p, wind_speed : float
        Peak frequency [rad s-1] and wind speed [m s-1] of the sea.

    Returns
    -------
    ndarray, shape (m, n)
        Shares, every row summing to one.

    Notes
    -----
    Cells that reach beyond the half-range are cut there, so that the ends -+pi/2 count half, as
    in the trapezoidal rule. For the paper's directions (6 by pi/5, 21 by pi/20) and cos^2 the
    shares of the paper, D d_theta, sum to one already.
    """
    half = spreading.half_range
    cells = np.minimum(theta + 0.5 * d_theta, half) - np.maximum(theta - 0.5 * d_theta, -half)
    column = np.asarray(omega, dtype=np.float64)[:, None]
    shares = spreading.density(column, theta, omega_p=omega_p, wind_speed=wind_speed) * cells
    return shares / shares.sum(axis=1, keepdims=True)
