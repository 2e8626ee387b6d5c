"""Sums of waves on grids against the product of two matrices, in CPU seconds of one run.

Run with `pytest tests/benchmarks --benchmark-only` on a quiet machine.
"""

from __future__ import annotations

import numpy as np
import pytest
from clocks import best_of

import meshtrace as mt
from meshtrace import options
from meshtrace.engine.setup import meshing
from meshtrace.engine.setup.options import Run
from meshtrace.surfaces import WaveComponents, resolved_sea, triangulate
from meshtrace.surfaces.waves import WaveGrid, elevation_and_slopes


def waves_of(n, longest):
    """Return n waves of 0.3 rad/m to k = `longest`."""
    rng = np.random.default_rng(1)
    k, heading = np.geomspace(0.3, longest, n), rng.uniform(-1.5, 1.5, n)
    phase = 2.0 * np.pi * rng.random(n)
    return WaveComponents(
        0.01 / k, np.sqrt(9.81 * k), *k * [np.cos(heading), np.sin(heading)], phase
    )


def product(waves, x, y, time):
    """Return elevation and slopes as products of matrices."""
    left, right = np.exp(-1j * np.outer(x, waves.kx)), np.exp(-1j * np.outer(waves.ky, y))
    return np.stack([((left * w) @ right).real for w in elevation_and_slopes(waves, time)])


CASES = {
    "2900 waves, 321 x 321": (2900, 4.0, triangulate.GridLines(20.0, 0.125).axis(), 10.0),
    "92000 waves, 201 x 201": (92_000, 4.0, triangulate.GridLines(20.0, 0.2).axis(), 30.0),
    "2300 waves, graded": (2300, 39.0, triangulate.GridLines(6.0, 0.0225, 0.5, 0.4).axis(), 2.0),
}


@pytest.mark.parametrize("name", CASES)
def test_a_grid(benchmark, name):
    n, longest, x, least = CASES[name]
    waves = waves_of(n, longest)
    grid = WaveGrid(waves.kx, waves.ky, x, x)
    got = benchmark.pedantic(lambda: grid.sum(elevation_and_slopes(waves, 1.0)), rounds=3)
    np.testing.assert_allclose(got, product(waves, x, x, 1.0), atol=1e-10 * np.abs(got).max())
    (one,) = best_of(3, lambda: grid.sum(elevation_and_slopes(waves, 1.0)))
    (other,) = best_of(1, lambda: product(waves, x, x, 1.0))
    benchmark.extra_info.update(cpu_seconds=one, product_cpu_seconds=other, ratio=other / one)
    assert other / one > least


@pytest.mark.parametrize("wind", [5.0, 13.0])
def test_a_mesh_of_a_resolved_sea(benchmark, wind):
    sea = resolved_sea(wind, fetch=30e3)
    case = options.Case(mt.Link(), sea, Run(), mt.Meshing(waves="fading")).with_waves()
    seas = iter([case.surface.with_seed(seed) for seed in range(12)])
    meshes = [meshing.mesh_for(case.link, next(seas), case.meshing)[0] for _ in range(2)]  # plans
    (one,) = best_of(5, lambda: meshing.mesh_for(case.link, next(seas), case.meshing))
    benchmark.pedantic(lambda: meshing.mesh_for(case.link, next(seas), case.meshing), rounds=1)
    size = {"waves": len(case.surface.components.omega), "vertices": len(meshes[0].vertices)}
    benchmark.extra_info.update(cpu_seconds=one, **size)
