"""Scores: apertures, horizontal planes, maps, the ledger of fates.

Weights of the ledger and of maps are added as integers of 2^-44: integer sums do not depend on
their order, so they are the same bit for bit for any thread count and batch size. Scores whose
error is estimated are kept per photon and added in photon order.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.interface import FOV_ANGLE
from meshtrace.kernels.jit import inlined, outlined
from meshtrace.kernels.medium import CONTINUOUS, absorption_path

SCALE = 2.0**44
UNIT = 2.0**-44

(
    RECEIVED,
    LANDED,
    ABSORBED,
    WHITECAP,
    REFLECTED,
    BOTTOM,
    LEFT_DOMAIN,
    LEAKED,
    ROULETTE,
    EVENT_LIMIT,
    DEEP,
) = range(11)
N_FATES = 11


class Apertures(NamedTuple):
    """Disks that collect light, one row each."""

    center: NDArray[np.float64]  # (n, 3)
    axis: NDArray[np.float64]  # (n, 3) direction of light at normal incidence
    radius: NDArray[np.float64]
    cos_half_fov: NDArray[np.float64]
    tan_half_fov: NDArray[np.float64]
    in_water: NDArray[np.bool_]
    any_in_water: bool


class Tallies(NamedTuple):
    """Where a chunk of photons writes to."""

    score: NDArray[np.float64]  # (photons, apertures + 4 * planes)
    ledger: NDArray[np.int64]  # (fates,) weights in units of 2^-44
    n_photons: NDArray[np.int64]  # (fates,) photons
    misses: NDArray[np.int64]  # (2,) rays cast again, rays given up
    planes: NDArray[np.float64]  # heights z of the irradiance planes [m], falling
    radiance: NDArray[np.int64]  # (groups, planes, cosines, azimuths) in units of 2^-44
    map_z: float
    map_x: float
    map_y: float
    map_step: float
    map_axis: tuple[float, float, float]  # axis of the aperture that the map stands for
    map_cos: float  # cosine of half its field of view
    map: NDArray[np.int64]  # (nx, ny) weights in units of 2^-44
    map_squared: NDArray[np.int64]  # (nx, ny) their squares
    arrivals: NDArray[np.float64]  # (capacity, 5): photon, aperture, weight, water, air path
    n_arrivals: NDArray[np.int64]  # (1,)


@inlined
def deposit(tallies, fate, weight):
    """Add a weight to the ledger.

    Array twin: the sum of all fates equals the photons launched, to 1e-12.
    """
    tallies.ledger[fate] += np.int64(math.floor(weight * SCALE + 0.5))


@inlined
def crosses_aperture(apertures, i, x, y, z, dx, dy, dz, length, fov):
    """Return the distance to aperture i if the path meets it inside its field of view, or -1.

    Array twin: `tests/unit/test_kernels_tally.py`.
    The angle is tested against the aperture's axis; the paper tests the position of the
    surface crossing instead, which accepts a superset (E11).
    """
    ax, ay, az = apertures.axis[i, 0], apertures.axis[i, 1], apertures.axis[i, 2]
    along = dx * ax + dy * ay + dz * az
    if along <= 0.0:
        return -1.0
    cx = apertures.center[i, 0] - x
    cy = apertures.center[i, 1] - y
    cz = apertures.center[i, 2] - z
    t = (cx * ax + cy * ay + cz * az) / along
    if t <= 0.0 or t > length:
        return -1.0
    px, py, pz = t * dx - cx, t * dy - cy, t * dz - cz
    r = apertures.radius[i]
    if px * px + py * py + pz * pz > r * r:
        return -1.0
    if fov == FOV_ANGLE:
        norm = math.sqrt(dx * dx + dy * dy + dz * dz)
        return t if along >= apertures.cos_half_fov[i] * norm else -1.0
    reach = r + cz * apertures.tan_half_fov[i]
    return t if cx * cx + cy * cy < reach * reach else -1.0


@inlined
def _transmission(medium, z0, z1, length):
    """Return what absorption along a straight path in water leaves of a weight."""
    if medium.absorption != CONTINUOUS:
        return 1.0
    return math.exp(-absorption_path(medium, z0, z1, length))


@inlined
def score_apertures(
    tallies,
    apertures,
    row,
    photon,
    in_water,
    x,
    y,
    z,
    dx,
    dy,
    dz,
    length,
    weight,
    water_path,
    air_path,
    fov,
    medium,
):
    """Score a straight path against every aperture of its medium; return True if any took it.

    Array twin: the analytic disk integrals of the flat-sea tests.
    Water absorbs up to the disk.
    """
    received = False
    for i in range(len(apertures.radius)):
        if apertures.in_water[i] != in_water:
            continue
        t = crosses_aperture(apertures, i, x, y, z, dx, dy, dz, length, fov)
        if t < 0.0:
            continue
        received = True
        w = weight
        if in_water:
            w *= _transmission(medium, z, z + t * dz, t)
        tallies.score[row, i] += w
        n = tallies.n_arrivals[0]
        tallies.n_arrivals[0] = n + 1  # counts what finds no room, too: the chunk is run again
        if n < len(tallies.arrivals):
            record = tallies.arrivals[n]
            record[0], record[1], record[2] = photon, i, w
            record[3] = water_path + (t if in_water else 0.0)
            record[4] = air_path + (0.0 if in_water else t)
    return received


@outlined
def score_planes(tallies, first, row, z0, z1, dx, dy, dz, length, weight, medium):
    """Score a straight path in water on the irradiance planes it crosses.

    Array twin: exp(-a z) of a beam in absorbing water.
    Columns of a plane: E_d, E_u (plane) and E_od, E_ou (scalar: weight over |cos|).
    """
    for k in range(len(tallies.planes)):
        h = tallies.planes[k]
        if (z0 - h) * (z1 - h) > 0.0 or z0 == z1 or h == z1:
            continue
        w = weight * _transmission(medium, z0, h, length * (z0 - h) / (z0 - z1))
        column = first + 4 * k + (0 if dz < 0.0 else 1)
        tallies.score[row, column] += w
        tallies.score[row, column + 2] += w / abs(dz)
        groups, _, n_cos, n_phi = tallies.radiance.shape
        if n_cos > 0:
            group = row % groups  # independent photons, from which the standard error comes
            i = min(int((0.5 - 0.5 * dz) * n_cos), n_cos - 1)
            j = int((math.atan2(dy, dx) / (2.0 * math.pi) + 1.0) % 1.0 * n_phi)
            tallies.radiance[group, k, i, min(j, n_phi - 1)] += np.int64(
                math.floor(w * SCALE + 0.5)
            )


@inlined
def score_map(tallies, x, y, z, dx, dy, dz, weight):
    """Add a path in air to the map on the receiver plane, if its aperture would accept it.

    Array twin: numpy.histogram2d of recorded paths.
    A tilted aperture takes d . axis / d_z of what crosses the level plane.
    """
    nx, ny = tallies.map.shape
    if nx == 0 or dz <= 0.0:
        return
    ax, ay, az = tallies.map_axis
    along = dx * ax + dy * ay + dz * az
    if along < tallies.map_cos * math.sqrt(dx * dx + dy * dy + dz * dz):
        return
    t = (tallies.map_z - z) / dz
    if t <= 0.0:
        return
    i = math.floor((x + t * dx - tallies.map_x) / tallies.map_step)
    j = math.floor((y + t * dy - tallies.map_y) / tallies.map_step)
    if 0 <= i < nx and 0 <= j < ny:
        w = weight * along / dz
        tallies.map[i, j] += np.int64(math.floor(w * SCALE + 0.5))
        tallies.map_squared[i, j] += np.int64(math.floor(w * w * SCALE + 0.5))
