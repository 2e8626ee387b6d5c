"""Sea and daylight as the rays of a receiver meet them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.bvh import EmbreeIntersector
from meshtrace.daylight.light import Daylight
from meshtrace.daylight.water_leaving import QuasiSingle
from meshtrace.kernels.facets import Surface
from meshtrace.link import Link
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.results.background import PARTS
from meshtrace.transport.arrays import surface_arrays
from meshtrace.transport.frame import frame_of

SKY, GLINT, WATER, FOAM, SUN = range(len(PARTS))


class Scene(NamedTuple):
    """Sea and light that the rays of a view meet."""

    intersector: EmbreeIntersector
    surface: Surface
    day: Daylight
    n: float  # index of the water over that of the air
    foam: float  # share of the surface
    water: QuasiSingle | None
    second_hits: bool

    @property
    def rough(self) -> bool:
        """Whether the mesh leaves out slopes."""
        return self.surface.roughness.along > 0.0 or self.surface.roughness.across > 0.0


def scene_of(link: Link, mesh: TriangleMesh, day: Daylight, normals: str, threads: int) -> Scene:
    """Return sea and light in the local coordinates of a link."""
    local = frame_of(link).mesh(mesh)
    water = None
    if day.water == "quasi-single":
        water = QuasiSingle(link.water, link.bubbles, link.n_air, day)
    return Scene(
        EmbreeIntersector(local, threads),
        surface_arrays(local, normals, link.physics.unresolved),
        day,
        link.water.n / link.n_air,
        1.0 - link.whitecaps.transmittance if link.whitecaps else 0.0,
        water,
        link.physics.second_hit == "trace",
    )


class Hit(NamedTuple):
    """Points where rays meet the sea: facet normal, and normal for the bending of light."""

    point: Floats
    facet_normal: Floats
    normal: Floats


def first_hits(
    scene: Scene, origin: Floats, direction: Floats, *, below: bool = False
) -> tuple[Hit, NDArray[np.bool_]]:
    """Return the hits of rays on the sea, level beyond the mesh, and the mask of rays with one.

    Rays come from the air, or from `below`.
    """
    side = -1.0 if below else 1.0
    hits, surface = scene.intersector.intersect(origin, direction), scene.surface
    facet = hits.facet
    facet_normal = surface.face_normals[facet]
    on_mesh = (facet >= 0) & (side * np.einsum("ij,ij->i", facet_normal, direction) < 0.0)
    level = -origin[:, 2] / np.where(direction[:, 2] == 0.0, math.inf, direction[:, 2])
    distance = np.where(on_mesh, hits.distance, np.maximum(level, 0.0))
    point = origin + distance[:, None] * direction
    normal = facet_normal
    if surface.interpolate:
        a, b, c = (surface.vertex_normals[surface.faces[facet, i]] for i in range(3))
        u, v = (np.where(on_mesh, w, 0.0)[:, None] for w in (hits.u, hits.v))
        normal = (1.0 - u - v) * a + u * b + v * c
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    up = np.array([0.0, 0.0, 1.0])
    facet_normal = np.where(on_mesh[:, None], facet_normal, up)
    normal = np.where(on_mesh[:, None], normal, up)
    behind = side * np.einsum("ij,ij->i", normal, direction) >= 0.0
    normal[behind] = facet_normal[behind]
    return Hit(point, facet_normal, normal), on_mesh | (side * direction[:, 2] < 0.0)
