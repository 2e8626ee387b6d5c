"""View of a receiver: its disk and field of view, and sea and daylight as its rays meet them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.daylight.light import Daylight
from meshtrace.daylight.water_leaving import QuasiSingle
from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.chains.sets import shifted, sobol_points
from meshtrace.engine.setup.arrays import frame_of, surface_arrays
from meshtrace.engine.setup.options import Case
from meshtrace.errors import Described, Refused
from meshtrace.kernels.facets import Surface
from meshtrace.link import Link
from meshtrace.link.receivers import Aperture
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.results.background import PARTS
from meshtrace.stored import SHIFTS

SKY, GLINT, WATER, FOAM, SUN = range(len(PARTS))


class View(NamedTuple):
    """Receiver in local coordinates: disk, line of sight, field of view, and its points."""

    center: Floats
    axis: Floats  # line of sight, from the receiver
    radius: float
    sin2_psi: float  # of half the field of view
    uniforms: Floats  # (rays, 7): disk, cone, tilt of the first reflection

    @classmethod
    def of(cls, link: Link, points: int, seed: int) -> View:
        """Return the view of a link's aperture, in local coordinates."""
        aperture, frame = only_aperture(link), frame_of(link)
        psi = math.radians(0.5 * aperture.fov_deg)
        axis, center = -np.array(aperture.axis), frame.points(np.array(aperture.center))
        uniforms = shifted(*sobol_points(7, points // SHIFTS, (seed, 19)))
        return cls(center, axis, aperture.radius / frame.unit, math.sin(psi) ** 2, uniforms)

    def origins(self) -> Floats:
        """Return points on the disk (rays, 3)."""
        r, phi = self.radius * np.sqrt(self.uniforms[:, 0]), 2 * math.pi * self.uniforms[:, 1]
        e1, e2 = _across(self.axis)
        return self.center + np.outer(r * np.cos(phi), e1) + np.outer(r * np.sin(phi), e2)

    def directions(self) -> Floats:
        """Return directions (rays, 3) by the cosine law inside the field of view."""
        return cone(self.axis, self.sin2_psi * self.uniforms[:, 2], self.uniforms[:, 3])

    def accepted(self, directions: Floats) -> Floats:
        """Return cosines at the disk (rays,) of directions from it; 0 outside of the view."""
        cosine = directions @ self.axis
        return np.where((cosine > 0.0) & (1.0 - cosine**2 <= self.sin2_psi), cosine, 0.0)

    def share_of_disk(self, towards: Floats, radius: float) -> float:
        """Return the share of a disk of small angular radius [rad] that lies in a wider view.

        That of two circles in a plane: (r^2 a + R^2 b - d r sin a) / (pi r^2) with the angles a
        and b that half of their common chord spans from either centre.
        """
        psi = math.asin(math.sqrt(self.sin2_psi))
        apart = math.acos(max(-1.0, min(1.0, float(towards @ self.axis))))
        if apart >= psi + radius:
            return 0.0
        if apart <= psi - radius:
            return 1.0
        a = math.acos((apart**2 + radius**2 - psi**2) / (2.0 * apart * radius))
        b = math.acos((apart**2 + psi**2 - radius**2) / (2.0 * apart * psi))
        common = radius**2 * a + psi**2 * b - apart * radius * math.sin(a)
        return common / (math.pi * radius**2)


def cone(axis: Floats, sin2: Floats, u_phi: Floats) -> Floats:
    """Return directions (n, 3) at squared sines sin2 and azimuths 2 pi u_phi about an axis."""
    s, phi = np.sqrt(sin2), 2.0 * math.pi * u_phi
    e1, e2 = _across(axis)
    out = np.outer(s * np.cos(phi), e1) + np.outer(s * np.sin(phi), e2)
    return out + np.outer(np.sqrt(1.0 - sin2), axis)


def _across(axis: Floats) -> tuple[Floats, Floats]:
    """Return two unit vectors across an axis and each other."""
    aside = np.eye(3)[int(np.argmin(np.abs(axis)))]
    e1 = np.cross(axis, aside)
    e1 /= np.linalg.norm(e1)
    return e1, np.cross(axis, e1)


def only_aperture(link: Link) -> Aperture:
    """Return the aperture of a link that has one, or refuse."""
    if len(link.receivers) != 1:
        raise Refused("receiver", Described(f"{len(link.receivers)} apertures"), "one aperture")
    return link.receivers[0]


class SeenSea(NamedTuple):
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


def scene_of(case: Case, mesh: TriangleMesh, day: Daylight) -> SeenSea:
    """Return sea and light in the local coordinates of a link."""
    link = case.link
    local = frame_of(link).mesh(mesh)
    water = None
    if day.water == "quasi-single":
        water = QuasiSingle(link.water, link.bubbles, link.n_air, day)
    return SeenSea(
        EmbreeIntersector(local, case.threads),
        surface_arrays(local, case.meshing.normals, link.physics.unresolved),
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
    scene: SeenSea, origin: Floats, direction: Floats, *, below: bool = False
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
