"""Forced against analog: every feature of the link, both at half a per cent or better.

`pytest tests/engine/test_forced_analog.py -m "slow or not slow" -s` prints both gains, their
errors and z of every case.

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
U5, U13 = (JonswapSea(wind_speed=u, seed=3, mss="band", waves="paper") for u in (5.0, 13.0))
ROUGH = JonswapSea(wind_speed=13.0, seed=3, omega_max=8.0, mss="band", waves="paper")
TILTED = JonswapSea(wind_speed=13.0, seed=3, waves="paper")
FOCUSING = SinusoidalSea(amplitude=0.1, wavelength=2.0, phase=0.4)
LAYERS = ((0.0, 0.1, 0.2), (4.0, 0.15, 0.05), (20.0, 0.1, 0.03))
TABLE = mt.TabulatedPhase(
    theta_deg=(0.1, 1.0, 5.0, 20.0, 60.0, 120.0, 180.0), value=(900.0, 60.0, 5.0, 0.4, 0.03, 0.006, 0.005)
)  # fmt: skip


def link_of(**changes):
    return mt.Link(**{"receiver": RX, "physics": KILL, **changes})


# link, sea, normals, analog photons for half a per cent, chains
CASES = {
    "flat": (link_of(), FLAT, "vertex", 10e6, 20_000),
    "5 m/s": (link_of(), U5, "vertex", 11e6, 20_000),
    "5 m/s facets": (link_of(), U5, "facet", 11e6, 40_000),
    "13 m/s": (link_of(), U13, "vertex", 11e6, 20_000),
    "13 m/s facets": (link_of(), U13, "facet", 11e6, 40_000),
    "offset": (link_of(receiver=RX.model_copy(update={"position": (0.5, 0.0)})), U13, "vertex", 11e6, 20_000),
    "tilt": (link_of(receiver=RX.model_copy(update={"tilt_deg": 20.0, "tilt_azimuth_deg": 70.0})), U13, "vertex", 12e6, 20_000),
    "wide lamp": (
        link_of(transmitter=mt.Led(half_angle_deg=60.0), receiver=mt.Receiver(radius=1.0)), U13, "vertex", 15e6, 20_000,
    ),
    "b = 0.2": (link_of(water=mt.Water(a=0.05, b=0.2)), U13, "vertex", 16e6, 60_000),
    "bubbles": (link_of(bubbles=mt.HallNovarini(wind_speed=13.0)), U13, "vertex", 11e6, 20_000),
    "bubbles, mean level": (
        link_of(bubbles=mt.HallNovarini(wind_speed=13.0, depth="mean_level")),
        JonswapSea(wind_speed=13.0, seed=6, waves="paper"), "vertex", 10e6, 20_000,
    ),
    "focusing": (link_of(), FOCUSING, "vertex", 5.5e6, 20_000),
    "focusing facets": (link_of(), FOCUSING, "facet", 5.5e6, 20_000),
    "omega_max 8": (link_of(), ROUGH, "vertex", 8e6, 20_000),
    "omega_max 8 facets": (link_of(), ROUGH, "facet", 8e6, 60_000),
    "30 m": (
        link_of(transmitter=mt.Led(depth=30.0), receiver=mt.Receiver(radius=2.0)), U5, "vertex", 2e6, 20_000,
    ),
    "paper": (link_of(physics="paper"), U5, "vertex", 15e6, 20_000),
    "layers": (link_of(water=mt.Water(layers=LAYERS)), U13, "vertex", 12e6, 30_000),
    "tabulated": (link_of(water=mt.Water(phase=TABLE)), U13, "vertex", 11e6, 20_000),
    "Henyey-Greenstein": (
        link_of(water=mt.Water(phase=mt.HenyeyGreenstein(g=0.9))), U13, "vertex", 11e6, 20_000,
    ),
    "foam": (link_of(whitecaps=mt.Whitecaps(wind_speed=13.0)), U13, "vertex", 11e6, 20_000),
    "tilted slopes": (link_of(), TILTED, "vertex", 11e6, 20_000),
    "tilted slopes, facets": (link_of(), TILTED, "facet", 11e6, 40_000),
    "default aperture": (link_of(receiver=mt.Receiver()), U13, "vertex", 260e6, 4_000),
}  # fmt: skip


def compare(name, link, sea, normals, photons, chains, tests, rtol):
    """Compare both gains, each good to a relative error, by a z test."""
    seed = list(CASES).index(name)  # cases are independent of each other
    forced = mt.simulate(link, sea, photons=chains, seed=seed, normals=normals)
    assert forced.gain_stderr <= rtol * forced.gain
    analog = mt.simulate(
        link, sea, estimator="analog", photons=int(photons), seed=100 + seed, normals=normals
    )
    assert analog.gain_stderr <= rtol * analog.gain, analog.gain_stderr / analog.gain
    z = (forced.gain - analog.gain) / np.hypot(forced.gain_stderr, analog.gain_stderr)
    said = (
        f"{name}: {forced.gain:.4e} +- {forced.gain_stderr:.1e}, "
        f"analog {analog.gain:.4e} +- {analog.gain_stderr:.1e}, z {z:+.2f}"
    )
    print(said)
    p = z_test(forced.gain, forced.gain_stderr, analog.gain, analog.gain_stderr)
    assert p > sidak(ALPHA, tests), said


QUICK = ["13 m/s", "focusing", "omega_max 8 facets", "bubbles", "layers", "paper", "tilted slopes"]


@pytest.mark.parametrize("name", QUICK)
@pytest.mark.thorough_but("paper", "13 m/s", "tilted slopes")
def test_estimators_agree_to_three_per_cent(name):
    """A quick look with few photons; the slow test below looks closely."""
    link, sea, normals, _photons, chains = CASES[name]
    wide = link.model_copy(update={"receiver": mt.Receiver(radius=0.5)})
    compare(name, wide, sea, normals, 300_000, chains // 8, len(QUICK), rtol=0.03)


def marked(name):
    """Return a case, slow but for the one that once had a coarser mesh for photons."""
    mark = pytest.mark.thorough if name == "focusing facets" else pytest.mark.slow
    return pytest.param(name, marks=mark)


@pytest.mark.parametrize("name", [marked(name) for name in CASES])
def test_estimators_agree(name):
    compare(name, *CASES[name], len(CASES), rtol=0.005)


@pytest.mark.slow
def test_estimators_agree_at_every_place():
    """A ring of default apertures in one run, each within its own error."""
    angle = 2 * np.pi * np.arange(16) / 16
    receivers = tuple(
        mt.Receiver(position=(float(0.3 * np.cos(a)), float(0.3 * np.sin(a)))) for a in angle
    )
    link = mt.Link(receiver=receivers, physics=KILL)
    a = mt.simulate(link, TILTED, estimator="analog", photons=12_000_000, seed=6)
    f = mt.simulate(link, TILTED, photons=4000, seed=7)
    p = [
        z_test(a.gain[i], a.gain_stderr[i], f.gain[i], f.gain_stderr[i])
        for i in range(len(receivers))
    ]
    assert min(p) > sidak(ALPHA, len(p))


def test_reflected_share_makes_the_sum_whole():
    """Light sent back by the surface and scattered up again, in water that scatters it well."""
    water = mt.Water(a=0.1, b=0.5, phase=mt.HenyeyGreenstein(g=0.3))
    receiver = mt.Receiver(radius=0.5, fov_deg=60.0)
    whole = mt.Link(water=water, transmitter=mt.Led(depth=3.0), receiver=receiver)
    f = mt.simulate(whole, FLAT, photons=20_000, seed=1)
    a = mt.simulate(whole, FLAT, estimator="analog", photons=600_000, seed=2)
    assert f.gain_reflected > 0.0
    assert z_test(f.gain, f.gain_stderr, a.gain, a.gain_stderr) > ALPHA
