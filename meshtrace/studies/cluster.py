"""Processes that evaluate the jobs of a loop: this one and dask workers."""

from __future__ import annotations

import json
import logging
import math
import os
import signal
import tempfile
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from importlib.util import find_spec
from itertools import islice
from queue import SimpleQueue
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Any

from meshtrace.errors import Described, Refused, extra, one_line, require_between, require_whole
from meshtrace.parallel import cores, held, safe_processes

if TYPE_CHECKING:
    import distributed

DEFAULT_TIMEOUT = 60.0
"""Seconds to wait for a scheduler and for a worker."""

_CHATTY = ("distributed", "tornado", "asyncio")  # loggers of lost connections
_PATIENCE = 2.0  # [s] of work in this process before others start, which takes as long
_AHEAD = 2  # jobs that a process on this machine has or waits with
_BROKEN = -1  # number of a job that stands for the loss of all workers
_POLL = 0.02  # [s] between looks for finished tasks
_ANSWER = 2.0  # [s] to wait for a result, or for the scheduler
_SILENCE = 60.0  # [s] without an answer after which a scheduler is lost; a busy one takes seconds
_ALLOWED = "a running dask scheduler with workers; the same command resumes"


@dataclass(eq=False)
class Cluster:
    """Processes that evaluate the jobs of a loop.

    Parameters
    ----------
    workers : int or str, optional
        Processes on this machine, of which this is one; or the address or file (.json) of a running
        dask scheduler. By default one for each core, if fewer than half of the jobs are finished
        after two seconds.
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
            with extra("batch", "workers"):
                raise ModuleNotFoundError(name="distributed")
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
            Called once in each process; returns the function of a job.
        jobs : sequence
            Jobs, plain data.

        Raises
        ------
        Refused
            If there is no scheduler or no worker, one is lost for good, or a worker would compute
            other numbers: another version of meshtrace, its kernels, numpy or numba.
        """
        waiting = deque(enumerate(jobs))
        if isinstance(self.workers, str):
            if waiting:
                yield from self._elsewhere(setup, waiting, len(waiting), Event())
            return
        others = (self.workers or cores()) - 1
        alone = min(others, len(waiting) - 1) < 1
        yield from _evaluated(setup, waiting) if alone else self._shared(setup, waiting, others)

    def _shared(
        self,
        setup: Callable[[], Callable[[Any], Any]],
        waiting: deque[tuple[int, Any]],
        others: int,
    ) -> Iterator[tuple[int, Any]]:
        """Yield the results of jobs of this process and, once they take longer, of others."""
        total, ended = len(waiting), Event()
        finished: SimpleQueue[tuple[int, Any]] = SimpleQueue()

        def beside() -> None:
            try:
                patience = 0.0 if self.workers or self._client else _PATIENCE
                if ended.wait(patience) or 2 * len(waiting) < total:
                    return
                for result in self._elsewhere(setup, waiting, _AHEAD * others, ended):
                    finished.put(result)
            except Exception as error:
                finished.put((_BROKEN, error))

        def merged() -> Iterator[tuple[int, Any]]:
            for result in _evaluated(setup, waiting):
                yield result
                while not finished.empty():
                    yield finished.get()
            while True:
                yield finished.get()

        thread = Thread(target=beside, name="workers")
        thread.start()
        try:
            for i, result in islice(merged(), total):
                if i == _BROKEN:
                    raise result
                yield i, result
        finally:
            ended.set()
            thread.join()  # ends within dask's bounds of the end of its processes, seconds

    def _elsewhere(
        self,
        setup: Callable[[], Callable[[Any], Any]],
        waiting: deque[tuple[int, Any]],
        ahead: int,
        ended: Event,
    ) -> Iterator[tuple[int, Any]]:
        """Yield the number of each job as a worker finishes it, and its result or exception.

        Workers have up to `ahead` jobs at a time, until none is left or the event is set.
        """
        import cloudpickle
        import distributed

        total, drawn = len(waiting), _drawn(waiting)
        with self._connected() as client:
            work = {"setup": cloudpickle.dumps(setup), "expected": _environment()()}
            run, completed = _portable_job(), distributed.as_completed(loop=client.loop)
            number: dict[Any, int] = {}

            def submit(count: int) -> None:
                batch = dict(islice(drawn, count))
                futures = client.map(run, list(batch.values()), **work, pure=False)
                number.update(zip((future.key for future in futures), batch, strict=True))
                completed.update(futures)

            submit(ahead)
            for future, result in _finished(client, completed, self.timeout, ended):
                if isinstance(result, CancelledError):
                    break
                yield number.pop(future.key), _checked(result)
                future.release()
                submit(1)
            if number and not ended.is_set():
                raise _lost(client, total - len(waiting) - len(number), total)

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

    # from the client, by the connection whose tasks are code in any case
    return cloudpickle.loads(setup)()


def _drawn(waiting: deque[tuple[int, Any]]) -> Iterator[tuple[int, Any]]:
    """Yield the jobs of a queue from which others draw, too."""
    with suppress(IndexError):
        while True:
            yield waiting.popleft()


def _evaluated(
    setup: Callable[[], Callable[[Any], Any]], waiting: deque[tuple[int, Any]]
) -> Iterator[tuple[int, Any]]:
    """Yield the number of each job, and its result or exception, evaluated in this process."""
    work = held(held(setup)())
    for i, job in _drawn(waiting):
        try:
            yield i, work(job)
        except Exception as error:
            yield i, error


def _finished(
    client: distributed.Client,
    completed: distributed.as_completed,
    timeout: float,
    ended: Event,
) -> Iterator[tuple[distributed.Future[Any], Any]]:
    """Yield tasks as they finish, with result or error, until there is no worker.

    A result lost with its worker before it arrives here is awaited again: the scheduler has
    another worker compute it. It also takes the jobs of a worker without a sign of life (dask's
    `distributed.scheduler.worker-ttl`, five minutes). A job itself has no bound: its length is
    not known.
    """
    without_worker = 0.0
    answered = time.monotonic()
    while not (completed.is_empty() or ended.is_set()):
        if time.monotonic() - answered > _SILENCE:
            return
        if completed.has_ready():
            future = next(completed)
            try:
                failed = future.status == "error"
                result = future.exception(_ANSWER) if failed else future.result(_ANSWER)
            except TimeoutError:
                completed.add(future)
                if _has_workers(client) is not None:
                    answered = time.monotonic()
                continue
            except Exception as error:
                result = error
            yield future, result
            without_worker, answered = 0.0, time.monotonic()
            continue
        time.sleep(_POLL)
        has_workers = _has_workers(client)
        without_worker = without_worker + _POLL if has_workers is False else 0.0
        if has_workers is not None:
            answered = time.monotonic()
        if client.status != "running" or without_worker > timeout:
            return


def _has_workers(client: distributed.Client) -> bool | None:
    """Return whether there is a worker, None if the scheduler does not answer.

    `Client.scheduler_info` waits for a minute for a scheduler that has just died.
    """
    scheduler: Any = client.scheduler
    try:
        identity = client.sync(scheduler.identity, n_workers=1, callback_timeout=_ANSWER)
    except (OSError, TimeoutError):
        return None
    return bool(identity["workers"])


def _lost(client: distributed.Client, done: int, total: int) -> Refused:
    what = "the connection is lost"
    if client.status == "running":
        what = "no worker is left" if _has_workers(client) is False else "no answer"
    return Refused("workers", Described(f"{what}, {done} of {total} tasks finished"), _ALLOWED)


def _environment() -> Callable[[], dict[str, str]]:
    """Return a function that describes an environment; it is sent by value.

    A function of this module would be looked up in the package of the worker, which may be none.
    """

    def environment() -> dict[str, str]:
        try:
            from importlib.metadata import version

            from meshtrace.kernels.jit import sources

            versions = {name: version(name) for name in ("meshtrace", "numpy", "numba")}
            return {**versions, "kernels": sources().hex()}
        except Exception as error:
            return {"meshtrace": f"{type(error).__name__}: {error}"}

    return environment


def _portable_job() -> Callable[..., Any]:
    """Return a function that evaluates a job; it is sent by value."""
    describe = _environment()

    def run(job: Any, setup: bytes, expected: dict[str, str]) -> Any:
        environment = describe()
        if environment != expected:  # of a worker that came late
            return environment
        from meshtrace.parallel import one_blas_thread
        from meshtrace.studies.cluster import prepared

        with one_blas_thread():
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
        what = "no worker"
        client.wait_for_workers(1, timeout=timeout)
        what = "no answer of a worker"
        # `Client.run` waits without limit, for a worker that is stopped, too
        run = partial(client._run, _environment(), on_error="return")
        environments = client.sync(run, callback_timeout=max(timeout, _ANSWER))
    except (TimeoutError, distributed.TimeoutError) as error:
        waited = Described(f"{what} within {timeout:g} s")
        raise Refused("workers", waited, _ALLOWED) from error
    except OSError as error:
        raise _lost(client, 0, 0) from error
    expected = _environment()()
    for address, environment in environments.items():
        if environment != expected:
            raise _other_worker(address, environment)


def _other_worker(address: str, environment: Any) -> Refused:
    expected = _environment()()
    there = environment if isinstance(environment, dict) else {"meshtrace": error_text(environment)}
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
        # like all of dask these processes unpickle, and so run, what reaches their ports; on
        # 127.0.0.1 that is what users of this machine send (docs/guides/sweep.md)
        # one thread each: a task fills one core, and dask keeps BLAS to one thread as well
        with (
            safe_processes(),
            tempfile.TemporaryDirectory(prefix="meshtrace-", ignore_cleanup_errors=True) as scratch,
            distributed.LocalCluster(
                n_workers=(workers or cores()) - 1,
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address=None,
                scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # no fixed port for health
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
        fields = json.load(file)
    if not isinstance(fields, dict) or not isinstance(fields.get("address"), str):
        raise ValueError("no address in the file")
    return str(fields["address"])


def error_text(error: BaseException) -> str:
    """Return an error as one line."""
    text = one_line(error)
    return text if isinstance(error, ValueError) and text else f"{type(error).__name__}: {text}"
