"""Throughput and memory of the analog engine; run with `pytest tests/benchmarks --benchmark-only`.

The numbers are stored with the benchmark (`--benchmark-json`). The bounds are those that the
project sets itself: 0.5 photons for each raw Embree ray, 20 times the plain tracer, twice the time
of a plain numba loop, flat memory.
"""

import os

import pytest
from throughput import (
    SMOOTH,
    default_mesh,
    measure_against_loop,
    measure_against_plain,
    peak_memory,
)
from works import analog_rate

import meshtrace as mt
from meshtrace.engine.photons import analog
from meshtrace.surfaces import FlatSea

PHOTONS = 500_000


@pytest.mark.parametrize("surface", ["flat", "jonswap"])
def test_analog_run(benchmark, surface):
    link = mt.Link()
    mesh = default_mesh(link) if surface == "jonswap" else FlatSea().mesh(extent=70.0, spacing=35.0)
    intersector = mt.EmbreeIntersector(mesh)
    threads = os.cpu_count() or 1
    analog.run_analog(link, intersector, photons=4096, seed=1)
    benchmark.pedantic(
        lambda: analog.run_analog(link, intersector, photons=PHOTONS, seed=1, threads=threads),
        rounds=3,
    )
    benchmark.extra_info["photons_per_s"] = PHOTONS / benchmark.stats.stats.min


def test_photons_per_raw_ray(benchmark):
    info = benchmark.pedantic(lambda: analog_rate(SMOOTH, default_mesh(SMOOTH)), rounds=1)
    benchmark.extra_info.update(info)
    assert info["ratio"] >= 0.5, info


def test_against_the_plain_tracer(benchmark):
    info = benchmark.pedantic(measure_against_plain, rounds=1)
    benchmark.extra_info.update(info)
    assert info["speedup"] >= 20.0, info


@pytest.mark.parametrize(("b", "photons"), [(0.037, 1_000_000), (0.1, 1_000_000), (1.0, 100_000)])
def test_against_a_plain_loop(benchmark, b, photons):
    info = benchmark.pedantic(measure_against_loop, (b, photons), rounds=1)
    benchmark.extra_info.update(info)
    assert info["ratio"] <= 2.0, info


def test_memory_does_not_grow_with_photons(benchmark):
    few, many = benchmark.pedantic(
        lambda: (peak_memory(2_000_000), peak_memory(20_000_000)), rounds=1
    )
    benchmark.extra_info.update(few=few, many=many)
    assert many - few < 50 * 2**20
    assert many < 2**30
