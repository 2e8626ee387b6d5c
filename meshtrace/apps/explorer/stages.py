"""Answers of the explorer in stages: gain and bits, rays, fading, map and design.

Each stage yields its answer several times, more precise each time, and calls `check` between its
steps, which raises where a newer move has made the answer useless.
"""

from __future__ import annotations

import asyncio
import math
import os
import threading
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, TypeVar

import numpy as np

from meshtrace import (
    Analog,
    Arrivals,
    Background,
    CoverageMap,
    GainResult,
    MeshSource,
    PhotonPaths,
    SurfaceModel,
    background,
    impulse_response,
    simulate,
    trace_paths,
)
from meshtrace.apps.designs.page import Design
from meshtrace.apps.explorer.controls import State, begun_at
from meshtrace.comms import ChannelResponse, OokLink
from meshtrace.comms.background import warn_of_background, with_background
from meshtrace.errors import Described, Refused, one_line
from meshtrace.fading import Estimate, block_length, scintillation_index, scintillation_of_spectrum
from meshtrace.link import Link
from meshtrace.models import Floats
from meshtrace.parallel import import_path, python_start
from meshtrace.results.tallies import error_of_groups
from meshtrace.scenario import Scenario
from meshtrace.studies import coverage_map
from meshtrace.studies.campaign import Steps, campaign_of
from meshtrace.uav import tilt_outage_note

Result = TypeVar("Result")
Check = Callable[..., None]

CHAINS = (1024, 8192)
"""Chains of the first and of the refined gain."""

PHOTONS = (20_000, 500_000)
"""Photons of both where only analog photons follow the link."""

BACKGROUND_RAYS = 1024
"""Rays traced backward from the receiver, for the light of sun and sky."""

RAYS = 60
"""Photon paths in the picture."""

# Tuned: precision and length of the series against its cost.
FADING_CHAINS = 1024
FADING_RATE = 8.0  # frames per second of the sea [Hz]
FADING_FRAMES = 96
DURATION = FADING_FRAMES / FADING_RATE
"""Time covered by a complete series [s]."""

_SKIPPED = 3  # frames from one of the times of `quiet_time` to the next
_MOST_ERROR = 0.2  # largest relative standard error of a gain in the series [1]
_SHOWN_EVERY = 8  # frames between two answers: a part of the series is shown each time

MAP_PHOTONS = (100_000, 1_000_000)
MAP_CELLS = 41  # along an axis; odd: one is in the middle

LIMIT = 1e-3
"""Bit error rate that the margin refers to."""

_WARNINGS = threading.Lock()  # the list of caught warnings belongs to the process


class Signal(NamedTuple):
    """Gain of the first receiver, and the transmission over it.

    Attributes
    ----------
    gain : GainResult
        Result of the simulation.
    notes : tuple of str
        Warnings.
    daylight : str
        Name of the light above the sea; "" without.
    detector : OokLink or None
        Transmission through the channel with the background light; None before that is known, and
        for links with several receivers.
    ber : float
        Bit error rate of the detector.
    """

    gain: GainResult
    notes: tuple[str, ...] = ()
    daylight: str = ""
    detector: OokLink | None = None
    ber: float = math.nan


@dataclass(frozen=True)
class Fading:
    """Gain over a moving sea, complete or up to the present frame.

    Attributes
    ----------
    time, gain : ndarray, shape (n,)
        Times [s] and gains.
    left_out : int
        Number of gains left out, with a relative standard error above 20 %.
    index : Estimate or None
        Scintillation index, of the complete series.
    index_of_all : float or None
        Scintillation index of unscattered light over all waves, in closed form.
    """

    time: Floats
    gain: Floats
    left_out: int = 0
    index: Estimate | None = None
    index_of_all: float | None = None


def gains(state: State, check: Check) -> Iterator[Signal]:
    """Compute gain and bit error rate at the time of the state; yield a rough, then a fine answer.

    The fine answer has pulses spread by the response of the channel, from the arrivals of the same
    light, as in `link_performance`; to choose their averaging window takes half a second.
    """
    analog = isinstance(state.channel.run.estimator, Analog)
    day, sky_light = state.scenario.daylight, None
    rough, fine = PHOTONS if analog else CHAINS
    for photons in (rough, fine):
        check()
        # the rough gain shall be fast, and its few arrivals would make a noisy response
        record = [Arrivals()] if photons == fine else []
        gain, notes = with_warnings(partial(
            simulate, state.channel, time=state.time, photons=photons, record=record,
            progress=check,
        ))  # fmt: skip
        yield Signal(gain, notes)
        if len(state.scenario.link.receivers) == 1:
            sky_light = sky_light or with_warnings(partial(light_above, state))
            detector, more = with_warnings(partial(_detector, state, gain, sky_light[0]))
            ber = float(detector.ber(detector.received_power(float(gain.gain))))
            notes = notes + sky_light[1] + more + _tilt_notes(state)
            yield Signal(gain, notes, day.light if day else "", detector, ber)


def with_warnings(work: Callable[[], Any]) -> tuple[Any, tuple[str, ...]]:
    """Call a function; return its result and the texts of its warnings."""
    # the page shows them as notes beside the gain; none goes to the console
    with _WARNINGS, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = work()
    return result, tuple(one_line(warning.message) for warning in caught)


def light_above(state: State) -> Background | None:
    """Return the background light of a state; None without daylight."""
    if state.scenario.daylight is None:
        return None
    return background(state.scenario, time=state.time, photons=BACKGROUND_RAYS)


def _detector(state: State, gain: GainResult, sky_light: Background | None) -> OokLink:
    """Return the receiver of a state with channel response and background light."""
    detector = state.detector
    # refused for the rough gain, which has no arrivals, and where no light arrives
    arrivals = unless_refused(lambda: impulse_response(gain))
    if detector.response is None and arrivals is not None:
        response = ChannelResponse.from_arrivals(arrivals.delay, arrivals.weight, arrivals.angle)
        detector = detector.replace(response=response)
    if sky_light is None:
        return detector
    detector = with_background(detector, sky_light)
    warn_of_background(detector, sky_light)
    return detector


def _tilt_notes(state: State) -> tuple[str, ...]:
    """Describe the tilts of the aircraft that leave the field of view, as in `link_performance`.

    The page shows the gain at the tilt in the mean wind, which says nothing about gusts.
    """
    campaign = campaign_of(state.channel)
    flight = campaign.flight(None)
    if flight is None:
        return ()
    fov_deg = state.scenario.link.only_receiver.fov_deg
    note = tilt_outage_note(campaign.tilt_factors(flight, fov_deg).outage)
    return (note,) if note else ()


def unless_refused(work: Callable[[], Result]) -> Result | None:
    """Call a function; return None if it raises `Refused`."""
    try:
        return work()
    except Refused:
        return None


def rays(state: State, check: Check) -> Iterator[PhotonPaths]:
    """Trace paths of received light at the time of the state.

    Where only photons follow the link they are paths of any light.
    """
    check()
    scenario = begun_at(state.channel, state.time)
    mesh, run = scenario.mesh(), scenario.run
    check()
    # analog photons hit an aperture so seldom that paths of any light are shown
    received = not isinstance(run.estimator, Analog)
    normals = scenario.meshing.normals
    yield trace_paths(
        scenario.link, mesh, RAYS, received_only=received, seed=run.seed, normals=normals
    )


def fading(state: State, check: Check) -> Iterator[Fading]:
    """Compute the gain over the moving sea from time 0; yield it in parts, then with statistics.

    Raises
    ------
    Refused
        If the surface is no sea model, or only analog photons follow the link.
    """
    times, gain = np.arange(FADING_FRAMES) / FADING_RATE, np.empty(FADING_FRAMES)
    for i, gain[i] in enumerate(_gains_at(state, times, check)):
        if (i + 1) % _SHOWN_EVERY == 0 and i + 1 < FADING_FRAMES:
            yield _series(times[: i + 1], gain[: i + 1])
    series = _series(times, gain)
    g = series.gain
    index = unless_refused(lambda: scintillation_index(g, block=block_length(g), resamples=399))
    of_all = index_of_all(state.channel.link, state.channel.surface)
    yield replace(series, index=index, index_of_all=of_all)


def _gains_at(state: State, times: Floats, check: Check) -> Iterator[float]:
    """Yield the gain at each of the times; nan where its error is too large."""
    campaign = campaign_of(state.channel, run={"photons": FADING_CHAINS}, fading=True)
    sea = campaign.surface
    if not isinstance(sea, SurfaceModel):
        raise Refused("surface", Described(type(sea).__name__), "a sea that moves")

    def surface(i: int) -> tuple[MeshSource, float]:
        check()
        return sea, float(times[i])

    for gains in campaign.each(Steps("time", times, surface)):
        # (gain and unscattered part, links, receivers, shifts)
        gain_of_shift = gains[0, 0, 0]
        mean, error = float(gain_of_shift.mean()), error_of_groups(gain_of_shift)
        # noise of few chains would look like fading
        yield math.nan if error > _MOST_ERROR * mean else mean


def quiet_time(scenario: Scenario) -> float:
    """Return the time of the sea at which the explorer begins [s].

    That of a file if it is not 0. Else the one of 32 times of the series of gains whose gain is
    nearest to their mean: at time 0 a sea may focus the light to twice of it.
    """
    times = np.arange(0, FADING_FRAMES, _SKIPPED) / FADING_RATE
    if scenario.meshing.time != 0.0:
        return scenario.meshing.time
    try:
        gain = np.array([*_gains_at(State(scenario), times, lambda *_: None)])
    except Refused:  # a surface that does not move, or photons alone
        return 0.0
    off = np.abs(gain - np.nanmean(gain)) if np.isfinite(gain).any() else np.zeros(1)
    return float(times[np.nanargmin(off)])


def _series(times: Floats, gain: Floats) -> Fading:
    """Return the series without gains of large error, which are marked by nan."""
    precise = np.isfinite(gain)
    return Fading(times[precise], gain[precise], int((~precise).sum()))


def index_of_all(link: Link, sea: SurfaceModel) -> float | None:
    """Return the closed form of the scintillation index over all waves of a sea.

    None where it does not hold: for a receiver off the axis, or a sea without a spectrum.
    """
    # the slope variance of an omega^-5 tail diverges, and with it the index: the sea that has
    # `short_waves` stands in
    short = getattr(sea, "short_waves", sea)
    return unless_refused(lambda: scintillation_of_spectrum(link, short, heights=True))


def coverage(state: State, check: Check) -> Iterator[CoverageMap]:
    """Compute the map of the gain in the plane of the receiver; yield a rough, then a fine one."""
    link = state.channel.link
    # a square as wide as the height from the lowest end of the link, or the sea, to the highest [m]
    heights = (
        [0.0] + [t.center[2] for t in link.transmitters] + [r.center[2] for r in link.receivers]
    )
    half = 0.5 * (max(heights) - min(heights))
    for photons in MAP_PHOTONS:
        check()
        yield coverage_map(
            state.channel, extent=half, step=2.0 * half / MAP_CELLS, times=(state.time,),
            photons=photons, progress=check,
        )  # fmt: skip


# trusted: the link has been loaded, with the code that it names, when the explorer started
_DESIGN = ("-m", "meshtrace", "design", "--trust")


async def design_of(scenario: Scenario) -> Design:
    """Compute `mt.design(scenario)` in another process, which ends if this task is cancelled.

    Raises
    ------
    Refused
        If the design is refused or the process fails, by the last line of its error.
    """
    with TemporaryDirectory(prefix="meshtrace-") as folder:
        link, result_file = Path(folder, "link.toml"), Path(folder, "design.nc")
        link.write_text(scenario.to_toml(), encoding="utf-8")
        environment = dict(os.environ) | {"PYTHONPATH": import_path()}
        options = str(link), "-o", str(result_file)
        command, env = python_start(*_DESIGN, *options, env=environment)
        process = await asyncio.create_subprocess_exec(
            *command, env=env,
            stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE,
        )  # fmt: skip
        try:
            # no bound: the page counts the seconds, and its button cancels this task
            _, stderr = await process.communicate()
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()  # ends with the signal, also of a stopped process
        if process.returncode:
            lines = stderr.decode(errors="replace").strip().splitlines() or ["ended without a word"]
            last_line = Described(lines[-1].removeprefix("error: "))
            raise Refused("design", last_line, "a link that can be designed")
        return Design.load(result_file)
