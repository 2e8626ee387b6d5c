"""Hovering UAV: wind and gusts, the tilt of its receiver over time and as a law, its route.

The airframe leans into the wind until thrust balances drag. `Uav.tilt` maps winds to tilts,
`Uav.simulate_flight` gives records in time for a joint run with the sea, and `Uav.tilt_law` the
law of the tilt angle, exact or as the paper's Gamma approximation.
"""

from __future__ import annotations

import abc
import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
import pydantic
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from meshtrace.checks import Seed, check_call, check_methods
from meshtrace.errors import (
    Described,
    Refused,
    require_array,
    require_between,
    require_finite,
    require_kind,
)
from meshtrace.models import Finite, Floats, Model, Position, Positive
from meshtrace.quadrature import gauss_legendre

__all__ = ["UAVS", "Dryden", "Flight", "FlightRecord", "Route", "Uav"]


def __dir__() -> list[str]:
    return __all__


FOOT = 0.3048  # [m]
HEIGHT_20FT = 20.0 * FOOT

WindPreset = Literal["physical", "paper"]


class LogProfile(Model, frozen=True):
    """Neutral logarithmic wind profile over a surface of given roughness.

    U(z) = U10 ln(z / z0) / ln(10 / z0)

    Parameters
    ----------
    roughness_length : float
        z0 [m]; 2e-4 m is open sea.
    """

    kind: Literal["log"] = "log"
    roughness_length: float = pydantic.Field(default=2e-4, gt=0.0, lt=1.0, allow_inf_nan=False)

    def ratio(self, height: Positive) -> float:
        """Return the wind at `height` [m] over the wind at 10 m."""
        return math.log(height / self.roughness_length) / math.log(10.0 / self.roughness_length)


class PowerProfile(Model, frozen=True):
    """Power-law wind profile, U(z) = U10 (z / 10)^p.

    Parameters
    ----------
    exponent : float
        p [1]; 0.11 over the sea, 1/7 over flat land.
    """

    kind: Literal["power"] = "power"
    exponent: float = pydantic.Field(default=0.11, ge=0.0, le=1.0, allow_inf_nan=False)

    def ratio(self, height: Positive) -> float:
        """Return the wind at `height` [m] over the wind at 10 m."""
        return (height / 10.0) ** self.exponent


WindProfile = Annotated[LogProfile | PowerProfile, pydantic.Field(discriminator="kind")]


class Dryden(Model, frozen=True):
    """Mean wind with Dryden gusts at low altitude after MIL-F-8785C.

    sigma_w = 0.1 W20,  sigma_u = sigma_v = sigma_w (0.177 + 0.000823 h)^-0.4,
    L_w = h,  L_u = L_v = h (0.177 + 0.000823 h)^-1.2,  with h in feet

    Parameters
    ----------
    wind_speed : float
        Wind at 10 m, U10 [m s-1]; 0 is a calm without gusts.
    height : float
        Flight height above still water [m].
    profile : LogProfile or PowerProfile
        Law that converts the wind from 10 m to 20 feet and to the flight height.
    w20 : float, optional
        Wind at 20 feet [m s-1]; None takes it from `wind_speed` and `profile`.
    wind_at_height : bool
        Mean wind taken at the flight height rather than at 10 m.
    altitude_unit : {"foot", "metre"}
        Unit in which `height` enters the bracket (0.177 + 0.000823 h).
    gust_variance : {"sigma^2", "sigma^2/pi"}
        Variance of each gust component.

    Notes
    -----
    The military specification gives its low-altitude form for 10 to 1000 feet (3 to 305 m); below
    3 m the same formulas are used, above 305 m they are refused.

    Two departures from the paper's Appendices B and C (`Dryden.preset("paper")` gives its form):
    it puts metres where the specification has feet, which raises sigma_u by 2 %, and it drives
    filters that carry the 1/sqrt(pi) of a one-sided spectrum per rad/m with noise of unit two-sided
    spectrum per hertz, which lowers every standard deviation by sqrt(pi) = 1.77. By the
    specification's definition sigma^2 is the variance.

    References
    ----------
    MIL-F-8785C (1980), Flying qualities of piloted airplanes, section 3.7.

    Examples
    --------
    >>> wind = Dryden(wind_speed=13.0, height=5.0)
    >>> [round(float(s), 4) for s in wind.std]
    [2.408, 2.408, 1.2405]
    """

    wind_speed: float = pydantic.Field(default=5.0, ge=0.0, le=60.0, allow_inf_nan=False)
    height: float = pydantic.Field(default=5.0, gt=0.0, le=1000.0 * FOOT, allow_inf_nan=False)
    profile: WindProfile = LogProfile()
    w20: float | None = pydantic.Field(default=None, ge=0.0, le=60.0, allow_inf_nan=False)
    wind_at_height: bool = False
    altitude_unit: Literal["foot", "metre"] = "foot"
    gust_variance: Literal["sigma^2", "sigma^2/pi"] = "sigma^2"

    @classmethod
    def preset(cls, physics: WindPreset, **fields: Any) -> Dryden:
        """Return gusts in the right form (`"physical"`) or as published (`"paper"`).

        Parameters
        ----------
        physics : {"physical", "paper"}
            Which form.
        **fields
            Any other field of the class, such as `wind_speed` and `height`.

        Raises
        ------
        Refused
            If `physics` is neither of the two names.
        """
        forms: dict[str, dict[str, Any]] = {
            "physical": {},
            "paper": {"altitude_unit": "metre", "gust_variance": "sigma^2/pi"},
        }
        return cls(**(forms[physics] | fields))

    @property
    def mean_wind(self) -> Floats:
        """Mean wind vector (3,) [m s-1], along x."""
        ratio = self.profile.ratio(self.height) if self.wind_at_height else 1.0
        return np.array([self.wind_speed * ratio, 0.0, 0.0])

    @property
    def sigma(self) -> Floats:
        """Turbulence intensities sigma_u, sigma_v, sigma_w of the specification (3,) [m s-1]."""
        derived = self.wind_speed * self.profile.ratio(HEIGHT_20FT)
        w20 = derived if self.w20 is None else self.w20
        horizontal = 0.1 * w20 * self._bracket**-0.4
        return np.array([horizontal, horizontal, 0.1 * w20])

    @property
    def std(self) -> Floats:
        """Standard deviation of the three gust components (3,) [m s-1]."""
        return self.sigma / (1.0 if self.gust_variance == "sigma^2" else math.sqrt(math.pi))

    @property
    def length_scales(self) -> Floats:
        """Turbulence lengths L_u, L_v, L_w (3,) [m]."""
        horizontal = self.height * self._bracket**-1.2
        return np.array([horizontal, horizontal, self.height])

    @property
    def correlation_times(self) -> Floats:
        """Filter times tau = L / |U| (3,) [s]; infinite in a calm."""
        speed = float(np.linalg.norm(self.mean_wind))
        return self.length_scales / speed if speed > 0.0 else np.full(3, np.inf)

    @property
    def _bracket(self) -> float:
        unit = FOOT if self.altitude_unit == "foot" else 1.0
        return 0.177 + 0.000823 * self.height / unit

    def autocorrelation(self, lag: ArrayLike) -> Floats:
        """Return the autocovariance of the three gust components.

        R_u = s^2 exp(-t/tau),  R_v = R_w = s^2 exp(-t/tau) (1 - t / (2 tau))

        Parameters
        ----------
        lag : array_like
            Time lag t [s], any shape.

        Returns
        -------
        ndarray
            Autocovariance [m2 s-2], shape of `lag` with a last axis of 3 (x, y, z).
        """
        x = np.abs(require_array(lag, "lag", "times [s]"))[..., None] / self.correlation_times
        return self.std**2 * np.exp(-x) * (1.0 - 0.5 * x * np.array([0.0, 1.0, 1.0]))

    def sample_wind(self, size: Annotated[int, Field(ge=1, le=10**8)], seed: Seed) -> Floats:
        """Draw independent winds from the stationary law.

        Parameters
        ----------
        size : int
            Number of winds n.
        seed : int
            Seed of the generator.

        Returns
        -------
        ndarray
            Wind vectors (n, 3) [m s-1].
        """
        noise = np.random.default_rng(seed).standard_normal((size, 3))
        return self.mean_wind + self.std * noise

    def simulate_wind(self, times: ArrayLike, seed: Seed) -> Floats:
        """Simulate a wind record with the Dryden spectra, exact at the sample times.

        H_u = s sqrt(2 tau) / (1 + tau p),
        H_v = H_w = s sqrt(tau) (1 + sqrt(3) tau p) / (1 + tau p)^2

        Parameters
        ----------
        times : array_like
            Sample times (n,) [s], evenly spaced and increasing.
        seed : int
            Seed of the generator.

        Returns
        -------
        ndarray
            Wind vectors (n, 3) [m s-1].

        Raises
        ------
        Refused
            If the times are not evenly spaced and increasing.

        Notes
        -----
        The filters are discretised by their exact transition matrix and noise covariance, and the
        record starts in the stationary state, so variance and autocorrelation hold at the samples
        for any time step. The gains are those for noise of unit two-sided spectrum per hertz.
        """
        t = require_finite(times, "times", "two or more evenly spaced times (n,)")
        steps = np.diff(t)
        if t.size < 2 or not np.allclose(steps, steps[:1], rtol=1e-6, atol=0.0):
            raise Refused("times", times, "two or more evenly spaced times (n,)")
        if not steps[0] > 0.0:
            raise Refused("times", times, "rising times")
        noise = np.random.default_rng(seed).standard_normal((3, 2, t.size))
        q = float(steps.mean()) / self.correlation_times
        x1, x2 = np.transpose([_states(*one) for one in zip(q, noise, strict=True)], (1, 2, 0))
        gusts = math.sqrt(3.0) * x1 + (1.0 - math.sqrt(3.0)) * x2
        gusts[:, 0] = math.sqrt(2.0) * x1[:, 0]
        return self.mean_wind + self.std * gusts


def _states(q: float, noise: Floats) -> Floats:
    """Return the states behind 1/(1 + tau p) and 1/(1 + tau p)^2, sampled every q tau, (2, n).

    x1' = (w - x1)/tau, x2' = (x1 - x2)/tau, in units of tau^-1/2; noise (2, n).
    """
    from scipy.signal import lfilter
    from scipy.special import gammainc

    def drive(q11: float, q12: float, q22: float, z: Floats) -> tuple[Floats, Floats]:
        if q11 == 0.0:
            return 0.0 * z[0], 0.0 * z[1]
        first = math.sqrt(q11)
        return first * z[0], q12 / first * z[0] + math.sqrt(q22 - q12**2 / q11) * z[1]

    # The noise covariance is the integral of (1, s, s^2) exp(-2 s): incomplete gamma functions,
    # free of the cancellation that P - A P A^T suffers for short steps.
    q11, q12, q22 = np.array([0.5, 0.25, 0.25]) * gammainc([1, 2, 3], 2.0 * q)
    drive_1, drive_2 = drive(q11, q12, q22, noise)
    (drive_1[0],), (drive_2[0],) = drive(0.5, 0.25, 0.25, noise[:, :1])
    decay = math.exp(-q)
    x1 = lfilter([1.0], [1.0, -decay], drive_1)
    coupling = q * decay if math.isfinite(q) else 0.0
    drive_2[1:] += coupling * x1[:-1]
    return np.stack([x1, lfilter([1.0], [1.0, -decay], drive_2)])


@check_call
def squared_wind_moments(mean: ArrayLike, std: ArrayLike) -> tuple[float, float]:
    """Return mean and variance of V^2 for independent Gaussian components.

    E = sum(s_j^2 + u_j^2),  Var = sum(2 s_j^4 + 4 s_j^2 u_j^2)

    Parameters
    ----------
    mean, std : array_like
        Mean u and standard deviation s of the components (3,) [m s-1].

    Returns
    -------
    tuple of float
        E[V^2] [m2 s-2] and Var[V^2] [m4 s-4].
    """
    u2, s2 = np.square(np.asarray(mean, float)), np.square(np.asarray(std, float))
    return float(np.sum(s2 + u2)), float(np.sum(2.0 * s2**2 + 4.0 * s2 * u2))


@check_call
def h_alpha(tilt: ArrayLike, fov: float) -> Floats:
    """Return the factor of the tilt on the gain of light that arrives vertically.

    h = cos(alpha) if alpha <= fov / 2, else 0

    Parameters
    ----------
    tilt : array_like
        Tilt angle alpha [rad], any shape.
    fov : float
        Full field of view [rad].

    Returns
    -------
    ndarray
        The factor, same shape.

    Raises
    ------
    Refused
        If `fov` is outside (0, pi].

    Notes
    -----
    The paper's factor cuts at alpha = fov, its test on the photons at fov / 2; the half angle is
    the one that a full field of view means, and is used for both here.
    """
    angle = np.asarray(tilt, dtype=float)
    return np.where(angle <= _half_angle(fov), np.cos(angle), 0.0)


def _half_angle(fov: float) -> float:
    return 0.5 * require_between(fov, 0.0, math.pi, "fov", "(]", "0 < fov <= pi rad (full angle)")


_Square = Annotated[ArrayLike, Field(ge=0.0)]
_Angle = Annotated[ArrayLike, Field(ge=0.0, lt=0.5 * math.pi)]


_FACTORS = 48  # nodes of the factor: the mean of cos(alpha) to 1e-9, that of error rates to 1e-4
_TABLE = 256  # angles of a distribution function


class TiltFactors(NamedTuple):
    """Law of the tilt factor h_alpha behind a field of view, as weighted nodes.

    Attributes
    ----------
    h : ndarray, shape (m,)
        Factors [1]; 0 for tilts that leave the field of view.
    weight : ndarray, shape (m,)
        Their probabilities, of sum 1.
    law : TiltLaw, optional
        Law of the tilt; None for a constant one.
    fov : float
        Full field of view [rad].
    """

    h: Floats
    weight: Floats
    law: TiltLaw | None = None
    fov: float = math.pi

    @property
    def outage(self) -> float:
        """Probability that the tilt leaves the field of view."""
        return float(self.weight[self.h == 0.0].sum())

    def below(self, h: ArrayLike) -> Floats:
        """Return P(h_alpha < h) for h > 0, any shape."""
        level = np.asarray(h, dtype=float)
        if self.law is None:
            return (self.h < level[..., None]) @ self.weight
        tilt = np.minimum(np.arccos(np.clip(level, 0.0, 1.0)), _half_angle(self.fov))
        return np.where(level >= 1.0, 1.0, _tilt_table(self.law)(tilt))


def tilt_outage_note(outage: float, wind: str = "") -> str:
    """Describe the share of tilts that leave the field of view; "" for a share of no account.

    Parameters
    ----------
    outage : float
        Probability that the tilt leaves the field of view.
    wind : str
        Text that follows the subject, such as " at 13 m/s".
    """
    least_ber = 0.5 * outage  # bits are then guessed
    if least_ber < _LEAST_BER:
        return ""
    return (
        f"tilt of the aircraft{wind}: {100.0 * outage:.2g} % of the time beyond half of the field "
        f"of view, so that no power has an error rate below {least_ber:.2e}"
    )


_LEAST_BER = 1e-15  # below which an error rate says nothing about a device


@functools.lru_cache(64)
def _bulk_of_tilt(law: TiltLaw) -> tuple[float, float]:
    """Return the tilts that leave 1e-9 of the mass on either side [rad]."""
    return law.ppf(1e-9), law.ppf(1.0 - 1e-9)


@functools.lru_cache(64)
def _tilt_table(law: TiltLaw) -> Callable[[Floats], Floats]:
    """Return P(alpha > tilt), interpolated in the logarithm to 1e-5."""
    from scipy.interpolate import PchipInterpolator

    low, high = (math.atan(law.tilt_coefficient * v2) for v2 in law._bulk())
    tilt = np.linspace(low, high, _TABLE)
    table = PchipInterpolator(tilt, np.log(np.maximum(law.sf(tilt), 1e-300)))
    return lambda angle: np.exp(table(np.clip(angle, low, high)))


@check_methods
@dataclasses.dataclass(frozen=True)
class TiltLaw(abc.ABC):
    """Law of the tilt angle alpha = arctan(K V^2) and of the factor h_alpha = cos(alpha).

    Subclasses give the law of V^2; everything else follows by change of variable.
    """

    tilt_coefficient: float

    @abc.abstractmethod
    def _squared_wind(self, v2: ArrayLike, function: Literal["pdf", "cdf", "sf"]) -> Floats:
        """Return one of the functions of V^2, with full relative precision in both tails."""

    def squared_wind_pdf(self, v2: _Square) -> Floats:
        """Return the density of V^2 [s2 m-2] at `v2` [m2 s-2]."""
        return self._squared_wind(v2, "pdf")

    def squared_wind_cdf(self, v2: _Square) -> Floats:
        """Return P(V^2 <= v2), with full relative precision in the lower tail."""
        return self._squared_wind(v2, "cdf")

    def squared_wind_sf(self, v2: _Square) -> Floats:
        """Return P(V^2 > v2), with full relative precision in the upper tail."""
        return self._squared_wind(v2, "sf")

    @abc.abstractmethod
    def _bulk(self) -> tuple[float, float]:
        """Return the interval of V^2 that leaves less than 1e-17 of the mass on either side."""

    def _v2(self, tilt: _Angle) -> Floats:
        return np.tan(np.asarray(tilt, dtype=float)) / self.tilt_coefficient

    def pdf(self, tilt: _Angle) -> Floats:
        """Return the density of the tilt, f(alpha) = f_V2(tan(alpha) / K) sec^2(alpha) / K [rad-1].

        Parameters
        ----------
        tilt : array_like
            alpha [rad] in [0, pi/2), any shape.
        """
        v2 = self._v2(tilt)
        k = self.tilt_coefficient
        return self.squared_wind_pdf(v2) * (1.0 + (k * v2) ** 2) / k

    def cdf(self, tilt: _Angle) -> Floats:
        """Return P(alpha <= tilt), tilt in [0, pi/2) [rad]."""
        return self.squared_wind_cdf(self._v2(tilt))

    def sf(self, tilt: _Angle) -> Floats:
        """Return P(alpha > tilt), tilt in [0, pi/2) [rad]."""
        return self.squared_wind_sf(self._v2(tilt))

    def ppf(self, probability: Annotated[float, Field(gt=1e-15, lt=1.0 - 1e-15)]) -> float:
        """Return the quantile of the tilt [rad], 1e-15 < probability < 1 - 1e-15."""
        from scipy.optimize import brentq

        low, high = self._bulk()
        v2 = brentq(lambda v: float(self.squared_wind_cdf(v)) - probability, low, high)
        return math.atan(self.tilt_coefficient * float(v2))

    def mean(self) -> float:
        """Return the mean tilt [rad]."""
        tilt, weight = self._quadrature()
        return float(weight @ tilt)

    def std(self) -> float:
        """Return the standard deviation of the tilt [rad]."""
        tilt, weight = self._quadrature()
        return math.sqrt(float(weight @ (tilt - weight @ tilt) ** 2))

    def outage(self, fov: float) -> float:
        """Return P(alpha > fov / 2), the vertical outside a full field of view `fov` [rad].

        This is also the mass of h_alpha at 0.
        """
        return float(self.sf(_half_angle(fov))) if fov < math.pi else 0.0

    def h_pdf(self, h: ArrayLike, fov: float = math.pi) -> Floats:
        """Return the density of h_alpha on [cos(fov / 2), 1); the mass `outage(fov)` is at 0.

        f(h) = f_alpha(arccos h) / sqrt(1 - h^2)

        Parameters
        ----------
        h : array_like
            Factor in (0, 1), any shape.
        fov : float
            Full field of view [rad].

        Returns
        -------
        ndarray
            Density, same shape; 0 outside of the support.

        Notes
        -----
        Departs from the paper, eq. final_f_h_alpha: its density has no lower limit and no mass at
        0, and its constant is wrong (`GammaTiltLaw.h_pdf_printed`).
        """
        h = np.asarray(h, dtype=float)
        inside = (h > 0.0) & (h < 1.0) & (h >= math.cos(_half_angle(fov)))
        safe = np.where(inside, h, 0.5)
        return np.where(inside, self.pdf(np.arccos(safe)) / np.sqrt(1.0 - safe**2), 0.0)

    def h_cdf(self, h: ArrayLike, fov: float = math.pi) -> Floats:
        """Return P(h_alpha <= h) for h in [0, 1), with the mass at 0 from the field of view."""
        h = np.asarray(h, dtype=float)
        tilt = np.minimum(np.arccos(np.clip(h, 1e-12, 1.0)), min(_half_angle(fov), 1.5707963267))
        return np.where(h < 0.0, 0.0, np.where(h >= 1.0, 1.0, self.sf(tilt)))

    def h_moment(self, order: int = 1, fov: float = math.pi) -> float:
        """Return the moment E[h_alpha^order], the outage of the field of view included.

        Parameters
        ----------
        order : int
            Order of the moment.
        fov : float
            Full field of view [rad].
        """
        tilt, weight = self._quadrature(_half_angle(fov))
        return float(weight @ np.cos(tilt) ** order)

    def factors(self, fov: float) -> TiltFactors:
        """Return the law of h_alpha as a rule of weighted nodes, the outage of `fov` included.

        Parameters
        ----------
        fov : float
            Full field of view [rad].
        """
        dark, half = self.outage(fov), _half_angle(fov)
        low, high = _bulk_of_tilt(self)
        high = min(high, half)
        if high <= low:
            return TiltFactors(np.zeros(1), np.ones(1), self, fov)
        x, w = gauss_legendre(_FACTORS)
        tilt = low + 0.5 * (high - low) * (x + 1.0)
        weight = w * self.pdf(tilt)
        weight *= (1.0 - dark) / weight.sum()
        h, weight = np.append(np.cos(tilt), 0.0), np.append(weight, dark)
        return TiltFactors(h, weight, self, fov)

    def _quadrature(self, upper: float = 0.5 * math.pi) -> tuple[Floats, Floats]:
        """Return nodes alpha and weights f(alpha) d(alpha) over the bulk up to `upper`."""
        low, high = (math.atan(self.tilt_coefficient * v2) for v2 in self._bulk())
        high = max(min(high, upper), low)
        x, w = gauss_legendre(400)
        tilt = low + 0.5 * (high - low) * (x + 1.0)
        return tilt, 0.5 * (high - low) * w * self.pdf(tilt)


@check_methods
@dataclasses.dataclass(frozen=True)
class GammaTiltLaw(TiltLaw):
    """The paper's approximation: V^2 follows a Gamma law with the exact mean and variance.

    shape = E[V^2]^2 / Var[V^2],  scale = Var[V^2] / E[V^2]

    Parameters
    ----------
    tilt_coefficient : float
        K [s2 m-2].
    shape : float
        alpha_Gamma [1].
    scale : float
        beta_Gamma [m2 s-2], a scale (the paper writes beta and theta for the same number).
    """

    shape: float
    scale: float

    @functools.cached_property
    def _law(self) -> Any:
        from scipy.stats import gamma

        return gamma(self.shape, scale=self.scale)

    def _squared_wind(self, v2: ArrayLike, function: Literal["pdf", "cdf", "sf"]) -> Floats:
        return np.asarray(getattr(self._law, function)(v2))

    def _bulk(self) -> tuple[float, float]:
        return float(self._law.ppf(1e-17)), float(self._law.isf(1e-17))

    def h_pdf_printed(self, h: Annotated[ArrayLike, Field(gt=0.0, lt=1.0)]) -> Floats:
        """Return the density of h_alpha as published, for comparison only.

        f(h) = h^-(a+1) (1 - h^2)^((a-2)/2) exp(-sqrt(1-h^2) / (h K b)) / (K Gamma(a) b^a)

        Parameters
        ----------
        h : array_like
            Factor in (0, 1), any shape.

        Notes
        -----
        Defect of eq. final_f_h_alpha: the constant 1/K must be 1/K^a (a the Gamma shape), so the
        published form integrates to K^(a-1), some 1e-61 for the paper's UAV, and not to 1. Its
        support has no lower limit either. `h_pdf` is the right form.
        """
        from scipy.special import gammaln

        h = np.asarray(h, dtype=float)
        a, k = self.shape, self.tilt_coefficient
        log_pdf = (
            -(a + 1.0) * np.log(h)
            + 0.5 * (a - 2.0) * np.log1p(-h * h)
            - np.sqrt(1.0 - h * h) / (h * k * self.scale)
            - (math.log(k) + gammaln(a) + a * math.log(self.scale))
        )
        return np.exp(log_pdf)


@check_methods
@dataclasses.dataclass(frozen=True)
class ExactTiltLaw(TiltLaw):
    """Exact law: V^2 is the sum of a non-central chi-squared and a central one.

    F(v) = int phi(w / s_z) / s_z  F_chi2[(v - w^2) / s_h^2; 2, (u / s_h)^2] dw,  |w| <= sqrt(v)

    The horizontal gusts have one variance, so V_x^2 + V_y^2 is s_h^2 times a non-central
    chi-squared variable of two degrees of freedom; one quadrature over the vertical gust remains.
    All its terms are positive, hence no loss of precision in either tail.

    Parameters
    ----------
    tilt_coefficient : float
        K [s2 m-2].
    mean_speed : float
        Mean wind u [m s-1].
    std_horizontal, std_vertical : float
        Standard deviations s_h of V_x and V_y and s_z of V_z [m s-1].
    """

    mean_speed: float
    std_horizontal: float
    std_vertical: float

    def _squared_wind(self, v2: ArrayLike, function: Literal["pdf", "cdf", "sf"]) -> Floats:
        from scipy.special import erfc
        from scipy.stats import ncx2

        v2 = np.asarray(v2, dtype=float)
        squared = v2[..., None]
        x, weight = gauss_legendre(64)
        reach = np.minimum(np.sqrt(squared), 10.0 * self.std_vertical)
        w = 0.5 * reach * (x + 1.0)
        gauss = np.exp(-0.5 * (w / self.std_vertical) ** 2) / (
            math.sqrt(2.0 * math.pi) * self.std_vertical
        )
        rest = np.maximum(squared - w * w, 0.0) / self.std_horizontal**2
        horizontal = getattr(ncx2, function)(rest, 2, (self.mean_speed / self.std_horizontal) ** 2)
        part = np.sum(reach * weight * gauss * horizontal, axis=-1)
        if function == "pdf":
            return part / self.std_horizontal**2
        if function == "sf":  # and vertical gusts that are stronger themselves
            return part + erfc(np.sqrt(0.5 * v2) / self.std_vertical)
        return part

    def _bulk(self) -> tuple[float, float]:
        reach = 9.0 * max(self.std_horizontal, self.std_vertical)
        return max(self.mean_speed - reach, 0.0) ** 2, (self.mean_speed + 1.2 * reach) ** 2


class LawComparison(NamedTuple):
    """Distance of two laws of the tilt: D_KS [1], KL divergence [nat], RMSE and MAE [1/degree]."""

    ks: float
    kl: float
    rmse: float
    mae: float


@check_call
def compare_laws(exact: TiltLaw, approximation: TiltLaw, points: int = 400) -> LawComparison:
    """Return the distance of an approximate law of the tilt from the exact one.

    Parameters
    ----------
    exact, approximation : TiltLaw
        The two laws.
    points : int
        Even grid between the 1e-5 quantiles of `exact` for RMSE and MAE of the density per degree.

    Returns
    -------
    LawComparison
        Kolmogorov-Smirnov distance, Kullback-Leibler divergence, RMSE and MAE.

    Notes
    -----
    V^2/U^2 has one law for every wind speed, and both distances are invariant, so D_KS and KL do
    not depend on the wind; the paper prints two different D_KS (a histogram artefact).
    """
    fine = np.linspace(exact.ppf(1e-12), exact.ppf(1.0 - 1e-12), 4001)
    ks = float(np.max(np.abs(exact.cdf(fine) - approximation.cdf(fine))))
    tilt, weight = exact._quadrature()
    kept = weight > 0.0
    ratio = exact.pdf(tilt[kept]) / approximation.pdf(tilt[kept])
    kl = float(weight[kept] @ np.log(ratio))
    grid = np.linspace(exact.ppf(1e-5), exact.ppf(1.0 - 1e-5), points)
    error = (approximation.pdf(grid) - exact.pdf(grid)) * math.pi / 180.0
    return LawComparison(ks, kl, float(np.sqrt(np.mean(error**2))), float(np.mean(np.abs(error))))


GRAVITY = 9.81  # [m s-2], the paper's value


class Tilt(NamedTuple):
    """Tilt of the receiver: `angle` from the vertical and `azimuth` of its line of sight [rad].

    The airframe leans into the wind, so the line of sight of a receiver fixed under it leans
    down-wind: it points along (sin angle cos azimuth, sin angle sin azimuth, -cos angle).
    """

    angle: Floats
    azimuth: Floats


class FlightRecord(NamedTuple):
    """Record of a flight: times (n,) [s], wind (n, 3) [m s-1], tilt of the receiver (n,) [rad]."""

    times: Floats
    wind: Floats
    tilt: Tilt


class Uav(Model, frozen=True):
    """Hovering multirotor that balances the wind's drag by tilting.

    tan(alpha) = K V^2,  K = C_D rho A / (2 m g)

    Parameters
    ----------
    mass : float
        Take-off mass m [kg].
    drag_coefficient : float
        C_D [1].
    area : float
        Equivalent flat area A [m2].
    air_density : float
        rho [kg m-3]; the paper's 1.293 is air at 0 degrees C, tropical air has 1.17 (K -9.5 %).
    gimbal : bool
        Receiver on a gimbal that holds it vertical: its tilt is 0.

    Notes
    -----
    V^2 contains the vertical gust, as in the paper. Balance of the horizontal forces would take the
    horizontal wind only; the vertical part adds less than 1 % to E[V^2].

    References
    ----------
    Palomaki et al. (2017), J. Atmos. Oceanic Technol. 34, 1183, doi:10.1175/JTECH-D-16-0177.1.

    Examples
    --------
    >>> round(UAVS["dji-m300-rtk"].tilt_coefficient, 9)
    0.001574723
    """

    mass: Positive = 8.37
    drag_coefficient: Positive = 0.8
    area: Positive = 0.25
    air_density: float = pydantic.Field(default=1.293, gt=0.0, le=2.0, allow_inf_nan=False)
    gimbal: bool = False

    @property
    def tilt_coefficient(self) -> float:
        """K = C_D rho A / (2 m g) [s2 m-2]."""
        return self.drag_coefficient * self.air_density * self.area / (2.0 * self.mass * GRAVITY)

    def tilt(self, wind: ArrayLike) -> Tilt:
        """Return the tilt of the receiver in a given wind, alpha = arctan(K V^2), down-wind.

        Parameters
        ----------
        wind : array_like
            Wind vectors (..., 3) [m s-1].

        Returns
        -------
        Tilt
            Angle and azimuth (...) [rad]; zeros behind a gimbal.
        """
        v = require_array(wind, "wind", "wind vectors (..., 3) [m/s]")
        if v.ndim == 0 or v.shape[-1] != 3:
            raise Refused("wind", Described(f"shape {v.shape}"), "wind vectors (..., 3) [m/s]")
        if self.gimbal:
            return Tilt(np.zeros(v.shape[:-1]), np.zeros(v.shape[:-1]))
        angle = np.arctan(self.tilt_coefficient * np.sum(v * v, axis=-1))
        return Tilt(angle, np.arctan2(v[..., 1], v[..., 0]))

    def simulate_flight(self, wind: Dryden, times: ArrayLike, seed: int) -> FlightRecord:
        """Simulate wind and tilt in time.

        Parameters
        ----------
        wind : Dryden
            Wind at the UAV.
        times : array_like
            Evenly spaced times (n,) [s], for instance those of the sea's time series.
        seed : int
            Seed of the generator.

        Returns
        -------
        FlightRecord
            Times, wind and tilt.
        """
        record = wind.simulate_wind(times, seed)
        return FlightRecord(np.asarray(times, dtype=float), record, self.tilt(record))

    def tilt_law(
        self, wind: Dryden, law: Literal["exact", "gamma"] = "exact"
    ) -> ExactTiltLaw | GammaTiltLaw:
        """Return the law of the tilt angle in a given wind.

        Parameters
        ----------
        wind : Dryden
            Wind at the UAV.
        law : {"exact", "gamma"}
            Exact law of V^2 (three Gaussian components), or the paper's Gamma law of the same mean
            and variance.

        Returns
        -------
        ExactTiltLaw or GammaTiltLaw
            The law.

        Raises
        ------
        Refused
            If the tilt does not vary (gimbal or calm), or `law` is not one of the two names.
        """
        if self.gimbal or not np.all(wind.std > 0.0):
            raise Refused("tilt_law", Described("constant tilt"), "no gimbal, a wind with gusts")
        mean_wind, std = wind.mean_wind, wind.std
        if law == "exact":
            speed, along, _, up = map(float, (mean_wind[0], *std))
            return ExactTiltLaw(self.tilt_coefficient, speed, along, up)
        mean, variance = squared_wind_moments(mean_wind, std)
        return GammaTiltLaw(self.tilt_coefficient, mean**2 / variance, variance / mean)

    def tilt_factors(self, wind: Dryden, fov: float) -> TiltFactors:
        """Return the law of the factor h_alpha in a wind; of a constant tilt a single value.

        Parameters
        ----------
        wind : Dryden
            Wind at the UAV.
        fov : float
            Full field of view [rad].
        """
        require_kind(wind, Dryden, "wind")
        if self.gimbal or not np.all(wind.std > 0.0):
            angle = self.tilt(wind.mean_wind[None]).angle
            return TiltFactors(h_alpha(angle, fov), np.ones(1), None, fov)
        return self.tilt_law(wind).factors(fov)


class Flight(NamedTuple):
    """An aircraft in a wind: the tilt of the receiver that it carries.

    Parameters
    ----------
    uav : Uav
        Airframe.
    wind : Dryden, optional
        Wind at the aircraft; by default that over the sea, at the height of the receiver.
    coupled : bool
        Whether the tilt acts on every photon, rather than as a factor h_alpha on the gain; a time
        series is always coupled.
    time_step : float
        Time between the realizations of a coupled link performance [s].
    """

    uav: Uav = Uav()
    wind: Dryden | None = None
    coupled: bool = False
    time_step: float = 0.5

    def checked(self) -> Flight:
        """Return the flight; refuse fields of a wrong type."""
        require_kind(self.uav, Uav, "flight.uav")
        require_kind(self.wind, Dryden | None, "flight.wind")
        require_kind(self.coupled, bool, "flight.coupled")
        require_between(self.time_step, 0.0, 1e6, "flight.time_step")
        return self


UAVS: dict[str, Uav] = {
    "dji-m300-rtk": Uav(),
    "dji-m300-rtk-no-payload": Uav(mass=6.3),
    "dji-m300-rtk-max-takeoff": Uav(mass=9.0),
}
"""Airframes by name. The paper's mass is 8.37 kg; drag coefficient and area are the paper's CFD
estimates for all three."""


class Place(NamedTuple):
    """Horizontal position (n, 2) and height (n,) of a receiver [m]."""

    position: Floats
    height: Floats


class Route(Model, frozen=True):
    """Waypoints of a receiver, with straight lines at constant speed between them.

    Parameters
    ----------
    times : sequence of float, length n
        Times at the waypoints [s], increasing, n >= 2.
    positions : sequence of (float, float), length n
        Horizontal positions (x, y) [m].
    heights : sequence of float, length n, optional
        Heights above still water [m], > 0; by default that of the receiver of the link.

    Raises
    ------
    Refused
        If the lengths differ or the times do not increase.

    Examples
    --------
    >>> route = Route(times=(0, 10), positions=((-5, 0), (5, 0)))
    >>> route.at([0.0, 2.5], height=5.0).position
    array([[-5. ,  0. ],
           [-2.5,  0. ]])
    """

    times: tuple[Finite, ...]
    positions: tuple[Position, ...]
    heights: tuple[Positive, ...] | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        n = len(self.times)
        if n < 2 or np.any(np.diff(self.times) <= 0.0):
            raise Refused("times", self.times, "two or more increasing times [s]")
        for name in ("positions", "heights"):
            value = getattr(self, name)
            if value is not None and len(value) != n:
                raise Refused(name, Described(f"{len(value)} of them"), f"{n}, one for each time")
        return self

    def at(self, times: Floats | list[float], height: Positive) -> Place:
        """Return the places at times (n,) [s].

        Parameters
        ----------
        times : ndarray, shape (n,)
            Times [s] from the first waypoint to the last.
        height : float
            Height [m] of a route without heights.

        Raises
        ------
        Refused
            If a time lies outside of the route.
        """
        wanted = require_finite(times, "times", "times (n,) [s]")
        first, last = self.times[0], self.times[-1]
        outside = (wanted < first) | (wanted > last)
        if outside.any():
            raise Refused("times", float(wanted[outside][0]), f"{first:g} <= times <= {last:g}")
        columns = np.transpose(self.positions)
        position = np.stack([np.interp(wanted, self.times, c) for c in columns], axis=-1)
        if self.heights is None:
            return Place(position, np.full(len(wanted), height))
        return Place(position, np.interp(wanted, self.times, self.heights))
