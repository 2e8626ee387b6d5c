import math

import numpy as np
import pytest
import trimesh

from meshtrace.surfaces import JonswapSea, from_trimesh, triangulate


def flat_grid(n=5, extent=2.0):
    axis = np.linspace(-extent, extent, n)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    vertices = np.stack([x, y, 0.1 * np.sin(x + 0.5 * y)], axis=-1).reshape(-1, 3)
    return vertices, np.array(triangulate.grid_faces(n, n))


def ribbon(turns, rise, steps=48):
    """Ramp around the origin between the radii 1 and 2, all facets facing up."""
    angle = np.linspace(0.0, 2.0 * math.pi * turns, steps) % (2.0 * math.pi)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    z = np.linspace(0.0, rise, steps)[:, None]
    vertices = np.concatenate([np.hstack([ring, z]), np.hstack([2.0 * ring, z])])
    i = np.arange(steps - 1)
    faces = np.concatenate(
        [np.stack([i, i + steps, i + steps + 1], 1), np.stack([i, i + steps + 1, i + 1], 1)]
    )
    return vertices, faces


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj"])
@pytest.mark.parametrize("as_text", [True, False])
def test_reads_files(tmp_path, suffix, as_text):
    sea = JonswapSea(wind_speed=13.0, seed=3).mesh(extent=6.15, spacing=0.5)
    path = tmp_path / f"sea.{suffix}"
    sea.to_trimesh().export(path)
    mesh = from_trimesh(str(path) if as_text else path, extent=6.15)
    assert mesh.vertices.shape == sea.vertices.shape
    assert mesh.faces.shape == sea.faces.shape
    order, expected = (
        np.lexsort(mesh.vertices.T[:2].round(3)),
        np.lexsort(sea.vertices.T[:2].round(3)),
    )
    np.testing.assert_allclose(mesh.vertices[order], sea.vertices[expected], atol=1e-6)
    assert (mesh.vertex_normals[:, 2] > 0.0).all()


def test_reads_objects_pairs_and_grids():
    vertices, faces = flat_grid()
    axis = np.linspace(-2.0, 2.0, 5)
    z = vertices[:, 2].reshape(5, 5)
    sources = [
        trimesh.Trimesh(vertices, faces, process=False),
        (vertices, faces),
        [vertices.tolist(), faces.tolist()],
        (axis, axis, z),
        (*np.meshgrid(axis, axis, indexing="ij"), z),
        (*np.meshgrid(axis, axis), z.T),
    ]
    for source in sources:
        mesh = from_trimesh(source, extent=2.0)
        np.testing.assert_array_equal(mesh.vertices, vertices)
        np.testing.assert_array_equal(mesh.faces, faces)
    # Every facet is within 0.1 of the steepest slope, so the mean normals are as well.
    slope = 0.1 * np.cos(vertices[:, 0] + 0.5 * vertices[:, 1])
    np.testing.assert_allclose(
        -mesh.vertex_normals[:, 0] / mesh.vertex_normals[:, 2], slope, atol=0.06
    )


def test_merges_equal_vertices_and_drops_unused_ones():
    vertices, faces = flat_grid()
    soup = np.concatenate([vertices[faces.ravel()], [[9.0, 9.0, math.nan]]])
    mesh = from_trimesh((soup, np.arange(faces.size).reshape(-1, 3)), extent=2.0)
    assert len(mesh.vertices) == len(vertices)
    assert len(mesh.faces) == len(faces)
    signed = vertices.copy()
    signed[signed == 0.0] = -0.0
    both = np.concatenate([vertices, signed])
    half = faces.copy()
    half[::2] += len(vertices)
    assert len(from_trimesh((both, half)).vertices) == len(vertices)


def test_accepts_graded_meshes():
    sea = JonswapSea(wind_speed=5.0).mesh(extent=9.0, spacing=0.2, fine_extent=1.0)
    assert len(from_trimesh(sea.to_trimesh(), extent=9.0).faces) == len(sea.faces)


def test_accepts_an_outline_that_is_not_convex():
    assert len(from_trimesh(ribbon(0.9, 0.5)).faces) == 94


def without(predicate):
    vertices, faces = flat_grid(9)
    middle = vertices[faces].mean(axis=1)
    return vertices, faces[~predicate(middle[:, 0], middle[:, 1])]


def flipped(some):
    vertices, faces = flat_grid()
    faces = faces.copy()
    faces[some] = faces[some][:, ::-1]
    return vertices, faces


def lifted(height):
    vertices, faces = flat_grid()
    return np.concatenate([vertices, vertices + np.array([0, 0, height])]), np.concatenate(
        [faces, faces + len(vertices)]
    )


def bent(corner):
    """Two facets over the unit square, one more hanging from the edge x = 1."""
    vertices = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), corner]
    return vertices, [(0, 1, 2), (0, 2, 3), (1, 4, 2)]


def broken():
    vertices, faces = flat_grid()
    vertices = vertices.copy()
    vertices[7, 2] = math.nan
    return vertices, faces


REFUSED = {
    "empty pair": (lambda: (np.empty((0, 3)), np.empty((0, 3), int)), "empty"),
    "empty trimesh": (trimesh.Trimesh, "empty"),
    "nothing of ours": (lambda: 42, "source: int, allowed: trimesh.Trimesh, a path"),
    "four arrays": (lambda: (1, 2, 3, 4), "source: tuple, allowed"),
    "flat vertices": (lambda: (np.zeros((4, 2)), [(0, 1, 2)]), r"shapes \(4, 2\)"),
    "quads": (lambda: (np.zeros((4, 3)), [(0, 1, 2, 3)]), r"and \(1, 4\)"),
    "float faces": (lambda: (flat_grid()[0], flat_grid()[1] * 1.0), "type float64"),
    "faces out of range": (lambda: (flat_grid()[0], flat_grid()[1] + 1), r"faces 1..25"),
    "not finite": (broken, "not all finite"),
    "degenerate": (lambda: (flat_grid()[0], [(0, 1, 5), (0, 1, 1)]), "1 of 2 facets without area"),
    "collinear": (lambda: (flat_grid()[0] * [1, 1, 0], [(0, 5, 10)]), "1 of 1 facets without"),
    "closed solid": (trimesh.creation.box, "closed solid"),
    "turned over": (lambda: flipped(slice(None)), "32 of 32 facets face down"),
    "partly turned over": (lambda: flipped(slice(3, 6)), "3 of 32 facets face down"),
    "vertical wall": (lambda: bent((1, 0.5, -1)), "1 of 3 facets are vertical"),
    "overhang": (lambda: bent((0.5, 0.5, -1)), "1 of 3 facets face down"),
    "three on an edge": (
        lambda: (
            [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, -1, 0), (0.5, 1, 3)],
            [(0, 1, 2), (1, 0, 3), (0, 1, 4)],
        ),
        "1 of 7 edges join more than two",
    ),
    "two sheets": (lambda: lifted(1.0), "2 separate pieces or sheets"),
    "pinched": (
        lambda: (
            [(0, 0, 0), (1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0)],
            [(0, 1, 2), (0, 3, 4)],
        ),
        "joined at a single vertex",
    ),
    "hole": (lambda: without(lambda x, y: np.hypot(x, y) < 0.7), "1 holes inside"),
    "two holes": (lambda: without(lambda x, y: np.hypot(abs(x) - 1.0, y) < 0.4), "2 holes inside"),
    "spiral ramp": (lambda: ribbon(1.3, 2.0), "outline meets itself"),
    "ring with a seam": (lambda: ribbon(1.0, 0.5), "outline meets itself"),
    "crossed grid": (lambda: (np.eye(2), np.eye(2), np.zeros((2, 2))), "no grid"),
    "grid of wrong shape": (lambda: ([0, 1], [0, 1], np.zeros((3, 2))), r"z: \(3, 2\)"),
    "grid shapes differ": (lambda: (np.eye(2), np.eye(3), np.eye(2)), "allowed: equal ones"),
    "falling grid": (lambda: ([1, 0], [0, 1], np.zeros((2, 2))), "x: shape"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refuses(name):
    make, message = REFUSED[name]
    with pytest.raises(ValueError, match=message):
        from_trimesh(make())


def doubled_areas(a, b, c):
    u, v = b - a, c - a
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]


def test_area_of_a_spiral_equals_that_inside_its_outline():
    vertices, faces = ribbon(1.3, 2.0)
    a, b, c = (vertices[faces[:, i], :2] for i in range(3))
    facets = doubled_areas(a, b, c).sum() / 2
    steps = len(vertices) // 2
    outline = np.concatenate([np.arange(steps, 2 * steps), np.arange(steps)[::-1]])
    x, y = vertices[outline, :2].T
    shoelace = 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
    assert facets == pytest.approx(shoelace, rel=1e-12)


@pytest.mark.parametrize(
    ("source", "extent", "covered"),
    [
        (flat_grid, 2.0, True),
        (flat_grid, 0.3, True),
        (flat_grid, 2.0 * (1 + 5e-7), True),
        (flat_grid, 2.001, False),
        (lambda: (flat_grid()[0] + [5.0, 0.0, 0.0], flat_grid()[1]), 1.0, False),
        # A notch that leaves the corners and the centre covered.
        (lambda: without(lambda x, y: (abs(x) < 0.5) & (y > 0.5)), 2.0, False),
        (lambda: without(lambda x, y: (abs(x) < 0.5) & (y > 0.5)), 0.5, True),
        (lambda: without(lambda x, y: (abs(x) < 0.5) & (y > 0.5)), 0.6, False),
        # The square lies in the eye of the ring: no outline crosses it.
        (lambda: ribbon(0.9, 0.1), 0.2, False),
    ],
)
def test_coverage(source, extent, covered):
    if covered:
        from_trimesh(source(), extent=extent)
    else:
        with pytest.raises(ValueError, match=r"extent: .* that the surface covers"):
            from_trimesh(source(), extent=extent)


@pytest.mark.parametrize("extent", [0.0, -1.0, math.nan, math.inf])
def test_refuses_extents(extent):
    with pytest.raises(ValueError, match="extent: "):
        from_trimesh(flat_grid(), extent=extent)


def test_missing_file(tmp_path):
    with pytest.raises((ValueError, OSError)):
        from_trimesh(tmp_path / "nothing.stl")
