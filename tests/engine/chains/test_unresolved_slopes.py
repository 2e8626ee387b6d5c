"""Waves that the mesh leaves out: both estimators against a plain quadrature, and the closure."""

import math
from functools import cache

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test
from scipy.stats import t as student_t

import meshtrace as mt
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.engine.setup import ends, meshing
from meshtrace.kernels import interface
from meshtrace.mesh import UnresolvedSlopes
from meshtrace.surfaces import FlatSea, GramCharlier, JonswapSea
from meshtrace.surfaces.statistics import (
    components_hs,
    components_slope_variance,
    cox_munk,
    elfouhaily_slope_variance,
    meshed_slope_variance,
    sampled_slope_variance,
)

VARIANCE = 0.04, 0.015
CLEAR = mt.Link(
    water=mt.Water(b=0.0), receiver=mt.Receiver(radius=0.5, position=(0.8, -0.5), fov_deg=70.0)
)


def rough(mesh, direction_deg=30.0):
    slopes = UnresolvedSlopes(VARIANCE, VARIANCE, direction_deg)
    return mt.TriangleMesh(mesh.vertices, mesh.faces, mesh.vertex_normals, slopes)


@cache
def quadrature(link, variance, direction_deg, series=interface.GAUSSIAN):
    """Return the gain through a flat sea with random slopes, no scattering, by brute force.

    gain = sum over rays and slopes of I(w) exp(-a s) T p(t) d.(-t, 1) / d_z [lands inside].
    """
    n, lamp, receiver = link.water.n, link.transmitter, link.receiver
    x, weight_x = np.polynomial.hermite_e.hermegauss(24)
    g1, g2 = np.meshgrid(x, x, indexing="ij")
    mass = (
        np.outer(weight_x, weight_x)
        / (2.0 * math.pi)
        * interface.over_gaussian.py_func(series, g1, g2)
    )
    wind = math.radians(direction_deg)
    a, c = math.sqrt(variance[0]) * g1, math.sqrt(variance[1]) * g2
    tx, ty = math.cos(wind) * a - math.sin(wind) * c, math.sin(wind) * a + math.cos(wind) * c
    step = 0.04
    grid = np.arange(-5.0, 5.0, step) + 0.5 * step
    px, py = np.meshgrid(grid, grid, indexing="ij")
    way = np.stack([px, py, np.full_like(px, lamp.depth)])
    length = np.sqrt((way**2).sum(axis=0))
    d = way / length
    order = lamp.order
    light = (order + 1.0) / (2.0 * math.pi) * d[2] ** order * step**2 * d[2] / length**2
    light *= np.exp(-link.water.a * length)
    total = 0.0
    for sx, sy, p in zip(tx.ravel(), ty.ravel(), mass.ravel(), strict=True):
        normal = np.array([-sx, -sy, 1.0]) / math.sqrt(1.0 + sx * sx + sy * sy)
        cos_i = np.tensordot(normal, d, 1)
        cos2_t = 1.0 - n**2 * (1.0 - cos_i**2)
        cos_t = np.sqrt(np.maximum(cos2_t, 0.0))
        rs = (n * cos_i - cos_t) / (n * cos_i + cos_t)
        rp = (cos_i - n * cos_t) / (cos_i + n * cos_t)
        out = n * d + (cos_t - n * cos_i) * normal[:, None, None]
        flight = receiver.height / out[2]
        off = np.hypot(
            px + flight * out[0] - receiver.position[0],
            py + flight * out[1] - receiver.position[1],
        )
        seen = (off <= receiver.radius) & (cos2_t > 0.0) & (cos_i > 0.0)
        seen &= out[2] >= math.cos(math.radians(receiver.fov_deg / 2.0))
        facing = np.clip((d[2] - sx * d[0] - sy * d[1]) / d[2], 0.0, 2.0)
        total += p * (light * facing * (1.0 - 0.5 * (rs**2 + rp**2)))[seen].sum()
    return total


@pytest.mark.parametrize("normals", ["vertex", "facet"])
@pytest.mark.thorough
def test_rough_flat_sea_against_quadrature(normals):
    expected = quadrature(CLEAR, VARIANCE, 30.0)
    mesh = rough(FlatSea().mesh(extent=20.0, spacing=0.5))
    forced = mt.simulate(CLEAR, mesh, photons=20_000, seed=1, normals=normals)
    assert forced.gain_stderr < 0.003 * forced.gain
    assert forced.gain == pytest.approx(forced.gain_ballistic)
    analog = mt.simulate(
        CLEAR, mesh, estimator="analog", photons=2_000_000, seed=2, normals=normals
    )
    # cells of 4 cm and 24 x 24 slopes leave less than 1e-3 in the quadrature
    for r in (forced, analog):
        stderr = math.hypot(r.gain_stderr, 1e-3 * expected)
        assert z_test(r.gain, stderr, expected) > sidak(ALPHA, 4)
    smooth = mt.simulate(CLEAR, FlatSea(), photons=512, seed=1)
    assert abs(smooth.gain - expected) > 20.0 * forced.gain_stderr


@pytest.mark.parametrize("normals", ["vertex", "facet"])
@pytest.mark.parametrize("wind_speed", [5.0, 13.0])
@pytest.mark.thorough
@pytest.mark.slow_but("5.0-vertex", "13.0-facet")
def test_estimators_agree_over_rough_waves(wind_speed, normals):
    link = mt.Link(water=mt.Water(b=0.1), receiver=mt.Receiver(radius=0.5))
    sea = JonswapSea(wind_speed=wind_speed, seed=4, waves="paper")
    forced = mt.simulate(link, sea, photons=20_000, seed=1, normals=normals)
    analog = mt.simulate(link, sea, estimator="analog", photons=2_000_000, seed=2, normals=normals)
    p = z_test(forced.gain, forced.gain_stderr, analog.gain, analog.gain_stderr)
    assert p > sidak(ALPHA, 4)


def test_nothing_is_lost_where_normals_are_random():
    mesh = rough(JonswapSea(wind_speed=13.0, seed=2, waves="paper").mesh(extent=120.0, spacing=2.0))
    link = mt.Link(water=mt.Water(b=0.3))
    r = mt.simulate(link, mesh, estimator="analog", photons=50_000, seed=1)
    assert sum(f.weight for f in r.fates.values()) == pytest.approx(1.0, abs=1e-12)


def test_the_switch_and_the_sea_turn_it_off():
    link = mt.Link(physics=mt.Physics(unresolved="none"))
    sea = JonswapSea(wind_speed=13.0, seed=2, waves="paper")
    band = sea.model_copy(update={"mss": "band"})
    off = mt.simulate(link, sea, photons=512, seed=1)
    without = mt.simulate(mt.Link(), band, photons=512, seed=1)
    assert off.gain == without.gain
    assert mt.simulate(mt.Link(), sea, photons=512, seed=1).gain != off.gain
    assert mt.Physics.paper().unresolved == "none"


@pytest.mark.parametrize("spacing", [0.3, 1.0, 2.5])
def test_what_a_mesh_shows_of_the_slopes(spacing):
    """The closed forms against the mean over meshes of 40 seas."""
    sea = JonswapSea(wind_speed=5.0, wind_direction_deg=25.0, omega_max=6.0, waves="paper")
    vertex, facet = meshed_slope_variance(sea.components, spacing, 25.0)
    interpolated, own = [], []
    rng = np.random.default_rng(1)
    for seed in range(40):
        mesh = sea.with_seed(seed).mesh(extent=25.0, spacing=spacing)
        own.append(facet_variance(mesh, 25.0))
        interpolated.append(interpolated_variance(mesh, 25.0, rng))
    for found, expected in ((interpolated, vertex), (own, facet)):
        mean, stderr = np.mean(found, axis=0), np.std(found, axis=0, ddof=1) / math.sqrt(40)
        for k in range(2):
            assert z_test(mean[k], stderr[k], expected[k]) > sidak(ALPHA, 12)


def along_across(slopes, direction_deg):
    wind = math.radians(direction_deg)
    along = math.cos(wind) * slopes[:, 0] + math.sin(wind) * slopes[:, 1]
    across = math.cos(wind) * slopes[:, 1] - math.sin(wind) * slopes[:, 0]
    return (along**2).mean(), (across**2).mean()


def facet_variance(mesh, direction_deg):
    n = mesh.face_normals
    return along_across(-n[:, :2] / n[:, 2:], direction_deg)


def interpolated_variance(mesh, direction_deg, rng):
    """Slopes at random points of the facets, from the normals of their corners."""
    weights = rng.dirichlet((1.0, 1.0, 1.0), len(mesh.faces))
    n = np.einsum("ij,ijk->ik", weights, mesh.vertex_normals[mesh.faces])
    return along_across(-n[:, :2] / n[:, 2:], direction_deg)


def test_variances_add_up_to_those_of_the_real_sea():
    for kind, target in (
        ("cox-munk", cox_munk(13.0)),
        ("elfouhaily", elfouhaily_slope_variance(13.0, 30e3)),  # of the fetch of the sea
    ):
        sea = JonswapSea(wind_speed=13.0, mss=kind, waves="paper")
        mesh = sea.mesh(extent=5.0, spacing=0.5)
        vertex, facet = meshed_slope_variance(sea.components, 0.5)
        np.testing.assert_allclose(np.add(mesh.unresolved.vertex, vertex), target)
        np.testing.assert_allclose(np.add(mesh.unresolved.facet, facet), target)
    fine, _ = meshed_slope_variance(sea.components, 1e-3)
    np.testing.assert_allclose(fine, components_slope_variance(sea.components), rtol=1e-4)
    assert FlatSea().mesh(extent=1.0, spacing=0.5).unresolved is None
    assert sampled_slope_variance(mesh)[0] > 0.0


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:waves")
def test_the_mean_gain_does_not_hang_on_band_and_spacing():
    """A lens of 2 m over 60 seas of 13 m/s, whose own waves bend the light too little."""
    link = mt.Link(receiver=mt.Receiver(radius=2.0))
    mean, stderr = [], []
    for omega_max, spacing in ((3.0, 0.25), (3.0, 2.0), (6.0, 0.25), (9.0, 0.25)):
        e = mt.ensemble(
            link, 60, JonswapSea(wind_speed=13.0, omega_max=omega_max, waves="paper"), photons=1024,
            mesh=mt.Meshing(spacing=spacing, extent=8.0),
        )  # fmt: skip
        mean.append(e.gain.mean())
        stderr.append(e.gain.std(ddof=1) / math.sqrt(60))
    for k in range(1, 4):
        assert stderr[k] < 0.01 * mean[k]
        assert z_test(mean[k], stderr[k], mean[0], stderr[0]) > sidak(ALPHA, 3)
    plain = mt.Link(receiver=link.receiver, physics=mt.Physics(unresolved="none"))
    e = mt.ensemble(
        plain,
        60,
        JonswapSea(wind_speed=13.0, waves="paper"),
        photons=1024,
        mesh=mt.Meshing(spacing=0.25, extent=8.0),
    )
    assert e.gain.mean() > 1.01 * mean[0]


BEAM = mt.Link(
    transmitter=mt.Led(half_angle_deg=2.0), receiver=mt.Receiver(radius=0.5, height=20.0)
)
BATCHES, SEAS = 10, 16


def mean_without_seas(sea, link=BEAM, photons=1024, seeds=range(BATCHES)):
    """Return the mean gain of a link, for the chains of each seed.

    Heights and slopes of a Gaussian sea are independent at one point, and light that crosses once
    knows no more of it: a flat mesh with random slopes, averaged over its height, is enough.
    """
    flat, slopes = FlatSea().mesh(extent=12.0, spacing=1.0), cox_munk(sea.wind_speed)
    nodes, weights = np.polynomial.hermite_e.hermegauss(7)
    total = np.zeros(len(seeds))
    for node, weight in zip(nodes, weights / weights.sum(), strict=True):
        level = [0.0, 0.0, node * components_hs(sea.components) / 4.0]
        mesh = mt.TriangleMesh(
            flat.vertices + level, flat.faces, flat.vertex_normals, UnresolvedSlopes(slopes, slopes)
        )
        for i, seed in enumerate(seeds):
            total[i] += weight * mt.simulate(link, mesh, photons=photons, seed=seed).gain
    return total


@pytest.mark.statistical
def test_default_sea_has_the_closed_mean():
    """40 seas of the default link, with the chains of the closed mean."""
    sea, means = JonswapSea(), mt.Scenario.from_toml("[sea]\nwaves = 'mean'")
    gain = mt.ensemble(means, 40, photons=512, seed=1).gain
    stderr = gain.std(ddof=1) / math.sqrt(len(gain))
    closed = float(mean_without_seas(sea, mt.Link(), 512, [1])[0])
    assert stderr < 0.015 * closed
    assert abs(gain.mean() - closed) < 1.5 * stderr


def mean_over_seas(sea, link):
    options = {"photons": 1024, "mesh": mt.Meshing(spacing=0.25, extent=5.0)}
    batches = range(BATCHES)
    return np.array([mt.ensemble(link, SEAS, sea, seed=i, **options).gain.mean() for i in batches])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wind_speed", "bands"), [(5.0, (4.0, 7.0)), (13.0, (3.0, 7.0))], ids=["5 m/s", "13 m/s"]
)
def test_narrow_beam_spreads_as_over_a_sea_of_slopes_alone(wind_speed, bands):
    """A beam of 2 degrees far up, where slopes halve the gain: scatter of batches, same chains."""
    seas = [
        JonswapSea(wind_speed=wind_speed, omega_max=omega_max, waves="paper") for omega_max in bands
    ]
    closed = [mean_without_seas(sea) for sea in seas]
    for sea, expected in zip(seas, closed, strict=True):
        ratio = mean_over_seas(sea, BEAM) / expected
        stderr = ratio.std(ddof=1) / math.sqrt(BATCHES)
        assert stderr < 0.03
        t = abs(ratio.mean() - 1.0) / stderr
        assert 2.0 * student_t.sf(t, BATCHES - 1) > sidak(ALPHA, 4)
    smooth = BEAM.model_copy(update={"physics": mt.Physics(unresolved="none")})
    assert (mean_over_seas(seas[0], smooth) / closed[0]).mean() > 1.2


def test_waves_that_no_mesh_resolves_are_told():
    """Up to 1000 rad/s at 5 m/s the gain was 2.4 times too large without a word."""
    link, sea = mt.Link(), JonswapSea(wind_speed=5.0, omega_max=1000.0)
    with pytest.warns(mt.DomainWarning, match="% of the slope variance .* gain is in doubt"):
        meshing.mesh_lines(link, sea, reach=ends.crossing_reach(link))


# twice as far from the Gaussian slopes as those of any sea, to be told from them
LAW = GramCharlier(c21=-0.3, c03=-0.6, c40=0.8, c22=0.3, c04=0.6)
SKEWED = cox_munk(14.0)


def skewed(mesh, law=LAW, direction_deg=30.0):
    slopes = UnresolvedSlopes(SKEWED, SKEWED, direction_deg, law.cumulants(SKEWED))
    return mt.TriangleMesh(mesh.vertices, mesh.faces, mesh.vertex_normals, slopes)


def aside(distance, azimuth_deg, b=0.0, **receiver):
    """Return a link whose receiver lies aside, in a direction."""
    turn = math.radians(azimuth_deg)
    position = distance * math.cos(turn), distance * math.sin(turn)
    return mt.Link(
        water=mt.Water(b=b),
        transmitter=mt.Led(half_angle_deg=1.0),
        receiver=mt.Receiver(**{"radius": 0.5, "position": position, "fov_deg": 90.0, **receiver}),
    )


LEVEL = FlatSea().mesh(extent=30.0, spacing=1.0)


@pytest.mark.thorough
@pytest.mark.parametrize("azimuth_deg", [30.0, 210.0], ids=["downwind", "upwind"])
@pytest.mark.slow_but("upwind")
def test_skewed_slopes_against_quadrature(azimuth_deg):
    link = CLEAR.replace("receiver.position", aside(1.5, azimuth_deg).receiver.position)
    expected = quadrature(link, SKEWED, 30.0, LAW.series)
    forced = mt.simulate(link, skewed(LEVEL), photons=20_000, seed=1)
    analog = mt.simulate(link, skewed(LEVEL), "analog", photons=2_000_000, seed=2)
    for r in (forced, analog):
        stderr = math.hypot(r.gain_stderr, 1e-3 * expected)
        assert z_test(r.gain, stderr, expected) > sidak(ALPHA, 4)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("distance", "azimuth_deg"), [(0.0, 0.0), (1.5, 30.0), (2.2, 210.0), (3.0, 120.0)]
)
@pytest.mark.slow_but("2.2-210.0")
def test_estimators_agree_for_skewed_slopes(distance, azimuth_deg):
    """Chains and joined photons against individual photons, unscattered light included."""
    link, mesh = aside(distance, azimuth_deg, b=0.05), skewed(LEVEL)
    analog = mt.simulate(link, mesh, "analog", photons=4_000_000, seed=2)
    assert analog.gain_stderr < 0.03 * analog.gain
    for scattered in ("chains", "joined"):
        forced = ForcedDetection(
            link, 16384, 1, sea=TypicalSea.of_meshes([mesh]), scattered=scattered
        )
        found = forced.evaluate(mesh)
        p = z_test(found.gain[0], found.stderr[0], analog.gain, analog.gain_stderr)
        assert p > sidak(ALPHA, 12)


def test_light_aside_is_brighter_where_the_slopes_say():
    """Near the axis it is brighter downwind, beyond some 1.7 deviations of the slope upwind.

    The most common slope ascends downwind and bends light downwind, the steepest ones do not.
    """
    blur = 0.33 * 6.0 * math.sqrt(SKEWED[0])
    for deviations, sign in ((1.0, 1.0), (3.0, -1.0)):
        gain = [
            mt.simulate(
                aside(deviations * blur, azimuth_deg, height=6.0, radius=0.1).replace(
                    "transmitter.half_angle_deg", 0.5
                ),
                skewed(LEVEL),
                photons=1024,
                seed=1,
            ).gain
            for azimuth_deg in (30.0, 210.0)
        ]
        assert sign * (gain[0] / gain[1] - 1.0) > 0.1
    across = [
        mt.simulate(aside(blur, azimuth_deg), skewed(LEVEL), photons=1024, seed=1).gain
        for azimuth_deg in (120.0, -60.0)
    ]
    assert across[0] == pytest.approx(across[1], rel=1e-3)


@pytest.mark.parametrize("azimuth_deg", [30.0, 210.0])
def test_skewed_slopes_from_the_air(azimuth_deg):
    """The mirrored link has the square of the index times the gain, slopes seen from above."""
    up = mt.Link(
        water=mt.Water(b=0.0),
        transmitter=mt.Led(half_angle_deg=60.0),
        receiver=mt.Receiver(
            fov_deg=180.0, radius=0.5, position=aside(4.0, azimuth_deg).receiver.position
        ),
    )
    a, b = (
        ForcedDetection(
            link, 4096, 1, sea=TypicalSea.of_meshes([LEVEL]), scattered="chains"
        ).evaluate(skewed(LEVEL))
        for link in (up, up.mirrored())
    )
    np.testing.assert_allclose(b.ballistic, 1.33**2 * a.ballistic, rtol=5e-4)


@pytest.mark.thorough
def test_downlink_through_skewed_slopes():
    lens = mt.WaterReceiver(radius=0.4, depth=8.0, position=(-0.9, -0.5), fov_deg=120.0)
    link = mt.Link(water=mt.Water(b=0.1), transmitter=mt.AirBeam(height=10.0), receiver=lens)
    mesh = skewed(LEVEL)
    forced = ForcedDetection(link, 16384, 1, sea=TypicalSea.of_meshes([mesh]), scattered="chains")
    found = forced.evaluate(mesh)
    analog = mt.simulate(link, mesh, "analog", photons=2_000_000, seed=2)
    p = z_test(found.gain[0], found.stderr[0], analog.gain, analog.gain_stderr)
    assert p > ALPHA


@pytest.mark.thorough
def test_sampled_chains_weigh_skewed_slopes():
    """Refraction as published is not integrated over slopes: chains draw them."""
    link = aside(1.5, 210.0, b=0.1).replace("physics", mt.Physics(direction="paper"))
    forced = mt.simulate(link, skewed(LEVEL), photons=20_000, seed=1)
    analog = mt.simulate(link, skewed(LEVEL), "analog", photons=2_000_000, seed=2)
    p = z_test(forced.gain, forced.gain_stderr, analog.gain, analog.gain_stderr)
    assert p > ALPHA
