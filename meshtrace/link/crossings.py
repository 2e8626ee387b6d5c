"""Where unscattered light crosses a level sea: Snell's law, the mirror, parallel light of the sky.

Each crossing comes with its lever: the displacement over the slope that causes it, from the
derivative of the law of refraction or reflection by the tilt of the facet.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from meshtrace.link.receivers import Aperture
from meshtrace.link.sources import AirLamp, AirSource, Source, Sun, WaterSource
from meshtrace.models import Floats, Position


class Crossing(NamedTuple):
    """Crossing of unscattered light over a flat sea, between a source and a receiver."""

    place: Floats  # (x, y) [m]
    lever: float  # displacement of the crossing over the slope that causes it [m]
    seen: float  # radius of the aperture, projected from the source onto still water [m]
    # corners (x, y) of the square on which daylight starts [m]: none crosses outside
    low: Floats | float = -math.inf
    high: Floats | float = math.inf


def refracted_crossing(t: Source, r: Aperture, n: float) -> Crossing:
    """Return where light crosses a flat sea from a source to an aperture on the other side."""
    if isinstance(t, AirSource):
        return _daylight_crossing(t, r, n)
    low_end, high_end = (t, r) if isinstance(t, WaterSource) else (r, t)
    depth, height = -low_end.center[2], high_end.center[2]
    # part of the horizontal way that lies in the water; for small angles a metre of height moves
    # light n times as far aside as a metre of depth
    share = depth / (depth + n * height)
    place = _by_snell(low_end.position, high_end.position, depth, height, n)
    # Fermat's principle over a slope s in the plane of the ray moves the crossing by
    # dx/ds = (n cos i - cos t) / (n cos^3 i / depth + cos^3 t / height),
    # i in the water and t in the air; `slant` is 1 for vertical light
    cos_i = depth / math.hypot(depth, math.dist(place, low_end.position))
    cos_t = height / math.hypot(height, math.dist(place, high_end.position))
    slant = (depth + n * height) / (depth * cos_t**3 + n * height * cos_i**3)
    lever = (n * cos_i - cos_t) * height * share * slant
    seen = r.radius * (share if r is high_end else 1.0 - share)
    return Crossing(place, lever, seen)


def _by_snell(low: Position, high: Position, depth: float, height: float, n: float) -> Floats:
    """Return the crossing (x, y) [m] of still water by light between two ends, by Snell's law.

    `depth` and `height` are those of the ends at `low` and `high`, n is the relative index.
    """
    a, b = np.array(low, float), np.array(high, float)
    distance = math.dist(a, b)
    least, most = 0.0, 1.0
    # n sin(angle in water) - sin(angle in air) grows with the share of the distance in the water:
    # bisection, to 2^-40 of the distance, needs no first guess.
    for _ in range(40):
        share = 0.5 * (least + most)
        x, y = share * distance, (1.0 - share) * distance
        if n * x * math.hypot(y, height) < y * math.hypot(x, depth):
            least = share
        else:
            most = share
    return np.asarray(a + share * (b - a))


def _daylight_crossing(sky: AirSource, end: Aperture, n: float) -> Crossing:
    r"""Return where light of sun or sky crosses a flat sea to an aperture in the water.

    Notes
    -----
    Parallel light at angles :math:`\theta_a` in the air and :math:`\theta_w` in the water stays
    so: :math:`n \sin(\theta_w - \tau) = \sin(\theta_a - \tau)` on a facet of tilt
    :math:`\tau`. The crossing :math:`d \tan \theta_w` from a receiver at depth d moves by

    .. math:: \frac{dx}{d\tau} = d \, \frac{n \cos\theta_w - \cos\theta_a}{n \cos^3\theta_w}

    which for vertical light is the limit (n - 1) d / n of `Link.footprint` for h = inf. Skylight
    crosses anywhere in the view of the receiver, up to the critical angle.
    """
    depth, seen, place = -end.center[2], end.radius, np.array(end.position)
    cosine_air = cosine = 1.0
    if isinstance(sky, Sun):
        direction = np.array(sky.axis)
        cosine_air = -direction[2]
        # 1e-6: of total reflection by water of a lower index than the air
        cosine = math.sqrt(max(1.0 - (1.0 - cosine_air**2) / n**2, 1e-6))
        place = place - depth * direction[:2] / (n * cosine)
    else:
        # light at normal incidence travels along `axis`, straight down for a receiver that looks up
        view = math.acos(max(-end.axis[2], -1.0)) + 0.5 * math.radians(end.fov_deg)
        seen += depth * math.tan(min(view, math.asin(min(1.0 / n, 1.0))))
    lever = depth * (n * cosine - cosine_air) / (n * cosine**3)
    square = np.array(sky.position)
    return Crossing(place, lever, seen, square - sky.half_width, square + sky.half_width)


def mirror_crossing(t: Source, r: Aperture) -> Crossing:
    """Return the reflection point on a level surface between a source and an aperture.

    Of a beam in the air that does not light this place, return the middle of its spot.
    """
    height, other = abs(t.center[2]), abs(r.center[2])
    # straight line to the mirror image of the aperture: similar triangles
    share = height / (height + other)
    a, b = np.array(t.position, float), np.array(r.position, float)
    tangent = math.dist(a, b) / (height + other)
    # A slope s turns the light by 2 s. A displacement x of the crossing turns the ray to an end at
    # the distance h from the mirror by x cos^2 theta / h: 2 s = x cos^2 theta (1 / h + 1 / h').
    lever = 2.0 * height * other / (height + other) * (1.0 + tangent**2)
    place, radius = a + share * (b - a), spot_radius(t)
    if isinstance(t, AirLamp) and radius < math.inf and t.axis[2] < 0.0:
        # a beam aside of the mirror, as that of a scanning lidar, enters the sea at its own spot
        spot = a + height * np.array(t.axis[:2]) / -t.axis[2]
        place = spot if math.dist(spot, place) > radius else place
    return Crossing(np.asarray(place), lever, r.radius * share)


def spot_radius(t: Source) -> float:
    """Return the radius of the light of a beam on the level surface [m], infinite for a lamp."""
    divergence = getattr(t, "divergence_deg", None)
    if divergence is None:
        return math.inf
    # a Gaussian beam, exp(-2 (theta / divergence)^2), has e^-12 of its intensity at 2.5 times its
    # half-angle
    flattest = math.acos(min(abs(t.axis[2]), 1.0)) + 2.5 * math.radians(divergence)  # [rad]
    # from 86 degrees off the vertical on the spot has hardly an end
    if flattest >= 1.5:
        return math.inf
    height = abs(t.center[2])
    # in the plane of incidence the spot reaches farthest on the side of flatter light: tan of that
    # angle less tan of the axis, sqrt(1 / cos^2 - 1)
    aside = height * (math.tan(flattest) - math.sqrt(1.0 / t.axis[2] ** 2 - 1.0))
    return 2.5 * t.size / abs(t.axis[2]) + aside
