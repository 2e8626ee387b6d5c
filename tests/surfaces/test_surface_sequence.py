"""Meshes in time: every format by a round trip from a sea's meshes, times, blends, refusals."""

import gc
import os
import pickle
import tracemalloc
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest
import pyvista as pv
import xarray as xr
from leaning import LeaningWave

import meshtrace as mt
from meshtrace import MeshSource, SurfaceModel
from meshtrace.errors import Refused
from meshtrace.scenario import Scenario
from meshtrace.surfaces import (
    JonswapSea,
    MeshSequence,
    from_trimesh,
    sea_from_config,
)

pytestmark = pytest.mark.filterwarnings("ignore::meshtrace.DomainWarning")

SEA = JonswapSea(wind_speed=8.0, seed=3)
TIMES = (0.0, 0.25, 0.5)
KEPT = {"extent": 12.0, "spacing": 1.0}
AXIS = np.linspace(-12.0, 12.0, 25)


@pytest.fixture(scope="module")
def meshes():
    return [SEA.mesh(time=t, **KEPT) for t in TIMES]


def polydata(mesh):
    return pv.PolyData.from_regular_faces(mesh.vertices, mesh.faces)


def write_trimesh(suffix):
    def write(folder, meshes):
        for i, mesh in enumerate(meshes):
            mesh.to_trimesh().export(folder / f"frame_{i}.{suffix}")
        return {"source": folder / f"*.{suffix}", "times": TIMES}

    return write


def write_vtk(suffix):
    def write(folder, meshes):
        for time, mesh in zip(TIMES, meshes, strict=True):
            data = polydata(mesh)
            data = data.cast_to_unstructured_grid() if suffix == "vtu" else data
            data.save(folder / f"sea-{time:.2f}.{suffix}")
        return {"source": folder}

    return write


def write_quads(folder, meshes):
    for i, mesh in enumerate(meshes):
        corner = np.arange(625).reshape(25, 25)
        quads = np.stack([corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]], -1)
        pv.PolyData.from_regular_faces(mesh.vertices, quads.reshape(-1, 4)).save(
            folder / f"{i}.vtk"
        )
    return {"source": folder, "frame_rate": 4.0}


def write_pvd(folder, meshes):
    root = ElementTree.Element("VTKFile", type="Collection")
    entries = ElementTree.SubElement(root, "Collection")
    for i in (2, 0, 1):
        polydata(meshes[i]).save(folder / f"part{i}.vtp")
        ElementTree.SubElement(entries, "DataSet", timestep=f"{TIMES[i]}", file=f"part{i}.vtp")
    ElementTree.ElementTree(root).write(folder / "sea.pvd")
    return {"source": folder / "sea.pvd"}


def write_xdmf_series(folder, meshes):
    meshio = pytest.importorskip("meshio")
    here = os.getcwd()
    os.chdir(folder)  # meshio writes the HDF5 file into the working folder
    try:
        with meshio.xdmf.TimeSeriesWriter("sea.xdmf") as writer:
            flat = meshes[0].vertices * [1.0, 1.0, 0.0]
            writer.write_points_cells(flat, [("triangle", meshes[0].faces)])
            for time, mesh in zip(TIMES, meshes, strict=True):
                writer.write_data(time, point_data={"displacement": mesh.vertices - flat})
    finally:
        os.chdir(here)
    return {"source": folder / "sea.xdmf"}


def write_xdmf_grids(folder, meshes):
    pytest.importorskip("meshio")
    root = ElementTree.Element("Xdmf", Version="3.0")
    domain = ElementTree.SubElement(root, "Domain")
    kind = {"GridType": "Collection", "CollectionType": "Temporal"}
    collection = ElementTree.SubElement(domain, "Grid", kind)
    with h5py.File(folder / "sea.h5", "w") as file:
        for i, (time, mesh) in enumerate(zip(TIMES, meshes, strict=True)):
            file[f"p{i}"], file[f"f{i}"] = mesh.vertices, mesh.faces
            grid = ElementTree.SubElement(collection, "Grid", GridType="Uniform")
            ElementTree.SubElement(grid, "Time", Value=f"{time}")
            topology = ElementTree.SubElement(grid, "Topology", TopologyType="Triangle")
            geometry = ElementTree.SubElement(grid, "Geometry", GeometryType="XYZ")
            shapes = (
                (topology, mesh.faces, "Int", "4", f"f{i}"),
                (
                    geometry,
                    mesh.vertices,
                    "Float",
                    "8",
                    f"p{i}",
                ),
            )
            for parent, array, number, size, name in shapes:
                item = ElementTree.SubElement(
                    parent,
                    "DataItem",
                    Dimensions=f"{len(array)} 3",
                    NumberType=number,
                    Precision=size,
                    Format="HDF",
                )
                item.text = f"sea.h5:/{name}"
    ElementTree.ElementTree(root).write(folder / "sea.xdmf")
    return {"source": folder / "sea.xdmf"}


def heights(meshes):
    return np.stack([mesh.vertices[:, 2].reshape(25, 25) for mesh in meshes])


def write_netcdf(folder, meshes, unit="m", factor=1.0):
    """Axes in the order (time, y, x) of climate and ocean models."""
    z = heights(meshes).transpose(0, 2, 1)
    data = xr.Dataset(
        {"eta": (("time", "y", "x"), z / factor, {"units": unit})},
        {
            "time": (
                "time",
                [7200.0 + 1000.0 * t for t in TIMES],
                {"units": "ms since 2024-01-01"},
            ),
            "x": ("x", AXIS / factor, {"units": unit}),
            "y": ("y", AXIS / factor, {"units": unit}),
        },
    )
    data.to_netcdf(folder / "sea.nc", engine="h5netcdf")
    return {"source": folder / "sea.nc"}


def write_millimetres(folder, meshes):
    return write_netcdf(folder, meshes, "mm", 1e-3)


def write_classic(folder, meshes):
    """Write a grid x(i, j), y(i, j) whose second index runs along x."""
    x, y = np.meshgrid(AXIS, AXIS)
    data = xr.Dataset(
        {
            "x": (("i", "j"), x, {"units": "m"}),
            "y": (("i", "j"), y, {"units": "m"}),
            "z": (("time", "i", "j"), heights(meshes).transpose(0, 2, 1), {"units": "m"}),
        },
        {"time": ("time", list(TIMES), {"units": "s"})},
    )
    data.to_netcdf(folder / "sea.nc", engine="scipy")
    return {"source": folder / "sea.nc"}


def write_hdf5(folder, meshes):
    with h5py.File(folder / "sea.h5", "w") as file:
        file["x"], file["y"] = 100.0 * AXIS, 100.0 * AXIS
        file["z"], file["t"] = 100.0 * heights(meshes), TIMES
    return {"source": folder / "sea.h5", "scale": 0.01}


FORMATS = {
    "stl": write_trimesh("stl"),
    "ply": write_trimesh("ply"),
    "obj": write_trimesh("obj"),
    "vtp": write_vtk("vtp"),
    "vtu": write_vtk("vtu"),
    "vtk": write_vtk("vtk"),
    "quads": write_quads,
    "pvd": write_pvd,
    "xdmf, one grid": write_xdmf_series,
    "xdmf, many grids": write_xdmf_grids,
    "netcdf": write_netcdf,
    "netcdf in mm": write_millimetres,
    "classic netcdf": write_classic,
    "hdf5": write_hdf5,
}


def ordered(mesh):
    return mesh.vertices[np.lexsort(mesh.vertices[:, :2].round(3).T)]


@pytest.mark.parametrize("name", FORMATS)
def test_round_trip(tmp_path, meshes, name):
    sea = MeshSequence(**FORMATS[name](tmp_path, meshes))
    assert len(sea) == 3
    for time, mesh in zip(TIMES, meshes, strict=True):
        found = sea.mesh(time)
        assert found.single_valued
        assert len(found.faces) == len(mesh.faces)
        np.testing.assert_allclose(ordered(found), ordered(mesh), atol=1e-5)
    again = pickle.loads(pickle.dumps(sea))
    assert again == sea == sea_from_config(sea.to_config())
    np.testing.assert_array_equal(again.mesh(0.25).vertices, sea.mesh(0.25).vertices)


class Direct:
    """The same meshes from memory."""

    def __init__(self, files):
        self.meshes = [from_trimesh(file) for file in files]

    def mesh(self, time=0.0, extent=20.0, spacing=0.1, **options):
        return self.meshes[TIMES.index(time)]

    def to_config(self):
        return {"kind": "direct"}


def test_gain_is_that_of_the_meshes(tmp_path, meshes):
    write_trimesh("ply")(tmp_path, meshes)
    sea = MeshSequence(tmp_path, times=TIMES)
    direct = Direct(sorted(tmp_path.glob("*.ply")))
    assert isinstance(sea, MeshSource)
    assert not isinstance(sea, SurfaceModel)
    link = mt.Link()
    one = mt.simulate(link, sea, photons=256, time=0.25)
    other = mt.simulate(link, direct.meshes[1], photons=256)
    assert one.gain == other.gain > 0.0
    series = mt.time_series(link, sea, TIMES, photons=256)
    expected = mt.time_series(link, direct, TIMES, photons=256)
    np.testing.assert_array_equal(series.gain, expected.gain)
    assert len(set(series.gain)) == 3
    assert sea_from_config(one.provenance["surface"]) == sea


def test_a_crest_that_breaks_changes_its_estimator(tmp_path):
    """Topology and folds may change from frame to frame."""
    for i, lean in enumerate((0.2, 0.9)):
        wave = LeaningWave(amplitude=0.3, wavelength=4.0, lean=lean)
        wave.mesh(extent=12.0, spacing=0.5 - 0.1 * i).to_trimesh().export(tmp_path / f"w{i}.ply")
    sea, link = MeshSequence(tmp_path), mt.Link()
    used = [mt.simulate(link, sea, time=t, photons=256).provenance["run"] for t in (0.0, 1.0)]
    assert [run["estimator"] for run in used] == ["forced", "analog"]
    with pytest.raises(Refused, match="overhangs"):
        mt.time_series(link, sea, [0.0, 1.0], photons=64)


def test_linear_blend_moves_the_corners(tmp_path, meshes):
    write_trimesh("ply")(tmp_path, meshes)
    sea = MeshSequence(tmp_path, times=TIMES, blend="linear", normals="angle")
    frames = [sea.frame(i) for i in range(3)]
    mid = sea.mesh(0.25 + 0.3 * 0.25)
    np.testing.assert_allclose(
        mid.vertices, 0.7 * frames[1].vertices + 0.3 * frames[2].vertices, atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.norm(mid.vertex_normals, axis=1), 1.0, atol=1e-12)
    assert sea.mesh(0.25) is frames[1]
    assert sea.mesh(0.5) is frames[2]


def test_error_of_the_linear_blend_is_of_second_order(tmp_path):
    wave = JonswapSea(wind_speed=8.0, seed=1)
    error = []
    for k, step in enumerate((0.4, 0.2)):
        folder = tmp_path / f"{k}"
        folder.mkdir()
        for i in range(2):
            wave.mesh(time=i * step, **KEPT).to_trimesh().export(folder / f"f{i}.ply")
        blended = MeshSequence(folder, times=(0.0, step), blend="linear").mesh(0.5 * step)
        exact = wave.mesh(time=0.5 * step, **KEPT)
        error.append(np.std(ordered(blended)[:, 2] - ordered(exact)[:, 2]))
    assert 1.7 < np.log2(error[0] / error[1]) < 2.3


@pytest.mark.parametrize(("time", "frame"), [(0.0, 0), (0.12, 0), (0.13, 1), (0.5, 2)])
def test_nearest_frame(tmp_path, meshes, time, frame):
    write_trimesh("ply")(tmp_path, meshes)
    sea = MeshSequence(tmp_path, times=TIMES)
    assert sea.mesh(time) is sea.frame(frame)


def test_numbers_in_names_are_times_in_their_order(tmp_path, meshes):
    for number in ("9.5", "10", "100"):
        meshes[0].to_trimesh().export(tmp_path / f"run2_t{number}s.ply")
    sea = MeshSequence(tmp_path)
    assert sea.mesh(9.5) is sea.frame(0)
    assert sea.mesh(100.0) is sea.frame(2)
    rated = MeshSequence(tmp_path, frame_rate=2.0)
    assert rated.mesh(1.0) is rated.frame(2)


@pytest.mark.parametrize(("up", "order"), [("y", [1, 2, 0]), ("x", [2, 0, 1])])
def test_other_axes_up(tmp_path, meshes, up, order):
    turned = meshes[0].vertices[:, order]
    mt_mesh = meshes[0].to_trimesh()
    mt_mesh.vertices = turned
    mt_mesh.export(tmp_path / "0.ply")
    found = MeshSequence(tmp_path, up=up).mesh()
    np.testing.assert_allclose(ordered(found), ordered(meshes[0]), atol=1e-5)


@pytest.mark.thorough
def test_a_thousand_frames_are_read_one_by_one(tmp_path):
    """Two frames of 1e5 facets stay in memory, whatever the number of files."""
    first = tmp_path / "f0000.ply"
    JonswapSea(wind_speed=8.0).mesh(extent=20.0, spacing=40.0 / 224.0).to_trimesh().export(first)
    for i in range(1, 1000):
        os.link(first, tmp_path / f"f{i:04d}.ply")
    tracemalloc.start()
    sea = MeshSequence(tmp_path, frame_rate=10.0)
    assert len(sea) == 1000
    assert len(sea.mesh(0.0).faces) == 2 * 224**2
    gc.collect()
    after_first = tracemalloc.get_traced_memory()[0]
    for i in (1, 500, 999, 998, 3, 4):
        sea.mesh(0.1 * i)
    gc.collect()
    held, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert held < 2.5 * after_first
    assert peak < 300e6
    kept = sea.mesh(0.4)
    assert sea.mesh(0.3) is not None
    assert sea.mesh(0.4) is kept


def test_link_file(tmp_path, meshes):
    write_trimesh("stl")(tmp_path, meshes)
    text = (
        '[sea]\nmeshes = "*.stl"\nframe_rate = 4.0\nscale = 0.5\ntime = 0.25\n[run]\nphotons = 64'
    )
    scenario = Scenario.from_toml(text, folder=tmp_path)
    expected = MeshSequence(tmp_path / "*.stl", frame_rate=4.0, scale=0.5)
    assert scenario.surface == expected
    assert scenario.meshing.time == 0.25
    assert Scenario.from_toml(scenario.to_toml()) == scenario
    r = scenario.simulate()
    assert r.gain == mt.simulate(scenario.link, expected.mesh(0.25), photons=64).gain
    assert Scenario.from_provenance(r.provenance).surface == expected


def gappy(folder, meshes):
    options = write_classic(folder, meshes)
    with xr.open_dataset(options["source"], engine="scipy") as opened:
        data = opened.load()
    data["z"][1, 3, 4:8] = np.nan
    data.to_netcdf(options["source"], engine="scipy")
    return options


def without_units(folder, meshes):
    options = write_hdf5(folder, meshes)
    del options["scale"]
    return options


def looking_like_mm(folder, meshes):
    big = mt.TriangleMesh(meshes[0].vertices * [1.0, 1.0, 1000.0], meshes[0].faces)
    big.to_trimesh().export(folder / "0.ply")
    return {"source": folder}


def unequal(folder, meshes):
    options = write_trimesh("ply")(folder, meshes[:2])
    SEA.mesh(extent=12.0, spacing=2.0).to_trimesh().export(folder / "frame_2.ply")
    return {**options, "blend": "linear"}


def flipped(folder, meshes):
    faces = np.array(meshes[0].faces)
    faces[7] = faces[7, ::-1]
    pv.PolyData.from_regular_faces(meshes[0].vertices, faces).save(folder / "0.vtp")
    return {"source": folder}


def damaged(folder, meshes):
    (folder / "0.stl").write_bytes(b"solid nothing")
    return {"source": folder}


READ = {
    "gaps": (gappy, 0.25, r"sea.nc \[1\]: source: 4 gaps \(nan\) in z"),
    "units": (without_units, 0.0, "no units, allowed: x, y, z in m, cm or mm, or scale"),
    "mm": (looking_like_mm, 0.0, "scale: heights up to .* m look like mm"),
    "unequal topology": (unequal, 0.3, r'blend: "linear" from 1152 to 288 facets'),
    "flipped winding": (flipped, 0.0, r"0.vtp: source: 3 edges between facets of opposite winding"),
    "damaged": (damaged, 0.0, "0.stl"),
    "before": (write_pvd, -0.1, "time: -0.1, allowed: 0 <= time <= 0.5 s, the record"),
    "after": (write_pvd, 0.6, "time: 0.6, allowed: 0 <= time <= 0.5 s, the record"),
}


@pytest.mark.parametrize("name", READ)
def test_refuses_frames(tmp_path, meshes, name):
    write, time, message = READ[name]
    sea = MeshSequence(**write(tmp_path, meshes))
    with pytest.raises(Refused, match=message) as caught:
        sea.mesh(time)
    assert str(caught.value).isprintable()


OPTIONS = {
    "count": ({"times": (0.0, 1.0)}, "times: 2 times for 3 frames"),
    "order": ({"times": (0.0, 2.0, 1.0)}, "times: not increasing"),
    "equal": ({"times": (0.0, 1.0, 1.0)}, "times: not increasing"),
    "nan": ({"times": (0.0, 1.0, float("nan"))}, "times"),
    "scale": ({"scale": 0.0}, "scale: 0.0, allowed: > 0"),
    "frame_rate": ({"frame_rate": -1.0}, "frame_rate: -1.0, allowed: > 0"),
    "blend": ({"blend": "cubic"}, "blend: 'cubic', allowed: nearest or linear"),
    "up": ({"up": "-z"}, "up: '-z', .*allowed: x, y or z"),
    "normals": ({"normals": "exact"}, "normals: 'exact', allowed: area or angle"),
    "no files": ({"source": "nothing/*.vtp"}, r"source: no files in 'nothing/\*.vtp'"),
    "other files": ({"source": __file__}, "source: .*allowed: a folder or a pattern"),
}


@pytest.mark.parametrize("name", OPTIONS)
def test_refuses_options(tmp_path, meshes, name):
    given, message = OPTIONS[name]
    options = {"source": write_trimesh("ply")(tmp_path, meshes)["source"], **given}
    with pytest.raises(Refused, match=message):
        MeshSequence(**options)


def test_names_without_numbers_ask_for_times(tmp_path, meshes):
    for name in ("one", "two"):
        meshes[0].to_trimesh().export(tmp_path / f"{name}.ply")
    with pytest.raises(Refused, match=r"times: None, allowed: times \[s\] or frame_rate"):
        MeshSequence(tmp_path)


@pytest.mark.parametrize("write", [write_trimesh("ply"), write_xdmf_series, write_netcdf])
@pytest.mark.parametrize("i", [-1, 3, 0.5])
def test_refuses_frames_that_do_not_exist(tmp_path, meshes, write, i):
    sea = MeshSequence(**{"times": TIMES, **write(tmp_path, meshes)})
    with pytest.raises(Refused, match=rf"^i: {i}, allowed: an integer 0 <= i <= 2$"):
        sea.frame(i)


def test_minutes_written_as_m_are_no_milliseconds(tmp_path, meshes):
    z = heights(meshes).transpose(0, 2, 1)
    coords = {"time": ("time", list(TIMES), {"units": "m"}), "x": AXIS, "y": AXIS}
    xr.Dataset({"eta": (("time", "y", "x"), z)}, coords).to_netcdf(tmp_path / "sea.nc")
    with pytest.raises(Refused, match=r"time in 'm', allowed: s, sec, second, ms, .*, min,"):
        MeshSequence(tmp_path / "sea.nc", scale=1.0)


def grid(**changes):
    """Return a sea over a grid in metres, as a dataset of three times."""
    z = 0.1 * np.cos(AXIS[:, None] + 0.5 * AXIS + np.arange(3.0)[:, None, None])
    metres = {"units": "m"}
    coords = {
        "time": ("time", np.arange(3.0), {"units": "s"}),
        "x": ("x", AXIS, metres),
        "y": ("y", AXIS, metres),
    }
    return xr.Dataset({"z": (("time", "x", "y"), z, metres)}, coords).assign(changes)


@pytest.mark.parametrize(
    ("name", "unit", "factor"),
    [
        ("x", "km", 1e-3),
        ("z", "mm", 1e3),
        ("z", "cm", 100.0),
        ("z", "centimeters", 100.0),
        ("y", "ft", 1 / 0.3048),
    ],
)
@pytest.mark.filterwarnings("ignore:.*converted to m:meshtrace.InputWarning")
def test_units_that_differ_between_axes(name, unit, factor, tmp_path):
    data = grid()
    dims = data[name].dims
    if name == "z":
        data = data.assign(z=(dims, factor * data.z.values, {"units": unit}))
    else:
        data = data.assign_coords({name: (dims, factor * AXIS, {"units": unit})})
    grid().to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    data.to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
    expected, found = (MeshSequence(tmp_path / f"{n}.nc").mesh(1.0) for n in "ab")
    np.testing.assert_allclose(found.vertices, expected.vertices, rtol=1e-9, atol=1e-12)


def test_heights_that_count_downwards(tmp_path):
    grid().to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    down = grid(z=(-grid().z).assign_attrs(units="m", positive="down"))
    down.to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
    expected = MeshSequence(tmp_path / "a.nc").mesh(1.0)
    with pytest.warns(mt.InputWarning, match="z: positive downwards, turned upwards"):
        found = MeshSequence(tmp_path / "b.nc").mesh(1.0)
    np.testing.assert_array_equal(found.vertices, expected.vertices)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda d: d.assign_coords(x=d.x.assign_attrs(units="degrees_east")), "x: in degrees_east"),
        (lambda d: d.assign(z=d.z.assign_attrs(units="Pa")), "z: in Pa"),
        (lambda d: d.assign(z=d.z.assign_attrs(units="")), "no units"),
        (lambda d: d.assign(z=d.z.assign_attrs(valid_max=0.05)), r"\d+ gaps \(nan\) in z"),
        (
            lambda d: d.assign_coords(time=d.time.assign_attrs(units="months since 2024-01-01")),
            "time in 'months'",
        ),
        (lambda d: d.isel(time=slice(0)), "no frames|source"),
        (lambda d: d.isel(x=slice(1)), "two or more points"),
        (
            lambda d: d.drop_vars("x").assign(
                x=("n", np.arange(99_999.0), {"units": "m"}),
                y=("m", np.arange(99_999.0), {"units": "m"}),
            ),
            "one grid|shapes|source",
        ),
        (lambda d: d.assign(z=(("x", "y", "time"), d.z.values.T, {"units": "m"})), "times: None"),
    ],
)
def test_grids_that_are_not_understood(change, match, tmp_path):
    change(grid()).to_netcdf(tmp_path / "sea.nc", engine="h5netcdf")
    with pytest.raises(Refused, match=match):
        MeshSequence(tmp_path / "sea.nc").mesh(1.0)


def test_a_collection_without_meshes_is_refused(tmp_path):
    """Once an IndexError."""
    (tmp_path / "a.xdmf").write_text(
        '<Xdmf><Domain><Grid CollectionType="Temporal"/></Domain></Xdmf>'
    )
    (tmp_path / "b.xdmf").write_text("<Xdmf/>")
    for name in ("a", "b"):
        with pytest.raises(Refused):
            MeshSequence(tmp_path / f"{name}.xdmf").mesh()
