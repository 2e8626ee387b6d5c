"""Speed of the engine, as ratios within one run.

Times are CPU seconds of one thread, which other load on the machine hardly changes, but for the
scaling with threads and workers. Engine and reference take turns; the best round of each counts.
"""

from meshtrace.bench.suite import bench as bench
from meshtrace.bench.suite import compare as compare
from meshtrace.bench.suite import report as report
