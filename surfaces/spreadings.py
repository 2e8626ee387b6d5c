"""Spreadings D(theta) [rad-1] of waves over directions from the down-wind one.

Every density integrates to one over the circle; `bands.direction_weights` makes the shares on a
chosen grid sum to one as well.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.models import Family

from .parameters import Floats, Positive, WindSpeed, finite_array
from .spectra import elfouhaily_delta
from .waves import GRAVITY, wavenumber

_log_gamma = np.vectorize(math.lgamma, otypes=[np.float64])


class Spreading(Family, ABC, frozen=True):
    """Base of the directional spreadings: a subclass defines the density.

    `half_range` is the largest |theta| with energy, pi / 2 or pi [rad].
    """

    half_range: ClassVar[float] = math.pi

    @abstractmethod
    def density(
        self, omega: ArrayLike, theta: ArrayLike, *, omega_p: float, wind_speed: float
    ) -> Floats:
        """Return D [rad-1].

        Parameters
        ----------
        omega : array_like
            Angular frequency [rad s-1].
        theta : array_like
            Angle from the down-wind direction [rad], |theta| <= pi; broadcasts with `omega`.
        omega_p : float
            Peak frequency of the sea [rad s-1].
        wind_speed : float
            Wind speed at 10 m [m s-1].

        Returns
        -------
        ndarray
            Density, broadcast shape.

        Raises
        ------
        Refused
            If an argument is not finite or out of range.
        """


class IttcSpreading(Spreading, frozen=True):
    """Cosine-squared spreading of the ITTC (the paper's), the same at every frequency.

    D = (2 / pi) cos^2(theta), |theta| <= pi / 2

    Examples
    --------
    >>> IttcSpreading().density(1.0, [0.0, 2.0], omega_p=1.0, wind_speed=5.0).round(4)
    array([0.6366, 0.    ])
    """

    half_range: ClassVar[float] = 0.5 * math.pi
    kind: Literal["ittc"] = "ittc"

    def density(
        self, omega: ArrayLike, theta: ArrayLike, *, omega_p: float, wind_speed: float
    ) -> Floats:
        """Return D [rad-1]."""
        theta = finite_array("theta", theta)
        inside = np.abs(theta) <= self.half_range
        cosine = np.where(inside, 2.0 / math.pi * np.cos(theta) ** 2, 0.0)
        # the same at every frequency, in the shape of both arguments
        return cosine * np.ones_like(finite_array("omega", omega))


class Cos2sSpreading(Spreading, frozen=True):
    """Cosine-2s spreading of Longuet-Higgins with one exponent for all frequencies.

    D = 2^(2s-1) Gamma(s+1)^2 / (pi Gamma(2s+1)) cos^2s(theta / 2)

    Parameters
    ----------
    s : float
        Exponent; 10 is a typical wind sea, larger is narrower.

    References
    ----------
    Longuet-Higgins, Cartwright and Smith (1963), in Ocean Wave Spectra, Prentice-Hall.
    """

    kind: Literal["cos2s"] = "cos2s"
    s: Positive = 10.0

    def density(
        self, omega: ArrayLike, theta: ArrayLike, *, omega_p: float, wind_speed: float
    ) -> Floats:
        """Return D [rad-1]."""
        return _cos_2s(theta, self.s) * np.ones_like(finite_array("omega", omega))


class MitsuyasuSpreading(Spreading, frozen=True):
    """Cosine-2s spreading with the exponent of Mitsuyasu et al., narrowest at the peak.

    s = s_p (omega / omega_p)^5 below the peak, s_p (omega / omega_p)^-2.5 above,
    s_p = 11.5 (omega_p U / g)^-2.5

    References
    ----------
    Mitsuyasu et al. (1975), doi:10.1175/1520-0485(1975)005<0750:OOTDSO>2.0.CO;2.
    """

    kind: Literal["mitsuyasu"] = "mitsuyasu"

    def density(
        self, omega: ArrayLike, theta: ArrayLike, *, omega_p: float, wind_speed: float
    ) -> Floats:
        """Return D [rad-1]."""
        return _cos_2s(theta, self.exponent(omega, omega_p, wind_speed))

    @staticmethod
    def exponent(omega: ArrayLike, omega_p: Positive, wind_speed: WindSpeed) -> Floats:
        """Return s, shape of `omega`; arguments as for `density`."""
        ratio = finite_array("omega", omega, 0.0) / omega_p
        s_p = 11.5 * (omega_p * wind_speed / GRAVITY) ** -2.5
        return s_p * np.minimum(ratio, 1.0) ** 5.0 * np.maximum(ratio, 1.0) ** -2.5


class ElfouhailySpreading(Spreading, frozen=True):
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
    ) -> Floats:
        """Return D [rad-1]."""
        theta = finite_array("theta", theta)
        delta = elfouhaily_delta(wavenumber(omega, capillary=True), wind_speed, omega_p)
        folded = (1.0 + delta * np.cos(2.0 * theta)) / math.pi
        return np.where(np.abs(theta) <= self.half_range, folded, 0.0)


def _cos_2s(theta: ArrayLike, s: ArrayLike) -> Floats:
    """Return the cosine-2s density for exponents s >= 0 that broadcast with `theta`."""
    s = np.asarray(s, dtype=np.float64)
    # in logarithms, since Gamma(2 s + 1) of narrow spreadings overflows
    log_scale = (2.0 * s - 1.0) * math.log(2.0) + 2.0 * _log_gamma(s + 1.0)
    scale = np.exp(log_scale - _log_gamma(2.0 * s + 1.0)) / math.pi
    return scale * np.abs(np.cos(0.5 * finite_array("theta", theta))) ** (2.0 * s)
