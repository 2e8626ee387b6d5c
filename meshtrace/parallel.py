"""Threads and processes: ordered maps, expected times, limits of BLAS, safe starts of Python."""

from __future__ import annotations

import ctypes
import os
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import cache
from math import ceil
from pathlib import Path
from threading import Lock, local
from time import monotonic, thread_time
from typing import Any, TypeVar

from meshtrace.errors import require_whole, warn

Job = TypeVar("Job")
Result = TypeVar("Result")

_worker = local()  # `is_busy` in the threads of `results_of`

_QUOTA = Path("/sys/fs/cgroup/cpu.max")
"""File "QUOTA PERIOD" of Linux: CPU time [us] that a container may use in each period [us]."""


def cores() -> int:
    """Return the number of cores that the affinity and the container of this process allow."""
    if hasattr(os, "sched_getaffinity"):
        allowed = len(os.sched_getaffinity(0))
    else:
        allowed = os.cpu_count() or 1
    with suppress(OSError, ValueError, ZeroDivisionError):  # no such file; "max": no quota
        quota, period = map(int, _QUOTA.read_text(encoding="ascii").split())
        allowed = min(allowed, ceil(quota / period))
    return max(allowed, 1)


def default_threads(threads: int | None = None) -> int:
    """Return a checked number of threads, 1 to 1024, by default all cores of the process."""
    if threads is None:
        return cores()
    require_whole(threads, 1, 1024, "threads")
    return threads


_SAFE = {"PYTHONSAFEPATH": "1"}
"""Environment in which Python imports nothing from its working directory or a script's folder."""


def python_start(
    *arguments: str, env: Mapping[str, str] | None = None
) -> tuple[list[str], dict[str, str]]:
    """Return command line and environment to start another Python process.

    Every Python process is started with these, or within `safe_processes`, so that modules in the
    working directory, which may come from a stranger, are not imported by accident. Modules that a
    link file names and the user trusts are found by `import_modules`.

    Parameters
    ----------
    *arguments : str
        Arguments of Python.
    env : mapping, optional
        Environment, by default that of this process.
    """
    # -P as well: it holds where environment variables are ignored
    return [sys.executable, "-P", *arguments], dict(env or os.environ) | _SAFE


def import_path() -> str:
    """Return the folders that this process imports from, as the PYTHONPATH of another process.

    The working directory is left out, unless this package lies there.
    """
    here = os.path.realpath(os.getcwd())
    folders = [os.path.realpath(folder) for folder in sys.path if folder]
    package = os.path.realpath(Path(__file__).parents[1])
    return os.pathsep.join(f for f in folders if f != here or f == package)


def safe_processes() -> AbstractContextManager[None]:
    """Start all Python processes within a block with the settings of `python_start`."""
    return environment(_SAFE)


@contextmanager
def environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables within a block."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def trim_memory() -> None:
    """Return free pages of the heap to the system, on Linux with glibc.

    Arrays of a few hundred kB that differ from mesh to mesh fragment the heap: otherwise an
    ensemble over resolved seas grows by half a megabyte per sea.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim is not None:
        trim(0)


class _Blas:
    """Limit of BLAS to one thread, counted: blocks may nest, or overlap in several threads."""

    def __init__(self) -> None:
        self._lock, self._holders = Lock(), 0
        self._limit: Any = None

    def hold(self) -> None:
        """Set the limit, unless another block holds it already."""
        with self._lock:
            if self._holders == 0:
                self._limit = _libraries("scipy.linalg" in sys.modules).limit(limits=1)
            self._holders += 1

    def leave(self) -> None:
        """Lift the limit after the last block."""
        from threadpoolctl import OpenBLASController

        with self._lock:
            self._holders -= 1
            if self._holders == 0:
                # Only the thread that set a limit may lift it, but the last block may end in
                # another: the controller forgets the thread.
                OpenBLASController.clear_controlling_thread(force=True)
                self._limit.restore_original_limits()
                OpenBLASController.clear_controlling_thread()


_BLAS = _Blas()


@cache
def _libraries(scipy: bool) -> Any:
    """Return the controller of the BLAS of numpy and, once loaded, of scipy.

    Cached, as the search among all shared libraries takes a millisecond; `scipy`, whether it is
    loaded, is a key of the cache.
    """
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread within a block: only threads that the user asked for work.

    Otherwise BLAS occupies all cores, mostly by busy waiting, and the last digits of its products
    may depend on their number.
    """
    _BLAS.hold()
    try:
        yield
    finally:
        _BLAS.leave()


held = one_blas_thread()
"""Decorator of functions that run with BLAS limited to one thread."""


def ordered_map(
    function: Callable[[Job], Result], jobs: Iterable[Job], threads: int, ahead: int = 2
) -> Iterator[Result]:
    """Return an iterator over `function(job)`, in the order of the jobs, computed by threads.

    Parameters
    ----------
    function : callable
        Function of one job; exceptions are raised where its result is due.
    jobs : iterable
        Jobs, drawn lazily.
    threads : int
        Threads; 1 runs in the calling thread.
    ahead : int
        Pending jobs per thread, a bound of the memory.

    Examples
    --------
    >>> list(ordered_map(abs, [-1, 2, -3], threads=2))
    [1, 2, 3]
    """
    # the caller's thread: no pool to start, and errors keep their plain traceback
    if threads == 1 or getattr(_worker, "is_busy", False):
        return map(function if _recorded is None else _timed(function, _recorded), jobs)
    return _in_threads(function, jobs, threads, ahead)


def results_of(threads: int, *functions: Callable[[], Any]) -> list[Any]:
    """Return the results of functions without arguments, called by several threads.

    Parameters
    ----------
    threads : int
        Threads; 1 calls them in the calling thread.
    *functions : callable
        Functions, the longest ones first; after an exception no further one is called.

    Examples
    --------
    >>> results_of(2, dict, list)
    [{}, []]
    """

    def call(function: Callable[[], Any]) -> Any:
        # loops inside share the threads already: a pool for each would have threads squared, whose
        # heaps keep a tenth of the memory of a design; this thread ends with its pool
        _worker.is_busy = threads > 1
        return function()

    return list(ordered_map(call, functions, threads, len(functions)))


def _in_threads(
    function: Callable[[Job], Result], jobs: Iterable[Job], threads: int, ahead: int
) -> Iterator[Result]:
    """Yield the results of jobs in order from a pool of threads."""
    with ThreadPoolExecutor(threads) as pool:
        pending: deque[Future[Result]] = deque()
        try:
            for job in jobs:
                pending.append(pool.submit(function, job))
                if len(pending) >= ahead * threads:
                    # no bound on the wait: a job of a thread ends only by itself
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            # if the consumer has stopped or failed, jobs that have not begun are dropped
            for future in pending:
                future.cancel()


LONG = 120.0
"""Expected time [s] above which a work is announced."""

# [s] over which a pace is measured, from the first result, which may have waited for compilation
_MEASURED = 1.0


class LongWork(UserWarning):
    """Warning that a computation is expected to take minutes or more."""


def announce(seconds: float, work: str, least: float = LONG) -> None:
    """Warn of a computation expected to take more than `least` seconds."""
    if seconds > least:
        warn(f"{work}: about {duration(seconds)}", LongWork)


class Pace:
    """Rate of a computation, by which its first results announce the expected time of all.

    Parameters
    ----------
    total : float
        Sum of the sizes of all results.
    work : str
        Name of the work, such as "10,000 frames".
    """

    def __init__(self, total: float, work: str) -> None:
        self._total, self._work = total, work
        self._start, self._done = monotonic(), 0.0
        self._first: tuple[float, float] | None = None
        self._measured = False

    def add(self, size: float = 1.0) -> None:
        """Count a finished result, of a size in the units of `total`."""
        if self._measured:
            return
        now, self._done = monotonic() - self._start, self._done + size
        self._first = self._first or (now, self._done)
        time, part = now - self._first[0], self._done - self._first[1]
        if time < _MEASURED and now > LONG:  # a long first result: compilation hardly counts
            time, part = now, self._done
        if time >= _MEASURED:
            self._measured = True
            announce(time / part * self._total, self._work)


def paced(
    results: Iterable[Result],
    total: float,
    work: str,
    size: Callable[[Result], float] = lambda _: 1.0,
) -> Generator[Result, None, None]:
    """Yield results, and announce the expected time of all by the rate of the first.

    Parameters
    ----------
    results : iterable
        Results as they are computed.
    total, work
        As in `Pace`.
    size : callable
        Size of a result, 1 by default.
    """
    pace = Pace(total, work)
    for result in results:
        yield result
        pace.add(size(result))


def duration(seconds: float) -> str:
    """Format a time in its largest fitting unit.

    Examples
    --------
    >>> duration(75.0), duration(7200.0), duration(1e9)
    ('1.2 min', '2.0 h', '31.7 years')
    """
    units = (("years", 31557600.0), ("d", 86400.0), ("h", 3600.0), ("min", 60.0))
    for unit, length in units:
        if seconds >= length:
            return f"{seconds / length:.1f} {unit}"
    return f"{seconds:.0f} s"


# CPU seconds of the jobs of each map, within `job_times`
_recorded: list[list[float]] | None = None


@contextmanager
def job_times() -> Iterator[list[list[float]]]:
    """Record the CPU seconds of jobs, a list for each `ordered_map` that runs on one thread."""
    global _recorded
    times: list[list[float]] = []
    _recorded = times
    try:
        yield times
    finally:
        _recorded = None


def _timed(
    function: Callable[[Job], Result], recorded: list[list[float]]
) -> Callable[[Job], Result]:
    """Return the function, timed: each call appends its CPU seconds to a new list in `recorded`."""
    seconds: list[float] = []
    recorded.append(seconds)

    def timed(job: Job) -> Result:
        start = thread_time()
        result = function(job)
        seconds.append(thread_time() - start)
        return result

    return timed
