"""The grid shortcut of the analog photons: its facets are Embree's, its results the same bits."""

import numpy as np
import pytest

import meshtrace as mt
from meshtrace import TriangleMesh
from meshtrace.engine.photons import analog
from meshtrace.engine.setup import arrays
from meshtrace.kernels import jit, rays, vectors
from meshtrace.surfaces import FlatSea, JonswapSea
from meshtrace.surfaces.triangulate import triangulate

SEA = JonswapSea(wind_speed=13.0, seed=7, waves="paper")


class Casting(mt.EmbreeIntersector):
    """Intersector that answers every ray."""

    shortcut = False


@jit.allocating_entry
def facets_of(grid, vertices, origins, directions, out):
    for i in range(len(out)):
        p = vectors.Vec3(origins[i, 0], origins[i, 1], origins[i, 2])
        d = vectors.Vec3(directions[i, 0], directions[i, 1], directions[i, 2])
        out[i] = rays.grid_facet(grid, vertices, p, d)


@jit.allocating_entry
def cells_of(axis, x, out):
    for i in range(len(out)):
        out[i] = rays.cell_of(axis, x[i])


def found(mesh, origins, directions):
    out = np.empty(len(origins), np.int64)
    facets_of(arrays.grid_arrays(mesh), mesh.vertices, origins, directions, out)
    return out


def uneven_mesh():
    """Return a sea on grid lines of uneven distance, far from the origin."""
    x = 300.0 + 10.0 * np.sinh(np.linspace(-1.5, 1.5, 61))
    y = np.linspace(-8.0, 9.0, 50)
    points = np.meshgrid(x, y, indexing="ij")
    return triangulate(x, y, SEA.elevation(*points), *SEA.slopes(*points))


MESHES = {
    "even": SEA.mesh(extent=15.0, spacing=0.25),
    "uneven": uneven_mesh(),
    "flat": FlatSea().mesh(extent=15.0, spacing=5.0),
}


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_facets_are_those_of_embree(name, side):
    mesh, n = MESHES[name], 200_000
    rng = np.random.default_rng(2)
    low, high = mesh.bounds
    inner = 0.5 * (low + high) + 0.4 * (high - low) * rng.uniform(-1.0, 1.0, (n, 3))
    sideways = rng.uniform(-0.3, 0.3, (n, 2))
    directions = np.column_stack([sideways, np.full(n, -side)])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    start = side * (np.abs(mesh.bounds[:, 2]).max() + rng.uniform(0.5, 4.0, n))
    origins = inner + ((start - inner[:, 2]) / directions[:, 2])[:, None] * directions
    facet = found(mesh, origins, directions)
    known = facet >= 0
    assert known.mean() > 0.9
    cast = mt.EmbreeIntersector(mesh).facets(
        origins.astype(np.float32), directions.astype(np.float32)
    )
    assert np.array_equal(facet[known], cast[known])


def test_rays_at_vertices_and_edges_are_left_to_embree():
    mesh = MESHES["even"]
    inner = (np.abs(mesh.vertices[:, :2]) < 12.0).all(axis=1)
    corners = mesh.vertices[mesh.faces[inner[mesh.faces].all(axis=1)]]
    aims = np.concatenate(
        [
            corners[:, 0],
            0.5 * (corners[:, 0] + corners[:, 1]),
            0.7 * corners[:, 1] + 0.3 * corners[:, 2],
        ]
    )
    direction = np.array([0.1, -0.05, 1.0]) / np.sqrt(1.0125)
    facet = found(mesh, aims - 5.0 * direction, np.broadcast_to(direction, aims.shape).copy())
    assert (facet < 0).all()


def test_other_rays_are_left_to_embree():
    """Slanted rays, rays beside the mesh, away from it, and from its own facet."""
    mesh = MESHES["even"]
    up, point = np.array([0.0, 0.0, 1.0]), np.array([[0.11, 0.07, -3.0]])
    assert found(mesh, point, up[None])[0] >= 0
    assert found(mesh, point, np.array([[0.9, 0.0, 0.43589]]))[0] < 0
    assert found(mesh, point + np.array([40.0, 0.0, 0.0]), up[None])[0] < 0
    assert found(mesh, point, -up[None])[0] < 0
    on = mt.EmbreeIntersector(mesh).intersect(point, up[None])
    assert found(mesh, point + on.distance[:, None] * up, up[None])[0] < 0
    assert found(mesh, np.full((1, 3), np.nan), up[None])[0] < 0


def test_cells_are_those_of_a_search():
    mesh = MESHES["uneven"]
    lines = np.unique(mesh.vertices[:, 0])
    x = np.concatenate([np.random.default_rng(3).uniform(lines[0], lines[-1], 50_000), lines[1:-1]])
    out = np.empty(len(x), np.int64)
    cells_of(arrays.grid_arrays(mesh).x, x, out)
    # a coordinate within rounding of a line may belong to either side: `grid_facet` has margins
    differ = out != np.searchsorted(lines, x, side="right") - 1
    assert np.abs(x[differ, None] - lines).min(axis=1, initial=0.0).max(initial=0.0) < 1e-10
    outside = np.array([lines[0] - 1e-3, lines[-1] + 1e-3, np.nan, -np.inf, np.inf])
    cells_of(arrays.grid_arrays(mesh).x, outside, out := np.empty(5, np.int64))
    assert (out == -1).all()


def test_other_meshes_have_no_grid():
    mesh = MESHES["even"]
    turned = TriangleMesh(mesh.vertices, np.roll(mesh.faces, 1, axis=1), mesh.vertex_normals)
    fewer = TriangleMesh(mesh.vertices, mesh.faces[:-1], mesh.vertex_normals)
    moved = mesh.vertices + 1e-6 * np.sin(mesh.vertices[:, ::-1])
    shifted = TriangleMesh(moved, mesh.faces, mesh.vertex_normals)
    single = TriangleMesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]), np.array([[0, 1, 2]]))
    for other in (turned, fewer, shifted, single):
        assert arrays.grid_arrays(other) is arrays.NO_GRID
    assert len(arrays.grid_arrays(mesh).x.line) * len(arrays.grid_arrays(mesh).y.line) == len(
        mesh.vertices
    )


@pytest.mark.parametrize(
    "link",
    [
        mt.Link(receiver=mt.Receiver(radius=0.5, fov_deg=120.0)),
        mt.Link(
            water=mt.Water(
                a=0.05,
                b=0.3,
                phase=mt.HenyeyGreenstein(g=0.8),
                bottom_depth=11.0,
                bottom_albedo=0.4,
            ),
            receiver=mt.Receiver(radius=1.0),
        ),
        mt.Link(
            transmitter=mt.Sun(zenith_deg=30.0),
            receiver=mt.WaterAperture(depth=2.0, radius=1.0, zenith_deg=180.0),
        ),
    ],
    ids=["default", "turbid", "sun"],
)
def test_results_are_the_same_bits_without_it(link):
    mesh = MESHES["even"]
    with_grid, without = (
        analog.run_analog(link, kind(mesh, 1), photons=20_000, seed=5)
        for kind in (mt.EmbreeIntersector, Casting)
    )
    assert with_grid.score.sum() > 0.0
    for name in ("score", "score_squared", "count", "misses"):
        assert np.array_equal(getattr(with_grid, name), getattr(without, name))
    assert np.array_equal(with_grid.ledger.value(), without.ledger.value())


@pytest.mark.filterwarnings("ignore:.*left the meshed surface:meshtrace.DomainWarning")
def test_grids_turned_by_half_a_circle_are_cast():
    """Their lines decrease: values outside the arrays were once read."""
    mesh = MESHES["even"]
    turned = TriangleMesh(mesh.vertices * (-1.0, -1.0, 1.0), mesh.faces)
    assert arrays.grid_arrays(turned) is arrays.NO_GRID
    link = mt.Link(receiver=mt.Receiver(radius=2.0, fov_deg=120.0))
    runs = [
        mt.simulate(link, surface, "analog", photons=20_000, seed=3, threads=1)
        for surface in (mesh, turned)
    ]
    a, b = runs
    assert a.gain > 10.0 * a.gain_stderr
    assert abs(a.gain - b.gain) < 3.9 * np.hypot(a.gain_stderr, b.gain_stderr)
