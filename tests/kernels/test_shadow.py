"""Shadows of waves on straight paths, against rays of brute force and of Embree."""

import math

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.engine.setup import arrays
from meshtrace.engine.setup.ends import forced_link
from meshtrace.kernels import jit, rays, vectors
from meshtrace.surfaces import SinusoidalSea


@jit.entry
def _free(origins, directions, lengths, surface, grid, out):
    for i in range(len(lengths)):
        out[i] = rays.is_free(
            vectors.row(origins, i), vectors.row(directions, i), lengths[i], surface, grid
        )


def free(start, direction, length, surface, grid):
    out = np.empty(len(length), bool)
    _free(start, direction, length, surface, grid, out)
    return out


@pytest.fixture(scope="module")
def steep():
    """Return a steep sea, its arrays and bins over a part of it."""
    mesh = SinusoidalSea(amplitude=0.3, wavelength=2.5, phase=0.4).mesh(0.0, 8.0, 0.25)
    surface = arrays.surface_arrays(mesh, "vertex")
    target = forced_link(mt.Link()).targets[0]._replace(reach=2.0)
    return mesh, surface, arrays.locator(surface, [target])


def paths(n, box, seed):
    """Return straight paths between random points near the surface, some of them vertical."""
    rng = np.random.default_rng(seed)
    start, end = rng.uniform(-1.0, 1.0, (2, n, 3)) * (box, box, 1.5)
    end[: n // 10, :2] = start[: n // 10, :2]
    end[n // 10 : n // 5, 2] = start[n // 10 : n // 5, 2]
    way = end - start
    length = np.linalg.norm(way, axis=1)
    return start, way / length[:, None], length


def blocked(intersector, start, direction, length):
    """Return the paths that meet the surface, a hair off their ends."""
    hair = 1e-4 * (1.0 + length)
    hits = intersector.intersect(start + hair[:, None] * direction, direction)
    return hits.distance < length - 3.0 * hair


@pytest.mark.parametrize("intersector", [mt.BruteForceIntersector, mt.EmbreeIntersector])
def test_the_walk_finds_what_rays_find(steep, intersector):
    mesh, surface, grid = steep
    n = 500 if intersector is mt.BruteForceIntersector else 20_000
    start, direction, length = paths(n, 3.0, 5)
    cut = ~free(start, direction, length, surface, grid)
    expected = blocked(intersector(mesh), start, direction, length)
    # single precision decides otherwise only at an edge or at an end
    allowed = 0 if intersector is mt.BruteForceIntersector else 2
    assert np.count_nonzero(cut != expected) <= allowed
    assert 0.2 < expected.mean() < 0.8


def test_paths_beside_the_bins_meet_all_facets(steep):
    mesh, surface, grid = steep
    start, direction, length = paths(2000, 8.0, 6)
    found = free(start, direction, length, surface, grid)
    expected = blocked(mt.EmbreeIntersector(mesh), start, direction, length)
    low, high = surface.low[2], surface.high[2]
    ends = np.stack([start, start + length[:, None] * direction])
    inside = (ends[..., :2] > (grid.x, grid.y)).all(axis=(0, 2))
    top = grid.x + grid.nx * grid.step, grid.y + grid.ny * grid.step
    inside &= (ends[..., :2] < top).all(axis=(0, 2))
    assert 0.2 < expected[~inside].mean() < 0.8
    assert np.count_nonzero(found == expected) <= 2
    away = (ends[..., 2] > high).all(axis=0) | (ends[..., 2] < low).all(axis=0)
    assert found[away].all()


def test_a_path_that_ends_on_the_surface_is_free(steep):
    mesh, surface, grid = steep
    below = mesh.vertices[mesh.faces].mean(axis=1)
    below = below[(np.abs(below[:, :2]) < 2.0).all(axis=1)]
    start = below - (0.0, 0.0, 1.0)
    up = np.tile([0.0, 0.0, 1.0], (len(below), 1))
    for length, expected in ((1.0, True), (1.0 + 1e-2, False), (math.pi, False)):
        assert (free(start, up, np.full(len(below), length), surface, grid) == expected).all()
