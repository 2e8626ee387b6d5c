"""Channel traces: gains of both directions, background and attitude of an aircraft over time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Any, Literal, Unpack

import numpy as np

from meshtrace import Flight, GainSeries, MeshSource, Route
from meshtrace.checks import Positive, check_call
from meshtrace.daylight import Daylight
from meshtrace.engine.setup.options import StudyOptions
from meshtrace.errors import Refused, require_between
from meshtrace.link import Link
from meshtrace.models import Floats
from meshtrace.results.tallies import error_of_groups
from meshtrace.scenario import Scenario
from meshtrace.stored import SHIFTS, Stored, Variable
from meshtrace.studies.background import backgrounds, light_of
from meshtrace.studies.campaign import Campaign, Steps, campaign_of, gains_over
from meshtrace.studies.comparison import both_directions
from meshtrace.studies.series import in_flight

DEFAULT_CHAINS = 1024
"""Chains of each direction."""

_PIECE = 50  # frames of a step, which a stopped run keeps
_LIT = 2.0 / 3.0  # 99.5 % of the light crosses in the fine part, the rest in cells somewhat wider
_RAYS = 512  # of the background at each of its times
_COLUMNS = "gain", "gain_stderr", "gain_ballistic", "gain_mean_stderr"
_MOST_FRAMES = 10**8
_EACH = Variable("time", "receiver")
_BY_LAMP = Variable("time", "transmitter", "receiver")


@dataclass(frozen=True, eq=False, repr=False)
class ChannelTrace(Stored, kind="trace", title="meshtrace channel trace"):
    """Channel of a link over time.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Times [s], at equal steps.
    gain, gain_stderr, gain_ballistic : ndarray, shape (n,) or (n, receivers)
        Gain, its standard error and its unscattered part.
    gain_mean_stderr : float or ndarray, shape (receivers,)
        Monte Carlo standard error of the mean gain: all times have common chains.
    down_gain, down_gain_stderr, down_gain_ballistic : ndarray, shape (n,), optional
        The same of the downlink.
    down_gain_mean_stderr : float, optional
        The same of the downlink.
    tilt_deg, tilt_azimuth_deg : ndarray, shape (n,), optional
        Tilt of the aircraft and its azimuth [deg]; None without a flight.
    place : ndarray, shape (n, 3), optional
        Place (x, y, z) of the aircraft [m]; None without a route.
    background_time : ndarray, shape (m,), optional
        Times of the background [s]; None without daylight.
    background_radiance, background_radiance_stderr : ndarray, shape (m,), optional
        Background of the receiver of the first link [W m-2 sr-1 nm-1], and its standard error.
    gain_by_lamp, gain_by_lamp_stderr : ndarray, shape (n, transmitters, receivers), or None
        Gain by lamp and receiver over the power of all lamps, and its standard error.
    provenance : dict
        Configuration of each direction by "up" and "down", aircraft, route and daylight.
    """

    time: Annotated[Floats, Variable("time")]
    gain: Annotated[Floats, _EACH]
    gain_stderr: Annotated[Floats, _EACH]
    gain_ballistic: Annotated[Floats, _EACH]
    gain_mean_stderr: Annotated[Any, Variable("receiver")]
    down_gain: Annotated[Floats | None, Variable("time")] = None
    down_gain_stderr: Annotated[Floats | None, Variable("time")] = None
    down_gain_ballistic: Annotated[Floats | None, Variable("time")] = None
    down_gain_mean_stderr: Annotated[float | None, Variable()] = None
    tilt_deg: Annotated[Floats | None, Variable("time")] = None
    tilt_azimuth_deg: Annotated[Floats | None, Variable("time")] = None
    place: Annotated[Floats | None, Variable("time", "axis")] = None
    background_time: Annotated[Floats | None, Variable("background_time")] = None
    background_radiance: Annotated[Floats | None, Variable("background_time")] = None
    background_radiance_stderr: Annotated[Floats | None, Variable("background_time")] = None
    gain_by_lamp: Annotated[Floats | None, _BY_LAMP] = None
    gain_by_lamp_stderr: Annotated[Floats | None, _BY_LAMP] = None
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def rate(self) -> float:
        """Frames per second [s-1]; nan for a single frame."""
        if len(self.time) < 2:
            return math.nan
        return (len(self.time) - 1) / float(self.time[-1] - self.time[0])

    def series(self, direction: Literal["up", "down"] = "up") -> GainSeries:
        """Return the gains of a direction as a series.

        Raises
        ------
        Refused
            If the trace has no such direction.
        """
        prefix = {"up": "", "down": "down_"}.get(direction)
        if prefix is None or getattr(self, f"{prefix}gain") is None:
            allowed = "up" if self.down_gain is None else "up or down"
            raise Refused("direction", direction, allowed)
        gain, stderr, ballistic, error = (getattr(self, f"{prefix}{name}") for name in _COLUMNS)
        origin = self.provenance[direction]
        series = GainSeries("time", self.time, gain, stderr, ballistic, error, origin)
        if prefix or self.gain_by_lamp is None:
            return series
        return replace(
            series, gain_by_lamp=self.gain_by_lamp, gain_by_lamp_stderr=self.gain_by_lamp_stderr
        )

    @property
    def correlation(self) -> float:
        """Pearson's correlation of both directions; nan without a downlink or fading."""
        if self.down_gain is None or self.gain.ndim > 1:
            return math.nan
        if min(np.ptp(self.gain), np.ptp(self.down_gain)) == 0.0:
            return math.nan
        return float(np.corrcoef(self.gain, self.down_gain)[0, 1])

    def _check(self) -> None:
        # a downlink with a part of its arrays would fail in its series only
        if len({getattr(self, f"down_{name}") is None for name in _COLUMNS}) > 1:
            raise ValueError("a downlink without all of its gains and errors")

    def _headline(self) -> str:
        means = ", ".join(f"{m:.4e}" for m in np.atleast_1d(self.gain.mean(axis=0))[:4])
        if len(self.time) < 2:
            return f"1 frame, mean gain {means}"
        return f"{len(self.time):,} frames at {self.rate:g} per s, mean gain {means}"

    def summary(self) -> str:
        """Describe the fading of each direction, the tilt and the background as text."""
        lines = [self._headline(), "", self.series("up").summary()]
        if self.down_gain is not None:
            lines += ["", "downlink", self.series("down").summary()]
            lines += ["", f"correlation of both directions  {self.correlation:.3f}"]
        if self.tilt_deg is not None:
            lines.append(
                f"tilt of the aircraft  {self.tilt_deg.mean():.3g} deg on average, "
                f"{self.tilt_deg.min():.3g} to {self.tilt_deg.max():.3g} deg"
            )
        radiance = self.background_radiance
        if radiance is not None and self.background_time is not None:
            lines.append(
                f"background  {radiance.mean():.3e} W m-2 sr-1 nm-1 on average, "
                f"{radiance.min():.3e} to {radiance.max():.3e} at {len(radiance):,} times"
            )
        return "\n".join(lines)


@check_call
def channel_trace(
    link: Link | Scenario,
    surface: MeshSource | None = None,
    *,
    hours: Positive = 0.01,
    rate: Positive = 50.0,
    down: Link | Literal["mirrored"] | None = "mirrored",
    flight: Flight | None = None,
    route: Route | None = None,
    daylight: Daylight | None = None,
    background_rate: float = 1.0,
    per_lamp: bool = False,
    **run: Unpack[StudyOptions],
) -> ChannelTrace:
    """Compute the channel of a link over time: gains of both directions, background, attitude.

    Parameters
    ----------
    link : Link or Scenario
        The link, or a scenario with its sea, daylight and aircraft.
    surface : MeshSource, optional
        The sea, whose phases stay while time moves its waves, or meshes in time.
    hours : float
        Duration [h], > 0.
    rate : float
        Frames per second [s-1], > 0. The light of short waves keeps its gain for some 0.05 s.
    down : Link, "mirrored" or None
        The downlink over the same surfaces: by default both ends have lamp and receiver of the
        link; None, or a link of several ends, has none.
    flight : Flight, optional
        Aircraft that tilts its end of the links; by default that of the scenario.
    route : Route, optional
        Waypoints of the end in the air.
    daylight : Daylight, optional
        Light above the sea; by default that of the scenario.
    background_rate : float
        Times per second [s-1] at which the background is computed, > 0, at most `rate`.
    per_lamp : bool
        Whether the trace also has the gains of the first link by lamp, from the same chains.
    **run
        Options of the run, see `StudyOptions`; 1024 chains by default. A stopped run resumes
        from its `store`, which keeps 50 frames at once.

    Returns
    -------
    ChannelTrace

    Raises
    ------
    Refused
        If an option is out of range, the downlink is none, or a flight tilts an end that is
        tilted already.

    Notes
    -----
    All frames have common chains, so that their Monte Carlo noise is common, too, unless an
    aircraft flies a route; chains are aimed anew where it tilts. The mesh is somewhat smaller than
    that of a series of the link, over the same waves: frames of both agree within the error of the
    mesh, some 0.5 %. Unless `waves` of the meshing says otherwise, the mesh holds all waves that
    make the light of `link` fade, for both directions; a warning says if that leaves out a tenth of
    the fading of the downlink. Beams with a `Tracker` are steered, each by what it saw; of a
    tracked lamp in the air the tilt of a trace is the axis of its beam.

    Examples
    --------
    >>> import meshtrace as mt
    >>> sea = mt.surfaces.sea_in_wind(5.0)
    >>> trace = mt.channel_trace(mt.Link(), sea, hours=4 / 3600, rate=2.0, photons=256)
    >>> trace.time[-1], trace.down_gain.shape
    (np.float64(3.5), (8,))
    """
    require_between(background_rate, 0.0, rate, "background_rate", "(]")
    frames = _frames_in(hours, rate)
    if frames > _MOST_FRAMES:
        raise Refused("hours", hours, f"at most {_MOST_FRAMES:,} frames")
    campaign = _campaign(link, surface, down, run)._replace(per_lamp=per_lamp)
    if per_lamp and len({len(one_way.transmitters) for one_way in campaign.links.values()}) > 1:
        raise Refused("per_lamp", True, "with as many lamps in the downlink")
    if campaign.meshing.time != 0.0:
        raise Refused("sea.time", campaign.meshing.time, "0: a trace begins there")
    flight = campaign.flight(flight)
    times = np.arange(frames) / rate
    steps = in_flight(campaign, times, flight, route)
    day = light_of(campaign, daylight)
    trace = _trace(campaign, steps)
    origin = dict(trace.provenance)
    if flight is not None:
        origin |= campaign.of_flight(flight)
    for name, part in (("route", route), ("daylight", day)):
        if part is not None:
            origin[name] = part.model_dump(mode="json")
    trace = replace(trace, provenance=origin)
    # attitude and place of the aircraft are those of its end of the links
    ends: list[Any] = [links[0].air_end[1] for links in steps.links or ()]
    if flight is not None:
        tilt, azimuth = np.array([(end.tilt_deg, end.tilt_azimuth_deg) for end in ends]).T
        trace = replace(trace, tilt_deg=tilt, tilt_azimuth_deg=azimuth)
    if route is not None:
        trace = replace(trace, place=np.array([end.center for end in ends]))
    return trace if day is None else _in_daylight(trace, campaign, steps, day, background_rate)


def pieces_in(hours: float, rate: float) -> int:
    """Return the number of pieces of a trace, the steps of its progress."""
    return math.ceil(_frames_in(hours, rate) / _PIECE)


def _frames_in(hours: float, rate: float) -> int:
    return max(round(3600.0 * hours * rate), 1)


def _campaign(
    link: Link | Scenario,
    surface: MeshSource | None,
    down: Link | Literal["mirrored"] | None,
    run: StudyOptions,
) -> Campaign:
    """Return the campaign of one or both directions."""
    campaign = campaign_of(link, surface, "trace", run, fading=True, chains=DEFAULT_CHAINS)
    # thousands of frames are worth a smaller mesh
    campaign = campaign._replace(fine_patch=_LIT)
    # only an uplink between single ends has one mirror image
    if down == "mirrored":
        single = len(campaign.link.receivers) == 1 == len(campaign.link.transmitters)
        down = campaign.link.mirrored() if single and campaign.link.direction == "up" else None
    if down is None:
        # named by its direction, as files and provenance have it
        return campaign.for_link(campaign.link, "up")
    if isinstance(link, Scenario):  # the downlink is a link alone, without the file's sea and mesh
        # both directions cross one sea, whatever the downlink alone would choose
        if surface is None and isinstance(link.surface, MeshSource):
            surface = link.surface
        run["mesh"] = run.get("mesh") or link.meshing
    return both_directions(campaign, campaign_of(down, surface, "trace", run))


def _trace(campaign: Campaign, steps: Steps) -> ChannelTrace:
    """Return the gains of a campaign, computed in pieces of many frames."""
    n, links, receivers = len(steps.labels), len(campaign.links), campaign.columns
    pieces = range(0, n, _PIECE)
    setup = partial(_gains_of_piece, campaign.alone, steps)
    identity = {"steps": steps.identity(), "piece": _PIECE}
    samples, frames = np.zeros((links, receivers, SHIFTS)), []

    def shape(first: int) -> tuple[int]:
        return ((SHIFTS + 3 * min(_PIECE, n - first)) * links * receivers,)

    work = f"pieces of {_PIECE} frames"
    # all frames share chains, so that the mean has the error of the sums over frames at each shift
    for numbers in campaign.evaluate(setup, pieces, "frames", identity, shape, work):
        of_link = numbers.reshape(-1, links, receivers)
        frames.append(of_link[SHIFTS:].reshape(-1, 3, links, receivers))
        samples += np.moveaxis(of_link[:SHIFTS], 0, -1)
    at_times, mean_error = np.concatenate(frames), error_of_groups(samples / n, axis=-1)
    # a result of a single receiver has no axis of receivers
    ends = len(campaign.link.receivers)
    axis = slice(ends) if isinstance(campaign.link.receiver, tuple) else 0
    columns: list[Any] = [
        values[..., axis][()]
        for k in range(links)
        for values in (*at_times[:, :, k].swapaxes(0, 1), mean_error[k])
    ]
    origin = {name: campaign.provenance(link) for name, link in campaign.links.items()}
    trace = replace(ChannelTrace(steps.labels, *columns), provenance=origin)
    if not campaign.per_lamp:
        return trace
    by_lamp, stderr = (at_times[:, k, 0, ends:].reshape(n, -1, ends) for k in (0, 1))
    return replace(trace, gain_by_lamp=by_lamp, gain_by_lamp_stderr=stderr)


def _gains_of_piece(campaign: Campaign, steps: Steps) -> Callable[[int], Floats]:
    """Return a function from the first frame of a piece to its gains.

    Sums of each shift over the frames, shape (shifts, links, receivers), stand before gain, error
    and unscattered part of each frame, shape (frames, 3, links, receivers); all as one row.
    """
    evaluate, n = gains_over(campaign, steps), len(steps.labels)

    def piece(first: int) -> Floats:
        shifts, frames_of_piece = 0.0, []
        for i in range(first, min(first + _PIECE, n)):
            gain, direct = evaluate(i)
            frames_of_piece.append(
                [gain.mean(axis=-1), error_of_groups(gain, axis=-1), direct.mean(axis=-1)]
            )
            shifts = shifts + np.moveaxis(gain, -1, 0)
        return np.concatenate([np.ravel(shifts), np.ravel(frames_of_piece)])

    return piece


def _in_daylight(
    trace: ChannelTrace, campaign: Campaign, steps: Steps, day: Daylight, rate: float
) -> ChannelTrace:
    """Add the background of the first link at the frames next to the times of a lower rate."""
    times = steps.labels
    wanted = np.minimum(np.arange(0.0, times[-1] + 0.5 / rate, 1.0 / rate), times[-1])
    # rounding must not push a time behind its frame
    frames = np.unique(np.searchsorted(times, wanted - 1e-9))
    links = None if steps.links is None else [steps.links[i] for i in frames]
    # the frames have reported the progress of the whole trace
    single = campaign.for_link(campaign.link, "up")._replace(progress=None)
    lights = backgrounds(single, single.in_time(times[frames], links), day, _RAYS)
    radiance, stderr = np.array([(b.radiance, b.radiance_stderr) for b in lights]).T
    return replace(
        trace,
        background_time=times[frames],
        background_radiance=radiance,
        background_radiance_stderr=stderr,
    )
