"""Processes that evaluate the jobs of a loop: this one and dask workers."""

from __future__ import annotations

import json
import logging
import math
import os
import signal
import tempfile
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from importlib.util import find_spec
from threading import Lock
from typing import TYPE_CHECKING, Any

from meshtrace.errors import Described, Refused, one_line, require_between, require_whole

if TYPE_CHECKING:
    import distributed

DEFAULT_TIMEOUT = 60.0
"""Seconds to wait for a scheduler and for a worker."""

_CHATTY = ("distributed", "tornado", "asyncio")  # loggers of lost connections
_START = 4.0  # [s] that a local cluster takes to start, with the imports of its workers
_POLL = 0.02  # [s] between looks for finished tasks
_ANSWER = 2.0  # [s] to wait for a result, or for the scheduler
_ALLOWED = "a running dask scheduler with workers; the same command resumes"


@dataclass(eq=False)
class Cluster:
    """Processes that evaluate the jobs of a loop.

    Parameters
    ----------
    workers : int or str, optional
        Processes on this machine, 1 is this process alone; or the address or file (.json) of a
        running dask scheduler. By default all cores, once the jobs last longer in this process
        than the start of others.
    timeout : float
        Seconds to wait for the scheduler, and for a worker.
    """

    workers: int | str | None = None
    timeout: float = DEFAULT_TIMEOUT
    _kept: ExitStack | None = field(default=None, init=False, repr=False)
    _client: distributed.Client | None = field(default=None, init=False, repr=False)
    _turn: Lock = field(default_factory=Lock, init=False, repr=False)

    def checked(self) -> Cluster:
        """Return the cluster; refuse numbers out of range, and to go on without dask."""
        if not isinstance(self.workers, str | None):
            require_whole(self.workers, 1, 1024, "workers")
        if self.workers != 1 and find_spec("distributed") is None:
            missing = 'workers: distributed is missing, pip install "meshtrace[batch]"'
            raise ModuleNotFoundError(missing, name="distributed")
        require_between(self.timeout, 0.0, math.inf, "timeout", "[)")
        return self

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Keep the workers that one loop needs for those that follow."""
        with ExitStack() as self._kept:
            try:
                yield
            finally:
                self._kept = self._client = None

    def map(
        self, setup: Callable[[], Callable[[Any], Any]], jobs: Sequence[Any]
    ) -> Generator[tuple[int, Any], None, None]:
        """Yield the number of each job as it finishes, and its result or its exception.

        Parameters
        ----------
        setup : callable
            Called once in each worker; returns the function of a job.
        jobs : sequence
            Jobs, plain data.

        Raises
        ------
        Refused
            If there is no scheduler or no worker, one is lost for good, or a worker would compute
            other numbers: another version of meshtrace, its kernels, numpy or numba.
        """
        here = 0
        for here, found in enumerate(self._here(setup, jobs), 1):
            yield here - 1, found
        if here < len(jobs):
            for i, found in self._elsewhere(setup, jobs[here:]):
                yield here + i, found

    def _here(
        self, setup: Callable[[], Callable[[Any], Any]], jobs: Sequence[Any]
    ) -> Iterator[Any]:
        """Yield the results, or exceptions, of the first jobs, evaluated in this process."""
        seconds = _START if self.workers is None else 0.0
        if not isinstance(self.workers, str):
            one = min(self.workers or os.cpu_count() or 1, len(jobs)) == 1
            seconds = math.inf if one else seconds
        if seconds == 0.0:
            return
        end, work = time.monotonic() + seconds, setup()
        for job in jobs:
            try:
                yield work(job)
            except Exception as error:
                yield error
            if time.monotonic() > end:
                return

    def _elsewhere(
        self, setup: Callable[[], Callable[[Any], Any]], jobs: Sequence[Any]
    ) -> Iterator[tuple[int, Any]]:
        """Yield the number of each job as a worker finishes it, and its result or exception."""
        import cloudpickle

        with self._connected() as client:
            work = {"setup": cloudpickle.dumps(setup), "expected": _environment()()}
            futures = client.map(_portable_job(), jobs, **work, pure=False)
            number = {future.key: i for i, future in enumerate(futures)}
            for n, (future, found) in enumerate(_finished(client, futures, self.timeout)):
                if isinstance(found, CancelledError):
                    raise _lost(client, n, len(jobs)) from found
                yield number[future.key], _checked(found)
                future.release()

    @contextmanager
    def _connected(self) -> Iterator[distributed.Client]:
        """Yield a client with workers, the one of other loops if it is kept."""
        import distributed  # noqa: F401  (its loggers exist from here on)

        with ExitStack() as own:
            with self._turn:  # loops of several threads share it, too
                client = self._client
                if client is None:
                    stack = self._kept or own
                    stack.enter_context(_quiet())
                    client = stack.enter_context(_client(self.workers, self.timeout))
                    _require_equal_workers(client, self.timeout)
                    self._client = client if self._kept else None
            yield client


class Restored:
    """Object that a worker makes from its inputs, once for all loops of a study."""

    inputs: tuple[Any, ...]

    @cached_property
    def _recipe(self) -> bytes:
        import cloudpickle

        recipe: bytes = cloudpickle.dumps(partial(type(self), *self.inputs))
        return recipe

    def __reduce__(self) -> Any:
        """Return the recipe, by which a worker knows the object again."""
        return prepared, (self._recipe,)


@lru_cache(4)  # two loops at once, and what each of them restores
def prepared(setup: bytes) -> Any:
    """Return the function of the jobs of a loop, or `Restored`, set up once in this process."""
    import cloudpickle

    return cloudpickle.loads(setup)()


def _finished(
    client: distributed.Client, futures: list[distributed.Future[Any]], timeout: float
) -> Iterator[tuple[distributed.Future[Any], Any]]:
    """Yield tasks as they finish, with result or error; refuse to wait for workers that are gone.

    A result lost with its worker before it arrives here is awaited again: the scheduler has
    another worker compute it.
    """
    import distributed

    done, without_worker = 0, 0.0
    completed = distributed.as_completed(futures, loop=client.loop)
    while not completed.is_empty():
        if completed.has_ready():
            future = next(completed)
            try:
                found = future.exception() if future.status == "error" else future.result(_ANSWER)
            except TimeoutError:
                completed.add(future)
                continue
            except Exception as error:
                found = error
            yield future, found
            done, without_worker = done + 1, 0.0
            continue
        time.sleep(_POLL)
        if client.status != "running":
            raise _lost(client, done, len(futures))
        without_worker = 0.0 if _has_workers(client) else without_worker + _POLL
        if without_worker > timeout:
            raise _lost(client, done, len(futures))


def _has_workers(client: distributed.Client) -> bool:
    """Return whether there is a worker, or the scheduler does not answer.

    `Client.scheduler_info` waits for a minute for a scheduler that has just died.
    """
    scheduler: Any = client.scheduler
    try:
        found = client.sync(scheduler.identity, n_workers=1, callback_timeout=_ANSWER)
    except (OSError, TimeoutError):
        return True
    return bool(found["workers"])


def _lost(client: distributed.Client, done: int, total: int) -> Refused:
    what = "no worker is left" if client.status == "running" else "the connection is lost"
    return Refused("workers", Described(f"{what}, {done} of {total} tasks finished"), _ALLOWED)


def _environment() -> Callable[[], dict[str, str]]:
    """Return a function that describes an environment; it is sent by value.

    A function of this module would be looked up in the package of the worker, which may be none.
    """

    def environment() -> dict[str, str]:
        try:
            from importlib.metadata import version

            from meshtrace.kernels.jit import sources

            found = {name: version(name) for name in ("meshtrace", "numpy", "numba")}
            return {**found, "kernels": sources().hex()}
        except Exception as error:
            return {"meshtrace": f"{type(error).__name__}: {error}"}

    return environment


def _portable_job() -> Callable[..., Any]:
    """Return a function that evaluates a job; it is sent by value."""
    describe = _environment()

    def run(job: Any, setup: bytes, expected: dict[str, str]) -> Any:
        found = describe()
        if found != expected:  # of a worker that came late
            return found
        from meshtrace.studies.cluster import prepared

        return prepared(setup)(job)

    return run


def _checked(result: Any) -> Any:
    """Return the result of a job; refuse a worker that described its environment instead."""
    if isinstance(result, dict):
        raise _other_worker("a worker that came late", result)
    return result


def _require_equal_workers(client: distributed.Client, timeout: float) -> None:
    """Refuse a cluster without workers, or with one of another environment."""
    import distributed

    try:
        client.wait_for_workers(1, timeout=timeout)
        environments = client.run(_environment(), on_error="return")
    except (TimeoutError, distributed.TimeoutError) as error:
        waited = Described(f"no worker within {timeout:g} s")
        raise Refused("workers", waited, _ALLOWED) from error
    except OSError as error:
        raise _lost(client, 0, 0) from error
    expected = _environment()()
    for address, found in environments.items():
        if found != expected:
            raise _other_worker(address, found)


def _other_worker(address: str, found: Any) -> Refused:
    expected = _environment()()
    there = found if isinstance(found, dict) else {"meshtrace": error_text(found)}
    name = next(name for name in expected if there.get(name) != expected[name])
    odd = Described(f"{address}: {name} {there.get(name, 'missing')} there, {expected[name]} here")
    return Refused("worker", odd, "the same versions of meshtrace, its kernels, numpy and numba")


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress the messages of distributed about lost connections."""
    names = [name for name in logging.root.manager.loggerDict if name.startswith(_CHATTY)]
    loggers = [logging.getLogger(name) for name in names]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


@contextmanager
def _client(workers: int | str | None, timeout: float) -> Iterator[distributed.Client]:
    """Yield a client of a running scheduler or of a new cluster on this machine."""
    import distributed

    if not isinstance(workers, str):
        # one thread each: a task fills one core, and dask keeps BLAS to one thread as well
        with (
            tempfile.TemporaryDirectory(prefix="meshtrace-", ignore_cleanup_errors=True) as scratch,
            distributed.LocalCluster(
                n_workers=workers or os.cpu_count() or 1,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address=None,
                local_directory=scratch,
                silence_logs=logging.ERROR,
            ) as cluster,
            distributed.Client(cluster, set_as_default=False) as client,
        ):

            class LeaveInterrupts(distributed.WorkerPlugin):
                """Plugin that ignores Ctrl-C on workers: the client handles it."""

                def setup(self, worker: distributed.Worker) -> None:
                    signal.signal(signal.SIGINT, signal.SIG_IGN)

            client.register_plugin(LeaveInterrupts())
            yield client
        return
    try:
        address = _address(workers, timeout)
        if not address.startswith("inproc://"):
            # a client of a wrong one writes a traceback when it is deleted
            distributed.comm.get_address_host_port(address, strict=True)
        client = distributed.Client(address, timeout=timeout, set_as_default=False)
    except (OSError, ValueError) as error:
        problem = Described(f"{workers!r}: {error_text(error)}")
        raise Refused("workers", problem, "the address of a running dask scheduler") from error
    with client:
        yield client


def _address(scheduler: str, timeout: float) -> str:
    """Return an address, or that in a scheduler's file written within a time."""
    if not scheduler.endswith(".json"):
        return scheduler
    end = time.monotonic() + timeout
    while not os.path.isfile(scheduler) and time.monotonic() < end:
        time.sleep(0.1)
    with open(scheduler, encoding="utf-8") as file:
        found = json.load(file)
    if not isinstance(found, dict) or not isinstance(found.get("address"), str):
        raise ValueError("no address in the file")
    return str(found["address"])


def error_text(error: BaseException) -> str:
    """Return an error as one line."""
    text = one_line(error)
    return text if isinstance(error, ValueError) and text else f"{type(error).__name__}: {text}"
