"""Joined photons: against analog photons, forced detection, and themselves."""

import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from mc_statistics import sidak, z_test

import meshtrace as mt
from meshtrace.engine.photons import joined
from meshtrace.engine.setup import ends, meshing
from meshtrace.engine.setup.options import resolve
from meshtrace.errors import Refused
from meshtrace.kernels import tally
from meshtrace.mesh import UnresolvedSlopes
from meshtrace.results.tallies import error_of_groups
from meshtrace.surfaces import FlatSea, JonswapSea

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*left the meshed surface:meshtrace.DomainWarning"),
    pytest.mark.filterwarnings("ignore:.*effective sample size:meshtrace.FewSamplesWarning"),
    pytest.mark.filterwarnings("ignore:.*the mesh cuts off:meshtrace.DomainWarning"),
]

ALPHA = 1e-4
KILL = mt.Physics(reflected="kill")
FLAT, WAVES = FlatSea(), JonswapSea(wind_speed=8.0, seed=23)
ISOTROPIC = mt.Water(a=0.1, b=0.5, phase=mt.HenyeyGreenstein(g=0.0))
WIDE = mt.Receiver(height=3.0, radius=1.0, fov_deg=160.0)
LAMP = mt.Led(depth=3.0, half_angle_deg=60.0)
DIM = mt.Water(a=0.1, b=0.3, bottom_depth=6.0, bottom_albedo=0.5)
LAYERS = mt.Water(layers=((0.0, 0.05, 0.1), (3.0, 0.1, 0.6), (8.0, 0.2, 0.2)))

UP = {
    "still": (mt.Link(water=ISOTROPIC, transmitter=LAMP, receiver=WIDE), FLAT),
    "waves": (mt.Link(water=ISOTROPIC, transmitter=LAMP, receiver=WIDE), WAVES),
    "bottom": (mt.Link(water=DIM, transmitter=LAMP, receiver=WIDE), WAVES),
    "beam of 0.3 m": (
        mt.Link(
            water=ISOTROPIC,
            transmitter=mt.GaussianBeam(depth=4.0, divergence_deg=2.0, waist=0.3),
            receiver=WIDE,
        ),
        WAVES,
    ),
    "layers, bubbles, foam": (
        mt.Link(
            water=LAYERS.replace(phase=mt.HenyeyGreenstein(g=0.5)),
            bubbles=mt.HallNovarini(wind_speed=10.0),
            whitecaps=mt.Whitecaps(wind_speed=10.0),
            transmitter=LAMP,
            receiver=WIDE,
        ),
        WAVES,
    ),
}
DOWN = mt.Link(
    water=ISOTROPIC,
    transmitter=mt.AirLed(height=3.0, half_angle_deg=30.0),
    receiver=mt.WaterReceiver(depth=2.0, radius=0.5, position=(2.0, 0.0), fov_deg=120.0),
)


def mesh_of(link, sea):
    return meshing.mesh_for(link, sea, reach=ends.crossing_reach(link))[0]


def traced(link, mesh, photons):
    """Return analog gains and errors, of all light and of light that was not reflected first."""
    runs = [
        mt.simulate(x, mesh, "analog", photons=photons, seed=2, roulette=1e-3)
        for x in (link, link.replace(physics=KILL))
    ]
    return [(r.gain, r.gain_stderr) for r in runs]


@pytest.mark.statistical
@pytest.mark.thorough
@pytest.mark.parametrize("name", UP)
@pytest.mark.slow_but("bottom", "layers, bubbles, foam")
def test_analog_photons_agree(name):
    """With light reflected first, and without; unscattered light sampled where slopes are random."""
    link, sea = UP[name]
    mesh = mesh_of(link, sea)
    found = joined.JoinedPhotons(link, 60_000, 3, direct=True).evaluate(mesh)
    whole, once = traced(link, mesh, 400_000)
    parts, error = found.parts[:, 0], found.part_stderr[:, 0]
    if sea is FLAT:
        parts[0] = mt.simulate(link, mesh, photons=64).gain_ballistic
    p = [
        z_test(parts.sum(), math.hypot(*error), *whole),
        z_test(parts[:2].sum(), math.hypot(*error[:2]), *once),
    ]
    assert min(p) > sidak(ALPHA, 2 * len(UP)), (parts, error, whole, once)
    assert parts[tally.REFLECTED] > 2.0 * error[tally.REFLECTED] > 0.0


PEAKED = {
    "LED aside": (
        mt.Link(
            water=mt.Water(a=0.094, b=0.056),
            transmitter=mt.Led(depth=10.2, half_angle_deg=5.0),
            receiver=mt.Receiver(position=(5.1, 0.0), height=3.5, radius=1.0, fov_deg=170.0),
        ),
        JonswapSea(wind_speed=3.0, seed=7),
    ),
    "beam beside": (
        mt.Link(
            water=mt.Water.from_type("petzold-clear", a=0.054, b=0.219),
            transmitter=mt.GaussianBeam(depth=8.8, divergence_deg=2.0),
            receiver=mt.Receiver(position=(2.2, 0.0), height=1.5, radius=1.0, fov_deg=40.0),
        ),
        WAVES,
    ),
}


@pytest.mark.statistical
@pytest.mark.thorough
@pytest.mark.parametrize("name", PEAKED)
@pytest.mark.slow_but("LED aside")
def test_peaked_scattering_into_wide_apertures(name):
    """Directions drawn about a target and points of a connection are independent."""
    link, sea = PEAKED[name]
    mesh = mesh_of(link, sea)
    found = joined.JoinedPhotons(link, 150_000, 3).evaluate(mesh)
    gain = found.parts[1:, 0].sum() + mt.simulate(link, mesh, photons=64).gain_ballistic
    error = math.hypot(*found.part_stderr[1:, 0])
    whole = mt.simulate(link, mesh, "analog", photons=600_000, seed=2)
    assert z_test(gain, error, whole.gain, whole.gain_stderr) > sidak(ALPHA, 2), (gain, error)


@pytest.mark.statistical
@pytest.mark.parametrize("sea", [FLAT, WAVES], ids=["still", "waves"])
@pytest.mark.slow
def test_photons_run_backwards_from_a_receiver_above_a_bottom(sea):
    """Scattered light, by the bottom too: all that is not unscattered."""
    link = DOWN.replace(water=DIM, physics=KILL).replace("receiver.tilt_deg", 85.0)
    mesh = mesh_of(link, sea)
    found = joined.JoinedPhotons(link, 200_000, 3).evaluate(mesh)
    whole = mt.simulate(link, mesh, "analog", photons=2_000_000, seed=2, roulette=1e-3)
    direct = mt.simulate(link, mesh, photons=64).gain_ballistic
    gain, error = found.parts[1, 0] + direct, found.part_stderr[1, 0]
    assert z_test(gain, error, whole.gain, whole.gain_stderr) > sidak(ALPHA, 2)


@pytest.mark.statistical
@pytest.mark.thorough
@pytest.mark.parametrize("sea", [FLAT, WAVES], ids=["still", "waves"])
@pytest.mark.slow_but("still")
def test_photons_run_backwards_from_a_receiver_in_the_water(sea):
    """Both analog runs have the same photons: their difference is that of those reflected first."""
    mesh, n = mesh_of(DOWN, sea), 200_000
    found = joined.JoinedPhotons(DOWN, 60_000, 3, first=2).evaluate(mesh)
    (whole, error), (once, its_error) = traced(DOWN, mesh, n)
    share = whole - once
    # no photon counts in both parts: their covariance is minus the product of their means
    error = math.sqrt(error**2 - its_error**2 + 2.0 * once * share / n)
    assert error < 0.1 * share
    p = z_test(found.parts[tally.REFLECTED, 0], found.part_stderr[tally.REFLECTED, 0], share, error)
    assert p > sidak(ALPHA, 2)
    assert found.parts[tally.REFLECTED, 0] > 10.0 * found.part_stderr[tally.REFLECTED, 0]


def laser(wind_speed, radius):
    """Return a link of a laser at 20 m and a sea."""
    scenario = mt.Scenario.from_toml(
        f"""
        wind_speed = {wind_speed}
        water = {{ type = "petzold-coastal", a = 0.179, b = 0.219 }}
        receiver = {{ height = 30.0, radius = {radius}, fov_deg = 60.0 }}
        sea = {{ seed = 1, waves = "fading" }}
        [transmitter]
        kind = "gaussian-beam"
        depth = 20.0
        divergence_deg = 1.0
        waist = 0.0
        wavelength_nm = 450.0
        """
    )
    case = resolve(scenario)
    return case.link, case.surface


@pytest.mark.statistical
def test_a_laser_over_waves():
    """The gain of an independent program of forward photons over the same sea: 1.590(5)e-6."""
    link, sea = laser(8.0, 0.05)
    found = joined.JoinedPhotons(link, 50_000, 1, direct=True).evaluate(mesh_of(link, sea))
    error = math.hypot(*found.part_stderr[:, 0])
    assert error < 0.015 * 1.590e-6
    assert z_test(found.parts.sum(), error, 1.590e-6, 0.005e-6) > ALPHA


@pytest.mark.statistical
@pytest.mark.slow
def test_a_laser_over_low_waves():
    """Against analog photons; one photon in twelve counts, by the squares of the scores."""
    link, sea = laser(3.0, 0.5)
    mesh = mesh_of(link, sea)
    found = joined.JoinedPhotons(link, 100_000, 1, direct=True).evaluate(mesh)
    assert found.samples_of(1)[0].effective > 8_000
    _, once = traced(link, mesh, 2_000_000)
    assert z_test(found.parts[:2].sum(), math.hypot(*found.part_stderr[:2, 0]), *once) > ALPHA


@pytest.mark.parametrize("sea", [FLAT, WAVES], ids=["still", "waves"])
def test_water_that_takes_and_turns_no_light(sea):
    link = mt.Link(water=mt.Water(a=0.0, b=0.0), transmitter=LAMP, receiver=WIDE)
    found = joined.JoinedPhotons(link, 20_000, 1, direct=True).evaluate(mesh_of(link, sea))
    assert found.parts[1, 0] == 0.0
    if sea is FLAT:
        return
    exact = mt.simulate(link, sea, photons=64, normals="facet").gain_ballistic
    assert found.parts[0, 0] == pytest.approx(exact, rel=0.1)


@pytest.mark.thorough
def test_the_mesh_of_a_beam_is_cut_to_its_patch():
    """The same photons over the mesh of a wide source: 0.03 % of the gain in the mean of seas."""
    link, sea = laser(8.0, 0.05)
    lines = meshing.mesh_lines(link, sea, reach=ends.crossing_reach(link))
    wide = {**lines, "extent": 24.0, "fine_extent": 8.3}
    meshes = sea.mesh(0.0, **lines), sea.mesh(0.0, **wide)
    assert len(meshes[0].faces) < 0.3 * len(meshes[1].faces)
    cut, whole = (
        joined.JoinedPhotons(link, 40_000, 1, direct=True).evaluate(mesh).groups[:2, 0].sum(axis=0)
        for mesh in meshes
    )
    change = (cut - whole) / whole.mean()
    assert abs(change.mean()) < 0.001 + 3.9 * change.std(ddof=1) / math.sqrt(len(change))


@pytest.mark.statistical
@pytest.mark.parametrize("sea", [FLAT, WAVES], ids=["still", "waves"])
@pytest.mark.thorough
@pytest.mark.slow_but("waves")
def test_stated_errors_are_those_of_the_scatter(sea):
    """Chi-square of 64 seeds about their mean, 63 degrees of freedom."""
    from scipy.stats import chi2

    link = mt.Link(water=ISOTROPIC, transmitter=LAMP, receiver=WIDE)
    mesh = mesh_of(link, sea)
    runs = [joined.JoinedPhotons(link, 2048, s).evaluate(mesh) for s in range(64)]
    for part in (1, tally.REFLECTED):
        gain = np.array([r.parts[part, 0] for r in runs])
        error = np.array([r.part_stderr[part, 0] for r in runs])
        square = ((gain - gain.mean()) ** 2).sum() / np.mean(error**2)
        assert chi2.ppf(1e-3, 63) < square < chi2.ppf(1.0 - 1e-3, 63)


def test_results_do_not_depend_on_threads():
    link, sea = UP["waves"]
    mesh = mesh_of(link, sea)
    one, two = (joined.JoinedPhotons(link, 10_000, 1, threads=n).evaluate(mesh) for n in (1, 2))
    assert np.array_equal(one.groups, two.groups)
    assert np.array_equal(one.orders, two.orders)


def test_the_order_of_receivers_changes_nothing():
    one, other = WIDE, WIDE.replace(position=(1.0, 0.5), radius=0.3)
    mesh = mesh_of(mt.Link(transmitter=LAMP, receiver=(one, other)), WAVES)
    water = mt.Water(a=0.1, b=0.0)
    gains = [
        joined.JoinedPhotons(
            mt.Link(water=water, transmitter=LAMP, receiver=r), 4096, 1, direct=True
        )
        .evaluate(mesh)
        .parts[0]
        for r in ((one, other), (other, one))
    ]
    assert (gains[0] > 0.0).all()
    np.testing.assert_array_equal(gains[0], gains[1][::-1])


def test_arrivals_at_many_receivers_take_little_memory():
    """Of one part of a block at a time, and none of them are kept: else 550 MiB."""
    ends_of = tuple(WIDE.replace(position=(0.1 * i, 0.0)) for i in range(24))
    link, mesh = UP["still"][0].replace("receiver", ends_of), FLAT.mesh(extent=20.0, spacing=1.0)
    photons = joined.JoinedPhotons(link, 4096, 1)
    photons.evaluate(mesh)  # compiles
    tracemalloc.start()
    photons.evaluate(mesh)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 150 * 2**20


def test_arrivals_add_up_to_the_gain():
    link, sea = UP["waves"]
    found = joined.JoinedPhotons(link, 4096, 1).evaluate(mesh_of(link, sea), record=True)
    (table,) = found.table
    weight, water, air = table.weight, table.water_path, table.air_path
    assert weight.sum() == pytest.approx(found.parts[:, 0].sum(), rel=1e-12)
    assert (water > 2.0).all()
    assert (air > 2.0).all()
    assert set(table.group) <= set(range(32))


def test_nothing_is_reflected_where_it_is_ended():
    link, sea = UP["still"]
    found = joined.JoinedPhotons(link.replace(physics=KILL), 4096, 1).evaluate(mesh_of(link, sea))
    assert found.parts[1, 0] > 0.0
    assert found.parts[tally.REFLECTED, 0] == 0.0


@pytest.mark.parametrize("form", [{"snell": "paper"}, {"second_hit": "ignore"}])
def test_other_forms_are_refused(form):
    with pytest.raises(Refused, match="physics"):
        joined.JoinedPhotons(mt.Link(physics=mt.Physics(**form)), 64, 1)


@pytest.mark.statistical
@pytest.mark.thorough
def test_simulate_adds_light_reflected_first_of_a_side_looking_link():
    """20 m aside in clear water: half of the light. The own value is that of 4.4e7 photons."""
    link = mt.Link(
        water=mt.Water(a=0.179, b=0.219),
        transmitter=mt.Led(depth=4.0, half_angle_deg=60.0),
        receiver=mt.Receiver(position=(20.0, 0.0), height=3.0, radius=1.0, fov_deg=120.0),
    )
    found = mt.simulate(link, FLAT, photons=100_000, seed=5)
    assert found.gain_stderr < 0.012 * found.gain
    assert 0.35 < found.gain_reflected / found.gain < 0.65
    assert z_test(found.gain, found.gain_stderr, 2.190e-7, 0.020e-7) > ALPHA
    assert "reflected first" in found.summary()
    kept = mt.GainResult.from_dataset(found.to_dataset())
    assert kept.reflected == found.reflected


def test_light_to_many_receivers_does_not_depend_on_the_guides():
    """Of more than 64 receivers some are guides; fewer are guides all."""
    places = [(float(x), float(y)) for x in range(-4, 5) for y in range(-4, 5)]
    receivers = [mt.Receiver(height=5.0, position=p, radius=0.1, fov_deg=120.0) for p in places]
    mesh = JonswapSea(wind_speed=5.0, seed=1).mesh(extent=20.0, spacing=0.5)
    light = []
    for some, seed in ((receivers, 1), (receivers[::2], 2)):
        link = mt.Link(
            water=mt.Water(a=0.1, b=0.3),
            transmitter=mt.Led(depth=5.0),
            receiver=tuple(some),
        )
        groups = joined.JoinedPhotons(link, 1024, seed).evaluate(mesh).groups[tally.SCATTERED]
        light.append(groups[:: 2 if some is receivers else 1].mean(axis=0))
    means, errors = np.mean(light, axis=1), [error_of_groups(one) for one in light]
    assert z_test(means[0], math.hypot(*errors), means[1]) > ALPHA


def test_photons_leave_water_that_does_not_attenuate(monkeypatch):
    """Below bubbles, without absorption, they once went down for ever: 100 times the time."""
    windows, make = [], joined.JoinedPhotons._world

    def recorded(self, *inputs):
        world = make(self, *inputs)
        windows.append(world.joins.window)
        return world

    monkeypatch.setattr(joined.JoinedPhotons, "_world", recorded)
    link = mt.Link(
        transmitter=mt.GaussianBeam(depth=20.0), water=mt.Water(a=0.0, b=0.0),
        bubbles=mt.HallNovarini(wind_speed=8.0),
    )  # fmt: skip
    slopes = UnresolvedSlopes((1e-3, 1e-3), (1e-3, 1e-3))
    mesh = replace(FLAT.mesh(extent=8.0), unresolved=slopes)
    gains = joined.JoinedPhotons(link, 512, 1).evaluate(mesh)
    assert gains.parts.sum() > 0.0
    assert windows[0].kappa > 0.0
