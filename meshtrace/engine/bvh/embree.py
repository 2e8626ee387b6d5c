"""Scenes of Embree over triangle meshes: by its C interface, or by embreex.

embreex copies a mesh facet by facet in Python and its wheel holds the library of Embree. Through
ctypes that library reads the arrays where they are. Where it is not found, lacks a function or
reports an error, embreex takes its place with the same hits.

References
----------
Intel, "Embree API reference", version 4.4, https://github.com/RenderKit/embree.
"""

from __future__ import annotations

import ctypes
import warnings
import weakref
from functools import cache
from importlib import metadata
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.jit import config
from meshtrace.kernels.rays import aligned_rays, cast
from meshtrace.models import Floats

_TRIANGLES = 0  # RTC_GEOMETRY_TYPE_TRIANGLE
_INDEX, _VERTEX = 0, 1  # RTC_BUFFER_TYPE_*
_UINT3, _FLOAT3 = 0x5003, 0x9003  # RTC_FORMAT_*
_ROBUST = 1 << 2  # RTC_SCENE_FLAG_ROBUST
_ROW = 12  # bytes of three numbers
_BLOCK = 64  # rays

_POINTER, _UINT, _SIZE = ctypes.c_void_p, ctypes.c_uint, ctypes.c_size_t
_FUNCTIONS: dict[str, tuple[Any, ...]] = {  # result, arguments
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


class Scene(Protocol):
    """Interface of a scene."""

    def run(
        self, origins: NDArray[np.float32], directions: NDArray[np.float32]
    ) -> NDArray[np.int32]:
        """Return the first facet of each ray, -1 for a miss; thread-safe, one thread."""
        ...


class Library(NamedTuple):
    """The library of Embree and its one device: devices are costly, scenes are not."""

    functions: Any
    device: int
    intersect: int  # address of rtcIntersect1


def new_scene(vertices: Floats, faces: NDArray[np.integer[Any]]) -> Scene:
    """Return a committed scene of a mesh in robust mode, in single precision."""
    found = library()
    if found is not None:
        try:
            return SharedScene(found, vertices, faces)
        except OSError as error:
            warnings.warn(f"{error}; embreex is used, which is slower", stacklevel=2)
    return CopiedScene(vertices, faces)


@cache
def library() -> Library | None:
    """Return the library in the wheel of embreex, None if it cannot be used from here."""
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
        device = functions.rtcNewDevice(None)
        intersect = ctypes.cast(functions.rtcIntersect1, _POINTER).value
    except (ImportError, OSError, AttributeError, StopIteration):  # any platform
        return None
    return Library(functions, device, intersect) if device and intersect else None


class SharedScene:
    """Scene of the C interface over the arrays of the mesh, without a copy.

    Raises
    ------
    OSError
        If Embree reports an error.
    """

    def __init__(self, found: Library, vertices: Floats, faces: NDArray[np.integer[Any]]) -> None:
        rtc = found.functions
        # Embree may read 16 bytes at the last vertex
        corners = np.zeros((len(vertices) + 1, 3), np.float32)
        corners[:-1] = vertices
        indices = np.ascontiguousarray(faces, np.int32)
        rtc.rtcGetDeviceError(found.device)  # clears an older one
        scene = rtc.rtcNewScene(found.device)
        if not scene:
            raise OSError("Embree made no scene")
        # the arrays live as long as the scene that reads them
        self._release = weakref.finalize(self, _release, rtc, scene, corners, indices)
        rtc.rtcSetSceneFlags(scene, _ROBUST)
        geometry = rtc.rtcNewGeometry(found.device, _TRIANGLES)
        for kind, form, array, n in (
            (_VERTEX, _FLOAT3, corners, len(vertices)),
            (_INDEX, _UINT3, indices, len(indices)),
        ):
            start = array.ctypes.data
            rtc.rtcSetSharedGeometryBuffer(geometry, kind, 0, form, start, 0, _ROW, n)
        rtc.rtcCommitGeometry(geometry)
        rtc.rtcAttachGeometry(scene, geometry)
        rtc.rtcReleaseGeometry(geometry)
        rtc.rtcCommitScene(scene)
        code = rtc.rtcGetDeviceError(found.device)
        if code:
            self._release()
            raise OSError(f"error {code} of Embree")
        self.function = found.intersect, scene
        """Address of the function that casts a ray, and its first argument."""

    def run(
        self, origins: NDArray[np.float32], directions: NDArray[np.float32]
    ) -> NDArray[np.int32]:
        """Return the first facet of each ray, -1 for a miss; thread-safe, one thread."""
        out = np.empty(len(origins), np.int32)
        block = aligned_rays(_BLOCK)
        rays = np.ascontiguousarray(origins), np.ascontiguousarray(directions)
        cast(*self.function, block, block.view(np.int32), *rays, out)
        return out


def _release(rtc: Any, scene: int, *arrays: NDArray[Any]) -> None:
    """Release a scene; its arrays are arguments so that they live until then."""
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

    def run(
        self, origins: NDArray[np.float32], directions: NDArray[np.float32]
    ) -> NDArray[np.int32]:
        """Return the first facet of each ray, -1 for a miss; thread-safe, one thread."""
        return self._scene.run(origins, directions)
