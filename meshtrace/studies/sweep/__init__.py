"""Sweeps over parameters and realizations on dask.distributed.

A task is one point of the sweep and a block of its realizations. Its random numbers belong to
(seed, realization), so that results are the same bits for any number of workers. Only the
process that called `sweep` writes: a finished task is a line of the store, and is never computed
again.
"""

from meshtrace.studies.sweep.points import BLOCK, Outcome, Study, Task
from meshtrace.studies.sweep.sweep import FIRST_CHAINS, store_of, sweep, sweep_file

__all__ = [
    "BLOCK",
    "FIRST_CHAINS",
    "Outcome",
    "Study",
    "Task",
    "store_of",
    "sweep",
    "sweep_file",
]
