"""Surfaces, paths and maps reach pyvista and ParaView with every number intact."""

import numpy as np
import pytest
import pyvista as pv
import trimesh
from PIL import Image

import meshtrace as mt
from meshtrace import Vertex, viz
from meshtrace.surfaces import FlatSea, SinusoidalSea
from meshtrace.viz import Stage, export

SEA = SinusoidalSea(amplitude=0.3, wavelength=6.0)


@pytest.fixture(scope="module")
def mesh():
    return SEA.mesh(extent=4.0, spacing=0.2)


@pytest.fixture(scope="module")
def paths():
    nan = np.nan
    return mt.PhotonPaths(
        vertex=np.array(
            [
                [[0, 0, -5], [0, 0, -1], [0.5, 0, 0], [1, 0, 3]],
                [[0, 0, -5], [2, 0, -3], [nan] * 3, [nan] * 3],
            ],
            dtype=float,
        ),
        weight=np.array([[1.0, 0.8, 0.7, 0.7], [1.0, 0.5, nan, nan]]),
        what=np.array([[0, 1, 2, 5], [0, 7, -1, -1]], np.int8),
        photon=np.array([3, 8]),
    )


@pytest.fixture(scope="module")
def coverage():
    axis = np.array([-1.0, 0.0, 1.0])
    gain = np.arange(6.0).reshape(3, 2)
    link = mt.Link(receiver=mt.Receiver(height=7.0)).model_dump(mode="json")
    return mt.CoverageMap(axis, axis[:2], gain, 0.1 * gain, {"link": link})


def test_surface_keeps_points_and_exact_slopes(mesh):
    data = viz.to_pyvista(mesh)
    np.testing.assert_array_equal(data.points, mesh.vertices)
    np.testing.assert_array_equal(data.regular_faces, mesh.faces)
    slope_x, slope_y = SEA.slopes(*mesh.vertices[:, :2].T)
    np.testing.assert_allclose(data["slope_x"], slope_x, atol=1e-12)
    np.testing.assert_allclose(data["slope_y"], slope_y, atol=1e-12)
    np.testing.assert_allclose(data["slope"], np.hypot(slope_x, slope_y), atol=1e-12)


def test_surface_is_a_copy(mesh):
    before = mesh.vertices.copy()
    viz.to_pyvista(mesh).points[:] = 0.0
    np.testing.assert_array_equal(mesh.vertices, before)


def test_paths_keep_what_happened(paths):
    data = viz.to_pyvista(paths)
    assert data.n_lines == 2
    assert data.n_points == 6
    np.testing.assert_array_equal(data["what"], [0, 1, 2, 5, 0, 7])
    np.testing.assert_array_equal(data["weight"], [1.0, 0.8, 0.7, 0.7, 1.0, 0.5])
    np.testing.assert_array_equal(data.cell_data["final"], [Vertex.RECEIVED, Vertex.END])
    np.testing.assert_array_equal(data.cell_data["photon"], [3, 8])


def test_map_lies_where_the_receiver_is(coverage):
    data = viz.to_pyvista(coverage)
    centers = data.cell_centers().points
    assert set(centers[:, 2]) == {7.0}
    for i, x in enumerate(coverage.x):
        for j, y in enumerate(coverage.y):
            cell = data.find_containing_cell((x, y, 7.0))
            assert data.cell_data["gain"][cell] == coverage.gain[i, j]


@pytest.mark.parametrize("what", ["mesh.vtp", "mesh.vtu", "mesh.ply", "paths.vtp", "paths.vtu"])
def test_files_read_back(what, tmp_path, mesh, paths):
    source = mesh if what.startswith("mesh") else paths
    data = pv.read(viz.save_vtk(source, tmp_path / what))
    shown = viz.to_pyvista(source)
    assert data.n_cells == shown.n_cells
    np.testing.assert_allclose(data.points, shown.points, atol=1e-5)
    if not what.endswith("ply"):
        for name in shown.array_names:
            np.testing.assert_array_equal(data[name], shown[name])


def test_map_reads_back(tmp_path, coverage):
    data = pv.read(viz.save_vtk(coverage, tmp_path / "map.vti"))
    np.testing.assert_array_equal(data["gain"], coverage.gain.ravel(order="F"))


def test_unsuitable_files_are_refused(tmp_path, mesh, paths, coverage):
    for source, name in ((mesh, "a.vti"), (paths, "a.stl"), (coverage, "a.vtp")):
        with pytest.raises(ValueError, match=r"path: .*allowed: a file name in"):
            viz.save_vtk(source, tmp_path / name)
    with pytest.raises(ValueError, match="source: 3, allowed: a TriangleMesh or a PhotonPaths"):
        viz.to_pyvista(3)


def test_sampler_interpolates_in_the_facets(mesh):
    vertex = mesh.vertices[57]
    sample = export.surface_sampler(mesh)
    np.testing.assert_allclose(sample(vertex[None, :2]), vertex[2], atol=1e-6)
    middle = mesh.vertices[mesh.faces[100]].mean(axis=0)
    np.testing.assert_allclose(sample(middle[None, :2]), middle[2], atol=1e-6)
    assert export.surface_sampler(FlatSea().mesh(extent=1.0, spacing=0.5))([[9.0, 9.0]]) == 0.0


def test_pictures_stay_within_a_size(tmp_path):
    plotter = pv.Plotter(off_screen=True, window_size=[300, 200])
    plotter.add_mesh(pv.Sphere(), scalars=np.arange(842.0))
    large = viz.save_picture(plotter, tmp_path / "large.png")
    small = viz.save_picture(plotter, tmp_path / "small.png", largest=large.stat().st_size - 1)
    plotter.close()
    assert small.stat().st_size < large.stat().st_size <= 400_000


def test_a_palette_keeps_gradients_smooth_and_rare_colours():
    """No dots: equal colours stay equal; a gradient of 200 steps keeps most, a key its colours."""
    shade = np.linspace(0.0, 1.0, 200)[:, None, None] * (40, 110, 160)
    image = np.broadcast_to(shade, (200, 400, 3)).astype(np.uint8).copy()
    rng = np.random.default_rng(1)
    image[:50, :200] = rng.integers(0, 120, (50, 200, 3))
    image[190:194, 4:8] = (255, 176, 46)
    made = np.asarray(export._in_palette(Image.fromarray(image)).convert("RGB")).astype(int)
    assert (np.ptp(made[60:180, 200:], axis=1) == 0).all()
    assert len(np.unique(made[60:, 300], axis=0)) > 30
    assert np.abs(made[192, 5] - (255, 176, 46)).max() < 8


@pytest.fixture(scope="module")
def drawn(paths):
    """Return a scene with a surface, a body, a receiver and paths."""
    corners = [(0.0, 0.0, -3.0), (1.0, 0.0, -3.0), (1.0, 1.0, -3.0)]
    wall = mt.Body(mt.TriangleMesh(corners, [(0, 1, 2)], overhangs=True), reflection="mirror")
    style = viz.SceneStyle(off_screen=True, spacing=1.0, labels=False, window_size=(64, 64))
    plotter = viz.scene(mt.Link(objects=(wall,)), FlatSea(), received=paths, style=style)
    yield plotter
    plotter.close()


@pytest.mark.parametrize("suffix", ["glb", "gltf", "obj"])
def test_a_scene_in_one_file_keeps_places_and_colours(drawn, suffix, tmp_path):
    files = viz.export_scene(drawn, tmp_path / f"scene.{suffix}")
    assert sorted(files) == sorted(tmp_path.iterdir())
    parts = trimesh.load_scene(files[0]).geometry
    assert set(parts) == {
        "surface",
        "body_1",
        "receiver_1",
        "paths_received",
        "paths_ended_in_the_water",
    }
    x, y, z = (parts["body_1"].vertices @ [[1, 0, 0], [0, 0, 1], [0, -1, 0]]).T  # y up to z up
    np.testing.assert_allclose([x.max(), y.max(), z.max(), z.min()], [1.0, 1.0, -3.0, -3.0])
    aperture = parts["receiver_1"]
    assert aperture.area == pytest.approx(np.pi * 0.05**2, rel=0.01)
    assert aperture.vertices[:, 1] == pytest.approx(5.0)
    low, high = parts["paths_received"].bounds[:, 1]
    assert (low, high) == pytest.approx((-5.0, 3.0), abs=0.02)
    material = parts["body_1"].visual.material
    color = material.diffuse if suffix == "obj" else material.baseColorFactor
    np.testing.assert_allclose(color[:3], [0xDD, 0xE5, 0xEC], atol=1)


def test_a_scene_in_a_folder_has_its_receivers(drawn, tmp_path):
    names = {path.name for path in viz.export_scene(drawn, tmp_path / "vtk")}
    assert names == {"surface.vtp", "body_1.vtp", "receiver_1.vtp", "paths.vtp"}


def test_pictures_without_background_keep_their_colours(tmp_path):
    """Half clear orange is orange with an alpha of one half, not darkened by what is behind it."""
    stage = Stage((0.0, 0.0), 1.0, -1.0, 1.0)
    plotter = viz.ScenePlotter(stage, off_screen=True, window_size=(80, 60), transparent=True)
    plotter.add_mesh(pv.Sphere(), color="#FF8000", opacity=0.5, lighting=False, culling="back")
    export.save_screenshot(plotter, tmp_path / "a.png")
    plotter.close()
    pixels = np.asarray(Image.open(tmp_path / "a.png"))
    assert pixels.shape == (60, 80, 4)
    assert pixels[0, 0, 3] == 0
    np.testing.assert_allclose(pixels[27, 37], [255, 128, 0, 128], atol=3)
