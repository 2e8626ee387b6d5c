"""Meshes in time from files: lists of files, collections of VTK and XDMF, grids in netCDF or HDF5.

Every reader lists its frames at once and reads each frame on demand.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from functools import lru_cache
from glob import glob
from os.path import abspath
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import PrivateAttr

from meshtrace.checks import Inside
from meshtrace.errors import Described, Refused, extra, reason_of, require_whole, warn_of_input
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Model
from meshtrace.netcdf import opened, require_size, valid_values
from meshtrace.units import convert, unit_of

from .parameters import Floats, Positive
from .triangulate import from_trimesh, grid_faces, read_mesh, unfit

if TYPE_CHECKING:
    import xarray

Facets = tuple[Floats, NDArray[np.int64]]
"""Vertices (n, 3) in the unit of the file, and facets (m, 3)."""

_TRIMESH = (".stl", ".ply", ".obj")
_VTK = (".vtp", ".vtu", ".vtk")
_XDMF = (".xdmf", ".xmf")
_GRID = (".nc", ".nc4", ".cdf", ".h5", ".hdf5")
_ALLOWED = (
    "a folder or a pattern of STL, PLY, OBJ, VTP, VTU or VTK files, or a PVD, XDMF, netCDF or "
    "HDF5 file"
)
_HEIGHT = ("z", "eta", "elevation", "zeta")  # names of arrays of heights
# units of time [s], in the singular
_SECONDS = {"s": 1.0, "sec": 1.0, "second": 1.0, "ms": 1e-3, "millisecond": 1e-3, "min": 60.0,
            "minute": 60.0, "h": 3600.0, "hour": 3600.0, "day": 86400.0}  # fmt: skip


class Frames(NamedTuple):
    """Meshes in files, listed but not read.

    Parameters
    ----------
    names : list of str
        Names of the frames, for errors.
    read : callable
        Function that returns a frame by its index, as it is in the file.
    times : ndarray, optional
        Times of the frames [s], None if the files hold none.
    metres : float or None
        Unit of length of the files [m], 1 for meshes; None for grids whose files do not name it.
    """

    names: list[str]
    read: Callable[[int], Facets]
    times: Floats | None = None
    metres: float | None = 1.0


def open_frames(source: str | Sequence[str]) -> Frames:
    """List the frames of a source, see `MeshSequence`.

    Raises
    ------
    Refused
        If there are none, or their kind is not known.
    """
    if not isinstance(source, str):
        return _files([Path(name) for name in source], source)
    path = Path(source)
    if path.is_dir():
        return _files([p for p in path.iterdir() if p.suffix.lower() in _TRIMESH + _VTK], source)
    if not path.is_file():
        return _files([Path(name) for name in glob(source)], source)
    suffix = path.suffix.lower()
    try:
        if suffix == ".pvd":
            return _collection(path)
        if suffix in _XDMF:
            return _xdmf(path)
        return _grids(path) if suffix in _GRID else _files([path], source)
    except Refused:
        raise
    except Exception as error:  # readers of XML, HDF5 and netCDF raise any exception
        raise unfit(f"{path}: {reason_of(error)}", _ALLOWED) from error


def _files(files: list[Path], source: object) -> Frames:
    """List files in the order of the number that distinguishes their names, or of the names."""
    if not files:
        raise unfit(f"no files in {source!r}", _ALLOWED)
    for file in files:
        if not file.is_file() or file.suffix.lower() not in _TRIMESH + _VTK:
            raise Refused("source", str(file), _ALLOWED)
    files = sorted(files)
    numbers = [re.findall(r"\d+(?:\.\d+)?", file.stem) for file in files]
    # the first number that differs from file to file orders them; it is also their time [s] unless
    # `MeshSequence` gets others
    for column in range(min(map(len, numbers))):
        times = np.array([float(row[column]) for row in numbers])
        if len(np.unique(times)) == len(files):
            order = np.argsort(times)
            return _one_each([files[i] for i in order], times[order])
    return _one_each(files)


def _collection(path: Path) -> Frames:
    """List the files of a ParaView collection with their times.

    Several parts of one time are refused by `MeshSequence`, since its times must increase.
    """
    entries = ElementTree.parse(path).getroot().iter("DataSet")
    entries_by_time = sorted((float(e.get("timestep", 0.0)), e.attrib["file"]) for e in entries)
    files = [path.parent / name for _, name in entries_by_time]
    missing = next((f for f in files if not f.is_file()), None)
    if missing is not None or not files:
        raise unfit(f"{path}: no {missing or 'files'}", _ALLOWED)
    return _one_each(files, np.array([time for time, _ in entries_by_time]))


def _one_each(files: list[Path], times: Floats | None = None) -> Frames:
    """Return the frames of files that hold one each; polygons are split into triangles."""

    def read(i: int) -> Facets:
        path = files[i]
        return read_mesh(path) if path.suffix.lower() in _TRIMESH else _read_vtk(path)

    return Frames(list(map(str, files)), read, times)


def _read_vtk(path: Path) -> Facets:
    """Return the polygons of a VTK file, or the outer surface of its cells."""
    with extra("viz", "source", str(path), "{} for VTK files"):
        import pyvista as pv
    data: Any = pv.read(path)
    # a file of several parts is one surface
    if isinstance(data, pv.MultiBlock):
        data = data.combine()
    if not isinstance(data, pv.PolyData):
        data = data.extract_surface(algorithm=None, pass_pointid=False, pass_cellid=False)
    data = data.triangulate()
    return np.asarray(data.points, np.float64), data.faces.reshape(-1, 4)[:, 1:].astype(np.int64)


def _numbered(path: Path, n: int) -> list[str]:
    """Return the names of the n frames of one file, for errors."""
    return [f"{path} [{i}]" for i in range(n)]


def _xdmf(path: Path) -> Frames:
    """List the grids of an XDMF file: one, or a temporal collection.

    The grids of a collection have their own points and cells, or share those of the first and move
    their points by a point array: positions or displacements of three components, or heights z.
    Quadrangles are split into triangles.
    """
    every_grid = list(ElementTree.parse(path).getroot().iter("Grid"))
    collection = next((g for g in every_grid if g.get("CollectionType") == "Temporal"), None)
    grids = every_grid[:1] if collection is None else collection.findall("Grid")
    # the first grid has points in both cases, the last one only where each has its own
    shared = collection is not None and grids[-1].find("Geometry") is None
    stated = [time.attrib["Value"] for grid in grids if (time := grid.find("Time")) is not None]
    times = np.array(stated, np.float64) if len(stated) == len(grids) else None

    def read(i: int) -> Facets:
        with extra("meshes", "source", str(path), "{} for XDMF files"):
            from meshio.xdmf import TimeSeriesReader
            from meshio.xdmf.main import XdmfReader
        if shared:
            with TimeSeriesReader(path) as series:
                points, cells = series.read_points_cells()
                return _moved(points, series.read_data(i)[1]), _triangles(cells)
        grid = ElementTree.Element("Grid", grids[i].attrib)
        grid.extend(c for c in grids[i] if c.tag in ("Topology", "Geometry"))
        # meshio reads files of one grid: each grid becomes such a file in memory
        root = ElementTree.Element("Xdmf", Version="3.0")
        ElementTree.SubElement(root, "Domain").append(grid)
        mesh = XdmfReader(str(path)).read_xdmf3(root)
        return _spatial(mesh.points), _triangles(mesh.cells)

    return Frames(_numbered(path, len(grids)), read, times)


def _spatial(points: Any) -> Floats:
    """Pad points to three dimensions with zeros."""
    points = np.array(points, np.float64)
    return np.pad(points, ((0, 0), (0, 3 - points.shape[1])))


def _moved(points: Any, arrays: dict[str, Any]) -> Floats:
    """Return the points of a frame that shares its grid with the others."""
    points = _spatial(points)
    for name, values in arrays.items():
        if name.lower() in _HEIGHT and np.size(values) == len(points):
            points[:, 2] = np.ravel(values)
            return points
        if np.shape(values) == points.shape and name.lower() in ("points", "position"):
            return np.array(values, np.float64)
        if np.shape(values) == points.shape and name.lower().startswith(("disp", "warp")):
            return points + values
    allowed = "points, displacement, or a height z, eta or elevation"
    raise unfit(f"point arrays {sorted(arrays)}", allowed)


def _triangles(blocks: Any) -> NDArray[np.int64]:
    """Return the facets of blocks of cells of meshio, quadrangles split into triangles."""
    faces = [block.data for block in blocks if block.type == "triangle"]
    for block in blocks:
        if block.type == "quad":
            faces += [block.data[:, [0, 1, 2]], block.data[:, [0, 2, 3]]]
    if not faces:
        raise unfit("no triangles or quadrangles", "a surface")
    return np.concatenate(faces).astype(np.int64)


def _grids(path: Path) -> Frames:
    """List the frames of a netCDF or HDF5 file: z(t, i, j) over x(i, j), y(i, j) or over axes."""
    with opened(path, None, decode_times=False) as data:
        names = {name.lower(): name for name in map(str, data.variables)}
        z = data[_height(data, names)]
        missing = [axis for axis in "xy" if axis not in names]
        if missing:
            raise unfit(f"without {missing}", "x, y and z(t, i, j)")
        variables = names["x"], names["y"], str(z.name)
        factors, metres = _lengths([data[name] for name in variables])
        time = next((names[name] for name in ("time", "t") if name in names), None)
        times = None
        if time is not None and z.ndim == 3 and data[time].shape == z.shape[:1]:
            times = _seconds(data[time])
        n = z.shape[0] if z.ndim == 3 else 1
    # memory of the names of the frames: a file may state any number of them
    require_size(64 * n, n, str(path))

    def read(i: int) -> Facets:
        with opened(path, None, decode_times=False) as data:
            x, y, z = (data[name] for name in variables)
            return _grid_facets(x, y, z, i, factors)

    return Frames(_numbered(path, n), read, times, metres)


def _lengths(axes: list[xarray.DataArray]) -> tuple[Floats, float | None]:
    """Return the factors of x, y and z to the unit of x, and that unit [m].

    The factor of depths (positive downwards) is negative. Without units for all three the factors
    are 1 and the unit is None.
    """
    units = [unit_of(axis) for axis in axes]
    if not all(units):
        return np.ones(3), None
    metres = [
        float(convert(1.0, unit, "m", str(a.name))) for unit, a in zip(units, axes, strict=True)
    ]
    if len(set(metres)) > 1:
        warn_of_input(f"x, y, z in {', '.join(units)} converted to m")
    factors = np.array(metres) / metres[0]
    if str(axes[2].attrs.get("positive", "up")).lower() == "down":
        warn_of_input(f"{axes[2].name}: positive downwards, turned upwards")
        factors[2] *= -1.0
    return factors, metres[0]


def _grid_facets(
    along: xarray.DataArray,
    across: xarray.DataArray,
    heights: xarray.DataArray,
    i: int,
    factors: Floats,
) -> Facets:
    """Return frame i as triangles that face up; `along` is x, `across` is y."""
    z = heights[i] if heights.ndim == 3 else heights
    x_dims, y_dims = along.dims, across.dims
    # over axes, files may have the heights as z(y, x)
    if len(x_dims) == len(y_dims) == 1 and (*y_dims, *x_dims) == z.dims:
        z = z.transpose()
    grid = (along.size, across.size) if along.ndim == across.ndim == 1 else along.shape
    if z.ndim != 2 or z.shape != grid or (along.ndim != 1 and across.shape != grid):
        raise unfit(f"shapes {along.shape}, {across.shape}, {z.shape}", "x, y and z of one grid")
    # before the arrays are read: a file may state any size
    require_size(8 * z.size, 8 * z.size, str(z.name))
    arrays = zip((along, across, z), factors, strict=True)
    x, y, height = (factor * valid_values(axis) for axis, factor in arrays)
    if x.ndim == y.ndim == 1:
        x, y = np.meshgrid(x, y, indexing="ij")
    gaps = np.count_nonzero(~np.isfinite(height))
    if gaps:
        raise unfit(f"{gaps} gaps (nan) in z", "none: fill them first")
    if min(height.shape) < 2:
        raise unfit(f"a grid of shape {height.shape}", "two or more points along x and y")
    vertices = np.stack([x, y, height], axis=-1).reshape(-1, 3)
    faces = grid_faces(*height.shape).astype(np.int64)
    # an axis may decrease, which would turn the facets over: d(x, y) / d(i, j) is then negative
    x_i, x_j = np.diff(x, axis=0)[0, 0], np.diff(x, axis=1)[0, 0]
    jacobian = x_i * np.diff(y, axis=1)[0, 0] - x_j * np.diff(y, axis=0)[0, 0]
    return vertices, faces if jacobian > 0.0 else faces[:, ::-1]


def _height(data: xarray.Dataset, names: dict[str, str]) -> str:
    """Return the name of the heights: by name, or the only array over time and a grid."""
    for name in _HEIGHT:
        if name in names and data[names[name]].ndim in (2, 3):
            return names[name]
    candidates = [str(name) for name, array in data.variables.items() if array.ndim == 3]
    if len(candidates) != 1:
        allowed = f"one array over time and a grid, or {', '.join(_HEIGHT)}"
        raise unfit(f"heights {candidates}", allowed)
    return candidates[0]


def _seconds(time: xarray.DataArray) -> Floats:
    """Return times [s]; dates count from the first one."""
    word, _, rest = str(time.attrs.get("units", "s")).lower().partition(" ")
    unit = _SECONDS.get(word) or _SECONDS.get(word.removesuffix("s"))
    if unit is None:
        raise unfit(f"time in {word!r}", ", ".join(_SECONDS))
    values = valid_values(time)
    return unit * (values - values[0] if rest.startswith("since") else values)


_KEPT = 2  # frames in memory
_DEEPEST = 50.0  # [m]: larger heights are taken for millimetres, no waves
# The axis that points up, to the columns of a file that become x, y, z: cyclic, so that nothing is
# mirrored.
_AXES = {"x": (1, 2, 0), "y": (2, 0, 1), "z": (0, 1, 2)}


def _plain(value: Any) -> Any:
    """Return paths as text, and arrays as tuples."""
    if isinstance(value, str | os.PathLike):
        return os.fspath(value)
    if isinstance(value, np.ndarray):
        return tuple(value.tolist())
    return tuple(map(_plain, value)) if isinstance(value, Sequence) else value


class MeshSequence(Model, frozen=True):
    """A surface given by one mesh file for each time.

    Parameters
    ----------
    source : path or sequence of paths
        Folder or pattern ("run/*.vtp") of STL, PLY, OBJ, VTP, VTU or VTK files, a list of them,
        a PVD collection, an XDMF file, or a netCDF or HDF5 file with heights z(t, i, j) over
        x(i, j), y(i, j) or over axes x(i), y(j).
    times : sequence of float, optional
        Increasing times of the frames [s]; by default i / frame_rate, else those in the files,
        else the numbers in their names [s].
    scale : float
        Unit of length of the files [m], > 0. By default those which netCDF and HDF5 files name
        for x, y and z, and 1 m for others.
    up : {"z", "y", "x"}
        Axis of the files that points up. The others follow in their cyclic order.
    normals : {"area", "angle"}
        Weights of the facets in the vertex normals, see `meshtrace.mesh.vertex_normals`.
    blend : {"nearest", "linear"}
        Surface between two frames: the nearer one, or corners that move straight, for frames
        of the same facets.
    frame_rate : float, optional
        Frames in a second [s-1], > 0.

    Raises
    ------
    Refused
        If no frames are found, the times do not increase, or a file states arrays that it cannot
        hold.

    Notes
    -----
    Frames are read on demand, and the last two are kept: memory does not grow
    with their number. Frames may overhang (see `from_trimesh`) and differ in their facets unless
    blended. `elevation` and `slopes` do not exist.

    Blending linearly is wrong by dt^2 |d^2 z/dt^2| / 8 <= dt^2 omega^2 a / 8 for waves of frequency
    omega and amplitude a: 0.1 % of a for dt = 0.1 / omega.

    Examples
    --------
    >>> import tempfile
    >>> from meshtrace.surfaces import FlatSea
    >>> folder = tempfile.mkdtemp()
    >>> for i in range(3):
    ...     mesh = FlatSea(height=0.1 * i).mesh(extent=5.0, spacing=1.0)
    ...     _ = mesh.to_trimesh().export(f"{folder}/frame_{i}.ply")
    >>> sea = MeshSequence(folder, frame_rate=10.0, blend="linear")
    >>> round(float(sea.mesh(time=0.15).bounds[1, 2]), 6)
    0.15
    """

    kind: Literal["meshes"] = "meshes"
    source: str | tuple[str, ...]
    times: tuple[float, ...] | None = None
    scale: Positive = 1.0
    up: Literal["x", "y", "z"] = "z"
    normals: Literal["area", "angle"] = "area"
    blend: Literal["nearest", "linear"] = "nearest"
    frame_rate: Positive | None = None

    _frames: Frames = PrivateAttr()
    _frame_times: Floats = PrivateAttr()  # [s], shape (frames,)
    _mesh_of: Callable[[int], TriangleMesh] = PrivateAttr()
    _lock: Any = PrivateAttr(default_factory=Lock)

    def __init__(
        self,
        source: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | None = None,
        times: ArrayLike | None = None,
        **options: Any,
    ) -> None:
        for name, value in (("source", _plain(source)), ("times", _plain(times))):
            if value is not None:  # a field that is not given stays unset in `to_config`
                options[name] = value
        super().__init__(**options)

    def model_post_init(self, context: Any) -> None:
        """List the frames and their times."""
        self._frames = open_frames(self.source)  # type: ignore[misc]  # private: not frozen
        # a cache of this sequence alone, freed with it
        self._mesh_of = lru_cache(maxsize=_KEPT)(self._read)  # type: ignore[misc]
        times, n = self._frames.times, len(self)
        # given times take precedence, then a given rate, then the times in the files
        if self.times is not None:
            times = np.array(self.times)
        elif self.frame_rate is not None:
            times = np.arange(n) / self.frame_rate
        elif times is None and n == 1:
            times = np.zeros(1)
        if n == 0:
            raise unfit(f"no frames in {self.source!r}", "one or more meshes")
        if times is None:
            raise Refused("times", None, "times [s] or frame_rate, for frames without times")
        if len(times) != n:
            raise Refused("times", Described(f"{len(times)} times for {n} frames"), "one a frame")
        if not np.isfinite(times).all() or not (np.diff(times) > 0.0).all():
            raise Refused("times", Described("not increasing"), "increasing times [s], all finite")
        self._frame_times = times  # type: ignore[misc]

    def __len__(self) -> int:
        return len(self._frames.names)

    def frame(self, i: Annotated[int, Inside()]) -> TriangleMesh:
        """Return frame i, from memory or its file.

        Parameters
        ----------
        i : int
            Number of the frame, 0 <= i < len(self).

        Raises
        ------
        Refused
            If there is no such frame, or its file is damaged.
        """
        require_whole(i, 0, len(self) - 1, "i")
        with self._lock:  # threads that want one frame read it once
            return self._mesh_of(i)

    def _read(self, i: int) -> TriangleMesh:
        """Read frame i from its file, in m, with z upwards."""
        name = self._frames.names[i]
        try:
            vertices, faces = self._frames.read(i)
            unit = self.scale if "scale" in self.model_fields_set else self._frames.metres
            if unit is None:
                raise Refused("source", Described("no units"), "x, y, z in m, cm or mm, or scale")
            vertices = unit * vertices[:, _AXES[self.up]]
            largest = float(np.abs(vertices[:, 2]).max()) if len(vertices) else 0.0
            if largest > _DEEPEST and "scale" not in self.model_fields_set:
                heights = Described(f"heights up to {largest:g} m look like mm")
                raise Refused("scale", heights, f"heights within {_DEEPEST:g} m, or scale")
            return from_trimesh((vertices, faces), overhangs=True, normals=self.normals)
        except Refused as error:
            raise error.in_file("" if error.field == name else name) from error.__cause__
        except Exception as error:  # the readers raise any exception
            reason = Described(reason_of(error))
            raise Refused(name, reason, "an undamaged mesh file") from error

    def mesh(
        self,
        time: float = 0.0,
        extent: float = 20.0,
        spacing: float = 0.1,
        *,
        center: tuple[float, float] = (0.0, 0.0),
        fine_extent: float | None = None,
        coarse_spacing: float | None = None,
    ) -> TriangleMesh:
        """Return the mesh at a time [s], with the facets of the frames; `extent` has no effect.

        Raises
        ------
        Refused
            If the time lies outside the record, a frame cannot be read or is no surface (see
            `from_trimesh`), or frames of other facets are to be blended.
        """
        times = self._frame_times
        # times of a study are rounded, by less than 1e-9 s
        if not times[0] - 1e-9 <= time <= times[-1] + 1e-9:
            raise Refused("time", time, f"{times[0]:g} <= time <= {times[-1]:g} s, the record")
        if self.blend == "nearest" or len(times) == 1:
            return self.frame(int(np.abs(times - time).argmin()))
        i = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(times) - 2))
        # weight of the later frame
        weight = min(max((time - times[i]) / (times[i + 1] - times[i]), 0.0), 1.0)
        # at a frame there is nothing to blend, nor another file to read
        if weight in (0.0, 1.0):
            return self.frame(i + int(weight))
        before, after = self.frame(i), self.frame(i + 1)
        if not np.array_equal(before.faces, after.faces):
            reason = Described(f'"linear" from {len(before.faces)} to {len(after.faces)} facets')
            allowed = 'the same facets in all frames; else blend = "nearest"'
            raise Refused("blend", reason, allowed, source=self._frames.names[i + 1])
        vertices = before.vertices + weight * (after.vertices - before.vertices)
        normals = (1.0 - weight) * before.vertex_normals + weight * after.vertex_normals
        length = np.linalg.norm(normals, axis=1)
        # opposite normals nearly cancel, which leaves no direction
        normals[length < 1e-3] = before.vertex_normals[length < 1e-3]
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        return TriangleMesh(vertices, before.faces, normals, overhangs=True)

    def to_config(self) -> dict[str, Any]:
        """Return the source (absolute paths) and options as plain data; see `sea_from_config`."""
        config = self.model_dump(mode="json", exclude_unset=True)
        source = self.source
        absolute = abspath(source) if isinstance(source, str) else list(map(abspath, source))
        return {"kind": self.kind} | config | {"source": absolute}

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MeshSequence) and self.to_config() == other.to_config()

    def __hash__(self) -> int:
        return hash(self.source)

    def __reduce__(self) -> tuple[Any, ...]:
        # without frames and lock
        return type(self).model_validate, (self.to_config(),)
