"""State of photons: records, inputs, limits and recorded paths."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.interface import (
    Interface,
    MeshArrays,
    normal_on,
    roughened,
    takes_slopes,
)
from meshtrace.kernels.jit import inlined, outlined
from meshtrace.kernels.medium import Medium
from meshtrace.kernels.random import Purpose, uniforms
from meshtrace.kernels.rays import Bvh, Grid
from meshtrace.kernels.sources import Backward, Sources
from meshtrace.kernels.tally import Apertures, Fate, Tallies, deposit, score_apertures
from meshtrace.kernels.tints import TINTS, Tints
from meshtrace.kernels.vectors import Vec3, row, write

UNDER_WAY = [
    ("x", float),  # position [m]
    ("y", float),
    ("z", float),
    ("dx", float),  # direction
    ("dy", float),
    ("dz", float),
    ("weight", float),
    ("free", float),  # way to the next collision [m]
    ("water", float),  # path in the water [m]
    ("id", np.int64),
    ("event", np.int64),
    ("tint", float, (TINTS,)),  # see `meshtrace.kernels.tints`
]
"""What is known of every photon."""

PHOTON = np.dtype(
    [
        *UNDER_WAY,
        ("air", float),
        ("crossings", np.int64),
        ("facet", np.int64),
        ("in_water", np.int64),
        ("retry", np.int64),
        ("turned", np.int64),  # 1 once it has scattered or met the bottom
        ("outcome", np.int64),  # RECEIVED or LANDED once light left the sea, else -1
    ]
)
"""A photon under way."""


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


class Limits(NamedTuple):
    """Conditions that end a photon."""

    weight: float  # Russian roulette below
    survival: float  # 0: survive with weight / limit; else with this probability
    events: int
    surface_events: int
    unscattered: bool  # whether light that has met its first crossing alone is scored in the air


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
    surface: MeshArrays
    grid: Grid
    medium: Medium
    apertures: Apertures
    interface: Interface
    limits: Limits
    tallies: Tallies
    recorder: Recorder
    back: Backward
    tints: Tints | None
    bvh: Bvh
    photon: NDArray[np.void]  # (1,) PHOTON, the one under way


@inlined
def place(q):
    """Return the position of a photon."""
    return Vec3(q.x, q.y, q.z)


@inlined
def heading(q):
    """Return the direction of a photon."""
    return Vec3(q.dx, q.dy, q.dz)


@inlined
def put(q, p):
    """Move a photon to p."""
    q.x, q.y, q.z = p.x, p.y, p.z


@inlined
def head(q, d):
    """Turn a photon to d."""
    q.dx, q.dy, q.dz = d.x, d.y, d.z


@inlined
def record(recorder, q, what):
    """Record an event of a photon if its path is kept."""
    if q.id < len(recorder.length):
        write_vertex(recorder, q.id, place(q), q.weight, what)


@outlined
def write_vertex(recorder, photon, p, weight, what):
    """Append a vertex to a recorded path."""
    n = recorder.length[photon]
    if n < recorder.vertex.shape[1]:
        write(recorder.vertex[photon, n], p)
        recorder.weight[photon, n] = weight
        recorder.what[photon, n] = what
        recorder.length[photon] = n + 1


@inlined
def set_weight(q, weight, fate, world):
    """Change the weight of a photon and deposit the difference."""
    deposit(world.tallies, fate, q.weight - weight)
    q.weight = weight


@inlined
def score_on_apertures(q, in_water, flight, world):
    """Score a straight path on the apertures; return whether any received it."""
    fov, medium, tints = world.interface.fov, world.medium, world.tints
    return score_apertures(
        world.tallies, world.apertures, world.first, q.id, in_water, flight, fov, medium,
        tints, q.tint,
    )  # fmt: skip


@inlined
def roulette(q, lot, world):
    """Play Russian roulette with a low-weight photon; draw a new uniform if `lot` is negative."""
    if q.weight >= world.limits.weight:
        return GOES_ON
    p = world.limits.survival if world.limits.survival > 0.0 else q.weight / world.limits.weight
    if lot < 0.0:
        lot, _, _, _ = uniforms(world.seed, q.id, q.event, Purpose.ROULETTE.value)
    if lot >= p:
        return Fate.ROULETTE.value
    set_weight(q, q.weight / p, Fate.ROULETTE.value, world)
    return GOES_ON


@inlined
def steeper_than_waves(d, surface):
    """Return whether a direction is steeper than every facet: away from the surface it stays so."""
    slope = surface.max_slope
    return d.z * d.z > slope * slope * (d.x * d.x + d.y * d.y)


@inlined
def bending_normal(q, facet, world):
    """Return (facet normal, normal that bends light, spare uniform or -1) at a crossing.

    Array twin: `roughened`.
    """
    g = row(world.surface.face_normals, facet)
    n = normal_on(place(q), facet, world.surface)
    if takes_slopes(g, world.surface.roughness):
        u, v, w, lot = uniforms(world.seed, q.id, q.event, Purpose.SLOPE.value)
        return g, roughened(heading(q), n, u, v, w, world.surface.roughness), lot
    return g, n, -1.0
