"""Ray-mesh intersection: Embree, and brute force as its reference.

Both return the first facet along each ray only: the point, its barycentrics and the normal follow
in double precision from the corners of the facet, so that the single precision of Embree decides
only between neighbours at an edge.
"""

from __future__ import annotations

import ctypes
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.engine.bvh.embree import SharedScene, new_scene
from meshtrace.errors import Described, Refused, require_kind
from meshtrace.kernels.facets import Triangles, corners, facet_hits
from meshtrace.kernels.jit import allocating_entry
from meshtrace.kernels.rays import RAY_WORDS, Bvh, Word, bvh_of
from meshtrace.kernels.vectors import cross, dot, minus, row
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import default_threads, ordered_map


class Hits(NamedTuple):
    """First intersections of rays with a mesh.

    Attributes
    ----------
    facet : ndarray of int32, shape (n,)
        Index of the facet, -1 for a miss.
    distance : ndarray, shape (n,)
        Distance along the ray [m], inf for a miss.
    u, v : ndarray, shape (n,)
        Barycentrics of the point: (1 - u - v) p0 + u p1 + v p2; nan for a miss.
    """

    facet: NDArray[np.int32]
    distance: Floats
    u: Floats
    v: Floats


class Intersector(ABC):
    """Acceleration structure over a triangle mesh, as the tracers use it.

    Parameters
    ----------
    mesh : TriangleMesh
        The surface.
    """

    shortcut = False  # whether facets may be found without it where the answer is known

    def __init__(self, mesh: TriangleMesh) -> None:
        require_kind(mesh, TriangleMesh, "mesh")
        self.mesh = mesh

    def over(self, mesh: TriangleMesh) -> Self:
        """Return an intersector of the same kind over another mesh."""
        return type(self)(mesh)

    @abstractmethod
    def facets(
        self, origins: NDArray[np.float32], directions: NDArray[np.float32]
    ) -> NDArray[np.int32]:
        """Return the first facet of each ray, -1 for a miss; thread-safe, one thread."""

    @contextmanager
    def function(self) -> Iterator[Bvh]:
        """Return `facets` as a C function for the kernels of one thread.

        An error that `facets` raises is raised at the end.
        """
        errors: list[Exception] = []

        def first(scene: int, address: int, _: int) -> None:
            ray = np.ctypeslib.as_array((ctypes.c_float * RAY_WORDS).from_address(address))
            start, way = ray[Word.ORIGIN :][:3], ray[Word.DIRECTION :][:3]
            try:
                ray.view(np.int32)[Word.FACET] = self.facets(start[None], way[None])[0]
            except Exception as error:
                errors.append(error)

        kept = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3)(first)
        yield bvh_of(int(ctypes.cast(kept, ctypes.c_void_p).value or 0), 0)
        if errors:
            raise errors[0]

    def intersect(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        """Return the first hit of each ray."""
        o = np.ascontiguousarray(origins, dtype=np.float64)
        d = np.ascontiguousarray(directions, dtype=np.float64)
        for name, array in (("origins", o), ("directions", d)):
            if array.ndim != 2 or array.shape[1] != 3 or not np.isfinite(array).all():
                raise Refused(name, Described(f"shape {array.shape}"), "finite (n, 3)")
        if o.shape != d.shape:
            other = Described(f"shape {d.shape}")
            raise Refused("directions", other, f"that of origins, {o.shape}")
        facet = self.facets(o.astype(np.float32), d.astype(np.float32))
        triangles = Triangles(self.mesh.vertices, self.mesh.faces, self.mesh.face_normals)
        distance, u, v = facet_hits(facet, o, d, triangles)
        return Hits(facet, distance, u, v)


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
        self._scene = new_scene(mesh.vertices, mesh.faces)

    def over(self, mesh: TriangleMesh) -> Self:
        """Return an intersector of the same kind over another mesh."""
        return type(self)(mesh, self.threads)

    def facets(
        self, origins: NDArray[np.float32], directions: NDArray[np.float32]
    ) -> NDArray[np.int32]:
        """Return the first facet of each ray, -1 for a miss; thread-safe, one thread."""
        return self._scene.run(origins, directions)

    @contextmanager
    def function(self) -> Iterator[Bvh]:
        """Return the function of Embree for the kernels of one thread."""
        if type(self).facets is EmbreeIntersector.facets and isinstance(self._scene, SharedScene):
            yield bvh_of(*self._scene.function)
            return
        with super().function() as python:
            yield python

    def intersect(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        """Return the first hit of each ray, rays spread over the threads.

        Parameters
        ----------
        origins, directions : array_like, shape (n, 3)
            Rays; directions need not be unit vectors, distances are in their length.
        """
        o, d = np.asarray(origins, dtype=float), np.asarray(directions, dtype=float)
        if self.threads == 1 or len(o) < 2 * self.threads:
            return super().intersect(o, d)
        bounds = np.linspace(0, len(o), self.threads + 1, dtype=int)
        chunks, hits = (slice(*ends) for ends in pairwise(bounds)), super().intersect
        parts = ordered_map(lambda chunk: hits(o[chunk], d[chunk]), chunks, self.threads)
        return Hits(*(np.concatenate(field) for field in zip(*parts, strict=True)))


class BruteForceIntersector(Intersector):
    """Brute force: every ray against every facet in double precision, the reference of tests."""

    def facets(
        self, origins: NDArray[np.float32], directions: NDArray[np.float32]
    ) -> NDArray[np.int32]:
        """Return the first facet of each ray, -1 for a miss; thread-safe."""
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
        nearest = np.inf
        for f in range(len(faces)):
            a, b, c = corners(vertices, f, faces)
            e1, e2, s = minus(b, a), minus(c, a), minus(o, a)
            p = cross(d, e2)
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
