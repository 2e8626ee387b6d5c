"""Answers of the explorer in stages: gain and bits, rays, fading, map.

Each stage yields its answer several times, more precise each time, and calls `check` between its
steps, which raises where a newer move has made the answer useless.
"""

from __future__ import annotations

import asyncio
import math
import os
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, TypeVar

import numpy as np

from meshtrace.comms.background import warn_of_background, with_background
from meshtrace.comms.ook import OokLink
from meshtrace.comms.response import ChannelResponse
from meshtrace.engine.backward.background import background
from meshtrace.engine.paths import PhotonPaths, received_paths, record_paths
from meshtrace.engine.setup.ends import resolved_reach
from meshtrace.engine.setup.meshing import mesh_for
from meshtrace.engine.setup.options import Analog, Arrivals
from meshtrace.engine.simulate import simulate
from meshtrace.errors import Described, Refused, one_line
from meshtrace.explorer.controls import State
from meshtrace.fading import (
    Estimate,
    block_length,
    scintillation_index,
    scintillation_of_spectrum,
)
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, SurfaceModel
from meshtrace.models import Floats
from meshtrace.results.background import Background
from meshtrace.results.coverage import CoverageMap
from meshtrace.results.gain import GainResult
from meshtrace.results.impulse import impulse_response
from meshtrace.results.tallies import error_of_groups
from meshtrace.scenario import Scenario
from meshtrace.studies.campaign import Steps, campaign_of
from meshtrace.studies.coverage import coverage_map
from meshtrace.studies.designs.page import Design

Found = TypeVar("Found")
Check = Callable[..., None]

CHAINS = (1024, 8192)
"""Chains of the first and of the refined gain."""

PHOTONS = (20_000, 500_000)
"""Photons of both where only analog photons follow the link."""

BACKGROUND_RAYS = 1024

RAYS = 60
RAY_CHAINS = 1024

FADING_CHAINS = 1024
FADING_RATE = 8.0  # [Hz]
FADING_FRAMES = 96
DURATION = FADING_FRAMES / FADING_RATE
"""Time covered by a complete series [s]."""

_MOST_ERROR = 0.2  # of a gain of the series, which is left out beyond
_SHOWN_EVERY = 8  # frames, after which a part of the series is published

MAP_PHOTONS = (100_000, 1_000_000)
MAP_CELLS = 41

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
    light : str
        Name of the light above the sea; "" without.
    detector : OokLink or None
        Transmission through the channel with the background light; None before that is known, and
        for links with several receivers.
    ber : float
        Bit error rate of the detector.
    """

    gain: GainResult
    notes: tuple[str, ...] = ()
    light: str = ""
    detector: OokLink | None = None
    ber: float = math.nan


@dataclass(frozen=True)
class Fading:
    """Gain over a moving sea, as far as it is known.

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


@dataclass(frozen=True)
class Failed:
    """Reason for the lack of an answer of a stage."""

    reason: str


def gains(state: State, check: Check) -> Iterator[Signal]:
    """Yield the gain at the time of the state without and with bits, roughly, then refined.

    The refined pulses spread by the response of the channel to the same light, as in
    `link_performance`: its averaging window takes half a second to choose.
    """
    analog = isinstance(state.channel.run.estimator, Analog)
    run: Any = {"time": state.time, "progress": check}
    day, lit = state.scenario.daylight, None
    rough, fine = PHOTONS if analog else CHAINS
    for photons in (rough, fine):
        check()
        record = [Arrivals()] if photons == fine else []
        work = partial(simulate, state.channel, photons=photons, record=record, **run)
        gain, notes = _noted(work)
        yield Signal(gain, notes)
        if len(state.scenario.link.receivers) == 1:
            lit = lit or _noted(partial(_light, state))
            detector, more = _noted(partial(_detector, state, gain, lit[0]))
            ber = float(detector.ber(detector.received_power(float(gain.gain))))
            notes = notes + lit[1] + more
            yield Signal(gain, notes, day.light if day else "", detector, ber)


def _noted(work: Callable[[], Any]) -> tuple[Any, tuple[str, ...]]:
    """Return the result of some work and the texts of its warnings."""
    with _WARNINGS, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = work()
    return result, tuple(one_line(warning.message) for warning in caught)


def _light(state: State) -> Background | None:
    """Return the background light of a state; None in the dark."""
    if state.scenario.daylight is None:
        return None
    return background(state.scenario, time=state.time, photons=BACKGROUND_RAYS)


def _detector(state: State, gain: GainResult, found: Background | None) -> OokLink:
    """Return the transmission of a state behind the response of its channel, in its light."""
    detector = state.detector
    seen = unless_refused(lambda: impulse_response(gain))  # none of the rough gain or without light
    if detector.response is None and seen is not None:
        response = ChannelResponse.of(seen.delay, seen.weight, seen.angle)
        detector = detector.replace(response=response)
    if found is None:
        return detector
    detector = with_background(detector, found)
    warn_of_background(detector, found)
    return detector


def unless_refused(work: Callable[[], Found]) -> Found | None:
    """Return the result of some work; None if it is refused."""
    try:
        return work()
    except Refused:
        return None


def rays(state: State, check: Check) -> Iterator[PhotonPaths]:
    """Yield paths of received light at the time of the state.

    Where only analog photons follow the link they are paths of any light.
    """
    check()
    case = state.channel.case()
    meshing = case.meshing.replace(time=state.time)
    analog = isinstance(case.run.estimator, Analog)
    reach = resolved_reach(case.link, case.run.estimator)
    mesh, _ = mesh_for(case.link, case.surface, meshing, reach)
    check()
    if analog:
        yield record_paths(case.link, mesh, RAYS, case.run.seed, meshing.normals, 64)
        return
    yield received_paths(case.link, mesh, RAYS, case.run.seed, meshing.normals, RAY_CHAINS)


def fading(state: State, check: Check) -> Iterator[Fading]:
    """Yield the gain over the moving sea from time 0, in parts, then with its statistics.

    Raises
    ------
    Refused
        If the surface is no sea model, or only analog photons follow the link.
    """
    campaign = campaign_of(state.channel, fading=True, photons=FADING_CHAINS)
    sea = campaign.surface
    if not isinstance(sea, SurfaceModel):
        raise Refused("surface", Described(type(sea).__name__), "a sea that moves")
    times = np.arange(FADING_FRAMES) / FADING_RATE

    def surface(i: int) -> tuple[MeshSource, float]:
        check()
        return sea, float(times[i])

    gain = np.empty(FADING_FRAMES)
    for i, found in enumerate(campaign.each(Steps("time", times, surface))):
        by_shift = found[0, 0, 0]
        mean, error = by_shift.mean(), error_of_groups(by_shift)
        gain[i] = np.nan if error > _MOST_ERROR * mean else mean
        if (i + 1) % _SHOWN_EVERY == 0 and i + 1 < FADING_FRAMES:
            yield _series(times[: i + 1], gain[: i + 1])
    series = _series(times, gain)
    g = series.gain
    index = unless_refused(lambda: scintillation_index(g, block=block_length(g), resamples=399))
    yield replace(series, index=index, index_of_all=index_of_all(campaign.link, sea))


def _series(times: Floats, gain: Floats) -> Fading:
    """Return the gains that are certain enough."""
    kept = np.isfinite(gain)
    return Fading(times[kept], gain[kept], int((~kept).sum()))


def index_of_all(link: Link, sea: SurfaceModel) -> float | None:
    """Return the closed form over all waves; None off the axis and without a spectrum."""
    short = getattr(sea, "short_waves", sea)
    return unless_refused(lambda: scintillation_of_spectrum(link, short, heights=True))


def coverage(state: State, check: Check) -> Iterator[CoverageMap]:
    """Yield the map of the gain in the plane of the receiver, roughly, then refined."""
    link = state.channel.link
    levels = [t.center[2] for t in link.transmitters] + [r.center[2] for r in link.receivers]
    extent = 0.5 * (max(levels) - min(levels))
    for photons in MAP_PHOTONS:
        check()
        yield coverage_map(
            state.channel, extent=extent, step=2.0 * extent / MAP_CELLS, times=(state.time,),
            photons=photons, progress=check,
        )  # fmt: skip


_DESIGN = """
import sys
import meshtrace as mt
try:
    scenario = mt.Scenario.load(sys.argv[1], trust=True)
    mt.design(scenario).save(sys.argv[2])
except mt.Refused as error:
    sys.exit(str(error))
"""


async def design_of(scenario: Scenario) -> Design:
    """Return `mt.design(scenario)` of another process, which ends if this task is cancelled.

    Raises
    ------
    Refused
        If the design is refused or the process fails, by the last line of its error.
    """
    with TemporaryDirectory(prefix="meshtrace-") as folder:
        link, made = Path(folder, "link.toml"), Path(folder, "design.nc")
        link.write_text(scenario.to_toml(), encoding="utf-8")
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-c", _DESIGN, str(link), str(made),
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE,
        )  # fmt: skip
        try:
            _, said = await process.communicate()
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        if process.returncode:
            lines = said.decode(errors="replace").strip().splitlines() or ["ended without a word"]
            raise Refused("design", Described(lines[-1]), "a link that can be designed")
        return Design.load(made)
