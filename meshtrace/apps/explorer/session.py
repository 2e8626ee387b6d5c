"""Session of a user of the explorer: its state, and a thread that answers the newest move.

The thread takes the stages in the order of `STAGES`. A newer move supersedes its work at the next
`check` of a stage.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent import futures
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

from meshtrace.apps.explorer.controls import BITS_ALONE, State, begun_at
from meshtrace.apps.explorer.influences import influences
from meshtrace.apps.explorer.stages import Check, coverage, fading, gains, rays
from meshtrace.errors import Refused
from meshtrace.scenario import Scenario


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


class Failed(str):
    """Reason for the lack of an answer of a stage."""


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
