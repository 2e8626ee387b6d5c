"""`meshtrace view`: windows, files and refusals."""

import json
import sys

import command_line
import imageio_ffmpeg
import numpy as np
import pytest
import pyvista as pv
from PIL import Image

import meshtrace as mt
from meshtrace.surfaces import JonswapSea

SEA = JonswapSea(wind_speed=5.0, seed=7)
COARSE = ["--paths", "0", "--spacing", "0.5"]


def view(*arguments):
    return command_line.meshtrace("view", *arguments)


def refusal(*arguments):
    return command_line.refusal("view", *arguments)


def written(*arguments):
    """Return the files that a command says it has written."""
    result = view(*arguments)
    assert result.exit_code == 0, result.stderr
    return [line.removeprefix("written to ") for line in result.stdout.splitlines()]


@pytest.fixture
def asked(monkeypatch):
    """Return the options with which a window would have been opened."""
    options = {}
    monkeypatch.setattr("meshtrace.viz.show.has_display", lambda: True)
    monkeypatch.setattr("meshtrace.viz.view", lambda **given: options.update(given) or [])
    return options


@pytest.mark.thorough
def test_the_default_link_as_picture_page_and_vtk_files(tmp_path):
    picture, page, folder = tmp_path / "a.png", tmp_path / "a.html", tmp_path / "vtk"
    names = written("--screenshot", picture, "--html", page, "--export", folder, *COARSE,
                    "--received", 12, "--map", 20_000)  # fmt: skip
    assert names == [
        str(path)
        for path in (
            picture,
            *(folder / f for f in ("surface.vtp", "received.vtp", "receiver_1.vtp", "map.vti")),
            page,
        )
    ]
    with Image.open(picture) as image:
        assert image.size == (1600, 1000)
    assert "<title>meshtrace</title>" in page.read_text()
    assert pv.read(folder / "received.vtp").n_lines == 12
    assert pv.read(folder / "map.vti")["gain"].max() > 0.0
    surface = pv.read(folder / "surface.vtp")
    np.testing.assert_allclose(
        surface["elevation"],
        mt.scenario.Scenario.from_toml("").surface.elevation(*surface.points[:, :2].T),
        atol=1e-5,
    )


def test_a_link_file_with_changes_at_a_time(tmp_path, asked):
    (tmp_path / "link.toml").write_text("wind_speed = 9.0\n[transmitter]\ndepth = 7.0\n")
    view(tmp_path / "link.toml", "--set", "receiver.height=8", "--time", "2.5", "--edges",
         "--color", "slope", "--paths", "7", "--size", "800x450", "--transparent",
         "--daylight", "overcast")  # fmt: skip
    assert asked["link"].transmitter.depth == 7.0
    assert asked["link"].receiver.height == 8.0
    assert asked["surface"].wind_speed == 9.0
    assert asked["title"] == "link.toml"
    style = asked["style"]
    assert (asked["time"], asked["paths"]) == (2.5, 7)
    assert (style.edges, style.color, style.window_size) == (True, "slope", (800, 450))
    assert style.transparent
    assert asked["daylight"].light == "overcast sky"


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj"])
def test_a_mesh(tmp_path, suffix):
    mesh = SEA.mesh(extent=3.0, spacing=0.25)
    mesh.to_trimesh().export(tmp_path / f"sea.{suffix}")
    folder = tmp_path / "vtk"
    names = written(tmp_path / f"sea.{suffix}", "--export", folder)
    assert names == [str(folder / "surface.vtp")]
    back = pv.read(names[0])
    assert back.n_cells == len(mesh.faces)
    np.testing.assert_allclose(back.bounds, mesh.bounds.T.ravel(), atol=1e-5)


def test_a_link_over_a_mesh(tmp_path, asked):
    SEA.mesh(extent=15.0, spacing=0.5).to_trimesh().export(tmp_path / "sea.ply")
    (tmp_path / "link.toml").write_text('[sea]\nmesh = "sea.ply"\n')
    view(tmp_path / "link.toml")
    assert isinstance(asked["surface"], mt.TriangleMesh)
    assert asked["link"] == mt.scenario.Scenario.from_toml("").link


def test_the_result_of_a_run(tmp_path, asked):
    link = mt.Link(transmitter=mt.Led(depth=6.0))
    mt.simulate(link, SEA, photons=256, time=1.5).save(tmp_path / "run.nc")
    view(tmp_path / "run.nc")
    assert (asked["link"], asked["surface"], asked["time"]) == (link, SEA, 1.5)


@pytest.mark.slow
def test_the_movie_of_a_series_has_its_times_and_gains(tmp_path, monkeypatch):
    series = mt.time_series(mt.Link(), SEA, [1.0, 1.5, 2.0], photons=64)
    series.save(tmp_path / "series.nc")
    monkeypatch.setattr("meshtrace.studies.series.time_series", None)
    name = tmp_path / "sea.mp4"
    options = ["--movie", name, "--spacing", 0.5, "--received", 1]
    assert written(tmp_path / "series.nc", *options) == [str(name)]
    about = imageio_ffmpeg.count_frames_and_secs(name)
    assert about == (3, pytest.approx(1.5, abs=0.01))


def test_an_ensemble_and_a_performance_are_shown_by_their_link(tmp_path, asked):
    link = mt.Link(receiver=mt.Receiver(height=4.0))
    mt.ensemble(link, 2, SEA, photons=64).save(tmp_path / "ensemble.nc")
    scenario = mt.scenario.Scenario.from_config({"receiver": {"height": 4.0}})
    performance = mt.link_performance(scenario, bit_rate=1e6, realizations=8)
    performance.save(tmp_path / "ber.nc")
    for name in ("ensemble.nc", "ber.nc"):
        asked.clear()
        view(tmp_path / name)
        assert asked["link"].receiver.height == 4.0
        assert asked.get("gain") is None


def test_a_coverage_map(tmp_path, asked):
    coverage = mt.coverage_map(mt.Link(), SEA, step=1.0, times=(2.0, 3.0), photons=4096)
    coverage.to_dataset().to_netcdf(tmp_path / "map.nc", engine="h5netcdf")
    view(tmp_path / "map.nc")
    np.testing.assert_array_equal(asked["coverage"].gain, coverage.gain)
    np.testing.assert_array_equal(asked["coverage"].x, coverage.x)
    assert asked["time"] == 2.0


@pytest.mark.parametrize("missing", ["pyvista", "trame_client", "matplotlib", "imageio"])
def test_a_missing_extra_is_a_hint(monkeypatch, missing):
    monkeypatch.delitem(sys.modules, "meshtrace.viz", raising=False)
    monkeypatch.setitem(sys.modules, missing, None)
    assert refusal() == f'viz: {missing} is not installed, allowed: pip install "meshtrace[viz]"'


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["gone.toml"], "gone.toml: No such file or directory, allowed: a TOML file"),
        (["gone.nc"], "gone.nc: no such file, allowed: a link file, result or mesh"),
        (["text.txt"], "text.txt: '.txt', allowed: a file name in .toml, .nc, .stl, .ply, .obj"),
        (["text.nc"], "text.nc: "),
        (["other.nc"], "allowed: results of kind gain, wavelengths, impulse-response, series"),
        (["text.stl"], "text.stl: sea.mesh.source: empty, allowed: a surface of one or more"),
        (["--set", "receiver.radius=-1"], "receiver.radius: -1"),
        (["sea.ply", "--set", "wind_speed=3"], "--set: 'wind_speed=3', allowed: with a link file"),
        (["sea.ply", "--threads", "2"], "--threads: '2', allowed: with a link file"),
        (["sea.ply", "--map", "9"], "coverage: of a mesh alone, allowed: with a link"),
        (["sea.ply", "--movie", "a.gif"], "movie: of a mesh, which does not move, allowed: a link"),
        (["--screenshot", "a.jpg"], "--screenshot: 'a.jpg', allowed: a file name in .png"),
        (
            ["--html", "gone/a.html"],
            "html: 'gone/a.html', allowed: a file in an existing folder, both writable",
        ),
        (["--movie", "a.avi"], "--movie: 'a.avi', allowed: a file name in .mp4 or .gif"),
        (["--export", "text.txt"], "export: 'text.txt', allowed: a folder to write to"),
        (["--color", "depth"], "color: 'depth', allowed: water, elevation"),
        (["--size", "800"], "--size: '800', allowed: WIDTHxHEIGHT"),
        (["--daylight", "dawn"], "daylight.model: 'dawn', allowed: "),
        (["--extent", "nan"], "--extent: nan, allowed: finite numbers"),
        (["--frame-rate", "0"], "--frame-rate: 0.0, allowed: numbers > 0"),
        (["--time", "inf"], "--time: inf, allowed: a finite number"),
        (["--spacing", "1e-9"], "spacing: 1e-09, allowed: >= 0.00"),
        (["--frames", "1"], "--frames: '1', allowed: >= 2"),
        (["--paths", "-1"], "--paths: '-1', allowed: >= 0"),
    ],
)
def test_refusals_are_one_line(tmp_path, monkeypatch, arguments, line):
    import xarray as xr

    monkeypatch.chdir(tmp_path)
    for name in ("text.txt", "text.nc", "text.stl"):
        (tmp_path / name).write_text("text")
    xr.Dataset({"a": ("x", [1.0])}).to_netcdf("other.nc", engine="h5netcdf")
    SEA.mesh(extent=2.0, spacing=0.5).to_trimesh().export("sea.ply")
    if not any(option in arguments for option in ("--screenshot", "--html", "--movie", "--export")):
        arguments = [*arguments, "--screenshot", "a.png"]
    assert line in refusal(*arguments)
    assert not (tmp_path / "a.png").exists()


def test_a_window_needs_a_display(monkeypatch):
    monkeypatch.setattr("meshtrace.viz.show.has_display", lambda: False)
    assert refusal().startswith("view: no display, allowed: ")


def test_a_picture_needs_opengl(monkeypatch):
    """The process once ended by a segmentation fault, without a word."""
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setattr("meshtrace.viz.show._window_class", lambda **_: "vtkOSOpenGLRenderWindow")
    monkeypatch.setattr("meshtrace.viz.show.find_library", lambda name: None)
    assert refusal("--screenshot", "a.png").startswith("--screenshot: no OpenGL, allowed: html")


def test_results_of_later_formats_are_refused(tmp_path):
    data = mt.simulate(mt.Link(), SEA, photons=64).to_dataset()
    data.attrs["format_version"] = 99
    data.to_netcdf(tmp_path / "run.nc", engine="h5netcdf")
    assert "allowed: gain of format_version " in refusal(
        tmp_path / "run.nc", "--html", tmp_path / "a.html"
    )
    assert json.loads(data.attrs["provenance"])["surface"]["seed"] == 7
