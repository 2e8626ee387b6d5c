"""The analog photon: from the source through the water to the surface and beyond.

A pool of slots holds the photons under way. One call of `advance` settles the rays that were
cast for the pool, moves every photon until it needs the surface again or has ended, and puts a
new photon into each free slot: the rays of one pool are one batch for Embree.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.facets import (
    Surface,
    exposure,
    is_rough,
    normal_at,
    plane_distance,
    slope_tilt,
    tilted,
)
from meshtrace.kernels.interface import (
    DIRECTION_VECTOR,
    FRESNEL_PAPER_BOTH,
    FRESNEL_WEIGHT,
    SNELL_PHYSICAL,
    Interface,
    reflectance,
    refract,
    refract_as_printed,
)
from meshtrace.kernels.jit import entry, inlined, outlined
from meshtrace.kernels.medium import CONTINUOUS, Medium, absorption_path, collide, sample_free_path
from meshtrace.kernels.random import Purpose, uniforms
from meshtrace.kernels.sources import Sources, lambert_reflection, launch
from meshtrace.kernels.tally import (
    ABSORBED,
    BOTTOM,
    DEEP,
    EVENT_LIMIT,
    LANDED,
    LEAKED,
    LEFT_DOMAIN,
    RECEIVED,
    REFLECTED,
    ROULETTE,
    WHITECAP,
    Apertures,
    Tallies,
    deposit,
    score_apertures,
    score_map,
    score_planes,
)
from meshtrace.kernels.vectors import on_circle, turn

_COLLISION = int(Purpose.COLLISION)
_INTERFACE = int(Purpose.INTERFACE)
_ROULETTE = int(Purpose.ROULETTE)
_BOTTOM = int(Purpose.BOTTOM)
_SLOPE = int(Purpose.SLOPE)

# columns of Pool.state
X, Y, Z, DX, DY, DZ, W, S, WATER_PATH, AIR_PATH = range(10)
# columns of Pool.flag
PHOTON, EVENT, N_SURFACE, FACET, IN_WATER, STATUS, RETRY, OUTCOME = range(8)
# Pool.flag[:, STATUS]
EMPTY, MOVING, WAITING = 0, 1, 2

GOES_ON = -1  # else a function returns the fate that ends the photon

_NUDGE = 1e-4  # [m], how far a missed ray is displaced when it is cast again
_OFFSET = 1e-5  # [m], how far a ray starts off the facet that it leaves
_RETRIES = 3

# what a recorded vertex is
(
    V_SOURCE,
    V_SCATTER,
    V_SURFACE_OUT,
    V_SURFACE_IN,
    V_BOTTOM,
    V_RECEIVED,
    V_LANDED,
    V_END,
    V_BRANCH,
) = range(9)


class Pool(NamedTuple):
    """The photons under way."""

    state: NDArray[np.float64]  # (slots, 10)
    flag: NDArray[np.int64]  # (slots, 8)
    origin: NDArray[np.float32]  # (slots, 3) rays to cast
    direction: NDArray[np.float32]
    ray_slot: NDArray[np.int64]  # slot that each ray belongs to


class Limits(NamedTuple):
    """When a photon ends."""

    weight: float  # Russian roulette below
    survival: float  # 0: survive with weight / limit; else with this probability
    events: int
    surface_events: int
    first_scored: int  # crossing from which on light is scored; 2 scores what was sent back


class Recorder(NamedTuple):
    """Paths of the first photons, for the eye; tallies do not look at it."""

    vertex: NDArray[np.float64]  # (photons, vertices, 3)
    weight: NDArray[np.float64]  # (photons, vertices)
    what: NDArray[np.int8]
    length: NDArray[np.int64]  # (photons,)


class World(NamedTuple):
    """All that the photons of a chunk share."""

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
def _record(recorder, photon, x, y, z, weight, what):
    if photon < len(recorder.length):
        _write(recorder, photon, x, y, z, weight, what)


@outlined
def _write(recorder, photon, x, y, z, weight, what):
    n = recorder.length[photon]
    if n < recorder.vertex.shape[1]:
        recorder.vertex[photon, n, 0] = x
        recorder.vertex[photon, n, 1] = y
        recorder.vertex[photon, n, 2] = z
        recorder.weight[photon, n] = weight
        recorder.what[photon, n] = what
        recorder.length[photon] = n + 1


@inlined
def _start(q, f, photon, world):
    """Put a new photon into a slot."""
    x, y, z, dx, dy, dz, in_water, u_path = launch(world.sources, world.seed, photon)
    q[X], q[Y], q[Z], q[DX], q[DY], q[DZ] = x, y, z, dx, dy, dz
    q[W], q[WATER_PATH], q[AIR_PATH] = 1.0, 0.0, 0.0
    q[S] = sample_free_path(world.medium, x, y, z, u_path) if in_water else math.inf
    f[PHOTON], f[EVENT], f[N_SURFACE], f[FACET] = photon, 0, 0, -1
    f[IN_WATER], f[STATUS], f[RETRY], f[OUTCOME] = int(in_water), MOVING, 0, -1
    _record(world.recorder, photon, x, y, z, 1.0, V_SOURCE)


@inlined
def _end(q, f, fate, world):
    """Deposit what is left of the weight, count the photon and free its slot."""
    deposit(world.tallies, fate, q[W])
    world.tallies.n_photons[f[OUTCOME] if f[OUTCOME] >= 0 else fate] += 1
    _record(world.recorder, f[PHOTON], q[X], q[Y], q[Z], q[W], V_END)
    f[STATUS] = EMPTY


@inlined
def _inside(x, y, world):
    return (
        world.surface.low[0] <= x <= world.surface.high[0]
        and world.surface.low[1] <= y <= world.surface.high[1]
    )


@inlined
def _fly_water(q, f, length, world):
    """Move a photon in water: absorption along the way, planes and apertures on the way."""
    z1 = q[Z] + length * q[DZ]
    a_path = 0.0
    if world.medium.absorption == CONTINUOUS:
        a_path = absorption_path(world.medium, q[Z], z1, length)
    if len(world.tallies.planes) > 0 or world.apertures.any_in_water:
        _score_water(q, f, length, world)
    q[X] += length * q[DX]
    q[Y] += length * q[DY]
    q[Z] = z1
    q[WATER_PATH] += length
    if a_path > 0.0:
        weight = q[W] * math.exp(-a_path)
        deposit(world.tallies, ABSORBED, q[W] - weight)
        q[W] = weight


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
def _score_water(q, f, length, world):
    """Score a path in water on planes and apertures; not inlined, most links have none."""
    score_planes(
        world.tallies,
        len(world.apertures.radius),
        f[PHOTON] - world.first,
        q[Z],
        q[Z] + length * q[DZ],
        q[DX],
        q[DY],
        q[DZ],
        length,
        q[W],
        world.medium,
    )
    score_apertures(
        world.tallies,
        world.apertures,
        f[PHOTON] - world.first,
        f[PHOTON],
        True,
        q[X],
        q[Y],
        q[Z],
        q[DX],
        q[DY],
        q[DZ],
        length,
        q[W],
        q[WATER_PATH],
        q[AIR_PATH],
        world.interface.fov,
        world.medium,
    )


@inlined
def _roulette(q, f, lot, world):
    """Play Russian roulette with a light photon, by a lot in (0, 1) or, if negative, a new one."""
    if q[W] >= world.limits.weight:
        return GOES_ON
    p = world.limits.survival if world.limits.survival > 0.0 else q[W] / world.limits.weight
    if lot < 0.0:
        lot, _, _, _ = uniforms(world.seed, f[PHOTON], f[EVENT], _ROULETTE)
    if lot >= p:
        return ROULETTE
    heavier = q[W] / p
    deposit(world.tallies, ROULETTE, q[W] - heavier)
    q[W] = heavier
    return GOES_ON


@inlined
def _scatter(q, f, world):
    """Let a photon collide where it is."""
    f[EVENT] += 1
    u_kind, u_theta, u_phi, u_path = uniforms(world.seed, f[PHOTON], f[EVENT], _COLLISION)
    s, weight = collide(world.medium, q[X], q[Y], q[Z], q[W], u_kind, u_theta)
    if weight != q[W]:
        deposit(world.tallies, ABSORBED, q[W] - weight)
        q[W] = weight
        if weight == 0.0:
            return ABSORBED
    if s >= 0.0:
        q[DX], q[DY], q[DZ] = turn(q[DX], q[DY], q[DZ], s, u_phi)
        _record(world.recorder, f[PHOTON], q[X], q[Y], q[Z], q[W], V_SCATTER)
    q[S] = sample_free_path(world.medium, q[X], q[Y], q[Z], u_path)
    if f[EVENT] >= world.limits.events:
        return EVENT_LIMIT
    return _roulette(q, f, -1.0, world)


@outlined
def _bounce(q, f, world):
    """Let a photon meet the bottom; not inlined, most links have none."""
    length = (world.medium.bottom_z - q[Z]) / q[DZ]
    _fly_water(q, f, length, world)
    q[Z] = world.medium.bottom_z
    kept = q[W] * world.medium.bottom_albedo
    if kept == 0.0:
        return BOTTOM
    deposit(world.tallies, BOTTOM, q[W] - kept)
    q[W] = kept
    f[EVENT] += 1
    u_cos, u_phi, u_path, _ = uniforms(world.seed, f[PHOTON], f[EVENT], _BOTTOM)
    q[DX], q[DY], q[DZ] = lambert_reflection(u_cos, u_phi)
    q[S] = sample_free_path(world.medium, q[X], q[Y], q[Z], u_path)
    _record(world.recorder, f[PHOTON], q[X], q[Y], q[Z], q[W], V_BOTTOM)
    if f[EVENT] >= world.limits.events:
        return EVENT_LIMIT
    return _roulette(q, f, -1.0, world)


@inlined
def _steeper_than_waves(dx, dy, dz, world):
    """Return whether a direction is steeper than every facet: away from the surface it stays so."""
    slope = world.surface.max_slope
    return dz * dz > slope * slope * (dx * dx + dy * dy)


@inlined
def _free_of_surface(z, dx, dy, dz, world):
    """Return whether a path in air cannot meet the surface again."""
    if not world.interface.follow_second_hit or (dz > 0.0 and z >= world.surface.high[2]):
        return True
    return dz > 0.0 and _steeper_than_waves(dx, dy, dz, world)


@inlined
def _to_sky(q, f, dx, dy, dz, weight, world):
    """Score light that leaves the surface for good and deposit its weight."""
    received = f[N_SURFACE] >= world.limits.first_scored and score_apertures(
        world.tallies,
        world.apertures,
        f[PHOTON] - world.first,
        f[PHOTON],
        False,
        q[X],
        q[Y],
        q[Z],
        dx,
        dy,
        dz,
        math.inf,
        weight,
        q[WATER_PATH],
        q[AIR_PATH],
        world.interface.fov,
        world.medium,
    )
    score_map(world.tallies, q[X], q[Y], q[Z], dx, dy, dz, weight)
    deposit(world.tallies, RECEIVED if received else LANDED, weight)
    if received:
        f[OUTCOME] = RECEIVED
    elif f[OUTCOME] < 0:
        f[OUTCOME] = LANDED
    if f[PHOTON] < len(world.recorder.length):
        _record_flight(q, f, dx, dy, dz, weight, received, world)


@outlined
def _record_flight(q, f, dx, dy, dz, weight, received, world):
    """Record where a path in air meets the height of the first aperture."""
    t = 1.0
    if len(world.apertures.radius) > 0 and dz > 0.0:
        t = max((world.apertures.center[0, 2] - q[Z]) / dz, 0.0)
    _write(
        world.recorder,
        f[PHOTON],
        q[X] + t * dx,
        q[Y] + t * dy,
        q[Z] + t * dz,
        weight,
        V_RECEIVED if received else V_LANDED,
    )


@outlined
def _roughened(seed, photon, event, dx, dy, dz, nx, ny, nz, roughness):
    """Return a normal tilted by the slopes that the mesh leaves out, and a number not needed.

    A tilt t and its opposite are equally common; the light picks one of the two by their
    exposures, which add up to 2.
    """
    u, v, w, lot = uniforms(seed, photon, event, _SLOPE)
    r = math.sqrt(-2.0 * math.log(u))
    cos_phi, sin_phi = on_circle(v)
    tx, ty = slope_tilt(roughness, r * cos_phi, r * sin_phi)
    if 2.0 * w >= exposure(dx, dy, dz, nx, ny, nz, tx, ty):
        tx, ty = -tx, -ty
    nx, ny, nz = tilted(nx, ny, nz, tx, ty)
    return nx, ny, nz, lot


@inlined
def _cross(q, f, world):
    """Let a photon on facet f[FACET] refract and reflect.

    The part that flies free through the air is scored at once; the part in the water goes on
    with its weight. Where the air part may meet the surface again one of the two is chosen.
    """
    in_water = f[IN_WATER] == 1
    g = f[FACET]
    f[N_SURFACE] += 1
    foam = world.interface.foam_transmittance
    if foam < 1.0:
        deposit(world.tallies, WHITECAP, q[W] * (1.0 - foam))
        q[W] *= foam
        if foam == 0.0:
            return WHITECAP
    _record(
        world.recorder,
        f[PHOTON],
        q[X],
        q[Y],
        q[Z],
        q[W],
        V_SURFACE_OUT if in_water else V_SURFACE_IN,
    )
    gx, gy, gz = (
        world.surface.face_normals[g, 0],
        world.surface.face_normals[g, 1],
        world.surface.face_normals[g, 2],
    )
    nx, ny, nz = normal_at(q[X], q[Y], g, world.surface)
    lot = -1.0
    if is_rough(world.surface.roughness):
        nx, ny, nz, lot = _roughened(
            world.seed,
            f[PHOTON],
            f[EVENT],
            q[DX],
            q[DY],
            q[DZ],
            nx,
            ny,
            nz,
            world.surface.roughness,
        )
    n1, n2 = (
        (world.medium.n_water, world.medium.n_air)
        if in_water
        else (world.medium.n_air, world.medium.n_water)
    )
    side = 1.0 if in_water else -1.0
    rho, tx, ty, tz, rx, ry, rz = _branches(
        q[DX],
        q[DY],
        q[DZ],
        side * nx,
        side * ny,
        side * nz,
        side * gx,
        side * gy,
        side * gz,
        n1,
        n2,
        world.interface.snell,
        world.interface.direction,
    )
    if in_water:
        w_air, w_water = q[W] * (1.0 - rho), q[W] * rho
        ax, ay, az, bx, by, bz = tx, ty, tz, rx, ry, rz
    else:
        w_air, w_water = q[W] * rho, q[W] * (1.0 - rho)
        ax, ay, az, bx, by, bz = rx, ry, rz, tx, ty, tz

    free = _free_of_surface(q[Z], ax, ay, az, world)
    if world.interface.fresnel != FRESNEL_WEIGHT or not free:
        u, _, _, _ = uniforms(world.seed, f[PHOTON], f[EVENT], _INTERFACE)
        if u * (w_air + w_water) < w_air:
            if (
                world.interface.fresnel == FRESNEL_PAPER_BOTH
            ):  # E4: roulette and weight, twice the loss
                deposit(world.tallies, REFLECTED, q[W] - w_air)
                q[W] = w_air
            w_air, w_water = q[W], 0.0
        else:
            w_air, w_water = 0.0, q[W]
    f[EVENT] += 1
    f[IN_WATER] = int(w_water > 0.0)
    q[W] = w_water
    if w_air > 0.0:
        if not free:
            q[W] = w_air
            return _leave(q, f, ax, ay, az, gx, gy, gz, world)
        _to_sky(q, f, ax, ay, az, w_air, world)
    if w_water == 0.0:
        return LANDED
    if in_water and not world.interface.follow_reflected:
        return REFLECTED
    fate = _roulette(q, f, lot, world)
    if fate != GOES_ON:
        return fate
    _record(world.recorder, f[PHOTON], q[X], q[Y], q[Z], q[W], V_BRANCH)
    _, u_path, _, _ = uniforms(world.seed, f[PHOTON], f[EVENT], _INTERFACE)
    q[S] = sample_free_path(world.medium, q[X], q[Y], q[Z], u_path)
    return _leave(q, f, bx, by, bz, -gx, -gy, -gz, world)


@outlined
def _leave(q, f, dx, dy, dz, gx, gy, gz, world):
    """Send a photon off a facet, along (dx, dy, dz), on the side that (gx, gy, gz) points to."""
    q[DX], q[DY], q[DZ] = dx, dy, dz
    q[X] += _OFFSET * gx
    q[Y] += _OFFSET * gy
    q[Z] += _OFFSET * gz
    if f[IN_WATER] == 0:
        q[S] = math.inf
    if f[N_SURFACE] >= world.limits.surface_events or f[EVENT] >= world.limits.events:
        return EVENT_LIMIT
    return GOES_ON


@inlined
def _branches(dx, dy, dz, nx, ny, nz, gx, gy, gz, n1, n2, snell, direction):
    """Return reflectance, transmitted and reflected direction at a normal along the light.

    An interpolated normal may contradict its facet (g): the light would leave on the wrong
    side. Then the facet's own normal is taken, which cannot.
    """
    rho, tx, ty, tz, rx, ry, rz = 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for _ in range(2):
        cos_i = min(dx * nx + dy * ny + dz * nz, 1.0)
        sound = cos_i > 0.0
        if snell == SNELL_PHYSICAL and direction == DIRECTION_VECTOR:
            cos_t, tx, ty, tz = refract(dx, dy, dz, nx, ny, nz, cos_i, n1, n2)
            rho = reflectance(cos_i, cos_t, n1, n2) if cos_t >= 0.0 else 1.0
        else:
            cos_t, rho, tx, ty, tz = refract_as_printed(
                dx, dy, dz, nx, ny, nz, cos_i, n1, n2, snell, direction
            )
        rx, ry, rz = dx - 2.0 * cos_i * nx, dy - 2.0 * cos_i * ny, dz - 2.0 * cos_i * nz
        if rho < 1.0 and tx * gx + ty * gy + tz * gz <= 0.0:
            sound = False
        if sound and rx * gx + ry * gy + rz * gz < 0.0:
            break
        nx, ny, nz = gx, gy, gz
    return rho, tx, ty, tz, rx, ry, rz


@inlined
def _needs_ray(q, f, world):
    """Return whether the next flight of a photon may meet the surface."""
    if f[IN_WATER] == 0:
        return True
    low = world.surface.low[2]
    z1 = q[Z] + q[S] * q[DZ] if q[DZ] != 0.0 else q[Z]
    if z1 < low:
        return q[Z] >= low and not _steeper_than_waves(q[DX], q[DY], q[DZ], world)
    return True


@inlined
def _cast(q, f, slot, n_rays, pool, world):
    """Write the ray of a waiting photon, started where it enters the slab of the surface."""
    t = 0.0
    if f[IN_WATER] == 1 and q[DZ] > 0.0:
        t = (world.surface.low[2] - q[Z]) / q[DZ]
    elif f[IN_WATER] == 0 and q[DZ] < 0.0:
        t = (world.surface.high[2] - q[Z]) / q[DZ]
    t = max(t - 1e-3 * (1.0 + t), 0.0)
    nudge = _NUDGE * f[RETRY]
    pool.origin[n_rays, 0] = q[X] + t * q[DX] + nudge
    pool.origin[n_rays, 1] = q[Y] + t * q[DY] + 0.7 * nudge
    pool.origin[n_rays, 2] = q[Z] + t * q[DZ] + (-nudge if f[IN_WATER] == 1 else nudge)
    pool.direction[n_rays, 0] = q[DX]
    pool.direction[n_rays, 1] = q[DY]
    pool.direction[n_rays, 2] = q[DZ]
    pool.ray_slot[n_rays] = slot
    f[STATUS] = WAITING
    return n_rays + 1


@outlined
def _settle_miss(q, f, seen, world):
    """Return (fate, distance) for a ray that met no facet of its own side.

    The photon goes on by the distance, and a photon that is cast again by none; LANDED means
    that it left for the sky. A miss is right where the path ends inside the slab, leaves it
    downwards or lies outside the mesh. `seen` tells that a facet was met from behind: the ray
    started on the wrong side.
    """
    t = math.inf
    if not seen and f[IN_WATER] == 0 and q[DZ] > 0.0:
        return LANDED, 0.0
    if f[IN_WATER] == 0:
        if q[DZ] < 0.0:
            t = (world.surface.low[2] - q[Z]) / q[DZ]
    elif not seen and q[DZ] < 0.0 and q[Z] + q[S] * q[DZ] < world.surface.low[2]:
        return GOES_ON, (world.surface.low[2] - q[Z]) / q[DZ] + 1e-9
    elif not seen and q[S] < math.inf and q[Z] + q[S] * q[DZ] <= world.surface.high[2]:
        if _inside(q[X] + q[S] * q[DX], q[Y] + q[S] * q[DY], world):
            return GOES_ON, q[S]
    elif q[DZ] > 0.0:
        t = (world.surface.high[2] - q[Z]) / q[DZ]
    if not seen and not (t < math.inf and _inside(q[X] + t * q[DX], q[Y] + t * q[DY], world)):
        return LEFT_DOMAIN, 0.0
    if f[RETRY] < _RETRIES:
        world.tallies.misses[0] += 1
        f[RETRY] += 1
        return GOES_ON, 0.0
    world.tallies.misses[1] += 1
    return LEAKED, 0.0


@inlined
def _settle(q, f, facet, world):
    """Settle the ray of a waiting photon: it crosses, collides before, or was missed."""
    f[STATUS] = MOVING
    t = math.inf
    if facet >= 0:
        nx, ny, nz = (
            world.surface.face_normals[facet, 0],
            world.surface.face_normals[facet, 1],
            world.surface.face_normals[facet, 2],
        )
        # single precision may find the facet that the ray leaves, or its neighbour, from behind
        if (q[DX] * nx + q[DY] * ny + q[DZ] * nz > 0.0) == (f[IN_WATER] == 1):
            t = max(
                plane_distance(
                    q[X],
                    q[Y],
                    q[Z],
                    q[DX],
                    q[DY],
                    q[DZ],
                    facet,
                    world.surface.vertices,
                    world.surface.faces,
                    world.surface.face_normals,
                ),
                0.0,
            )
    if math.isinf(t):
        fate, length = _settle_miss(q, f, facet >= 0, world)
        if fate == LANDED:
            _to_sky(q, f, q[DX], q[DY], q[DZ], q[W], world)
            q[W] = 0.0
        if fate != GOES_ON or length == 0.0:
            return fate
        f[RETRY] = 0
        if length < q[S]:
            _fly_water(q, f, length, world)
            q[S] -= length
            return GOES_ON
    f[RETRY] = 0
    length = min(t, q[S])
    if f[IN_WATER] == 1:
        _fly_water(q, f, length, world)
        if q[S] < t:
            return _scatter(q, f, world)
    else:
        q[X] += t * q[DX]
        q[Y] += t * q[DY]
        q[Z] += t * q[DZ]
        q[AIR_PATH] += t
    f[FACET] = facet
    return _cross(q, f, world)


@inlined
def _enter_slab(q, f, world):
    """End a photon that comes up beside the mesh: there is no surface to meet."""
    if f[IN_WATER] == 1 and q[DZ] > 0.0 and q[Z] < world.surface.low[2]:
        t = (world.surface.low[2] - q[Z]) / q[DZ]
        if not _inside(q[X] + t * q[DX], q[Y] + t * q[DY], world):
            _fly_water(q, f, t, world)
            return LEFT_DOMAIN
    return GOES_ON


@inlined
def _move(q, f, world):
    """Move a photon until it needs a ray (GOES_ON) or has ended."""
    while True:
        if f[RETRY] > 0 or _needs_ray(q, f, world):
            return _enter_slab(q, f, world)
        if q[DZ] < 0.0 and q[Z] + q[S] * q[DZ] < world.medium.bottom_z:
            fate = _bounce(q, f, world)
        elif math.isinf(q[S]):  # downwards for ever: without a bottom only absorption is left
            low = _lowest(world)
            if q[Z] > low and q[DZ] < 0.0:
                _fly_water(q, f, (low - q[Z]) / q[DZ], world)
            fate = ABSORBED if world.medium.a > 0.0 else DEEP
        else:
            _fly_water(q, f, q[S], world)
            fate = _scatter(q, f, world)
        if fate != GOES_ON:
            return fate


@entry
def advance(pool, n_waiting, facets, next_photon, last, world):
    """Settle the rays of a pool, move its photons on, fill free slots; return the new rays.

    Array twin: the plain tracer of `tests/benchmarks`.
    Photon ids run from `world.first` to `last`; a photon's result does not depend on its slot.
    """
    n_rays = 0
    for k in range(n_waiting):
        slot = pool.ray_slot[k]
        q, f = pool.state[slot], pool.flag[slot]
        fate = GOES_ON
        if f[STATUS] == WAITING:
            fate = _settle(q, f, facets[k], world)
        while True:
            if f[STATUS] == MOVING:
                if fate == GOES_ON:
                    fate = _move(q, f, world)
                if fate == GOES_ON:
                    n_rays = _cast(q, f, slot, n_rays, pool, world)
                    break
                _end(q, f, fate, world)
            if next_photon >= last:
                break
            _start(q, f, next_photon, world)
            next_photon += 1
            fate = GOES_ON
    return n_rays, next_photon
