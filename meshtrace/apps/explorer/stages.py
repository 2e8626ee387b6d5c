"""Answers of the explorer in stages: gain and bits, rays, fading, map; the session of a user.

Each stage yields its answer several times, more precise each time, and calls `check` between its
steps, which raises where a newer move has made the answer useless. The session has the state of its
user and a thread that answers the newest move.
"""

from __future__ import annotations

import asyncio
import math
import os
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent import futures
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
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
    compare,
    impulse_response,
    simulate,
    trace_paths,
)
from meshtrace.apps.designs.page import Design
from meshtrace.apps.explorer.controls import BITS_ALONE, State, begun_at
from meshtrace.comms import ChannelResponse, OokLink
from meshtrace.comms.background import warn_of_background, with_background
from meshtrace.comms.budget import link_budget
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

INPUTS = (
    "power",
    "pde",
    "bit_rate",
    "filter",
    "depth",
    "a",
    "half_angle",
    "fov",
    "height",
    "wind",
    "wavelength",
    "b",
    "tilt",
    "offset_x",
    "chlorophyll",
    "aperture",
    "fetch",
)
"""Controls whose influence on the margin is computed; those that matter seldom come last."""

STEPS = {"wind": 1.0, "offset_x": 1.0, "tilt": 5.0, "wavelength": 10.0}
"""Steps of inputs whose value may be 0, in the units of the page; of others it is 10 %."""

_COMPARED = (1024, 50_000)  # chains and photons of a pair of gains, of a tenth of a second
_OF_SEA = ("wind", "fetch")  # inputs that change the waves themselves, and with them each crest
_SEAS = 8  # over which their influence is averaged: over one sea it would be that of its phases
_LONGEST = 20.0  # after which no further input is tried [s]

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


class Influence(NamedTuple):
    """Change of the margin with a step of one control.

    Attributes
    ----------
    name : str
        Name of the control.
    change, stderr : float
        Change of the optical margin and its standard error [dB].
    """

    name: str
    change: float
    stderr: float


class Failed(str):
    """Reason for the lack of an answer of a stage."""


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
        gain, notes = _with_warnings(partial(
            simulate, state.channel, time=state.time, photons=photons, record=record,
            progress=check,
        ))  # fmt: skip
        yield Signal(gain, notes)
        if len(state.scenario.link.receivers) == 1:
            sky_light = sky_light or _with_warnings(partial(_light, state))
            detector, more = _with_warnings(partial(_detector, state, gain, sky_light[0]))
            ber = float(detector.ber(detector.received_power(float(gain.gain))))
            notes = notes + sky_light[1] + more + _tilt_notes(state)
            yield Signal(gain, notes, day.light if day else "", detector, ber)


def _with_warnings(work: Callable[[], Any]) -> tuple[Any, tuple[str, ...]]:
    """Call a function; return its result and the texts of its warnings."""
    # the page shows them as notes beside the gain; none goes to the console
    with _WARNINGS, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = work()
    return result, tuple(one_line(warning.message) for warning in caught)


def _light(state: State) -> Background | None:
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


def influences(state: State, check: Check) -> Iterator[tuple[Influence, ...]]:
    """Compute the change of the margin with a step of each input; yield the largest first.

    The change of the gain is that of `compare`, with common chains and seas. `sensitivities` has no
    derivative by the wind over a sea whose band follows it, nor of links without chains. Pulses
    spread as at the state itself.
    """
    *_, signal = gains(state, check)
    changes, end = [], time.monotonic() + _LONGEST
    if signal.detector is not None and signal.gain.gains[0] > 0.0:
        sky_light = _with_warnings(partial(_light, state))[0]
        for name in INPUTS:
            check()
            value = state.values[name]
            if value is None or time.monotonic() > end:
                continue
            wanted = {name: value + STEPS.get(name, 0.1 * value)}
            moved = unless_refused(partial(state.moved, wanted))
            if moved is None or moved.moves == state.moves:
                continue
            pair = partial(_influence, name, state, moved, signal, sky_light, check)
            influence = _with_warnings(partial(unless_refused, pair))[0]
            if influence is not None and math.isfinite(influence.change + influence.stderr):
                changes.append(influence)
    yield tuple(sorted(changes, key=lambda influence: -abs(influence.change)))


def _influence(
    name: str,
    state: State,
    moved: State,
    signal: Signal,
    sky_light: Background | None,
    check: Check,
) -> Influence:
    """Return the change of the margin from one state to another, which differ in one control."""
    change = error = 0.0
    if name not in BITS_ALONE:
        channels = {"now": state.channel, "moved": moved.channel}
        pair = compare(
            {key: begun_at(channel, state.time) for key, channel in channels.items()},
            photons=_COMPARED[isinstance(state.channel.run.estimator, Analog)],
            realizations=_SEAS if name in _OF_SEA else 1, progress=check,
        )  # fmt: skip
        change, error = float(pair.ratio_db[1]), float(pair.ratio_db_stderr[1])
        sky_light = _light(moved)

    def margin(detector: OokLink, more: float = 0.0) -> float:
        """Return the margin at the gain of the present state, under a share more of light."""
        detector = detector.replace(background_rate=(1.0 + more) * detector.background_rate)
        return float(link_budget(detector, signal.gain.gain, LIMIT).margin_optical_db)

    assert signal.detector is not None
    detector = moved.detector
    if detector.response is None:
        detector = detector.replace(response=signal.detector.response)
    if sky_light is not None:
        detector = with_background(detector, sky_light)
        if name not in BITS_ALONE:  # two backgrounds, taken for independent
            share = math.sqrt(2.0) * float(
                sky_light.radiance_stderr / max(sky_light.radiance, 1e-300)
            )
            error = math.hypot(error, margin(detector, share) - margin(detector))
    return Influence(name, change + margin(detector) - margin(signal.detector), error)


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


class Superseded(Exception):
    """A newer job has been submitted, or the worker closed."""


class Ticket(threading.Event):
    """Event set when a newer job waits; the running job stops at its next check."""

    def check(self, *_: Any) -> None:
        """Check that the job may continue; ignore the arguments of progress callbacks.

        Raises
        ------
        Superseded
            If a newer job has been submitted.
        """
        self.rest(0.0)

    def rest(self, seconds: float) -> None:
        """Wait for a newer job, if one comes.

        Raises
        ------
        Superseded
            If a newer job has been submitted.
        """
        if self.wait(seconds):
            raise Superseded


class Worker:
    """Thread that runs the newest submitted job and drops older ones.

    Parameters
    ----------
    on_error : callable
        Called with any other exception of a job, in the thread.
    """

    def __init__(self, on_error: Callable[[Exception], None]) -> None:
        self._on_error = on_error
        self._pool = ThreadPoolExecutor(1, "meshtrace explorer")
        self._lock = threading.RLock()
        self._ticket = Ticket()
        self._newest: Future[None] = Future()
        self._newest.set_result(None)

    def submit(self, job: Callable[[Ticket], None]) -> None:
        """Replace the waiting job and stop the running one; do nothing after `close`."""
        with self._lock, suppress(RuntimeError):
            self.supersede()
            self._newest = self._pool.submit(self._run, job, self._ticket)

    def supersede(self) -> None:
        """Stop the running job after its present step and drop the waiting one."""
        with self._lock:
            self._ticket.set()
            self._newest.cancel()
            self._ticket = Ticket()

    def close(self) -> None:
        """Stop the thread after the present step of its job."""
        self.supersede()
        self._pool.shutdown(wait=False)

    def join(self) -> None:
        """Wait until the thread has ended, after `close`: the interpreter must not end before."""
        self._pool.shutdown()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until no job is pending or running; return False if the timeout comes first."""
        return not futures.wait([self._newest], timeout).not_done

    def _run(self, job: Callable[[Ticket], None], ticket: Ticket) -> None:
        try:
            ticket.check()
            job(ticket)
        except Superseded:
            pass
        except Exception as error:  # the thread outlives any job
            self._on_error(error)


_REST = 0.15  # pause after the first gain, in which the page draws gain and scene [s]


class Answer(NamedTuple):
    """Latest answer of a stage: value, key of its state, completeness."""

    value: Any
    key: Any
    complete: bool


STAGES: dict[str, Callable[[State, Check], Iterator[Any]]] = {
    "gain": gains,
    "rays": rays,
    "fading": fading,
    "influences": influences,
    "map": coverage,
}
"""Stages in the order of the work, as functions that yield their answers for a state; the map is
made on demand."""


class Session(Worker):
    """State of one user of the explorer, with a thread that answers the latest move.

    Parameters
    ----------
    scenario : Scenario
        Link, sea and options at the start.
    on_answer : callable, optional
        Called with the name of a stage, "" for the end of the work, in the thread of the work.

    Notes
    -----
    A move supersedes the work on the state before it. Each stage is worked on once for a state;
    answers that do not depend on a move stay.
    """

    def __init__(
        self, scenario: Scenario, on_answer: Callable[[str], None] = lambda name: None
    ) -> None:
        self._state = State(scenario, time=scenario.meshing.time)
        self._answers: dict[str, Answer] = {}
        self._on_answer = on_answer
        self._map_wanted = False
        self.working = ""
        super().__init__(self._fail)

    @property
    def state(self) -> State:
        """The state of the newest move."""
        return self._state

    def move(self, values: Mapping[str, Any], answer: bool = True) -> State:
        """Move controls and start to answer, or leave that to `answer_now`; return the new state.

        Raises
        ------
        Refused
            If a value is not allowed; the state stays.
        """
        state = self._state.moved(values)
        if state != self._state:
            self._state, self._map_wanted = state, False
            self.supersede()
            self.working = next(iter(STAGES))
            if answer:
                self.answer_now()
        return state

    def begin(self, initial: Scenario) -> None:
        """Return to a link at the start, at the same time, without new work."""
        self._state, self._map_wanted = State(initial, time=self._state.time), False

    def begin_at(self, time: float) -> None:
        """Let the present link start at a time [s], at which its sea stands unless it was moved."""
        state, initial = self._state, self._state.initial
        moved = state.time != initial.meshing.time
        initial, time = begun_at(initial, time), state.time if moved else time
        self._state = replace(state, initial=initial, time=time)

    def show_time(self, time: float) -> State:
        """Change the time of the sea without new work, as in a running sea."""
        self._state = self._state.at(time)
        return self._state

    def answer_now(self) -> None:
        """Start to answer the present state: the first, or one after a change without answer."""
        state, with_map = self._state, self._map_wanted
        self.submit(lambda ticket: self._work(ticket, state, with_map))

    def make_map(self) -> None:
        """Compute the map of the present state after its other answers."""
        self._map_wanted = True
        self.answer_now()

    def answer(self, name: str) -> Any:
        """Return the latest answer of a stage; None before the first."""
        answer = self._answers.get(name)
        return None if answer is None else answer.value

    def fresh(self, name: str) -> bool:
        """Return whether the latest answer of a stage belongs to the present state."""
        answer = self._answers.get(name)
        return answer is not None and answer.key == _key(name, self._state)

    def _work(self, ticket: Ticket, state: State, with_map: bool) -> None:
        """Answer a state stage by stage in the thread; skip complete stages."""
        for name, answers in STAGES.items():
            latest, key = self._answers.get(name), _key(name, state)
            if (name == "map" and not with_map) or (
                latest and latest.complete and latest.key == key
            ):
                continue
            self.working = name
            self._publish(ticket, name, None)
            answer = None
            try:
                for value in answers(state, ticket.check):
                    first = answer is None and name == "gain"
                    answer = Answer(value, key, False)
                    self._publish(ticket, name, answer)
                    if first:
                        ticket.rest(_REST)
            except Refused as error:
                answer = Answer(Failed(str(error)), key, False)
            if answer is not None:
                self._publish(ticket, name, answer._replace(complete=True))
        ticket.check()
        self.working = ""
        self._on_answer("")

    def _publish(self, ticket: Ticket, name: str, answer: Answer | None) -> None:
        """Store an answer of a stage, unless superseded, and report the stage."""
        with self._lock:
            ticket.check()
            if answer is not None:
                self._answers[name] = answer
        self._on_answer(name)

    def _fail(self, error: Exception) -> None:
        """Publish an internal error as the answer of its stage."""
        name = self.working or "gain"
        reason = Failed(f"{type(error).__name__}: {error}")
        self._answers[name] = Answer(reason, _key(name, self._state), True)
        self.working = ""
        self._on_answer(name)


_WITH_BITS = ("gain", "influences")


def _key(stage: str, state: State) -> Any:
    """Return the part of a state that the answers of a stage depend on."""
    # gain and influences show bits, and the series begins at time 0 in any case
    moves = tuple(m for m in state.moves if stage in _WITH_BITS or m[0] not in BITS_ALONE)
    return moves, None if stage == "fading" else state.time, state.initial
