"""Figure of merit 1 / (variance x time) of forced over analog, and the time of 1 % on a new sea.

Run with `pytest tests/benchmarks --benchmark-only` on a quiet machine. The bounds are those that
the project sets itself: 20 000 times analog at 20 000 samples, 0.15 s for 1 % on a new sea,
10 000 realizations of the default link, each at 1 %, in 15 minutes, and as many of a sea resolved up
to 24 rad/s in 30 minutes, all on two cores, and memory that does not grow with the chains.
"""

from __future__ import annotations

from time import perf_counter

import pytest
from throughput import peak_memory
from works import figure_of_merit, new_sea, resolved_sea

import meshtrace as mt
from meshtrace.engine.setup import ends, meshing
from meshtrace.surfaces import Band, Elfouhaily, JonswapSea, SpectralSea

SEA = JonswapSea(wind_speed=13.0, seed=7, waves="paper")
CHAINS = 1024  # for 1 % in every realization


def test_figure_of_merit(benchmark):
    link = mt.Link()
    mesh = meshing.mesh_for(link, SEA, reach=ends.crossing_reach(link))[0]
    info = benchmark.pedantic(figure_of_merit, (link, mesh), rounds=1)
    benchmark.extra_info.update(info)
    assert info["ratio_kept"] * (1.0 - info["ratio_stderr"] / info["ratio"]) >= 20_000, info


def test_memory_does_not_grow_with_chains(benchmark):
    few, many = benchmark.pedantic(
        lambda: (peak_memory(10**5, "forced"), peak_memory(10**6, "forced")), rounds=1
    )
    benchmark.extra_info.update(few=few, many=many)
    assert many - few < 50 * 2**20


def test_one_per_cent_on_a_new_sea(benchmark):
    info = benchmark.pedantic(new_sea, (mt.Link(), SEA), rounds=1)
    benchmark.extra_info.update(info)
    assert info["rtol"] <= 0.01, info
    assert info["with_bvh_seconds"] <= 0.15, info


@pytest.mark.parametrize("realizations", [300])
def test_realizations_at_one_per_cent(benchmark, realizations):
    options = {"photons": CHAINS, "threads": 2}
    mt.ensemble(mt.Link(), 4, SEA, **options)  # compiles
    start = perf_counter()
    found = benchmark.pedantic(mt.ensemble, (mt.Link(), realizations, SEA), options, rounds=1)
    seconds = (perf_counter() - start) / realizations
    worst = float((found.gain_stderr / found.gain).max())
    benchmark.extra_info.update({"seconds_per_realization": seconds, "worst_stderr": worst})
    assert worst <= 0.01
    assert 10_000 * seconds <= 15 * 60


def test_realizations_of_a_resolved_sea(benchmark):
    sea = SpectralSea(
        spectrum=Elfouhaily(wind_speed=5.0, fetch=30e3),
        spreading="elfouhaily",
        mss="elfouhaily",
        waves=Band(omega_min=1.18, omega_max=24.0, d_omega=0.2, d_theta=0.1),
    )
    info = benchmark.pedantic(resolved_sea, (mt.Link(), sea), rounds=1)
    benchmark.extra_info.update(info)
    assert info["facets"] < 60_000, info
    assert info["direct_seconds"] <= 0.02, info
    assert 10_000 * info["seconds_per_realization"] <= 30 * 60 * 2, info
