"""Distances, barycentrics and normals on facets against plain numpy."""

import numpy as np
import pytest

from meshtrace import TriangleMesh
from meshtrace.engine.setup import arrays
from meshtrace.kernels import interface, jit, vectors
from meshtrace.surfaces import JonswapSea


@jit.allocating_entry
def points(origins, directions, facet, surface):
    """Return distance, u, v and interpolated normal of every ray on its facet."""
    out = np.empty((len(facet), 6))
    for i in range(len(facet)):
        p, d = vectors.row(origins, i), vectors.row(directions, i)
        t = interface.plane_distance(p, d, facet[i], surface)
        hit = vectors.along(p, d, t)
        u, v = interface.barycentrics(hit.x, hit.y, facet[i], surface)
        out[i, 0], out[i, 1], out[i, 2] = t, u, v
        vectors.write(out[i, 3:], interface.interpolated_normal(u, v, facet[i], surface))
    return out


@pytest.fixture(scope="module")
def mesh():
    return JonswapSea(wind_speed=13.0, seed=3, waves="paper").mesh(extent=5.0, spacing=0.5)


def on_facets(mesh, facet, weights, origins):
    """Return points with given barycentrics and the rays to them."""
    corners = mesh.vertices[mesh.faces[facet]]
    target = np.einsum("ij,ijk->ik", weights, corners)
    way = target - origins
    distance = np.linalg.norm(way, axis=1)
    return target, way / distance[:, None], distance


def kernel_points(mesh, origins, directions, facet):
    return points(origins, directions, facet, arrays.surface_arrays(mesh, "vertex"))


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_points_on_facets(mesh, side):
    rng = np.random.default_rng(4)
    n = 2000
    facet = rng.integers(0, len(mesh.faces), n)
    weights = rng.dirichlet((1.0, 1.0, 1.0), n)
    origins = np.column_stack([rng.uniform(-20, 20, (n, 2)), np.full(n, 12.0 * side)])
    target, directions, distance = on_facets(mesh, facet, weights, origins)
    out = kernel_points(mesh, origins, directions, facet)
    np.testing.assert_allclose(out[:, 0], distance, rtol=1e-12)
    np.testing.assert_allclose(out[:, 1:3], weights[:, 1:], rtol=0, atol=1e-10)
    corners = np.einsum("ij,ijk->ik", weights, mesh.vertices[mesh.faces[facet]])
    np.testing.assert_allclose(target, corners, atol=1e-12)
    normal = np.einsum("ij,ijk->ik", weights, mesh.vertex_normals[mesh.faces[facet]])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    np.testing.assert_allclose(out[:, 3:], normal, rtol=0, atol=1e-10)


def test_corners_have_their_own_normal(mesh):
    facet = np.arange(len(mesh.faces))
    for corner in range(3):
        weights = np.zeros((len(facet), 3))
        weights[:, corner] = 1.0
        target, directions, _ = on_facets(mesh, facet, weights, np.zeros((len(facet), 3)) + 9.0)
        out = kernel_points(mesh, target - directions, directions, facet)
        expected = mesh.vertex_normals[mesh.faces[:, corner]]
        np.testing.assert_allclose(out[:, 3:], expected, atol=1e-10)


@jit.allocating_entry
def points_of(places, facet, surface):
    """Return u, v and interpolated normal of every place on its facet."""
    out = np.empty((len(facet), 5))
    for i in range(len(facet)):
        p = vectors.row(places, i)
        out[i, 0], out[i, 1] = interface.barycentrics_of(p, facet[i], surface)
        vectors.write(out[i, 2:], interface.normal_on(p, facet[i], surface))
    return out


def test_points_on_facets_of_any_orientation():
    """A soup of facets, upright and upside down ones among them; the twin is least squares."""
    rng = np.random.default_rng(5)
    n = 600
    corners = rng.normal(size=(n, 3, 3))
    corners[:100, :, 0] = 0.3  # upright, along y
    corners[100:200, :, 1] = -2.0  # upright, along x
    corners[200:300, :, 2] = 0.0  # level
    normals = rng.normal(size=(3 * n, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    faces = np.arange(3 * n).reshape(-1, 3)
    soup = TriangleMesh(corners.reshape(-1, 3), faces, normals, overhangs=True)
    assert 200 < soup.facing_down < 500
    weights = rng.dirichlet((1.0, 1.0, 1.0), n)
    places = np.einsum("ij,ijk->ik", weights, corners)
    out = points_of(places, np.arange(n), arrays.surface_arrays(soup, "vertex"))
    for i in range(n):
        edges = (corners[i, 1:] - corners[i, 0]).T
        uv = np.linalg.lstsq(edges, places[i] - corners[i, 0], rcond=None)[0]
        np.testing.assert_allclose(out[i, :2], uv, atol=1e-9)
    normal = np.einsum("ij,ijk->ik", weights, normals[faces])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    np.testing.assert_allclose(out[:, 2:], normal, atol=1e-7)


def test_ray_along_the_plane_is_infinitely_far():
    mesh = TriangleMesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])

    @jit.allocating_entry
    def distance(triangles):
        return interface.plane_distance(
            vectors.Vec3(0.0, 0.0, -1.0), vectors.Vec3(1.0, 0.0, 0.0), 0, triangles
        )

    assert distance(interface.Triangles(mesh.vertices, mesh.faces, mesh.face_normals)) == np.inf


@jit.allocating_entry
def roughened(roughness, direction, normal, downwind, across):
    """Return slopes of the tilt, the tilted normal and its exposure, for each pair of numbers."""
    out = np.empty((len(downwind), 6))
    d = vectors.Vec3(direction[0], direction[1], direction[2])
    n = vectors.Vec3(normal[0], normal[1], normal[2])
    for i in range(len(downwind)):
        tilt = interface.slope_tilt(roughness, downwind[i], across[i])
        out[i, 0], out[i, 1] = tilt.x, tilt.y
        vectors.write(out[i, 2:5], interface.tilted(n, tilt))
        out[i, 5] = interface.exposure(d, n, tilt)
    return out


def test_slopes_have_the_variances_along_and_across_the_wind():
    """The covariance of R (g1 s_along, g2 s_across) is R diag(s^2) R^T."""
    wind = np.radians(35.0)
    roughness = interface.Roughness(0.2, 0.1, np.cos(wind), np.sin(wind))
    up = np.array([0.0, 0.0, 1.0])
    unit = np.array([[1.0, 0.0], [0.0, 1.0]])
    slopes = roughened(roughness, up, up, *unit)[:, :2]
    turn = np.array([[np.cos(wind), -np.sin(wind)], [np.sin(wind), np.cos(wind)]])
    np.testing.assert_allclose(slopes.T @ slopes, turn @ np.diag([0.04, 0.01]) @ turn.T, atol=1e-15)


@pytest.mark.parametrize("dz", [0.9, -0.7])
def test_tilted_normals_and_what_light_sees_of_them(dz):
    """Slopes add; the exposure is the area seen, d . (-s, 1), over its mean."""
    rng = np.random.default_rng(3)
    d = np.array([0.3, -0.2, dz])
    d /= np.linalg.norm(d)
    s = np.array([0.1, 0.25])
    normal = np.array([*-s, 1.0]) / np.sqrt(1.0 + s @ s)
    g = rng.standard_normal((2, 4000))
    out = roughened(interface.Roughness(0.2, 0.15, 1.0, 0.0), d, normal, *g)
    slopes = s + out[:, :2]
    up = np.column_stack([-slopes, np.ones(len(slopes))])
    np.testing.assert_allclose(out[:, 2:5], up / np.linalg.norm(up, axis=1)[:, None], atol=1e-14)
    seen = up @ d / (np.array([*-s, 1.0]) @ d)
    np.testing.assert_allclose(out[:, 5], np.clip(seen, 0.0, 2.0), atol=1e-12)
    opposite = roughened(interface.Roughness(0.2, 0.15, 1.0, 0.0), d, normal, *-g)
    np.testing.assert_allclose(out[:, 5] + opposite[:, 5], 2.0, atol=1e-12)
