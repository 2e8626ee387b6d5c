"""The leaning wave against its closed forms, and refusals of overhanging meshes."""

import math

import numpy as np
import pytest
from leaning import LeaningWave

from meshtrace import TriangleMesh
from meshtrace.errors import Refused
from meshtrace.mesh import vertex_normals
from meshtrace.surfaces import SinusoidalSea, from_trimesh, sea_from_config

WAVE = LeaningWave(amplitude=0.3, wavelength=4.0, lean=0.9)


def test_reference_values():
    expected = [(0.250112, 1.018198, 0.277144), (0.749888, 0.881802, 0.114854)]
    np.testing.assert_allclose(WAVE.folds, expected, atol=1e-6)
    assert WAVE.overlap == pytest.approx(0.13639614, abs=1e-8)
    assert WAVE.overlap / WAVE.wavelength == pytest.approx(0.034099, abs=1e-6)
    assert 1.0 / WAVE.wavenumber == pytest.approx(0.63661977, abs=1e-8)


@pytest.mark.parametrize(("lean", "single_valued"), [(0.0, True), (0.63, True), (0.64, False)])
def test_it_overhangs_from_the_critical_lean_on(lean, single_valued):
    wave = LeaningWave(amplitude=0.3, wavelength=4.0, lean=lean)
    assert wave.single_valued == single_valued
    assert wave.mesh(extent=4.0, spacing=0.01).single_valued == single_valued
    assert len(wave.folds) == (0 if single_valued else 2)


def test_folds_are_where_the_curve_turns():
    s = np.linspace(0.0, 1.0, 100_001)
    x = WAVE.profile(s)[0]
    turns = s[1:-1][np.sign(np.diff(x)[1:]) != np.sign(np.diff(x)[:-1])]
    np.testing.assert_allclose(turns, WAVE.folds[:, 0], atol=2e-5)


def test_normals_are_upright_on_the_curve():
    mesh = WAVE.mesh(extent=3.0, spacing=0.01)
    face = mesh.face_normals
    corners = mesh.vertex_normals[mesh.faces]
    assert np.einsum("ik,ijk->ij", face, corners).min() > 0.99
    assert mesh.max_slope == math.inf
    assert (mesh.bounds[0, :2] <= -3.0).all()
    assert (mesh.bounds[1, :2] >= 3.0).all()


def test_a_gentle_lean_has_elevation_and_slopes():
    wave = LeaningWave(amplitude=0.3, wavelength=4.0, lean=0.5)
    s = np.linspace(-5.0, 5.0, 401)
    x, z = wave.profile(s)
    np.testing.assert_allclose(wave.elevation(x, 0.0), z, atol=1e-13)
    h = 1e-6
    slope = (wave.elevation(x + h, 0.0) - wave.elevation(x - h, 0.0)) / (2.0 * h)
    np.testing.assert_allclose(wave.slopes(x, 0.0)[0], slope, atol=1e-6)
    upright = LeaningWave(amplitude=0.3, wavelength=4.0, lean=0.0)
    cosine = SinusoidalSea(amplitude=0.3, wavelength=4.0)
    np.testing.assert_allclose(upright.elevation(s, 0.0), cosine.elevation(s, 0.0), atol=1e-14)


def test_an_overhanging_wave_has_no_elevation():
    with pytest.raises(Refused, match=r"lean: 0.9, allowed: lean < 0.6366 m"):
        WAVE.elevation(0.0, 0.0)


def test_plain_data():
    assert sea_from_config(WAVE.to_config()) == WAVE


@pytest.mark.parametrize("key", ["amplitude", "wavelength", "lean"])
def test_refuses_parameters(key):
    with pytest.raises(Refused, match=key):
        LeaningWave(**{"amplitude": 0.3, "wavelength": 4.0, "lean": 0.9, key: -1.0})


def small():
    mesh = WAVE.mesh(extent=3.0, spacing=0.2)
    return mesh.vertices, np.array(mesh.faces)


def flipped():
    vertices, faces = small()
    faces[5:7] = faces[5:7, ::-1]
    return vertices, faces


def spiral():
    angle = np.linspace(0.0, 2.6 * math.pi, 48)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    z = np.linspace(0.0, 2.0, 48)[:, None]
    i = np.arange(47)
    faces = [np.stack([i, i + 48, i + 49], 1), np.stack([i, i + 49, i + 1], 1)]
    vertices = np.concatenate([np.hstack([ring, z]), np.hstack([2.0 * ring, z])])
    return vertices, np.concatenate(faces)


REFUSED = {
    "flipped winding": (flipped, "edges between facets of opposite winding"),
    "turned over": (lambda: (small()[0], small()[1][:, ::-1]), "turned over"),
    "self-crossing outline": (spiral, "outline meets itself"),
    "two pieces": (
        lambda: (
            np.concatenate([small()[0], small()[0] + [0.0, 0.0, 2.0]]),
            np.concatenate([small()[1], small()[1] + len(small()[0])]),
        ),
        "2 separate pieces",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refuses_meshes(name):
    make, message = REFUSED[name]
    with pytest.raises(Refused, match=message):
        from_trimesh(make(), overhangs=True)


def test_triangle_mesh_takes_overhangs_only_if_allowed():
    vertices, faces = small()
    with pytest.raises(Refused, match="facets do not face up"):
        TriangleMesh(vertices, faces)
    assert not TriangleMesh(vertices, faces, overhangs=True).single_valued
    with pytest.raises(Refused, match="1 facets without area"):
        TriangleMesh(vertices, [[0, 1, 1]], overhangs=True)


def test_angle_weights_do_not_depend_on_the_triangulation():
    """A pyramid on a square: its apex and corners, with either diagonal in every quarter."""
    x, y = np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), 0.3 * x.ravel() + 0.1 * x.ravel() ** 2], axis=1)
    quads = [(0, 3, 4, 1), (1, 4, 5, 2), (3, 6, 7, 4), (4, 7, 8, 5)]
    one = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    other = np.array([t for a, b, c, d in quads for t in ((a, b, d), (b, c, d))])
    angle = [vertex_normals(vertices, faces, "angle") for faces in (one, other)]
    np.testing.assert_allclose(*angle, atol=1e-14)
    area = [vertex_normals(vertices, faces, "area") for faces in (one, other)]
    assert np.abs(area[0] - area[1]).max() > 1e-3
