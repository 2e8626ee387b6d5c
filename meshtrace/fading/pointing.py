"""Closed forms for the wander of a narrow beam over a Gaussian sea, and its residual in tracking.

Refraction at the slope s moves the spot of a vertical beam at the height h by (n - 1) h s. The
slope is averaged over the footprint: with the weight exp(-2 r^2 / w^2) of a Gaussian beam each wave
k counts by exp(-k^2 w^2 / 4) in variance.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from meshtrace.checks import Index, Infinite, NonNegative, Positive, check_call
from meshtrace.fading.spectral import require_spectrum
from meshtrace.models import Floats

Predictor = Literal["hold", "linear"]
"""What a tracker makes of the past: its last correction, or the best linear prediction."""

SAMPLE = 0.002
"""Time between samples of the linear predictor [s]."""

# Past of the linear predictor, at most. Over longer lags the nodes of the spectrum, 0.15 rad/s
# apart at 100 rad/s, would return like separate tones, which a predictor foretells without error.
_SAMPLES, _MEMORY = 400, 0.8  # [1], [s]
LEAST_NOISE = 1e-6
"""Noise over the variance that keeps the normal equations well-conditioned."""

_AZIMUTHS = 2048  # of the outage: a periodic integrand, exact to rounding for any ratio of axes


class Wander(NamedTuple):
    """Slope variances over a footprint by omega (n,) [rad s-1]: along, across the wind (2, n)."""

    omega: Floats
    variance: Floats

    @classmethod
    def from_sea(cls, surface: Any, radius: float, omega_max: float | None = None) -> Wander:
        """Return the slopes of a sea under a beam of a 1/e^2 radius [m]."""
        require_spectrum(surface)
        spectrum = surface.slope_spectrum(omega_max)
        along = 0.5 * (1.0 + spectrum.harmonics[2])  # cos^2 = (1 + cos 2 theta) / 2
        footprint = spectrum.variance * np.exp(-0.25 * (spectrum.k * radius) ** 2)
        return cls(spectrum.omega, footprint * np.stack([along, 1.0 - along]))

    def covariance(self, lags: Floats) -> Floats:
        """Return the autocovariances along and across the wind at time lags (m,) [s], (2, m)."""
        # einsum: the last digits of a BLAS product change with its number of threads
        return np.einsum("an,mn->am", self.variance, np.cos(np.outer(lags, self.omega)))

    def coefficients(
        self, latency: float, sample: float = SAMPLE, noise: float = LEAST_NOISE
    ) -> Floats:
        """Return the best linear predictor a (m,) of both axes, newest sample first.

        Both axes have one predictor, that of the sum of their covariances C:
        sum_j (C(i T - j T) + noise C(0) delta_ij) a_j = C(latency + i T).
        """
        lags = sample_lags(sample)
        return _predictor(self.covariance(lags), self.covariance(latency + lags), noise)

    def left(
        self, latency: float | None, predictor: Predictor | None, sample: float, noise: float | None
    ) -> Floats:
        """Return the residual slope variances (2,) of tracking, along and across the wind."""
        from scipy.linalg import matmul_toeplitz

        whole = self.variance.sum(axis=1)
        if latency is None or predictor is None:
            return whole
        if predictor == "hold":
            # 1 - cos by its half angle, without cancellation at short latencies
            steps = 4.0 * np.sin(0.5 * self.omega * latency) ** 2
            return (self.variance * steps).sum(axis=1) + (noise or 0.0) * 0.5 * whole.sum()
        noise = max(noise or 0.0, LEAST_NOISE)
        lags = sample_lags(sample)
        past_of, ahead_of = self.covariance(lags), self.covariance(latency + lags)
        a = _predictor(past_of, ahead_of, noise)
        by_axis = zip(whole, past_of, ahead_of, strict=True)
        # E (s - sum_j a_j (s_j + e_j))^2, half of the noise on each axis
        left = [c0 - 2.0 * a @ ahead + a @ matmul_toeplitz(past, a) for c0, past, ahead in by_axis]
        return np.array(left) + noise * 0.5 * whole.sum() * (a @ a)


def _predictor(past: Floats, ahead: Floats, noise: float) -> Floats:
    """Return `Wander.coefficients` from the covariances (2, m) at the lags and ahead of them."""
    from scipy.linalg import solve_toeplitz

    column = past.sum(axis=0)
    column[0] *= 1.0 + noise
    return np.asarray(solve_toeplitz(column, ahead.sum(axis=0)))


@check_call
def pointing_residual(
    surface: Any,
    latency: NonNegative,
    radius: NonNegative,
    predictor: Predictor = "hold",
    sample: Positive = SAMPLE,
    noise: NonNegative | None = None,
    omega_max: Annotated[float, Infinite()] | None = None,
) -> float:
    r"""Compute the share of the variance of beam wander that remains after tracking.

    .. math:: \epsilon = 2 (1 - \rho(\tau)), \quad
        \rho(\tau) = \frac{\int k^2 S e^{-k^2 w^2 / 4} \cos \omega\tau \, d\omega}
                          {\int k^2 S e^{-k^2 w^2 / 4} \, d\omega}

    where the last correction is held, and with the best linear predictor of samples every T

    .. math:: \epsilon = 1 - \sum_j a_j \rho(\tau + j T), \quad
        \sum_j \left(\rho((i - j) T) + \sigma^2 \delta_{ij}\right) a_j = \rho(\tau + i T)

    Parameters
    ----------
    surface : JonswapSea or SpectralSea
        The sea; its seed and its mesh do not matter, `choppy` and `order` are left out.
    latency : float
        Time tau from the newest sample to the beam steered by it [s], >= 0.
    radius : float
        Radius w at 1/e^2 of the irradiance of the beam at the surface [m], >= 0.
    predictor : {"hold", "linear"}
        Held correction, or best linear predictor of the samples of the last 0.8 s, at most 400:
        no learned predictor of the same samples of a Gaussian sea leaves less.
    sample : float
        Time T between the samples of the predictor [s], > 0.
    noise : float, optional
        Variance sigma^2 of the noise of a sample, as a share of that of the wander, >= 0; by
        default none. "linear" counts on 1e-6 at least, which keeps its equations well-conditioned.
    omega_max : float, optional
        Highest frequency of the waves [rad s-1]; by default all waves down to 1.3 mm.

    Returns
    -------
    float
        Share of the variance [1]: 0 for perfect tracking, 1 for none, and 2 for a correction that
        has nothing in common with the present.

    Raises
    ------
    Refused
        If the sea has no spectrum, or a value is out of range.

    See Also
    --------
    pointing_outage : Share of the time that the spot is off its target.

    Notes
    -----
    The beam crosses the surface at one place: steering moves the crossing by little. Noise of a
    held correction adds its whole variance.

    Examples
    --------
    >>> from meshtrace.surfaces import resolved_sea
    >>> sea = resolved_sea(5.0)
    >>> round(pointing_residual(sea, 0.03, 0.005), 3)
    0.351
    >>> round(pointing_residual(sea, 0.03, 0.02, "linear"), 4)
    0.0004
    """
    wander = Wander.from_sea(surface, radius, omega_max)
    return float(wander.left(latency, predictor, sample, noise).sum() / wander.variance.sum())


@check_call
def pointing_outage(
    surface: Any,
    height: Positive,
    tolerance: Positive,
    latency: NonNegative | None,
    radius: NonNegative,
    predictor: Predictor | None = "hold",
    sample: Positive = SAMPLE,
    noise: NonNegative | None = None,
    n: Annotated[Index, Field(gt=1.0)] = 1.33,
    omega_max: Annotated[float, Infinite()] | None = None,
) -> float:
    r"""Compute the probability that the spot of a beam is farther than R from its target.

    .. math:: P(|y| > R) = \frac{1}{2\pi} \int_0^{2\pi}
        \exp\left(-\frac{R^2}{2 (\sigma_1^2 \cos^2\phi + \sigma_2^2 \sin^2\phi)}\right) d\phi

    with the deviations sigma_i = (n - 1) h sqrt(v_i) of the spot along and across the wind, and the
    slope variances v_i that tracking leaves on each axis (`pointing_residual`).

    Parameters
    ----------
    surface, radius, predictor, sample, noise, omega_max
        As for `pointing_residual`.
    height : float
        Height h of the target above the sea [m], > 0.
    tolerance : float
        Largest distance R of the spot from its target [m], > 0.
    latency : float or None
        As for `pointing_residual`; None, here or as `predictor`, is a beam that is not steered.
    n : float
        Refractive index of the water over that of the air, > 1.

    Returns
    -------
    float
        Probability [1].

    Raises
    ------
    Refused
        As `pointing_residual`.

    Examples
    --------
    >>> from meshtrace.surfaces import resolved_sea
    >>> sea = resolved_sea(5.0)
    >>> round(pointing_outage(sea, 10.0, 0.3, None, 0.005), 4)
    0.7404
    >>> round(pointing_outage(sea, 10.0, 0.3, 0.01, 0.005), 5)
    0.00614
    """
    wander = Wander.from_sea(surface, radius, omega_max)
    left = wander.left(latency, predictor, sample, noise)
    return outside((n - 1.0) ** 2 * height**2 * left, tolerance)


def sample_lags(sample: float) -> Floats:
    """Return the ages (m,) [s] of the samples of a linear predictor relative to the newest."""
    return sample * np.arange(float(min(max(round(_MEMORY / sample), 1), _SAMPLES)))


def outside(variances: Floats, tolerance: float) -> float:
    """Return P(|y| > R) of a Gaussian with the variances (2,) [m2] of its axes.

    This is the tail of the radius in the frame where the law is round, over the azimuth there, see
    `pointing_outage`.
    """
    phi = 2.0 * math.pi * (np.arange(_AZIMUTHS) + 0.5) / _AZIMUTHS
    across = variances[0] * np.cos(phi) ** 2 + variances[1] * np.sin(phi) ** 2
    exponent = np.full(_AZIMUTHS, np.inf)
    np.divide(0.5 * tolerance**2, across, out=exponent, where=across > 0.0)
    return float(np.exp(-exponent).mean())
