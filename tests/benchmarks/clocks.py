"""Clocks of the programs of speed: CPU seconds of works and of commands, and peak memory."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Callable
from time import perf_counter, process_time
from typing import Any, TypeVar

import psutil

from meshtrace.checks import check_call
from meshtrace.parallel import python_start

Result = TypeVar("Result")


@check_call
def best_of(
    rounds: int, *jobs: Callable[[], Any], clock: Callable[[], float] = process_time
) -> list[float]:
    """Return the shortest time of each job [s] by a clock, CPU time, over interleaved rounds."""
    best = [math.inf] * len(jobs)
    for _ in range(rounds):
        for i, job in enumerate(jobs):
            start = clock()
            job()
            best[i] = min(best[i], clock() - start)
    return best


def timed(
    work: Callable[[], Result], warm_up: Callable[[], Any] = lambda: None
) -> tuple[Result, float]:
    """Return the result of a work and its CPU seconds, after a smaller one that compiles."""
    warm_up()
    start = process_time()
    result = work()
    return result, process_time() - start


_LONGEST_COMMAND = 1800.0  # [s]: twenty first runs, which compile all kernels for 40 to 90 s


def of_command(*arguments: str, env: dict[str, str] | None = None) -> tuple[float, float]:
    """Return the CPU and the wall seconds of Python with some arguments, and its processes."""
    command, env = python_start(*arguments, env=env)
    before, start = os.times(), perf_counter()
    subprocess.run(command, env=env, check=True, capture_output=True, timeout=_LONGEST_COMMAND)
    after, wall = os.times(), perf_counter() - start
    user = after.children_user - before.children_user
    return user + after.children_system - before.children_system, wall


def peak_mib() -> float:
    """Return the peak of resident memory of this process [MiB]."""
    try:
        import resource
    except ImportError:  # Windows
        return float(psutil.Process().memory_info().peak_wset) / 2**20
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)
