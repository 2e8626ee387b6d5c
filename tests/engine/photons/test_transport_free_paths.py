"""Free paths: homogeneous, layered and bubbly water against exp(-tau), in kernels and engine."""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, chi2_test, sidak, z_test

import meshtrace as mt
from meshtrace.engine.setup import arrays
from meshtrace.kernels import jit, vectors
from meshtrace.kernels.medium import collide, sample_free_path
from meshtrace.kernels.random import uniforms
from meshtrace.optics import fresnel_reflectance
from meshtrace.surfaces import FlatSea

pytestmark = pytest.mark.filterwarnings("ignore:.*left the meshed surface:meshtrace.DomainWarning")

SAMPLES = 300_000
MODES = ("continuous", "implicit", "analog", "paper")
# constant below its last node; a jump is drawn over 2 mm
LAYERS = (
    (0.0, 0.05, 0.30),
    (2.0, 0.05, 0.30),
    (2.002, 0.40, 0.02),
    (5.0, 0.40, 0.02),
    (9.0, 0.02, 1.20),
    (12.0, 0.02, 0.10),
)


@jit.allocating_entry
def _first_collisions(medium, z0, dz, n, seed):
    """Return the depth of the first real collision and the weight after it; nan: reached z = 0."""
    out = np.empty((n, 2))
    for i in range(n):
        z, event = z0, 0
        out[i, 0], out[i, 1] = np.nan, 1.0
        while True:
            event += 1
            u_kind, u_theta, u_path, _ = uniforms(seed, i, event, 2)
            s = sample_free_path(medium, vectors.Vec3(0.0, 0.0, z), u_path)
            z += s * dz
            if not (-1e6 < z < 0.0):
                break
            turned, w, _ = collide(medium, vectors.Vec3(0.0, 0.0, z), 1.0, u_kind, u_theta)
            if turned >= 0.0 or w != 1.0:
                out[i, 0], out[i, 1] = -z, w
                break
    return out


def medium_of(water, bubbles=None, **physics):
    mesh = FlatSea().mesh(extent=10.0, spacing=1.0)
    link = mt.Link(water=water, bubbles=bubbles, physics=mt.Physics(**physics))
    return arrays.with_raster(arrays.medium_arrays(link), mt.EmbreeIntersector(mesh, 1))


def optical_depth(rate, z0, cos, depth):
    """Return tau along a slanted way from depth z0 to other depths, by fine quadrature."""
    grid = np.linspace(0.0, 60.0, 600_001)
    total = np.concatenate([[0.0], np.cumsum(0.5 * (rate(grid[1:]) + rate(grid[:-1])))]) * 1e-4
    return np.abs(np.interp(depth, grid, total) - np.interp(z0, grid, total)) / abs(cos)


def assert_first_collisions(medium, rate, z0, dz, family, seed=1):
    """Chi-square of the depths of first collisions, and of those that never collide."""
    depths = _first_collisions(medium, -z0, dz, SAMPLES, seed)[:, 0]
    end = 0.0 if dz > 0.0 else 60.0
    edges = np.linspace(z0, end, 61)
    survive = np.exp(-optical_depth(rate, z0, dz, edges))
    p = np.append(survive[:-1] - survive[1:], survive[-1])
    inside = depths[np.isfinite(depths) & (depths <= 60.0)]
    ordered = edges if dz < 0.0 else edges[::-1]
    counts = np.histogram(inside, ordered)[0]
    counts = counts if dz < 0.0 else counts[::-1]
    counts = np.append(counts, SAMPLES - counts.sum())
    assert chi2_test(counts, p) > sidak(ALPHA, family)


SLANTS = [1.0, -1.0, 0.3, -0.3]


@pytest.mark.parametrize("dz", SLANTS)
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.thorough
def test_homogeneous_water(mode, dz):
    rate = 0.3 if mode == "continuous" else 0.3 + 0.15
    medium = medium_of(mt.Water(a=0.15, b=0.3), absorption=mode)
    assert_first_collisions(medium, lambda d: np.full_like(d, rate), 8.0, dz, 16)


@pytest.mark.parametrize("dz", SLANTS)
@pytest.mark.parametrize("mode", ["continuous", "implicit"])
def test_layered_water(mode, dz):
    water = mt.Water(layers=LAYERS)

    def rate(depth):
        a, b = water.profile(depth)
        return b if mode == "continuous" else a + b

    assert_first_collisions(medium_of(water, absorption=mode), rate, 10.0, dz, 8)


@pytest.mark.parametrize("dz", SLANTS)
@pytest.mark.parametrize("depth_mode", ["local", "clamped", "mean_level"])
@pytest.mark.slow_but(
    "local-1.0", "local--0.3", "clamped--1.0", "clamped-0.3", "mean_level-1.0", "mean_level--0.3"
)
def test_bubbly_water(depth_mode, dz):
    """Delta tracking through the exact Hall-Novarini profile, not a pure exponential."""
    bubbles = mt.HallNovarini(wind_speed=13.0, depth=depth_mode)
    medium = medium_of(mt.Water(b=0.01), bubbles)

    def rate(depth):
        return 0.01 + np.where(depth < 12.0 * bubbles.e_folding, bubbles.b(depth), 0.0)

    assert_first_collisions(medium, rate, 6.0, dz, 12)


@pytest.mark.parametrize("mode", MODES)
def test_mean_weight_left_by_absorption_is_the_albedo(mode):
    """What a first collision keeps on average, by whichever means: albedo, or all of it."""
    a, b = 0.15, 0.3
    weights = _first_collisions(
        medium_of(mt.Water(a=a, b=b), absorption=mode), -9.0, -1.0, SAMPLES, 2
    )
    w = weights[np.isfinite(weights[:, 0]), 1]
    expected = 1.0 if mode == "continuous" else b / (a + b)
    if mode == "analog":
        assert z_test(w.mean(), w.std() / math.sqrt(len(w)), expected) > ALPHA
    else:
        np.testing.assert_allclose(w, expected, rtol=1e-12)


def ballistic(link, mesh=None, photons=300_000, seed=3):
    mesh = mesh or FlatSea().mesh(extent=60.0, spacing=20.0)
    return mt.simulate(link, mesh, estimator="analog", photons=photons, seed=seed)


def narrow_link(water, bubbles=None, **physics):
    """Return a parallel beam into a pinhole of the finest field of view: unscattered light only."""
    return mt.Link(
        water=water,
        bubbles=bubbles,
        transmitter=mt.TopHatBeam(depth=10.0, divergence_deg=0.0),
        receiver=mt.Receiver(height=1.0, radius=1e-4, fov_deg=1e-3),
        physics=mt.Physics(**physics),
    )


NORMAL_LOSS = 1.0 - 0.02005931
ISOTROPIC = mt.HenyeyGreenstein(g=0.0)


@pytest.mark.parametrize("mode", MODES)
def test_beer_lambert_through_the_engine(mode):
    """exp(-(a + b) d); as printed b acts as albedo b (E5)."""
    a, b = 0.1, 0.05
    r = ballistic(narrow_link(mt.Water(a=a, b=b, phase=ISOTROPIC), absorption=mode))
    scatter = b * b / (a + b) if mode == "paper" else b
    expected = NORMAL_LOSS * math.exp(-(a + scatter) * 10.0)
    assert r.gain_stderr / expected < 0.005
    assert z_test(r.gain, r.gain_stderr, expected) > sidak(ALPHA, len(MODES))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.thorough
@pytest.mark.slow_but("continuous", "paper")
def test_layers_through_the_engine(mode):
    water = mt.Water(layers=LAYERS, phase=ISOTROPIC)
    r = ballistic(narrow_link(water, absorption=mode))

    def rate(depth):
        a, b = water.profile(depth)
        return a + (b * b / (a + b) if mode == "paper" else b)

    expected = NORMAL_LOSS * math.exp(-float(optical_depth(rate, 10.0, 1.0, 0.0)))
    assert z_test(r.gain, r.gain_stderr, expected, 1e-3 * expected) > sidak(ALPHA, len(MODES))


@pytest.mark.parametrize(
    ("wind_speed", "q", "psi", "tau"),
    [
        (5.0, 2.0, "exact", 2.00811e-3),
        (13.0, 2.0, "exact", 9.89773e-2),
        (13.0, "mie", "exact", 1.002340e-1),
        (13.0, 2.0, "paper", 1.062426e-1),
    ],
)
@pytest.mark.parametrize("depth_mode", ["local", "mean_level"])
def test_bubble_optical_depth_through_the_engine(wind_speed, q, psi, tau, depth_mode):
    """The optical depths 0..10 m of physics.md, as what is lost on the straight way up."""
    bubbles = mt.HallNovarini(wind_speed=wind_speed, q=q, psi=psi, depth=depth_mode)
    r = ballistic(narrow_link(mt.Water(a=0.01, b=0.0), bubbles))
    expected = NORMAL_LOSS * math.exp(-0.1 - tau)
    assert r.gain_stderr / expected < 1e-3
    assert z_test(r.gain, r.gain_stderr, expected, 2e-5) > sidak(ALPHA, 8)


def test_printed_free_path_never_sees_the_bubbles():
    """E6: with c at the start of the path a photon from 10 m passes them, exp(tau) too bright."""
    bubbles = mt.HallNovarini(wind_speed=13.0, q=2.0)
    link = narrow_link(mt.Water(a=0.01, b=0.01, phase=ISOTROPIC), bubbles, free_path="local_c")
    r = ballistic(link)
    expected = NORMAL_LOSS * math.exp(-0.2 - 10.0 * float(bubbles.b(10.0)))
    assert z_test(r.gain, r.gain_stderr, expected) > ALPHA
    assert r.gain > 1.05 * NORMAL_LOSS * math.exp(-0.2 - 9.89773e-2)


# ---- irradiance on planes and apertures in the water -------------------------------------


def sun_link(water, depths, **options):
    return mt.Link(
        water=water, transmitter=mt.Sun(), planes=mt.IrradiancePlanes(depths=depths), **options
    )


@pytest.mark.parametrize("bottom_depth", [None, 30.0])
@pytest.mark.parametrize("b", [0.0, 1e-9])
def test_planes_in_water_that_only_absorbs(b, bottom_depth):
    """E_d(z) = T exp(-a z), whatever is below; without scattering it has no noise."""
    depths = (0.5, 2.0, 10.0)
    water = mt.Water(a=0.1, b=b, bottom_depth=bottom_depth)
    r = ballistic(sun_link(water, depths), photons=4096)
    expected = NORMAL_LOSS * np.exp(-0.1 * np.array(depths))
    np.testing.assert_allclose(r.planes.e_d, expected, rtol=3e-6)
    np.testing.assert_allclose(r.planes.e_od, expected, rtol=3e-6)
    np.testing.assert_allclose(r.planes.e_u, 0.0, atol=1e-6)


def test_water_aperture_in_water_that_only_absorbs():
    aperture = mt.WaterAperture(depth=3.0, radius=50.0, zenith_deg=180.0)
    link = mt.Link(water=mt.Water(a=0.1, b=0.0), transmitter=mt.Sun(), receiver=aperture)
    r = ballistic(link, photons=4096)
    assert r.gain == pytest.approx(NORMAL_LOSS * math.exp(-0.3), rel=3e-6)


@pytest.mark.parametrize("zenith_deg", [0.0, 50.0])
def test_planes_in_absorbing_layers(zenith_deg):
    """The absorption up to a plane is that of the layers above it, not a share of the path."""
    water = mt.Water(layers=((0.0, 0.0, 1e-4), (2.0, 0.0, 1e-4), (2.002, 0.8, 1e-4)))
    depths = (1.0, 1.9, 3.0, 5.0)
    link = mt.Link(
        water=water,
        transmitter=mt.Sun(zenith_deg=zenith_deg),
        planes=mt.IrradiancePlanes(depths=depths),
    )
    r = ballistic(link, photons=50_000)
    inside = math.sqrt(1.0 - (math.sin(math.radians(zenith_deg)) / 1.33) ** 2)
    loss = 1.0 - float(fresnel_reflectance(math.cos(math.radians(zenith_deg)), 1.0, 1.33))
    expected = loss * np.exp(-0.8 * np.maximum(np.array(depths) - 2.001, 0.0) / inside)
    np.testing.assert_allclose(r.planes.e_d, expected, rtol=3e-3)


def test_water_aperture_in_absorbing_layers():
    water = mt.Water(layers=((0.0, 0.0, 1e-4), (2.0, 0.0, 1e-4), (2.002, 0.8, 1e-4)))
    aperture = mt.WaterAperture(depth=1.0, radius=50.0, zenith_deg=180.0)
    r = ballistic(mt.Link(water=water, transmitter=mt.Sun(), receiver=aperture), photons=50_000)
    assert r.gain == pytest.approx(NORMAL_LOSS, rel=3e-3)


@pytest.mark.parametrize("mode", ["continuous", "implicit", "analog"])
def test_plane_and_aperture_agree(mode):
    """A disk as wide as the light is a plane: both tallies of the same photons."""
    water = mt.Water(a=0.2, b=0.4, phase=mt.HenyeyGreenstein(g=0.6))
    apertures = tuple(
        mt.WaterAperture(depth=2.0, radius=1e4, zenith_deg=zenith) for zenith in (180.0, 0.0)
    )
    link = sun_link(water, (2.0,), receiver=apertures, physics=mt.Physics(absorption=mode))
    r = ballistic(link, photons=50_000)
    np.testing.assert_allclose(r.gain[0], r.planes.e_d[0], rtol=1e-9)
    np.testing.assert_allclose(r.gain[1], r.planes.e_u[0], rtol=1e-9)
    assert r.gain[1] > 0.01
