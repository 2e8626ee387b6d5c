"""Scores: apertures, horizontal planes, maps, the ledger of fates.

Weights of the ledger, of maps and of radiances are added as integers in units of 2^-44: integer
sums do not depend on their order, so they are the same bit for bit for any thread count and batch
size. Scores whose error is estimated are stored for each photon and added in the order of photons.
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
    Mixture,
    balance,
    copy_tint,
    fill_factors,
    tint_way,
)
from meshtrace.kernels.vectors import TWO_PI, UP, Vec3, along, dot, minus, norm, row, scaled, write

# 63 bits hold 2^19 photons of weight 1; rounding is 2^-45 = 3e-14 of such a photon at most.
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
    ROULETTE = 8  # ended at random for its small weight
    EVENT_LIMIT = 9  # ended after too many events
    DEEP = 10  # so deep that it cannot return
    BODY = 11  # absorbed there


class PlaneScore(IntEnum):
    """Scores of an irradiance plane, in the order of their columns."""

    E_D = 0  # plane irradiance of light that travels down
    E_U = 1  # and up
    E_OD = 2  # scalar irradiance of light that travels down
    E_OU = 3  # and up


N_PLANE_SCORES = len(PlaneScore)

DIRECT, SCATTERED, REFLECTED, MIRRORED, BOTTOM, BODY = range(6)
N_PARTS = 6
"""Parts of the light at a receiver, by what it met.

Light that changes sides is unscattered (`DIRECT`), scattered, or first reflected by the surface. Of
links whose ends lie on one side `DIRECT` is straight, `MIRRORED` is unscattered and reflected by
the surface, and the rest is named by what it met last: `SCATTERED` water, `BOTTOM`, `BODY`.
"""

ARRIVAL = record_type(
    [
        ("photon", np.int64),
        ("receiver", np.int64),
        ("part", np.int64),  # DIRECT ... BODY
        ("order", np.int64),  # scatterings, and reflections by the bottom
        ("weight", float),
        ("water", float),  # path in the water [m]
        ("air", float),  # path in the air [m]
        ("way", float, (3,)),  # along the light at the aperture, of any length
        ("tint", float, (TINTS,)),  # see `meshtrace.kernels.tints`
    ]
)
"""Light of a photon that enters an aperture.

Backward photons record the height of their last event in `air` [m] and its angle in `water` [rad].
"""


class Apertures(NamedTuple):
    """Disks that collect light, one row each."""

    center: NDArray[np.float64]  # (n, 3)
    axis: NDArray[np.float64]  # (n, 3) direction in which light at normal incidence travels
    radius: NDArray[np.float64]  # [m]
    cos_half_fov: NDArray[np.float64]  # of half the full field of view
    tan_half_fov: NDArray[np.float64]
    in_water: NDArray[np.bool_]
    any_in_water: bool  # whether any of them is
    any_in_air: bool  # whether any of them is not
    same_side: bool  # whether all ends of the link lie in one medium, which names parts of light


class MapGrid(NamedTuple):
    """Square cells of a map on a level plane, for apertures of one axis; none by default."""

    n: int = 0  # cells along a side
    z: float = 0.0  # height of the plane [m]
    x: float = 0.0  # corner of the first cell [m]
    y: float = 0.0
    step: float = 1.0  # edge of a cell [m]
    axis: Vec3 = UP  # of the aperture that the map stands for
    cos: float = 0.0  # cosine of half its field of view
    mixture: Mixture = ALONE  # see `meshtrace.kernels.tints`
    # (wavelengths,) factors on weights, large for deep light, whose digits units of 2^-44 would cut
    scale: NDArray[np.float64] = np.ones(1)


class Tallies(NamedTuple):
    """Scores of a chunk of photons."""

    score: NDArray[np.float64]  # (photons, apertures + `PlaneScore` for each plane)
    ledger: NDArray[np.int64]  # (fates,) weights in units of 2^-44
    n_photons: NDArray[np.int64]  # (fates,) photons
    misses: NDArray[np.int64]  # (2,) rays that slipped between facets: cast again, lost
    planes: NDArray[np.float64]  # heights z of the irradiance planes [m], falling
    # (groups, planes, cosines, azimuths) in units of 2^-44; cosines of the direction of
    # travel to +z from 1 (upwards) to -1, its azimuths from +x; photons take turns in the groups
    radiance: NDArray[np.int64]
    grid: MapGrid
    map_tint: NDArray[np.float64]  # (tints,) scratch, sums of the path that is scored
    map_factors: NDArray[np.float64]  # (2, wavelengths) scratch for `fill_factors` of that path
    map: NDArray[np.int64]  # (n, n, wavelengths) scaled weights in units of 2^-44
    map_squared: NDArray[np.int64]  # (n, n, wavelengths) their squares
    arrivals: NDArray[np.void]  # (capacity,) ARRIVAL
    n_arrivals: NDArray[np.int64]  # (1,)


@inlined
def units(weight):
    """Return a weight in units of 2^-44.

    Array twin: numpy.floor.
    """
    # rounded to the nearest
    return np.int64(math.floor(weight * SCALE + 0.5))


@inlined
def deposit(tallies, fate, weight):
    """Add a weight to the ledger.

    Array twin: the sum of all fates equals the photons launched, to 1e-12.
    """
    tallies.ledger[fate] += units(weight)


@inlined
def crosses_aperture(apertures, i, p, d, length, fov):
    """Return the distance to aperture i if a path meets it inside its field of view, or -1.

    Array twin: `tests/kernels/test_kernels_tally.py`.
    The path starts at p along d. The angle is tested against the aperture's axis; the paper tests
    the position of the surface crossing instead, which accepts a superset (E11 of
    docs/paper.md).
    """
    # First the cosine, which is cheap: most light of a scattering sea heads elsewhere.
    axis = row(apertures.axis, i)
    facing = dot(d, axis)
    if facing <= 0.0:
        return -1.0
    way = minus(row(apertures.center, i), p)
    t = dot(way, axis) / facing
    if t <= 0.0 or t > length:
        return -1.0
    off = minus(scaled(t, d), way)  # from the centre to the point on the disk
    r = apertures.radius[i]
    if dot(off, off) > r * r:
        return -1.0
    if fov == FieldOfView.ANGLE:
        return t if facing >= apertures.cos_half_fov[i] * norm(d) else -1.0
    # E11: the horizontal distance of the crossing, the start of this path, stands for the angle. It
    # lies below a receiver that looks down, above one that looks up: behind it the cone of view
    # ends, and the square of a negative radius would open it again.
    ahead = way.z if axis.z >= 0.0 else -way.z
    reach = max(r + ahead * apertures.tan_half_fov[i], 0.0)
    return t if way.x * way.x + way.y * way.y < reach * reach else -1.0


@inlined
def _transmission(medium, z0, z1, length):
    """Return the factor of absorption on a weight along a straight path in water."""
    if medium.absorption != Absorption.CONTINUOUS:
        return 1.0
    return math.exp(-absorption_path(medium, z0, z1, length))


@inlined
def score_apertures(q, in_water, d, weight, length, world):
    """Score a straight path of a photon on every aperture of a medium; return whether any took it.

    Array twin: the analytic disk integrals of the flat-sea tests.
    q is the record of the photon, where the path starts along d with `weight`, world all that it
    meets (`engine.photons.state.World`). Water absorbs up to the disk. A photon is counted wherever
    its path passes through the disk and never stopped there: light behind a receiver is that of a
    receiver which hides nothing.
    """
    received, tallies, apertures, p = False, world.tallies, world.apertures, Vec3(q.x, q.y, q.z)
    for i in range(len(apertures.radius)):
        if apertures.in_water[i] != in_water:
            continue
        t = crosses_aperture(apertures, i, p, d, length, world.interface.fov)
        if t < 0.0:
            continue
        # An aperture is no obstacle: light goes on, and may be scored by several.
        received = True
        w = weight
        # the weight is that at the start: absorption follows at the end of a path, after its scores
        if in_water:
            w *= _transmission(world.medium, p.z, p.z + t * d.z, t)
        tallies.score[q.id - world.first, i] += w
        n = keep_arrival(tallies, q.id, i, w, world.tints, q.tint)
        if n >= 0:
            a = tallies.arrivals[n]
            a.water = q.water + (t if in_water else 0.0)
            a.air = q.air + (0.0 if in_water else t)
            a.order = q.turned
            write(a.way, d)
            a.part = _part_of(q, apertures.same_side)
            if in_water:
                tint_way(world.tints, a.tint, p.z, p.z + t * d.z, t)
    return received


@inlined
def _part_of(q, same_side):
    """Return the part of the light that a photon belongs to, `DIRECT` ... `BODY`."""
    if same_side:
        # light that was never turned is straight, or a mirror image
        return q.turned_by if q.turned > 0 or q.crossings == 0 else MIRRORED
    # turned: scatterings and reflections by the bottom, 0 of them for DIRECT = 0
    return REFLECTED if q.crossings > 1 else min(q.turned, SCATTERED)


@inlined
def keep_arrival(store, photon, receiver, weight, tints, log_weights):
    """Append a record of arriving light; return its index, -1 if there is no room.

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
def score_planes(q, length, world):
    """Score a straight path of a photon in water on the irradiance planes it crosses.

    Array twin: exp(-a z) of a beam in absorbing water.
    Plane irradiances take the weight, scalar ones the weight over the |cosine| to the vertical.
    """
    tallies, index, d = world.tallies, q.id - world.first, Vec3(q.dx, q.dy, q.dz)
    column = len(world.apertures.radius)  # scores of planes follow those of the apertures
    # few planes: each is tested, without a search for those between z0 and z1
    z0, z1 = q.z, q.z + length * d.z
    for k in range(len(tallies.planes)):
        h = tallies.planes[k]
        if (z0 - h) * (z1 - h) > 0.0 or z0 == z1 or h == z1:
            continue
        before = length * (z0 - h) / (z0 - z1)
        w = q.weight * _transmission(world.medium, z0, h, before)
        # A level that the path starts on counts, one that it ends on does not: each crossing once.
        scores = tallies.score[index, column + N_PLANE_SCORES * k :]
        scores[(PlaneScore.E_D if d.z < 0.0 else PlaneScore.E_U).value] += w
        scores[(PlaneScore.E_OD if d.z < 0.0 else PlaneScore.E_OU).value] += w / abs(d.z)
        groups, _, n_cos, n_phi = tallies.radiance.shape
        if n_cos > 0:
            group = index % groups  # the spread of independent groups is the standard error
            i = min(int((0.5 - 0.5 * d.z) * n_cos), n_cos - 1)
            # azimuths from 0 to 2 pi; rounding may give n_phi
            j = int((math.atan2(d.y, d.x) / TWO_PI + 1.0) % 1.0 * n_phi)
            tallies.radiance[group, k, i, min(j, n_phi - 1)] += units(w)


@inlined
def score_map(q, d, weight, length, world):
    """Add a path of a photon along d to the map on the receiver plane, if in the field of view.

    Array twin: numpy.histogram2d of recorded paths.
    """
    tallies, grid = world.tallies, world.tallies.grid
    # the cheap tests first: most paths end here
    if grid.n == 0 or d.z == 0.0:
        return
    facing = dot(d, grid.axis)
    if facing < grid.cos * norm(d):
        return
    t = (grid.z - q.z) / d.z
    if t <= 0.0 or t > length:
        return
    p = along(Vec3(q.x, q.y, q.z), d, t)
    i = math.floor((p.x - grid.x) / grid.step)
    j = math.floor((p.y - grid.y) / grid.step)
    if 0 <= i < grid.n and 0 <= j < grid.n:
        # Irradiance of the level plane is weight over area; that of an aperture across its axis is
        # d . axis / |d_z| times as large.
        w = weight * facing / abs(d.z)
        here = tallies.map_tint
        copy_tint(world.tints, q.tint, here)
        if grid.z < 0.0:
            w *= _transmission(world.medium, q.z, grid.z, t)
            tint_way(world.tints, here, q.z, grid.z, t)
        # Photons traced at several wavelengths may bring this light, see `tints.Mixture`.
        w *= balance(grid.mixture, here)
        fill_factors(grid.mixture, here, tallies.map_factors)
        factors = tallies.map_factors[0]
        for k in range(len(grid.scale)):
            scaled_weight = w * factors[k] * grid.scale[k]
            tallies.map[i, j, k] += units(scaled_weight)
            tallies.map_squared[i, j, k] += units(scaled_weight * scaled_weight)
