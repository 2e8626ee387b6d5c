"""Speed of the engine, as ratios within one run.

Engine and reference are timed in interleaved rounds, and the best round of each counts: other load
on the machine affects both.
"""

from meshtrace.bench.engine import analog_rate, best_of, figure_of_merit, new_sea, resolved_sea
from meshtrace.bench.scaling import thread_scaling, worker_scaling
from meshtrace.bench.suite import bench, report

__all__ = [
    "analog_rate",
    "bench",
    "best_of",
    "figure_of_merit",
    "new_sea",
    "report",
    "resolved_sea",
    "thread_scaling",
    "worker_scaling",
]
