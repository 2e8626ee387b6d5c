"""One thread that works for the newest move: every job has a ticket, and a newer one ends it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any


class Superseded(Exception):
    """A newer job has been submitted, or the worker closed."""


class Ticket:
    """Right of a job to go on while no newer one waits."""

    def __init__(self, worker: Worker, number: int) -> None:
        self._worker = worker
        self.number = number

    @property
    def newest(self) -> bool:
        """Whether no newer job has been submitted."""
        return self._worker.newest == self.number

    def check(self, *_: Any) -> None:
        """Return if the job may go on; takes and ignores the arguments of progress callbacks.

        Raises
        ------
        Superseded
            If a newer job has been submitted.
        """
        if not self.newest:
            raise Superseded

    def rest(self, seconds: float) -> None:
        """Wait for a newer job; return if there is none.

        Raises
        ------
        Superseded
            If a newer job has been submitted.
        """
        self._worker.wait_for_newer(self.number, seconds)
        self.check()


class Worker:
    """Thread that runs the newest submitted job and leaves out those submitted before it.

    Parameters
    ----------
    on_error : callable
        Called with any other exception of a job, in the thread.
    """

    def __init__(self, on_error: Callable[[Exception], None]) -> None:
        self._changed = threading.Condition()
        self._job: Callable[[Ticket], None] | None = None
        self._running = False
        self._closed = False
        self._on_error = on_error
        self.newest = 0
        self._thread = threading.Thread(target=self._run, name="meshtrace explorer", daemon=True)
        self._thread.start()

    def submit(self, job: Callable[[Ticket], None] | None) -> int:
        """Replace the waiting job, supersede the running one, and return the ticket's number.

        Without a job the thread rests.
        """
        with self._changed:
            self.newest += 1
            self._job = job
            self._changed.notify_all()
            return self.newest

    def supersede(self) -> None:
        """End the running job after its present step, and leave out the waiting one."""
        self.submit(None)

    def close(self) -> None:
        """End the thread after the present step of its job."""
        with self._changed:
            self._closed = True
        self.supersede()

    def join(self) -> None:
        """Wait until the thread has ended, after `close`."""
        self._thread.join()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until no job waits or runs, and return whether that is so."""
        with self._changed:
            return self._changed.wait_for(lambda: self._job is None and not self._running, timeout)

    def wait_for_newer(self, number: int, seconds: float) -> None:
        """Wait until a job newer than a ticket has been submitted, at most some seconds."""
        with self._changed:
            self._changed.wait_for(lambda: self.newest != number, seconds)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._job is not None or self._closed)
                if self._closed:
                    return
                job, self._job = self._job, None
                ticket, self._running = Ticket(self, self.newest), True
            assert job is not None
            try:
                job(ticket)
            except Superseded:
                pass
            except Exception as error:  # the thread outlives any job
                self._on_error(error)
            finally:
                with self._changed:
                    self._running = False
                    self._changed.notify_all()
