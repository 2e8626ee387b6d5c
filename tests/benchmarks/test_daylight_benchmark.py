"""Downlink gain to 1 % and far aside, background of one sea to 3 %, in CPU seconds of new seas.

Run with `pytest tests/benchmarks --benchmark-only` on a quiet machine.
"""

from __future__ import annotations

import warnings
from statistics import median
from time import process_time

import pytest

import meshtrace as mt
from meshtrace.bench import new_sea
from meshtrace.surfaces import JonswapSea

SEA = JonswapSea(wind_speed=5.0, seed=7)
DAY = mt.Daylight(direct=1.421482, diffuse=0.295018)  # clear sky, sun at 30 degrees
UP = mt.Link(receiver=mt.Receiver(fov_deg=20.0))
DOWN = mt.Link().mirrored()


def background_seconds(link, rtol=0.03, rounds=5):
    """Return the CPU seconds of the background of new seas at a relative error, mesh included."""
    photons, rows = 256, []
    for seed in range(rounds + 1):  # the first compiles
        while True:
            start = process_time()
            found = mt.background(link, SEA.with_seed(seed), DAY, photons=photons, threads=1)
            seconds = process_time() - start
            reached = found.radiance_stderr / found.radiance
            if reached <= rtol:
                break
            photons *= 2
        rows.append((seconds, reached))
    seconds, reached = zip(*rows[1:], strict=True)
    return {"cpu_seconds": median(seconds), "rtol": max(reached), "photons": photons}


def test_downlink_to_one_per_cent(benchmark):
    info = benchmark.pedantic(new_sea, (DOWN, SEA), {"rtol": 0.01, "threads": 1}, rounds=1)
    benchmark.extra_info.update(info)
    assert info["rtol"] <= 0.01, info


def far_seconds(link):
    """Return the CPU seconds of one gain far aside, mesh included."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # few paths, light reflected by the surface
        mt.simulate(link, SEA, threads=1)  # compiles
        start = process_time()
        mt.simulate(link, SEA, threads=1)
    return {"cpu_seconds": process_time() - start}


@pytest.mark.parametrize("aside", [20.0, 50.0, 100.0])
def test_downlink_far_aside(benchmark, aside):
    lamp = mt.AirLed(half_angle_deg=60.0)
    end = mt.WaterReceiver(position=(aside, 0.0), fov_deg=180.0)
    link = mt.Link(transmitter=lamp, receiver=end)
    info = benchmark.pedantic(far_seconds, (link,), rounds=1)
    benchmark.extra_info.update(info)
    assert info["cpu_seconds"] <= 5.0, info


@pytest.mark.parametrize(("name", "most"), [("air", 0.5), ("water", 1.5)])
def test_background_to_three_per_cent(benchmark, name, most):
    link = UP if name == "air" else DOWN
    info = benchmark.pedantic(background_seconds, (link,), rounds=1)
    benchmark.extra_info.update(info)
    assert info["rtol"] <= 0.03, info
    assert info["cpu_seconds"] <= most, info
