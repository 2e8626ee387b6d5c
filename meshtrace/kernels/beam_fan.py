"""Directions of adjoint paths towards the beam of a narrow source: a fan of planes and tilts.

With alpha the angle at the source from its axis to a point, a direction from the point towards the
axis at the scattering angle theta lies theta - alpha beside the direction to the source. Angles are
drawn by the phase function and evenly; the sine x of the tilt out of the plane of point and axis
by Cauchy's law, as wide as the beam appears:

    p(w) = p(theta) e / (2 atan(1 / e) (x^2 + e^2)),   dOmega = dtheta dx.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from meshtrace.kernels.jit import inlined, outlined
from meshtrace.kernels.line_estimate import seen_line
from meshtrace.kernels.phase import angle_of_tail, phase_at, tail_at
from meshtrace.kernels.vectors import Vec3, angle_between, cross, dot, minus, norm, scaled, unit

_THINNEST = 1e-3  # sine of a tilt
_FARTHEST = 4.0  # mean distances of points in the beam
_SMALLEST = 1e-4  # [rad] angle that spans a plane


class Fan(NamedTuple):
    """The beam of a source seen from a point."""

    visible: bool
    to_lamp: Vec3
    along: Vec3  # in the plane of the axis, across to_lamp
    across: Vec3  # of the plane
    alpha: float  # [rad]
    last: float  # largest scattering angle [rad]
    mass: float  # integral of the phase function
    width: float  # of the beam over sin(alpha)


@outlined
def fan_of(at, to_lamp, lamp, width, optics):
    """Return the `Fan` of a point.

    Array twin: none, geometry.
    """
    axis = optics.emitter.axis
    alpha = angle_between(axis, scaled(-1.0, to_lamp))
    visible = width > 0.0 and _SMALLEST < alpha < math.pi - _SMALLEST
    last, mass, along, across = 0.0, 0.0, axis, axis
    if visible:
        across = unit(cross(to_lamp, axis))
        along = cross(across, to_lamp)
        far = _FARTHEST / optics.beam_rate
        if axis.z > 0.0 > lamp.z:
            far = min(far, -lamp.z / axis.z)
        r = norm(minus(lamp, at))
        last = math.atan2(r * math.sin(alpha), r * math.cos(alpha) - far)
        mass = tail_at(optics.water, alpha) - tail_at(optics.water, last)
        visible = mass > 0.0
    return Fan(
        visible, to_lamp, along, across, alpha, last, mass, width / max(math.sin(alpha), _SMALLEST)
    )


@inlined
def _tilt(fan, theta):
    return min(max(fan.width * math.sin(theta - fan.alpha), _THINNEST), 1.0)


@outlined
def fan_density(fan, w, optics):
    """Return the density [sr-1] of directions of a fan.

    Array twin: its integral in the tests.
    """
    theta = fan.alpha + math.atan2(dot(w, fan.along), dot(w, fan.to_lamp))
    if not fan.alpha < theta < fan.last:
        return 0.0
    p = 0.5 * phase_at(optics.water, theta) / fan.mass + 0.5 / (fan.last - fan.alpha)
    x, e = dot(w, fan.across), _tilt(fan, theta)
    return p * e / (2.0 * math.atan(1.0 / e) * (x * x + e * e))


@outlined
def drawn_in_fan(fan, u, v, optics):
    """Draw a direction of a fan.

    Array twin: `fan_density`.
    """
    if u < 0.5:
        tail = tail_at(optics.water, fan.last) + 2.0 * u * fan.mass
        theta = angle_of_tail(optics.water, fan.alpha, fan.last, tail)
    else:
        theta = fan.alpha + (2.0 * u - 1.0) * (fan.last - fan.alpha)
    e = _tilt(fan, theta)
    x = e * math.tan((2.0 * v - 1.0) * math.atan(1.0 / e))
    plane = math.sqrt(max(1.0 - x * x, 0.0))
    p, q = plane * math.cos(theta - fan.alpha), plane * math.sin(theta - fan.alpha)
    a, b, c = fan.to_lamp, fan.along, fan.across
    return Vec3(
        p * a.x + q * b.x + x * c.x, p * a.y + q * b.y + x * c.y, p * a.z + q * b.z + x * c.z
    )


class Pass(NamedTuple):
    """A line that passes the beam: scattering angles, and their law about that nearest the axis."""

    foot: float  # distance of the foot of the source [m]
    distance: float  # of the source [m]
    center: float  # [rad]
    scale: float
    low: float  # of the law at both ends
    high: float


@outlined
def pass_of(p, d, longest, lamp, width, optics):
    """Return the `Pass` of a line from p along d.

    Array twin: none, geometry.
    """
    line = seen_line(p, d, longest, lamp, optics.emitter.axis)
    scale = math.hypot(width, math.acos(min(line.nearest, 1.0)))
    low = math.atan((line.low - line.center) / scale)
    high = math.atan((line.high - line.center) / scale)
    return Pass(line.foot, line.distance, line.center, scale, low, high)


@inlined
def drawn_in_beam(line, longest, u):
    """Draw a distance along a line about the beam.

    Array twin: `distance_density`.
    """
    theta = line.center + line.scale * math.tan(line.low + u * (line.high - line.low))
    theta = min(max(theta, 1e-9), math.pi - 1e-9)
    t = line.foot - line.distance / math.tan(theta)
    return min(max(t, 0.0), longest * (1.0 - 1e-9))


@inlined
def distance_density(line, t):
    """Return the density [m-1] of `drawn_in_beam`.

    Array twin: its integral in the tests.
    """
    if not line.high > line.low:
        return 0.0
    s = line.foot - t
    theta = math.atan2(line.distance, s)
    x = (theta - line.center) / line.scale
    law = 1.0 / (line.scale * (line.high - line.low) * (1.0 + x * x))
    return law * line.distance / (line.distance * line.distance + s * s)
