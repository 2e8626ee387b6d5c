"""Light of a point source scattered once into a line: one sample of the integral.

A line runs from O along the unit vector d. With t0 and D the foot and the distance of the source
from the line, theta the scattering angle at the point t of the line and r the distance of that
point from the source,

    theta(t) = atan2(D, t0 - t),   dt / r^2 = dtheta / D,

so that the radiance against d at O per emitted power is

    L = (1 / D) int b(t) beta(theta) exp(-tau(O, t) - tau(t, source)) I(theta) dtheta.

The change of variable removes 1 / r^2; drawing theta from a table of beta removes the forward
peak. Seen from the source the points of the line lie in one plane, in which the angle to the
source's axis is psi with cos(psi) = A cos(theta - theta_c): beams are sampled by that angle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from meshtrace.kernels.jit import inlined, outlined
from meshtrace.kernels.medium import (
    Medium,
    distance_at,
    is_uniform,
    optical_depth,
    scattering_coefficients,
    scattering_depth,
)
from meshtrace.kernels.phase import (
    SMALLEST_ANGLE,
    AngleTable,
    angle_of_tail,
    phase_at,
    tail_at,
)
from meshtrace.kernels.scene import Emitter
from meshtrace.kernels.sources import SourceKind, emission_s, intensity
from meshtrace.kernels.vectors import Vec3, along, dot, minus, norm, scaled, turn

_DISTANCE_SHARE = 0.25  # of the samples drawn by the distance along the line
_BEAM_SHARE = 0.35  # of those drawn by the angle to the axis of a beam
_FEWEST = 0.15  # share of either scatterer where both exist
_GAUSSIAN_END = 4.5  # divergences, behind which exp(-2 x^2) is 3e-18


class Optics(NamedTuple):
    """Optical properties along straight paths in the water.

    `sampled` is a medium whose optical depths are exact in closed form, from which distances are
    drawn: `medium` itself, or with the depths of bubbles below still water.
    """

    emitter: Emitter
    medium: Medium
    sampled: Medium
    water: AngleTable
    bubble: AngleTable
    bubbly: bool
    beam_rate: float  # inverse of the mean distance of points drawn in the beam [m-1]


class SeenLine(NamedTuple):
    """A line seen from the source."""

    foot: float  # t0 [m]
    distance: float  # D [m]
    low: float  # scattering angles at its ends [rad]
    high: float
    center: float  # theta_c
    nearest: float  # A, cosine of the angle at which it passes the axis


@inlined
def seen_line(p, d, longest, lamp, axis):
    """Return the `SeenLine` from p along d.

    Array twin: none, geometry.
    """
    to_lamp = minus(lamp, p)
    t0 = dot(to_lamp, d)
    off = minus(scaled(t0, d), to_lamp)
    # lines that pass closer are beyond double precision, and beyond the table
    distance = max(norm(off), SMALLEST_ANGLE * norm(to_lamp))
    low = math.atan2(distance, t0)
    high = math.pi if math.isinf(longest) else math.atan2(distance, t0 - longest)
    cos_along, cos_foot = dot(axis, d), dot(axis, off) / distance
    center = math.atan2(cos_foot, -cos_along)
    if center < -0.5 * math.pi:
        center += 2.0 * math.pi
    return SeenLine(t0, distance, low, high, center, math.hypot(cos_along, cos_foot))


@inlined
def _beam(emitter, nearest):
    """Return (half, width) of the part of a line inside the beam of the source.

    The source shines between theta_c - half and theta_c + half only (half < 0: nowhere); width
    is the scale of the logistic law that follows its intensity, 0 for none.
    """
    if emitter.kind == SourceKind.ISOTROPIC:
        return 2.0 * math.pi, 0.0
    if emitter.kind == SourceKind.LED:
        width = 0.6 / math.sqrt(emitter.spread) if emitter.spread > 4.0 else 0.0
        return 0.5 * math.pi, width
    widest, width = emitter.spread, 0.0
    if emitter.kind == SourceKind.GAUSSIAN_BEAM:
        width = 0.3 * emitter.spread
        widest *= _GAUSSIAN_END
    if widest > 0.5 * math.pi:
        return 2.0 * math.pi, width
    if nearest <= math.cos(widest):
        return -1.0, width
    return math.acos(math.cos(widest) / nearest), width


@inlined
def _logistic(x):
    return 1.0 / (1.0 + math.exp(-x)) if x > -700.0 else 0.0


@inlined
def _distance_density(optics, p, d, first, last, t):
    """Return the density of distances drawn between first and last by the optical depth."""
    medium = optics.sampled
    if is_uniform(medium):
        c = medium.a + medium.b
        if c == 0.0:
            return 1.0 / (last - first) if last < math.inf else 0.0
        return c * math.exp(-c * (t - first)) / -math.expm1(-c * (last - first))
    b, bubbles = scattering_coefficients(medium, along(p, d, t))
    low = scattering_depth(medium, p, d, first)
    high = scattering_depth(medium, p, d, last) if last < math.inf else math.inf
    span = -math.expm1(low - high)
    if span <= 0.0:
        return 0.0
    return (b + bubbles) * math.exp(low - scattering_depth(medium, p, d, t)) / span


@inlined
def _draw_distance(optics, p, d, first, last, u, scale):
    medium = optics.sampled
    if is_uniform(medium):
        c = medium.a + medium.b
        if c == 0.0:
            return first + u * (last - first)
        return first - math.log1p(u * math.expm1(-c * (last - first))) / c
    low = scattering_depth(medium, p, d, first)
    high = scattering_depth(medium, p, d, last) if last < math.inf else math.inf
    tau = low - math.log1p(u * math.expm1(low - high))
    return min(max(distance_at(medium, p, d, tau, last, scale), first), last)


class Line(NamedTuple):
    """A line, its part in the beam of the source, and the sampling of its points."""

    lit: bool
    foot: float  # t0 [m]
    distance: float  # D [m]
    low: float  # scattering angles of the lit part [rad]
    high: float
    first: float  # distances of its ends [m]
    last: float
    center: float  # theta_c
    width: float
    side: float  # +1 or -1: from where the logistic law keeps its digits
    f_low: float  # of the logistic law at the ends
    f_high: float
    share_beam: float
    share_bubble: float
    mass: float  # integrals of the phase functions over the lit part
    mass_bubble: float


class LinePoint(NamedTuple):
    """A point of a line, the light scattered into it there, and the densities of its draw."""

    light: float  # per theta [sr-1 rad-1 m-2]; 0: none
    density: float  # of theta along the line [rad-1]
    beam_density: float  # of the same point, per theta and solid angle, by `point_of_beam`
    t: float
    at: Vec3


@inlined
def line_of(p, d, longest, lamp, optics):
    """Return the `Line` from p along d.

    Array twin: none, geometry.
    """
    seen = seen_line(p, d, longest, lamp, optics.emitter.axis)
    foot, distance, _, _, center, _ = seen
    lit, low, high, first, last, width = _lit_part(seen, longest, optics.emitter)
    mass, mass_bubble, share_bubble = 0.0, 0.0, 0.0
    side, share_beam, f_low, f_high = 1.0, 0.0, 0.0, 0.0
    if lit:
        mass = tail_at(optics.water, low) - tail_at(optics.water, high)
        lit = mass > 0.0
        if optics.bubbly:
            mass_bubble = tail_at(optics.bubble, low) - tail_at(optics.bubble, high)
            lit = lit and mass_bubble > 0.0
            b, bubbles = scattering_coefficients(optics.medium, p)
            share_bubble = bubbles / (b + bubbles) if b + bubbles > 0.0 else 0.5
            share_bubble = min(max(share_bubble, _FEWEST), 1.0 - _FEWEST)
        if width > 0.0:
            side = 1.0 if low + high < 2.0 * center else -1.0
            f_low = _logistic(side * (low - center) / width)
            f_high = _logistic(side * (high - center) / width)
            if abs(f_high - f_low) > 1e-250:
                share_beam = _BEAM_SHARE
    ends = low, high, first, last, center, width, side, f_low, f_high
    return Line(lit, foot, distance, *ends, share_beam, share_bubble, mass, mass_bubble)


@inlined
def _lit_part(seen, longest, emitter):
    """Return (lit, angles, distances, width) of the part of a line that is lit."""
    low, high, first, last = seen.low, seen.high, 0.0, longest
    half, width = _beam(emitter, seen.nearest)
    if seen.center - half > low:
        low = seen.center - half
        first = min(max(seen.foot - seen.distance / math.tan(low), 0.0), longest)
    if seen.center + half < high:
        high = seen.center + half
        last = min(max(seen.foot - seen.distance / math.tan(high), first), longest)
    lit = seen.distance > 0.0 and half >= 0.0 and low < high and first < last
    return lit, low, high, first, last, width


@inlined
def _draw(line, p, d, scale, u_kind, u, optics):
    """Return (theta, t) of a point drawn on a line."""
    share_angle = 1.0 - _DISTANCE_SHARE - line.share_beam
    if u_kind < _DISTANCE_SHARE:
        t = _draw_distance(optics, p, d, line.first, line.last, u, scale)
        theta = math.atan2(line.distance, line.foot - t)
        return min(max(theta, line.low), line.high), t
    if u_kind < _DISTANCE_SHARE + line.share_beam:
        f = line.f_low + u * (line.f_high - line.f_low)
        theta = line.center + line.side * line.width * math.log(f / (1.0 - f))
    elif u_kind < 1.0 - line.share_bubble * share_angle:
        tail = tail_at(optics.water, line.high) + u * line.mass
        theta = angle_of_tail(optics.water, line.low, line.high, tail)
    else:
        tail = tail_at(optics.bubble, line.high) + u * line.mass_bubble
        theta = angle_of_tail(optics.bubble, line.low, line.high, tail)
    theta = min(max(theta, line.low), line.high)
    t = line.foot - line.distance / math.tan(theta)
    return theta, min(max(t, line.first), line.last)


@inlined
def _density(line, p, d, theta, t, r, optics):
    """Return the density of theta in `_draw`."""
    share_angle = 1.0 - _DISTANCE_SHARE - line.share_beam
    density = (1.0 - line.share_bubble) * phase_at(optics.water, theta) / line.mass
    if line.share_bubble > 0.0:
        density += line.share_bubble * phase_at(optics.bubble, theta) / line.mass_bubble
    by_distance = _distance_density(optics, p, d, line.first, line.last, t)
    density = share_angle * density + _DISTANCE_SHARE * by_distance * r * r / line.distance
    if line.share_beam > 0.0:
        f = _logistic(line.side * (theta - line.center) / line.width)
        span = line.width * abs(line.f_high - line.f_low)
        density += line.share_beam * f * (1.0 - f) / span
    return density


@outlined
def _evaluated(line, p, d, theta, t, lamp, optics):
    """Return the `LinePoint` at t, with the scattering angle theta."""
    at = along(p, d, t)
    from_lamp = minus(at, lamp)
    r = norm(from_lamp)
    nothing = LinePoint(0.0, 1.0, 0.0, t, at)
    if not 0.0 < r < math.inf:
        return nothing
    w = Vec3(from_lamp.x / r, from_lamp.y / r, from_lamp.z / r)
    emitted = intensity(optics.emitter, w)
    if emitted == 0.0:
        return nothing
    b, bubbles = scattering_coefficients(optics.medium, at)
    scattered = b * phase_at(optics.water, theta)
    if bubbles > 0.0:
        scattered += bubbles * phase_at(optics.bubble, theta)
    tau = optical_depth(optics.medium, p, d, t) + optical_depth(optics.medium, lamp, w, r)
    light = scattered * emitted * math.exp(-tau) / line.distance
    density = _density(line, p, d, theta, t, r, optics)
    rate = optics.beam_rate
    beam_density = emitted * rate * math.exp(-rate * r) * t * t / line.distance
    return LinePoint(light, density, beam_density, t, at)


@outlined
def scattered_into(p, d, longest, lamp, u_kind, u, optics):
    """Draw a point of a line, roughly in proportion to the light it scatters into the line.

    Array twin: quadrature of the integral in the tests.
    Angles are drawn by the phase functions, by the distance along the line or by the angle to the
    axis of a beam; light / density is one sample of the integral.
    """
    line = line_of(p, d, longest, lamp, optics)
    if not line.lit:
        return LinePoint(0.0, 1.0, 0.0, 0.0, p)
    theta, t = _draw(line, p, d, norm(minus(lamp, p)), u_kind, u, optics)
    return _evaluated(line, p, d, theta, t, lamp, optics)


@inlined
def point_of_beam(lamp, u, v, u_length, optics):
    """Draw a point in the beam of the source: emission times exponential distance.

    Array twin: `kernels.sources.launch`.
    """
    emitter = optics.emitter
    w = turn(emitter.axis, emission_s(emitter.kind, emitter.spread, u), v)
    return along(lamp, w, -math.log(u_length) / optics.beam_rate)


@outlined
def scattered_at(p, d, t, longest, lamp, optics):
    """Return the light scattered into a line at a given point, and its densities.

    Array twin: `scattered_into`.
    """
    line = line_of(p, d, longest, lamp, optics)
    nothing = LinePoint(0.0, 1.0, 0.0, t, p)
    if not (line.lit and line.first < t < line.last):
        return nothing
    theta = math.atan2(line.distance, line.foot - t)
    if not line.low < theta < line.high:
        return nothing
    return _evaluated(line, p, d, theta, t, lamp, optics)
