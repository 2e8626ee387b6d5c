"""Random links: forced detection against analog photons over the same mesh."""

import numpy as np
import pytest
from mc_statistics import sidak, z_test

import meshtrace as mt
from meshtrace.engine.setup import meshing
from meshtrace.engine.setup.ends import crossing_reach
from meshtrace.engine.setup.options import resolve
from meshtrace.surfaces import FlatSea, JonswapSea

pytestmark = [
    pytest.mark.statistical,
    pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning"),
    pytest.mark.filterwarnings("ignore::meshtrace.FewSamplesWarning"),
]

ALPHA = 1e-4
FEW, MANY = range(6), range(6, 40)


def water(rng, depth):
    """Return clear to turbid water of a random phase function, at times above a bottom."""
    a, b = 10.0 ** rng.uniform([-1.3, -1.5], [-0.3, 0.3])
    b = min(b, 6.0 / depth)
    found = [
        mt.Water(a=a, b=b),
        mt.Water(a=a, b=b, phase=mt.HenyeyGreenstein(g=rng.uniform(0.0, 0.95))),
        mt.Water.from_type("petzold-clear", a=a, b=b),
    ][rng.integers(3)]
    if rng.random() < 0.15:
        found = found.replace(bottom_depth=1.5 * depth, bottom_albedo=0.4)
    return found


def link_and_sea(rng):
    """Return a link with an aperture that analog photons hit, up or down, and a sea."""
    depth, height = 10.0 ** rng.uniform([0.3, 0.0], [1.2, 1.0])
    ends = {"radius": rng.choice([0.3, 1.0]), "fov_deg": rng.choice([40.0, 90.0, 170.0])}
    ends["position"] = (0.5 * depth * rng.choice([0.0, 0.5, 1.0, 2.0]), 0.0)
    half = rng.choice([5.0, 15.0, 30.0, 60.0])
    kind = rng.choice(["up", "beam", "down"], p=[0.5, 0.25, 0.25])
    if kind == "down":
        lamp = mt.AirLed(height=height, half_angle_deg=half)
        receiver = mt.WaterReceiver(depth=depth, **ends)
    else:
        lamp = mt.Led(depth=depth, half_angle_deg=half)
        if kind == "beam":
            lamp = mt.GaussianBeam(depth=depth, divergence_deg=rng.choice([0.5, 2.0, 10.0]))
        tilt = rng.choice([0.0, 30.0])
        receiver = mt.Receiver(height=height, tilt_deg=tilt, **ends)
    sea = JonswapSea(wind_speed=rng.choice([3.0, 5.0, 8.0, 12.0]), seed=int(rng.integers(100)))
    surface = FlatSea() if rng.random() < 0.25 else sea
    return mt.Link(water=water(rng, depth), transmitter=lamp, receiver=receiver), surface


@pytest.mark.parametrize(
    "seeds", [pytest.param(FEW, marks=pytest.mark.thorough), pytest.param(MANY, marks=pytest.mark.slow)],
    ids=["few", "many"],
)  # fmt: skip
def test_estimators_agree_on_random_links(seeds):
    found = {}
    for seed in seeds:
        case = resolve(*link_and_sea(np.random.default_rng(seed)))
        mesh, _ = meshing.mesh_for(case.link, case.surface, reach=crossing_reach(case.link))
        forced = mt.simulate(case.link, mesh, photons=5000, seed=1)
        analog = mt.simulate(case.link, mesh, "analog", photons=400_000, seed=2)
        sure = forced.gain_bound is None and analog.gain > 7.0 * analog.gain_stderr
        if sure:
            values = forced.gain, forced.gain_stderr, analog.gain, analog.gain_stderr
            found[seed] = z_test(*values)
    assert len(found) > 0.5 * len(seeds)
    low = {seed: p for seed, p in found.items() if p < sidak(ALPHA, len(seeds))}
    assert not low
