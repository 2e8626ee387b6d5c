"""A photon under way, what all photons of a chunk share, and the paths that are recorded.

Analog and joined photons have common fields and steps. A photon is a record, which kernels change
in place; what its chunk shares is a NamedTuple, which they only read: numba would build another
tuple for each change of a field. Names are those of `photons.flight`.
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
    # Random numbers are a function of both (`kernels.random`): results depend neither on threads
    # nor on the order of photons, and a chunk that is followed again takes the same paths.
    ("id", np.int64),
    ("event", np.int64),  # number of the event under way
    ("tint", float, (TINTS,)),  # see `meshtrace.kernels.tints`
]
"""Fields that analog and joined photons share."""

PHOTON = record_type(
    [
        *UNDER_WAY,
        ("air", float),  # path in the air [m]
        # Of the surface, refracted or reflected. Light of one crossing and no turn is unscattered,
        # which facets may score in place of photons, without noise: `World.scores_unscattered`.
        ("crossings", np.int64),
        ("facet", np.int64),  # ahead, -1: none
        ("in_water", np.int64),  # 0 or 1
        # rays that missed the surface since the last step: single precision slips through edges,
        # and they are cast again from a point aside
        ("retry", np.int64),
        ("turned", np.int64),  # scatterings, and reflections by the bottom
        ("turned_by", np.int64),  # the last of them: SCATTERED or BOTTOM, DIRECT before the first
        ("body", np.int64),  # facet of a body at the end of the free path, -1: none
        # RECEIVED or LANDED once light left the sea, else -1: a photon whose reflected part goes
        # on is counted by the transmitted one
        ("outcome", np.int64),
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
    """Paths of the first photons, for visualisation; tallies are unaffected.

    Arrays of a fixed size, as kernels allocate nothing; those of no photons switch it off.
    """

    vertex: NDArray[np.float64]  # (photons, vertices, 3)
    weight: NDArray[np.float64]  # (photons, vertices)
    what: NDArray[np.int8]  # Vertex
    length: NDArray[np.int64]  # (photons,)


class World(NamedTuple):
    """Everything that the photons of a chunk share.

    Where None is possible kernels are compiled for its type, without the code for the rest: links
    without bodies, or at one wavelength, pay nothing for them.
    """

    first: int  # id of the first photon, the row 0 of `tallies.score`
    seed: np.uint64
    sources: Sources
    surface: MeshArrays
    grid: Grid
    bodies: BodyArrays | None
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
    # (1,) PHOTON, the one under way: an array of the caller, since kernels make none
    photon: NDArray[np.void]


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
    # the test is inlined and the writing is not: nearly all photons stop here
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
