"""Meshes in time, from files."""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Sequence
from os.path import abspath
from threading import Lock
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import PrivateAttr

from meshtrace.errors import Described, Refused, reason_of, require_whole
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Model

from .foreign_mesh import from_trimesh
from .frames import Frames, open_frames
from .parameters import TIME, Floats, Positive

_KEPT = 2  # frames in memory
_DEEPEST = 50.0  # [m]: higher numbers are millimetres, no waves
_AXES = {"x": (1, 2, 0), "y": (2, 0, 1), "z": (0, 1, 2)}  # cyclic: no mirror


def _plain(value: Any) -> Any:
    """Return paths as text, and arrays as tuples."""
    if isinstance(value, str | os.PathLike):
        return os.fspath(value)
    if isinstance(value, np.ndarray):
        return tuple(value.tolist())
    return tuple(map(_plain, value)) if isinstance(value, Sequence) else value


class MeshSequence(Model, frozen=True):
    """A surface as meshes in files, one a time.

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
        Unit of length of the files [m], > 0. By default that which netCDF and HDF5 files name,
        and 1 m for others.
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
        If no frames are found, or the times do not increase.

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
    _at: Floats = PrivateAttr()
    _kept: OrderedDict[int, TriangleMesh] = PrivateAttr(default_factory=OrderedDict)
    _lock: Any = PrivateAttr(default_factory=Lock)

    def __init__(
        self,
        source: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | None = None,
        times: ArrayLike | None = None,
        **options: Any,
    ) -> None:
        given = {"source": _plain(source), "times": _plain(times)}
        super().__init__(**{k: v for k, v in given.items() if v is not None}, **options)

    def model_post_init(self, context: Any) -> None:
        """List the frames and their times."""
        self._frames = open_frames(self.source)
        self._at = self._read_times()

    def _read_times(self) -> Floats:
        at, n = self._frames.times, len(self._frames)
        if self.times is not None:
            at = np.array(self.times)
        elif self.frame_rate is not None:
            at = np.arange(n) / self.frame_rate
        elif at is None and n == 1:
            at = np.zeros(1)
        if at is None:
            raise Refused("times", None, "times [s] or frame_rate, for frames without times")
        if len(at) != n:
            raise Refused("times", Described(f"{len(at)} times for {n} frames"), "one a frame")
        if not np.isfinite(at).all() or not (np.diff(at) > 0.0).all():
            raise Refused("times", Described("not increasing"), "increasing times [s], all finite")
        return at

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, i: int) -> TriangleMesh:
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
        with self._lock:
            if i not in self._kept:
                self._kept[i] = self._read(i)
                while len(self._kept) > _KEPT:
                    self._kept.popitem(last=False)
            self._kept.move_to_end(i)
            return self._kept[i]

    def _read(self, i: int) -> TriangleMesh:
        name = self._frames.name(i)
        try:
            vertices, faces = self._frames.read(i)
            unit = self.scale if "scale" in self.model_fields_set else self._frames.metres()
            if unit is None:
                raise Refused("source", Described("no units"), "x, y, z in m, cm or mm, or scale")
            vertices = unit * vertices[:, _AXES[self.up]]
            largest = float(np.abs(vertices[:, 2]).max()) if len(vertices) else 0.0
            if largest > _DEEPEST and "scale" not in self.model_fields_set:
                found = Described(f"heights up to {largest:g} m look like mm")
                raise Refused("scale", found, f"heights within {_DEEPEST:g} m, or scale")
            return from_trimesh((vertices, faces), overhangs=True, normals=self.normals)
        except Refused as error:
            raise error.of("" if error.field == name else name) from error.__cause__
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
        """Return the mesh at a time [s], on the facets of the frames; `extent` has no effect.

        Raises
        ------
        Refused
            If the time lies outside the record, a frame cannot be read or is no surface (see
            `from_trimesh`), or frames of other facets are to be blended.
        """
        at, time = self._at, TIME.check(time)
        if not at[0] - 1e-9 <= time <= at[-1] + 1e-9:
            raise Refused("time", time, f"{at[0]:g} <= time <= {at[-1]:g} s, the record")
        if self.blend == "nearest" or len(at) == 1:
            return self.frame(int(np.abs(at - time).argmin()))
        i = int(np.clip(np.searchsorted(at, time, side="right") - 1, 0, len(at) - 2))
        share = min(max((time - at[i]) / (at[i + 1] - at[i]), 0.0), 1.0)
        if share in (0.0, 1.0):
            return self.frame(i + int(share))
        return self._blended(i, share)

    def _blended(self, i: int, share: float) -> TriangleMesh:
        before, after = self.frame(i), self.frame(i + 1)
        if not np.array_equal(before.faces, after.faces):
            found = Described(f'"linear" from {len(before.faces)} to {len(after.faces)} facets')
            allowed = 'the same facets in all frames; else blend = "nearest"'
            raise Refused("blend", found, allowed, source=self._frames.name(i + 1))
        vertices = before.vertices + share * (after.vertices - before.vertices)
        normals = (1.0 - share) * before.vertex_normals + share * after.vertex_normals
        length = np.linalg.norm(normals, axis=1)
        normals[length < 1e-3] = before.vertex_normals[length < 1e-3]  # opposite ones
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        return TriangleMesh(vertices, before.faces, normals, overhangs=True)

    def to_config(self) -> dict[str, Any]:
        """Return the source (absolute paths) and options as plain data; see `sea_from_config`."""
        config = self.model_dump(mode="json", exclude_unset=True)
        source = self.source
        whole = abspath(source) if isinstance(source, str) else list(map(abspath, source))
        return {"kind": self.kind, **config, "source": whole}

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MeshSequence) and self.to_config() == other.to_config()

    def __hash__(self) -> int:
        return hash(self.source)

    def __reduce__(self) -> tuple[Any, ...]:
        # without frames and lock
        return type(self).model_validate, (self.to_config(),)
