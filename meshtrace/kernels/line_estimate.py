"""Light of a point source that is scattered once into a straight line: one sample of its integral.

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
    DEPTH_NONE,
    Medium,
    absorption_path,
    bubble_scattering,
    scattering_path,
    water_coefficients,
)
from meshtrace.kernels.sources import GAUSSIAN, ISOTROPIC, LAMBERTIAN, TOP_HAT
from meshtrace.kernels.vectors import Vec3, along, dot, minus, norm

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
    """What light meets on straight paths in the water.

    `sampled` is a medium whose optical depths are exact in closed form, from which distances are
    drawn: `medium` itself, or with the depths of bubbles below still water.
    """

    emitter: Emitter
    medium: Medium
    sampled: Medium
    water: AngleTable
    bubble: AngleTable
    bubbly: bool


class LinePoint(NamedTuple):
    """A point of a line and the light that it scatters into it."""

    value: float
    t: float
    x: float
    y: float
    z: float


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
    """Return the angle between low and high whose tail is a value.

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
    return water_coefficients(medium, p.z)[1], bubble_scattering(medium, p.x, p.y, p.z)


@inlined
def scattering_depth(medium, p, d, t):
    """Return the optical depth of scattering along a path of length t.

    Array twin: see `scattering_path`.
    """
    q = along(p, d, t)
    return scattering_path(medium, p.x, p.y, p.z, q.x, q.y, q.z, t)


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
    return not medium.layered and medium.depth_mode == DEPTH_NONE


@outlined
def distance_at(medium, p, d, tau, most, scale):
    """Return the distance along a path behind which the scattering depth is tau, or `most`.

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
    """Return (theta_c, half, width): where the source shines on the points of a line.

    The source shines between theta_c - half and theta_c + half only (half < 0: nowhere); width
    is the scale of the logistic law that follows its intensity, 0 for none.
    """
    center = math.atan2(cos_foot, -cos_along)
    if center < -0.5 * math.pi:
        center += 2.0 * math.pi
    if emitter.kind == ISOTROPIC:
        return center, 2.0 * math.pi, 0.0
    if emitter.kind == LAMBERTIAN:
        width = 0.6 / math.sqrt(emitter.spread) if emitter.spread > 4.0 else 0.0
        return center, 0.5 * math.pi, width
    widest, width = emitter.spread, 0.0
    if emitter.kind == GAUSSIAN:
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


@outlined
def scattered_into(p, d, longest, lamp, u_kind, u, optics):
    """Return one sample (`LinePoint`) of the light that a line receives by one scattering.

    Array twin: quadrature of the integral in the tests.
    Angles are drawn by the phase functions, by the distance along the line or by the angle to the
    axis of a beam; the balance heuristic joins them.
    """
    nothing = LinePoint(0.0, 0.0, p.x, p.y, p.z)
    to_lamp = minus(lamp, p)
    t0 = dot(to_lamp, d)
    off = Vec3(t0 * d.x - to_lamp.x, t0 * d.y - to_lamp.y, t0 * d.z - to_lamp.z)
    # lines that pass closer are beyond double precision, and beyond the table
    distance = max(norm(off), SMALLEST_ANGLE * norm(to_lamp))
    if distance == 0.0:
        return nothing
    foot = Vec3(off.x / distance, off.y / distance, off.z / distance)
    low = math.atan2(distance, t0)
    high = math.pi if math.isinf(longest) else math.atan2(distance, t0 - longest)
    axis = optics.emitter.axis
    center, half, width = _beam(
        optics.emitter,
        axis[0] * d.x + axis[1] * d.y + axis[2] * d.z,
        axis[0] * foot.x + axis[1] * foot.y + axis[2] * foot.z,
    )
    first, last = 0.0, longest
    if center - half > low:
        low = center - half
        first = min(max(t0 - distance / math.tan(low), 0.0), longest)
    if center + half < high:
        high = center + half
        last = min(max(t0 - distance / math.tan(high), first), longest)
    if half < 0.0 or low >= high or first >= last:
        return nothing

    # logistic law about theta_c; its tails are taken from the side that keeps the digits
    side = 1.0 if low + high < 2.0 * center else -1.0
    share_beam, f_low, f_high = 0.0, 0.0, 0.0
    if width > 0.0:
        f_low, f_high = _logistic(side * (low - center) / width), _logistic(
            side * (high - center) / width
        )
        if abs(f_high - f_low) > 1e-250:
            share_beam = _BEAM_SHARE
    b, bubbles = coefficients(optics.medium, p)
    share_bubble = 0.0
    if optics.bubbly:
        share_bubble = bubbles / (b + bubbles) if b + bubbles > 0.0 else 0.5
        share_bubble = min(max(share_bubble, _FEWEST), 1.0 - _FEWEST)
    share_far = _DISTANCE_SHARE
    share_angle = 1.0 - share_far - share_beam
    mass = tail_at(optics.water, low) - tail_at(optics.water, high)
    mass_bubble = 0.0
    if optics.bubbly:
        mass_bubble = tail_at(optics.bubble, low) - tail_at(optics.bubble, high)
    if not mass > 0.0 or (optics.bubbly and not mass_bubble > 0.0):
        return nothing

    if u_kind < share_far:
        t = _draw_distance(optics, p, d, first, last, u, norm(to_lamp))
        theta = min(max(math.atan2(distance, t0 - t), low), high)
    else:
        if u_kind < share_far + share_beam:
            f = f_low + u * (f_high - f_low)
            theta = center + side * width * math.log(f / (1.0 - f))
        elif u_kind < 1.0 - share_bubble * share_angle:
            theta = angle_of_tail(
                optics.water, low, high, tail_at(optics.water, high) + u * mass
            )
        else:
            theta = angle_of_tail(
                optics.bubble, low, high, tail_at(optics.bubble, high) + u * mass_bubble
            )
        theta = min(max(theta, low), high)
        t = min(max(t0 - distance / math.tan(theta), first), last)
    at = along(p, d, t)
    from_lamp = minus(at, lamp)
    r = norm(from_lamp)
    if not 0.0 < r < math.inf:
        return nothing
    w = Vec3(from_lamp.x / r, from_lamp.y / r, from_lamp.z / r)
    light = intensity(optics.emitter, w.x, w.y, w.z)
    if light == 0.0:
        return nothing

    beta = phase_at(optics.water, theta)
    density = share_angle * (1.0 - share_bubble) * beta / mass
    density += share_far * _distance_density(optics, p, d, first, last, t) * r * r / distance
    b, bubbles = coefficients(optics.medium, at)
    scattered = b * beta
    if optics.bubbly:
        beta_bubble = phase_at(optics.bubble, theta)
        density += share_angle * share_bubble * beta_bubble / mass_bubble
        scattered += bubbles * beta_bubble
    if share_beam > 0.0:
        f = _logistic(side * (theta - center) / width)
        density += share_beam * f * (1.0 - f) / (width * abs(f_high - f_low))
    tau = optical_depth(optics.medium, p, d, t) + optical_depth(optics.medium, lamp, w, r)
    value = scattered * light * math.exp(-tau) / (distance * density)
    return LinePoint(value, t, at.x, at.y, at.z)
