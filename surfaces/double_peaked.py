"""Spectra of a wind sea and a swell together."""

from __future__ import annotations

import math
from functools import cached_property, lru_cache
from typing import Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import model_validator

from meshtrace.errors import Refused

from .dispersion import GRAVITY
from .parameters import Floats, Positive
from .spectra import Spectrum, integral_over_peak, peak_enhancement

LONGEST_SWELL = 25.0
"""Period T_u beyond which the shares of a swell change no more [s]."""


class OchiHubble(Spectrum, frozen=True):
    """Six-parameter spectrum of Ochi and Hubble: two peaks of free height, period and width.

    S = 1/4 sum_j ((4 l_j + 1) w_j^4 / 4)^l_j / Gamma(l_j)
    hs_j^2 omega^-(4 l_j + 1) exp(-(4 l_j + 1) / 4 (w_j / omega)^4),  w_j = 2 pi / tp_j

    Parameters
    ----------
    hs : (float, float)
        Significant wave heights of the two parts [m]; that of the sea is the root of the sum of
        their squares.
    tp : (float, float)
        Peak periods of the two parts [s].
    lam : (float, float)
        Shape parameters lambda; larger is narrower, and 1 has the tail omega^-5.
    wind_speed : float
        Wind speed at 10 m [m s-1], for the slopes of the short waves only.

    Notes
    -----
    The variance is sum hs_j^2 / 16 exactly.

    References
    ----------
    Ochi and Hubble (1976), Proc. 15th Coastal Engineering Conf., 301-328.

    Examples
    --------
    >>> spectrum = OchiHubble(hs=(2.0, 1.0), tp=(12.0, 5.0), lam=(3.0, 1.5))
    >>> spectrum([0.5, 1.0]).round(4)
    array([1.1984, 0.0384])
    """

    kind: Literal["ochi-hubble"] = "ochi-hubble"
    hs: tuple[Positive, Positive]
    tp: tuple[Positive, Positive]
    lam: tuple[Positive, Positive] = (3.0, 1.0)

    @property
    def omega_p(self) -> float:
        """Frequency of the higher peak [rad s-1]."""
        peaks = 2.0 * math.pi / np.array(self.tp)
        return float(peaks[np.argmax(sum(self._parts(peaks)))])

    def __call__(self, omega: ArrayLike) -> Floats:
        """Return S(omega) [m2 s rad-1]."""
        first, second = self._parts(self._raised(omega))
        return first + second

    def _parts(self, omega: Floats) -> list[Floats]:
        from scipy.special import gammaln

        parts = []
        for hs, tp, lam in zip(self.hs, self.tp, self.lam, strict=True):
            ratio = (4.0 * lam + 1.0) / 4.0 * (2.0 * math.pi / (tp * omega)) ** 4
            log = lam * np.log(ratio) - gammaln(lam) - ratio
            parts.append(0.25 * hs**2 * np.exp(log) / omega)
        return parts


class _Peak(NamedTuple):
    hs: float
    tp: float
    gamma: float


class Torsethaugen(Spectrum, frozen=True):
    """Simplified two-peak spectrum of Torsethaugen for wind sea with swell.

    S = sum_j hs_j^2 / 16 (tp_j / 2 pi) F(f_j) / int F,  f_j = omega tp_j / (2 pi),
    F(f) = f^-4 exp(-f^-4) gamma_j^exp(-(f - 1)^2 / (2 sigma^2))

    Parameters
    ----------
    hs : float
        Significant wave height [m].
    tp : float
        Period of the highest peak [s]. Up to T_f = 6.6 hs^(1/3) it belongs to the wind sea,
        beyond to the swell.
    wind_speed : float
        Wind speed at 10 m [m s-1], for the slopes of the short waves only.

    Raises
    ------
    Refused
        If a parameter is out of range, or hs >= 50 m.

    Notes
    -----
    Wind sea (tp <= T_f): hs_1 = r hs, r = 0.7 + 0.3 exp(-4 e^2),
    e = (T_f - tp) / (T_f - 2 sqrt(hs)), gamma = 35 (2 pi hs_1 / (g tp^2))^0.857, and a swell of
    period T_f + 2 s with the rest of the variance.
    Swell (tp > T_f): r = 0.6 + 0.4 exp(-(e / 0.3)^2), e = (tp - T_f) / (25 s - T_f),
    gamma = 35 (2 pi hs / (g T_f^2))^0.857 (1 + 6 e), and a wind sea of period 6.6 hs_2^(1/3).
    e is held within [0, 1] and gamma at 1 or above. The second peak has gamma = 1. Each peak is
    normalised by quadrature instead of the fitted factors, so that `hs` holds exactly. The tail
    omega^-4 is that of the source: its slopes grow with the band.

    References
    ----------
    Torsethaugen and Haver (2004), Proc. 14th ISOPE Conf.; DNV-RP-C205, section 3.5.6.

    Examples
    --------
    >>> Torsethaugen(hs=4.0, tp=9.0)([0.5, 0.7, 1.5]).round(3)
    array([0.567, 2.435, 0.17 ])
    """

    kind: Literal["torsethaugen"] = "torsethaugen"
    hs: Positive
    tp: Positive

    @model_validator(mode="after")
    def _check_height(self) -> Self:
        if not 0.0 < self.hs < 50.0:
            raise Refused("hs", self.hs, "0 < hs < 50 m")
        return self

    @property
    def omega_p(self) -> float:
        """Frequency of the higher peak [rad s-1]."""
        return 2.0 * math.pi / self.tp

    def __call__(self, omega: ArrayLike) -> Floats:
        """Return S(omega) [m2 s rad-1]."""
        omega = self._raised(omega)
        return sum((_peak_density(peak, omega) for peak in self.peaks), np.zeros_like(omega))

    @cached_property
    def peaks(self) -> tuple[_Peak, _Peak]:
        """Height [m], period [s] and enhancement of the higher peak and of the other one."""
        hs, tp = self.hs, self.tp
        separation = 6.6 * hs ** (1.0 / 3.0)
        if tp <= separation:
            e = _unit((separation - tp) / (separation - 2.0 * math.sqrt(hs)))
            share = 0.7 + 0.3 * math.exp(-4.0 * e * e)
            gamma = 35.0 * (2.0 * math.pi * share * hs / (GRAVITY * tp**2)) ** 0.857
            second = separation + 2.0
        else:
            e = _unit((tp - separation) / (LONGEST_SWELL - separation))
            share = 0.6 + 0.4 * math.exp(-((e / 0.3) ** 2))
            gamma = 35.0 * (2.0 * math.pi * hs / (GRAVITY * separation**2)) ** 0.857
            gamma *= 1.0 + 6.0 * e
            second = 6.6 * (math.sqrt(1.0 - share**2) * hs) ** (1.0 / 3.0)
        rest = math.sqrt(max(0.0, 1.0 - share**2)) * hs
        # a vanished part keeps a period, so that its density is zero and not undefined
        return _Peak(share * hs, tp, max(1.0, gamma)), _Peak(rest, max(second, 1e-3), 1.0)


def _unit(value: float) -> float:
    return min(1.0, max(0.0, value))


def _shape(f: Floats, gamma: float) -> Floats:
    return f**-4.0 * np.exp(-(f**-4.0)) * peak_enhancement(f, gamma)


@lru_cache
def _integral(gamma: float) -> float:
    return integral_over_peak(lambda f: _shape(f, gamma))


def _peak_density(peak: _Peak, omega: Floats) -> Floats:
    # below a tenth of the peak the density has underflowed, and f^-4 would overflow
    f = np.maximum(omega * peak.tp / (2.0 * math.pi), 0.1)
    scale = peak.hs**2 / 16.0 * peak.tp / (2.0 * math.pi * _integral(peak.gamma))
    return scale * _shape(f, peak.gamma)
