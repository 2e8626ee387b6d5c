"""Without embreex and finufft: rays walk over bins, waves are summed directly, to the same light."""

import sys
from contextlib import contextmanager
from weakref import WeakKeyDictionary

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.engine import bvh
from meshtrace.mesh import TriangleMesh
from meshtrace.results import provenance
from meshtrace.surfaces import JonswapSea, waves

SEA = JonswapSea(wind_speed=13.0, seed=7, waves="paper")


WALK = "embreex is not installed: rays walk over bins"
DIRECT = "finufft is not installed: many waves are summed directly"
CACHES = bvh.library, bvh._tell_walk, waves._has_finufft


@contextmanager
def packages_absent(monkeypatch):
    """Take both packages away, as on Linux on ARM."""
    with monkeypatch.context() as patch:
        for name in ("embreex", "embreex.rtcore", "embreex.mesh_construction", "finufft"):
            patch.setitem(sys.modules, name, None)
        for cached in CACHES:
            cached.cache_clear()
        yield
    for cached in CACHES:
        cached.cache_clear()


def rays(mesh, n, rng):
    """Return rays of all slants, level and vertical ones included, in single precision."""
    low, high = mesh.bounds
    origins = rng.uniform(low - 1.0, high + 1.0, (n, 3))
    directions = rng.normal(size=(n, 3))
    directions[: n // 4, :2] = 0.0
    directions[n // 4 : n // 2, 2] = 0.0
    directions[n // 2 : 5 * n // 8, 0] = 0.0
    return origins.astype(np.float32), directions.astype(np.float32)


def plunging(mesh):
    """Return the mesh with its crests carried forward, so that it overhangs."""
    bent = mesh.vertices.copy()
    bent[:, 0] += 8.0 * np.maximum(bent[:, 2], 0.0) ** 2
    return TriangleMesh(bent, mesh.faces, overhangs=True)


@pytest.mark.parametrize("overhangs", [False, True])
def test_a_walk_finds_the_facets_of_embree(overhangs, rng):
    mesh = SEA.mesh(extent=12.0, spacing=0.5)
    if overhangs:
        mesh = plunging(mesh)
        assert not mesh.single_valued
    origins, directions = rays(mesh, 20_000, rng)
    walked = bvh.WalkedScene(mesh.vertices, mesh.faces).run(origins, directions)
    embree = bvh.CopiedScene(mesh.vertices, mesh.faces).run(origins, directions)
    assert len(np.unique(embree)) > 2000
    other = np.flatnonzero(walked != embree)
    assert len(other) < 20
    # where single precision chose the neighbour, both lie at the same distance
    for facets in (walked[other], embree[other]):
        assert (facets >= 0).all()
    apart = mesh.vertices[mesh.faces[walked[other]]].mean(axis=1)
    apart -= mesh.vertices[mesh.faces[embree[other]]].mean(axis=1)
    assert np.linalg.norm(apart, axis=1).max(initial=0.0) < 1.0


def test_no_ray_slips_through_an_edge_or_a_vertex():
    """Upright rays at all vertices and the middles of all edges of a level sheet."""
    mesh = mt.surfaces.FlatSea().mesh(extent=2.0, spacing=0.25)
    inner = (np.abs(mesh.vertices[:, :2]) < 1.9).all(axis=1)
    places = [mesh.vertices[inner]]
    for edge in ((0, 1), (1, 2), (2, 0)):
        middle = mesh.vertices[mesh.faces[:, edge]].mean(axis=1)
        places.append(middle[(np.abs(middle[:, :2]) < 1.9).all(axis=1)])
    origins = (np.concatenate(places) - [0.0, 0.0, 1.0]).astype(np.float32)
    directions = np.tile(np.float32([0.0, 0.0, 1.0]), (len(origins), 1))
    assert (bvh.WalkedScene(mesh.vertices, mesh.faces).run(origins, directions) >= 0).all()


def test_the_light_is_that_of_embree(monkeypatch):
    link = mt.Link(transmitter=mt.Led(depth=2.0), receiver=mt.Receiver(radius=5.0, fov_deg=180.0))
    mesh = SEA.mesh(extent=20.0, spacing=0.5)
    embree = mt.simulate(link, mesh, "analog", photons=4096)
    monkeypatch.setattr(bvh, "_SCENES", WeakKeyDictionary())
    with packages_absent(monkeypatch), pytest.warns(UserWarning, match=WALK):
        walked = mt.simulate(link, mesh, "analog", photons=4096)
    assert embree.gain > 0.0
    assert walked.gain == pytest.approx(embree.gain, rel=1e-9)


def test_waves_are_summed_directly(monkeypatch, rng):
    kx, ky = rng.normal(0.0, 2.0, (2, 4000))
    axis, weights = np.linspace(-5.0, 5.0, 201), rng.normal(size=(1, 4000)) + 0j
    fast = waves.WaveGrid(kx, ky, axis, axis)
    with packages_absent(monkeypatch), pytest.warns(UserWarning, match=DIRECT):
        direct = waves.WaveGrid(kx, ky, axis, axis)
    total = direct.sum(weights)
    assert fast._fast
    assert not direct._fast
    assert direct.seconds > fast.seconds
    scale = np.sqrt(np.square(np.abs(weights)).sum() / 2.0)
    assert np.abs(total - fast.sum(weights)).max() < 1e-5 * scale


def test_a_result_says_that_embree_was_absent():
    assert provenance._version("no-such-distribution") == "none"
