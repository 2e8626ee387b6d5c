"""Triangle meshes of the sea surface, and the interface of the surface models."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from os import PathLike, fspath
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BeforeValidator, PlainSerializer

from meshtrace.checks import Shape, check_call
from meshtrace.errors import Described, Refused, require_array, require_range

if TYPE_CHECKING:
    import trimesh

FARTHEST = 1e6  # largest coordinate [m]; single precision and integer bins still hold it


@runtime_checkable
class MeshSource(Protocol):
    """Protocol of a surface that gives a mesh at any time.

    All lengths in m, times in s; z is up and still water lies at z = 0.
    """

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
        """Return the triangulated surface over |x - xc|, |y - yc| <= extent."""
        ...

    def to_config(self) -> dict[str, Any]:
        """Return the parameters as plain data that `surfaces.sea_from_config` loads back."""
        ...


@runtime_checkable
class SurfaceModel(MeshSource, Protocol):
    """A sea surface that can be evaluated anywhere and triangulated at any time."""

    def elevation(self, x: ArrayLike, y: ArrayLike, time: float = 0.0) -> NDArray[np.float64]:
        """Return the elevation [m] at (x, y, time)."""
        ...

    def slopes(
        self, x: ArrayLike, y: ArrayLike, time: float = 0.0
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the slopes dz/dx and dz/dy at (x, y, time)."""
        ...


@runtime_checkable
class PlaneSurface(SurfaceModel, Protocol):
    """Protocol of a plane, which facets of any size represent exactly."""

    @property
    def gradient(self) -> tuple[float, float]:
        """Slopes dz/dx and dz/dy."""
        ...


@runtime_checkable
class SeededSurface(SurfaceModel, Protocol):
    """A sea whose phases come from a seed."""

    def with_seed(self, seed: int) -> SeededSurface:
        """Return the same sea with other phases."""
        ...


@runtime_checkable
class WaveSum(SurfaceModel, Protocol):
    """A sea composed of plane waves."""

    @property
    def components(self) -> Any:
        """Amplitudes, frequencies, wave vectors and phases as arrays."""
        ...


def require_surface(surface: Any) -> None:
    """Refuse anything but a `MeshSource` or a `TriangleMesh`."""
    if not isinstance(surface, MeshSource | TriangleMesh):
        kind = Described(type(surface).__name__)
        raise Refused("surface", kind, "a sea (SurfaceModel) or a TriangleMesh")


class Cumulants(NamedTuple):
    """Third and fourth cumulants of slopes, 0 for Gaussian ones.

    Parameters
    ----------
    along3, along_across2 : float
        <a^3> and <a c^2> of the slopes a along the wind, positive for ascent in the direction the
        wind blows to, and c across it.
    along4, along2_across2, across4 : float
        <a^4> - 3 <a^2>^2, <a^2 c^2> - <a^2> <c^2> and <c^4> - 3 <c^2>^2.
    """

    along3: float = 0.0
    along_across2: float = 0.0
    along4: float = 0.0
    along2_across2: float = 0.0
    across4: float = 0.0


class UnresolvedSlopes(NamedTuple):
    """Slopes, along and across the wind, of the waves that are too short for a mesh.

    Light that crosses the mesh is bent as if the normal were tilted by random slopes of these
    variances and cumulants, on top of those of the mesh.

    Parameters
    ----------
    vertex : tuple of float
        Slope variances that normals interpolated from the corners leave out.
    facet : tuple of float
        Slope variances that the facets' own normals leave out.
    direction_deg : float
        Direction the wind blows to, counter-clockwise from +x [deg].
    cumulants : Cumulants
        Third and fourth cumulants. Those of the whole sea: cumulants of independent slopes add, and
        those of Gaussian ones, which a sum of waves has, are 0.
    """

    vertex: tuple[float, float]
    facet: tuple[float, float]
    direction_deg: float = 0.0
    cumulants: Cumulants = Cumulants()


def _array(value: Any, name: str, shape: str, least: int, dtype: Any = float) -> NDArray[Any]:
    """Return a value as an array (n, 3), n >= `least`; `shape` is its text in a refusal."""
    array = require_array(value, f"mesh.{name}", f"an array {shape}", dtype)
    if array.ndim != 2 or array.shape[1] != 3 or len(array) < least:
        raise Refused(f"mesh.{name}", Described(f"shape {array.shape}"), shape)
    return array


def _corner_indices(faces: NDArray[Any]) -> NDArray[np.int32]:
    """Return faces as read-only int32, the only type that kernels are compiled for."""
    # Read-only, as are the faces that grids of one shape share. A view, so that the array of the
    # caller stays as it is.
    faces = faces.astype(np.int32, copy=False).view()
    faces.flags.writeable = False
    return faces


class _Facets(NamedTuple):
    """Geometry of the facets of a mesh, computed in one pass."""

    normals: NDArray[np.float64]  # (m, 3) unit
    double_areas: NDArray[np.float64]  # (m,) twice the areas [m2]
    bounds: NDArray[np.float64]  # (2, 3) lowest and highest coordinates [m]
    max_slope: float  # of the steepest facet

    @classmethod
    def from_arrays(cls, vertices: NDArray[np.float64], faces: NDArray[Any]) -> _Facets:
        """Return the geometry of vertices (n, 3) [m] and faces (m, 3)."""
        from meshtrace.kernels.scene import facet_normals

        vertices, faces = np.require(vertices, np.float64, ["C", "W"]), _corner_indices(faces)
        normals, double_areas = np.empty((len(faces), 3)), np.empty(len(faces))
        low, high, squared_slope = facet_normals(vertices, faces, normals, double_areas)
        return cls(normals, double_areas, np.array([low, high]), math.sqrt(squared_slope))


@check_call
def vertex_normals(
    vertices: Annotated[NDArray[np.float64], Shape("n 3")],
    faces: NDArray[Any],
    weights: Literal["area", "angle"] = "area",
) -> NDArray[np.float64]:
    """Return the mean unit normals of the facets at each corner.

    Parameters
    ----------
    vertices : ndarray, shape (n, 3)
        Corner positions [m].
    faces : ndarray of int, shape (m, 3)
        Corner indices.
    weights : {"area", "angle"}
        Weights of the facets: their areas, or their angles at the corner, with which the mean
        does not depend on the way in which a polygon is split.

    Returns
    -------
    ndarray, shape (n, 3)
        Unit normals; corners that no facet uses point up.

    References
    ----------
    G. Thuermer and C. A. Wuethrich, "Computing vertex normals from polygonal facets", Journal of
    Graphics Tools 3 (1998).
    """
    faces = _array(faces, "faces", "(m, 3), m >= 1", 1, np.int64)
    require_range(faces, 0, len(vertices) - 1, "faces")
    (units, double_areas, *_), corner = _Facets.from_arrays(vertices, faces), vertices[faces]
    # normals times twice the areas; the normal of a facet without area is nan, and its weight 0
    cross = np.where(double_areas > 0.0, units.T * double_areas, 0.0).T
    normals = np.zeros_like(vertices)
    for i in range(3):
        weighted = cross
        if weights == "angle":
            u, v = corner[:, (i + 1) % 3] - corner[:, i], corner[:, (i + 2) % 3] - corner[:, i]
            # |u x v| is twice the area: tan(angle) = |u x v| / (u . v), accurate near 0 and pi, too
            angle = np.arctan2(double_areas, np.einsum("ij,ij->i", u, v))
            weighted = cross * (angle / np.where(double_areas > 0.0, double_areas, 1.0))[:, None]
        # `add.at` sums over repeated indices: a corner belongs to several facets
        np.add.at(normals, faces[:, i], weighted)
    length = np.linalg.norm(normals, axis=1)
    normals[length == 0.0] = (0.0, 0.0, 1.0)
    length[length == 0.0] = 1.0
    return normals / length[:, None]


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """An open surface of triangles: the sea seen from the air.

    Parameters
    ----------
    vertices : array_like, shape (n, 3)
        Corner positions [m].
    faces : array_like of int, shape (m, 3)
        Corner indices, counter-clockwise seen from the air, so that every facet normal
        points to the air.
    vertex_normals : array_like, shape (n, 3), optional
        Unit normals at the corners, pointing to the air. Surface models pass the normals of
        their exact slopes; without them the area-weighted mean of the adjacent facets is used.
    unresolved : UnresolvedSlopes, optional
        Slopes that the mesh leaves out.
    overhangs : bool
        Allow facets that stand upright or face down. Otherwise every normal points up.

    Raises
    ------
    Refused
        If an array has the wrong shape, is not finite, a facet has no area, or a normal does
        not point up where `overhangs` does not allow it.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    vertex_normals: NDArray[np.float64] = None  # type: ignore[assignment]
    unresolved: UnresolvedSlopes | None = None
    overhangs: bool = False

    def __post_init__(self) -> None:
        vertices = _array(self.vertices, "vertices", "(n >= 3, 3)", 3)
        faces = _array(self.faces, "faces", "(m >= 1, 3)", 1, None)
        largest = float(np.abs(vertices).max())
        # "not <=": nan is refused, too
        if not largest <= FARTHEST:
            raise Refused("mesh.vertices", largest, f"coordinates within {FARTHEST:g} m")
        low, high = faces.min(), faces.max()
        if faces.dtype.kind not in "iu" or low < 0 or high >= len(vertices):
            kind = Described(f"{faces.dtype} {low}..{high}")
            raise Refused("mesh.faces", kind, f"integers 0..{len(vertices) - 1}")
        faces, vertices = _corner_indices(faces), np.require(vertices, requirements="W")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)
        up = self.face_normals[:, 2]
        if self.overhangs and not np.isfinite(up).all():
            flat = Described(f"{np.count_nonzero(~np.isfinite(up))} facets without area")
            raise Refused("mesh.faces", flat, "facets with an area")
        # "not >": nan, of a facet without area, is refused, too
        if not self.overhangs and not up.min() > 0.0:
            down = Described(f"{np.count_nonzero(~(up > 0.0))} facets do not face up")
            allowed = "counter-clockwise facets of a height field (normal_z > 0)"
            raise Refused("mesh.faces", down, allowed)
        normals = self.vertex_normals
        normals = vertex_normals(vertices, faces) if normals is None else normals
        normals = _array(normals, "vertex_normals", f"{vertices.shape}", len(vertices))
        if normals.shape != vertices.shape:
            shape = Described(f"shape {normals.shape}")
            raise Refused("mesh.vertex_normals", shape, f"{vertices.shape}")
        length = np.sqrt(np.einsum("ij,ij->i", normals, normals))
        upward = self.overhangs or (normals[:, 2] > 0.0).all()
        if not (np.abs(length - 1.0) < 1e-9).all() or not upward:
            other = Described("other vectors")
            raise Refused("mesh.vertex_normals", other, "unit vectors with normal_z > 0")
        object.__setattr__(self, "vertex_normals", np.require(normals, requirements="W"))

    @cached_property
    def _facets(self) -> _Facets:
        return _Facets.from_arrays(self.vertices, self.faces)

    @property
    def face_normals(self) -> NDArray[np.float64]:
        """Unit normals of the facets, shape (m, 3), pointing to the air."""
        return self._facets.normals

    @cached_property
    def facing_down(self) -> int:
        """Number of facets that stand upright or face down."""
        return int(np.count_nonzero(~(self.face_normals[:, 2] > 0.0)))

    @property
    def single_valued(self) -> bool:
        """Whether the surface is a height field: every facet faces up."""
        return self.facing_down == 0

    @cached_property
    def bounds(self) -> NDArray[np.float64]:
        """Lowest and highest coordinates [m], shape (2, 3)."""
        return self._facets.bounds

    @property
    def max_slope(self) -> float:
        """Slope of the steepest facet: a steeper ray meets the surface at most once.

        Infinite if a facet stands upright or hangs over.
        """
        return self._facets.max_slope if self.single_valued else math.inf

    @cached_property
    def sha256(self) -> str:
        """Digest of vertices and faces, which identifies the mesh."""
        return hashlib.sha256(self.vertices.tobytes() + self.faces.tobytes()).hexdigest()

    def to_trimesh(self) -> trimesh.Trimesh:
        """Return the same mesh as a `trimesh.Trimesh`."""
        import trimesh

        return trimesh.Trimesh(
            self.vertices, self.faces, vertex_normals=self.vertex_normals, process=False
        )


READABLE = "a file with a mesh that trimesh reads (OBJ, PLY, STL, ...), or a TriangleMesh"
"""What a `MeshOrFile` may be, for refusals."""


def _path_or_mesh(value: Any) -> Any:
    """Return a path as text or a TriangleMesh unchanged; refuse other types."""
    if value is None or isinstance(value, TriangleMesh):
        return value
    if isinstance(value, str | PathLike):
        return fspath(value)
    # plain data of a result hold no arrays
    is_digest = isinstance(value, Mapping) and "sha256" in value
    kind = "a digest of arrays" if is_digest else type(value).__name__
    raise Refused("", Described(kind), READABLE)


def _path_or_digest(mesh: Any) -> Any:
    """Return the path of a mesh or a digest of the arrays of a TriangleMesh as plain data."""
    if not isinstance(mesh, TriangleMesh):
        return mesh
    return {"sha256": mesh.sha256, "facets": len(mesh.faces)}


MeshOrFile = Annotated[Any, BeforeValidator(_path_or_mesh), PlainSerializer(_path_or_digest)]
"""Field of a model that holds a TriangleMesh or the path of a file with a mesh, or None."""
