"""Embree against brute force: random rays, rays aimed at vertices and edges, grazing rays.

Embree works in single precision, the oracle in double. They may differ only where that can be
seen: in which of two facets that touch at the point was met, or whether a ray that passes within
rounding of the rim or of a crest was met at all.
"""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import meshtrace as mt
from meshtrace import TriangleMesh
from meshtrace.engine.bvh import Hits
from meshtrace.surfaces import FlatSea, JonswapSea

TOLERANCE = 2e-5  # [m], some units of single precision at 10 m


@pytest.fixture(scope="module")
def mesh():
    return JonswapSea(wind_speed=13.0, seed=7, waves="paper").mesh(extent=6.0, spacing=1.0)


@pytest.fixture(scope="module")
def fine_mesh():
    return JonswapSea(wind_speed=13.0, seed=7, waves="paper").mesh(extent=60.0, spacing=0.25)


def to_unit(d):
    return d / np.linalg.norm(d, axis=1)[:, None]


def neighbours(mesh, f, g):
    """Return whether facets share a corner."""
    return (mesh.faces[f][:, :, None] == mesh.faces[g][:, None, :]).any(axis=(1, 2))


def unexplained(mesh, origins, directions):
    """Return the rays whose answers differ beyond single precision, and both answers."""
    fast = mt.EmbreeIntersector(mesh).intersect(origins, directions)
    oracle = mt.BruteForceIntersector(mesh)
    slow = oracle.intersect(origins, directions)
    differ = np.flatnonzero(fast.facet != slow.facet)
    f, g = fast.facet[differ], slow.facet[differ]
    both = (f >= 0) & (g >= 0)
    touch = np.zeros(len(differ), bool)
    touch[both] = neighbours(mesh, f[both], g[both])
    near = np.abs(fast.distance[differ] - slow.distance[differ]) < TOLERANCE
    # the rest must be what the oracle itself answers within rounding of the ray
    rest = differ[~(both & touch & near)]
    left = [i for i in rest if not _seen_beside(oracle, origins[i], directions[i], fast.facet[i])]
    return np.array(left, int), fast, slow


def _seen_beside(oracle, origin, direction, facet):
    """Return whether the oracle gives this answer to a ray displaced by rounding."""
    shifts = np.random.default_rng(0).normal(size=(200, 3)) * TOLERANCE
    beside = oracle.intersect(origin + shifts, np.broadcast_to(direction, shifts.shape))
    return (beside.facet == facet).any()


def assert_points_lie_on_their_facets(mesh, hits, origins, directions, slack):
    """Check that point, distance and barycentrics agree to 1e-9 and lie within the facet."""
    hit = hits.facet >= 0
    corners = mesh.vertices[mesh.faces[hits.facet[hit]]]
    u, v = hits.u[hit], hits.v[hit]
    weights = np.column_stack([1.0 - u - v, u, v])
    point = origins[hit] + hits.distance[hit, None] * directions[hit]
    np.testing.assert_allclose(point, np.einsum("ij,ijk->ik", weights, corners), atol=1e-9)
    assert weights.min() > -slack
    assert (hits.distance[hit] > -TOLERANCE).all()
    assert np.isinf(hits.distance[~hit]).all()
    assert np.isnan(hits.u[~hit]).all()
    assert np.isnan(hits.v[~hit]).all()


def random_rays(rng, n, width=7.0):
    """Return rays from around, above and below to points around the surface."""
    origins = np.column_stack([rng.uniform(-width, width, (n, 2)), rng.uniform(-6.0, 6.0, n)])
    targets = np.column_stack([rng.uniform(-width, width, (n, 2)), rng.uniform(-1.0, 1.0, n)])
    return origins, to_unit(targets - origins)


def rays_to(rng, targets, height):
    """Return rays from a height [m] above (or below) to given points."""
    side = rng.uniform(-3.0, 3.0, (len(targets), 2))
    origins = targets + np.column_stack([side, np.full(len(targets), height)])
    return origins, to_unit(targets - origins)


def inner_vertices(mesh, rng, n):
    """Return corners that are not on the rim."""
    low, high = mesh.bounds[:, :2] + np.array([[1e-6], [-1e-6]])
    inside = ((mesh.vertices[:, :2] > low) & (mesh.vertices[:, :2] < high)).all(axis=1)
    return mesh.vertices[rng.choice(np.flatnonzero(inside), n)]


def edge_points(mesh, rng, n):
    """Return points on edges, none on the rim."""
    facet, corner = rng.integers(0, len(mesh.faces), n), rng.integers(0, 3, n)
    a = mesh.vertices[mesh.faces[facet, corner]]
    b = mesh.vertices[mesh.faces[facet, (corner + 1) % 3]]
    w = rng.random((n, 1))
    points = w * a + (1.0 - w) * b
    inside = (np.abs(points[:, :2]) < mesh.bounds[1, :2] - 1e-6).all(axis=1)
    return points[inside]


def test_random_rays(mesh):
    origins, directions = random_rays(np.random.default_rng(1), 100_000)
    left, fast, slow = unexplained(mesh, origins, directions)
    assert len(left) == 0
    assert (slow.facet >= 0).sum() > 50_000
    assert (slow.facet < 0).sum() > 10_000
    assert (fast.facet != slow.facet).sum() <= 10
    assert_points_lie_on_their_facets(mesh, fast, origins, directions, 1e-4)
    assert_points_lie_on_their_facets(mesh, slow, origins, directions, 1e-5)


@pytest.mark.parametrize("height", [-5.0, 5.0])
@pytest.mark.parametrize("aim", [inner_vertices, edge_points])
def test_rays_aimed_at_vertices_and_edges(mesh, aim, height):
    rng = np.random.default_rng(2)
    origins, directions = rays_to(rng, aim(mesh, rng, 10_000), height)
    left, fast, slow = unexplained(mesh, origins, directions)
    missed = fast.facet < 0
    assert missed.mean() <= 0.02, "robust mode misses at most about 1 % of exact vertices"
    assert (slow.facet < 0).mean() <= 0.02
    assert len(left) == 0
    assert (fast.facet != slow.facet).mean() > 0.1, "the rays do not meet the edges"


def test_vertical_rays_at_vertices(mesh):
    """The raster of local depths and beams straight up cast such rays."""
    rng = np.random.default_rng(3)
    targets = inner_vertices(mesh, rng, 5000)
    for side in (-1.0, 1.0):
        origins = targets * (1, 1, 0) + (0, 0, 4.0 * side)
        directions = np.broadcast_to((0.0, 0.0, -side), origins.shape)
        left, fast, _ = unexplained(mesh, origins, directions)
        assert len(left) == 0
        assert (fast.facet < 0).mean() <= 0.02
        hit = fast.facet >= 0
        z = origins[hit, 2] - side * fast.distance[hit]
        np.testing.assert_allclose(z, targets[hit, 2], atol=1e-5)


def test_grazing_rays(mesh):
    """Nearly level rays through the waves, which pass many facets edge-on."""
    rng = np.random.default_rng(4)
    n = 20_000
    azimuth, elevation = rng.uniform(0.0, 2 * np.pi, n), rng.uniform(-0.05, 0.05, n)
    directions = np.column_stack(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )
    low, high = mesh.bounds[:, 2]
    middle = np.column_stack([rng.uniform(-5.0, 5.0, (n, 2)), rng.uniform(low, high, n)])
    origins = middle - 12.0 * directions
    left, fast, slow = unexplained(mesh, origins, directions)
    assert len(left) == 0
    assert (slow.facet >= 0).sum() > 5000
    assert (slow.facet < 0).sum() > 1000
    assert (fast.facet != slow.facet).mean() < 1e-3


def test_rays_in_the_plane_of_a_flat_sea():
    """A level ray on the surface may meet any facet or none, and must not fail."""
    flat = FlatSea().mesh(extent=5.0, spacing=1.0)
    origins = np.column_stack([np.full(100, -9.0), np.linspace(-6, 6, 100), np.zeros(100)])
    directions = np.tile((1.0, 0.0, 0.0), (100, 1))
    for intersector in (mt.EmbreeIntersector(flat), mt.BruteForceIntersector(flat)):
        facet = intersector.facets(origins.astype(np.float32), directions.astype(np.float32))
        assert ((facet >= -1) & (facet < len(flat.faces))).all()


def test_nearest_of_several_facets_wins(mesh):
    """Rays along the waves cross the sheet several times: the first crossing counts."""
    rng = np.random.default_rng(5)
    n = 3000
    directions = to_unit(np.column_stack([rng.normal(size=(n, 2)), 0.1 * rng.normal(size=n)]))
    origins = np.column_stack([rng.uniform(-5, 5, (n, 2)), np.zeros(n)]) - 9.0 * directions
    fast = mt.EmbreeIntersector(mesh).intersect(origins, directions)
    hit = np.flatnonzero(fast.facet >= 0)
    beyond = origins[hit] + (fast.distance[hit] + 1e-3)[:, None] * directions[hit]
    again = mt.EmbreeIntersector(mesh).intersect(beyond, directions[hit])
    assert (again.facet >= 0).sum() > 100
    before = mt.BruteForceIntersector(mesh).intersect(origins[hit], directions[hit])
    np.testing.assert_allclose(before.distance, fast.distance[hit], atol=TOLERANCE)


def test_fine_mesh_far_from_the_origin(fine_mesh):
    """Vertical rays on a fine mesh: the facet must hold the point, to single precision at 60 m."""
    rng = np.random.default_rng(6)
    n = 200_000
    origins = np.column_stack([rng.uniform(-60, 60, (n, 2)), np.full(n, 4.0)])
    directions = np.broadcast_to((0.0, 0.0, -1.0), origins.shape)
    hits = mt.EmbreeIntersector(fine_mesh).intersect(origins, directions)
    assert (hits.facet >= 0).all()
    assert_points_lie_on_their_facets(fine_mesh, hits, origins, directions, 1e-4)


@pytest.mark.parametrize("scale", [0.01, 1.0, 30.0])
def test_distance_is_in_lengths_of_the_direction(mesh, scale):
    rng = np.random.default_rng(7)
    origins, directions = random_rays(rng, 2000)
    one = mt.EmbreeIntersector(mesh).intersect(origins, directions)
    many = mt.EmbreeIntersector(mesh).intersect(origins, directions * scale)
    hit = (one.facet >= 0) & (many.facet == one.facet)
    assert hit.sum() > 1000
    np.testing.assert_allclose(many.distance[hit] * scale, one.distance[hit], rtol=1e-9, atol=1e-9)


def test_threads_give_equal_answers(fine_mesh):
    origins, directions = random_rays(np.random.default_rng(8), 50_001, width=50.0)
    one = mt.EmbreeIntersector(fine_mesh, threads=1).intersect(origins, directions)
    for threads in (2, 3, 7):
        many = mt.EmbreeIntersector(fine_mesh, threads).intersect(origins, directions)
        for name in Hits._fields:
            np.testing.assert_array_equal(getattr(many, name), getattr(one, name))


def test_one_scene_may_be_asked_by_many_threads_at_once(fine_mesh):
    rng = np.random.default_rng(9)
    intersector = mt.EmbreeIntersector(fine_mesh, threads=1)
    rays = [tuple(a.astype(np.float32) for a in random_rays(rng, 20_000, 50.0)) for _ in range(8)]
    alone = [intersector.facets(*r) for r in rays]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda r: intersector.facets(*r), rays))
    for a, b in zip(alone, together, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("intersector", [mt.EmbreeIntersector, mt.BruteForceIntersector])
def test_no_rays_and_bad_rays(mesh, intersector):
    none = intersector(mesh).intersect(np.empty((0, 3)), np.empty((0, 3)))
    assert len(none.facet) == len(none.distance) == 0
    with pytest.raises(ValueError, match="origins"):
        intersector(mesh).intersect([[0.0, np.nan, 0.0]], [[0.0, 0.0, 1.0]])
    with pytest.raises(ValueError, match="directions"):
        intersector(mesh).intersect([[0.0, 0.0, 0.0]], [[0.0, 1.0]])
    with pytest.raises(ValueError, match="directions"):
        intersector(mesh).intersect(np.zeros((2, 3)), np.ones((3, 3)))


def test_mesh_of_one_facet():
    mesh = TriangleMesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    origins = np.array([[0.25, 0.25, -1.0], [0.9, 0.9, -1.0], [0.25, 0.5, 2.0]])
    directions = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    for hits in (
        mt.EmbreeIntersector(mesh).intersect(origins, directions),
        mt.BruteForceIntersector(mesh).intersect(origins, directions),
    ):
        assert hits.facet.tolist() == [0, -1, 0]
        assert hits.distance.tolist() == [1.0, np.inf, 2.0]
        np.testing.assert_allclose(hits.u[[0, 2]], [0.25, 0.25])
        np.testing.assert_allclose(hits.v[[0, 2]], [0.25, 0.5])
