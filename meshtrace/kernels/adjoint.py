"""Adjoint paths in the water, connected to the source.

A path starts on the aperture against the light, crosses the surface (`kernels.adjoint_start`) and
is scattered in the water. Each of its segments receives light that the source sends straight to a
point of it and that is scattered into it there (`kernels.line_estimate`): the segment behind k
scatterings scores light of order k + 1. At a scattering the segment that goes on is drawn by the
phase function; a second one, drawn by the phase function about the direction to the source or
towards the beam of a narrow one (`kernels.beam_fan`), scores and goes on as a side path with some
chance. The balance heuristic joins both, so that neither forward peak makes a heavy tail and no
weight grows.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.adjoint_look import mixed_phase, peaked_density, peaked_s
from meshtrace.kernels.adjoint_start import (
    ENDED,
    FIRST_STREAM,
    WAITING,
    WALKING,
    importance_at,
    is_flat,
)
from meshtrace.kernels.beam_fan import (
    distance_density,
    drawn_in_beam,
    drawn_in_fan,
    fan_density,
    fan_of,
    pass_of,
)
from meshtrace.kernels.jit import entry, inlined, outlined
from meshtrace.kernels.line_estimate import point_of_beam, scattered_at, scattered_into
from meshtrace.kernels.medium import (
    distance_at,
    optical_depth,
    scattering_coefficients,
    scattering_depth,
)
from meshtrace.kernels.phase import phase_at, sample_s
from meshtrace.kernels.random import uniforms
from meshtrace.kernels.sources import intensity, lambert_reflection
from meshtrace.kernels.vectors import (
    Vec3,
    along,
    angle_between,
    minus,
    norm,
    row,
    turn,
    unit,
    write,
)

# what a draw is for, behind those of the start
_LINE, _COLLISION, _TURN, _SIDE, _BEAM = range(FIRST_STREAM, FIRST_STREAM + 5)

_LIGHT = 0.25  # importance over that of the crossing, below which roulette is played
_ASIDE = 0.3  # [rad], beyond which a path does not head for the source
_BEYOND = 1.5  # distances to the source, up to which free paths are drawn evenly
_MANY = 64  # scatterings behind which paths end with a chance of 0.1 each
_ROOM = 8  # deferred scores and rays that one event may write


class Checks(NamedTuple):
    """Scores that a wave may block, and the paths to be checked; every score if `whole`."""

    whole: bool
    score: NDArray[np.float64]  # (m, 4) path, order, value, way in the water
    ray: NDArray[np.float64]  # (2 m, 8) score or -1 - path, origin, direction, length


@inlined
def _is_clear(p, q, d, surface):
    """Return whether no wave can block the straight path from p to q along d."""
    low = surface.low[2]
    if (p.z <= low and q.z <= low) or is_flat(surface):
        return True
    slope = surface.max_slope
    return d.z < 0.0 and d.z * d.z > slope * slope * (d.x * d.x + d.y * d.y)


@inlined
def _list_ray(checks, n, what, p, d, length):
    r = checks.ray[n]
    r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7] = what, p.x, p.y, p.z, d.x, d.y, d.z, length
    return n + 1


@inlined
def _gather(paths, i, p, d, value, at, checks, n, rays, world):
    """Score a value that a segment receives at a point; return (n, rays)."""
    if not value > 0.0:
        return n, rays
    order = min(paths.order[i], paths.score.shape[1] - 1)
    lamp = row(paths.lamp, i)
    return _score(paths, i, order, value, p, at.at, d, at.t, lamp, checks, n, rays, world)


@inlined
def _score(paths, i, order, value, p, q, d, t, lamp, checks, n, rays, world):
    """Score light from the source via q to p, or list it for a check; return (n, rays)."""
    way = unit(minus(lamp, q))
    here, there = _is_clear(p, q, d, world.surface), _is_clear(q, lamp, way, world.surface)
    if here and there and not checks.whole:
        paths.score[i, order] += value
        return n, rays
    checks.score[n, 0], checks.score[n, 1], checks.score[n, 2] = i, order, value
    checks.score[n, 3] = paths.water[i] + t + norm(minus(lamp, q))
    if not here:
        rays = _list_ray(checks, rays, n, p, d, t)
    if not there:
        rays = _list_ray(checks, rays, n, q, way, norm(minus(lamp, q)))
    return n + 1, rays


@inlined
def _longest(p, d, world):
    """Return the length of a segment up to the last wave or the bottom."""
    if d.z > 0.0:
        return max((world.surface.high[2] - p.z) / d.z, 0.0)
    if d.z < 0.0 and world.optics.medium.bottom_z > -math.inf:
        return max((world.optics.medium.bottom_z - p.z) / d.z, 0.0)
    return math.inf


@entry
def follow(paths, clear, checks, world):
    """Advance every path until it ends or needs a ray; return (listed scores, rays).

    Array twin: `tests/transport/single_scattering.py` for the first order.
    `clear` tells of waiting paths whether no wave cut their segment.
    """
    n = rays = 0
    room = len(checks.score) - _ROOM
    for i in range(len(paths.weight)):
        if paths.state[i] == WAITING:
            paths.state[i] = ENDED
            if clear[i]:
                n, rays = _arrive(paths, i, checks, n, rays, world)
        while n < room:
            if paths.state[i] == ENDED:
                if paths.branches[i] == 0:
                    break
                _resume(paths, i)
            p, d = row(paths.point, i), row(paths.direction, i)
            if paths.event[i] == 0:
                u_kind, u, _, _ = uniforms(world.key, world.first + i, 0, _LINE)
                lamp, longest = row(paths.lamp, i), _longest(p, d, world)
                at = scattered_into(p, d, longest, lamp, u_kind, u, world.optics)
                value = paths.weight[i] * at.light / at.density
                n, rays = _gather(paths, i, p, d, value, at, checks, n, rays, world)
            paths.event[i] += 1
            longest = _longest(p, d, world)
            t = _draw_length(paths, i, p, d, longest, world)
            paths.length[i] = t
            if t == longest and not (d.z < 0.0 and t < math.inf):
                paths.state[i] = ENDED  # up through the surface, or down for ever
            elif _is_clear(p, along(p, d, t), d, world.surface):
                n, rays = _arrive(paths, i, checks, n, rays, world)
            else:
                rays = _list_ray(checks, rays, -1 - i, p, d, t)
                paths.state[i] = WAITING
                break
    return n, rays


@inlined
def _resume(paths, i):
    """Resume the side path stored last."""
    paths.branches[i] -= 1
    b = paths.branch[i, paths.branches[i]]
    write(paths.point[i], Vec3(b[0], b[1], b[2]))
    write(paths.direction[i], Vec3(b[3], b[4], b[5]))
    paths.weight[i], paths.order[i], paths.water[i] = b[6], int(b[7]), b[8]
    paths.state[i] = WALKING


@inlined
def _branch_off(paths, i, p, d, weight):
    """Store a side path."""
    b = paths.branch[i, paths.branches[i]]
    b[0], b[1], b[2], b[3], b[4], b[5] = p.x, p.y, p.z, d.x, d.y, d.z
    b[6], b[7], b[8] = weight, paths.order[i], paths.water[i]
    paths.branches[i] += 1


@inlined
def _even_range(p, lamp, longest):
    """Return the distance up to which collisions are also sampled uniformly."""
    return min(_BEYOND * norm(minus(lamp, p)), longest)


@inlined
def _draw_length(paths, i, p, d, longest, world):
    """Draw a free path: by the scattering depth, uniformly to beyond the source, or in its beam."""
    u, u_kind, _, _ = uniforms(world.key, world.first + i, paths.event[i], _COLLISION)
    lamp = row(paths.lamp, i)
    if u_kind < world.even:
        return u * _even_range(p, lamp, longest)
    if u_kind < world.even + world.lit:
        line = pass_of(p, d, longest, lamp, world.beam, world.optics)
        if line.high > line.low:
            return drawn_in_beam(line, longest, u)
    scale = norm(minus(lamp, p))
    return distance_at(world.optics.sampled, p, d, -math.log(u), longest, scale)


@outlined
def _arrive(paths, i, checks, n, rays, world):
    """Scatter a path at the end of its segment, in the water or at the bottom."""
    optics = world.optics
    medium = optics.medium
    p, d, t = row(paths.point, i), row(paths.direction, i), paths.length[i]
    lamp, weight = row(paths.lamp, i), paths.weight[i]
    at = along(p, d, t)
    paths.water[i] += t
    on_bottom = d.z < 0.0 and t == _longest(p, d, world)
    weight *= math.exp(-optical_depth(medium, p, d, t))
    b, bubbles = scattering_coefficients(medium, at)
    near_b, near_bubbles = scattering_coefficients(optics.sampled, at)
    passed = (1.0 - world.even - world.lit) * math.exp(-scattering_depth(optics.sampled, p, d, t))
    u_kind, u, v, lot = uniforms(world.key, world.first + i, paths.event[i], _TURN)
    if on_bottom:
        weight *= medium.bottom_albedo / passed
    else:
        density = passed * (near_b + near_bubbles)
        even = _even_range(p, lamp, _longest(p, d, world))
        if t <= even:
            density += world.even / even
        if world.lit > 0.0:
            line = pass_of(p, d, _longest(p, d, world), lamp, world.beam, optics)
            density += world.lit * distance_density(line, t)
        weight *= (b + bubbles) / density
    paths.order[i] += 1
    if weight == 0.0:
        paths.state[i] = ENDED
        return n, rays
    share = bubbles / (b + bubbles) if bubbles > 0.0 and not on_bottom else 0.0
    if on_bottom:
        n, rays = _gather_bottom(paths, i, at, weight, checks, n, rays, world)
        plain = lambert_reflection(u, v)
    else:
        s = sample_s(medium.phase_bubble if u_kind < share else medium.phase_water, u)
        plain = turn(d, s, v)
    n, rays = _connect(
        paths, i, at, d, plain, weight, share, on_bottom, lot, checks, n, rays, world
    )
    return n, rays


@outlined
def _connect(paths, i, at, d, plain, weight, share, on_bottom, lot, checks, n, rays, world):
    """Score the segments that leave a scattering, and select those to follow; return (n, rays).

    Three points are joined by the balance heuristic: on a segment drawn by the phase function, on
    one drawn about the direction to the source or its beam, and in the beam of the source.
    """
    optics, lamp = world.optics, row(paths.lamp, i)
    to_lamp = unit(minus(lamp, at))
    u_kind, u, v, u_side = uniforms(world.key, world.first + i, paths.event[i], _SIDE)
    fan = fan_of(at, to_lamp, lamp, world.beam, optics)
    in_fan = world.fan if fan.visible else 0.0
    aimed = _drawn_aim(to_lamp, u_kind, u, v, share, fan, in_fan, optics)
    u_a, v_a, u_b, v_b = uniforms(world.key, world.first + i, paths.event[i], _LINE)
    u, v, u_length, _ = uniforms(world.key, world.first + i, paths.event[i], _BEAM)
    lit = minus(point_of_beam(lamp, u, v, u_length, optics), at)
    paths.state[i] = ENDED
    aside = world.aimed if paths.branches[i] < paths.branch.shape[1] else 0.0
    write(paths.point[i], at)
    for k in range(3):
        w = plain if k == 0 else (aimed if k == 1 else unit(lit))
        forward = _forward(d, w, share, on_bottom, optics)
        if not forward > 0.0:
            continue
        towards, brighter = _aim_of(to_lamp, w, share, fan, in_fan, optics)
        longest = _longest(at, w, world)
        if k == 2:
            q = scattered_at(at, w, norm(lit), longest, lamp, optics)
        else:
            u_line, v_line = (u_a, v_a) if k == 0 else (u_b, v_b)
            q = scattered_into(at, w, longest, lamp, u_line, v_line, optics)
        density = (forward + towards) * q.density + q.beam_density
        value = weight * forward * q.light / density
        n, rays = _gather(paths, i, at, w, value, q, checks, n, rays, world)
        kept = weight * forward / (forward + aside * towards)
        if k == 0:
            write(paths.direction[i], w)
            paths.weight[i] = _roulette(kept, at, lamp, brighter, lot, paths, i, optics)
            if paths.weight[i] > 0.0:
                paths.state[i] = WALKING
        elif k == 1 and u_side < aside:
            kept = _roulette(kept, at, lamp, brighter, u_side / aside, paths, i, optics)
            if kept > 0.0:
                _branch_off(paths, i, at, w, kept)
    return n, rays


@inlined
def _drawn_aim(to_lamp, u_kind, u, v, share, fan, in_fan, optics):
    """Draw a direction towards the source or its beam."""
    if u_kind < in_fan:
        return drawn_in_fan(fan, u, v, optics)
    u_kind = (u_kind - in_fan) / (1.0 - in_fan)
    return turn(to_lamp, peaked_s(u, u_kind, share, optics.medium), v)


@inlined
def _aim_of(to_lamp, w, share, fan, in_fan, optics):
    """Return the density [sr-1] of `_drawn_aim`, and the light along w over that farther aside."""
    theta = angle_between(to_lamp, w)
    density = peaked_density(theta, share, optics)
    brighter = max(phase_at(optics.water, theta) / phase_at(optics.water, _ASIDE), 1.0)
    if in_fan > 0.0:
        beam = fan_density(fan, w, optics)
        density = (1.0 - in_fan) * density + in_fan * beam
        brighter = max(brighter, 4.0 * math.pi * beam)
    return density, brighter


@inlined
def _forward(d, w, share, on_bottom, optics):
    """Return the density [sr-1] of directions after a scattering or a reflection at the bottom."""
    if on_bottom:
        return max(w.z, 0.0) / math.pi
    return mixed_phase(angle_between(d, w), share, optics)


@inlined
def _roulette(weight, at, lamp, brighter, u, paths, i, optics):
    """Return the weight after Russian roulette, 0 for a terminated path.

    A path that heads for the source or its beam scores more by the factor `brighter`: its weight
    is low because that direction was drawn often, and roulette must not raise it again.
    """
    survival = 1.0
    ratio = weight * importance_at(at, lamp, optics.medium) / paths.importance[i]
    ratio *= brighter
    if ratio < _LIGHT:
        survival = min(max(ratio / _LIGHT, weight / paths.heaviest[i]), 1.0)
    if paths.order[i] > _MANY:
        survival = min(survival, 0.9)
    if not u < survival:
        return 0.0
    return weight / survival


@outlined
def _gather_bottom(paths, i, at, weight, checks, n, rays, world):
    """Score unscattered light from the source to the bottom; return (n, rays)."""
    lamp = row(paths.lamp, i)
    away = minus(at, lamp)
    r = norm(away)
    w = unit(away)
    if w.z >= 0.0:
        return n, rays
    light = intensity(world.optics.emitter, w)
    if light == 0.0:
        return n, rays
    tau = optical_depth(world.optics.medium, lamp, w, r)
    value = weight * light * math.exp(-tau) * -w.z / (math.pi * r * r)
    order = min(paths.order[i] - 1, paths.score.shape[1] - 1)
    # the segment to the bottom itself has been found clear
    return _score(paths, i, order, value, at, at, w, 0.0, lamp, checks, n, rays, world)
