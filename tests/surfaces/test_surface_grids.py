import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from meshtrace.surfaces.triangulate import (
    DEFAULT_COARSENING,
    GROWTH,
    MAX_LINES,
    GridLines,
    grid_faces,
    triangulate,
)

modest = settings(max_examples=80, deadline=None, derandomize=True)
centers = st.floats(-100.0, 100.0)


@given(center=centers, extent=st.floats(0.01, 200.0), spacing=st.floats(0.01, 30.0))
@modest
def test_equally_spaced_lines(center, extent, spacing):
    assume(2 * extent / spacing < 5000)
    axis = GridLines(extent, spacing).axis(center)
    assert axis[0] == center - extent
    assert axis[-1] == center + extent
    steps = np.diff(axis)
    rounding = 4e-14 * (abs(center) + extent)
    assert (steps > 0.0).all()
    assert steps.max() <= spacing * (1 + 1e-11) + rounding
    assert np.ptp(steps) <= rounding
    assert len(axis) == max(1, math.ceil(2 * extent / spacing * (1 - 1e-12))) + 1


def test_equally_spaced_lines_meet_round_spacings():
    assert len(GridLines(20.0, 0.1).axis()) == 401
    assert len(GridLines(0.07, 0.005).axis()) == 29  # the quotient rounds to just above 28
    assert len(GridLines(0.3, 0.1).axis()) == 7
    np.testing.assert_allclose(np.diff(GridLines(1.0, 0.3).axis()), 2.0 / 7.0, rtol=1e-14)


@given(
    center=centers,
    fine_extent=st.floats(0.1, 20.0),
    ratio=st.floats(1.001, 20.0),
    spacing=st.floats(0.05, 1.0),
    coarsening=st.floats(1.0, 30.0),
)
@modest
def test_graded_lines(center, fine_extent, ratio, spacing, coarsening):
    extent, coarse_spacing = fine_extent * ratio, spacing * coarsening
    axis = GridLines(extent, spacing, fine_extent, coarse_spacing).axis(center)
    assert axis[0] == center - extent
    assert axis[-1] == center + extent
    rounding = 1e-13 * (abs(center) + extent)
    offsets = axis - center
    np.testing.assert_allclose(offsets, -offsets[::-1], atol=rounding)
    steps = np.diff(offsets[len(offsets) // 2 :])
    assert (np.diff(axis) > 0.0).all()
    assert np.abs(offsets - fine_extent).min() <= rounding
    fine = offsets[len(offsets) // 2 + 1 :] <= fine_extent + rounding
    assert steps[fine].max() <= spacing * (1 + 1e-9) + rounding
    assert steps.max() <= coarse_spacing * (1 + 1e-9) + rounding
    outer = steps[~fine]
    assert outer[0] <= spacing * GROWTH * (1 + 1e-9) + rounding
    assert (outer[1:] <= outer[:-1] * GROWTH * (1 + 1e-9) + 2 * rounding).all()


def test_graded_lines_are_fewer_and_degenerate_to_equally_spaced_ones():
    graded, uniform = GridLines(50.0, 0.1, 2.0, 2.0), GridLines(50.0, 0.1)
    assert len(graded.axis()) < 0.2 * len(uniform.axis())
    whole = GridLines(5.0, 0.1, 9.0, 1.0)
    np.testing.assert_array_equal(whole.axis(1.0), GridLines(5.0, 0.1).axis(1.0))


def test_default_of_the_coarse_spacing():
    given = GridLines(50.0, 0.1, 2.0, 0.1 * DEFAULT_COARSENING)
    np.testing.assert_array_equal(GridLines(50.0, 0.1, fine_extent=2.0).axis(), given.axis())


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: GridLines(-1.0, 0.1).axis(), "extent: -1.0, allowed: 0 < extent"),
        (lambda: GridLines(1.0, 0.0).axis(), "spacing: 0.0, allowed: 0 < spacing"),
        (lambda: GridLines(1.0, math.nan).axis(), "spacing: nan"),
        (lambda: GridLines(1.0, 0.1).axis(math.inf), "center: inf"),
        (lambda: GridLines(20.0, 1e-5).axis(), f"allowed: at most {MAX_LINES} grid lines"),
        (lambda: GridLines(9.0, 0.1, 0.0, 1.0).axis(), "fine_extent: 0.0"),
        (lambda: GridLines(9.0, 0.1, 1.0, 0.05).axis(), "coarse_spacing: 0.05, allowed: 0.1 <="),
        (
            lambda: GridLines(9.0, 0.1, coarse_spacing=1.0).axis(),
            "coarse_spacing: 1.0, allowed: only with",
        ),
    ],
)
def test_refuses_lines(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def plane(nx, ny, slope_x=0.3, slope_y=-0.2):
    x = np.cumsum(np.linspace(0.5, 1.5, nx))
    y = np.cumsum(np.linspace(1.0, 0.3, ny))
    z = slope_x * x[:, None] + slope_y * y
    return triangulate(x, y, z, np.full_like(z, slope_x), np.full_like(z, slope_y)), x, y


@given(nx=st.integers(2, 9), ny=st.integers(2, 9))
@modest
def test_triangulated_plane_faces_up_and_fills_its_rectangle(nx, ny):
    mesh, x, y = plane(nx, ny)
    assert mesh.vertices.shape == (nx * ny, 3)
    assert mesh.faces.shape == (2 * (nx - 1) * (ny - 1), 3)
    np.testing.assert_array_equal(mesh.vertices[:, 0], np.repeat(x, ny))
    np.testing.assert_array_equal(mesh.vertices[:, 1], np.tile(y, nx))
    normal = np.array([-0.3, 0.2, 1.0]) / math.sqrt(1.0 + 0.3**2 + 0.2**2)
    np.testing.assert_allclose(
        mesh.face_normals, np.broadcast_to(normal, mesh.faces.shape), atol=1e-13
    )
    np.testing.assert_allclose(
        mesh.vertex_normals, np.broadcast_to(normal, mesh.vertices.shape), atol=1e-15
    )
    a, b, c = (mesh.vertices[mesh.faces[:, i], :2] for i in range(3))
    u, v = b - a, c - a
    doubled = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    assert (doubled > 0.0).all()
    assert doubled.sum() / 2 == pytest.approx(np.ptp(x) * np.ptp(y), rel=1e-12)


def test_diagonals_alternate_so_that_the_mirror_image_is_the_same_mesh():
    nx, ny = 5, 7
    index = np.arange(nx * ny).reshape(nx, ny)
    mirrored = index[::-1][np.unravel_index(grid_faces(nx, ny), (nx, ny))]

    def cells(faces):
        return {tuple(sorted(face)) for face in faces.tolist()}

    assert cells(mirrored) == cells(grid_faces(nx, ny))
    diagonal = {tuple(sorted(f)) for f in grid_faces(3, 2).tolist()}
    assert diagonal == {(0, 2, 3), (0, 1, 3), (2, 3, 4), (3, 4, 5)}


def test_faces_are_shared_and_read_only():
    assert grid_faces(4, 5) is grid_faces(4, 5)
    assert grid_faces(4, 5).dtype == np.int32
    with pytest.raises(ValueError, match="read-only"):
        grid_faces(4, 5)[0, 0] = 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x_axis": [0.0, 0.0]}, "x_axis: shape"),
        ({"y_axis": [0.0]}, "y_axis: shape"),
        ({"z": np.zeros((3, 2))}, r"z: \(3, 2\), allowed: the shape \(2, 2\)"),
        ({"sy": np.zeros(4)}, r"sy: \(4,\), allowed: the shape \(2, 2\)"),
    ],
)
def test_triangulate_refuses(change, message):
    flat = np.zeros((2, 2))
    arguments = {"x_axis": [0.0, 1.0], "y_axis": [0.0, 1.0], "z": flat, "sx": flat, "sy": flat}
    with pytest.raises(ValueError, match=message):
        triangulate(**{**arguments, **change})
