"""Joined photons over waves without random slopes: against analog photons and forced detection."""

import math

import numpy as np
import pytest
from mc_statistics import sidak, z_test
from scipy.stats import chi2

import meshtrace as mt
from meshtrace.engine.photons import joined
from meshtrace.kernels import tally
from meshtrace.surfaces import JonswapSea, SinusoidalSea

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*left the meshed surface:meshtrace.DomainWarning"),
    pytest.mark.filterwarnings("ignore:.*effective sample size:meshtrace.FewSamplesWarning"),
    pytest.mark.filterwarnings("ignore:.*the mesh cuts off:meshtrace.DomainWarning"),
]

ALPHA = 1e-4
NONE = mt.Physics(unresolved="none")
KILL = NONE.replace(reflected="kill")
ISOTROPIC = mt.Water(a=0.1, b=0.5, phase=mt.HenyeyGreenstein(g=0.0))
FORWARD = mt.Water(a=0.1, b=0.8, phase=mt.HenyeyGreenstein(g=0.9))
DIM = mt.Water(a=0.1, b=0.3, bottom_depth=6.0, bottom_albedo=0.5)
LINK = mt.Link(
    water=ISOTROPIC,
    transmitter=mt.Led(depth=3.0, half_angle_deg=60.0),
    receiver=mt.Receiver(height=3.0, radius=1.0, fov_deg=160.0),
    physics=NONE,
)
DOWN = mt.Link(
    water=ISOTROPIC,
    transmitter=mt.AirLed(height=3.0, half_angle_deg=30.0),
    receiver=mt.WaterReceiver(depth=2.0, radius=0.5, position=(2.0, 0.0), fov_deg=120.0),
    physics=NONE,
)
SINUSOID = SinusoidalSea(amplitude=0.15, wavelength=3.0)
WAVES = JonswapSea(wind_speed=6.0, seed=23)

CASES = {
    "sinusoid": (LINK, SINUSOID, "vertex"),
    "waves": (LINK, WAVES, "vertex"),
    "facets": (LINK, WAVES, "facet"),
    "forward": (LINK.replace(water=FORWARD), WAVES, "vertex"),
    "Fournier-Forand": (
        LINK.replace(water=mt.Water(a=0.1, b=0.6, phase=mt.FournierForand())),
        WAVES,
        "vertex",
    ),
    "bottom": (LINK.replace(water=DIM), WAVES, "vertex"),
    "extended lamp": (
        LINK.replace(transmitter=mt.GaussianBeam(depth=4.0, divergence_deg=2.0, waist=0.3)),
        WAVES,
        "vertex",
    ),
    "down, sinusoid": (DOWN, SINUSOID, "vertex"),
    "down": (DOWN, WAVES, "vertex"),
    "down, facets": (DOWN, WAVES, "facet"),
}


def mesh_of(sea):
    return sea.mesh(extent=40.0, spacing=0.25)


@pytest.mark.statistical
@pytest.mark.thorough
@pytest.mark.parametrize("name", CASES)
@pytest.mark.slow_but("waves")
def test_analog_photons_agree(name):
    """With light reflected first, and without; unscattered light is that of the facets."""
    link, sea, normals = CASES[name]
    mesh = mesh_of(sea)
    found = joined.JoinedPhotons(link, 40_000, 3, normals).evaluate(mesh)
    parts, error = found.parts[:, 0], found.part_stderr[:, 0]
    parts[0] = mt.simulate(link, mesh, photons=4096, normals=normals).gain_ballistic
    options = {"photons": 400_000, "seed": 2, "normals": normals, "roulette": 1e-3}
    whole, once = (
        mt.simulate(link.replace(physics=p), mesh, "analog", **options) for p in (NONE, KILL)
    )
    p = [
        z_test(parts.sum(), math.hypot(*error), whole.gain, whole.gain_stderr),
        z_test(parts[:2].sum(), math.hypot(*error[:2]), once.gain, once.gain_stderr),
    ]
    assert min(p) > sidak(ALPHA, 2 * len(CASES)), (parts, error, whole, once)
    assert parts[tally.REFLECTED] > 2.0 * error[tally.REFLECTED] > 0.0


def test_results_do_not_depend_on_threads():
    mesh = mesh_of(WAVES)
    one, two = (joined.JoinedPhotons(LINK, 10_000, 1, threads=n).evaluate(mesh) for n in (1, 2))
    assert np.array_equal(one.groups, two.groups)
    assert np.array_equal(one.orders, two.orders)


def test_arrivals_add_up_to_the_gain():
    found = joined.JoinedPhotons(LINK, 2048, 1).evaluate(mesh_of(WAVES), record=True)
    (table,) = found.table
    weight, water, air = table.weight, table.water_path, table.air_path
    assert weight.sum() == pytest.approx(found.parts[:, 0].sum(), rel=1e-12)
    assert (water > 2.0).all()
    assert (air > 1.5).all()


@pytest.mark.statistical
@pytest.mark.slow
def test_stated_errors_are_those_of_the_scatter():
    """Chi-square of 64 seeds about their mean, 63 degrees of freedom."""
    mesh = mesh_of(WAVES)
    runs = [joined.JoinedPhotons(LINK, 2048, s).evaluate(mesh) for s in range(64)]
    for part in (1, tally.REFLECTED):
        gain = np.array([r.parts[part, 0] for r in runs])
        error = np.array([r.part_stderr[part, 0] for r in runs])
        square = ((gain - gain.mean()) ** 2).sum() / np.mean(error**2)
        assert chi2.ppf(1e-3, 63) < square < chi2.ppf(1.0 - 1e-3, 63)
