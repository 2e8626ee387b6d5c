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
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import cached_property, lru_cache, partial
from importlib.util import find_spec
from itertools import islice
from queue import SimpleQueue
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Any

from meshtrace.errors import (
    Described,
    Refused,
    extra,
    one_line,
    require_between,
    require_whole,
    warn,
)
from meshtrace.parallel import cores, held, safe_processes

if TYPE_CHECKING:
    import distributed

Setup = Callable[[], Callable[[Any], Any]]
"""Returns the function of a job; called once in each process that evaluates jobs."""

Done = tuple[int, Any, Sequence[tuple[str, type[Warning]]]]
"""Number of a job, its result or exception, and the warnings of another process."""

DEFAULT_TIMEOUT = 60.0
"""Seconds to wait for a scheduler and for a worker."""

_CHATTY = ("distributed", "tornado", "asyncio")  # loggers of lost connections
_PATIENCE = 2.0  # [s] of work in this process before others start, which takes as long
_AHEAD = 2  # jobs that a process on this machine has or waits with
_BROKEN = -1  # number of a job that stands for the loss of all workers
_POLL = 0.02  # [s] between looks for finished tasks
_ANSWER = 2.0  # [s] to wait for an answer of the scheduler
_SILENCE = 60.0  # [s] without an answer after which a scheduler is lost; a busy one takes seconds
_ALLOWED = "a running dask scheduler with workers; the same command resumes"


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

    Raises
    ------
    Refused
        If an option is out of range, or several processes are asked for without dask.
    """

    def __init__(self, workers: int | str | None = None, timeout: float = DEFAULT_TIMEOUT) -> None:
        if not isinstance(workers, str | None):
            require_whole(workers, 1, 1024, "workers")
        # this process alone needs no dask
        if workers != 1 and find_spec("distributed") is None:
            with extra("batch", "workers"):
                raise ModuleNotFoundError(name="distributed")
        require_between(timeout, 0.0, math.inf, "timeout", "[)")
        self.workers, self.timeout, self._turn = workers, timeout, Lock()
        # of `keep_workers`: the client of one loop serves those that follow
        self._shared: ExitStack | None = None
        self._client: distributed.Client | None = None

    @contextmanager
    def keep_workers(self) -> Iterator[None]:
        """Share the workers of one loop with the following loops."""
        with ExitStack() as self._shared:
            try:
                yield
            finally:
                self._shared = self._client = None

    def map(self, setup: Setup, jobs: Sequence[Any]) -> Generator[tuple[int, Any], None, None]:
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
        with closing(self._spread(setup, deque(enumerate(jobs)))) as results:
            for i, result, caught in results:
                try:
                    # here they are one with those of this process, which have been told
                    for text, category in caught:
                        warn(text, category)
                except Warning as error:
                    result = error
                yield i, result

    def _spread(self, setup: Setup, waiting: deque[tuple[int, Any]]) -> Generator[Done, None, None]:
        """Yield the jobs of a queue as they are done, in this process and in others."""
        if isinstance(self.workers, str):
            if waiting:
                yield from self._elsewhere(setup, waiting, len(waiting), Event())
            return
        # this process is one of the workers
        others = (self.workers or cores()) - 1
        # the last job is not worth a process, which starts in two seconds
        alone = min(others, len(waiting) - 1) < 1
        yield from _evaluated(setup, waiting) if alone else self._beside(setup, waiting, others)

    def _beside(self, setup: Setup, waiting: deque[tuple[int, Any]], others: int) -> Iterator[Done]:
        """Yield the results of jobs of this process and, once they take longer, of others.

        A thread feeds the others, so that they also work while this process is inside a long job.
        """
        total, ended = len(waiting), Event()
        results: SimpleQueue[Done] = SimpleQueue()

        def feed() -> None:
            try:
                patience = 0.0 if self.workers or self._client else _PATIENCE
                # fewer than half of the jobs are left: they are done before others have started
                if ended.wait(patience) or 2 * len(waiting) < total:
                    return
                for result in self._elsewhere(setup, waiting, _AHEAD * others, ended):
                    results.put(result)
            except Exception as error:
                results.put((_BROKEN, error, ()))

        def merged() -> Iterator[Done]:
            # while this process has jobs of its own, results of others wait in their queue
            for result in _evaluated(setup, waiting):
                yield result
                while not results.empty():
                    yield results.get()
            while True:
                yield results.get()

        thread = Thread(target=feed, name="workers")
        # daemon threads would outlive the dask client that they use: this one is joined
        thread.start()
        try:
            for done in islice(merged(), total):
                if done[0] == _BROKEN:
                    raise done[1]
                yield done
        finally:
            ended.set()
            thread.join()  # within dask's bounds of the end of its processes, seconds

    def _elsewhere(
        self, setup: Setup, waiting: deque[tuple[int, Any]], ahead: int, ended: Event
    ) -> Iterator[Done]:
        """Yield the jobs that workers have done, in the order in which they finish.

        Workers have up to `ahead` jobs at a time, until none is left or the event is set.
        """
        import cloudpickle
        import distributed

        total, drawn = len(waiting), _drawn(waiting)
        with self._connected() as client:
            recipe, here = cloudpickle.dumps(setup), _environment()
            # a result that is lost with its worker is awaited again, computed by another one
            completed = distributed.as_completed(
                loop=client.loop, with_results=True, raise_errors=False
            )
            run, numbers = _portable_job(), dict[Any, int]()

            def submit(count: int) -> None:
                jobs = dict(islice(drawn, count))
                futures = client.map(
                    run, list(jobs.values()), setup=recipe, expected=here, pure=False
                )
                numbers.update(zip((future.key for future in futures), jobs, strict=True))
                completed.update(futures)

            # some jobs ahead, so that no worker waits for the connection
            submit(ahead)
            for future, result in _finished(client, completed, self.timeout, ended):
                if future.cancelled():  # by a scheduler that went away
                    break
                i = numbers.pop(future.key)
                yield (i, result[1], ()) if future.status == "error" else (i, *_checked(result))
                # frees the result in the memory of the worker
                future.release()
                submit(1)
            if numbers and not ended.is_set():
                raise _lost(client, total - len(waiting) - len(numbers), total)

    @contextmanager
    def _connected(self) -> Iterator[distributed.Client]:
        """Yield a dask client with workers, reusing the one kept from an earlier loop."""
        with ExitStack() as stack:
            with self._turn:  # loops of several threads share it, too
                client = self._client
                if client is None:
                    # the stack of `keep_workers` outlives this loop, and so does the client in it
                    stack = self._shared or stack
                    stack.enter_context(_quiet())
                    client = stack.enter_context(_client(self.workers, self.timeout))
                    # before any job: another version would give other digits
                    _require_equal_workers(client, self.timeout)
                    self._client = client if self._shared else None
            yield client


class Restored:
    """Object that a worker rebuilds from its inputs, once for all loops of a study."""

    inputs: tuple[Any, ...]

    @cached_property
    def _recipe(self) -> bytes:
        import cloudpickle

        return bytes(cloudpickle.dumps(partial(type(self), *self.inputs)))

    def __reduce__(self) -> Any:
        """Pickle a recipe, by which a worker finds the object if it has built it before."""
        return prepared, (self._recipe,)


@lru_cache(4)  # two loops at once, and what each of them restores
def prepared(setup: bytes) -> Any:
    """Return the function of the jobs of a loop, or a `Restored`, set up once per process."""
    import cloudpickle

    # from the client, by the connection whose tasks are code in any case
    return cloudpickle.loads(setup)()


def _drawn(waiting: deque[tuple[int, Any]]) -> Iterator[tuple[int, Any]]:
    """Yield jobs of a queue until it is empty; other threads draw from it, too."""
    with suppress(IndexError):
        while True:
            yield waiting.popleft()


def _evaluated(setup: Setup, waiting: deque[tuple[int, Any]]) -> Iterator[Done]:
    """Yield jobs as they are done in this process."""
    evaluate = held(held(setup)())
    for i, job in _drawn(waiting):
        try:
            yield i, evaluate(job), ()
        except Exception as error:
            # as a worker of a cluster returns it
            yield i, error, ()


def _finished(
    client: distributed.Client,
    completed: distributed.as_completed,
    timeout: float,
    ended: Event,
) -> Iterator[tuple[distributed.Future[Any], Any]]:
    """Yield tasks as they finish, with result or error, until there is no worker.

    The scheduler takes the jobs of a worker without a sign of life (dask's
    `distributed.scheduler.worker-ttl`, five minutes). A job itself has no bound: its length is
    not known.
    """
    employed = answered = time.monotonic()
    while not (completed.is_empty() or ended.is_set()):
        if completed.has_ready():
            yield next(completed)
            employed = answered = time.monotonic()
            continue
        time.sleep(_POLL)
        # asked only while nothing is ready: a finished task is a sign of life
        has_workers, now = _has_workers(client), time.monotonic()
        # silence is no answer, and says nothing of workers
        if has_workers is not None:
            answered = now
        if has_workers is not False:  # a scheduler without an answer may well have some
            employed = now
        if now - answered > _SILENCE or now - employed > timeout or client.status != "running":
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
    """Return the error for workers that are gone for good."""
    what = "the connection is lost"
    if client.status == "running":
        what = "no worker is left" if _has_workers(client) is False else "no answer"
    return Refused("workers", Described(f"{what}, {done} of {total} tasks finished"), _ALLOWED)


def _portable_job() -> Callable[..., Any]:
    """Return a function of a job's result and warnings, or of the environment if it is another one.

    It is sent by value: a function of this module would be looked up in the package of the
    worker, which may be none.
    """

    def run(job: Any, setup: bytes, expected: dict[str, str]) -> Any:
        import warnings

        try:
            from importlib.metadata import version

            from meshtrace.kernels.jit import sources

            here = {name: version(name) for name in ("meshtrace", "numpy", "numba")}
            here["kernels"] = sources().hex()
        except Exception as error:
            here = {"meshtrace": f"{type(error).__name__}: {error}"}
        if here != expected:  # of a worker that came after the first check
            return here
        from meshtrace.parallel import one_blas_thread
        from meshtrace.studies.cluster import prepared

        # digits of a sum depend on the number of BLAS threads
        with one_blas_thread(), warnings.catch_warnings(record=True) as caught:
            result = prepared(setup)(job)
        return result, [(str(w.message), w.category) for w in caught]

    return run


def _environment() -> dict[str, str]:
    """Return the versions on which results depend, by the code that runs on workers."""
    return dict(_portable_job()(None, b"", {}))


def _checked(result: Any) -> Any:
    """Return result and warnings of a job; refuse a worker that described its environment."""
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
        describe = partial(client._run, _portable_job(), None, b"", {}, on_error="return")
        environments = client.sync(describe, callback_timeout=max(timeout, _ANSWER))
    except (TimeoutError, distributed.TimeoutError) as error:
        waited = Described(f"{what} within {timeout:g} s")
        raise Refused("workers", waited, _ALLOWED) from error
    except OSError as error:
        raise _lost(client, 0, 0) from error
    for address, there in environments.items():
        if there != _environment():
            raise _other_worker(address, there)


def _other_worker(address: str, there: Any) -> Refused:
    """Return the error for a worker with other versions: its first difference from here."""
    if not isinstance(there, dict):
        there = {"meshtrace": error_text(there)}
    # a long list of equal versions would hide the one that differs
    name, here = next(item for item in _environment().items() if there.get(item[0]) != item[1])
    difference = f"{address}: {name} {there.get(name, 'missing')} there, {here} here"
    allowed = "the same versions of meshtrace, its kernels, numpy and numba"
    return Refused("worker", Described(difference), allowed)


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress the messages of distributed about lost connections."""
    import distributed  # noqa: F401  (its loggers exist from here on)

    names = [name for name in logging.root.manager.loggerDict if name.startswith(_CHATTY)]
    # messages about a lost worker come with tracebacks; `_lost` says it in a line
    levels = {logging.getLogger(name): logging.getLogger(name).level for name in names}
    for logger in levels:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in levels.items():
            logger.setLevel(level)


@contextmanager
def _client(workers: int | str | None, timeout: float) -> Iterator[distributed.Client]:
    """Yield a client of a running scheduler or of a new cluster on this machine."""
    import distributed

    if not isinstance(workers, str):
        with _local_client((workers or cores()) - 1) as client:
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


@contextmanager
def _local_client(processes: int) -> Iterator[distributed.Client]:
    """Yield a client of a new cluster on this machine.

    Like all of dask its processes unpickle, and so run, what reaches their ports; on 127.0.0.1
    that is what users of this machine send (docs/guides/sweep.md).
    """
    import distributed

    with (
        # a file of the current folder with the name of a module must not take its place
        safe_processes(),
        tempfile.TemporaryDirectory(prefix="meshtrace-", ignore_cleanup_errors=True) as scratch,
        distributed.LocalCluster(
            n_workers=processes,
            threads_per_worker=1,  # a task fills one core, and dask keeps BLAS to one thread
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
                # Ctrl-C reaches all processes of a terminal at once
                signal.signal(signal.SIGINT, signal.SIG_IGN)

        client.register_plugin(LeaveInterrupts())
        yield client


def _address(scheduler: str, timeout: float) -> str:
    """Return the address of a scheduler, from its file if one is given.

    Wait for the file up to a time [s].

    `distributed.Client` waits for such a file without a bound.
    """
    if not scheduler.endswith(".json"):
        return scheduler
    end = time.monotonic() + timeout
    # a batch system starts the scheduler when it likes
    while not os.path.isfile(scheduler) and time.monotonic() < end:
        time.sleep(0.1)
    with open(scheduler, encoding="utf-8") as file:
        content = json.load(file)
    address = content.get("address") if isinstance(content, dict) else None
    if not isinstance(address, str):
        raise ValueError("no address in the file")
    return address


def error_text(error: BaseException) -> str:
    """Return an error as one line."""
    text = one_line(error)
    return text if isinstance(error, ValueError) and text else f"{type(error).__name__}: {text}"
