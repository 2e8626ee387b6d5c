"""Speed of the engine, as ratios within one run.

Times are CPU seconds of one thread, which other load on the machine hardly changes, but for the
scaling with threads and workers. Engine and reference take turns; the best round of each counts.
"""

from meshtrace.bench.answers import background_light, coverage_cost, first_run, realization
from meshtrace.bench.engine import analog_rate, best_of, figure_of_merit, new_sea, resolved_sea
from meshtrace.bench.scaling import speedup_by_jobs, thread_scaling, worker_scaling
from meshtrace.bench.suite import bench, report

__all__ = [
    "analog_rate",
    "background_light",
    "bench",
    "best_of",
    "coverage_cost",
    "figure_of_merit",
    "first_run",
    "new_sea",
    "realization",
    "report",
    "resolved_sea",
    "speedup_by_jobs",
    "thread_scaling",
    "worker_scaling",
]
