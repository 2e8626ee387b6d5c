"""Directions in which adjoint paths leave the aperture: a mixture of densities.

A cosine lobe over the field of view, and lobes about the directions of unscattered light.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from meshtrace.kernels.adjoint_start import ENDED, LOOK, STARTED
from meshtrace.kernels.jit import entry, inlined, outlined
from meshtrace.kernels.phase import phase_at, sample_s
from meshtrace.kernels.random import uniforms
from meshtrace.kernels.sources import emission_s, intensity
from meshtrace.kernels.vectors import Vec3, along, angle_between, dot, norm, row, turn, unit, write

PEAK = 0.3
"""Share of directions about a source or a lobe with a density as 1 / sin(theta / 2)."""

_LOBES = 0.75  # share of directions drawn about unscattered arrivals inside the field of view
_LOBES_OUTSIDE = 0.7  # the same, where all arrivals lie outside


@inlined
def _in_cone(w, world):
    return dot(w, world.axis) >= world.cos_cone


class Rim(NamedTuple):
    """The cone of directions seen from a lobe outside it: between s0 and s1, within an azimuth."""

    s0: float  # sin^2(theta / 2)
    s1: float
    half: float  # azimuth [rad]


@inlined
def _rim(lobe, axis, world):
    apart, half = angle_between(lobe, axis), math.acos(min(world.cos_cone, 1.0))
    s0 = math.sin(0.5 * max(apart - half, 0.0)) ** 2
    s1 = math.sin(0.5 * min(apart + half, math.pi)) ** 2
    widest = math.pi
    if half < apart < math.pi - half:
        widest = math.asin(min(math.sin(half) / math.sin(apart), 1.0))
    return Rim(max(s0, 1e-12), s1, widest)


@outlined
def _drawn_aside(lobe, axis, u, v, world):
    """Draw a direction of the cone about a lobe outside it, with a density as s^-2."""
    rim = _rim(lobe, axis, world)
    s = 1.0 / (1.0 / rim.s0 - u * (1.0 / rim.s0 - 1.0 / rim.s1))
    sin, cos = 2.0 * math.sqrt(max(s * (1.0 - s), 0.0)), 1.0 - 2.0 * s
    along_lobe = dot(axis, lobe)
    e = along(axis, lobe, -along_lobe)
    if norm(e) < 1e-9:
        return turn(lobe, s, v)
    e = unit(e)
    f = Vec3(lobe.y * e.z - lobe.z * e.y, lobe.z * e.x - lobe.x * e.z, lobe.x * e.y - lobe.y * e.x)
    phi = rim.half * (2.0 * v - 1.0)
    p, q = sin * math.cos(phi), sin * math.sin(phi)
    return Vec3(
        cos * lobe.x + p * e.x + q * f.x,
        cos * lobe.y + p * e.y + q * f.y,
        cos * lobe.z + p * e.z + q * f.z,
    )


@inlined
def peak_density(theta):
    """Return a density [sr-1] as 1 / sin(theta / 2).

    Array twin: none, elementary.
    Light scattered once goes as the inverse distance of a line from the source: with a density
    that stays finite there the variance is infinite.
    """
    return 1.0 / (8.0 * math.pi * max(math.sin(0.5 * theta), 1e-12))


@inlined
def peaked_s(u, u_kind, share, medium):
    """Draw sin^2(theta / 2) by the mixture of a phase function and `peak_density`.

    Array twin: the integral of the density in the tests.
    """
    if u_kind < PEAK:
        return u * u
    if (u_kind - PEAK) < share * (1.0 - PEAK):
        return sample_s(medium.phase_bubble, u)
    return sample_s(medium.phase_water, u)


@inlined
def peaked_density(theta, share, optics):
    """Return the density [sr-1] of the directions drawn by `peaked_s`."""
    return (1.0 - PEAK) * mixed_phase(theta, share, optics) + PEAK * peak_density(theta)


@inlined
def mixed_phase(theta, share, optics):
    """Return the phase function [sr-1] of water and a share of bubbles."""
    beta = (1.0 - share) * phase_at(optics.water, theta)
    if share > 0.0:
        beta += share * phase_at(optics.bubble, theta)
    return beta


@outlined
def _lobe_density(w, lobe, axis, inside, world):
    """Return the density [sr-1] of directions of the cone that are drawn about a lobe."""
    theta = angle_between(w, lobe)
    if not inside:
        rim, s = _rim(lobe, axis, world), math.sin(0.5 * theta) ** 2
        return 1.0 / (s * s * (1.0 / rim.s0 - 1.0 / rim.s1) * 4.0 * rim.half)
    return peaked_density(theta, world.lobe_bubble, world.optics)


@outlined
def _drawn_about(lobe, axis, inside, u, v, u_kind, world):
    """Draw a direction about a lobe: by the phase function, or in the cone beside it."""
    if not inside:
        return _drawn_aside(lobe, axis, u, v, world)
    return turn(lobe, peaked_s(u, u_kind, world.lobe_bubble, world.optics.medium), v)


class _Lobes(NamedTuple):
    """Lobes of a path that are drawn from: those inside the cone, or all if none is."""

    inside: bool
    used: int
    share: float  # of the directions


@inlined
def _lobes_of(paths, i, world):
    lobes, n_inside = paths.lobe.shape[1], 0
    for j in range(lobes):
        n_inside += _in_cone(row(paths.lobe[i], j), world)
    inside = n_inside > 0
    share = 0.0
    if lobes > 0:
        share = _LOBES if inside else _LOBES_OUTSIDE
    return _Lobes(inside, n_inside if inside else lobes, share)


@inlined
def _drawn(paths, i, lobes, world):
    """Draw the direction of a path."""
    target, axis = world.target, world.axis
    u_kind, u, v, u_lobe = uniforms(world.key, world.first + i, 0, LOOK)
    if u_kind >= lobes.share and target.is_lamp:
        return turn(axis, emission_s(target.lamp.kind, target.lamp.spread, u), v)
    if u_kind >= lobes.share:
        sin2 = 1.0 - world.cos_cone * world.cos_cone
        return turn(axis, 0.5 * u * sin2 / (1.0 + math.sqrt(1.0 - u * sin2)), v)
    pick, j = int(u_kind / lobes.share * lobes.used), 0
    for j in range(paths.lobe.shape[1]):
        if not lobes.inside or _in_cone(row(paths.lobe[i], j), world):
            if pick == 0:
                break
            pick -= 1
    return _drawn_about(row(paths.lobe[i], j), axis, lobes.inside, u, v, u_lobe, world)


@inlined
def _weight(paths, i, w, facing, lobes, world):
    """Return the weight of a path that leaves along w: light over the density of the mixture."""
    target, axis = world.target, world.axis
    density = 0.0
    for j in range(paths.lobe.shape[1]):
        lobe = row(paths.lobe[i], j)
        if not lobes.inside or _in_cone(lobe, world):
            density += _lobe_density(w, lobe, axis, lobes.inside, world)
    density *= lobes.share / max(lobes.used, 1)
    if target.is_lamp:
        light = intensity(target.lamp, w)
        density += (1.0 - lobes.share) * light
        light *= world.optics.emitter.power
    else:
        light = target.area * facing
        sin2 = 1.0 - world.cos_cone * world.cos_cone
        density += (1.0 - lobes.share) * max(dot(w, axis), 0.0) / (math.pi * sin2)
    return light / density if light > 0.0 else 0.0


@entry
def look(paths, origins, directions, world):
    """Draw the directions in which the paths leave the aperture, and write their first rays.

    Array twin: the integral of the density in the tests.
    A mixture of a cosine lobe over the field of view and of lobes about the directions of
    unscattered light: the phase function about those inside the field of view, or, where all lie
    outside, the field of view beside them. The pattern of a lamp takes the place of the cosine
    lobe. Rays start above the highest crest.
    """
    high = world.surface.high[2]
    for i in range(len(paths.weight)):
        lobes = _lobes_of(paths, i, world)
        w = _drawn(paths, i, lobes, world)
        p = row(paths.point, i)
        facing = -dot(w, world.target.axis)
        paths.state[i] = ENDED
        if facing > 0.0 and w.z < 0.0 and _in_cone(w, world):
            weight = _weight(paths, i, w, facing, lobes, world)
            if weight > 0.0:
                paths.weight[i] = weight
                paths.state[i] = STARTED
        write(paths.direction[i], w)
        t = max((high - p.z) / w.z, 0.0) * (1.0 - 1e-3) if w.z < 0.0 else 0.0
        write(origins[i], along(p, w, t))
        write(directions[i], w)
