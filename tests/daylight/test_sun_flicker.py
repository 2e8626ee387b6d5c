"""Flicker of light from the air under waves: lever, passing wave, random seas, band."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.fading import scintillation_of_spectrum
from meshtrace.surfaces import JonswapSea, SinusoidalSea
from meshtrace.surfaces.statistics import spectral_moment

REFERENCE = json.loads(
    (Path(__file__).parents[1] / "data/daylight_downlink_reference.json").read_text()
)["flicker"]
CLEAR = mt.Water(a=0.0, b=0.0)
HIGH = 2000.0  # a lamp whose light is nearly that of the sun [m]


@pytest.mark.parametrize(
    ("height", "key"), [(5.0, "h5"), (20.0, "h20"), (50.0, "h50"), (1e5, "sun")]
)
def test_the_lever_of_a_slope(height, key):
    # the fine part of a footprint is 2.5 beta and the radius of the receiver
    receiver = mt.WaterReceiver(depth=10.0, radius=0.05)
    link = mt.Link(transmitter=mt.AirLed(height=height), receiver=receiver)
    beta = (link.footprint().fine_extent - 0.05) / 2.5
    assert beta == pytest.approx(REFERENCE["beta_d10_m"][key], rel=2e-4)


@pytest.mark.parametrize("depth", [5.0, 10.0])
@pytest.mark.thorough
@pytest.mark.slow_but("5.0")
def test_sunlight_under_a_passing_wave(depth):
    """SI = (1 - eps^2)^(-1/2) - 1, eps = (n - 1) d A k^2 / n, below the first caustic."""
    wanted = REFERENCE["sinus_A0.05_lam3_sun"][f"{depth:g}"]
    k = 2.0 * math.pi / 3.0
    eps = 0.33 / 1.33 * depth * 0.05 * k**2
    assert eps == pytest.approx(wanted["eps"], rel=2e-4)
    assert (1.0 - eps**2) ** -0.5 - 1.0 == pytest.approx(wanted["SI"], rel=1e-3)
    receiver = mt.WaterReceiver(depth=depth, radius=0.005, fov_deg=120.0)
    link = mt.Link(water=CLEAR, transmitter=mt.AirLed(), receiver=receiver)
    sea, day = (
        SinusoidalSea(amplitude=0.05, wavelength=3.0),
        mt.Daylight(direct=1.0, diffuse=0.0, sun_zenith_deg=0.0),
    )
    # half of 24 phases: crests on either side of the receiver are alike
    times = (np.arange(12) + 0.5) / 24.0 * 2.0 * math.pi / math.sqrt(9.81 * k)
    fine = mt.Meshing(spacing=0.05, extent=2.0)
    series = mt.background_series(link, sea, day, times, photons=128, mesh=fine)
    # the disk of the sun takes 0.4 % at 10 m
    assert series.scintillation_index == pytest.approx(wanted["SI"], rel=2e-2)


def index_of_sunlight(depth, band):
    """Return the index of unscattered sunlight in cells of 5 cm, without tilts."""
    # by reciprocity: a lamp at the depth, seen by a disk far above whose image has their area
    disk = mt.Receiver(height=HIGH, radius=0.0282 * (1.0 + 1.33 * HIGH / depth), fov_deg=180.0)
    lamp = mt.Led(depth=depth, half_angle_deg=60.0)
    link = mt.Link(water=CLEAR, transmitter=lamp, receiver=disk)
    return scintillation_of_spectrum(link, JonswapSea(wind_speed=5.0), omega_max=band, tilts=False)


@pytest.mark.parametrize("band", [8.0, 12.0])
def test_sunlight_under_random_seas(band):
    wanted = REFERENCE["jonswap5_seed7_sun"]
    at = wanted[f"omega_max_{band:g}"]
    # k = omega^2 / g; the reference is one realization of the sea
    moment = spectral_moment(JonswapSea(wind_speed=5.0).spectrum, 8, 0.01, band) / 9.81**4
    assert moment == pytest.approx(at["int_k4S"], rel=0.1)
    found = np.array([index_of_sunlight(float(d), band) for d in at["depth"]])
    # its rays in cells leave 0.01: at 1 m, 8 rad/s, beta^2 int k^4 S is 0.006 and it has 0.015
    bound = wanted["rel_tolerance"] * np.array(at["SI"]) + 0.01
    assert (np.abs(found - at["SI"]) < bound).all()
    if band == 8.0:  # weak at 1 m
        assert found[0] == pytest.approx((0.33 / 1.33) ** 2 * moment, rel=0.02)


def test_the_band_of_the_waves_decides_the_flicker_of_sunlight():
    page = (Path(__file__).parents[2] / "docs/daylight.md").read_text()
    for band in (8.0, 12.0, 30.0, 100.0):
        row = " | ".join(f"{index_of_sunlight(d, band):.2g}" for d in (1.0, 2.0, 5.0, 10.0, 20.0))
        assert f"| {band:g} | {row} |" in page
