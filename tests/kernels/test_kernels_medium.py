"""Coefficients, optical paths and outcomes of collisions."""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, chi2_test, sidak

import meshtrace as mt
from meshtrace.engine.setup import arrays
from meshtrace.kernels import jit, vectors
from meshtrace.kernels import medium as kernel
from meshtrace.kernels.random import uniforms
from meshtrace.surfaces import FlatSea, SinusoidalSea

LAYERS = ((0.0, 0.05, 0.3), (2.0, 0.05, 0.1), (2.5, 0.4, 0.8), (8.0, 0.2, 0.1))
LAYERED = mt.Water(layers=LAYERS)
GRID_ERROR = 1e-3  # the layers are tabulated every 8 m / 2048


@jit.allocating_entry
def look_up(table, positions):
    out = np.empty(len(positions))
    for i in range(len(positions)):
        out[i] = kernel.lookup(table, positions[i])
    return out


@jit.allocating_entry
def coefficients(medium, x, y, z):
    out = np.empty((len(z), 3))
    for i in range(len(z)):
        a, b = kernel.water_coefficients(medium, z[i])
        out[i, 0], out[i, 1] = a, b
        out[i, 2] = kernel.bubble_scattering(medium, vectors.Vec3(x[i], y[i], z[i]))
    return out


@jit.allocating_entry
def path(medium, z0, z1, length):
    return kernel.absorption_path(medium, z0, z1, length)


@jit.allocating_entry
def elevations(medium, x, y):
    out = np.empty(len(x))
    for i in range(len(x)):
        out[i] = kernel.local_elevation(medium, vectors.Vec3(x[i], y[i], 0.0))
    return out


@jit.allocating_entry
def free_path(medium, z, u):
    return kernel.sample_free_path(medium, vectors.Vec3(0.0, 0.0, z), u)


@jit.allocating_entry
def collisions(medium, z, n, seed):
    """Return s and weight after n tentative collisions at height z."""
    out = np.empty((n, 2))
    for i in range(n):
        u0, u1, _, _ = uniforms(seed, i, 1, 2)
        s, w, _ = kernel.collide(medium, vectors.Vec3(0.3, 0.4, z), 1.0, u0, u1)
        out[i, 0], out[i, 1] = s, w
    return out


def medium_of(water=None, surface=None, extent=20.0, **link):
    link = mt.Link(water=water or mt.Water(), **link)
    mesh = (surface or FlatSea()).mesh(extent=extent, spacing=extent / 80)
    return arrays.with_raster(
        arrays.medium_arrays(link, float(mesh.bounds[1, 2])), mt.EmbreeIntersector(mesh, 1)
    )


def test_lookup_is_linear_interpolation():
    table = np.random.default_rng(1).random(17)
    positions = np.concatenate([np.linspace(-2.0, 19.0, 500), np.arange(17.0)])
    np.testing.assert_allclose(
        look_up(table, positions), np.interp(positions, np.arange(17), table), rtol=1e-13
    )


def test_homogeneous_water():
    medium = medium_of(mt.Water(a=0.2, b=0.7))
    z = np.array([-50.0, -1.0, 0.0, 0.5])
    np.testing.assert_array_equal(
        coefficients(medium, z, z, z), np.broadcast_to((0.2, 0.7, 0.0), (4, 3))
    )
    assert path(medium, -3.0, -1.0, 5.0) == 0.2 * 5.0


def test_layers_follow_the_profile():
    medium = medium_of(LAYERED)
    depth = np.linspace(-1.0, 12.0, 400)
    got = coefficients(medium, depth, depth, -depth)
    np.testing.assert_allclose(got[:, :2].T, LAYERED.profile(depth), atol=6e-3)
    away = np.abs(depth[:, None] - [2.0, 2.5, 8.0]).min(axis=1) > 0.01
    np.testing.assert_allclose(got[away, :2].T, LAYERED.profile(depth[away]), atol=1e-12)


@pytest.mark.parametrize(
    ("z0", "z1"),
    [(-0.5, -7.0), (-7.0, -0.5), (-2.1, -2.2), (-1.0, 0.4), (-20.0, -5.0), (0.4, -9.0)],
)
@pytest.mark.parametrize("slant", [1.0, 1.7, 40.0])
def test_absorption_path_integrates_the_layers(z0, z1, slant):
    medium = medium_of(LAYERED)
    depth = np.linspace(-z0, -z1, 20_001)
    a = LAYERED.profile(depth)[0]
    expected = slant * abs(np.trapezoid(a, depth))
    assert path(medium, z0, z1, slant * abs(z1 - z0)) == pytest.approx(expected, rel=GRID_ERROR)


def test_absorption_path_of_a_level_path_takes_the_local_value():
    medium = medium_of(LAYERED)
    expected = 30.0 * float(LAYERED.profile(1.0)[0])
    for dz in (0.0, 1e-9, -1e-9, 1e-4):
        assert path(medium, -1.0, -1.0 + dz, 30.0) == pytest.approx(expected, rel=1e-6)


def test_absorption_paths_add_up():
    medium = medium_of(LAYERED)
    whole = path(medium, -9.0, -0.2, 17.6)
    parts = sum(path(medium, a, b, 2 * (b - a)) for a, b in [(-9, -4), (-4, -2.3), (-2.3, -0.2)])
    assert whole == pytest.approx(parts, rel=1e-12)


@pytest.mark.parametrize("wind_speed", [5.0, 13.0])
@pytest.mark.parametrize("mode", ["clamped", "mean_level", "local"])
def test_bubbles_on_a_flat_sea(wind_speed, mode):
    bubbles = mt.HallNovarini(wind_speed=wind_speed, depth=mode)
    medium = medium_of(bubbles=bubbles)
    depth = np.linspace(0.0, 5.0, 300)
    got = coefficients(medium, depth, depth, -depth)[:, 2]
    # the table ends 12 e-foldings down
    np.testing.assert_allclose(got, bubbles.b(depth), rtol=2e-4, atol=2e-5 * bubbles.b(0.0))
    assert (got <= medium.b_max - mt.Water().b + 1e-15).all(), "the majorant is no majorant"


def test_bubbles_under_waves_take_the_depth_that_is_asked_for():
    wave = SinusoidalSea(amplitude=0.5, wavelength=8.0)
    x = np.linspace(-9.0, 9.0, 91)
    y = np.full_like(x, 0.7)
    z = wave.elevation(x, y) - 0.4
    for mode, depth in (
        ("local", np.full_like(x, 0.4)),
        ("clamped", np.maximum(-z, 0.0)),
        ("mean_level", -z),
    ):
        bubbles = mt.HallNovarini(wind_speed=13.0, depth=mode)
        medium = medium_of(surface=wave, bubbles=bubbles, extent=10.0)
        expected = mt.HallNovarini(wind_speed=13.0, depth="mean_level").b(depth)
        # the raster of the local depth is 20 m / 255 wide
        rtol = 5e-3 if mode == "local" else 2e-4
        got = coefficients(medium, x, y, z)[:, 2]
        np.testing.assert_allclose(got, expected, rtol=rtol, err_msg=mode)
        assert got.max() <= medium.b_max - mt.Water().b + 1e-15


@pytest.fixture(scope="module")
def rastered():
    """Return a sinusoid over 20 m by 20 m and the medium with its raster, 4 nodes a metre."""
    wave = SinusoidalSea(amplitude=0.3, wavelength=5.0, direction_deg=30.0)
    bubbles = mt.HallNovarini(wind_speed=13.0, depth="local")
    return wave, medium_of(surface=wave, bubbles=bubbles, extent=10.0)


def test_local_elevation_is_bilinear(rastered):
    from scipy.interpolate import RegularGridInterpolator

    wave, medium = rastered
    nodes = medium.raster_x + medium.raster_step * np.arange(len(medium.raster))
    twin = RegularGridInterpolator((nodes, nodes), medium.raster)
    x, y = np.random.default_rng(2).uniform(-9.7, 9.7, (2, 500))
    got = elevations(medium, x, y)
    np.testing.assert_allclose(got, twin((x, y)), atol=1e-12)
    np.testing.assert_allclose(got, wave.elevation(x, y), atol=6e-3)


def test_local_elevation_holds_at_the_rim_and_is_constant_outside(rastered):
    wave, medium = rastered
    along = np.linspace(-10.0, 10.0, 81)
    for rim in (-10.0, 10.0):
        for x, y in ((np.full(81, rim), along), (along, np.full(81, rim))):
            expected = wave.elevation(x, y)
            np.testing.assert_allclose(elevations(medium, x, y), expected, atol=6e-3)
            beyond = elevations(medium, np.where(x == rim, 3 * rim, x), y)
            np.testing.assert_allclose(beyond, expected, atol=6e-3)


@pytest.mark.parametrize(
    ("absorption", "rate"),
    [("continuous", 0.7), ("implicit", 0.9), ("analog", 0.9), ("paper", 0.9)],
)
def test_free_path_has_the_rate_of_its_mode(absorption, rate):
    physics = mt.Physics(absorption=absorption)
    medium = medium_of(mt.Water(a=0.2, b=0.7), physics=physics)
    for u in (1e-9, 0.3, 1.0 - 1e-9):
        assert free_path(medium, -1.0, u) == pytest.approx(-math.log1p(-u) / rate, rel=1e-9)


def test_free_path_without_anything_to_meet_is_infinite():
    assert math.isinf(free_path(medium_of(mt.Water(a=0.2, b=0.0)), -1.0, 0.5))


def test_local_c_takes_the_coefficient_at_the_start():
    """E6: the printed free path; `exact` takes the majorant instead."""
    physics = mt.Physics(free_path="local_c")
    medium = medium_of(LAYERED, physics=physics)
    for z in (-1.0, -2.4, -6.0, -30.0):
        b = float(LAYERED.profile(-z)[1])
        assert free_path(medium, z, 0.5) == pytest.approx(math.log(2.0) / b, rel=5e-3)
    assert free_path(medium_of(LAYERED), -6.0, 0.5) == pytest.approx(math.log(2.0) / 0.8, rel=5e-3)


def outcomes(medium, z, n=200_000):
    """Return the counts of (null, kept direction with another weight, ended, turned)."""
    out = collisions(medium, z, n, 11)
    s, w = out.T
    null = (s < 0.0) & (w == 1.0)
    ended = w == 0.0
    weighted = (s < 0.0) & ~null & ~ended
    return np.array([null.sum(), weighted.sum(), ended.sum(), (s >= 0.0).sum()]), out


A, B = 0.2, 0.3
WATER = mt.Water(layers=((0.0, A, B), (5.0, A, B), (5.1, 0.5, 1.0), (9.0, 0.5, 1.0)))
ALBEDO = B / (A + B)


@pytest.mark.parametrize(
    ("absorption", "expected", "weight"),
    [
        # probabilities of null, weighted only, ended and turned; weight of those turned
        ("continuous", (1 - B / 1.0, 0.0, 0.0, B / 1.0), 1.0),
        ("implicit", (1 - (A + B) / 1.5, 0.0, 0.0, (A + B) / 1.5), ALBEDO),
        ("analog", (1 - (A + B) / 1.5, 0.0, A / 1.5, B / 1.5), 1.0),
        ("paper", (1 - (A + B) / 1.5, A / 1.5, 0.0, B / 1.5), ALBEDO),
    ],
)
def test_what_a_tentative_collision_does(absorption, expected, weight):
    medium = medium_of(WATER, physics=mt.Physics(absorption=absorption))
    counts, out = outcomes(medium, -2.0)
    assert (counts[np.array(expected) == 0.0] == 0).all()
    assert chi2_test(counts, expected) > sidak(ALPHA, 4)
    turned = out[out[:, 0] >= 0.0]
    assert (turned[:, 1] == weight).all()
    if absorption == "paper":
        others = out[(out[:, 0] < 0.0) & (out[:, 1] != 1.0)]
        assert (others[:, 1] == weight).all()


@pytest.mark.parametrize("absorption", ["continuous", "implicit", "analog", "paper"])
def test_scattering_angles_do_not_depend_on_the_choice_before(absorption):
    """The uniform that picks the collision must not leak into the angle."""
    phase = mt.HenyeyGreenstein(g=0.3)
    water = WATER.model_copy(update={"phase": phase})
    medium = medium_of(water, physics=mt.Physics(absorption=absorption))
    s = collisions(medium, -2.0, 300_000, 5)[:, 0]
    s = s[s >= 0.0]
    edges = np.linspace(0.0, np.pi, 41)
    counts = np.histogram(2.0 * np.arcsin(np.sqrt(s)), edges)[0]
    assert chi2_test(counts, np.diff(phase.cdf(edges))) > sidak(ALPHA, 4)


@pytest.mark.parametrize("absorption", ["continuous", "implicit", "analog", "paper"])
def test_water_and_bubbles_share_the_scattering(absorption):
    """A mixture of both phase functions in proportion to b and b_bub at the place."""
    bubbles = mt.HallNovarini(wind_speed=13.0)
    water = mt.Water(a=0.1, b=0.05, phase=mt.HenyeyGreenstein(g=-0.6))
    medium = medium_of(water, bubbles=bubbles, physics=mt.Physics(absorption=absorption))
    s = collisions(medium, -0.5, 400_000, 6)[:, 0]
    s = s[s >= 0.0]
    share = water.b / (water.b + float(bubbles.b(0.5)))
    edges = np.radians([0.0, 1.0, 5.0, 10.0, 20.0, 40.0, 60.0, 82.5, 90.0, 120.0, 150.0, 180.0])
    cdf = share * water.phase.cdf(edges) + (1.0 - share) * bubbles.phase_function().cdf(edges)
    counts = np.histogram(2.0 * np.arcsin(np.sqrt(s)), edges)[0]
    assert chi2_test(counts, np.diff(cdf)) > sidak(ALPHA, 4)
