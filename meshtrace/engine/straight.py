"""Unscattered light straight from a lamp to a receiver in the same medium.

The gain is int I(w) exp(-tau) dOmega over the directions w from the lamp through the aperture. They
are taken in spherical coordinates about the axis of the aperture, where every rim is a closed form:
seen from the lamp at the distance h before the plane of the aperture, light of polar angle theta
meets that plane on a circle of radius rho = h tan(theta) about the foot of the lamp. The field of
view ends at a polar angle, the disk at an azimuth Phi(theta) on either side of its centre, and the
cone that a beam fills at an azimuth Psi(theta) on either side of its axis. Gauss-Legendre
quadrature between these rims sees a smooth integrand, however narrow the beam. Where waves may
stand in the way, or bodies, rays find the azimuths between which the light is free.

Azimuth 0 points from the foot to the centre of the aperture. The haversine hav(x) = sin^2(x / 2) =
(1 - cos(x)) / 2 keeps the digits of small angles that a cosine loses. The angle between a direction
(theta, azimuth) and the axis of the beam, at the polar angle beta and the azimuth `turn`, is by the
spherical law of haversines

    hav(angle) = hav(theta - beta) + sin(theta) sin(beta) hav(azimuth - turn).

Lengths are in the unit of the frame of the link, called m here.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.bvh import Intersector
from meshtrace.engine.setup.ends import ForcedLink
from meshtrace.kernels.medium import DepthMode, Medium, straight_depths
from meshtrace.kernels.scene import Emitter, Target
from meshtrace.kernels.sources import SourceKind
from meshtrace.kernels.tables import intensities
from meshtrace.kernels.vectors import Vec3
from meshtrace.models import Floats
from meshtrace.quadrature import gauss_legendre

# Gauss nodes along theta and along azimuth, tried in turn until the gain changes by less than the
# share _ENOUGH. A Gaussian beam, cut off at exp(-x^2 / 2) = 1e-16, spans 2 x = 17 standard
# deviations: 48 nodes integrate it to 1e-9.
_NODES = 12, 24, 48, 96
_ENOUGH = 1e-8
# Of light beside solids: parts of a panel to start with, nodes along either coordinate in each,
# rays along an arc to find its shadows, and the most halvings of parts, which end as soon as the
# changes by the last halving of each part add up to less than the share _SHADED_ENOUGH of the gain.
_SHADED_PANELS, _SHADED_NODES, _RAYS, _MOST_SPLITS = 4, 12, 96, 200
_SHADED_ENOUGH = 1e-6
# relative: halving does not see a solid that slips between two rays of an arc; 3e-5 was left at a
# straight edge
_SHADED_LEAST_ERROR = 1e-4
_LEAST_ERROR = 1e-9  # relative: rounding of angles far from the axis of a narrow beam
_DARK = 37.0  # exp(-37) = 1e-16: fainter light changes no digit of a sum
# Largest ratio of tan(theta), and so of radii rho, within one panel of a disk that is wide against
# its distance h: each panel sees the fall of the light with the distance, not all of it at once.
_PANEL_RATIO = 8.0
_SCAN = 64  # polar angles in each panel at which rims are compared, to find where they cross
_HALVINGS = 50  # of an interval, to find a rim in it: 2^-50 = 1e-15, down to the last digit
# A lamp is in the plane of the aperture, and lights nothing, up to this ratio of its distance h
# from the plane to the extent of what it sees there: such an h is rounding.
_IN_PLANE = 1e-12
# Share of a path, at its end, within which a facet hides nothing: one that touches the aperture is
# in front of it or behind by rounding alone.
_HAIR = 1e-6


_Arcs = tuple[Floats, Floats, Floats, Floats]
"""Arcs of directions at polar angles to the axis of the aperture: four arrays (n,) [rad].

The polar angle theta; the weight of the quadrature over it, with its dtheta, without sin(theta);
and the azimuths low < high at both ends of the arc, not wrapped to one turn.
"""


class _Sight(NamedTuple):
    """The aperture and the beam, as seen from the lamp."""

    start: Floats  # (3,) place of the lamp [m]
    # (3, 3), unit vectors as rows: axis of the aperture, along which light arrives; in its plane,
    # from the foot of the lamp to the centre (azimuth 0); cross product of both (azimuth pi / 2)
    axes: Floats
    height: float  # h, distance of the lamp from the plane of the aperture [m]
    offset: float  # of the centre of the aperture from the foot of the lamp [m]
    radius: float  # of the aperture [m]
    beta: float  # polar angle of the axis of the beam [rad]
    turn: float  # its azimuth from the centre of the aperture [rad]
    dark: float  # angle to that axis beyond which there is no light [rad]

    def points(self, theta: Floats, azimuth: Floats) -> Floats:
        """Return the points (..., 3) where directions meet the plane of the aperture."""
        rho = self.height * np.tan(theta)
        along_axes = np.stack(
            np.broadcast_arrays(self.height, rho * np.cos(azimuth), rho * np.sin(azimuth)), -1
        )
        return self.start + along_axes @ self.axes

    def half_arcs(self, theta: Floats) -> tuple[Floats, Floats]:
        """Return the half-widths Phi of the disk and Psi of the beam in azimuth [rad].

        0 where the circle of theta is all outside, pi where it is all inside.
        """
        rho = self.height * np.tan(theta)
        past_center = rho - self.offset
        with np.errstate(divide="ignore", invalid="ignore"):
            # law of cosines radius^2 = rho^2 + offset^2 - 2 rho offset cos(Phi), for hav(Phi)
            hav_disk = (self.radius - past_center) * (self.radius + past_center)
            hav_disk /= 4.0 * self.offset * rho
            # law of haversines for the angle `dark`, for hav(Psi)
            hav_beam = math.sin(0.5 * self.dark) ** 2 - np.sin(0.5 * (theta - self.beta)) ** 2
            hav_beam /= np.sin(theta) * math.sin(self.beta)
        halves = []
        # Below 0 no point of the circle is inside, above 1 every one is. With the centre of disk or
        # beam on the axis the denominator is 0: infinite inside and outside, 0 / 0 at the rim.
        for hav in (hav_disk, np.where(np.isnan(hav_beam), 1.0, hav_beam)):
            halves.append(2.0 * np.arcsin(np.sqrt(np.clip(hav, 0.0, 1.0))))
        return halves[0], halves[1]


def straight_gains(
    link: ForcedLink,
    intersector: Intersector | None,
    medium: Medium,
    e: int,
    t: int,
    at: Vec3 | None = None,
) -> tuple[float, float]:
    """Return the share of the power of an emitter that a target collects straight, and its error.

    Deterministic. Water attenuates by the optical depth of absorption and scattering, air by
    nothing.

    Parameters
    ----------
    link : ForcedLink
        A link whose ends lie on one side of the surface.
    intersector : Intersector or None
        A surface in the frame of the link that stops light, in whichever medium; None for none.
    medium : Medium
        The water in the frame of the link, with the raster of the surface if bubbles need it.
    e, t : int
        Indices of the emitter and of the target.
    at : Vec3, optional
        Another point of an extended source, in the frame; its centre by default.

    Returns
    -------
    gain, relative_error : float
        Bodies of the link hide light, too. The error is the change by a coarser quadrature, at
        least 1e-9, and 1e-4 where light is cut off; 0 without light.
    """
    emitter, target = link.emitters[e], link.targets[t]
    if at is not None:
        emitter = emitter._replace(position=at)
    sight = _sight(emitter, target)
    # every other lamp has faded to nothing at the rim of its beam
    ends_sharply = emitter.kind == SourceKind.TOP_HAT_BEAM
    panels = _panels(sight, target, ends_sharply)
    if len(panels) < 2:
        return 0.0, 0.0
    solids = [intersector, link.bodies and link.bodies.intersector]
    hiding = [s for s in solids if s is not None and _meets_bounds(sight, target, s.mesh.bounds)]
    water = medium if link.direction == "under" else None  # both ends in the water, or in the air
    if hiding:
        gain, change = _shaded(sight, panels, emitter, water, hiding)
        return (gain, change / gain + _SHADED_LEAST_ERROR) if gain > 0.0 else (0.0, 0.0)
    gain, change = math.nan, math.inf  # nothing coarser to compare the first sum with: no break
    for n in _NODES:
        arcs = _arcs_inside(sight, panels, n)
        coarser, gain = gain, _sum_of(sight, arcs, n, emitter, water)
        change = abs(gain - coarser)
        if change <= _ENOUGH * gain:
            break
    return (gain, max(change / gain, _LEAST_ERROR)) if gain > 0.0 else (0.0, 0.0)


def _sight(emitter: Emitter, target: Target) -> _Sight:
    """Return lamp, beam and aperture in coordinates about the axis of the aperture."""
    start, axis, beam = np.array(emitter.position), np.array(target.axis), np.array(emitter.axis)
    way = np.array(target.center) - start
    height = float(way @ axis)
    # by components in the plane: the way less its part along the axis may be mere rounding
    across = np.array([target.e1, target.e2])
    aside = across @ way
    offset = float(np.linalg.norm(aside))
    along = (aside / offset if offset > 0.0 else np.array([1.0, 0.0])) @ across
    axes = np.array([axis, along, np.cross(axis, along)])
    # components of the axis of the beam: at theta = 0, at azimuth 0 and at azimuth pi / 2
    b_axis, b_along, b_normal = (axes @ beam).tolist()
    return _Sight(
        start=start,
        axes=axes,
        height=height,
        offset=offset,
        radius=target.radius,
        beta=math.atan2(math.hypot(b_along, b_normal), b_axis),
        turn=math.atan2(b_normal, b_along),
        dark=_dark_angle(emitter),
    )


def _dark_angle(emitter: Emitter) -> float:
    """Return the angle to the axis [rad] beyond which a source has 1e-16 of its intensity or less.

    `Emitter.spread` is the Lambertian order m of an LED, else a half-angle [rad].
    """
    if emitter.kind == SourceKind.LED:
        # cos(angle)^m = exp(-_DARK), by hav = (1 - cos) / 2; for m < 1e-3 that is a right angle
        half_versine = -0.5 * math.expm1(-_DARK / max(emitter.spread, 1e-3))
        return 2.0 * math.asin(math.sqrt(half_versine))
    if emitter.kind == SourceKind.GAUSSIAN_BEAM:
        # exp(-2 (angle / spread)^2) = exp(-_DARK), see `_intensity`
        return min(emitter.spread * math.sqrt(0.5 * _DARK), math.pi)
    # a measured lamp has light at any angle, and its own edges: `intensity` is 0 beyond them
    everywhere = emitter.kind in (SourceKind.ISOTROPIC, SourceKind.TABLE)
    return math.pi if everywhere else emitter.spread


def _panels(sight: _Sight, target: Target, ends_sharply: bool) -> Floats:
    """Return polar angles between which the rims of disk, view and beam are smooth [rad].

    Fewer than two without light. `ends_sharply` is whether the intensity jumps to 0 at the rim of
    the beam; else it has faded there, and a kink of the arcs where disk and beam cross is not seen.
    """
    # rho of the nearest and of the farthest point of the disk; the foot lies in it where inner < 0
    h, inner, outer = sight.height, sight.offset - sight.radius, sight.offset + sight.radius
    # the lamp is behind the aperture, or in its plane but for rounding, as beside a telescope
    if h <= _IN_PLANE * (outer + sight.radius):
        return np.zeros(0)
    # light lies between the last of the rims where it may begin and the first where it must end
    low = max(math.atan2(max(inner, 0.0), h), sight.beta - sight.dark)
    view = math.acos(target.cos_half_fov)
    high = min(math.atan2(outer, h), view, sight.beta + sight.dark)
    # Up to rho = -inner the disk, and up to theta = dark - beta the beam hold whole circles about
    # the axis (Phi or Psi = pi). A beam with beta + dark > pi reaches past theta = pi, away
    # from the aperture, and holds whole circles again from 2 pi - (beta + dark) on.
    rims = [low, high, math.atan2(abs(inner), h), abs(sight.beta - sight.dark)]
    rims.append(2.0 * math.pi - sight.beta - sight.dark)
    # Near a wide disk light fades with the way h / cos(theta) over many scales of tan(theta) =
    # rho / h: panels in geometric progression.
    n_cuts = math.floor(math.log(max(outer / h, 1.0), _PANEL_RATIO))
    rims += [math.atan(_PANEL_RATIO**k) for k in range(1, n_cuts + 1)]
    panels = np.unique(rims)
    panels = panels[(panels >= low) & (panels <= high)]
    if ends_sharply and len(panels) > 1:
        panels = np.unique(np.append(panels, _rim_crossings(sight, panels)))
    return panels


def _rim_crossings(sight: _Sight, panels: Floats) -> Floats:
    """Return the polar angles where the rims of disk and beam cross, by bisection [rad]."""

    def gaps(theta: Floats) -> Floats:
        # (12, n), azimuth of a rim of the disk, +-Phi, less that of a rim of the beam, turn +- Psi;
        # turn lies in -pi to pi, so that the same azimuth may be a turn before or behind
        disk, beam = sight.half_arcs(theta)
        turns = sight.turn + 2.0 * math.pi * np.arange(-1, 2)[:, None]
        return np.concatenate([i * disk - j * beam - turns for i in (-1, 1) for j in (-1, 1)])

    # cosine spacing, dense at the ends of panels: rims open there like a square root, where the
    # circle of theta begins to touch disk or beam, and may cross at once
    share = 0.5 - 0.5 * np.cos(np.linspace(0.0, math.pi, _SCAN))
    grid = np.unique(panels[:-1, None] + np.diff(panels)[:, None] * share)
    signs = gaps(grid) > 0.0
    # crossings between neighbours of the grid: which of the 12 gaps changes its sign, and where
    gap, cell = np.nonzero(signs[:, 1:] != signs[:, :-1])
    low, high, sign_at_low = grid[cell], grid[cell + 1], signs[gap, cell]
    crossing = np.arange(len(gap))
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        before = (gaps(middle)[gap, crossing] > 0.0) == sign_at_low
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    return 0.5 * (low + high)


def _arcs_inside(sight: _Sight, panels: Floats, n: int) -> _Arcs:
    """Return the arcs of directions inside all rims, at n Gauss nodes in each panel."""
    nodes, weights = gauss_legendre(n)
    u = 0.5 * math.pi * (nodes + 1.0)  # from nodes in (-1, 1) to (0, pi), du = pi / 2 dnode
    low, high = panels[:-1, None], panels[1:, None]
    # Arcs shrink like a square root where circles touch; theta = middle - half cos(u) smooths it,
    # and dtheta = half sin(u) du.
    theta = (0.5 * (low + high) - 0.5 * (high - low) * np.cos(u)).ravel()
    weight = (0.25 * math.pi * (high - low) * np.sin(u) * weights).ravel()
    disk, beam = sight.half_arcs(theta)
    # -Phi to Phi and turn - Psi to turn + Psi, if both are wide, overlap in two parts of a circle;
    # one of them is met a turn before or behind
    turns = sight.turn + 2.0 * math.pi * np.arange(-1, 2)[:, None]
    start, end = np.maximum(-disk, turns - beam), np.minimum(disk, turns + beam)
    _, i = overlaps = np.nonzero(end > start)
    return theta[i], weight[i], start[overlaps], end[overlaps]


def _shaded(
    sight: _Sight,
    panels: Floats,
    emitter: Emitter,
    water: Medium | None,
    hiding: Sequence[Intersector],
) -> tuple[float, float]:
    """Return the light that passes solids, and its error, by adaptive halving of panels."""
    # (-change, low, high, halves) of parts: sums over both halves of the polar angles low to high,
    # and their change against the whole; minus, as a heap gives its least item: the largest change
    queue, n_splits = list[tuple[float, float, float, tuple[float, float]]](), 0

    def sum_between(low: float, high: float) -> float:
        arcs = _arcs_inside(sight, np.array([low, high]), _SHADED_NODES)
        arcs = _free_arcs(sight, arcs, _RAYS, hiding)
        return _sum_of(sight, arcs, _SHADED_NODES, emitter, water)

    def push(low: float, high: float, whole: float) -> None:
        middle = 0.5 * (low + high)
        halves = sum_between(low, middle), sum_between(middle, high)
        heapq.heappush(queue, (-abs(whole - sum(halves)), low, high, halves))

    # where a shadow starts or ends the light jumps with the polar angle: halving closes in on it
    parts = np.linspace(panels[:-1], panels[1:], _SHADED_PANELS + 1).T.ravel().tolist()
    for low, high in pairwise(parts):
        if high > low:
            push(low, high, sum_between(low, high))
    while True:
        gain, change = (
            math.fsum(sum(item[3]) for item in queue),
            -math.fsum(item[0] for item in queue),
        )
        if change <= _SHADED_ENOUGH * gain or n_splits == _MOST_SPLITS:
            return gain, change
        _, low, high, halves = heapq.heappop(queue)
        middle, n_splits = 0.5 * (low + high), n_splits + 1
        push(low, middle, halves[0])
        push(middle, high, halves[1])


def _free_arcs(sight: _Sight, arcs: _Arcs, n: int, hiding: Sequence[Intersector]) -> _Arcs:
    """Return the parts of arcs that no solid hides, by n rays along each and bisection."""

    def is_free(theta: Floats, azimuth: Floats) -> NDArray[np.bool_]:
        way = sight.points(theta, azimuth) - sight.start
        origins = np.broadcast_to(sight.start, way.shape)
        # distances are in lengths of the way; a miss is infinitely far
        nearest = [solid.intersect(origins, way).distance for solid in hiding]
        return np.min(nearest, axis=0) > 1.0 - _HAIR

    theta, weight, first, last = arcs
    if len(theta) == 0:
        return arcs
    # at both ends, too: an edge may lie between an end and the next ray
    azimuth = np.linspace(first, last, n, axis=1)
    free = is_free(np.repeat(theta, n), azimuth.ravel()).reshape(azimuth.shape)
    # edges of shadows: arc and number of the last ray before each
    row, k = np.nonzero(free[:, 1:] != free[:, :-1])
    low, high, ends_free = azimuth[row, k], azimuth[row, k + 1], free[row, k]
    # 25 halvings: rays of single precision do not tell more than 2^-24 of an arc apart
    for _ in range(_HALVINGS // 2 if len(row) else 0):
        middle = 0.5 * (low + high)
        before = is_free(theta[row], middle) == ends_free
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    edge = 0.5 * (low + high)
    # Every free part runs from an end of its arc, or an edge, to the next. (arcs, rays): azimuths
    # at which a part begins with a ray, or ends with it, nan at other rays. Begins and ends
    # alternate along an arc, so that row by row the i-th of both belong to the same part.
    begins, ends = np.full((len(free), n), np.nan), np.full((len(free), n), np.nan)
    begins[free[:, 0], 0] = first[free[:, 0]]
    ends[free[:, -1], -1] = last[free[:, -1]]
    begins[row[~ends_free], k[~ends_free] + 1] = edge[~ends_free]
    ends[row[ends_free], k[ends_free]] = edge[ends_free]
    i, j = np.nonzero(~np.isnan(begins))
    return theta[i], weight[i], begins[i, j], ends[~np.isnan(ends)]


def _sum_of(sight: _Sight, arcs: _Arcs, n: int, emitter: Emitter, water: Medium | None) -> float:
    """Return int I exp(-tau) dOmega over arcs, with n Gauss nodes along each, for a power of 1."""
    nodes, weights = gauss_legendre(n)
    polar, weight, low, high = arcs
    half = 0.5 * (high - low)
    theta, azimuth = polar[:, None], (low + half)[:, None] + half[:, None] * nodes
    # of the angle to the axis of the beam, by the law of haversines
    slant = np.sin(theta) * math.sin(sight.beta)
    haversine = np.sin(0.5 * (theta - sight.beta)) ** 2
    haversine = haversine + slant * np.sin(0.5 * (azimuth - sight.turn)) ** 2
    if emitter.kind == SourceKind.TABLE:
        intensity = _tabulated(sight, theta, azimuth, emitter)
    else:
        intensity = _intensity(emitter, haversine)
    if water is not None:
        intensity = intensity * np.exp(-_optical_depth(sight, theta, azimuth, water))
    # dOmega = sin(theta) dtheta dazimuth, dazimuth = half dnode
    return float((weight * np.sin(polar) * half) @ (intensity @ weights))


def _tabulated(sight: _Sight, theta: Floats, azimuth: Floats, emitter: Emitter) -> Floats:
    """Return the intensity [sr-1] of a measured lamp in directions (theta, azimuth)."""
    ways = np.stack([np.broadcast_to(np.cos(theta), azimuth.shape),
                     np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth)])  # fmt: skip
    directions = np.ascontiguousarray(ways.reshape(3, -1).T @ sight.axes)
    out = np.empty(len(directions))
    intensities(emitter.table, directions, emitter.axis, emitter.e1, emitter.e2, out)
    return out.reshape(azimuth.shape)


def _optical_depth(sight: _Sight, theta: Floats, azimuth: Floats, water: Medium) -> Floats:
    """Return the optical depth of straight ways to the plane of the aperture."""
    # neither layers nor bubbles: (a + b) times the length of the way
    if not water.layered and water.depth_mode == DepthMode.NONE:
        return np.asarray((water.a + water.b) * sight.height / np.cos(theta))
    ends = sight.points(theta, azimuth).reshape(-1, 3)
    depths = np.empty(len(ends))
    straight_depths(water, Vec3(*sight.start.tolist()), ends, depths)
    return depths.reshape(azimuth.shape)


def _intensity(emitter: Emitter, haversine: Floats) -> Floats:
    """Return the intensity [sr-1] by the haversine of the angle to the axis of a source.

    As `kernels.sources.intensity`, which takes the cosine: it has no digits left in a narrow beam.
    """
    if emitter.kind == SourceKind.LED:
        # cos^m by cos = 1 - 2 hav; beyond a right angle, hav > 1 / 2, log(0) = -inf gives 0
        with np.errstate(divide="ignore", invalid="ignore"):
            log_cosine = np.log1p(-2.0 * np.minimum(haversine, 0.5))
            return np.asarray(emitter.norm * np.exp(emitter.spread * log_cosine))
    if emitter.kind == SourceKind.GAUSSIAN_BEAM:
        angle = 2.0 * np.arcsin(np.sqrt(np.clip(haversine, 0.0, 1.0)))
        # A Gaussian, 1 / e^2 at `spread`, over a plane with polar coordinates (angle, azimuth):
        # dA / dOmega = angle / sin(angle); numpy's sinc(x) is sin(pi x) / (pi x).
        area_ratio = 1.0 / np.sinc(angle / math.pi)
        return np.asarray(emitter.norm * area_ratio * np.exp(-2.0 * (angle / emitter.spread) ** 2))
    return np.full(haversine.shape, emitter.norm)


def _meets_bounds(sight: _Sight, target: Target, bounds: Floats) -> bool:
    """Return whether straight light may pass through the box about a mesh."""
    center, axis = np.array(target.center), np.array(target.axis)
    # box about the cone from the lamp to the disk; along each coordinate e a disk with the normal n
    # reaches radius sqrt(1 - (n . e)^2) from its centre
    reach = target.radius * np.sqrt(np.clip(1.0 - axis * axis, 0.0, 1.0))
    low, high = np.minimum(sight.start, center - reach), np.maximum(sight.start, center + reach)
    return bool(np.all((low <= bounds[1]) & (high >= bounds[0])))
