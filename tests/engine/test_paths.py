"""Photon paths: received ones obey refraction and hit the aperture; analog ones are complete."""

import numpy as np
import pytest

import meshtrace as mt
from meshtrace import Vertex
from meshtrace.engine import paths, simulate
from meshtrace.optics.fresnel import refract
from meshtrace.surfaces import FlatSea, JonswapSea

LINK = mt.Link(
    water=mt.Water(b=0.1),
    receiver=mt.Receiver(radius=0.2, position=(0.5, -0.2), tilt_deg=10.0, tilt_azimuth_deg=30.0),
)
MESH = JonswapSea(wind_speed=13.0, seed=3, mss="band", waves="paper").mesh(extent=12.0, spacing=0.2)


def normals_at(mesh, points, kind):
    up = np.column_stack([points[:, :2], np.full(len(points), 5.0)])
    hits = mt.BruteForceIntersector(mesh).intersect(up, np.broadcast_to((0, 0, -1.0), up.shape))
    assert (hits.facet >= 0).all()
    np.testing.assert_allclose(5.0 - hits.distance, points[:, 2], atol=1e-9)
    if kind == "facet":
        return mesh.face_normals[hits.facet]
    weight = np.stack([1 - hits.u - hits.v, hits.u, hits.v], axis=1)
    normal = (weight[..., None] * mesh.vertex_normals[mesh.faces[hits.facet]]).sum(1)
    return normal / np.linalg.norm(normal, axis=1)[:, None]


def direction(a, b):
    d = b - a
    return d / np.linalg.norm(d, axis=1)[:, None]


@pytest.mark.parametrize("normals", ["vertex", "facet"])
def test_received_paths_obey_snell_and_hit_the_aperture(normals):
    paths = mt.trace_paths(LINK, MESH, 400, received_only=True, normals=normals, seed=2)
    assert len(paths.vertex) == 400
    assert paths.received.all()
    last = paths.length - 1
    i = np.arange(400)
    end, cross, before = (paths.vertex[i, last - k] for k in range(3))
    assert (paths.what[i, last - 1] == Vertex.SURFACE_OUT).all()
    assert (paths.what[:, 0] == Vertex.SOURCE).all()
    np.testing.assert_array_equal(paths.vertex[:, 0], np.broadcast_to((0, 0, -10.0), (400, 3)))
    n = normals_at(MESH, cross, normals)
    bent = refract(direction(before, cross), n, 1.33, 1.0)
    # the root is good to some 1e-6 m on the aperture
    np.testing.assert_allclose(bent, direction(cross, end), atol=2e-6)
    rx = LINK.receiver
    off = end - np.array(rx.center)
    assert (np.linalg.norm(off, axis=1) <= rx.radius * (1 + 1e-9)).all()
    np.testing.assert_allclose(off @ np.array(rx.axis), 0.0, atol=1e-12)
    assert (bent @ np.array(rx.axis) >= np.cos(np.radians(rx.fov_deg / 2)) - 1e-6).all()


def test_received_paths_share_the_gain_and_its_orders():
    r = mt.simulate(LINK, MESH, photons=8192, seed=3)
    paths = mt.trace_paths(LINK, MESH, 6000, received_only=True, seed=4)
    weight = paths.weight[:, 0]
    assert np.ptp(weight) <= 1e-12 * weight[0]
    assert weight.sum() == pytest.approx(r.gain, rel=0.03)
    scatterings = paths.length - 3
    share = np.bincount(scatterings, minlength=8)[:4] / len(scatterings)
    expected = np.append(r.gain_ballistic, r.gain_order[0, :3]) / r.gain
    np.testing.assert_allclose(share, expected, atol=0.03)
    # the landing points fill the aperture evenly: the mean lies at its centre
    last = paths.length - 1
    off = paths.vertex[np.arange(len(last)), last] - np.array(LINK.receiver.center)
    assert np.abs(off.mean(axis=0)).max() < 0.02


def test_received_paths_stay_in_the_water_until_they_cross():
    paths = mt.trace_paths(LINK, MESH, 500, received_only=True, seed=5)
    inner = paths.what == Vertex.SCATTER
    points = paths.vertex[inner]
    assert len(points) > 100
    up = np.column_stack([points[:, :2], np.full(len(points), 5.0)])
    hits = mt.BruteForceIntersector(MESH).intersect(up, np.broadcast_to((0, 0, -1.0), up.shape))
    over = np.isfinite(hits.distance)
    assert (points[over, 2] < 5.0 - hits.distance[over]).all()


def test_received_paths_are_reproducible():
    a, b = (mt.trace_paths(LINK, MESH, 50, received_only=True, seed=6) for _ in range(2))
    np.testing.assert_array_equal(a.vertex, b.vertex)
    c = mt.trace_paths(LINK, MESH, 50, received_only=True, seed=7)
    assert a.vertex.shape != c.vertex.shape or not np.array_equal(a.vertex, c.vertex)


@pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")
def test_received_paths_need_the_surface_that_received_light_crosses(monkeypatch):
    """A mesh of all that photons may cross took most of a frame of a movie."""
    facets, placed, place = [], [], paths._placed
    mesh_for = simulate.mesh_for

    def meshed(*arguments):
        mesh, config = mesh_for(*arguments)
        facets.append(len(mesh.faces))
        return mesh, config

    monkeypatch.setattr(simulate, "mesh_for", meshed)
    monkeypatch.setattr(paths, "_placed", lambda *a: placed.append(len(a[1])) or place(*a))
    sea = JonswapSea(wind_speed=5.0, seed=7)
    mt.trace_paths(mt.Link(), sea, n=50, received_only=True)
    mt.trace_paths(mt.Link(), sea, n=50)
    assert facets[0] < 0.5 * facets[1]
    assert sum(placed) == 50


def test_analog_paths_are_connected_and_end():
    paths = mt.trace_paths(LINK, MESH, 300, seed=8)
    assert (paths.length >= 2).all()
    assert set(np.unique(paths.photon)) <= set(range(300))
    used = paths.what >= 0
    assert np.isfinite(paths.vertex[used]).all()
    assert np.isnan(paths.vertex[~used]).all()
    out = paths.what == Vertex.SURFACE_OUT
    rows, steps = np.nonzero(out[:, :-1])
    assert len(rows) > 50
    cross, after = paths.vertex[rows, steps], paths.vertex[rows, steps + 1]
    ends = np.isnan(after[:, 2])  # all of it was sent back: goes on as a path of its own
    assert ends.mean() < 0.1
    assert (after[~ends, 2] > cross[~ends, 2]).mean() > 0.95
    np.testing.assert_allclose(after[after[:, 2] > 2.0, 2], 5.0, atol=0.2)
    points, cells = paths.polylines()
    assert len(points) == used.sum()
    assert len(cells) == used.sum() + len(paths.vertex)
    assert paths.to_dataset()["what"].attrs["flag_meanings"].split()[Vertex.BRANCH] == "branch"


def test_nothing_to_receive_is_said():
    """A receiver that looks away from all light has no paths: a clear error or none, no crash."""
    link = mt.Link(receiver=mt.Receiver(tilt_deg=80.0, fov_deg=5.0))
    try:
        paths = mt.trace_paths(link, FlatSea(), 10, received_only=True, extent=8.0, spacing=0.5)
    except ValueError as error:
        assert "receive" in str(error), error
    else:
        assert len(paths.vertex) == 0


@pytest.mark.parametrize("n", [0, -1, 100_001])
def test_number_of_paths_is_checked(n):
    with pytest.raises(ValueError, match="n:"):
        mt.trace_paths(LINK, MESH, n)


def test_received_paths_where_the_gain_rests_on_joined_photons():
    """No chains were drawn for such a receiver: its light was refused as none."""
    link = mt.Link(receiver=mt.Receiver(tilt_deg=40.0))
    paths = mt.trace_paths(link, FlatSea(), 20, received_only=True, seed=1)
    assert paths.received.all()
    assert (paths.length >= 4).all()  # scattered once at least


def test_options_of_analog_photons_hold_for_their_paths():
    short = mt.trace_paths(LINK, MESH, 60, seed=8, max_events=1)
    long = mt.trace_paths(LINK, MESH, 60, seed=8)
    assert (short.what == mt.Vertex.SCATTER).sum(axis=1).max() <= 1
    assert (long.what == mt.Vertex.SCATTER).sum(axis=1).max() > 1
    with pytest.raises(mt.Refused, match="max_events"):
        mt.trace_paths(LINK, MESH, 60, seed=8, max_events=0)
    with pytest.raises(mt.Refused, match="max_events"):
        mt.trace_paths(LINK, MESH, 60, received_only=True, max_events=1)
