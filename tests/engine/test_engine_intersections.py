"""The whole engine on Embree and on brute force; beams aimed at vertices."""

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.engine.photons import analog
from meshtrace.results import Fate
from meshtrace.surfaces import JonswapSea

SEA = JonswapSea(wind_speed=13.0, seed=7, waves="paper")


@pytest.mark.parametrize("normals", ["vertex", "facet"])
def test_engine_gives_the_same_on_brute_force(normals):
    """Same photons, same random numbers: only a ray within rounding of an edge may differ."""
    mesh = SEA.mesh(extent=7.0, spacing=1.0)
    link = mt.Link(
        water=mt.Water(a=0.05, b=0.2, phase=mt.HenyeyGreenstein(g=0.8), bottom_depth=6.0),
        transmitter=mt.Led(depth=3.0, half_angle_deg=30.0),
        receiver=mt.Receiver(height=3.0, radius=1.0),
    )
    fast, slow = (
        analog.run_analog(link, intersector, photons=10_000, seed=3, normals=normals)
        for intersector in (mt.EmbreeIntersector(mesh), mt.BruteForceIntersector(mesh))
    )
    assert fast.score[0] > 100.0
    np.testing.assert_allclose(fast.score, slow.score, rtol=1e-3)
    np.testing.assert_allclose(fast.ledger.value(), slow.ledger.value(), atol=2.0)
    assert np.abs(fast.count - slow.count).sum() <= 4


@pytest.mark.parametrize("normals", ["vertex", "facet"])
@pytest.mark.parametrize("spacing", [0.25, 1.0])
def test_beams_aimed_at_vertices_do_not_leak(normals, spacing):
    """Parallel beams straight up under many vertices; every ray aims at one exactly."""
    mesh = SEA.mesh(extent=30.0, spacing=spacing)
    rng = np.random.default_rng(1)
    inner = np.flatnonzero((np.abs(mesh.vertices[:, :2]) < 25.0).all(axis=1))
    beams = tuple(
        mt.TopHatBeam(position=(float(x), float(y)), depth=4.0, divergence_deg=0.0)
        for x, y in mesh.vertices[rng.choice(inner, 200, replace=False), :2]
    )
    link = mt.Link(water=mt.Water(a=0.1, b=0.0), transmitter=beams)
    r = mt.simulate(link, mesh, estimator="analog", photons=8192, normals=normals)
    assert r.rays_recast <= 0.05 * r.photons
    assert r.rays_lost == 0
    assert r.fates[Fate.LEAKED.name.lower()].weight == 0.0
    # straight up: 2 to 4 % are reflected at these slopes
    left = r.fates["landed"].weight + r.fates["received"].weight
    assert left == pytest.approx(np.exp(-0.1 * 4.0) * 0.979, rel=0.05)


def test_rays_cast_again_are_counted_and_reported():
    """A slit in the mesh is met as a miss, cast again, given up and reported."""
    whole = SEA.mesh(extent=5.0, spacing=0.5)
    center = whole.vertices[whole.faces].mean(axis=1)
    keep = ~((np.abs(center[:, 0]) < 0.5) & (np.abs(center[:, 1]) < 0.5))
    holed = mt.TriangleMesh(whole.vertices, whole.faces[keep], whole.vertex_normals)
    link = mt.Link(
        water=mt.Water(a=0.1, b=0.0), transmitter=mt.TopHatBeam(depth=4.0, divergence_deg=0.0)
    )
    with pytest.warns(mt.DomainWarning, match="holes"):
        r = mt.simulate(link, holed, estimator="analog", photons=4096)
    assert (r.rays_recast, r.rays_lost) == (3 * 4096, 4096)
    assert r.fates["leaked"].photons == 4096
    # what is left of the weight at the hole: nothing was lost on the way
    assert sum(f.weight for f in r.fates.values()) == pytest.approx(1.0, abs=1e-12)
