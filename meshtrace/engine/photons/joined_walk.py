"""The walk of joined photons: through the water, and back from the surface and the bottom.

Photons are those of `photons.flight` without the light that leaves the water: that is
expected by `photons.next_event` at each crossing and collision. A weight window plays Russian
roulette with photons of small weight times importance and splits those of a large one [1]_. In
clear water collisions are `Joins.often` times as frequent as those of light, and count by the
inverse.

References
----------
.. [1] A. Haghighat and J. C. Wagner, "Monte Carlo variance reduction with deterministic importance
   functions", Progress in Nuclear Energy 42, 25 (2003).
"""

from __future__ import annotations

import math

import numpy as np

from meshtrace.engine.photons.guides import copies_of, guide_start, importance, redirect, survives
from meshtrace.engine.photons.next_event import join_collision, join_crossing
from meshtrace.engine.photons.state import bending_normal, head, heading, place
from meshtrace.engine.photons.targets import bend_ahead, chance_ahead, level_over
from meshtrace.kernels import interface
from meshtrace.kernels.interface import branches, reflectance
from meshtrace.kernels.jit import NO, YES, entry, inlined, outlined
from meshtrace.kernels.medium import (
    Absorption,
    absorption_path,
    collide,
    sample_free_path,
    scattering_coefficients,
    scattering_path,
)
from meshtrace.kernels.phase import sample_s
from meshtrace.kernels.random import Purpose, uniforms
from meshtrace.kernels.rays import UNKNOWN, first_facet, grid_facet
from meshtrace.kernels.sources import lambert_reflection, launch
from meshtrace.kernels.tints import reset_tint, tint_way
from meshtrace.kernels.vectors import Vec2, along, dot, row

_HAIR = 1e-5  # [m], distance of a ray's start from the facet that it leaves
_LEANING = 2.0


@inlined
def _draw_path(q, u, world):
    """Draw the free path to the next collision."""
    q.free = sample_free_path(world.medium, place(q), u) / world.joins.often


@inlined
def _start(q, photon, world):
    """Start a photon at its source."""
    p, d, source, u_path = launch(world.sources, world.seed, photon)
    q.u, q.v, _, _ = uniforms(world.seed, photon, 0, Purpose.JOIN.value)
    d, q.weight = guide_start(d, p, source, photon, Vec2(q.u, q.v), world)
    q.x, q.y, q.z = p.x, p.y, p.z
    head(q, d)
    q.water, q.id, q.event, q.order, q.reflections = 0.0, photon, 0, 0, 0
    q.level, q.density, q.bend = level_over(p, world), 0.0, 0.0
    q.copies, q.is_guided, q.aimed = 0, 0, 0
    reset_tint(world.tints, q.tint)
    q.importance = importance(p, world.joins)
    _draw_path(q, u_path, world)
    _look_ahead(q, world, world.manifold)


@outlined
def _facet_ahead(q, world):
    """Return (facet, distance) of the surface ahead of a photon; facet -1 beside the mesh."""
    p, d, low = place(q), heading(q), world.surface.low[2]
    facet = UNKNOWN
    if len(world.grid.x.line) > 0:
        facet = grid_facet(world.grid, world.surface.vertices, p, d)
    if facet == UNKNOWN:
        t = max((low - p.z) / d.z, 0.0) if d.z > 0.0 else 0.0
        facet = first_facet(world.bvh, along(p, d, max(t - 1e-3 * (1.0 + t), 0.0)), d)
    if facet < 0 or dot(d, row(world.surface.face_normals, facet)) <= 0.0:
        return np.int64(-1), math.inf
    return facet, max(interface.plane_distance(p, d, facet, world.surface), 0.0)


@outlined
def _look_ahead(q, world, manifold):
    """Join the light of a photon that meets the surface without another collision, by chance."""
    if manifold is not None:  # an argument: the rest is not compiled
        return
    joins = world.joins
    if not interface.is_rough(world.surface.roughness) or q.reflections + 1 < joins.first:
        return
    q.bend = bend_ahead(place(q), heading(q), q.level, world)
    if q.order == 0 and q.reflections == 0 and not joins.direct:
        return
    if q.dz <= 0.0 and q.z < world.surface.low[2]:
        return
    chance = chance_ahead(place(q), heading(q), q.level, q.bend, joins)
    _, _, _, lot = uniforms(world.seed, q.id, q.event, Purpose.APERTURE.value)
    if lot < chance:
        facet, distance = _facet_ahead(q, world)
        if facet >= 0:
            join_crossing(q, facet, distance, chance, world)


@inlined
def _fly(q, length, world):
    """Move a photon through the water."""
    start, often = place(q), world.joins.often
    q.x, q.y, q.z = q.x + length * q.dx, q.y + length * q.dy, q.z + length * q.dz
    q.water += length
    tint_way(world.tints, q.tint, start.z, q.z, length)
    if world.medium.absorption == Absorption.CONTINUOUS:
        tau = absorption_path(world.medium, start.z, q.z, length)
        if often > 1.0:
            tau -= (often - 1.0) * scattering_path(world.medium, start, place(q), length)
        q.weight *= math.exp(-tau)


@inlined
def _most_reflected(q, world):
    """Return the reflectance of waves that lean away from the light by `_LEANING` deviations."""
    n, lean = world.medium.n_water / world.medium.n_air, _LEANING * world.joins.spread
    flat = math.sqrt(max(1.0 - q.dz * q.dz, 0.0))
    c = (q.dz - lean * flat) / math.sqrt(1.0 + lean * lean)
    square = 1.0 - n * n * (1.0 - c * c)
    if c <= 0.0 or square <= 0.0:
        return 1.0
    return reflectance(c, math.sqrt(square), world.medium.n_water, world.medium.n_air)


@outlined
def _stays(q, world):
    """Return whether a photon that meets the surface is followed back into the water."""
    if not world.interface.follow_reflected:
        return False
    if not interface.is_rough(world.surface.roughness):
        return True  # `_reflect` plays, by the reflectance itself
    # of the next event: the last one may have played, too
    _, _, lot, _ = uniforms(world.seed, q.id, q.event + 1, Purpose.INTERFACE.value)
    q.bend = 0.0
    way = max(q.level - q.z, 0.0) / q.dz if q.dz > 0.0 else 0.0
    share = _most_reflected(q, world)
    if world.medium.absorption == Absorption.CONTINUOUS:
        share *= math.exp(-absorption_path(world.medium, q.z, q.z + way * q.dz, way))
    return survives(q, along(place(q), heading(q), way), share, lot, world)


@outlined
def _reflect(q, facet, world):
    """Reflect a photon off a facet; return whether it lives."""
    p, d = place(q), heading(q)
    g, n, lot = bending_normal(q, facet, world)
    medium = world.medium
    rho, _, reflected = branches(d, n, g, medium.n_water, medium.n_air, world.interface)
    q.event += 1
    q.reflections += 1
    q.weight *= rho * world.interface.foam_transmittance
    q.density = 0.0
    if q.weight == 0.0 or not survives(q, place(q), 1.0, lot, world):
        return False
    at = along(p, g, -_HAIR)
    q.x, q.y, q.z = at.x, at.y, at.z
    head(q, reflected)
    q.level = level_over(at, world)
    _, u_path, _, _ = uniforms(world.seed, q.id, q.event, Purpose.INTERFACE.value)
    _draw_path(q, u_path, world)
    _look_ahead(q, world, world.manifold)
    return True


@inlined
def _is_worth(q, is_turned, world):
    """Play the roulette of an event; return whether the photon lives.

    Where directions count, when it is turned, else before: guided copies are light on purpose.
    """
    if (world.joins.window.bent > 0.0) != is_turned:
        return True
    return survives(q, place(q), 1.0, -1.0, world)


@outlined
def _bounce(q, world):
    """Reflect a photon off the bottom; return whether it lives."""
    q.z = world.medium.bottom_z
    q.weight *= world.medium.bottom_albedo
    q.event += 1
    if q.weight == 0.0:
        return False
    join_collision(q, YES, world)
    if not _is_worth(q, NO, world):
        return False
    u_cos, u_phi, u_path, _ = uniforms(world.seed, q.id, q.event, Purpose.BOTTOM.value)
    head(q, lambert_reflection(u_cos, u_phi))
    if q.density > 0.0:
        q.density = q.dz / math.pi
    _draw_path(q, u_path, world)
    _look_ahead(q, world, world.manifold)
    return _is_worth(q, YES, world)


@outlined
def _scatter(q, world):
    """Apply a collision; return whether the photon lives."""
    q.event += 1
    u_kind, u_theta, u_phi, u_path = uniforms(world.seed, q.id, q.event, Purpose.COLLISION.value)
    s, q.weight, _ = collide(world.medium, place(q), q.weight, u_kind, u_theta)
    if q.weight == 0.0:
        return False
    if s >= 0.0:
        q.weight /= world.joins.often
        if q.order == 0:
            q.importance /= world.joins.often  # no roulette for it
        join_collision(q, NO, world)
        if not _is_worth(q, NO, world):
            return False
        n = copies_of(q, world)
        q.weight /= n
        for _ in range(n - 1):
            q.copies += 1
            world.photon[q.copies] = q
        redirect(q, s, u_phi, world)
        _look_ahead(q, world, world.manifold)
        if not _is_worth(q, YES, world):
            return False
    elif not survives(q, place(q), 1.0, -1.0, world):  # null collisions in the clear are many
        return False
    _draw_path(q, u_path, world)
    return True


@outlined
def _resume(q, world):
    """Take up a copy that has waited behind its collision; return whether it lives.

    Its random numbers are those of the next event: no two of a photon's tree are the same.
    """
    event, copies = q.event, q.copies
    world.photon[0] = world.photon[copies]
    q.event, q.copies = event + 1, copies - 1
    u_kind, u_theta, u_phi, u_path = uniforms(world.seed, q.id, q.event, Purpose.COLLISION.value)
    b, bubbles = scattering_coefficients(world.medium, place(q))
    phase = world.medium.phase_water
    if u_kind * (b + bubbles) >= b:
        phase = world.medium.phase_bubble
    redirect(q, sample_s(phase, u_theta), u_phi, world)
    _look_ahead(q, world, world.manifold)
    _draw_path(q, u_path, world)
    return _is_worth(q, YES, world)


@outlined
def _walk(q, world):
    """Follow a photon to its end."""
    low, high, bottom = world.surface.low[2], world.surface.high[2], world.medium.bottom_z
    alive = q.weight > 0.0
    while alive and q.event < world.events:
        t, facet = q.free, np.int64(-1)
        if q.z + t * q.dz > low or (q.z >= low and q.dz > -1.0):
            surely = q.z + t * q.dz > high
            if surely and not _stays(q, world):
                return  # before the search for the facet
            facet, distance = _facet_ahead(q, world)
            if facet >= 0 and distance < t:
                if not surely and not _stays(q, world):
                    return
                _fly(q, distance, world)
                alive = _reflect(q, facet, world)
                continue
            if facet < 0 and surely:
                return  # beside the mesh
        if q.dz < 0.0 and q.z + t * q.dz < bottom:
            _fly(q, (bottom - q.z) / q.dz, world)
            alive = _bounce(q, world)
        elif math.isinf(t):
            return
        else:
            _fly(q, t, world)
            alive = _scatter(q, world)


@entry
def follow_joined(first, last, world):
    """Follow the photons first <= id < last and all their copies to their ends.

    Array twin: the analog photon, `meshtrace.engine.photons.flight.follow`.
    """
    q = world.photon[0]
    for photon in range(first, last):
        _start(q, photon, world)
        _walk(q, world)
        while q.copies > 0:
            if _resume(q, world):
                _walk(q, world)
