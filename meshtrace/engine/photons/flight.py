"""The analog photon: from the source through the water to the surface and beyond.

`follow` takes photons one after another through flights in the water, crossings of the surface and
flights in the air until they end. The facet ahead is found on the grid of the mesh where
`photon_grid` knows it, else by a ray.
"""

from __future__ import annotations

import math

from meshtrace.engine.bvh.grid import UNKNOWN, grid_facet
from meshtrace.engine.photons.events import bounce, cross, fly_water, lowest, scatter, to_sky
from meshtrace.engine.photons.state import (
    GOES_ON,
    Miss,
    Vertex,
    head,
    heading,
    place,
    put,
    record,
    steeper_than_waves,
)
from meshtrace.kernels.facets import plane_distance
from meshtrace.kernels.jit import entry, inlined, outlined
from meshtrace.kernels.medium import sample_free_path
from meshtrace.kernels.rays import first_facet
from meshtrace.kernels.sky import is_backward, launch_back
from meshtrace.kernels.sources import launch
from meshtrace.kernels.tally import Fate, deposit
from meshtrace.kernels.vectors import Vec3, along, dot, plus, row

_NUDGE = 1e-4  # [m], displacement of a missed ray that is cast again
_RETRIES = 3


@inlined
def _start(q, photon, world):
    """Start a photon at its source."""
    if is_backward(world.back):
        p, d, in_water, u_path = launch_back(world.back, world.seed, photon)
    else:
        p, d, source, u_path = launch(world.sources, world.seed, photon)
        in_water = world.sources.in_water[source]
    put(q, p)
    head(q, d)
    q.weight, q.water, q.air = 1.0, 0.0, 0.0
    q.free = sample_free_path(world.medium, p, u_path) if in_water else math.inf
    q.id, q.event, q.crossings, q.facet = photon, 0, 0, -1
    q.in_water, q.retry, q.turned, q.outcome = int(in_water), 0, 0, -1
    record(world.recorder, q, Vertex.SOURCE)


@inlined
def _end(q, fate, world):
    """End a photon: deposit the rest of its weight and count it."""
    deposit(world.tallies, fate, q.weight)
    world.tallies.n_photons[q.outcome if q.outcome >= 0 else fate] += 1
    record(world.recorder, q, Vertex.END)


@inlined
def _inside(q, t, surface):
    """Return whether a photon is over the mesh after a distance t."""
    x, y = q.x + t * q.dx, q.y + t * q.dy
    return surface.low[0] <= x <= surface.high[0] and surface.low[1] <= y <= surface.high[1]


@inlined
def _needs_ray(q, world):
    """Return whether the next flight of a photon may meet the surface."""
    if q.in_water == 0:
        return True
    low = world.surface.low[2]
    z1 = q.z + q.free * q.dz if q.dz != 0.0 else q.z
    if z1 < low:
        return q.z >= low and not steeper_than_waves(heading(q), world.surface)
    return True


@inlined
def _facet_ahead(q, world):
    """Return the facet that a photon meets, -1 for none.

    A ray starts at the entry of the photon into the slab of the surface.
    """
    if len(world.grid.x.line) > 0 and q.retry == 0:
        facet = grid_facet(world.grid, world.surface.vertices, place(q), heading(q))
        if facet != UNKNOWN:
            return facet
    t = 0.0
    if q.in_water == 1 and q.dz > 0.0:
        t = (world.surface.low[2] - q.z) / q.dz
    elif q.in_water == 0 and q.dz < 0.0:
        t = (world.surface.high[2] - q.z) / q.dz
    t = max(t - 1e-3 * (1.0 + t), 0.0)
    nudge = _NUDGE * q.retry
    aside = Vec3(nudge, 0.7 * nudge, -nudge if q.in_water == 1 else nudge)
    return first_facet(world.bvh, plus(along(place(q), heading(q), t), aside), heading(q))


@outlined
def _settle_miss(q, seen, world):
    """Return (fate, distance) for a ray that hit no facet from its own side.

    The photon advances by the distance, and by none if its ray is cast again; LANDED means
    that it left for the sky. A miss is right where the path ends inside the slab, leaves it
    downwards or lies outside the mesh. `seen`: a facet was met from behind, since the ray
    started on the wrong side.
    """
    t = math.inf
    low, high = world.surface.low[2], world.surface.high[2]
    if not seen and q.in_water == 0 and q.dz > 0.0:
        return Fate.LANDED.value, 0.0
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
        return Fate.LEFT_DOMAIN.value, 0.0
    if q.retry < _RETRIES:
        world.tallies.misses[Miss.CAST_AGAIN.value] += 1
        q.retry += 1
        return GOES_ON, 0.0
    world.tallies.misses[Miss.GIVEN_UP.value] += 1
    return Fate.LEAKED.value, 0.0


@inlined
def _settle(q, world):
    """Fly to the facet ahead: crossing, collision before it, or a miss."""
    facet = q.facet
    t = math.inf
    if facet >= 0:
        n = row(world.surface.face_normals, facet)
        # single precision may find the facet that the ray leaves, or its neighbour, from behind
        if (dot(heading(q), n) > 0.0) == (q.in_water == 1):
            t = max(plane_distance(place(q), heading(q), facet, world.surface), 0.0)
    if math.isinf(t):
        fate, length = _settle_miss(q, facet >= 0, world)
        if fate == Fate.LANDED.value:
            to_sky(q, heading(q), q.weight, world)
            q.weight = 0.0
        if fate != GOES_ON or length == 0.0:
            return fate
        q.retry = 0
        if length < q.free:
            fly_water(q, length, world)
            q.free -= length
            return GOES_ON
    q.retry = 0
    if q.in_water == 1:
        fly_water(q, min(t, q.free), world)
        if q.free < t:
            return scatter(q, world)
    else:
        put(q, along(place(q), heading(q), t))
        q.air += t
    return cross(q, world)


@inlined
def _enter_slab(q, world):
    """End a photon that rises outside the mesh."""
    if q.in_water == 1 and q.dz > 0.0 and q.z < world.surface.low[2]:
        t = (world.surface.low[2] - q.z) / q.dz
        if not _inside(q, t, world.surface):
            fly_water(q, t, world)
            return Fate.LEFT_DOMAIN.value
    return GOES_ON


@inlined
def _move(q, world):
    """Advance a photon until it needs a ray (GOES_ON) or has ended."""
    while True:
        if q.retry > 0 or _needs_ray(q, world):
            return _enter_slab(q, world)
        if q.dz < 0.0 and q.z + q.free * q.dz < world.medium.bottom_z:
            fate = bounce(q, world)
        elif math.isinf(q.free):  # descends without end: with no bottom only absorption is left
            low = lowest(world)
            if q.z > low and q.dz < 0.0:
                fly_water(q, (low - q.z) / q.dz, world)
            return Fate.ABSORBED.value if world.medium.a > 0.0 else Fate.DEEP.value
        else:
            fly_water(q, q.free, world)
            fate = scatter(q, world)
        if fate != GOES_ON:
            return fate


@entry
def follow(first, last, world):
    """Follow the photons first <= id < last to their ends.

    Array twin: the plain tracer of `tests/benchmarks`.
    """
    q = world.photon[0]
    for photon in range(first, last):
        _start(q, photon, world)
        fate = GOES_ON
        while fate == GOES_ON:
            fate = _move(q, world)
            if fate == GOES_ON:
                q.facet = _facet_ahead(q, world)
                fate = _settle(q, world)
        _end(q, fate, world)
