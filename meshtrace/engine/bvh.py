"""Ray-mesh intersection: Embree, by its C interface or by embreex; brute force, its reference.

All return only the index of the first facet along each ray: distance and barycentrics follow in
double precision from the corners of the facet, so that the single precision of Embree decides only
between neighbours at an edge.

The wheel of the Python package embreex contains the shared library of Embree. Called through
ctypes, the library reads the arrays of a mesh where they are; embreex copies them facet by facet in
Python. It takes over, with the same hits, where the library is missing, lacks a function or reports
an error. Where embreex has no wheel rays walk over bins of the mesh, `kernels.walk`.

References
----------
Intel, "Embree API reference", version 4.4, https://github.com/RenderKit/embree.
"""

from __future__ import annotations

import ctypes
import math
import warnings
import weakref
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, cached_property
from importlib import metadata
from itertools import pairwise
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.checks import Shape, check_call, check_methods
from meshtrace.errors import Described, Refused
from meshtrace.kernels.interface import Triangles, corners, facet_hits
from meshtrace.kernels.jit import allocating_entry, config
from meshtrace.kernels.rays import RAY_WORDS, Bvh, Word, aligned_rays, bvh_of, cast
from meshtrace.kernels.scene import Locator, count_bins, fill_bins
from meshtrace.kernels.vectors import cross, dot, minus, row
from meshtrace.kernels.walk import packed, walker
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import default_threads, ordered_map

# Constants of `rtcore_geometry.h`, `rtcore_buffer.h`, `rtcore_common.h` and `rtcore_scene.h`.
_TRIANGLES = 0  # RTC_GEOMETRY_TYPE_TRIANGLE
_INDEX, _VERTEX = 0, 1  # RTC_BUFFER_TYPE_*
_UINT3, _FLOAT3 = 0x5003, 0x9003  # RTC_FORMAT_*
_ROBUST = 1 << 2  # RTC_SCENE_FLAG_ROBUST
_ROW = 12  # bytes of three 32-bit numbers
_MOST_BINS = 2048  # along a side, of a scene without Embree: 32 MB for the starts of their lists
_NONE = np.zeros(0, np.int32)
_BLOCK = 64  # rays prepared at a time: 8 kB, 128 bytes each, stay in the fastest cache

_POINTER, _UINT, _SIZE = ctypes.c_void_p, ctypes.c_uint, ctypes.c_size_t
# Types of result and arguments by function: undeclared, ctypes passes addresses as 32-bit integers.
_FUNCTIONS: dict[str, tuple[Any, ...]] = {
    "rtcNewDevice": (_POINTER, ctypes.c_char_p),
    "rtcGetDeviceError": (_UINT, _POINTER),
    "rtcNewScene": (_POINTER, _POINTER),
    "rtcSetSceneFlags": (None, _POINTER, _UINT),
    "rtcNewGeometry": (_POINTER, _POINTER, _UINT),
    "rtcSetSharedGeometryBuffer": (
        *(None, _POINTER, _UINT, _UINT, _UINT),
        *(_POINTER, _SIZE, _SIZE, _SIZE),
    ),
    "rtcCommitGeometry": (None, _POINTER),
    "rtcAttachGeometry": (_UINT, _POINTER, _POINTER),
    "rtcReleaseGeometry": (None, _POINTER),
    "rtcCommitScene": (None, _POINTER),
    "rtcReleaseScene": (None, _POINTER),
    "rtcIntersect1": (None, _POINTER, _POINTER, _POINTER),
}


def new_scene(vertices: Floats, faces: NDArray[np.integer[Any]]) -> RayScene:
    """Return a committed scene of a mesh in robust mode, in single precision."""
    embree = library()
    # no warning for a missing library, since hits are the same; one for a library that fails
    if embree is not None:
        try:
            return SharedScene(embree, vertices, faces)
        except OSError as error:
            warnings.warn(f"{error}; embreex is used, which is slower", stacklevel=2)
    try:
        return CopiedScene(vertices, faces)
    except ImportError:
        _tell_walk()
        return WalkedScene(vertices, faces)


@cache
def _tell_walk() -> None:
    """Warn, once per process, that rays are followed without Embree."""
    warnings.warn(
        "embreex is not installed: rays walk over bins of the mesh, to the same facets",
        stacklevel=2,
    )


@cache
def library() -> ctypes.CDLL | None:
    """Return the Embree library of the embreex wheel; None if it cannot be loaded.

    Its functions have the types of `_FUNCTIONS`.
    """
    if config.DISABLE_JIT:  # rays are cast by compiled code
        return None
    try:
        import embreex.rtcore  # noqa: F401 - loads what the library depends on

        files = metadata.files("embreex") or []
        names = (f for f in files if "embree4" in f.name and f.suffix != ".py")
        functions = ctypes.CDLL(str(next(names).locate()))
        for name, (result, *arguments) in _FUNCTIONS.items():
            function = getattr(functions, name)
            function.restype, function.argtypes = result, arguments
        return functions if _device_of(functions) else None
    except (ImportError, OSError, AttributeError, StopIteration):  # whatever a platform lacks
        return None


@cache
def _device_of(rtc: ctypes.CDLL) -> int | None:
    """Return the address of the one RTCDevice: devices are costly, scenes are not."""
    address: int | None = rtc.rtcNewDevice(None)
    return address


class _Called:
    """Base of the scenes whose rays a C function answers."""

    function: tuple[int, int]
    """Address of the function that casts a ray, and its first argument, the scene."""

    def run(self, origins: Rays, directions: Rays) -> NDArray[np.int32]:
        """Return the first facet of each ray, -1 for a miss; thread-safe, on one thread."""
        out = np.empty(len(origins), np.int32)
        block = aligned_rays(_BLOCK)
        rays = np.ascontiguousarray(origins), np.ascontiguousarray(directions)
        cast(*self.function, block, block.view(np.int32), *rays, out)
        return out


def filled_bins(
    x: float, y: float, step: float, shape: tuple[int, int], vertices: Floats,
    faces: NDArray[np.int32],
) -> Locator:  # fmt: skip
    """Return bins from the corner (x, y) on, with the facets that may touch each."""
    empty = Locator(x, y, step, *shape, np.zeros(math.prod(shape) + 1, np.int64), _NONE)
    # counting sort: one array of facets ordered by bin, and the start of each bin in it
    places = np.empty((len(vertices), 2), np.int64)
    count_bins(vertices, faces, empty, places)
    np.cumsum(empty.start, out=empty.start)
    bins = empty._replace(facet=np.empty(empty.start[-1], np.int32))
    fill_bins(faces, bins, places, bins.start[:-1].copy())
    return bins


class WalkedScene(_Called):
    """Scene of `kernels.walk`, with the single-precision vertices of Embree."""

    def __init__(self, vertices: Floats, faces: NDArray[np.integer[Any]]) -> None:
        corners = np.asarray(vertices, np.float32).astype(np.float64)
        facets = np.ascontiguousarray(faces, np.int32)
        low, size = corners.min(axis=0), np.ptp(corners, axis=0)
        # half the mean edge of a square of two facets: a fine part of a mesh has more a bin
        step = 0.5 * math.sqrt(max(2.0 * size[0] * size[1] / len(facets), 1e-12))
        nx, ny = (min(int(size[k] / step) + 1, _MOST_BINS) for k in (0, 1))
        step = max(step, size[0] / nx, size[1] / ny)
        bins = filled_bins(float(low[0]), float(low[1]), step, (nx, ny), corners, facets)
        self._numbers = packed(corners, facets, bins)
        self.function = walker().address, self._numbers.ctypes.data


class SharedScene(_Called):
    """Scene of the C interface over single-precision arrays of the mesh, which Embree shares.

    Raises
    ------
    OSError
        If Embree reports an error.
    """

    def __init__(self, rtc: ctypes.CDLL, vertices: Floats, faces: NDArray[np.integer[Any]]) -> None:
        device = _device_of(rtc)
        # Embree reads vertices as 16 bytes, 4 beyond the last one: one more vertex is allocated
        corners = np.zeros((len(vertices) + 1, 3), np.float32)
        corners[:-1] = vertices
        indices = np.ascontiguousarray(faces, np.int32)
        rtc.rtcGetDeviceError(device)  # clears an older one
        scene = rtc.rtcNewScene(device)
        if not scene:
            raise OSError("Embree made no scene")
        # the arrays live as long as the scene that reads them
        self._release = weakref.finalize(self, _release, rtc, scene, corners, indices)
        rtc.rtcSetSceneFlags(scene, _ROBUST)
        geometry = rtc.rtcNewGeometry(device, _TRIANGLES)
        for kind, form, array, n in (
            (_VERTEX, _FLOAT3, corners, len(vertices)),
            (_INDEX, _UINT3, indices, len(indices)),
        ):
            start = array.ctypes.data
            # geometry, type, slot, format, address, offset and stride in bytes, number of items
            rtc.rtcSetSharedGeometryBuffer(geometry, kind, 0, form, start, 0, _ROW, n)
        # committed here: a scene that its first ray commits would do so in two threads at once
        rtc.rtcCommitGeometry(geometry)
        rtc.rtcAttachGeometry(scene, geometry)
        rtc.rtcReleaseGeometry(geometry)
        rtc.rtcCommitScene(scene)
        code = rtc.rtcGetDeviceError(device)
        if code:
            self._release()
            raise OSError(f"error {code} of Embree")
        self.function = ctypes.cast(rtc.rtcIntersect1, _POINTER).value or 0, scene


def _release(rtc: Any, scene: int, *arrays: NDArray[Any]) -> None:
    """Release a scene; the arrays it reads are arguments so that they live until then."""
    rtc.rtcReleaseScene(scene)


@cache
def _device() -> Any:
    """Return the one device of embreex."""
    from embreex.rtcore import EmbreeDevice

    return EmbreeDevice()


class CopiedScene:
    """Scene of embreex, with a copy of the mesh."""

    def __init__(self, vertices: Floats, faces: NDArray[np.integer[Any]]) -> None:
        from embreex.mesh_construction import TriangleMesh as EmbreeMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene(_device(), robust=True)
        EmbreeMesh(self._scene, vertices.astype(np.float32), faces.astype(np.int32, copy=False))
        # the first query commits the scene, which must not happen in two threads at once
        self._scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))

    def run(self, origins: Rays, directions: Rays) -> NDArray[np.int32]:
        """Return the first facet of each ray, -1 for a miss; thread-safe, one thread."""
        return self._scene.run(origins, directions)


class Hits(NamedTuple):
    """First intersections of rays with a mesh.

    Attributes
    ----------
    facet : ndarray of int32, shape (n,)
        Index of the facet, -1 for a miss.
    distance : ndarray, shape (n,)
        Distance along the ray, in lengths of its direction (for a unit vector, in the unit of the
        mesh); inf for a miss.
    u, v : ndarray, shape (n,)
        Barycentrics of the point: (1 - u - v) p0 + u p1 + v p2; nan for a miss.
    """

    facet: NDArray[np.int32]
    distance: Floats
    u: Floats
    v: Floats


RayScene = SharedScene | CopiedScene | WalkedScene
"""Scene of a mesh, whose `run` finds the first facets of rays."""
# scenes that live as long as their meshes
_SCENES: weakref.WeakKeyDictionary[TriangleMesh, RayScene] = weakref.WeakKeyDictionary()


Rays = Annotated[NDArray[np.float32], Shape("n 3")]
"""Origins or directions of rays."""


def _require_pairs(origins: NDArray[Any], directions: NDArray[Any]) -> None:
    """Refuse arrays of origins and directions of different shapes."""
    if origins.shape != directions.shape:
        other = Described(f"shape {directions.shape}")
        raise Refused("directions", other, f"that of origins, {origins.shape}")


@check_methods
class Intersector(ABC):
    """Base of the ray-mesh intersectors; `facets` is all that a subclass has to define.

    Parameters
    ----------
    mesh : TriangleMesh
        The surface.
    """

    threads = 1
    # Whether kernels may use `kernels.rays.grid_facet` in its place. An intersector of a user may
    # see another surface than the mesh: it is asked for every ray.
    shortcut = False

    @check_call
    def __init__(self, mesh: TriangleMesh) -> None:
        self.mesh = mesh

    def for_mesh(self, mesh: TriangleMesh) -> Self:
        """Return an intersector of the same kind over another mesh."""
        return type(self)(mesh)

    @abstractmethod
    def facets(self, origins: Rays, directions: Rays) -> NDArray[np.int32]:
        """Return the first facet of each ray, -1 for a miss; thread-safe, one thread."""

    @contextmanager
    def function(self) -> Iterator[Bvh]:
        """Yield `facets` as a C function, a stand-in for rtcIntersect1, for kernels of one thread.

        An error that `facets` raises is raised when the context ends.
        """
        # no exception can pass through a compiled kernel: the ray counts as a miss until the end
        errors: list[Exception] = []

        def first(scene: int, address: int, _: int) -> None:
            # `address` is that of an RTCRayHit: origin and direction in, the facet out
            ray = np.ctypeslib.as_array((ctypes.c_float * RAY_WORDS).from_address(address))
            start, way = ray[Word.ORIGIN :][:3], ray[Word.DIRECTION :][:3]
            try:
                ray.view(np.int32)[Word.FACET] = self.facets(start[None], way[None])[0]
            except Exception as error:
                errors.append(error)

        # a local name keeps the callback: its address would dangle if it were collected
        callback = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3)(first)
        yield bvh_of(int(ctypes.cast(callback, ctypes.c_void_p).value or 0), 0)
        if errors:
            raise errors[0]

    def intersect(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        """Return the first hit of each ray, rays spread over the threads.

        Parameters
        ----------
        origins, directions : array_like, shape (n, 3)
            Rays; directions need not be unit vectors: distances are in units of their lengths.
        """
        # writable: for read-only arrays numba would compile again
        o, d = (np.require(a, np.float64, ["C", "W"]) for a in (origins, directions))
        for name, array in (("origins", o), ("directions", d)):
            if array.ndim != 2 or array.shape[1] != 3 or not np.isfinite(array).all():
                raise Refused(name, Described(f"shape {array.shape}"), "finite (n, 3)")
        _require_pairs(o, d)
        triangles = Triangles(self.mesh.vertices, self.mesh.faces, self.mesh.face_normals)

        def hits(part: slice) -> Hits:
            # single precision decides on the facet alone, see the docstring of the module
            facet = self.facets(o[part].astype(np.float32), d[part].astype(np.float32))
            return Hits(facet, *facet_hits(facet, o[part], d[part], triangles))

        # Few rays do not pay for threads.
        threads = self.threads if len(o) >= 2 * self.threads else 1
        bounds = np.linspace(0, len(o), threads + 1, dtype=int)
        parts = ordered_map(hits, (slice(*ends) for ends in pairwise(bounds)), threads)
        return Hits(*(np.concatenate(field) for field in zip(*parts, strict=True)))


@check_methods
class EmbreeIntersector(Intersector):
    """Embree BVH over a triangle mesh, in robust mode.

    Parameters
    ----------
    mesh : TriangleMesh
        The surface; its corners are copied in single precision.
    threads : int, optional
        Threads that `intersect` spreads its rays over; all cores by default.

    Notes
    -----
    Rays are answered one by one without the GIL, so chunks in threads scale. Packets of 16 rays
    (`rtcIntersect16`) take as long per ray as single ones, in any order of the rays. A moving sea
    is a new intersector for each time step.
    """

    shortcut = True

    def __init__(self, mesh: TriangleMesh, threads: int | None = None) -> None:
        super().__init__(mesh)
        self.threads = default_threads(threads)

    def built(self) -> Self:
        """Return the intersector with its scene, which is otherwise built by the first ray."""
        _ = self._scene
        return self

    @cached_property
    def _scene(self) -> RayScene:
        """Scene of the mesh, which all its intersectors share."""
        # by weak reference: when nothing else refers to a mesh, its scene goes with it
        scene = _SCENES.get(self.mesh)
        if scene is None:
            scene = _SCENES[self.mesh] = new_scene(self.mesh.vertices, self.mesh.faces)
        return scene

    def for_mesh(self, mesh: TriangleMesh) -> Self:
        """Return an intersector of the same kind over another mesh."""
        return type(self)(mesh, self.threads)

    def facets(self, origins: Rays, directions: Rays) -> NDArray[np.int32]:
        """Return the first facet of each ray, -1 for a miss; thread-safe, one thread."""
        _require_pairs(origins, directions)
        return self._scene.run(origins, directions)

    @contextmanager
    def function(self) -> Iterator[Bvh]:
        """Yield the function of Embree for the kernels of one thread."""
        # a subclass with other facets is asked through Python
        if type(self).facets is EmbreeIntersector.facets and isinstance(self._scene, _Called):
            yield bvh_of(*self._scene.function)
            return
        with super().function() as python:
            yield python


@check_methods
class BruteForceIntersector(Intersector):
    """Brute force: every ray against every facet in double precision, the reference of tests."""

    def facets(self, origins: Rays, directions: Rays) -> NDArray[np.int32]:
        """Return the first facet of each ray, -1 for a miss; thread-safe."""
        _require_pairs(origins, directions)
        rays = origins.astype(np.float64), directions.astype(np.float64)
        return _first_facets(*rays, self.mesh.vertices, self.mesh.faces)


@allocating_entry
def _first_facets(
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
) -> NDArray[np.int32]:
    """Return the nearest facet of each ray by Moller and Trumbore (1997).

    Array twin: `EmbreeIntersector.facets`, of which this is the reference, in double precision and
    without bounding volumes.
    """
    out = np.full(len(origins), -1, np.int32)
    for i in range(len(origins)):
        o, d = row(origins, i), row(directions, i)
        # no hierarchy, no tolerance: the nearest of all facets, the first of equal ones
        nearest = np.inf
        for f in range(len(faces)):
            a, b, c = corners(vertices, f, faces)
            e1, e2, s = minus(b, a), minus(c, a), minus(o, a)
            p = cross(d, e2)
            # Moller and Trumbore (1997): Cramer's rule for t, u, v in o + t d = a + u e1 + v e2
            det = dot(e1, p)
            if det == 0.0:
                continue
            u = dot(s, p) / det
            if u < 0.0 or u > 1.0:
                continue
            q = cross(s, e1)
            v = dot(d, q) / det
            if v < 0.0 or u + v > 1.0:
                continue
            t = dot(e2, q) / det
            if 0.0 <= t < nearest:
                nearest = t
                out[i] = f
    return out
