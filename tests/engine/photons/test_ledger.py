"""Photons in = photons out, weight in = weight out, whatever the physics and the surface."""

import numpy as np
import pytest
from mc_statistics import z_test

import meshtrace as mt
from meshtrace.results import Fate
from meshtrace.surfaces import FlatSea, JonswapSea, SinusoidalSea

# small meshes on purpose: light that leaves them is a fate like the others
pytestmark = pytest.mark.filterwarnings("ignore:.*left the meshed surface:meshtrace.DomainWarning")

PHOTONS = 20_000
TURBID = mt.Water(a=0.1, b=0.5, phase=mt.HenyeyGreenstein(g=0.7))
SHALLOW = TURBID.model_copy(update={"bottom_depth": 4.0, "bottom_albedo": 0.5})
LAYERED = mt.Water(layers=((0.0, 0.05, 0.6), (1.5, 0.3, 0.1), (4.0, 0.02, 0.4)))
LED = mt.Led(depth=3.0, half_angle_deg=40.0)
RECEIVER = mt.Receiver(height=4.0, radius=1.0)


@pytest.fixture(scope="module")
def meshes():
    return {
        "flat": FlatSea().mesh(extent=40.0, spacing=10.0),
        "jonswap": JonswapSea(wind_speed=13.0, seed=1, waves="paper").mesh(
            extent=20.0, spacing=0.4
        ),
        "rough": JonswapSea(wind_speed=13.0, seed=2, omega_max=10.0, waves="paper").mesh(
            extent=8.0, spacing=0.1
        ),
        "steep": SinusoidalSea(amplitude=0.5, wavelength=4.0).mesh(extent=15.0, spacing=0.2),
    }


LINKS = {
    "default": {},
    "turbid": {"water": TURBID},
    "bottom": {"water": SHALLOW},
    "white bottom": {"water": SHALLOW.model_copy(update={"bottom_albedo": 1.0})},
    "layers": {"water": LAYERED},
    "no absorption": {"water": TURBID.model_copy(update={"a": 0.0, "bottom_depth": 5.0})},
    "bubbles": {"bubbles": mt.HallNovarini(wind_speed=13.0)},
    "whitecaps": {"whitecaps": mt.Whitecaps(wind_speed=13.0)},
    "nothing but foam": {"whitecaps": mt.Whitecaps(wind_speed=28.0)},
    "isotropic": {"transmitter": mt.IsotropicSource(depth=3.0)},
    "down": {"transmitter": mt.Led(depth=3.0, zenith_deg=180.0), "water": SHALLOW},
    "sun": {"transmitter": mt.Sun(zenith_deg=40.0), "water": SHALLOW},
    "low sun": {"transmitter": mt.Sun(zenith_deg=85.0)},
    "sky": {"transmitter": mt.UniformSky(half_width=3.0), "water": TURBID},
    "cloud": {"transmitter": mt.CardioidalSky(half_width=3.0)},
    "sun and lamp": {"transmitter": (mt.Sun(), LED)},
    "planes": {"planes": mt.IrradiancePlanes(depths=(0.9, 2.0), n_cosines=4, n_azimuths=3)},
    "water aperture": {"receiver": (RECEIVER, mt.WaterAperture(depth=1.0, radius=2.0))},
    "no receiver": {"receiver": ()},
    "matched": {"n_air": 1.33},
    "dense air": {"n_air": 1.7},
}
SWITCHES = {
    "physical": {},
    "implicit": {"absorption": "implicit"},
    "analog": {"absorption": "analog"},
    "paper absorption": {"absorption": "paper"},
    "roulette": {"fresnel": "roulette"},
    "both": {"fresnel": "paper_both"},
    "kill": {"reflected": "kill"},
    "ignore": {"second_hit": "ignore"},
    "local c": {"free_path": "local_c"},
    "printed direction": {"direction": "paper"},
    "printed snell": {"snell": "paper"},
    "position": {"fov": "paper_position"},
    "all printed": mt.Physics.paper().model_dump(),
}


def assert_balance(r):
    """No fate is lost, none is negative but the net of roulette."""
    assert sum(f.photons for f in r.fates.values()) == r.photons
    assert sum(f.weight for f in r.fates.values()) == pytest.approx(1.0, abs=1e-12)
    for name, fate in r.fates.items():
        assert fate.photons >= 0
        # a photon that survives roulette is heavier; over many it is even
        lowest = -max(0.05, 1.0 / r.photons) if name == "roulette" else 0.0
        assert fate.weight >= lowest, name
    assert set(r.fates) == {fate.name.lower() for fate in Fate}
    assert r.rays_lost == 0
    assert np.isfinite(r.gain).all()


def run(link, mesh, **options):
    return mt.simulate(link, mesh, estimator="analog", **{"photons": PHOTONS, **options})


@pytest.mark.parametrize("surface", ["flat", "jonswap"])
@pytest.mark.parametrize("name", LINKS)
def test_links(meshes, name, surface):
    link = mt.Link(**{"transmitter": LED, "receiver": RECEIVER, **LINKS[name]})
    assert_balance(run(link, meshes[surface], extent=None))


@pytest.mark.parametrize("name", SWITCHES)
@pytest.mark.parametrize("surface", ["jonswap", "steep"])
def test_physics(meshes, name, surface):
    link = mt.Link(
        water=SHALLOW, transmitter=LED, receiver=RECEIVER, physics=mt.Physics(**SWITCHES[name])
    )
    assert_balance(run(link, meshes[surface]))


@pytest.mark.parametrize("name", SWITCHES)
@pytest.mark.parametrize("zenith_deg", [0.0, 30.0, 60.0, 85.0])
def test_physics_with_light_from_the_air(meshes, name, zenith_deg):
    link = mt.Link(
        water=SHALLOW,
        transmitter=mt.Sun(zenith_deg=zenith_deg),
        receiver=RECEIVER,
        physics=mt.Physics(**SWITCHES[name]),
    )
    assert_balance(run(link, meshes["flat"]))


@pytest.mark.parametrize("normals", ["vertex", "facet"])
@pytest.mark.parametrize("surface", ["flat", "jonswap", "rough", "steep"])
def test_surfaces_and_normals(meshes, surface, normals):
    link = mt.Link(water=TURBID, transmitter=LED, receiver=RECEIVER)
    assert_balance(run(link, meshes[surface], normals=normals))


@pytest.mark.parametrize(
    "options",
    [
        {"roulette": 0.0},
        {"roulette": 1.0},
        {"max_surface_events": 1},
        {"max_events": 1},
        {"max_events": 3, "roulette": 0.5},
        {"photons": 1},
        {"photons": 4097, "batch_size": 4096},
    ],
    ids=str,
)
def test_limits(meshes, options):
    link = mt.Link(water=SHALLOW, transmitter=LED, receiver=RECEIVER)
    assert_balance(run(link, meshes["jonswap"], **options))


@pytest.mark.parametrize("roulette", [0.01, 0.3, 1.0])
@pytest.mark.thorough
@pytest.mark.slow_but("0.3")
def test_roulette_leaves_the_gain(meshes, roulette):
    link = mt.Link(water=SHALLOW, transmitter=LED, receiver=RECEIVER)
    fair = run(link, meshes["flat"], photons=200_000, roulette=0.0)
    played = run(link, meshes["flat"], photons=200_000, roulette=roulette, seed=2)
    assert z_test(fair.gain, fair.gain_stderr, played.gain, played.gain_stderr) > 1e-4
    assert abs(played.fates["roulette"].weight) < 0.01


def test_every_end_is_counted_under_its_name(meshes):
    """Light that was stopped by foam has not landed."""
    link = mt.Link(whitecaps=mt.Whitecaps(wind_speed=28.0), transmitter=LED, receiver=RECEIVER)
    assert link.whitecaps.transmittance == 0.0
    r = run(link, meshes["flat"])
    assert r.fates["landed"].weight == r.fates["received"].weight == 0.0
    assert r.fates["landed"].photons == 0
    assert r.fates["whitecap"].photons > 0.9 * r.photons


@pytest.mark.parametrize("normals", ["vertex", "facet"])
@pytest.mark.parametrize("surface", ["jonswap", "rough", "steep"])
def test_light_that_comes_back_from_outside_the_mesh_has_left_the_domain(meshes, surface, normals):
    """A photon may pass under the rim and come up outside: no hole in the mesh, no leak."""
    width = meshes[surface].bounds[1, 0]
    link = mt.Link(
        water=mt.Water(a=0.02, b=0.5, phase=mt.HenyeyGreenstein(g=0.3)),
        transmitter=mt.Led(depth=2.0, half_angle_deg=60.0, position=(0.8 * width, 0.0)),
        receiver=RECEIVER,
    )
    r = run(link, meshes[surface], photons=100_000, normals=normals)
    assert (r.rays_recast, r.rays_lost) == (0, 0)
    assert r.fates["leaked"] == (0, 0.0)
    assert r.fates["left_domain"].weight > 0.01


@pytest.mark.filterwarnings("always::meshtrace.DomainWarning")
def test_light_that_goes_down_for_ever_has_not_left_sideways(recwarn):
    """In clear water without a floor nothing ends it; a larger mesh would not help."""
    link = mt.Link(water=mt.Water(a=0.0, b=0.0))
    r = run(link, FlatSea().mesh(extent=1000.0, spacing=500.0))
    assert_balance(r)
    assert not any("enlarge extent" in str(w.message) for w in recwarn)
