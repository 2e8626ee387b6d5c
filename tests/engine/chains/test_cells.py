"""Overlaps of images with cells, against counted points."""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test

import meshtrace as mt
from meshtrace.engine.chains import cells
from meshtrace.engine.setup import arrays, ends
from meshtrace.kernels import jit, rays, vectors
from meshtrace.surfaces import SinusoidalSea


@jit.entry
def _overlaps(triangles, x, y, half, poly, out):
    for i in range(len(triangles)):
        t = triangles[i]
        a, b, c = vectors.Vec2(t[0], t[1]), vectors.Vec2(t[2], t[3]), vectors.Vec2(t[4], t[5])
        out[i, 0], out[i, 1], out[i, 2] = cells._overlap(a, b, c, x, y, half, poly)


def overlap(triangles, x=0.0, y=0.0, half=0.5):
    t = np.asarray(triangles, float).reshape(-1, 6)
    out = np.empty((len(t), 3))
    _overlaps(t, x, y, half, np.empty((2, 16, 2)), out)
    return out


def test_overlap_with_a_cell_against_points_of_the_triangle():
    """Share and centroid of triangles of all sizes, by uniform points on them."""
    rng = np.random.default_rng(1)
    n, count, partly = 20_000, 200, 0
    size = 10.0 ** rng.uniform(-1, 0.5, (count, 1, 1))
    triangles = rng.uniform(-0.8, 0.8, (count, 1, 2)) + size * rng.normal(size=(count, 3, 2))
    u, v = rng.random((2, n))
    u, v = np.where(u + v > 1.0, (1.0 - u, 1.0 - v), (u, v))
    alpha = sidak(ALPHA, 3 * count)
    for t, (share, at_u, at_v) in zip(triangles, overlap(triangles), strict=True):
        points = t[0] + u[:, None] * (t[1] - t[0]) + v[:, None] * (t[2] - t[0])
        inside = (np.abs(points) <= 0.5).all(axis=1)
        stderr = math.sqrt(max(share * (1.0 - share), 1e-12) / n)
        if share * n > 20 and (1.0 - share) * n > 20:
            partly += 1
            assert z_test(inside.mean(), stderr, share) > alpha, t
            for got, values in ((at_u, u[inside]), (at_v, v[inside])):
                error = values.std() / math.sqrt(len(values))
                assert z_test(values.mean(), error, got) > alpha, t
        else:
            assert inside.mean() == pytest.approx(share, abs=25 / n)
    assert partly > 50


def test_cells_of_a_lattice_share_a_triangle():
    rng = np.random.default_rng(2)
    for _ in range(20):
        t = rng.uniform(-2.0, 2.0, 6)
        shares = [overlap(t, i + 0.5, j + 0.5)[0, 0] for i in range(-3, 3) for j in range(-3, 3)]
        assert sum(shares) == pytest.approx(1.0, abs=1e-9)


def test_an_image_at_a_caustic_lies_in_one_cell():
    line = [0.1, 0.1, 0.3, 0.3, 0.7, 0.7]
    shares = [overlap(line, x, x)[0, 0] for x in (0.0, 1.0)]
    assert shares == [1.0, 0.0]


@jit.entry
def _free(origins, directions, lengths, surface, grid, out):
    for i in range(len(lengths)):
        out[i] = rays.is_free(
            vectors.row(origins, i), vectors.row(directions, i), lengths[i], surface, grid
        )


def test_nothing_cuts_paths_that_leave_the_mesh():
    mesh = SinusoidalSea(amplitude=0.3, wavelength=2.5, phase=0.4).mesh(0.0, 6.0, 0.25)
    surface = arrays.surface_arrays(mesh, "vertex")
    target = ends.forced_link(mt.Link()).targets[0]._replace(reach=math.inf)
    grid = arrays.locator(surface, [target])
    rng = np.random.default_rng(3)
    start, end = rng.uniform(-1.0, 1.0, (2, 5000, 3)) * (5.5, 5.5, 1.5)
    way = end - start
    direction = way / np.linalg.norm(way, axis=1)[:, None]
    free = np.empty(5000, bool)
    # a hair is 4 mm here
    _free(start, direction, np.full(5000, 40.0), surface, grid, free)
    met = mt.EmbreeIntersector(mesh, 1).intersect(start, direction).distance
    sure = (met > 0.01) & ((met < 30.0) | np.isinf(met))
    assert np.count_nonzero(free[sure] != np.isinf(met[sure])) <= 2  # single precision at edges
    assert 0.2 < free.mean() < 0.8
