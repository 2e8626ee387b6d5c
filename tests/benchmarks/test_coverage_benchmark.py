"""CPU time of a coverage map of 40 x 40 places, each to 2 %.

Run with `pytest tests/benchmarks/test_coverage_benchmark.py --benchmark-only`. The bound is the one
that the project sets itself: 30 CPU seconds.
"""

from __future__ import annotations

import pytest

import meshtrace as mt
from meshtrace.bench import coverage_cost
from meshtrace.surfaces import FlatSea, JonswapSea

SEAS = {"flat": FlatSea(), "5 m/s": JonswapSea(wind_speed=5.0, seed=7)}


@pytest.mark.parametrize("sea", SEAS)
def test_a_map_to_two_per_cent(benchmark, sea):
    info = benchmark.pedantic(coverage_cost, (mt.Link(), SEAS[sea]), rounds=1)
    benchmark.extra_info.update(info)
    assert info["cells"] == 1600
    assert info["rtol"] <= 0.02, info
    assert info["cpu_seconds"] <= 30.0, info
