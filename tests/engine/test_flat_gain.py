"""The default link over still water: closed forms, quadrature, and the analog estimator.

Reference gains of physics.md section 6: unscattered light by closed form or quadrature, all of it
by the forced-detection prototype (+- 0.01 %), which an adjoint prototype confirmed.
"""

import itertools
import math

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test

import meshtrace as mt
from meshtrace.optics import fresnel_reflectance
from meshtrace.surfaces import FlatSea

# light that a small mesh does not cover cannot reach the apertures
pytestmark = pytest.mark.filterwarnings("ignore:.*left the meshed surface:meshtrace.DomainWarning")

MESH = FlatSea().mesh(extent=70.0, spacing=35.0)
BALLISTIC = 4.5166617e-5
NO_SCATTERING = mt.Water(b=0.0)


# ---- unscattered gain by quadrature ----------------------------------------------------------


def landing(theta, depth, height, n):
    """Return distance from the axis and angle in air of light emitted at theta to the vertical."""
    theta_t = np.arcsin(np.minimum(n * np.sin(theta), 1.0))
    return depth * np.tan(theta) + height * np.tan(theta_t), theta_t


def axis_gain(depth=10.0, height=5.0, radius=0.05, half_angle_deg=10.0, fov_deg=60.0,
              offset=0.0, n=1.33, c=0.114):  # fmt: skip
    """Return the unscattered gain of an upright receiver.

    int (m+1) cos^m sin T(theta) exp(-c d / cos) f(rho(theta)) dtheta; f is the share of the circle
    of radius rho that the aperture covers, theta_t <= fov / 2.
    """
    m = -math.log(2.0) / math.log(math.cos(math.radians(half_angle_deg)))
    end = min(math.radians(fov_deg / 2.0), math.pi / 2.0 - 1e-9)
    edge = math.asin(math.sin(end) / n)
    # the integrand has its kinks where the circle touches the rim of the aperture
    grid = np.linspace(0.0, edge, 200_001)
    rho = landing(grid, depth, height, n)[0]
    kinks = np.interp([abs(offset - radius), offset + radius], rho, grid)
    nodes = np.unique([0.0, *kinks, edge])
    x, w = np.polynomial.legendre.leggauss(200)
    total = 0.0
    for a, b in itertools.pairwise(nodes):
        # cosine substitution: square roots at the kinks become smooth
        t = 0.5 * math.pi * (x + 1.0)
        theta = 0.5 * (a + b) - 0.5 * (b - a) * np.cos(t)
        weight = 0.5 * (b - a) * np.sin(t) * 0.5 * math.pi * w
        rho, _ = landing(theta, depth, height, n)
        if offset == 0.0:
            share = (rho <= radius).astype(float)
        else:
            cosine = (rho**2 + offset**2 - radius**2) / np.maximum(2.0 * rho * offset, 1e-300)
            share = np.arccos(np.clip(cosine, -1.0, 1.0)) / math.pi
        loss = 1.0 - fresnel_reflectance(np.cos(theta), n, 1.0)
        flux = (m + 1.0) * np.cos(theta) ** m * np.sin(theta) * np.exp(-c * depth / np.cos(theta))
        total += float((weight * flux * loss * share).sum())
    return total


def disk_gain(receiver, depth=10.0, half_angle_deg=10.0, n=1.33, c=0.114, nodes=60):
    """Return the unscattered gain of any receiver whose disk lies within its field of view.

    Irradiance at points of the disk, each from the one direction that Snell's law allows:
    E = I T exp(-c s) (d . axis) / d_z * sin(theta) / (rho drho/dtheta).
    """
    m = -math.log(2.0) / math.log(math.cos(math.radians(half_angle_deg)))
    x, w = np.polynomial.legendre.leggauss(nodes)
    r, phi = 0.5 * receiver.radius * (x + 1.0), 2.0 * math.pi * np.arange(nodes) / nodes
    weight = (0.5 * receiver.radius * w * r)[:, None] * (2.0 * math.pi / nodes) * np.ones(nodes)
    axis = np.array(receiver.axis)
    e1 = np.cross(axis, (0.0, 1.0, 0.0))
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(axis, e1)
    q = np.array(receiver.center) + r[:, None, None] * (
        np.cos(phi)[None, :, None] * e1 + np.sin(phi)[None, :, None] * e2
    )
    rho, z = np.hypot(q[..., 0], q[..., 1]), q[..., 2]
    low, high = np.zeros_like(rho), np.full_like(rho, math.asin(1.0 / n) - 1e-12)
    for _ in range(60):
        middle = 0.5 * (low + high)
        far = landing(middle, depth, z, n)[0] > rho
        low, high = np.where(far, low, middle), np.where(far, middle, high)
    theta = np.maximum(0.5 * (low + high), 1e-9)
    _, theta_t = landing(theta, depth, z, n)
    slope = depth / np.cos(theta) ** 2 + z * n * np.cos(theta) / np.cos(theta_t) ** 3
    away = np.where(rho > 0.0, rho, 1.0)
    d = np.stack(
        [
            np.sin(theta_t) * q[..., 0] / away,
            np.sin(theta_t) * q[..., 1] / away,
            np.cos(theta_t),
        ],
        axis=-1,
    )
    assert (d @ axis > math.cos(math.radians(receiver.fov_deg / 2.0))).all()
    intensity = (m + 1.0) / (2.0 * math.pi) * np.cos(theta) ** m
    loss = 1.0 - fresnel_reflectance(np.cos(theta), n, 1.0)
    spread = np.sin(theta) / (landing(theta, depth, z, n)[0] * slope)
    e = intensity * loss * np.exp(-c * depth / np.cos(theta)) * spread * (d @ axis) / d[..., 2]
    return float((weight * e).sum())


def test_quadratures_meet_the_closed_form_and_each_other():
    m = 45.277602
    point = (m + 1) / 2 * (1e-4 / (10 + 1.33 * 5)) ** 2 * math.exp(-1.51) * 0.97994069
    assert axis_gain(radius=1e-4, c=0.151) == pytest.approx(point, rel=1e-6)
    for options in ({}, {"radius": 0.5}, {"offset": 1.0, "radius": 0.3}, {"depth": 20.0}):
        receiver = mt.Receiver(
            radius=options.get("radius", 0.05), position=(options.get("offset", 0.0), 0.0)
        )
        disk = disk_gain(receiver, depth=options.get("depth", 10.0))
        assert axis_gain(**options) == pytest.approx(disk, rel=2e-6), options


@pytest.mark.parametrize(
    ("depth", "expected"),
    [
        (5.0, 1.962614e-4),
        (10.0, BALLISTIC),
        (20.0, 3.894906e-6),
        (30.0, 4.549544e-7),
        (40.0, 6.203430e-8),
        (47.0, 1.629851e-8),
    ],
)
def test_ballistic_gain_of_the_default_link(depth, expected):
    assert axis_gain(depth=depth, c=0.151) == pytest.approx(expected, rel=2e-7)


def test_absorption_only_and_no_loss():
    assert axis_gain() == pytest.approx(6.5389e-5, rel=1e-5)
    assert axis_gain(c=0.0) == pytest.approx(2.04458e-4, rel=1e-5)


# ---- the engine without scattering -----------------------------------------------------------


def analog(link, photons, seed=1, **options):
    return mt.simulate(link, MESH, estimator="analog", photons=photons, seed=seed, **options)


def link_of(water=NO_SCATTERING, depth=10.0, half_angle_deg=10.0, **receiver):
    return mt.Link(
        water=water,
        transmitter=mt.Led(depth=depth, half_angle_deg=half_angle_deg),
        receiver=mt.Receiver(**receiver),
    )


@pytest.mark.thorough
def test_absorption_only_to_two_in_a_thousand():
    r = analog(link_of(radius=1.0), 9_000_000)
    expected = axis_gain(radius=1.0)
    assert r.gain_stderr / expected < 0.002
    assert abs(r.gain - expected) < 3.0 * r.gain_stderr
    assert r.gain == pytest.approx(expected, rel=0.006)


AXIS_CASES = [
    {"half_angle_deg": 5.0, "radius": 0.5},
    {"half_angle_deg": 20.0, "radius": 1.0},
    {"half_angle_deg": 60.0, "radius": 2.0},
    {"half_angle_deg": 85.0, "radius": 3.0, "fov_deg": 180.0},
    {"depth": 5.0, "radius": 0.5},
    {"depth": 20.0, "radius": 1.5},
    {"height": 0.5, "radius": 0.5},
    {"height": 40.0, "radius": 3.0},
    # the field of view cuts the lamp's light before the aperture does
    {"radius": 3.0, "fov_deg": 10.0},
    {"radius": 50.0, "fov_deg": 60.0, "half_angle_deg": 60.0},
    {"radius": 8.0, "fov_deg": 120.0, "half_angle_deg": 60.0},
    {"radius": 400.0, "fov_deg": 178.0, "half_angle_deg": 80.0, "height": 0.2},
]


@pytest.mark.parametrize("case", AXIS_CASES, ids=str)
def test_absorption_only_on_axis(case):
    r = analog(link_of(**case), 1_000_000, seed=2)
    expected = axis_gain(**case)
    assert r.gain_stderr / expected < 0.02
    assert z_test(r.gain, r.gain_stderr, expected) > sidak(ALPHA, len(AXIS_CASES) + 10)


@pytest.mark.parametrize("azimuth_deg", [0.0, 110.0])
@pytest.mark.parametrize("offset", [0.5, 1.5, 3.0])
def test_absorption_only_beside_the_axis(offset, azimuth_deg):
    azimuth = math.radians(azimuth_deg)
    position = (offset * math.cos(azimuth), offset * math.sin(azimuth))
    r = analog(link_of(radius=0.8, position=position), 1_500_000, seed=3)
    expected = axis_gain(radius=0.8, offset=offset)
    assert z_test(r.gain, r.gain_stderr, expected) > sidak(ALPHA, len(AXIS_CASES) + 10)


@pytest.mark.parametrize(
    ("tilt_deg", "tilt_azimuth_deg", "position"),
    [
        (20.0, 0.0, (0.0, 0.0)),
        (25.0, 200.0, (0.6, 0.2)),
        (40.0, -90.0, (0.3, 1.0)),
        (60.0, 45.0, (0.0, 0.0)),
    ],
)
def test_absorption_only_on_tilted_receivers(tilt_deg, tilt_azimuth_deg, position):
    receiver = mt.Receiver(
        radius=0.8,
        fov_deg=150.0,
        position=position,
        tilt_deg=tilt_deg,
        tilt_azimuth_deg=tilt_azimuth_deg,
    )
    r = analog(mt.Link(water=NO_SCATTERING, receiver=receiver), 1_500_000, seed=4)
    expected = disk_gain(receiver)
    assert z_test(r.gain, r.gain_stderr, expected) > sidak(ALPHA, len(AXIS_CASES) + 10)


def test_displaced_lamp_is_a_displaced_receiver():
    """Same distance, other place on the mesh: the mean of both directions agrees."""
    lamp = mt.Led(position=(-7.0, 4.0))
    receiver = mt.Receiver(radius=0.8, position=(-7.0, 5.0))
    r = analog(mt.Link(water=NO_SCATTERING, transmitter=lamp, receiver=receiver), 1_500_000)
    expected = axis_gain(radius=0.8, offset=1.0)
    assert z_test(r.gain, r.gain_stderr, expected) > sidak(ALPHA, len(AXIS_CASES) + 10)


@pytest.mark.parametrize("fov_deg", [5.0, 20.0])
def test_receiver_that_looks_away_sees_nothing(fov_deg):
    """All light of a 1-degree beam arrives within 2 degrees of the vertical."""
    beam = mt.TopHatBeam(divergence_deg=1.0)
    for tilt_deg, seen in ((fov_deg / 2 - 2.0, True), (fov_deg / 2 + 2.0, False)):
        if tilt_deg < 0.0:
            continue
        receiver = mt.Receiver(radius=1.0, fov_deg=fov_deg, tilt_deg=tilt_deg)
        link = mt.Link(water=NO_SCATTERING, transmitter=beam, receiver=receiver)
        r = analog(link, 8192)
        fraction = r.gain / (math.exp(-1.14) * 0.98)
        assert fraction == (pytest.approx(1.0, abs=0.01) if seen else 0.0)


# ---- with scattering -------------------------------------------------------------------------


def test_wide_aperture():
    """Radius 0.25 m, the same physics with 25 times the hits: 1.488835e-3."""
    r = analog(link_of(mt.Water(), radius=0.25), 3_000_000, seed=11)
    assert r.gain_stderr / r.gain < 0.01
    assert abs(r.gain - 1.488835e-3) < 3.0 * r.gain_stderr
    assert r.gain > axis_gain(radius=0.25, c=0.151) - 3.0 * r.gain_stderr


@pytest.mark.parametrize(("offset", "expected"), [(0.5, 5.841e-5), (1.0, 5.465e-5)])
@pytest.mark.thorough
def test_default_aperture_beside_the_axis(offset, expected):
    """A ring of default apertures side by side: the mean of their gains, disjoint hits."""
    n = int(math.pi * offset / 0.0501)
    angle = 2.0 * math.pi * np.arange(n) / n
    receivers = tuple(
        mt.Receiver(position=(float(offset * math.cos(a)), float(offset * math.sin(a))))
        for a in angle
    )
    r = analog(mt.Link(receiver=receivers), 2_000_000, seed=12)
    mean, stderr = r.gain.mean(), math.sqrt((r.gain_stderr**2).sum()) / n
    assert stderr / expected < 0.013
    assert z_test(mean, stderr, expected, 5e-4 * expected) > sidak(ALPHA, 2)
    assert mean > axis_gain(offset=offset, c=0.151)


@pytest.mark.slow
def test_default_link():
    """5.973e-5 within 3 standard errors at 1 %; never below the unscattered light."""
    r = analog(mt.Link(), 60_000_000, seed=13)
    assert r.gain_stderr / r.gain < 0.01
    assert abs(r.gain - 5.9731e-5) < 3.0 * r.gain_stderr
    assert r.gain > BALLISTIC - 3.0 * r.gain_stderr
    assert (r.rays_recast, r.rays_lost) == (0, 0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "expected", "error", "photons"),
    [
        ({"half_angle_deg": 5.0}, 2.247e-4, 5e-4, 15_000_000),
        ({"half_angle_deg": 20.0}, 1.626e-5, 5e-4, 40_000_000),
        ({"depth": 5.0}, 2.26e-4, 0.01, 12_000_000),
        ({"depth": 20.0}, 6.85e-6, 0.01, 40_000_000),
    ],
    ids=str,
)
def test_other_lamps_and_depths(case, expected, error, photons):
    r = analog(link_of(mt.Water(), **case), photons, seed=14)
    assert r.gain_stderr / r.gain < 0.05
    assert z_test(r.gain, r.gain_stderr, expected, error * expected) > sidak(ALPHA, 4)
    quadrature = axis_gain(c=0.151, **case)
    assert r.gain > quadrature - 3.0 * r.gain_stderr


# ---- the printed forms -----------------------------------------------------------------------


@pytest.mark.thorough
def test_printed_absorption_is_less_scattering():
    """E5: Algorithm 1 is exactly b -> albedo b, whatever its weights look like."""
    water = mt.Water()
    receiver = mt.Receiver(radius=0.25)
    printed = mt.Link(receiver=receiver, physics=mt.Physics(absorption="paper"))
    less = water.model_copy(update={"b": water.albedo * water.b})
    assert less.b == pytest.approx(0.00906623, abs=5e-9)
    results = [analog(printed, 1_500_000, seed=15)]
    for k, mode in enumerate(("continuous", "implicit", "analog")):
        link = mt.Link(water=less, receiver=receiver, physics=mt.Physics(absorption=mode))
        results.append(analog(link, 1_500_000, seed=16 + k))
    first = results[0]
    for r in results[1:]:
        assert z_test(r.gain, r.gain_stderr, first.gain, first.gain_stderr) > sidak(ALPHA, 3)
    assert first.gain_stderr / first.gain < 0.02
    # the unscattered part alone is exp(-(a + albedo b) d)
    assert first.gain > axis_gain(radius=0.25, c=0.114 + less.b) - 3.0 * first.gain_stderr


@pytest.mark.parametrize("mode", ["implicit", "analog"])
def test_ways_to_absorb_agree(mode):
    receiver = mt.Receiver(radius=0.5)
    water = mt.Water(a=0.114, b=0.1)
    continuous = analog(mt.Link(water=water, receiver=receiver), 800_000, seed=20)
    link = mt.Link(water=water, receiver=receiver, physics=mt.Physics(absorption=mode))
    r = analog(link, 800_000, seed=21)
    assert r.gain_stderr / r.gain < 0.03
    p = z_test(r.gain, r.gain_stderr, continuous.gain, continuous.gain_stderr)
    assert p > sidak(ALPHA, 2)


def test_printed_unscattered_light():
    assert axis_gain(c=0.114 + 0.00906623) == pytest.approx(5.9722e-5, rel=1e-5)


@pytest.mark.slow
def test_printed_absorption_of_the_default_link():
    """E5: total 6.3950e-5, scattered part 4.2287e-6; both Fresnel losses x 0.97994 (E4)."""
    physics = mt.Physics(absorption="paper")
    r = analog(mt.Link(physics=physics), 30_000_000, seed=22)
    assert z_test(r.gain, r.gain_stderr, 6.3950e-5, 1e-8) > sidak(ALPHA, 3)
    twice = mt.Physics(absorption="paper", fresnel="paper_both", reflected="kill")
    r = analog(mt.Link(physics=twice), 30_000_000, seed=23)
    assert z_test(r.gain, r.gain_stderr, 6.3950e-5 * 0.97994, 1e-8) > sidak(ALPHA, 3)


def test_printed_snell_is_too_bright():
    """E2: 2.170e-3 instead of 1.489e-3 at r = 0.25 m."""
    receiver = mt.Receiver(radius=0.25)
    r = analog(mt.Link(receiver=receiver, physics=mt.Physics(snell="paper")), 2_000_000, seed=24)
    assert z_test(r.gain, r.gain_stderr, 2.170e-3, 1e-6) > ALPHA


@pytest.mark.parametrize(("depth", "height"), [(1000.0, 5.0), (1000.0, 1000.0), (1e4, 1e4)])
def test_deep_links_in_clear_water(depth, height):
    """Still water was once refused for the facets of a fine mesh."""
    radius = 0.01 * height
    text = f"""
    wind_speed = 0
    [water]
    a = 1e-4
    b = 0.0
    [transmitter]
    depth = {depth}
    [receiver]
    height = {height}
    radius = {radius}
    [sea]
    spectrum = "flat"
    """
    expected = axis_gain(depth, height, radius, c=1e-4)
    found = mt.Scenario.from_toml(text + "[run]\nphotons = 64").simulate()
    assert found.gain == pytest.approx(expected, rel=1e-3)
    few = mt.Scenario.from_toml(text + "[run]\nestimator = 'analog'\nphotons = 4096").simulate()
    assert few.gain_stderr < 1.0
