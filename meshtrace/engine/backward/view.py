"""Rays of a receiver, the sea and daylight that they meet, and points that bend the sun to it.

Rays run backwards, from the receiver to the light. Coordinates and lengths are local, in the unit
of the frame of the link.

A mesh without unresolved slopes bends light of one point of the sun to one point of the receiver at
separate points of the sea. There the slope s_m of the facet's interpolated normal equals the slope
s_r that bends the sun to the receiver; with the irradiance E across the sun's beam in the air, that
of the receiver is

    E_r = E sum F cos(theta_y) / (R^2 |det d(s_m - s_r) / d(x, y)|)

with F = rho / (4 cos^4 b) for reflection, and (1 - rho) n^2 cos(theta_a) cos(theta_w) /
(cos^4 b (n cos(theta_w) - cos(theta_a))^2) for refraction into the water; theta_y is the angle of
arrival to the axis of the receiver, R the distance, b the inclination of the normal, theta_a and
theta_w the angles to it in air and water. Each sampled point of the aperture takes its own point of
the sun's disk; those of a pair of successive points are opposite.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.daylight.light import SUN_RADIUS_DEG, Daylight
from meshtrace.daylight.upward import Bending, QuasiSingle, Reflection, slopes_to
from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.chains.sets import shifted, shifted_points
from meshtrace.engine.setup.arrays import frame_of, integral, surface_arrays
from meshtrace.engine.setup.options import Case
from meshtrace.errors import Described, Refused
from meshtrace.kernels.interface import MeshArrays
from meshtrace.link import Link
from meshtrace.link.receivers import Aperture, Camera
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats
from meshtrace.stored import SHIFTS

_BLOCK = 2**17  # rays that are followed at a time, some 300 bytes each: bounds memory
_POINTS = 4  # points of the aperture in each shift, each with a search of the sea: time for noise
_STEPS = 6  # of Newton's method: it converges quadratically, from the centroid of a facet over
# which the gap is nearly linear
_CURVED = 0.5  # tuned: allowance for a gap that is not linear over a facet, in units of its range
# between the corners; a larger one tries more facets
_SUN_RADIUS = math.radians(SUN_RADIUS_DEG)
_STEP = 1e-4  # of derivatives, in barycentric coordinates: central differences err by its square
LEVELS = 4000
"""Nodes of an optical depth: 2.5 mm over 10 m, for layers and bubbles."""


class View(NamedTuple):
    """Receiver in local coordinates: disk, line of sight, field of view and quasi-random rays."""

    center: Floats
    axis: Floats  # line of sight, from the receiver
    radius: float
    sin2_psi: float  # squared sine of half the field of view
    uniforms: Floats  # (rays, 7): two of the disk, two of the cone, three of the first random slope
    per_shift: int  # rays of each random shift of the quasi-random points; they are contiguous
    aperture: Aperture
    first: int = 0  # number of the first ray of a block among all rays

    def blocks(self) -> Iterator[View]:
        """Yield the view in blocks of shifts."""
        # Whole shifts: the standard error comes from their spread.
        rays = self.per_shift * max(_BLOCK // self.per_shift, 1)
        for first in range(0, len(self.uniforms), rays):
            yield self._replace(uniforms=self.uniforms[first : first + rays], first=first)

    def later_tilts(self, reflection: int, seed: int) -> Floats:
        """Return the uniforms (rays, 3) of the random slope at a reflection after the first."""
        # 23 names the stream, as 19 does that of the points in `view_of`: both are arbitrary
        rng = np.random.PCG64((seed, 23))
        # Three numbers for each ray: PCG64 jumps to those of the first ray of the block, so that
        # the size of blocks does not matter.
        rng.advance(3 * ((reflection - 1) * SHIFTS * self.per_shift + self.first))
        return np.random.Generator(rng).random((len(self.uniforms), 3))

    def origins(self) -> Floats:
        """Return points on the disk (rays, 3)."""
        # even over the disk: dA = d(r^2) dphi / 2
        r, phi = self.radius * np.sqrt(self.uniforms[:, 0]), 2 * math.pi * self.uniforms[:, 1]
        e1, e2 = _across(self.axis)
        return self.center + np.outer(r * np.cos(phi), e1) + np.outer(r * np.sin(phi), e2)

    def directions(self) -> Floats:
        """Return directions (rays, 3) by the cosine law inside the field of view."""
        # cos(theta) dOmega = d(sin^2 theta) dphi / 2: the squared sine is uniform
        return cone(self.axis, self.sin2_psi * self.uniforms[:, 2], self.uniforms[:, 3])

    def accepted(self, directions: Floats) -> Floats:
        """Return cosines at the disk (rays,) of directions from it; 0 outside of the view."""
        cosine = directions @ self.axis
        return np.where((cosine > 0.0) & (1.0 - cosine**2 <= self.sin2_psi), cosine, 0.0)

    @property
    def pixels(self) -> int:
        """Number of all pixels."""
        return int(getattr(self.aperture, "pixels", 1)) ** 2

    def pixels_of(self, towards: Floats) -> NDArray[np.int64]:
        """Return the numbers of the pixels (n,) that see directions (n, 3) from the receiver."""
        if not isinstance(self.aperture, Camera) or self.pixels == 1:
            return np.zeros(len(towards), np.int64)
        angle = np.arccos(np.clip(towards @ self.axis, -1.0, 1.0))
        return self.aperture.pixels_of(angle, self.aperture.azimuths_of(-towards))

    def means(self, values: Floats, towards: Floats) -> Floats:
        """Return the means of values (..., rays) over the rays of each shift, by pixel.

        Shape (..., shifts, pixels); sums over the pixels that see the directions `towards`
        (rays, 3) are the means of all rays.
        """
        by_shift = values.reshape(*values.shape[:-1], -1, self.per_shift)
        if self.pixels == 1:
            return np.asarray(by_shift.mean(axis=-1)[..., None])
        shifts = by_shift.shape[-2]
        cell = np.repeat(np.arange(shifts), self.per_shift) * self.pixels + self.pixels_of(towards)
        flat = values.reshape(-1, values.shape[-1])
        sums = np.array([np.bincount(cell, row, shifts * self.pixels) for row in flat])
        return sums.reshape(*values.shape[:-1], shifts, self.pixels) / self.per_shift

    def share_of_disk(self, towards: Floats, radius: float) -> float:
        """Return the share of a disk of small angular radius [rad] that lies in a wider view.

        Overlap of two circles in a plane, with centers at a distance d (`apart`): (r^2 a + R^2 b -
        d r sin a) / (pi r^2), r the radius of the disk, R = psi half the field of view, a and b the
        angles that half of their chord spans from the centers of disk and view.
        """
        psi = math.asin(math.sqrt(self.sin2_psi))
        apart = math.acos(max(-1.0, min(1.0, float(towards @ self.axis))))
        # the disk lies outside of the view, or inside
        if apart >= psi + radius:
            return 0.0
        if apart <= psi - radius:
            return 1.0
        a = math.acos((apart**2 + radius**2 - psi**2) / (2.0 * apart * radius))
        b = math.acos((apart**2 + psi**2 - radius**2) / (2.0 * apart * psi))
        overlap = radius**2 * a + psi**2 * b - apart * radius * math.sin(a)
        return overlap / (math.pi * radius**2)


def view_of(link: Link, points: int, seed: int) -> View:
    """Return the view of the aperture of a link, with quasi-random rays, in local coordinates."""
    aperture, frame = only_aperture(link), frame_of(link)
    psi = math.radians(0.5 * aperture.fov_deg)
    # the axis of an aperture is the direction of light at normal incidence: rays run against it
    axis, center = -np.array(aperture.axis), frame.points(np.array(aperture.center))
    # seven uniforms a ray, see `View.uniforms`
    places, shifts = shifted_points(7, points // SHIFTS, (seed, 19))
    radius, sin2_psi = aperture.radius / frame.unit, math.sin(psi) ** 2
    return View(center, axis, radius, sin2_psi, shifted(places, shifts), len(places), aperture)


def cone(axis: Floats, sin2: Floats, u_phi: Floats) -> Floats:
    """Return directions (n, 3) about an axis, squared sines (n,) and azimuths 2 pi u_phi (n,)."""
    s, phi = np.sqrt(sin2), 2.0 * math.pi * u_phi
    e1, e2 = _across(axis)
    out = np.outer(s * np.cos(phi), e1) + np.outer(s * np.sin(phi), e2)
    return out + np.outer(np.sqrt(1.0 - sin2), axis)


def _across(axis: Floats) -> tuple[Floats, Floats]:
    """Return two unit vectors perpendicular to an axis and to each other."""
    # the coordinate axis that is least parallel to `axis`: the cross product keeps its digits
    aside = np.eye(3)[int(np.argmin(np.abs(axis)))]
    e1 = np.cross(axis, aside)
    e1 /= np.linalg.norm(e1)
    return e1, np.cross(axis, e1)


def only_aperture(link: Link) -> Aperture:
    """Return the only aperture of a link; refuse a link with none or several."""
    if len(link.receivers) != 1:
        raise Refused("receiver", Described(f"{len(link.receivers)} apertures"), "one aperture")
    return link.receivers[0]


class SeenSea:
    """Sea and daylight that the rays of a receiver meet, in the local coordinates of its link.

    Parameters
    ----------
    case : Case
        Seed, threads and normals of the run.
    mesh : TriangleMesh
        The surface [m].
    links : sequence of Link
        The link at each wavelength, with one receiver; they differ in their waters and lamps alone.
    days : sequence of Daylight
        Daylight at each wavelength, of one pattern and sun.
    """

    def __init__(
        self, case: Case, mesh: TriangleMesh, links: Sequence[Link], days: Sequence[Daylight]
    ) -> None:
        self.case, self.mesh, self.links, self.days = case, mesh, links, days
        link, self.frame = links[0], frame_of(links[0])
        self.in_water = only_aperture(link).center[2] < 0.0
        local = self.frame.mesh(mesh)
        self.intersector = EmbreeIntersector(local, case.threads)
        self.surface = surface_arrays(local, case.meshing.normals, link.physics.unresolved)
        # Dispersion is so small that light is linear in the index of the water over that of the
        # air: two ends serve all wavelengths, one where they are equal (`np.unique`; the weights of
        # the second are then 0, not 0 / 0).
        n = np.array([wave_link.water.n / wave_link.n_air for wave_link in links])
        self.indices = np.unique([n.min(), n.max()])
        self._share = (n - self.indices[0]) / (np.ptp(self.indices) or 1.0)
        # share of the surface that foam covers
        self.foam = 1.0 - link.whitecaps.transmittance if link.whitecaps else 0.0
        # light out of the water at the indices; none where it is left out
        self.water = list[QuasiSingle]()
        if days[0].water == "quasi-single" and not self.in_water:
            waters, bubbles = [x.water for x in links], [x.bubbles for x in links]
            self.water = [QuasiSingle(waters, bubbles, i, days) for i in self.indices.tolist()]

    @property
    def direct(self) -> Floats:
        """Irradiance across the sun's beam at each wavelength [W m-2 nm-1]."""
        return np.array([day.direct for day in self.days])

    @property
    def sun(self) -> Floats:
        """Unit vector to the sun."""
        return np.array(self.days[0].sun)

    def at_wavelengths(self, values: Sequence[Floats] | Floats) -> Floats:
        """Interpolate values (wavelengths, n) between the tabulated refractive indices.

        `values` has one array at each index, (n,) or (wavelengths, n).
        """
        first, last = values[0], values[-1]
        return np.asarray(first + self._share[:, None] * (last - first))

    def optical_depths(self, points: Floats) -> Floats:
        """Return the vertical optical depths (wavelengths, n) of a receiver below points (n, 3)."""
        z = self.frame.unit * points[:, 2]
        return np.array([depth(z) for depth in self._depths])

    @cached_property
    def _depths(self) -> list[Callable[[Floats], Floats]]:
        """Functions of the height of the surface for the depth of the receiver, by wavelength."""
        return [optical_depth(link, -only_aperture(link).center[2]) for link in self.links]

    @property
    def mirror(self) -> Reflection:
        """Law of reflection at the indices."""
        return Reflection(self.sun, tuple(self.indices.tolist()))

    @property
    def rough(self) -> bool:
        """Whether the mesh leaves out slopes."""
        return self.surface.roughness.along > 0.0 or self.surface.roughness.across > 0.0


def optical_depth(link: Link, depth: float) -> Callable[[Floats], Floats]:
    """Return a function that gives the vertical optical depth from the surface to a depth [m].

    Its argument is an array of heights z [m] of the surface, z up from the mean level. The water of
    crests, above that level, has no bubbles.
    """
    levels = np.linspace(0.0, depth, LEVELS)
    a, b = link.water.profile(levels)
    c = a + b
    if link.bubbles is not None:
        c = c + link.bubbles.b(levels)
    path = integral(c, levels[1])  # optical depth from the mean level down to each node
    top = float(a[0] + b[0])  # [m-1]

    def below(z: Floats) -> Floats:
        # a trough lacks the water above it, a crest adds water like that at the top
        above = np.interp(np.maximum(-z, 0.0), levels, path)
        return np.asarray(path[-1] - above + top * np.maximum(z, 0.0))

    return below


def first_hits(
    sea: SeenSea, origin: Floats, direction: Floats
) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
    """Return where rays meet the sea, level beyond the mesh, and the mask of rays that do.

    Points, normals of the facets and normals that bend light, (rays, 3) each, all normals upwards.
    They mean nothing where the mask (rays,) is False.
    """
    side = -1.0 if sea.in_water else 1.0  # times a normal: towards the receiver
    # `facet` is -1 for rays that miss the mesh: the values of the last facet are replaced below
    hits, surface = sea.intersector.intersect(origin, direction), sea.surface
    facet = hits.facet
    facet_normal = surface.face_normals[facet]
    on_mesh = (facet >= 0) & (side * np.einsum("ij,ij->i", facet_normal, direction) < 0.0)
    # Beyond the mesh the sea is level, z = 0: light from near the horizon leaves any mesh.
    # Horizontal rays get a distance of 0, and False in the mask.
    level = -origin[:, 2] / np.where(direction[:, 2] == 0.0, math.inf, direction[:, 2])
    distance = np.where(on_mesh, hits.distance, np.maximum(level, 0.0))
    point = origin + distance[:, None] * direction
    normal = facet_normal
    if surface.interpolate:
        normal = _blend(np.stack([hits.u, hits.v], 1), surface.vertex_normals[surface.faces[facet]])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    up = np.array([0.0, 0.0, 1.0])
    facet_normal = np.where(on_mesh[:, None], facet_normal, up)
    normal = np.where(on_mesh[:, None], normal, up)
    # An interpolated normal may turn away from a grazing ray that meets its facet from the front.
    behind = side * np.einsum("ij,ij->i", normal, direction) >= 0.0
    normal[behind] = facet_normal[behind]
    return point, facet_normal, normal, on_mesh | (side * direction[:, 2] < 0.0)


def bent_sun(sea: SeenSea, law: Bending, view: View) -> Floats:
    """Return the mean radiance of sunlight bent to the view, over the sun's irradiance [sr-1].

    Shape (indices, shifts, pixels) for a reflection, (wavelengths, shifts, pixels) for a
    refraction, which the water dims. Shadows of the sun by other waves are left out, and so is
    light that is bent twice.
    """
    surface, per_shift = sea.surface, view.per_shift
    # the first few rays of each shift stand for its points
    chosen = (per_shift * np.arange(SHIFTS)[:, None] + np.arange(min(_POINTS, per_shift))).ravel()
    corners = _corners(surface, slice(None))
    nearest = np.linalg.norm(surface.vertices - view.center, axis=1).min()
    # largest turn of rays [rad], from the centers of aperture and sun to any point of both disks
    turns = view.radius / nearest + _SUN_RADIUS
    n = float(np.min(law.n))
    # One list of facets serves all points of both disks: s_r changes by at most `slack` from that
    # of the centers. The normal -n v - s, at least n - 1 long, turns by n / (n - 1) times the turn
    # of the ray v, and by less with the sun s, or in a reflection that does not graze; slopes
    # change by up to twice as much up to an inclination of 45 degrees.
    slack = 2.0 * turns * n / (n - 1.0)
    # Nearly all facets are ruled out by their corners, where the gap would have to change its sign.
    near = np.flatnonzero(_may_vanish(_gaps(law, view.center, *corners), slack))
    points = view.origins()[chosen]
    # A point of the sun's disk for each, even over it, by the two uniforms that elsewhere choose
    # the ray in its cone. Those of a pair are opposite (antithetic): both take the uniforms of the
    # first, the second turned by half a circle. What is linear over the disk adds no noise.
    odd = np.arange(len(chosen)) % 2
    u = view.uniforms[chosen, 2:4][np.arange(len(chosen)) - odd]
    suns = cone(law.sun, math.sin(_SUN_RADIUS) ** 2 * u[:, 0], u[:, 1] + 0.5 * odd)
    irradiances = [
        _irradiance(sea, near, law._replace(sun=sun), view, point)
        for sun, point in zip(suns, points, strict=True)
    ]
    # (indices, pixels, shifts)
    by_shift = np.moveaxis(np.array(irradiances), 0, -1)
    by_shift = by_shift.reshape(*by_shift.shape[:2], SHIFTS, -1).mean(axis=-1)
    # mean radiance = irradiance over the etendue per area of the aperture, pi sin^2(psi)
    return np.swapaxes(by_shift, 1, 2) / (math.pi * view.sin2_psi)


def _gaps(law: Bending, point: Floats, places: Floats, normals: Floats) -> Floats:
    """Return the gaps s_r - s_m (..., 2) at places with normals, for a point of the aperture.

    s_r is the slope that bends the sun to the point, s_m that of the surface: 0 where it shines.
    """
    ray = point - places
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    return slopes_to(law.normal(ray), normals)


def _corners(surface: MeshArrays, facets: Any) -> tuple[Floats, Floats]:
    """Return the corners of facets, and the normals there, both (facets, 3, 3)."""
    corners = surface.vertices[surface.faces[facets]]
    if surface.interpolate:
        return corners, surface.vertex_normals[surface.faces[facets]]
    return corners, np.repeat(surface.face_normals[facets][:, None], 3, axis=1)


def _may_vanish(gaps: Floats, slack: Floats | float) -> NDArray[np.bool_]:
    """Return the mask of facets on which both components of a gap may vanish together.

    `gaps` (facets, 3, 2) are those at the corners, `slack` is what they may differ by.
    """
    low, high = gaps.min(axis=1), gaps.max(axis=1)
    margin = _CURVED * (high - low) + slack
    return np.asarray(((low <= margin) & (high >= -margin)).all(axis=1))


def _irradiance(
    sea: SeenSea, facets: NDArray[np.int64], law: Bending, view: View, point: Floats
) -> Floats:
    """Return the irradiance by bent sunlight at a point of the aperture, over the sun's.

    Shape (indices, pixels) for a reflection, (wavelengths, pixels) for a refraction.
    """
    corner, normals = _corners(sea.surface, facets)
    possible = _may_vanish(_gaps(law, point, corner, normals), 0.0)
    corner, normals = corner[possible], normals[possible]

    def gap(u: Floats) -> Floats:
        return _gaps(law, point, _blend(u, corner), _blend(u, normals))

    u = np.full((len(corner), 2), 1.0 / 3.0)  # barycentric coordinates: of the centroids
    with np.errstate(all="ignore"):
        for _ in range(_STEPS):
            # Newton in barycentrics, for all facets at once; another search than `crossing.newton`,
            # as sunlight does not start at a point.
            u = u - np.einsum("nij,nj->ni", _inverse(_jacobian(gap, u)), gap(u))
        inside = (u >= 0.0).all(axis=1) & (u.sum(axis=1) < 1.0)
        # A facet that has not converged, to 1e-9 in slope, has no root on it.
        inside &= np.abs(gap(u)).max(axis=1) < 1e-9
        det = np.abs(np.linalg.det(_jacobian(gap, u)[inside]))
    if not inside.any():
        return np.zeros((len(sea.links) if sea.in_water else np.size(law.n), view.pixels))
    edges = corner[inside][:, 1:, :2] - corner[inside][:, :1, :2]
    # from barycentrics to (x, y): det d(gap)/d(x, y) = det d(gap)/du / det d(x, y)/du
    det = det / np.abs(np.linalg.det(edges))
    place = _blend(u, corner)[inside]
    distance = np.linalg.norm(point - place, axis=1)
    ray = (point - place) / distance[:, None]
    first = sea.intersector.intersect(np.broadcast_to(point, ray.shape), -ray).distance
    # Visible from the receiver where the ray meets nothing nearer than the facet itself, whose
    # distance Embree rounds to single precision: 1e-3 is far above that (tuned).
    seen = first > distance * (1.0 - 1e-3)
    light_in = law.strength(ray, law.normal(ray)) * view.accepted(-ray) / (distance**2 * det)
    tau = sea.optical_depths(place) if sea.in_water else np.zeros((1, len(place)))
    # the equation of the module, F cos(theta_y) / (R^2 det), dimmed along the slanted ray
    irradiance = (light_in * np.exp(-tau / np.abs(ray[:, 2])))[:, seen]
    pixel = view.pixels_of(-ray[seen])
    return np.stack([irradiance[:, pixel == k].sum(axis=1) for k in range(view.pixels)], axis=1)


def _blend(u: Floats, corners: Floats) -> Floats:
    """Interpolate values at the corners (n, 3, k) to barycentrics u (n, 2): shape (n, k).

    u are the weights of the second and the third corner.
    """
    share = np.concatenate([1.0 - u.sum(axis=1, keepdims=True), u], axis=1)
    return np.asarray(np.einsum("ni,nij->nj", share, corners))


def _jacobian(gap: Callable[[Floats], Floats], u: Floats) -> Floats:
    """Return the derivatives (n, 2, 2) of a gap by barycentrics, by central differences."""
    steps = _STEP * np.eye(2)
    return np.stack([(gap(u + s) - gap(u - s)) / (2.0 * _STEP) for s in steps], axis=-1)


def _inverse(m: Floats) -> Floats:
    """Return the inverses of matrices (n, 2, 2)."""
    signs = np.array([[1.0, -1.0], [-1.0, 1.0]])
    det = m[:, 0, 0] * m[:, 1, 1] - m[:, 0, 1] * m[:, 1, 0]
    return signs * m[:, ::-1, ::-1].swapaxes(1, 2) / det[:, None, None]
