"""Wind and gusts at an aircraft: profiles over the sea, Dryden turbulence.

Vectors are (x, y, z): u along the mean wind, v across it, w up.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.checks import Seed, check_call
from meshtrace.errors import Refused, require_array, require_finite
from meshtrace.models import Floats, Model, Positive

FOOT = 0.3048  # [m]
HEIGHT_20FT = 20.0 * FOOT  # [m], where the specification takes the wind W20

WindPreset = Literal["physical", "paper"]


class LogProfile(Model, frozen=True):
    """Neutral logarithmic wind profile over a rough surface.

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

    W20 is the wind at 20 feet, sigma are turbulence intensities, L lengths, h is the height:

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
        """Return gusts in the correct form (`"physical"`) or as published (`"paper"`).

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
        return cls.model_validate(forms[physics] | fields)

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
        # MIL-F-8785C, section 3.7
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
        """Filter times tau = L / |U| (3,) [s], U the mean wind; infinite in a calm."""
        speed = float(np.linalg.norm(self.mean_wind))
        return self.length_scales / speed if speed > 0.0 else np.full(3, np.inf)

    @property
    def _bracket(self) -> float:
        """The term 0.177 + 0.000823 h of intensities and lengths."""
        unit = FOOT if self.altitude_unit == "foot" else 1.0
        return 0.177 + 0.000823 * self.height / unit

    def autocorrelation(self, lag: ArrayLike) -> Floats:
        """Return the autocovariance of the three gust components.

        R_u = s^2 exp(-t/tau),  R_v = R_w = s^2 exp(-t/tau) (1 - t / (2 tau)), s the `std`

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

        are the filters of white noise, with the Laplace variable p and the standard deviation s.

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
        step = float(steps.mean()) / self.correlation_times
        # states (n, 3) of the three components
        x1, x2 = np.transpose(list(map(_states, step, noise)), (1, 2, 0))
        # H_v = s sqrt(tau) [sqrt(3) / (1 + tau p) + (1 - sqrt(3)) / (1 + tau p)^2]
        gusts = math.sqrt(3.0) * x1 + (1.0 - math.sqrt(3.0)) * x2
        gusts[:, 0] = math.sqrt(2.0) * x1[:, 0]
        return self.mean_wind + self.std * gusts


def _states(step: float, noise: Floats) -> Floats:
    """Return the states (2, n) behind 1/(1 + tau p) and 1/(1 + tau p)^2, sampled every step tau.

    x1' = (w - x1)/tau, x2' = (x1 - x2)/tau for white noise w, in units of tau^-1/2. `noise` (2, n)
    are independent standard normal numbers.
    """
    from scipy.signal import lfilter
    from scipy.special import gammainc

    def drive(q11: float, q12: float, q22: float, z: Floats) -> tuple[Floats, Floats]:
        """Return noise of the covariance [[q11, q12], [q12, q22]] by its Cholesky factor."""
        if q11 == 0.0:
            return 0.0 * z[0], 0.0 * z[1]
        first = math.sqrt(q11)
        return first * z[0], q12 / first * z[0] + math.sqrt(q22 - q12**2 / q11) * z[1]

    # The noise covariance over a step is the integral of (1, s, s^2) exp(-2 s) from 0 to `step`:
    # incomplete gamma functions, free of the cancellation for short steps in P - A P A^T, with the
    # stationary covariance P and the transition matrix A.
    q11, q12, q22 = np.array([0.5, 0.25, 0.25]) * gammainc([1, 2, 3], 2.0 * step)
    drive_1, drive_2 = drive(q11, q12, q22, noise)
    # the record starts in the stationary state: the covariance of an infinite step
    (drive_1[0],), (drive_2[0],) = drive(0.5, 0.25, 0.25, noise[:, :1])
    decay = math.exp(-step)
    x1 = lfilter([1.0], [1.0, -decay], drive_1)
    # the transition matrix is exp(-q) [[1, 0], [q, 1]]; infinity times 0 would be nan
    coupling = step * decay if math.isfinite(step) else 0.0
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
