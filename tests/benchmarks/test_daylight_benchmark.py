"""Downlink gain to 1 % of new seas and far aside, background of one sea to 3 %, in CPU seconds.

Run with `pytest tests/benchmarks --benchmark-only` on a quiet machine.
"""

from __future__ import annotations

import warnings

import pytest
from clocks import timed
from works import background_light, new_sea

import meshtrace as mt
from meshtrace.surfaces import JonswapSea

SEA = JonswapSea(wind_speed=5.0, seed=7)
UP = mt.Link(receiver=mt.Receiver(fov_deg=20.0))
DOWN = mt.Link().mirrored()


def test_downlink_to_one_per_cent(benchmark):
    info = benchmark.pedantic(new_sea, (DOWN, SEA), rounds=1)
    benchmark.extra_info.update(info)
    assert info["rtol"] <= 0.01, info


def far_seconds(link):
    """Return the CPU seconds of one gain far aside, mesh included."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # few paths, light reflected by the surface
        mt.simulate(link, SEA, threads=1)  # compiles
        return {"cpu_seconds": timed(lambda: mt.simulate(link, SEA, threads=1))[1]}


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
    info = benchmark.pedantic(background_light, (link, SEA), rounds=1)
    benchmark.extra_info.update(info)
    assert info["rtol"] <= 0.03, info
    assert info["cpu_seconds"] <= most, info
