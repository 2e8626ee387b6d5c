"""Spectra S(omega) of the sea surface elevation [m2 s rad-1].

A spectrum is a model of its parameters that is called with frequencies. Every sea uses
`spectrum(omega)`, `spectrum.omega_p` and `spectrum.wind_speed` only, so that a subclass of
`Spectrum` with these joins the built-in ones.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from functools import cached_property, lru_cache
from typing import Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import model_validator

from meshtrace.checks import check_call
from meshtrace.errors import Refused
from meshtrace.models import Family, NonNegative

from .parameters import Alpha, Depth, Fetch, Floats, Gamma, Positive, WindSpeed, finite_array
from .waves import (
    CAPILLARY_WAVENUMBER,
    GRAVITY,
    angular_frequency,
    group_speed,
    phase_speed,
    wavenumber,
)

ALPHA_COEFFICIENT = 0.075
"""Fetch law alpha = 0.075 X^-0.22 of the paper; Hasselmann et al. (1973) print 0.076."""

# Fraction of the peak frequency. At it exp(-5/4 (omega_p / omega)^4) is zero (exp(-1.25e8)),
# and lower frequencies are replaced by it: S(0) = 0 then needs no special case.
_LOWEST = 0.01
# Least wind speed of Elfouhaily's spectrum [m s-1]: without fetch limit the waves at its peak,
# k_p = g (0.84 / U)^2, are 0.1 mm long, shorter than any that sea water has.
_LEAST_WIND = 0.01


class Spectrum(Family, ABC, frozen=True):
    """Base of the frequency spectra: a subclass defines the peak and the call.

    Parameters
    ----------
    wind_speed : float
        Wind speed at 10 m [m s-1], 0 < U <= 60.

    Notes
    -----
    A subclass declares its parameters as annotated class attributes; see the guide
    "A spectrum of your own".
    """

    wind_speed: WindSpeed = 5.0

    @property
    @abstractmethod
    def omega_p(self) -> float:
        """Peak angular frequency [rad s-1]."""

    @abstractmethod
    def __call__(self, omega: ArrayLike) -> Floats:
        """Return S(omega) [m2 s rad-1] at angular frequencies >= 0 [rad s-1].

        Raises
        ------
        Refused
            If a frequency is negative or not finite.
        """

    @property
    def lowest_peak(self) -> float:
        """Frequency below which there is no peak [rad s-1]: `omega_p` unless there are several."""
        return self.omega_p

    def _raised(self, omega: ArrayLike) -> Floats:
        """Return checked frequencies [rad s-1], raised to `_LOWEST` of the peak, where S is 0."""
        return np.maximum(finite_array("omega", omega, 0.0), _LOWEST * self.lowest_peak)


class Jonswap(Spectrum, frozen=True):
    """JONSWAP spectrum of a fetch-limited sea.

    S = alpha g^2 omega^-5 exp(-5/4 (omega_p / omega)^4) gamma^r,
    r = exp(-(omega / omega_p - 1)^2 / (2 sigma^2)),
    omega_p = 22 (g / U) X^-0.33,  X = g F / U^2

    Parameters
    ----------
    wind_speed : float
        Wind speed at 10 m [m s-1].
    fetch : float
        Fetch F, the distance from the shore up-wind [m].
    gamma : float
        Peak enhancement, 1 to 20.
    alpha : float, optional
        Energy scale, by default alpha_coefficient X^-0.22.
    hs : float, optional
        Significant wave height [m], which replaces alpha: 16 int S d(omega) = hs^2.
    tp : float, optional
        Peak period [s], which replaces that of the fetch law: omega_p = 2 pi / tp.
    alpha_coefficient : float
        0.075 as in the paper; 0.076 in Hasselmann et al. (1973).
    sigma_a, sigma_b : float
        Peak widths below and above omega_p.

    Notes
    -----
    Fitted for U up to some 20 m/s. The tail omega^-5 makes the mean square slope grow without
    bound, as the logarithm of the highest frequency, so every slope statistic needs a band.

    References
    ----------
    Hasselmann et al. (1973), Dtsch. Hydrogr. Z. A8(12).

    Examples
    --------
    >>> spectrum = Jonswap(wind_speed=13.0)
    >>> round(spectrum.omega_p, 4), round(float(spectrum(1.5)), 3)
    (1.4147, 0.178)
    >>> Jonswap(wind_speed=5.0)([1.0, 1.9577, 4.0]).round(5)
    array([0.     , 0.03018, 0.00083])
    """

    fetch: Fetch = 30e3
    gamma: Gamma = 3.3
    alpha: Alpha | None = None
    alpha_coefficient: Alpha = ALPHA_COEFFICIENT
    sigma_a: Positive = 0.07
    sigma_b: Positive = 0.09
    hs: Positive | None = None
    tp: Positive | None = None
    kind: Literal["jonswap"] = "jonswap"

    @model_validator(mode="after")
    def _check_scale(self) -> Self:
        if None not in (self.hs, self.alpha):
            raise Refused("alpha", self.alpha, "either alpha or hs")
        return self

    @property
    def omega_p(self) -> float:
        """Peak angular frequency of the deep-water spectrum [rad s-1]."""
        if self.tp is not None:
            return 2.0 * math.pi / self.tp
        X = _dimensionless_fetch(self.wind_speed, self.fetch)
        return 22.0 * (GRAVITY / self.wind_speed) * X**-0.33

    @cached_property
    def energy_scale(self) -> float:
        """Factor alpha: as set, or by the wave height, or by the fetch law."""
        if self.alpha is not None:
            return self.alpha
        if self.hs is None:
            X = _dimensionless_fetch(self.wind_speed, self.fetch)
            return self.alpha_coefficient * X**-0.22
        # int S d(omega) = alpha g^2 omega_p^-4 total in deep water, with x = omega / omega_p
        total = _peak_integral(5.0, self.gamma, self.sigma_a, self.sigma_b)
        return self.hs**2 * self.omega_p**4 / (16.0 * GRAVITY**2 * total)

    def __call__(self, omega: ArrayLike) -> Floats:
        """Return S(omega) [m2 s rad-1]."""
        omega_p, omega = self.omega_p, self._raised(omega)
        enhanced = peak_enhancement(omega / omega_p, self.gamma, self.sigma_a, self.sigma_b)
        return _phillips_tail(omega, omega_p, self.energy_scale) * enhanced


class Tma(Jonswap, frozen=True):
    """TMA spectrum: JONSWAP in water of finite depth.

    S = S_jonswap(omega) phi(omega, depth), with phi of `kitaigorodskii`

    Parameters
    ----------
    depth : float
        Water depth [m].
    wind_speed, fetch, gamma, alpha, alpha_coefficient, sigma_a, sigma_b : float
        See `Jonswap`.

    Notes
    -----
    The factor is in closed form rather than its usual fit by parabolas.

    References
    ----------
    Bouws, Guenther, Rosenthal and Vincent (1985), doi:10.1029/JC090iC01p00975.
    """

    kind: Literal["tma"] = "tma"  # type: ignore[assignment]
    depth: Depth

    def __call__(self, omega: ArrayLike) -> Floats:
        """Return S(omega) [m2 s rad-1]."""
        return super().__call__(omega) * kitaigorodskii(omega, self.depth)


class PiersonMoskowitz(Spectrum, frozen=True):
    """Pierson-Moskowitz spectrum of a fully developed sea.

    S = 0.0081 g^2 omega^-5 exp(-0.74 (g / (U_19.5 omega))^4),  omega_p = 0.877 g / U_19.5

    Parameters
    ----------
    wind_speed : float
        Wind speed at 10 m [m s-1].

    Notes
    -----
    The wind at 19.5 m, where the spectrum was fitted, is taken as 1.026 times the wind at 10 m
    (Stewart 2008, Introduction to Physical Oceanography, eq. 16.29, which names neutral air and a
    drag coefficient of 1.3e-3; the logarithmic profile of these would give 1.06). Then
    Hs = 0.2092 U_19.5^2 / g.

    References
    ----------
    Pierson and Moskowitz (1964), doi:10.1029/JZ069i024p05181.

    Examples
    --------
    >>> spectrum = PiersonMoskowitz(wind_speed=10.0)
    >>> round(spectrum.omega_p, 4), spectrum([0.5, 0.84, 2.0]).round(4)
    (0.8387, array([0.0013, 0.5382, 0.0234]))
    """

    kind: Literal["pierson-moskowitz"] = "pierson-moskowitz"

    @property
    def omega_p(self) -> float:
        """Peak angular frequency [rad s-1]."""
        # 5/4 omega_p^4 = 0.74 (g / U_19.5)^4, by the exponents of both forms
        return (4.0 * 0.74 / 5.0) ** 0.25 * GRAVITY / (1.026 * self.wind_speed)

    def __call__(self, omega: ArrayLike) -> Floats:
        """Return S(omega) [m2 s rad-1]."""
        return _phillips_tail(self._raised(omega), self.omega_p, 0.0081)


class Elfouhaily(Spectrum, frozen=True):
    """Unified spectrum of long and short waves of Elfouhaily et al.

    S(omega) = S(k) / c_g(k), omega^2 = g k + T k^3, with S(k) of `over_wavenumber`

    Parameters
    ----------
    wind_speed : float
        Wind speed at 10 m [m s-1].
    fetch : float, optional
        Fetch [m]; None is the fully developed sea.

    References
    ----------
    Elfouhaily, Chapron, Katsaros and Vandemark (1997), doi:10.1029/97JC00467.

    Examples
    --------
    >>> Elfouhaily(wind_speed=10.0)([0.5, 0.82, 2.0]).round(4)
    array([0.0018, 0.7221, 0.0303])
    """

    kind: Literal["elfouhaily"] = "elfouhaily"
    fetch: Fetch | None = None

    @model_validator(mode="after")
    def _check_wind(self) -> Self:
        if self.wind_speed < _LEAST_WIND:
            raise Refused("wind_speed", self.wind_speed, f">= {_LEAST_WIND:g} m/s, which has waves")
        return self

    @property
    def inverse_wave_age(self) -> float:
        """Inverse wave age U / c_p, 0.84 (fully developed) to 5 (very young).

        Omega_c = 0.84 tanh((X / 2.2e4)^0.4)^-0.75, X = g F / U^2

        Raises
        ------
        Refused
            If the fetch is so short that it exceeds 5.
        """
        if self.fetch is None:
            return 0.84
        X = _dimensionless_fetch(self.wind_speed, self.fetch)
        inverse_age = 0.84 * math.tanh((X / 2.2e4) ** 0.4) ** -0.75
        if inverse_age > 5.0:
            allowed = f"a fetch with inverse wave age <= 5, not {inverse_age:g}"
            raise Refused("fetch", self.fetch, allowed)
        return inverse_age

    @property
    def k_p(self) -> float:
        """Wavenumber of the peak, g Omega_c^2 / U^2 [rad m-1]."""
        return GRAVITY * (self.inverse_wave_age / self.wind_speed) ** 2

    @property
    def omega_p(self) -> float:
        """Nominal peak angular frequency, at the wavenumber k_p [rad s-1]."""
        return float(angular_frequency(self.k_p, capillary=True))

    def __call__(self, omega: ArrayLike) -> Floats:
        """Return S(omega) [m2 s rad-1]."""
        k = wavenumber(self._raised(omega), capillary=True)
        return self.over_wavenumber(k) / group_speed(k, capillary=True)

    def over_wavenumber(self, k: ArrayLike) -> Floats:
        """Return the omnidirectional elevation spectrum S(k) [m3 rad-1].

        S(k) = k^-3 (B_l + B_h),
        B_l = 0.003 sqrt(Omega) (c_p / c) L J exp(-(Omega / sqrt(10)) (sqrt(k / k_p) - 1)),
        B_h = (alpha_m / 2) (c_m / c) L J exp(-(k / k_m - 1)^2 / 4)

        with L = exp(-5/4 (k_p / k)^2), J = gamma^exp(-(sqrt(k / k_p) - 1)^2 / (2 sigma^2)),
        sigma = 0.08 (1 + 4 Omega^-3), gamma = 1.7 + 6 max(0, log10(Omega)), and Omega of
        `inverse_wave_age`; c is the phase speed, with c_p at k_p and c_m at k_m, the slowest.

        Parameters
        ----------
        k : array_like
            Wavenumber [rad m-1], k >= 0.

        Returns
        -------
        ndarray
            S(k), shape of `k`; the integral over k is the elevation variance [m2].

        Notes
        -----
        Friction velocity u* = U sqrt(1e-3 (0.8 + 0.065 U)) (Wu 1982). L J in B_h, absent in
        print, is the usual correction: without it B_h does not vanish for long waves.
        alpha_m = 0.01 (1 + ln(u*/c_m)), or 0.01 (1 + 3 ln(u*/c_m)) above c_m, turns negative
        below 2.7 m/s; it is held at zero there.
        """
        inverse_age, k_p = self.inverse_wave_age, self.k_p
        # k / k_p = (omega / omega_p)^2 of long waves, hence the square
        k = np.maximum(finite_array("k", k, 0.0), _LOWEST**2 * k_p)
        c = phase_speed(k, capillary=True)
        c_p, c_m = phase_speed([k_p, CAPILLARY_WAVENUMBER], capillary=True)
        sigma = 0.08 * (1.0 + 4.0 / inverse_age**3)
        gamma = 1.7 + 6.0 * math.log10(max(inverse_age, 1.0))
        root = np.sqrt(k / k_p) - 1.0
        peak = np.exp(-1.25 * (k_p / k) ** 2) * gamma ** np.exp(-(root**2) / (2.0 * sigma**2))
        friction = _friction_velocity(self.wind_speed) / c_m  # u* / c_m
        alpha_m = max(0.0, 0.01 * (1.0 + (1.0 if friction <= 1.0 else 3.0) * math.log(friction)))
        decay = np.exp(-inverse_age / math.sqrt(10.0) * root)
        B_l = 0.003 * math.sqrt(inverse_age) * (c_p / c) * decay
        B_h = 0.5 * alpha_m * (c_m / c) * np.exp(-0.25 * (k / CAPILLARY_WAVENUMBER - 1.0) ** 2)
        return peak * (B_l + B_h) / k**3


@check_call
def peak_enhancement(
    x: Floats, gamma: NonNegative, sigma_a: Positive = 0.07, sigma_b: Positive = 0.09
) -> Floats:
    """Return the factor gamma^exp(-(x - 1)^2 / (2 sigma^2)) at x = omega / omega_p."""
    sigma = np.where(x <= 1.0, sigma_a, sigma_b)
    return gamma ** np.exp(-((x - 1.0) ** 2) / (2.0 * sigma**2))


def _peak_shape(
    x: Floats, tail: float, gamma: float, sigma_a: float = 0.07, sigma_b: float = 0.09
) -> Floats:
    """Return x^-n exp(-n / 4 x^-4) times the enhancement, n = `tail`, at x = omega / omega_p."""
    enhanced = peak_enhancement(x, gamma, sigma_a, sigma_b)
    return x**-tail * np.exp(-0.25 * tail * x**-4.0) * enhanced


@lru_cache
def _peak_integral(tail: float, *enhancement: float) -> float:
    """Integrate `_peak_shape` over x > 0.1 (zero below), split at its kink x = 1."""
    from scipy.integrate import quad

    return sum(
        quad(lambda x: float(_peak_shape(np.array(x), tail, *enhancement)), *limits,
             epsabs=0.0, epsrel=1e-12)[0]
        for limits in ((0.1, 1.0), (1.0, 2.0), (2.0, math.inf))
    )  # fmt: skip


@check_call
def kitaigorodskii(omega: ArrayLike, depth: Depth) -> Floats:
    """Return the fraction of a deep-water spectrum that remains in finite depth.

    phi = tanh^2(k d) / (1 + 2 k d / sinh(2 k d)), omega^2 = g k tanh(k d)

    Parameters
    ----------
    omega : array_like
        Angular frequency [rad s-1], omega >= 0.
    depth : float
        Water depth d [m].

    Returns
    -------
    ndarray
        Factor from 0 (long waves) to 1 (short waves), shape of `omega`.

    Raises
    ------
    Refused
        If a parameter is out of range.

    References
    ----------
    Kitaigorodskii, Krasitskii and Zaslavskii (1975),
    doi:10.1175/1520-0485(1975)005<0410:OPTOER>2.0.CO;2.

    Examples
    --------
    >>> kitaigorodskii([0.1, 1.0, 10.0], depth=10.0).round(4)
    array([0.0051, 0.4913, 1.    ])
    """
    kd = wavenumber(omega, depth) * depth
    # x = kd: avoid 0 / 0 at 0, where 2 x / sinh(2 x) is 1, and the overflow of sinh(2 x) beyond
    # x = 355; from x = 22 on the quotient is lost in the rounding of 1
    kd = np.clip(kd, 1e-12, 300.0)
    return np.tanh(kd) ** 2 / (1.0 + 2.0 * kd / np.sinh(2.0 * kd))


@check_call
def elfouhaily_delta(k: ArrayLike, wind_speed: WindSpeed, omega_p: Positive) -> Floats:
    """Return the up-wind over cross-wind contrast Delta(k) of the Elfouhaily spreading.

    Delta = tanh(ln(2) / 4 + 4 (c / c_p)^2.5 + 0.13 (u* / c_m) (c_m / c)^2.5)

    Parameters
    ----------
    k : array_like
        Wavenumber [rad m-1], k > 0.
    wind_speed : float
        Wind speed at 10 m [m s-1].
    omega_p : float
        Peak frequency [rad s-1], which sets c_p.

    Returns
    -------
    ndarray
        Delta in (0, 1), shape of `k`; D(theta) is proportional to 1 + Delta cos(2 theta).

    Raises
    ------
    Refused
        If a parameter is out of range.

    References
    ----------
    Elfouhaily, Chapron, Katsaros and Vandemark (1997), doi:10.1029/97JC00467.
    """
    k_p = wavenumber(omega_p, capillary=True)
    c = phase_speed(k, capillary=True)
    c_p, c_m = phase_speed([float(k_p), CAPILLARY_WAVENUMBER], capillary=True)
    a_m = 0.13 * _friction_velocity(wind_speed) / c_m  # factor of the short waves
    return np.tanh(math.log(2.0) / 4.0 + 4.0 * (c / c_p) ** 2.5 + a_m * (c_m / c) ** 2.5)


def _dimensionless_fetch(wind_speed: float, fetch: float) -> float:
    """Return X = g F / U^2."""
    return GRAVITY * fetch / wind_speed**2


def _phillips_tail(omega: Floats, omega_p: float, alpha: float) -> Floats:
    """Return alpha g^2 omega^-5 exp(-5/4 (omega_p / omega)^4) [m2 s rad-1]."""
    return alpha * GRAVITY**2 * omega**-5.0 * np.exp(-1.25 * (omega_p / omega) ** 4)


def _friction_velocity(wind_speed: float) -> float:
    """Return u* = U sqrt(1e-3 (0.8 + 0.065 U)) [m s-1] (Wu 1982)."""
    return wind_speed * math.sqrt(1e-3 * (0.8 + 0.065 * wind_speed))


LONGEST_SWELL = 25.0
"""Period T_u of `Torsethaugen` [s]: for swell of longer periods hs_1 / hs stays at its limit."""


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
        """Peak frequency of the part at whose peak the whole spectrum is higher [rad s-1]."""
        # of the sum, since the parts overlap
        peaks = 2.0 * math.pi / np.array(self.tp)
        return float(peaks[np.argmax(sum(self._parts(peaks)))])

    def __call__(self, omega: ArrayLike) -> Floats:
        """Return S(omega) [m2 s rad-1]."""
        first, second = self._parts(self._raised(omega))
        return first + second

    @property
    def lowest_peak(self) -> float:
        """Frequency 2 pi / tp of the longer period [rad s-1]."""
        return 2.0 * math.pi / max(self.tp)

    def _parts(self, omega: Floats) -> list[Floats]:
        """Return the two terms of S(omega) [m2 s rad-1]."""
        from scipy.special import gammaln

        parts = []
        for hs, tp, lam in zip(self.hs, self.tp, self.lam, strict=True):
            ratio = (4.0 * lam + 1.0) / 4.0 * (2.0 * math.pi / (tp * omega)) ** 4
            # in logarithms, since powers of low frequencies overflow
            exponent = lam * np.log(ratio) - gammaln(lam) - ratio
            parts.append(0.25 * hs**2 * np.exp(exponent) / omega)
        return parts


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
        # T_f = 6.6 hs^(1/3) has to stay below T_u = 25 s (hs < 54 m), for e of the swell
        if not self.hs < 50.0:
            raise Refused("hs", self.hs, "0 < hs < 50 m")
        return self

    @property
    def omega_p(self) -> float:
        """Frequency of the highest peak, 2 pi / tp [rad s-1]."""
        return 2.0 * math.pi / self.tp

    def __call__(self, omega: ArrayLike) -> Floats:
        """Return S(omega) [m2 s rad-1]."""
        omega = self._raised(omega)
        density = np.zeros_like(omega)
        for hs, tp, gamma in self.peaks:
            # below a tenth of the peak the density has underflowed, and f^-4 would overflow
            f = np.maximum(omega * tp / (2.0 * math.pi), 0.1)
            scale = hs**2 / 16.0 * tp / (2.0 * math.pi * _peak_integral(4.0, gamma))
            density = density + scale * _peak_shape(f, 4.0, gamma)
        return density

    @property
    def lowest_peak(self) -> float:
        """Frequency of the peak of the longer period [rad s-1]."""
        return 2.0 * math.pi / max(tp for _, tp, _ in self.peaks)

    @cached_property
    def peaks(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Height [m], period [s] and enhancement of the peak at `tp` and of the other one."""
        hs, tp = self.hs, self.tp
        # T_f, e and r of the notes are `separation`, `e` and `share`, the latter of the height
        separation = 6.6 * hs ** (1.0 / 3.0)
        if tp <= separation:
            e = (separation - tp) / (separation - 2.0 * math.sqrt(hs))
            e = min(1.0, max(0.0, e))
            share = 0.7 + 0.3 * math.exp(-4.0 * e * e)
            gamma = 35.0 * (2.0 * math.pi * share * hs / (GRAVITY * tp**2)) ** 0.857
            second = separation + 2.0
        else:
            e = min(1.0, max(0.0, (tp - separation) / (LONGEST_SWELL - separation)))
            share = 0.6 + 0.4 * math.exp(-((e / 0.3) ** 2))
            gamma = 35.0 * (2.0 * math.pi * hs / (GRAVITY * separation**2)) ** 0.857
            gamma *= 1.0 + 6.0 * e
            second = 6.6 * (math.sqrt(1.0 - share**2) * hs) ** (1.0 / 3.0)
        # heights add in squares
        rest = math.sqrt(max(0.0, 1.0 - share**2)) * hs
        # a vanished part keeps a period, so that its density is zero and not undefined
        return (share * hs, tp, max(1.0, gamma)), (rest, max(second, 1e-3), 1.0)
