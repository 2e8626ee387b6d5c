"""Cost of coverage maps."""

from __future__ import annotations

from time import process_time
from typing import Any

import numpy as np

from meshtrace.link import Link
from meshtrace.studies.coverage import coverage_map


def coverage_cost(
    link: Link, sea: Any, extent: float = 5.0, step: float = 0.1, rtol: float = 0.01
) -> dict[str, Any]:
    """Return the CPU time of a coverage map with a relative error in every cell.

    Parameters
    ----------
    link : Link
        The link.
    sea : SurfaceModel
        The sea.
    extent, step, rtol : float
        As in `coverage_map`.

    Returns
    -------
    dict
        `cells`, `cpu_seconds` on one thread, `rtol` reached (largest), and the counts of
        `CoverageMap.provenance["chains"]`.
    """
    options: Any = {"rtol": rtol, "threads": 1}
    coverage_map(link, sea, 2.0 * step, step, **options)  # compiles
    start = process_time()
    found = coverage_map(link, sea, extent, step, **options)
    seconds = process_time() - start
    reached = float(np.max(found.gain_stderr / found.gain))
    counts = found.provenance.get("chains", {})
    return {"cells": found.gain.size, "cpu_seconds": seconds, "rtol": reached, **counts}
