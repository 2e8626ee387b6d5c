"""Replay of a waveform through a stored trace of a channel."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.apps.traces import ChannelTrace
from meshtrace.checks import NonNegative, Positive, check_call
from meshtrace.errors import Described, Refused, require_finite
from meshtrace.models import Floats
from meshtrace.results.impulse import ImpulseResponse

_MOST_TAPS = 10**6  # 8 MB; the delays of a link at 10 GHz have some hundred


@check_call
def replay(
    waveform: ArrayLike,
    rate: Positive,
    trace: ChannelTrace,
    response: ImpulseResponse | None = None,
    *,
    direction: Literal["up", "down"] = "up",
    start: NonNegative = 0.0,
    receiver: Annotated[int, Field(ge=0, le=2**31)] = 0,
) -> Floats:
    r"""Send a waveform through the time-varying channel of a trace.

    .. math:: y(t) = g(t) \int \hat h(\tau) x(t - \tau) d\tau, \quad \int \hat h(\tau) d\tau = 1

    Parameters
    ----------
    waveform : array_like, shape (n,)
        Samples x of the emitted power, in any unit; there is no light before the first.
    rate : float
        Samples per second [s-1].
    trace : ChannelTrace
        The gains g, linear between the frames.
    response : ImpulseResponse, optional
        Delays of the light in the same link; by default all light arrives at once.
    direction : {"up", "down"}, optional
        Direction of the trace.
    start : float, optional
        Time of the first sample in the trace [s].
    receiver : int, optional
        Index of the receiver in a trace of several.

    Returns
    -------
    ndarray, shape (n,)
        Samples y of the received power, in the unit of the waveform, without noise.

    Raises
    ------
    Refused
        If the trace has no such direction or receiver, or is shorter than the waveform.

    Notes
    -----
    Time 0 is that of the first arrival. An arrival between two samples is shared by both, so that
    the mean delay is kept. The shape of the delays is taken for constant: waves change the gain
    of all light far more than its delays.

    Examples
    --------
    >>> import numpy as np
    >>> trace = ChannelTrace(np.array([0.0, 1.0]), np.array([1e-6, 3e-6]), *np.zeros((2, 2)), 0.0)
    >>> replay([1.0, 1.0, 0.0], 2.0, trace)
    array([1.e-06, 2.e-06, 0.e+00])
    """
    x = require_finite(waveform, "waveform", "finite samples (n,)")
    if x.ndim != 1 or not x.size:
        raise Refused("waveform", Described(f"shape {x.shape}"), "one dimension")
    gain = trace.gain if direction == "up" else trace.down_gain
    if gain is None:
        raise Refused("direction", direction, "up")
    gain = gain.reshape(len(trace.time), -1)
    if receiver >= gain.shape[1]:
        raise Refused("receiver", receiver, f"below {gain.shape[1]}, the number of receivers")
    times = trace.time[0] + start + np.arange(x.size) / rate
    # half a sample: times at equal steps may miss that of the last frame by rounding
    if times[-1] > trace.time[-1] + 0.5 / rate:
        length = Described(f"{x.size / rate:g} s from {start:g} s on")
        raise Refused("waveform", length, f"within {np.ptp(trace.time):g} s of the trace")
    if response is not None:
        from scipy.signal import oaconvolve

        x = oaconvolve(x, _taps(response, rate))[: x.size]
    return np.asarray(np.interp(times, trace.time, gain[:, receiver]) * x)


def _taps(response: ImpulseResponse, rate: float) -> Floats:
    """Return the shares of the light that arrive at each multiple of the sampling time."""
    place = response.delay * rate
    if place.max() > _MOST_TAPS:
        raise Refused(
            "rate", rate, f"at most {_MOST_TAPS / response.delay.max():.3g} samples per s"
        )
    before = np.floor(place).astype(np.int64)
    share, n = place - before, int(before.max()) + 2
    taps = np.bincount(before, (1.0 - share) * response.weight, n)
    taps += np.bincount(before + 1, share * response.weight, n)
    return np.asarray(taps / taps.sum())
