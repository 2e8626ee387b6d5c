"""Ordered maps over threads with a bounded number of pending results, and free memory."""

from __future__ import annotations

import ctypes
import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from time import thread_time
from typing import TypeVar

from meshtrace.errors import require_whole

Job = TypeVar("Job")
Result = TypeVar("Result")


def default_threads(threads: int | None = None) -> int:
    """Return the number of threads, 1 to 1024, all cores by default."""
    if threads is None:
        return os.cpu_count() or 1
    require_whole(threads, 1, 1024, "threads")
    return threads


def trim_memory() -> None:
    """Return free pages of the heap to the system, on Linux with glibc.

    Arrays of a few hundred kB that differ from mesh to mesh fragment the heap: without it an
    ensemble over resolved seas grows by half a megabyte for each of them.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim is not None:
        trim(0)


def ordered_map(
    function: Callable[[Job], Result], jobs: Iterable[Job], threads: int, ahead: int = 2
) -> Iterator[Result]:
    """Yield `function(job)` of each job in order, computed by several threads.

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
    if threads == 1:
        yield from map(function if _recorded is None else _timed(function, _recorded), jobs)
        return
    with ThreadPoolExecutor(threads) as pool:
        pending: deque = deque()
        try:
            for job in jobs:
                pending.append(pool.submit(function, job))
                if len(pending) >= ahead * threads:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()


_recorded: list[list[float]] | None = None


@contextmanager
def job_times() -> Iterator[list[list[float]]]:
    """Record the CPU seconds of the jobs of each map that runs on one thread."""
    global _recorded
    found: list[list[float]] = []
    _recorded = found
    try:
        yield found
    finally:
        _recorded = None


def _timed(
    function: Callable[[Job], Result], recorded: list[list[float]]
) -> Callable[[Job], Result]:
    """Return a function that appends its CPU seconds to a new row."""
    row: list[float] = []
    recorded.append(row)

    def timed(job: Job) -> Result:
        start = thread_time()
        result = function(job)
        row.append(thread_time() - start)
        return result

    return timed
