"""A photon under way, what all photons of a chunk share, and the paths that are recorded.

Analog and joined photons have common fields and steps. Names are those of `photons.flight`.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels import tally
from meshtrace.kernels.bodies import BodyArrays
from meshtrace.kernels.interface import Interface, MeshArrays
from meshtrace.kernels.jit import inlined, outlined, record_type
from meshtrace.kernels.medium import Medium
from meshtrace.kernels.rays import Bvh, Grid
from meshtrace.kernels.sources import Backward, Sources
from meshtrace.kernels.tints import TINTS, Tints
from meshtrace.kernels.vectors import Vec3, write

UNDER_WAY = [
    ("x", float),  # position [m]
    ("y", float),
    ("z", float),
    ("dx", float),  # direction
    ("dy", float),
    ("dz", float),
    ("weight", float),
    ("free", float),  # path to the next collision [m], inf without one
    ("water", float),  # path in the water so far [m]
    ("id", np.int64),
    ("event", np.int64),  # number of the event under way: with the id it selects random numbers
    ("tint", float, (TINTS,)),  # see `meshtrace.kernels.tints`
]
"""Fields that analog and joined photons share."""

PHOTON = record_type(
    [
        *UNDER_WAY,
        ("air", float),  # path in the air [m]
        ("crossings", np.int64),  # of the surface, refracted or reflected
        ("facet", np.int64),  # ahead, -1: none
        ("in_water", np.int64),  # 0 or 1
        ("retry", np.int64),  # rays that missed the surface since the last step
        ("turned", np.int64),  # scatterings, and reflections by the bottom
        ("turned_by", np.int64),  # the last of them: SCATTERED or BOTTOM, DIRECT before the first
        ("body", np.int64),  # facet of a body at the end of the free path, -1: none
        ("outcome", np.int64),  # RECEIVED or LANDED once light left the sea, else -1
    ]
)
"""A photon under way."""


class Vertex(IntEnum):
    """Event at a vertex of a recorded path."""

    SOURCE = 0
    SCATTER = 1
    SURFACE_OUT = 2  # met from the water
    SURFACE_IN = 3  # met from the air
    BOTTOM = 4
    RECEIVED = 5
    LANDED = 6
    END = 7
    BRANCH = 8  # start of what the surface has reflected into the water
    BODY = 9  # reflected by a body


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
    bodies: BodyArrays | None  # None: kernels of links without bodies compile nothing of them
    medium: Medium
    apertures: tally.Apertures
    interface: Interface
    least_weight: float  # below it Russian roulette is played
    survival: float  # probability in that roulette; 0: weight / least_weight
    max_events: int  # collisions, crossings and reflections of a photon
    max_crossings: int  # of the surface, among them
    scores_unscattered: bool  # whether light that has met its first crossing alone is scored
    tallies: tally.Tallies
    recorder: Recorder
    back: Backward  # receivers from which photons run backwards, `FORWARD` for photons of sources
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
    """Set the direction of a photon to d."""
    q.dx, q.dy, q.dz = d.x, d.y, d.z


@inlined
def record(recorder, q, what):
    """Record an event of a photon if its path is kept."""
    if q.id < len(recorder.length):
        write_vertex(recorder, q.id, place(q), q.weight, what)


@outlined
def write_vertex(recorder, photon, p, weight, what):
    """Append a vertex to a recorded path."""
    # vertices beyond the room are left out: the end of a long path is missing, not its start
    n = recorder.length[photon]
    if n < recorder.vertex.shape[1]:
        write(recorder.vertex[photon, n], p)
        recorder.weight[photon, n] = weight
        recorder.what[photon, n] = what
        recorder.length[photon] = n + 1
