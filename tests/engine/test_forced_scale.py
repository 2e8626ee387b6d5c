"""Scale, distance from the origin and size of the mesh: none of them changes a gain."""

import math

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.engine.forced import ForcedDetection
from meshtrace.engine.setup import ends, meshing
from meshtrace.errors import DomainWarning, Refused
from meshtrace.optics import fresnel_reflectance
from meshtrace.surfaces import FlatSea


def scaled(k, x=0.0):
    return mt.Link(
        water=mt.Water(a=0.114 / k, b=0.037 / k),
        transmitter=mt.Led(depth=10.0 * k, position=(x, 0.0)),
        receiver=mt.Receiver(height=5.0 * k, radius=0.05 * k, position=(x, 0.0)),
    )


def parts_of(link, photons=2048, seed=1):
    mesh, _ = meshing.mesh_for(link, FlatSea(), reach=ends.crossing_reach(link))
    return ForcedDetection(link, photons, seed).evaluate(mesh)


@pytest.fixture(scope="module")
def metres():
    return parts_of(scaled(1.0))


@pytest.mark.parametrize("k", [1e-4, 1e-3, 3e-3, 0.007, 10.0])
def test_all_lengths_times_k_change_nothing(k, metres):
    """A laboratory tank: once -1.3 % at 0.003, -11 % at 0.001, no direct light at 1e-4."""
    parts = parts_of(scaled(k))
    np.testing.assert_allclose(parts.ballistic, metres.ballistic, rtol=2e-5)
    np.testing.assert_allclose(parts.gain, metres.gain, rtol=1e-4)


def test_a_power_of_two_changes_no_bit():
    a, b = (parts_of(scaled(k), 512) for k in (1.0, 1.0 / 64.0))
    np.testing.assert_array_equal(a.scattered, b.scattered)


@pytest.mark.parametrize("x", [1e5, 9e5])
def test_links_far_from_the_origin(x, metres):
    parts = parts_of(scaled(1.0, x))
    np.testing.assert_allclose(parts.gain, metres.gain, rtol=1e-5)


def test_a_receiver_far_aside_takes_a_small_mesh():
    """It once built 11.3 million facets."""
    link = mt.Link(receiver=mt.Receiver(position=(100.0, 0.0)))
    mesh, _ = meshing.mesh_for(link, FlatSea(), reach=ends.crossing_reach(link))
    assert len(mesh.faces) < 1_000_000
    low, high = mesh.bounds
    assert low[0] < 0.0
    assert high[0] > ends.crossing_reach(link)


def test_a_mesh_of_too_many_facets_is_refused_before_it_is_made():
    with pytest.raises(Refused, match=r"mesh: .* million facets, some .* GB, allowed"):
        meshing.mesh_for(mt.Link(), FlatSea(), mt.Meshing(extent=1000.0, spacing=0.01))


def test_an_extent_that_cuts_the_light_is_said():
    link = mt.Link(transmitter=mt.Led(half_angle_deg=60.0), receiver=mt.Receiver(fov_deg=150.0))
    with pytest.warns(DomainWarning, match="the mesh cuts off .* enlarge extent"):
        mt.simulate(link, FlatSea(), photons=512, extent=1.0)


def test_distant_corners_are_refused():
    corners = np.array([[0.0, 0.0, 0.0], [1e30, 0.0, 0.0], [0.0, 1e30, 0.0]])
    with pytest.raises(Refused, match=r"mesh\.vertices: 1e\+30, allowed: coordinates within 1e"):
        mt.TriangleMesh(corners, np.array([[0, 1, 2]]))


@pytest.mark.parametrize("extent", [9e5, 1000.0])
def test_eight_facets_over_kilometres(extent):
    """Corners near the limit; at 1 km each facet was once cut into (20 000)^2 parts."""
    mesh = FlatSea().mesh(extent=extent, spacing=extent)
    parts = ForcedDetection(mt.Link(), 64, 1).evaluate(mesh)
    assert parts.ballistic[0] == pytest.approx(4.5166617e-5, rel=1e-4)


def test_upright_facets_have_an_infinite_slope():
    assert FlatSea().mesh(extent=1.0, spacing=1.0).max_slope == 0.0
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    faces = np.array([[0, 1, 2], [0, 3, 2]])
    assert mt.TriangleMesh(corners, faces, overhangs=True).max_slope == math.inf


@pytest.mark.parametrize("half_angle", [0.5, 1.0, 3.0])
def test_narrow_beams(half_angle):
    """Gain of an unscattered beam: int I exp(-c l) T over the solid angle of the aperture.

    Parts of a facet too large for the beam once made a lamp of 1 degree 0.13 % too bright.
    """
    link = mt.Link(
        water=mt.Water(b=0.0),
        transmitter=mt.Led(depth=20.0, half_angle_deg=half_angle),
        receiver=mt.Receiver(radius=0.5),
    )
    n, a, h, d = link.water.n, link.water.a, 5.0, 20.0
    order = link.transmitter.order

    def landing(theta):
        return d * math.tan(theta) + h * math.tan(math.asin(n * math.sin(theta)))

    low, high = 0.0, 0.5
    for _ in range(80):
        mid = 0.5 * (low + high)
        low, high = (mid, high) if landing(mid) < 0.5 else (low, mid)
    x, w = np.polynomial.legendre.leggauss(200)
    theta = 0.5 * low * (1.0 + x)
    cos = np.cos(theta)
    through = 1.0 - fresnel_reflectance(cos, n, 1.0)
    light = (order + 1.0) * cos**order * np.sin(theta) * np.exp(-a * d / cos) * through
    expected = 0.5 * low * float((w * light).sum())
    got = parts_of(link, 64).ballistic[0]
    assert got == pytest.approx(expected, rel=1e-4)
