"""Tracker that steers a beam by delayed measurements."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from meshtrace.models import Model, NonNegative, Positive


class Tracker(Model, frozen=True):
    r"""Tracker that steers a beam to the receiver by measurements of a latency before.

    .. math:: \hat s(t) = \sum_j a_j \, (s(t_0 - j T) + \epsilon_j), \quad t_0 \le t - \tau,
              \qquad y(u(t); \hat s(t)) = 0

    s is the slope of the sea over the footprint, epsilon its noise, u the turn of the axis, and y
    the distance of the spot from the receiver by refraction at a slope; for a vertical beam from
    the depth d to the height h it is (d + n h) u - (n - 1) h s. `time_series` and `channel_trace`
    steer each frame, see `studies.steer`; single gains and ensembles, which have no past, take the
    axis of the lamp.

    Parameters
    ----------
    latency : float
        Time tau from a sample to the beam steered by it [s], >= 0.
    sample : float
        Time T between samples [s], 0.0001 to 10; a correction stays until the next.
    noise_deg : float
        Standard deviation of the noise of each component of what is seen [deg], 0 to 90: of the
        direction of the refracted light, or of the slope.
    range_deg : float, optional
        Largest angle of the axis from that of the lamp [deg], > 0, <= 90; by default any.
    rate_deg_s : float, optional
        Largest speed of the axis [deg s-1], > 0; by default any.
    predictor : {"hold", "linear"}
        Last slope (a_0 = 1), or the best linear prediction: by the samples of the last 0.8 s, at
        most 400, for waves, footprint and noise (`fading.pointing_residual`).
    sees : {"spot", "slope"}
        The place of the spot in the plane of the receiver, or the slopes of the surface wherever
        the beam will cross: the spot tells the slope where it crossed unless the sea reflects it.

    Examples
    --------
    >>> import meshtrace as mt
    >>> beam = mt.GaussianBeam(depth=2.0, tracker=mt.Tracker(latency=0.03, predictor="linear"))
    >>> beam.tracker.sees
    'spot'
    """

    latency: NonNegative = 0.01
    sample: float = Field(default=0.002, ge=1e-4, le=10.0, allow_inf_nan=False)
    noise_deg: float = Field(default=0.0, ge=0.0, le=90.0, allow_inf_nan=False)
    range_deg: float | None = Field(default=None, gt=0.0, le=90.0, allow_inf_nan=False)
    rate_deg_s: Positive | None = None
    predictor: Literal["hold", "linear"] = "hold"
    sees: Literal["spot", "slope"] = "spot"
