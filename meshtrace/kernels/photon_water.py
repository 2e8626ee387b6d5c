"""The analog photon in the water: flights, collisions and the bottom."""

from __future__ import annotations

import math

from meshtrace.kernels.jit import inlined, outlined
from meshtrace.kernels.medium import Absorption, absorption_path, collide, sample_free_path
from meshtrace.kernels.photon_state import (
    Vertex,
    head,
    heading,
    place,
    put,
    record,
    roulette,
    score_on_apertures,
    set_weight,
)
from meshtrace.kernels.random import Purpose, uniforms
from meshtrace.kernels.sky import SUN_SCORE, sunlight
from meshtrace.kernels.sources import lambert_reflection
from meshtrace.kernels.tally import Fate, Flight, score_map, score_planes
from meshtrace.kernels.vectors import along, turn


@inlined
def fly_water(q, length, world):
    """Move a photon in water: absorption along the way, planes and apertures on the way."""
    p = along(place(q), heading(q), length)
    a_path = 0.0
    if world.medium.absorption == Absorption.CONTINUOUS:
        a_path = absorption_path(world.medium, q.z, p.z, length)
    if len(world.tallies.planes) > 0 or world.apertures.any_in_water or world.tallies.map_z < 0.0:
        _score_water(q, length, world)
    put(q, p)
    q.water += length
    if a_path > 0.0:
        set_weight(q, q.weight * math.exp(-a_path), Fate.ABSORBED, world)


@inlined
def lowest(world):
    """Return a height below every plane, map and aperture in the water."""
    low = min(world.surface.low[2], world.tallies.map_z)
    for h in world.tallies.planes:
        low = min(low, h)
    for i in range(len(world.apertures.radius)):
        low = min(low, world.apertures.center[i, 2] - world.apertures.radius[i])
    return low - 1.0


@outlined
def _score_water(q, length, world):
    """Score a path in water on planes and apertures; not inlined, most links have none."""
    flight = Flight(place(q), heading(q), length, q.weight, q.water, q.air)
    column = len(world.apertures.radius)
    score_planes(world.tallies, column, q.id - world.first, flight, world.medium)
    score_on_apertures(q, True, flight, world)
    if world.tallies.map_z < 0.0:
        score_map(world.tallies, flight, world.medium)


@inlined
def _continue(q, u_path, world):
    """Draw the next free path after a collision; end a photon by its limits."""
    q.free = sample_free_path(world.medium, place(q), u_path)
    if q.event >= world.limits.events:
        return Fate.EVENT_LIMIT
    return roulette(q, -1.0, world)


@inlined
def scatter(q, world):
    """Apply a collision at the position of a photon."""
    q.event += 1
    if world.back.irradiance > 0.0:
        light = sunlight(world.back, world.medium, place(q), heading(q), q.weight)
        world.tallies.score[q.id - world.first, SUN_SCORE] += light
    u_kind, u_theta, u_phi, u_path = uniforms(world.seed, q.id, q.event, Purpose.COLLISION)
    s, weight = collide(world.medium, place(q), q.weight, u_kind, u_theta)
    if weight != q.weight:
        set_weight(q, weight, Fate.ABSORBED, world)
        if weight == 0.0:
            return Fate.ABSORBED
    if s >= 0.0:
        head(q, turn(heading(q), s, u_phi))
        record(world.recorder, q, Vertex.SCATTER)
    return _continue(q, u_path, world)


@outlined
def bounce(q, world):
    """Apply the reflection or absorption at the bottom; not inlined, most links have none."""
    fly_water(q, (world.medium.bottom_z - q.z) / q.dz, world)
    q.z = world.medium.bottom_z
    kept = q.weight * world.medium.bottom_albedo
    if kept == 0.0:
        return Fate.BOTTOM
    set_weight(q, kept, Fate.BOTTOM, world)
    q.event += 1
    u_cos, u_phi, u_path, _ = uniforms(world.seed, q.id, q.event, Purpose.BOTTOM)
    head(q, lambert_reflection(u_cos, u_phi))
    record(world.recorder, q, Vertex.BOTTOM)
    return _continue(q, u_path, world)
