"""The analog photon: from the source through the water to the surface and beyond.

A pool of slots holds the photons under way. One call of `advance` settles the rays that were
cast for the pool, moves every photon until it needs the surface again or has ended, and puts a
new photon into each free slot: the rays of one pool are one batch for Embree.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.facets import (
    Surface,
    exposure,
    is_rough,
    normal_on,
    plane_distance,
    slope_tilt,
    tilted,
)
from meshtrace.kernels.interface import FresnelMode, Interface, branches
from meshtrace.kernels.jit import entry, inlined, outlined
from meshtrace.kernels.medium import Absorption, Medium, absorption_path, collide, sample_free_path
from meshtrace.kernels.random import Purpose, uniforms
from meshtrace.kernels.sources import Sources, lambert_reflection, launch
from meshtrace.kernels.tally import (
    Apertures,
    Fate,
    Flight,
    Tallies,
    deposit,
    score_apertures,
    score_map,
    score_planes,
)
from meshtrace.kernels.vectors import Vec2, Vec3, along, dot, on_circle, row, scaled, turn

PHOTON = np.dtype(
    [
        ("x", float),  # position [m]
        ("y", float),
        ("z", float),
        ("dx", float),  # direction
        ("dy", float),
        ("dz", float),
        ("weight", float),
        ("free", float),  # way to the next collision [m]
        ("water", float),  # path in the water [m]
        ("air", float),
        ("id", np.int64),
        ("event", np.int64),
        ("crossings", np.int64),
        ("facet", np.int64),
        ("in_water", np.int64),
        ("status", np.int64),  # Status
        ("retry", np.int64),
        ("outcome", np.int64),  # RECEIVED or LANDED once light left the sea, else -1
    ]
)
"""A photon under way."""


class Status(IntEnum):
    """Status of a slot of the pool."""

    EMPTY = 0
    MOVING = 1
    WAITING = 2


class Vertex(IntEnum):
    """Event at a vertex of a recorded path."""

    SOURCE = 0
    SCATTER = 1
    SURFACE_OUT = 2
    SURFACE_IN = 3
    BOTTOM = 4
    RECEIVED = 5
    LANDED = 6
    END = 7
    BRANCH = 8


class Miss(IntEnum):
    """Rays that missed the surface inside the mesh, `Tallies.misses`."""

    CAST_AGAIN = 0
    GIVEN_UP = 1


GOES_ON = -1  # else a function returns the fate that ends the photon

_NUDGE = 1e-4  # [m], displacement of a missed ray that is cast again
_OFFSET = 1e-5  # [m], distance of a ray's start from the facet that it leaves
_RETRIES = 3
_LEAST_ROUGH = 0.3  # normal_z: no slopes are added to steeper facets, those of jets are smooth


class Pool(NamedTuple):
    """The photons under way."""

    photon: NDArray[np.void]  # (slots,) PHOTON
    origin: NDArray[np.float32]  # (slots, 3) rays to cast
    direction: NDArray[np.float32]
    ray_slot: NDArray[np.int64]  # slot that each ray belongs to


class Limits(NamedTuple):
    """Conditions that end a photon."""

    weight: float  # Russian roulette below
    survival: float  # 0: survive with weight / limit; else with this probability
    events: int
    surface_events: int
    first_scored: int  # crossing from which on light is scored; 2 scores light sent back once


class Recorder(NamedTuple):
    """Paths of the first photons, for visualisation; tallies are unaffected."""

    vertex: NDArray[np.float64]  # (photons, vertices, 3)
    weight: NDArray[np.float64]  # (photons, vertices)
    what: NDArray[np.int8]  # Vertex
    length: NDArray[np.int64]  # (photons,)


class World(NamedTuple):
    """Everything that the photons of a chunk share."""

    first: int  # id of the first photon
    seed: np.uint64
    sources: Sources
    surface: Surface
    medium: Medium
    apertures: Apertures
    interface: Interface
    limits: Limits
    tallies: Tallies
    recorder: Recorder


@inlined
def _place(q):
    return Vec3(q.x, q.y, q.z)


@inlined
def _heading(q):
    return Vec3(q.dx, q.dy, q.dz)


@inlined
def _put(q, p):
    q.x, q.y, q.z = p.x, p.y, p.z


@inlined
def _head(q, d):
    q.dx, q.dy, q.dz = d.x, d.y, d.z


@inlined
def _record(recorder, q, what):
    if q.id < len(recorder.length):
        _write(recorder, q.id, _place(q), q.weight, what)


@outlined
def _write(recorder, photon, p, weight, what):
    n = recorder.length[photon]
    if n < recorder.vertex.shape[1]:
        recorder.vertex[photon, n, 0] = p.x
        recorder.vertex[photon, n, 1] = p.y
        recorder.vertex[photon, n, 2] = p.z
        recorder.weight[photon, n] = weight
        recorder.what[photon, n] = what
        recorder.length[photon] = n + 1


@inlined
def _start(q, photon, world):
    """Put a new photon into a slot."""
    p, d, in_water, u_path = launch(world.sources, world.seed, photon)
    _put(q, p)
    _head(q, d)
    q.weight, q.water, q.air = 1.0, 0.0, 0.0
    q.free = sample_free_path(world.medium, p, u_path) if in_water else math.inf
    q.id, q.event, q.crossings, q.facet = photon, 0, 0, -1
    q.in_water, q.status, q.retry, q.outcome = int(in_water), Status.MOVING, 0, -1
    _record(world.recorder, q, Vertex.SOURCE)


@inlined
def _end(q, fate, world):
    """Deposit the rest of the weight, count the photon and free its slot."""
    deposit(world.tallies, fate, q.weight)
    world.tallies.n_photons[q.outcome if q.outcome >= 0 else fate] += 1
    _record(world.recorder, q, Vertex.END)
    q.status = Status.EMPTY


@inlined
def _inside(q, t, surface):
    """Return whether a photon is over the mesh after a distance t."""
    x, y = q.x + t * q.dx, q.y + t * q.dy
    return surface.low[0] <= x <= surface.high[0] and surface.low[1] <= y <= surface.high[1]


@inlined
def _fly_water(q, length, world):
    """Move a photon in water: absorption along the way, planes and apertures on the way."""
    p = along(_place(q), _heading(q), length)
    a_path = 0.0
    if world.medium.absorption == Absorption.CONTINUOUS:
        a_path = absorption_path(world.medium, q.z, p.z, length)
    if len(world.tallies.planes) > 0 or world.apertures.any_in_water:
        _score_water(q, length, world)
    _put(q, p)
    q.water += length
    if a_path > 0.0:
        _set_weight(q, q.weight * math.exp(-a_path), Fate.ABSORBED, world)


@inlined
def _set_weight(q, weight, fate, world):
    """Change the weight of a photon and deposit the difference."""
    deposit(world.tallies, fate, q.weight - weight)
    q.weight = weight


@inlined
def _lowest(world):
    """Return a height below every plane and aperture in the water."""
    low = world.surface.low[2]
    for h in world.tallies.planes:
        low = min(low, h)
    for i in range(len(world.apertures.radius)):
        low = min(low, world.apertures.center[i, 2] - world.apertures.radius[i])
    return low - 1.0


@outlined
def _score_water(q, length, world):
    """Score a path in water on planes and apertures; not inlined, most links have none."""
    flight = Flight(_place(q), _heading(q), length, q.weight, q.water, q.air)
    column = len(world.apertures.radius)
    score_planes(world.tallies, column, q.id - world.first, flight, world.medium)
    _score_apertures(q, True, flight, world)


@inlined
def _score_apertures(q, in_water, flight, world):
    return score_apertures(
        world.tallies,
        world.apertures,
        world.first,
        q.id,
        in_water,
        flight,
        world.interface.fov,
        world.medium,
    )


@inlined
def _roulette(q, lot, world):
    """Play Russian roulette with a low-weight photon; draw a new uniform if `lot` is negative."""
    if q.weight >= world.limits.weight:
        return GOES_ON
    p = world.limits.survival if world.limits.survival > 0.0 else q.weight / world.limits.weight
    if lot < 0.0:
        lot, _, _, _ = uniforms(world.seed, q.id, q.event, Purpose.ROULETTE)
    if lot >= p:
        return Fate.ROULETTE
    _set_weight(q, q.weight / p, Fate.ROULETTE, world)
    return GOES_ON


@inlined
def _continue(q, u_path, world):
    """Draw the next free path after a collision; end a photon by its limits."""
    q.free = sample_free_path(world.medium, _place(q), u_path)
    if q.event >= world.limits.events:
        return Fate.EVENT_LIMIT
    return _roulette(q, -1.0, world)


@inlined
def _scatter(q, world):
    """Apply a collision at the position of a photon."""
    q.event += 1
    u_kind, u_theta, u_phi, u_path = uniforms(world.seed, q.id, q.event, Purpose.COLLISION)
    s, weight = collide(world.medium, _place(q), q.weight, u_kind, u_theta)
    if weight != q.weight:
        _set_weight(q, weight, Fate.ABSORBED, world)
        if weight == 0.0:
            return Fate.ABSORBED
    if s >= 0.0:
        _head(q, turn(_heading(q), s, u_phi))
        _record(world.recorder, q, Vertex.SCATTER)
    return _continue(q, u_path, world)


@outlined
def _bounce(q, world):
    """Apply the reflection or absorption at the bottom; not inlined, most links have none."""
    _fly_water(q, (world.medium.bottom_z - q.z) / q.dz, world)
    q.z = world.medium.bottom_z
    kept = q.weight * world.medium.bottom_albedo
    if kept == 0.0:
        return Fate.BOTTOM
    _set_weight(q, kept, Fate.BOTTOM, world)
    q.event += 1
    u_cos, u_phi, u_path, _ = uniforms(world.seed, q.id, q.event, Purpose.BOTTOM)
    _head(q, lambert_reflection(u_cos, u_phi))
    _record(world.recorder, q, Vertex.BOTTOM)
    return _continue(q, u_path, world)


@inlined
def _steeper_than_waves(d, surface):
    """Return whether a direction is steeper than every facet: away from the surface it stays so."""
    slope = surface.max_slope
    return d.z * d.z > slope * slope * (d.x * d.x + d.y * d.y)


@inlined
def _free_of_surface(z, d, world):
    """Return whether a path in air cannot meet the surface again."""
    if not world.interface.follow_second_hit or (d.z > 0.0 and z >= world.surface.high[2]):
        return True
    return d.z > 0.0 and _steeper_than_waves(d, world.surface)


@inlined
def _to_sky(q, d, weight, world):
    """Score light that leaves the surface for good and deposit its weight."""
    flight = Flight(_place(q), d, math.inf, weight, q.water, q.air)
    scored = q.crossings >= world.limits.first_scored
    received = scored and _score_apertures(q, False, flight, world)
    score_map(world.tallies, flight)
    deposit(world.tallies, Fate.RECEIVED if received else Fate.LANDED, weight)
    if received:
        q.outcome = Fate.RECEIVED
    elif q.outcome < 0:
        q.outcome = Fate.LANDED
    if q.id < len(world.recorder.length):
        _record_flight(q, flight, received, world)


@outlined
def _record_flight(q, flight, received, world):
    """Record the point of a path in air at the height of the first aperture."""
    p, d, t = flight.origin, flight.direction, 1.0
    if len(world.apertures.radius) > 0 and d.z > 0.0:
        t = max((world.apertures.center[0, 2] - p.z) / d.z, 0.0)
    what = Vertex.RECEIVED if received else Vertex.LANDED
    _write(world.recorder, q.id, along(p, d, t), flight.weight, what)


@outlined
def _roughened(q, n, world):
    """Return a normal tilted by the slopes that the mesh leaves out, and a spare uniform.

    A tilt t and its opposite are equally common; the light picks one of the two by their
    exposures, which add up to 2.
    """
    u, v, w, lot = uniforms(world.seed, q.id, q.event, Purpose.SLOPE)
    r = math.sqrt(-2.0 * math.log(u))
    cos_phi, sin_phi = on_circle(v)
    tilt = slope_tilt(world.surface.roughness, r * cos_phi, r * sin_phi)
    if 2.0 * w >= exposure(_heading(q), n, tilt):
        tilt = Vec2(-tilt.x, -tilt.y)
    return tilted(n, tilt), lot


@inlined
def _cross(q, world):
    """Refract and reflect a photon on facet `q.facet`.

    The part that flies free through the air is scored at once; the part in the water goes on
    with its weight. Where the air part may meet the surface again one of the two is chosen.
    """
    in_water = q.in_water == 1
    q.crossings += 1
    foam = world.interface.foam_transmittance
    if foam < 1.0:
        deposit(world.tallies, Fate.WHITECAP, q.weight * (1.0 - foam))
        q.weight *= foam
        if foam == 0.0:
            return Fate.WHITECAP
    _record(world.recorder, q, Vertex.SURFACE_OUT if in_water else Vertex.SURFACE_IN)
    rho, g, transmitted, reflected, lot = _split(q, in_water, world)
    if in_water:
        w_air, w_water = q.weight * (1.0 - rho), q.weight * rho
        air, water = transmitted, reflected
    else:
        w_air, w_water = q.weight * rho, q.weight * (1.0 - rho)
        air, water = reflected, transmitted

    free = _free_of_surface(q.z, air, world)
    if world.interface.fresnel != FresnelMode.WEIGHT or not free:
        u, _, _, _ = uniforms(world.seed, q.id, q.event, Purpose.INTERFACE)
        if u * (w_air + w_water) < w_air:
            if world.interface.fresnel == FresnelMode.PAPER_BOTH:
                # E4: roulette and weight, twice the loss
                _set_weight(q, w_air, Fate.REFLECTED, world)
            w_air, w_water = q.weight, 0.0
        else:
            w_air, w_water = 0.0, q.weight
    q.event += 1
    q.in_water = int(w_water > 0.0)
    q.weight = w_water
    if w_air > 0.0:
        if not free:
            q.weight = w_air
            return _leave(q, air, g, world)
        _to_sky(q, air, w_air, world)
    if w_water == 0.0:
        return Fate.LANDED
    if in_water and not world.interface.follow_reflected:
        return Fate.REFLECTED
    fate = _roulette(q, lot, world)
    if fate != GOES_ON:
        return fate
    _record(world.recorder, q, Vertex.BRANCH)
    _, u_path, _, _ = uniforms(world.seed, q.id, q.event, Purpose.INTERFACE)
    q.free = sample_free_path(world.medium, _place(q), u_path)
    return _leave(q, water, scaled(-1.0, g), world)


@inlined
def _split(q, in_water, world):
    """Return reflectance, facet normal, both directions and a spare uniform of a crossing."""
    g = row(world.surface.face_normals, q.facet)
    n = normal_on(_place(q), q.facet, world.surface)
    lot = -1.0
    if g.z > _LEAST_ROUGH and is_rough(world.surface.roughness):
        n, lot = _roughened(q, n, world)
    side, n1, n2 = 1.0, world.medium.n_water, world.medium.n_air
    if not in_water:
        side, n1, n2 = -1.0, n2, n1
    rho, transmitted, reflected = branches(
        _heading(q), scaled(side, n), scaled(side, g), n1, n2, world.interface
    )
    return rho, g, transmitted, reflected, lot


@outlined
def _leave(q, d, g, world):
    """Send a photon off a facet, along d, on the side that g points to."""
    _head(q, d)
    _put(q, along(_place(q), g, _OFFSET))
    if q.in_water == 0:
        q.free = math.inf
    if q.crossings >= world.limits.surface_events or q.event >= world.limits.events:
        return Fate.EVENT_LIMIT
    return GOES_ON


@inlined
def _needs_ray(q, world):
    """Return whether the next flight of a photon may meet the surface."""
    if q.in_water == 0:
        return True
    low = world.surface.low[2]
    z1 = q.z + q.free * q.dz if q.dz != 0.0 else q.z
    if z1 < low:
        return q.z >= low and not _steeper_than_waves(_heading(q), world.surface)
    return True


@inlined
def _cast(q, slot, n_rays, pool, world):
    """Write the ray of a waiting photon from its entry into the slab of the surface."""
    t = 0.0
    if q.in_water == 1 and q.dz > 0.0:
        t = (world.surface.low[2] - q.z) / q.dz
    elif q.in_water == 0 and q.dz < 0.0:
        t = (world.surface.high[2] - q.z) / q.dz
    t = max(t - 1e-3 * (1.0 + t), 0.0)
    nudge = _NUDGE * q.retry
    pool.origin[n_rays, 0] = q.x + t * q.dx + nudge
    pool.origin[n_rays, 1] = q.y + t * q.dy + 0.7 * nudge
    pool.origin[n_rays, 2] = q.z + t * q.dz + (-nudge if q.in_water == 1 else nudge)
    pool.direction[n_rays, 0] = q.dx
    pool.direction[n_rays, 1] = q.dy
    pool.direction[n_rays, 2] = q.dz
    pool.ray_slot[n_rays] = slot
    q.status = Status.WAITING
    return n_rays + 1


@outlined
def _settle_miss(q, seen, world):
    """Return (fate, distance) for a ray that met no facet of its own side.

    The photon goes on by the distance, and a photon that is cast again by none; LANDED means
    that it left for the sky. A miss is right where the path ends inside the slab, leaves it
    downwards or lies outside the mesh. `seen`: a facet was met from behind, since the ray
    started on the wrong side.
    """
    t = math.inf
    low, high = world.surface.low[2], world.surface.high[2]
    if not seen and q.in_water == 0 and q.dz > 0.0:
        return Fate.LANDED, 0.0
    if q.in_water == 0:
        if q.dz < 0.0:
            t = (low - q.z) / q.dz
    elif not seen and q.dz < 0.0 and q.z + q.free * q.dz < low:
        return GOES_ON, (low - q.z) / q.dz + 1e-9
    elif not seen and q.free < math.inf and q.z + q.free * q.dz <= high:
        if _inside(q, q.free, world.surface):
            return GOES_ON, q.free
    elif q.dz > 0.0:
        t = (high - q.z) / q.dz
    if not seen and not (t < math.inf and _inside(q, t, world.surface)):
        return Fate.LEFT_DOMAIN, 0.0
    if q.retry < _RETRIES:
        world.tallies.misses[Miss.CAST_AGAIN] += 1
        q.retry += 1
        return GOES_ON, 0.0
    world.tallies.misses[Miss.GIVEN_UP] += 1
    return Fate.LEAKED, 0.0


@inlined
def _settle(q, facet, world):
    """Apply the result of a photon's ray: crossing, collision before it, or a miss."""
    q.status = Status.MOVING
    t = math.inf
    if facet >= 0:
        n = row(world.surface.face_normals, facet)
        # single precision may find the facet that the ray leaves, or its neighbour, from behind
        if (dot(_heading(q), n) > 0.0) == (q.in_water == 1):
            t = max(plane_distance(_place(q), _heading(q), facet, world.surface), 0.0)
    if math.isinf(t):
        fate, length = _settle_miss(q, facet >= 0, world)
        if fate == Fate.LANDED:
            _to_sky(q, _heading(q), q.weight, world)
            q.weight = 0.0
        if fate != GOES_ON or length == 0.0:
            return fate
        q.retry = 0
        if length < q.free:
            _fly_water(q, length, world)
            q.free -= length
            return GOES_ON
    q.retry = 0
    if q.in_water == 1:
        _fly_water(q, min(t, q.free), world)
        if q.free < t:
            return _scatter(q, world)
    else:
        _put(q, along(_place(q), _heading(q), t))
        q.air += t
    q.facet = facet
    return _cross(q, world)


@inlined
def _enter_slab(q, world):
    """End a photon that comes up beside the mesh: there is no surface to meet."""
    if q.in_water == 1 and q.dz > 0.0 and q.z < world.surface.low[2]:
        t = (world.surface.low[2] - q.z) / q.dz
        if not _inside(q, t, world.surface):
            _fly_water(q, t, world)
            return Fate.LEFT_DOMAIN
    return GOES_ON


@inlined
def _move(q, world):
    """Move a photon until it needs a ray (GOES_ON) or has ended."""
    while True:
        if q.retry > 0 or _needs_ray(q, world):
            return _enter_slab(q, world)
        if q.dz < 0.0 and q.z + q.free * q.dz < world.medium.bottom_z:
            fate = _bounce(q, world)
        elif math.isinf(q.free):  # descends without end: with no bottom only absorption is left
            low = _lowest(world)
            if q.z > low and q.dz < 0.0:
                _fly_water(q, (low - q.z) / q.dz, world)
            return Fate.ABSORBED if world.medium.a > 0.0 else Fate.DEEP
        else:
            _fly_water(q, q.free, world)
            fate = _scatter(q, world)
        if fate != GOES_ON:
            return fate


@entry
def advance(pool, n_waiting, facets, next_photon, last, world):
    """Apply the rays of a pool, advance its photons, fill free slots; return the new rays.

    Array twin: the plain tracer of `tests/benchmarks`.
    Photon ids run from `world.first` to `last`; a photon's result does not depend on its slot.
    """
    n_rays = 0
    for k in range(n_waiting):
        slot = pool.ray_slot[k]
        q = pool.photon[slot]
        fate = GOES_ON
        if q.status == Status.WAITING:
            fate = _settle(q, np.int64(facets[k]), world)
        while True:
            if q.status == Status.MOVING:
                if fate == GOES_ON:
                    fate = _move(q, world)
                if fate == GOES_ON:
                    n_rays = _cast(q, slot, n_rays, pool, world)
                    break
                _end(q, fate, world)
            if next_photon >= last:
                break
            _start(q, next_photon, world)
            next_photon += 1
            fate = GOES_ON
    return n_rays, next_photon
