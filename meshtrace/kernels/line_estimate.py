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

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.aiming import Emitter
from meshtrace.kernels.chain_gain import intensity
from meshtrace.kernels.jit import inlined, outlined
from meshtrace.kernels.medium import (
    DepthMode,
    Medium,
    absorption_path,
    bubble_scattering,
    scattering_path,
    water_coefficients,
)
from meshtrace.kernels.sources import SourceKind
from meshtrace.kernels.vectors import Vec3, along, dot, minus, norm, turn

_DISTANCE_SHARE = 0.25  # of the samples drawn by the distance along the line
_BEAM_SHARE = 0.35  # of those drawn by the angle to the axis of a beam
SMALLEST_ANGLE = 1e-13  # [rad], first edge of the tables
_FEWEST = 0.15  # share of either scatterer where both exist
_GAUSSIAN_END = 4.5  # divergences, behind which exp(-2 x^2) is 3e-18
_STEPS = 60  # of the inversion of an optical depth at most


class AngleTable(NamedTuple):
    """A phase function on cells of equal width in ln(theta), and its integral over theta.

    Parameters
    ----------
    log_first, per_log : float
        ln of the first edge, and cells per unit of ln(theta).
    edge : ndarray, shape (n + 1,)
        Edges [rad]; the last is pi. Below the first the value is that of the first cell.
    beta : ndarray, shape (n,)
        Mean of each cell over solid angle [sr-1].
    tail : ndarray, shape (n + 1,)
        Integral of beta dtheta from an edge to pi [rad sr-1].
    """

    log_first: float
    per_log: float
    edge: NDArray[np.float64]
    beta: NDArray[np.float64]
    tail: NDArray[np.float64]


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


@inlined
def _cell(table, theta):
    if theta <= table.edge[0]:
        return 0
    j = int((math.log(theta) - table.log_first) * table.per_log)
    return min(max(j, 0), len(table.beta) - 1)


@inlined
def phase_at(table, theta):
    """Return the phase function [sr-1] at an angle.

    Array twin: `PhaseFunction.pdf`, averaged over cells.
    """
    return table.beta[_cell(table, theta)]


@inlined
def tail_at(table, theta):
    """Return the integral of beta dtheta from an angle to pi.

    Array twin: quadrature of `PhaseFunction.pdf` in the tests.
    Summed from pi downwards, it keeps the digits of large angles in spite of the forward peak.
    """
    j = _cell(table, theta)
    return table.tail[j + 1] + table.beta[j] * (table.edge[j + 1] - theta)


@inlined
def angle_of_tail(table, low, high, value):
    """Return the angle between low and high with a given tail.

    Array twin: `tail_at`, of which it is the inverse.
    """
    i, j = _cell(table, low), _cell(table, high) + 1
    while j - i > 1:
        k = (i + j) // 2
        if table.tail[k] > value:
            i = k
        else:
            j = k
    theta = table.edge[j] - (value - table.tail[j]) / table.beta[i]
    return min(max(theta, low), high)


@inlined
def angle_between(a, b):
    """Return the angle between two vectors, exact for small ones.

    Array twin: arctan2 of the norms of the cross and the scalar product.
    """
    x, y, z = a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x
    return math.atan2(math.sqrt(x * x + y * y + z * z), dot(a, b))


@inlined
def coefficients(medium, p):
    """Return (b, b_bub) [m-1] at a point.

    Array twin: `Water.b`, `HallNovarini.b`.
    """
    return water_coefficients(medium, p.z)[1], bubble_scattering(medium, p)


@inlined
def scattering_depth(medium, p, d, t):
    """Return the optical depth of scattering along a path of length t.

    Array twin: see `scattering_path`.
    """
    q = along(p, d, t)
    return scattering_path(medium, p, q, t)


@inlined
def optical_depth(medium, p, d, t):
    """Return the optical depth of absorption and scattering along a path of length t.

    Array twin: see `scattering_path`.
    """
    return scattering_depth(medium, p, d, t) + absorption_path(medium, p.z, p.z + t * d.z, t)


@inlined
def is_uniform(medium):
    """Return whether the coefficients are the same everywhere.

    Array twin: none.
    """
    return not medium.layered and medium.depth_mode == DepthMode.NONE


@outlined
def distance_at(medium, p, d, tau, most, scale):
    """Return the distance along a path to a scattering depth of tau, at most `most`.

    Array twin: `scattering_depth`, of which it is the inverse.
    Newton's method in halves: depths grow with distance and are exact in closed form. `scale` is
    any length of the size of the link, from which a path without end is searched.
    """
    if is_uniform(medium):
        return min(tau / medium.b, most) if medium.b > 0.0 else most
    low, high = 0.0, most
    if math.isinf(most):
        high = scale
        for _ in range(_STEPS):
            if scattering_depth(medium, p, d, high) >= tau:
                break
            low, high = high, 4.0 * high
        else:
            return most
    elif scattering_depth(medium, p, d, high) < tau:
        return most
    t = 0.5 * (low + high)
    for _ in range(_STEPS):
        miss = scattering_depth(medium, p, d, t) - tau
        if miss > 0.0:
            high = t
        else:
            low = t
        b, bubbles = coefficients(medium, along(p, d, t))
        step = miss / (b + bubbles) if b + bubbles > 0.0 else math.inf
        if abs(step) <= 1e-12 * t:
            break
        t -= step
        if not low < t < high:
            t = 0.5 * (low + high)
    return t


@inlined
def _beam(emitter, cos_along, cos_foot):
    """Return (theta_c, half, width) of the part of a line inside the beam of the source.

    The source shines between theta_c - half and theta_c + half only (half < 0: nowhere); width
    is the scale of the logistic law that follows its intensity, 0 for none.
    """
    center = math.atan2(cos_foot, -cos_along)
    if center < -0.5 * math.pi:
        center += 2.0 * math.pi
    if emitter.kind == SourceKind.ISOTROPIC:
        return center, 2.0 * math.pi, 0.0
    if emitter.kind == SourceKind.LED:
        width = 0.6 / math.sqrt(emitter.spread) if emitter.spread > 4.0 else 0.0
        return center, 0.5 * math.pi, width
    widest, width = emitter.spread, 0.0
    if emitter.kind == SourceKind.GAUSSIAN_BEAM:
        width = 0.3 * emitter.spread
        widest *= _GAUSSIAN_END
    if widest > 0.5 * math.pi:
        return center, 2.0 * math.pi, width
    largest = math.hypot(cos_along, cos_foot)
    if largest <= math.cos(widest):
        return center, -1.0, width
    return center, math.acos(math.cos(widest) / largest), width


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
    b, bubbles = coefficients(medium, along(p, d, t))
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
    to_lamp = minus(lamp, p)
    t0 = dot(to_lamp, d)
    off = Vec3(t0 * d.x - to_lamp.x, t0 * d.y - to_lamp.y, t0 * d.z - to_lamp.z)
    # lines that pass closer are beyond double precision, and beyond the table
    distance = max(norm(off), SMALLEST_ANGLE * norm(to_lamp))
    low, high, first, last = 0.0, 0.0, 0.0, longest
    center, half, width = 0.0, -1.0, 0.0
    if distance > 0.0:
        low = math.atan2(distance, t0)
        high = math.pi if math.isinf(longest) else math.atan2(distance, t0 - longest)
        axis = optics.emitter.axis
        center, half, width = _beam(
            optics.emitter,
            axis[0] * d.x + axis[1] * d.y + axis[2] * d.z,
            (axis[0] * off.x + axis[1] * off.y + axis[2] * off.z) / distance,
        )
        if center - half > low:
            low = center - half
            first = min(max(t0 - distance / math.tan(low), 0.0), longest)
        if center + half < high:
            high = center + half
            last = min(max(t0 - distance / math.tan(high), first), longest)
    lit = half >= 0.0 and low < high and first < last
    mass, mass_bubble, share_bubble = 0.0, 0.0, 0.0
    side, share_beam, f_low, f_high = 1.0, 0.0, 0.0, 0.0
    if lit:
        mass = tail_at(optics.water, low) - tail_at(optics.water, high)
        lit = mass > 0.0
        if optics.bubbly:
            mass_bubble = tail_at(optics.bubble, low) - tail_at(optics.bubble, high)
            lit = lit and mass_bubble > 0.0
            b, bubbles = coefficients(optics.medium, p)
            share_bubble = bubbles / (b + bubbles) if b + bubbles > 0.0 else 0.5
            share_bubble = min(max(share_bubble, _FEWEST), 1.0 - _FEWEST)
        if width > 0.0:
            side = 1.0 if low + high < 2.0 * center else -1.0
            f_low = _logistic(side * (low - center) / width)
            f_high = _logistic(side * (high - center) / width)
            if abs(f_high - f_low) > 1e-250:
                share_beam = _BEAM_SHARE
    return Line(
        lit,
        t0,
        distance,
        low,
        high,
        first,
        last,
        center,
        width,
        side,
        f_low,
        f_high,
        share_beam,
        share_bubble,
        mass,
        mass_bubble,
    )


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
    """Return the `LinePoint` at t, where the scattering angle is theta."""
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
    b, bubbles = coefficients(optics.medium, at)
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
    if emitter.kind == SourceKind.LED:
        s = 0.5 - 0.5 * math.exp(math.log(u) / (emitter.spread + 1.0))
    elif emitter.kind == SourceKind.ISOTROPIC:
        s = u
    elif emitter.kind == SourceKind.TOP_HAT_BEAM:
        s = u * math.sin(0.5 * emitter.spread) ** 2
    else:
        theta = min(emitter.spread * math.sqrt(-0.5 * math.log(u)), math.pi)
        s = math.sin(0.5 * theta) ** 2
    w = turn(emitter.axis, s, v)
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
