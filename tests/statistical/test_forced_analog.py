"""Forced against analog: every feature of the link, both at half a per cent or better.

The wide aperture (r = 0.25 m) has 25 times the hits of the default one and the same physics.
Light that the surface sends back is left out on both sides (`reflected="kill"`).
"""

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test

import meshtrace as mt
from meshtrace.surfaces import FlatSea, JonswapSea, SinusoidalSea

pytestmark = pytest.mark.filterwarnings("ignore:.*left the meshed surface:meshtrace.DomainWarning")

KILL = mt.Physics(reflected="kill")
RX = mt.Receiver(radius=0.25)
FLAT = FlatSea()
U5, U13 = JonswapSea(wind_speed=5.0, seed=3), JonswapSea(wind_speed=13.0, seed=3)
ROUGH = JonswapSea(wind_speed=13.0, seed=3, omega_max=8.0)
FOCUSING = SinusoidalSea(amplitude=0.1, wavelength=2.0, phase=0.4)
LAYERS = ((0.0, 0.1, 0.2), (4.0, 0.15, 0.05), (20.0, 0.1, 0.03))
TABLE = mt.TabulatedPhase(
    theta_deg=(0.1, 1.0, 5.0, 20.0, 60.0, 120.0, 180.0), value=(900.0, 60.0, 5.0, 0.4, 0.03, 0.006, 0.005)
)  # fmt: skip


def link_of(**changes):
    return mt.Link(**{"receiver": RX, "physics": KILL, **changes})


# link, sea, normals, analog photons, chains
CASES = {
    "flat": (link_of(), FLAT, "vertex", 30e6, 20_000),
    "5 m/s": (link_of(), U5, "vertex", 30e6, 20_000),
    "5 m/s facets": (link_of(), U5, "facet", 30e6, 20_000),
    "13 m/s": (link_of(), U13, "vertex", 30e6, 20_000),
    "13 m/s facets": (link_of(), U13, "facet", 30e6, 20_000),
    "offset": (link_of(receiver=RX.model_copy(update={"position": (0.5, 0.0)})), U13, "vertex", 30e6, 20_000),
    "tilt": (link_of(receiver=RX.model_copy(update={"tilt_deg": 20.0, "tilt_azimuth_deg": 70.0})), U13, "vertex", 30e6, 20_000),
    "wide lamp": (
        link_of(transmitter=mt.Led(half_angle_deg=60.0), receiver=mt.Receiver(radius=1.0)), U13, "vertex", 35e6, 20_000,
    ),
    "b = 0.2": (link_of(water=mt.Water(a=0.05, b=0.2)), U13, "vertex", 25e6, 30_000),
    "bubbles": (link_of(bubbles=mt.HallNovarini(wind_speed=13.0)), U13, "vertex", 30e6, 20_000),
    "bubbles, mean level": (
        link_of(bubbles=mt.HallNovarini(wind_speed=13.0, depth="mean_level")),
        JonswapSea(wind_speed=13.0, seed=6), "vertex", 30e6, 20_000,
    ),
    "focusing": (link_of(), FOCUSING, "vertex", 30e6, 20_000),
    "focusing facets": (link_of(), FOCUSING, "facet", 30e6, 20_000),
    "omega_max 8": (link_of(), ROUGH, "vertex", 30e6, 20_000),
    "omega_max 8 facets": (link_of(), ROUGH, "facet", 30e6, 20_000),
    "30 m": (
        link_of(transmitter=mt.Led(depth=30.0), receiver=mt.Receiver(radius=2.0)), U5, "vertex", 40e6, 20_000,
    ),
    "paper": (link_of(physics="paper"), U5, "vertex", 25e6, 20_000),
    "layers": (link_of(water=mt.Water(layers=LAYERS)), U13, "vertex", 30e6, 30_000),
    "tabulated": (link_of(water=mt.Water(phase=TABLE)), U13, "vertex", 30e6, 20_000),
    "Henyey-Greenstein": (
        link_of(water=mt.Water(phase=mt.HenyeyGreenstein(g=0.9))), U13, "vertex", 30e6, 20_000,
    ),
    "foam": (link_of(whitecaps=mt.Whitecaps(wind_speed=13.0)), U13, "vertex", 30e6, 20_000),
}  # fmt: skip


def compare(link, sea, normals, photons, chains, tests, rtol=0.005):
    forced = mt.simulate(link, sea, photons=chains, seed=3, normals=normals)
    assert forced.gain_stderr < rtol * forced.gain
    # photons for the wanted error: three quarters of the hits have about the full weight
    analog = mt.simulate(
        link, sea, estimator="analog", photons=int(photons), seed=4, normals=normals
    )
    assert analog.gain_stderr < 1.5 * rtol * analog.gain
    p = z_test(forced.gain, forced.gain_stderr, analog.gain, analog.gain_stderr)
    assert p > sidak(ALPHA, tests), (
        f"{forced.gain} +- {forced.gain_stderr}, analog {analog.gain} +- {analog.gain_stderr}"
    )


QUICK = ["13 m/s", "focusing", "omega_max 8 facets", "bubbles", "layers", "paper"]


@pytest.mark.parametrize("name", QUICK)
def test_estimators_agree_to_three_per_cent(name):
    """A quick look with few photons; the slow test below looks closely."""
    link, sea, normals, _photons, chains = CASES[name]
    wide = link.model_copy(update={"receiver": mt.Receiver(radius=0.5)})
    compare(wide, sea, normals, 400_000, chains // 8, len(QUICK), rtol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_estimators_agree(name):
    link, sea, normals, photons, chains = CASES[name]
    compare(link, sea, normals, photons / 2, chains, len(CASES))


@pytest.mark.slow
@pytest.mark.parametrize("sea", [FLAT, U13], ids=["flat", "13 m/s"])
def test_estimators_agree_on_the_default_aperture(sea):
    """A ring and a row of default apertures share one analog run: more hits for the time."""
    n = 16
    angle = 2 * np.pi * np.arange(n) / n
    receivers = tuple(
        mt.Receiver(position=(float(0.3 * np.cos(a)), float(0.3 * np.sin(a)))) for a in angle
    )
    link = mt.Link(receiver=receivers, physics=KILL)
    a = mt.simulate(link, sea, estimator="analog", photons=12_000_000, seed=6)
    f = mt.simulate(link, sea, photons=4000, seed=7)
    mean, error = a.gain.mean(), np.sqrt((a.gain_stderr**2).sum()) / n
    assert error < 0.015 * mean
    assert z_test(mean, error, f.gain.mean(), f.gain_stderr.mean()) > sidak(ALPHA, 2)
    z = (a.gain - f.gain) / np.hypot(a.gain_stderr, f.gain_stderr)
    assert np.abs(z).max() < 4.5


def test_reflected_share_makes_the_sum_whole():
    """Light sent back by the surface and scattered up again, in water that scatters it well."""
    water = mt.Water(a=0.1, b=0.5, phase=mt.HenyeyGreenstein(g=0.3))
    receiver = mt.Receiver(radius=0.5, fov_deg=60.0)
    whole = mt.Link(water=water, transmitter=mt.Led(depth=3.0), receiver=receiver)
    f = mt.simulate(whole, FLAT, photons=20_000, seed=1, reflected_photons=300_000)
    a = mt.simulate(whole, FLAT, estimator="analog", photons=600_000, seed=2)
    assert f.data["gain_reflected"][1][0] > 0.0
    assert z_test(f.gain, f.gain_stderr, a.gain, a.gain_stderr) > ALPHA
