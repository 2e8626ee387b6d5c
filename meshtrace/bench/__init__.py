"""Speed of the engine, as ratios within one run.

Machines are noisy: engine and yardstick take turns, and the best of several rounds counts for
both, so that a busy machine slows both alike.
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
