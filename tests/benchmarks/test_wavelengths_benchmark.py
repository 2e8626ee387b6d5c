"""CPU time of 31 wavelengths over that of one; run with `pytest tests/benchmarks --benchmark-only`.

The bound is the project's own: twice the time of a run at 550 nm, with kernels warm and one thread.
"""

import time

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.surfaces import FlatSea, JonswapSea

pytestmark = [
    pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning"),
    pytest.mark.filterwarnings("ignore::meshtrace.FewSamplesWarning"),
]

MOST = 2.0
COLOURS = np.linspace(400.0, 570.0, 31)


def typed(name, **parts):
    return mt.Link(water=mt.Water.from_type(name, 550.0), **parts)


def chlorophyll(content, **parts):
    spectrum = mt.optics.Constituents(chlorophyll=content)
    return mt.Link(water=mt.Water(spectrum=spectrum, wavelength_nm=550.0), **parts)


WAVY, WIDE = JonswapSea(wind_speed=5.0, seed=2), mt.Receiver(radius=10.0)
PROFILE = chlorophyll([(0, 0.2), (5, 1.0), (20, 0.3)], bubbles=mt.HallNovarini(wind_speed=8.0))
CASES = {
    "clear-flat": (typed("jerlov-II"), FlatSea(), "forced"),
    "clear-wavy": (typed("jerlov-II"), WAVY, "forced"),
    "clear-down": (typed("jerlov-II").mirrored(), FlatSea(), "forced"),
    "clear-analog": (typed("jerlov-II", receiver=WIDE), WAVY, "analog"),
    "turbid-wavy": (typed("jerlov-3C"), WAVY, "forced"),
    "turbid-analog": (typed("jerlov-3C", receiver=WIDE), WAVY, "analog"),
    "chlorophyll-wavy": (chlorophyll(0.5), WAVY, "forced"),
    "profile-bubbles": (PROFILE, JonswapSea(wind_speed=8.0, seed=2), "forced"),
}


DAY = mt.Daylight.clear_sky(30.0, wavelength_nm=550.0)
SEEN = {
    "clear-flat": (typed("jerlov-II"), FlatSea(), "quasi-single"),
    "clear-wavy": (typed("jerlov-II"), WAVY, "quasi-single"),
    "turbid-wavy": (typed("jerlov-3C"), WAVY, "quasi-single"),
    "chlorophyll-flat": (chlorophyll(0.5), FlatSea(), "quasi-single"),
    "chlorophyll-wavy": (chlorophyll(0.5), WAVY, "quasi-single"),
    "profile-bubbles": (PROFILE, WAVY, "quasi-single"),
    "turbid-walk": (typed("jerlov-3C"), WAVY, "walk"),
    "chlorophyll-walk": (chlorophyll(0.5), WAVY, "walk"),
    "clear-down": (typed("jerlov-II").mirrored(), FlatSea(), "walk"),
    "turbid-down": (typed("jerlov-3C").mirrored(), WAVY, "walk"),
}
MAPS = {
    "clear-flat": (typed("jerlov-II"), FlatSea()),
    "clear-wavy": (typed("jerlov-II"), WAVY),
    "turbid-wavy": (typed("jerlov-3C"), WAVY),
    "chlorophyll-wavy": (chlorophyll(0.5), WAVY),
}


def ratio_of(benchmark, run, rounds):
    """Return the CPU time of `run` at all colours over that at one."""
    spent = {1: [], len(COLOURS): []}

    def both():
        for colours in ([550.0], COLOURS):
            start = time.process_time()
            run(colours)
            spent[len(colours)].append(time.process_time() - start)

    benchmark.pedantic(both, rounds=rounds, warmup_rounds=1)
    ratio = min(spent[len(COLOURS)]) / min(spent[1])
    benchmark.extra_info["ratio"] = ratio
    return ratio


@pytest.mark.parametrize("case", CASES)
def test_all_colours_for_twice_the_time_of_one(benchmark, case):
    link, sea, estimator = CASES[case]
    photons = {"forced": 10_000, "analog": 200_000}[estimator]

    def run(colours):
        mt.simulate(
            link, sea, estimator, photons=photons, wavelengths_nm=colours, threads=1, seed=1
        )

    assert ratio_of(benchmark, run, 4) < MOST


@pytest.mark.parametrize("case", MAPS)
def test_maps_of_all_colours(benchmark, case):
    link, sea = MAPS[case]

    def run(colours):
        mt.coverage_map(link, sea, wavelengths_nm=colours, threads=1)

    assert ratio_of(benchmark, run, 2) < MOST


@pytest.mark.parametrize("case", SEEN)
def test_backgrounds_of_all_colours(benchmark, case):
    link, sea, water = SEEN[case]

    def run(colours):
        mt.background(link, sea, DAY, water=water, wavelengths_nm=colours, threads=1)

    assert ratio_of(benchmark, run, 4) < MOST
