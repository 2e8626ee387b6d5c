"""CPU time of coverage maps of 40 x 40 places, each to 2 %, and of 100 x 100, each to 1 %.

Run with `pytest tests/benchmarks/test_coverage_benchmark.py --benchmark-only`. The bounds are those
that the project sets itself.
"""

from __future__ import annotations

import pytest
from works import coverage_cost

import meshtrace as mt
from meshtrace.surfaces import FlatSea, JonswapSea

SEAS = {
    "flat": FlatSea(),
    "5 m/s": JonswapSea(wind_speed=5.0, seed=7),
    "13 m/s": JonswapSea(wind_speed=13.0, seed=7),
}
MAPS = {
    ("flat", 0.25, 0.02): 30.0,
    ("5 m/s", 0.25, 0.02): 15.0,
    ("13 m/s", 0.25, 0.02): 15.0,
    ("13 m/s", 0.1, 0.01): 40.0,
}
"""CPU seconds allowed by sea, step [m] and relative error."""


@pytest.mark.parametrize("which", MAPS, ids=str)
def test_a_map_to_a_tolerance(benchmark, which):
    sea, step, rtol = which
    given = (mt.Link(), SEAS[sea], 5.0, step, rtol)
    info = benchmark.pedantic(coverage_cost, given, rounds=1)
    benchmark.extra_info.update(info)
    assert info["cells"] == round(10.0 / step) ** 2
    assert info["rtol"] <= rtol, info
    assert info["cpu_seconds"] <= MAPS[which], info
