"""How much faster two workers finish a sweep of 64 points than one.

Run with `pytest tests/benchmarks/test_batch_benchmark.py --benchmark-only` on a quiet machine of
at least two cores, or `python tests/benchmarks/test_batch_benchmark.py` for the numbers alone.
The bound is the one that the project sets itself: 1.7 times.
"""

from __future__ import annotations

import os
from statistics import median
from time import perf_counter
from typing import Any

import pytest

from meshtrace.studies import sweep

pytest.importorskip("distributed")

LINK = {"bubbles": "none"}
PARAMETERS = {
    "transmitter.depth": [4.0 + 2.0 * i for i in range(8)],
    "wind_speed": [4.0 + i for i in range(8)],
}


def seconds_of(workers: int, rtol: float) -> float:
    """Return the wall time of the sweep [s], from the start of the workers to the dataset."""
    start = perf_counter()
    data = sweep(LINK, PARAMETERS, rtol=rtol, workers=workers)
    seconds = perf_counter() - start
    assert (data["error"] == "").all()
    return seconds


def measure(rtol: float = 0.0007, rounds: int = 3) -> dict[str, Any]:
    """Return the wall times of one and of two workers in turn, and the median of their ratio.

    Starting the processes counts: a sweep pays for it once.

    Parameters
    ----------
    rtol : float
        Relative standard error of every point: sets how long a point takes.
    rounds : int
        Pairs of runs; neighbouring runs share what else the machine does.

    Returns
    -------
    dict
        `ratio`, `ratios`, `one_worker_seconds`, `two_worker_seconds`, `cores`.
    """
    seconds_of(2, rtol=1.0)  # compiles
    one, two = [], []
    for _ in range(rounds):
        one.append(seconds_of(1, rtol))
        two.append(seconds_of(2, rtol))
    ratios = [a / b for a, b in zip(one, two, strict=True)]
    return {
        "ratio": median(ratios),
        "ratios": ratios,
        "one_worker_seconds": one,
        "two_worker_seconds": two,
        "cores": os.cpu_count(),
    }


def test_two_workers_are_nearly_twice_as_fast(benchmark):
    info = benchmark.pedantic(measure, rounds=1)
    benchmark.extra_info.update(info)
    assert info["ratio"] >= 1.7, info


if __name__ == "__main__":
    print(measure())
