"""Daylight below the sea: refracted onto a horizontal plane, and scattered up once."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.jit import entry, outlined


@entry
def land_sunlight(z, zx, zy, corner, spacing, sun, n, c, depth, cells, cell, light):
    """Add the unscattered sunlight of the points of a surface to the cells of a plane.

    Array twin: `refracted` in `tests/studies/test_irradiance.py`.
    Why so: three passes over a point, of 70 operations, in place of forty arrays.

    Parameters
    ----------
    z, zx, zy : ndarray, shape (nx, ny)
        Height [m] and slopes at `corner` + `spacing` (i, j).
    corner, spacing : (float, float), float
        Place of the first point and distance of the points [m].
    sun : (float, float, float)
        Unit vector to the sun.
    n : float
        Refractive index of the water over that of the air.
    c, depth : float
        Attenuation [m-1] and depth of the plane [m].
    cells, cell : (float, float), float
        Corner of the plane and edge of its cells [m].
    light : ndarray, shape (mx, my)
        Power on the cells per irradiance across the sunlight [m2], shared out between the four
        nearest ones.
    """
    for i in range(z.shape[0]):
        for j in range(z.shape[1]):
            p, q = zx[i, j], zy[i, j]
            upright = sun[2] - p * sun[0] - q * sun[1]  # cosine of incidence times `long`
            if upright <= 0.0:
                continue
            long = math.sqrt(1.0 + p * p + q * q)
            cos_i = upright / long
            cos_t = math.sqrt(1.0 - (1.0 - cos_i * cos_i) / (n * n))
            along = (cos_i / n - cos_t) / long
            down = sun[2] / n - along
            if down <= 0.0:
                continue
            r_s = (cos_i - n * cos_t) / (cos_i + n * cos_t)
            r_p = (n * cos_i - cos_t) / (n * cos_i + cos_t)
            way = (z[i, j] + depth) / down
            power = spacing * spacing * upright * (1.0 - 0.5 * (r_s * r_s + r_p * r_p))
            power *= math.exp(-c * way)
            x = corner[0] + i * spacing + way * (-sun[0] / n - along * p)
            y = corner[1] + j * spacing + way * (-sun[1] / n - along * q)
            u, v = (x - cells[0]) / cell - 0.5, (y - cells[1]) / cell - 0.5
            k, m = math.floor(u), math.floor(v)
            if k < 0 or m < 0 or k >= light.shape[0] - 1 or m >= light.shape[1] - 1:
                continue
            u, v = u - k, v - m
            light[k, m] += (1.0 - u) * (1.0 - v) * power
            light[k + 1, m] += u * (1.0 - v) * power
            light[k, m + 1] += (1.0 - u) * v * power
            light[k + 1, m + 1] += u * v * power


class Beams(NamedTuple):
    """Beams of sun and sky under still water, and the light that the water scatters up once.

    Beams of one slant, a ring, differ in azimuth alone.
    """

    travel: NDArray[np.float64]  # (beams, 3) unit vectors, downwards
    power: NDArray[np.float64]  # (beams,)
    ring: NDArray[np.int64]  # (beams,)
    slant: NDArray[np.float64]  # (rings,) cosines, downwards
    lit: NDArray[np.float64]  # (rings, wavelengths) irradiance for a power of 1
    phase: NDArray[np.float64]  # (angles, functions), on a uniform grid from 0 to pi
    m: NDArray[np.float64]  # (nodes,) extinction of beam and view, a geometric series
    integral: NDArray[np.float64]  # (scatterers, nodes, wavelengths) over the depth
    mix: NDArray[np.float64]  # (scatterers, functions, wavelengths) of the phase functions
    floor: NDArray[np.float64]  # (nodes, wavelengths) radiance for an irradiance of 1, or (0, ...)


@entry
def add_upwelling(directions, beams, toward, scattered, light):
    """Add the radiance that travels up along directions.

    Array twin: `scattered_once` in `tests/daylight/test_background_air.py`.
    Why so: 281 beams have 15 slants, and phase functions of all wavelengths few common functions.

    Parameters
    ----------
    directions : ndarray, shape (n, 3)
        Unit vectors.
    beams : Beams
        Beams and water.
    toward, scattered : ndarray, shape (rings, functions), (wavelengths,)
        Scratch: power of a ring times function, and phase function.
    light : ndarray, shape (n, wavelengths)
        Radiances.
    """
    nodes, per_angle = len(beams.m), (len(beams.phase) - 1) / math.pi
    per_m = (nodes - 1) / math.log(beams.m[nodes - 1] / beams.m[0])
    for i in range(len(directions)):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        mu = max(z, 1e-3)
        toward[:] = 0.0
        for b in range(len(beams.power)):
            cosine = x * beams.travel[b, 0] + y * beams.travel[b, 1] + z * beams.travel[b, 2]
            at = math.acos(min(max(cosine, -1.0), 1.0)) * per_angle
            j = min(int(at), len(beams.phase) - 2)
            f, power, r = at - j, beams.power[b], beams.ring[b]
            for q in range(beams.phase.shape[1]):
                p = (1.0 - f) * beams.phase[j, q] + f * beams.phase[j + 1, q]
                toward[r, q] += power * p
        for r in range(len(beams.slant)):
            m = 1.0 / beams.slant[r] + 1.0 / mu
            j = min(max(int(math.log(m / beams.m[0]) * per_m), 0), nodes - 2)
            f = min(max((m - beams.m[j]) / (beams.m[j + 1] - beams.m[j]), 0.0), 1.0)
            for s in range(len(beams.integral)):
                scattered[:] = 0.0
                for q in range(beams.phase.shape[1]):
                    share, row = toward[r, q], beams.mix[s, q]
                    for c in range(len(row)):
                        scattered[c] += share * row[c]
                low, high = beams.integral[s, j], beams.integral[s, j + 1]
                for c in range(len(low)):
                    scattered[c] *= (1.0 - f) * low[c] + f * high[c]
                row, lit = light[i], beams.lit[r]
                for c in range(len(row)):
                    row[c] += lit[c] / mu * scattered[c]
        if len(beams.floor) > 0:
            _add_floor(beams, mu, per_m, light[i])


@outlined
def _add_floor(beams, mu, per_m, light):
    """Add the light of the floor at one direction, see `add_upwelling`."""
    for b in range(len(beams.power)):
        r, nodes = beams.ring[b], len(beams.m)
        m = 1.0 / beams.slant[r] + 1.0 / mu
        j = min(max(int(math.log(m / beams.m[0]) * per_m), 0), nodes - 2)
        f = min(max((m - beams.m[j]) / (beams.m[j + 1] - beams.m[j]), 0.0), 1.0)
        for c in range(len(light)):
            floor = (1.0 - f) * beams.floor[j, c] + f * beams.floor[j + 1, c]
            light[c] += beams.lit[r, c] * beams.power[b] * beams.slant[r] * floor
