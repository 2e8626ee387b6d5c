"""Light that meets another wave in the air, and light that the surface sends back."""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test

import meshtrace as mt
from meshtrace import Vertex
from meshtrace.engine.photons import analog
from meshtrace.optics import fresnel_reflectance
from meshtrace.optics.fresnel import refract
from meshtrace.surfaces import FlatSea, SinusoidalSea

pytestmark = pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")

N = 1.33
SLOPE = 0.5


def valley():
    """Return a trough z = |x| / 2: two planes of four facets."""
    x = np.array([-20.0, 0.0, 20.0])
    y = np.array([-20.0, 20.0])
    vertices = [(a, b, SLOPE * abs(a)) for a in x for b in y]
    faces = [(0, 2, 3), (0, 3, 1), (2, 4, 5), (2, 5, 3)]
    return mt.TriangleMesh(vertices, faces)


def aimed_beam(target, direction, depth=4.0):
    """Return a parallel beam from a depth through a point along a direction."""
    t = (target[2] + depth) / direction[2]
    start = target - t * direction
    return mt.TopHatBeam(
        depth=depth,
        position=(float(start[0]), float(start[1])),
        divergence_deg=0.0,
        zenith_deg=math.degrees(math.acos(direction[2])),
        azimuth_deg=math.degrees(math.atan2(direction[1], direction[0])),
    )


@pytest.fixture(scope="module")
def two_hits():
    """Return a beam that leaves the left slope and meets the right one, and its analysis."""
    normal_left = np.array([SLOPE, 0.0, 1.0]) / math.hypot(SLOPE, 1.0)
    normal_right = normal_left * (-1, 1, 1)
    in_air = np.array([math.cos(math.radians(20.0)), 0.0, math.sin(math.radians(20.0))])
    first = np.array([-1.0, 0.0, SLOPE])
    in_water = -refract(-in_air, -normal_left, 1.0, N)
    # z0 + t dz = SLOPE (x0 + t dx)
    t = (SLOPE * first[0] - first[2]) / (in_air[2] - SLOPE * in_air[0])
    second = first + t * in_air
    out = 1.0 - float(fresnel_reflectance(in_water @ normal_left, N, 1.0))
    back = float(fresnel_reflectance(-in_air @ normal_right, 1.0, N))
    return in_water, first, second, out, back


def link_of(two_hits, **physics):
    in_water, first, *_ = two_hits
    return mt.Link(
        water=mt.Water(a=0.05, b=0.0),
        transmitter=aimed_beam(first, in_water),
        receiver=mt.Receiver(height=12.0, position=(10.0, 10.0), radius=0.05),
        physics=mt.Physics(**physics),
    )


def test_second_hit_is_where_geometry_puts_it(two_hits):
    _, first, second, *_ = two_hits
    recorder = analog.new_recorder(64, 16)
    analog.run_analog(
        link_of(two_hits),
        mt.EmbreeIntersector(valley(), 1),
        photons=64,
        seed=1,
        normals="facet",
        recorder=recorder,
    )
    entered = 0
    for i in range(64):
        what = recorder.what[i, : recorder.length[i]]
        out = recorder.vertex[i, np.flatnonzero(what == Vertex.SURFACE_OUT)[0]]
        np.testing.assert_allclose(out, first, atol=1e-9)
        for k in np.flatnonzero(what == Vertex.SURFACE_IN):
            entered += 1
            np.testing.assert_allclose(recorder.vertex[i, k], second, atol=1e-4)
    assert entered > 40


def test_light_is_shared_between_sky_and_water_at_the_second_hit(two_hits):
    """exp(-a s) T1 reaches the second wave, R2 of it goes to the sky and T2 into the water."""
    in_water, _, _, out, back = two_hits
    n = 400_000
    r = mt.simulate(
        link_of(two_hits), valley(), estimator="analog", photons=n, seed=2, normals="facet"
    )
    assert (r.rays_recast, r.rays_lost) == (0, 0)
    arrives = math.exp(-0.05 * 4.5 / in_water[2]) * out
    landed = r.fates["landed"].weight
    # one photon in 1 / (out back) lands with the weight it arrived with, at most
    stderr = math.sqrt(out * back / n)
    assert z_test(landed, stderr, arrives * back) > ALPHA
    assert 0.4 < back < 0.6


def test_ignoring_the_second_hit_lands_all(two_hits):
    in_water, _, _, out, _ = two_hits
    r = mt.simulate(
        link_of(two_hits, second_hit="ignore"),
        valley(),
        estimator="analog",
        photons=4096,
        normals="facet",
    )
    arrives = math.exp(-0.05 * 4.5 / in_water[2]) * out
    assert r.fates["landed"].weight == pytest.approx(arrives, rel=1e-6)


def test_air_path_counts_every_flight(two_hits):
    """A receiver that sees what the second wave reflects: its air path has both legs."""
    in_water, first, second, *_ = two_hits
    in_air = (second - first) / np.linalg.norm(second - first)
    normal = np.array([-SLOPE, 0.0, 1.0]) / math.hypot(SLOPE, 1.0)
    away = in_air - 2.0 * (in_air @ normal) * normal
    t = (12.0 - second[2]) / away[2]
    spot = second + t * away
    receiver = mt.Receiver(
        height=12.0, position=(float(spot[0]), float(spot[1])), radius=0.01, fov_deg=180.0
    )
    link = link_of(two_hits).model_copy(update={"receiver": receiver})
    r = mt.simulate(
        link, valley(), estimator="analog", photons=50_000, normals="facet", record=[mt.Arrivals()]
    )
    assert r.gain > 0.0
    air = r.arrivals.air_path
    water = r.arrivals.water_path
    np.testing.assert_allclose(air, np.linalg.norm(second - first) + t, atol=1e-3)
    np.testing.assert_allclose(water, 4.5 / in_water[2], atol=1e-4)


def test_reflected_light_returns_from_a_bright_bottom():
    """Lambertian floor of albedo 1 in clear water: all light leaves in the end, by R^k T."""
    water = mt.Water(a=0.0, b=0.0, bottom_depth=1.0, bottom_albedo=1.0)
    link = mt.Link(water=water, transmitter=mt.Led(depth=0.5, half_angle_deg=60.0))
    mesh = FlatSea().mesh(extent=2000.0, spacing=500.0)
    r = mt.simulate(
        link, mesh, estimator="analog", photons=10_000, max_surface_events=1000, roulette=0.0
    )
    assert r.fates["landed"].weight + r.fates["received"].weight > 0.998
    killed = mt.simulate(
        link.model_copy(update={"physics": mt.Physics(reflected="kill")}),
        mesh,
        estimator="analog",
        photons=50_000,
    )
    assert killed.fates["reflected"].weight == pytest.approx(0.47195, abs=0.01)


@pytest.mark.parametrize("normals", ["vertex", "facet"])
def test_grazing_light_over_steep_waves(normals):
    """Tracing second hits takes light from the sky that ignoring them lets through the crests."""
    sea = SinusoidalSea(amplitude=0.4, wavelength=5.0)
    link = mt.Link(
        water=mt.Water(a=0.02, b=0.1, phase=mt.HenyeyGreenstein(g=0.5)),
        transmitter=mt.Led(depth=2.0, half_angle_deg=60.0),
    )
    mesh = sea.mesh(extent=40.0, spacing=0.25)
    trace, ignore = (
        mt.simulate(
            link.model_copy(update={"physics": mt.Physics(second_hit=kind)}),
            mesh,
            estimator="analog",
            photons=200_000,
            normals=normals,
        )
        for kind in ("trace", "ignore")
    )
    sky = [r.fates["landed"].weight + r.fates["received"].weight for r in (trace, ignore)]
    assert sky[0] < sky[1]
    assert sky[0] > 0.9 * sky[1]
    for r in (trace, ignore):
        assert sum(f.weight for f in r.fates.values()) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(("wind_speed", "expected"), [(5.0, 0.99756902), (13.0, 0.88987770)])
def test_whitecaps_weigh_the_crossing_once(wind_speed, expected):
    link = mt.Link(receiver=mt.Receiver(radius=0.5), physics=mt.Physics(reflected="kill"))
    foamy = link.model_copy(update={"whitecaps": mt.Whitecaps(wind_speed=wind_speed)})
    mesh = FlatSea().mesh(extent=70.0, spacing=35.0)
    plain, foam = (
        mt.simulate(x, mesh, estimator="analog", photons=50_000, seed=4) for x in (link, foamy)
    )
    assert foam.gain / plain.gain == pytest.approx(expected, rel=1e-8)


def test_roulette_and_weighting_of_the_surface_agree():
    receiver = mt.Receiver(radius=1.0)
    gains = []
    for kind in ("weight", "roulette"):
        link = mt.Link(receiver=receiver, physics=mt.Physics(fresnel=kind))
        r = mt.simulate(link, FlatSea(), estimator="analog", photons=400_000, seed=5)
        gains.append((r.gain, r.gain_stderr))
    (a, da), (b, db) = gains
    assert z_test(a, math.hypot(da, db), b) > sidak(ALPHA, 2)
    both = mt.Link(receiver=receiver, physics=mt.Physics(fresnel="paper_both", reflected="kill"))
    r = mt.simulate(both, FlatSea(), estimator="analog", photons=400_000, seed=5)
    # E4: the loss counts twice, 0.97994 at normal incidence
    assert z_test(r.gain / 0.9799, r.gain_stderr, a, da) > sidak(ALPHA, 2)
