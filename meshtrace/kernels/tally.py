"""Scores: apertures, horizontal planes, maps, the ledger of fates.

Weights of the ledger and of maps are added as integers of 2^-44: integer sums do not depend on
their order, so they are the same bit for bit for any thread count and batch size. Scores whose
error is estimated are kept per photon and added in photon order.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.interface import FieldOfView
from meshtrace.kernels.jit import inlined, outlined, record_type
from meshtrace.kernels.medium import Absorption, absorption_path
from meshtrace.kernels.tints import (
    ALONE,
    TINTS,
    Factors,
    Mixture,
    balance,
    copy_tint,
    fill_factors,
    tint_way,
)
from meshtrace.kernels.vectors import TWO_PI, UP, Vec3, along, dot, minus, norm, row, scaled

# 2^44 leaves 2^19 photons of weight 1 in 63 bits of each sum, and an error of 6e-14 of one.
SCALE = 2.0**44
UNIT = 2.0**-44


class Fate(IntEnum):
    """Fate of a photon, or of a part of its weight.

    A photon is counted once: as received or landed if any of its light left the sea, else by
    its end. Its weight is split: a reflected part goes on after the transmitted one has landed.
    """

    RECEIVED = 0  # by an aperture
    LANDED = 1  # left the sea, past all apertures
    ABSORBED = 2  # by the water
    WHITECAP = 3  # by foam
    REFLECTED = 4  # by the surface, where reflected light is not followed
    BOTTOM = 5  # absorbed there
    LEFT_DOMAIN = 6  # beyond the mesh
    LEAKED = 7  # through a gap of single precision between facets
    ROULETTE = 8
    EVENT_LIMIT = 9
    DEEP = 10  # so deep that it cannot return


class PlaneScore(IntEnum):
    """Scores of an irradiance plane, in the order of their columns."""

    E_D = 0  # plane irradiance, downwards
    E_U = 1  # upwards
    E_OD = 2  # scalar irradiance, downwards
    E_OU = 3


N_PLANE_SCORES = len(PlaneScore)

DIRECT, SCATTERED, REFLECTED = range(3)
N_PARTS = 3
"""Parts of the light at a receiver: unscattered, scattered, and first reflected by the surface."""

ARRIVAL = record_type(
    [
        ("photon", np.int64),
        ("receiver", np.int64),
        ("part", np.int64),  # of the light
        ("order", np.int64),  # scatterings, and reflections by the bottom
        ("weight", float),
        ("water", float),  # path in the water [m]
        ("air", float),
        ("cosine", float),  # of the angle of arrival to the axis of the aperture
        ("tint", float, (TINTS,)),  # see `meshtrace.kernels.tints`
    ]
)
"""Light of a photon that enters an aperture."""


class Apertures(NamedTuple):
    """Disks that collect light, one row each."""

    center: NDArray[np.float64]  # (n, 3)
    axis: NDArray[np.float64]  # (n, 3) direction of light at normal incidence
    radius: NDArray[np.float64]
    cos_half_fov: NDArray[np.float64]
    tan_half_fov: NDArray[np.float64]
    in_water: NDArray[np.bool_]
    any_in_water: bool


class MapGrid(NamedTuple):
    """Cells of a map on a level plane, and the light that they collect; none by default."""

    n: int = 0  # cells along a side
    z: float = 0.0
    x: float = 0.0  # corner of the first cell [m]
    y: float = 0.0
    step: float = 1.0
    axis: Vec3 = UP  # of the aperture that the map stands for
    cos: float = 0.0  # cosine of half its field of view
    mixture: Mixture = ALONE  # see `meshtrace.kernels.tints`
    scale: NDArray[np.float64] = np.ones(1)  # (wavelengths,) that keeps the digits of deep light


class Tallies(NamedTuple):
    """Scores of a chunk of photons."""

    score: NDArray[np.float64]  # (photons, apertures + `PlaneScore` for each plane)
    ledger: NDArray[np.int64]  # (fates,) weights in units of 2^-44
    n_photons: NDArray[np.int64]  # (fates,) photons
    misses: NDArray[np.int64]  # (2,) rays that slipped between facets: cast again, lost
    planes: NDArray[np.float64]  # heights z of the irradiance planes [m], falling
    # (groups, planes, cosines, azimuths) in units of 2^-44; cosines of the direction of
    # travel to +z from 1 (upwards) to -1, its azimuths from +x
    radiance: NDArray[np.int64]
    grid: MapGrid
    map_tint: NDArray[np.float64]  # (tints,) of the path under way
    map_factors: Factors  # of the path under way
    map: NDArray[np.int64]  # (n, n, wavelengths) scaled weights in units of 2^-44
    map_squared: NDArray[np.int64]  # (n, n, wavelengths) their squares
    arrivals: NDArray[np.void]  # (capacity,) ARRIVAL
    n_arrivals: NDArray[np.int64]  # (1,)


class Segment(NamedTuple):
    """A straight part of a photon's path."""

    origin: Vec3
    direction: Vec3
    length: float  # [m]
    weight: float
    water: float  # path before it, in the water [m]
    air: float


@inlined
def units(weight):
    """Return a weight in units of 2^-44.

    Array twin: numpy.floor.
    """
    # Integer sums are associative: the same bits for any order of threads.
    return np.int64(math.floor(weight * SCALE + 0.5))


@inlined
def deposit(tallies, fate, weight):
    """Add a weight to the ledger.

    Array twin: the sum of all fates equals the photons launched, to 1e-12.
    """
    tallies.ledger[fate] += units(weight)


@inlined
def crosses_aperture(apertures, i, flight, fov):
    """Return the distance to aperture i if the path meets it inside its field of view, or -1.

    Array twin: `tests/kernels/test_kernels_tally.py`.
    The angle is tested against the aperture's axis; the paper tests the position of the
    surface crossing instead, which accepts a superset (E11).
    """
    # First the cosine, which is cheap: most light of a scattering sea heads elsewhere.
    d, axis = flight.direction, row(apertures.axis, i)
    facing = dot(d, axis)
    if facing <= 0.0:
        return -1.0
    way = minus(row(apertures.center, i), flight.origin)
    t = dot(way, axis) / facing
    if t <= 0.0 or t > flight.length:
        return -1.0
    off = minus(scaled(t, d), way)
    r = apertures.radius[i]
    if dot(off, off) > r * r:
        return -1.0
    if fov == FieldOfView.ANGLE:
        return t if facing >= apertures.cos_half_fov[i] * norm(d) else -1.0
    # Erratum E11: the position of the crossing below the aperture stands for the angle.
    reach = r + way.z * apertures.tan_half_fov[i]
    return t if way.x * way.x + way.y * way.y < reach * reach else -1.0


@inlined
def _transmission(medium, z0, z1, length):
    """Return the factor of absorption on a weight along a straight path in water."""
    if medium.absorption != Absorption.CONTINUOUS:
        return 1.0
    return math.exp(-absorption_path(medium, z0, z1, length))


@inlined
def score_apertures(q, in_water, flight, world):
    """Score a straight path of a photon on every aperture of a medium; return whether any took it.

    Array twin: the analytic disk integrals of the flat-sea tests.
    q is the record of the photon, world all that it meets (`engine.photons.flight`). Water absorbs
    up to the disk.
    """
    received, tallies, apertures = False, world.tallies, world.apertures
    for i in range(len(apertures.radius)):
        if apertures.in_water[i] != in_water:
            continue
        t = crosses_aperture(apertures, i, flight, world.interface.fov)
        if t < 0.0:
            continue
        # An aperture is no obstacle: light goes on, and may be scored by several.
        received = True
        w, z = flight.weight, flight.origin.z
        # photons are dimmed at the end of a path, after it has been scored
        if in_water:
            w *= _transmission(world.medium, z, z + t * flight.direction.z, t)
        tallies.score[q.id - world.first, i] += w
        n = keep_arrival(tallies, q.id, i, w, world.tints, q.tint)
        if n >= 0:
            a = tallies.arrivals[n]
            a.water = flight.water + (t if in_water else 0.0)
            a.air = flight.air + (0.0 if in_water else t)
            a.order = q.turned
            a.cosine = dot(flight.direction, row(apertures.axis, i)) / norm(flight.direction)
            a.part = REFLECTED if q.crossings > 1 else min(q.turned, SCATTERED)
            if in_water:
                tint_way(world.tints, a.tint, z, z + t * flight.direction.z, t)
    return received


@inlined
def keep_arrival(store, photon, receiver, weight, tints, log_weights):
    """Record the light of a path on demand; return its row, -1 without room.

    Array twin: none.
    `store` is anything with the fields `arrivals` and `n_arrivals`.
    """
    n = store.n_arrivals[0]
    store.n_arrivals[0] = n + 1  # counts those without room, too: the chunk is run again
    if n >= len(store.arrivals):
        return -1
    a = store.arrivals[n]
    a.photon, a.receiver, a.weight = photon, receiver, weight
    copy_tint(tints, log_weights, a.tint)
    return n


@outlined
def score_planes(tallies, column, index, flight, medium):
    """Score a straight path in water on the irradiance planes it crosses.

    Array twin: exp(-a z) of a beam in absorbing water.
    `column` is that of the first plane in row `index` of the scores. Plane irradiances take the
    weight, scalar ones weight over |cos|.
    """
    # few planes: no search for those between z0 and z1
    d, z0 = flight.direction, flight.origin.z
    z1 = z0 + flight.length * d.z
    for k in range(len(tallies.planes)):
        h = tallies.planes[k]
        if (z0 - h) * (z1 - h) > 0.0 or z0 == z1 or h == z1:
            continue
        before = flight.length * (z0 - h) / (z0 - z1)
        w = flight.weight * _transmission(medium, z0, h, before)
        # A level that the path starts on counts, one that it ends on does not: each crossing once.
        scores = tallies.score[index, column + N_PLANE_SCORES * k :]
        scores[(PlaneScore.E_D if d.z < 0.0 else PlaneScore.E_U).value] += w
        scores[(PlaneScore.E_OD if d.z < 0.0 else PlaneScore.E_OU).value] += w / abs(d.z)
        groups, _, n_cos, n_phi = tallies.radiance.shape
        if n_cos > 0:
            group = index % groups  # independent photons, from which the standard error comes
            i = min(int((0.5 - 0.5 * d.z) * n_cos), n_cos - 1)
            # rounding may give n_phi
            j = int((math.atan2(d.y, d.x) / TWO_PI + 1.0) % 1.0 * n_phi)
            tallies.radiance[group, k, i, min(j, n_phi - 1)] += units(w)


@inlined
def score_map(tallies, flight, medium, tints, log_weights):
    """Add a path to the map on the receiver plane, if within the field of view.

    Array twin: numpy.histogram2d of recorded paths.
    A tilted aperture takes d . axis / d_z of the light across the level plane.
    """
    d, grid = flight.direction, tallies.grid
    # the cheap tests first: most paths end here
    if grid.n == 0 or d.z == 0.0:
        return
    facing = dot(d, grid.axis)
    if facing < grid.cos * norm(d):
        return
    t = (grid.z - flight.origin.z) / d.z
    if t <= 0.0 or t > flight.length:
        return
    p = along(flight.origin, d, t)
    i = math.floor((p.x - grid.x) / grid.step)
    j = math.floor((p.y - grid.y) / grid.step)
    if 0 <= i < grid.n and 0 <= j < grid.n:
        # Flux through a level cell is weight over area; across a tilted aperture it is facing / d_z
        # of that.
        w = flight.weight * facing / abs(d.z)
        here = tallies.map_tint
        copy_tint(tints, log_weights, here)
        if grid.z < 0.0:
            w *= _transmission(medium, flight.origin.z, grid.z, t)
            tint_way(tints, here, flight.origin.z, grid.z, t)
        # Photons of several base wavelengths may bring this light, see `tints.Mixture`.
        w *= balance(grid.mixture, here)
        fill_factors(grid.mixture, here, tallies.map_factors)
        for k in range(len(grid.scale)):
            scaled_weight = w * tallies.map_factors.values[k] * grid.scale[k]
            tallies.map[i, j, k] += units(scaled_weight)
            tallies.map_squared[i, j, k] += units(scaled_weight * scaled_weight)
