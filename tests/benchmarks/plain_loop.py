"""The anchor of individual photons: one after another below still water, by a plain numba loop.

Lambertian lamp in homogeneous water, exponential free paths, absorption by weight,
Henyey-Greenstein, Snell and Fresnel at z = 0, light in the air on to one aperture, reflected light
on with its weight, Russian roulette. No facets, layers, bubbles, records or ledger, and the
generator of numpy, whose numbers do not belong to photons.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

import meshtrace as mt


@numba.njit(error_model="numpy")
def _follow(seed, photons, depth, order, a, b, g, n, height, radius, cos_fov, limit):
    np.random.seed(seed)  # noqa: NPY002 - of numba
    total = square = 0.0
    events = 0
    for _ in range(photons):
        x = y = 0.0
        z, dz = -depth, np.random.random() ** (1.0 / (order + 1.0))  # noqa: NPY002
        s, phi = math.sqrt(1.0 - dz * dz), 2.0 * math.pi * np.random.random()  # noqa: NPY002
        dx, dy = s * math.cos(phi), s * math.sin(phi)
        w, score = 1.0, 0.0
        while True:
            free = -math.log(1.0 - np.random.random()) / b  # noqa: NPY002
            t = -z / dz if dz > 0.0 else math.inf
            way = min(free, t)
            x, y, z = x + way * dx, y + way * dy, z + way * dz
            w *= math.exp(-a * way)
            if t < free:
                sin2, rho = n * n * (1.0 - dz * dz), 1.0
                if sin2 < 1.0:
                    out = math.sqrt(1.0 - sin2)
                    rs = (n * dz - out) / (n * dz + out)
                    rp = (dz - n * out) / (dz + n * out)
                    rho = 0.5 * (rs * rs + rp * rp)
                    far = height / out
                    px, py = x + far * n * dx, y + far * n * dy
                    if out >= cos_fov and px * px + py * py <= radius * radius:
                        score += w * (1.0 - rho)
                w *= rho
                z, dz = 0.0, -dz
            else:
                events += 1
                v = (1.0 - g * g) / (1.0 - g + 2.0 * g * np.random.random())  # noqa: NPY002
                c = (1.0 + g * g - v * v) / (2.0 * g)
                s = math.sqrt(max(1.0 - c * c, 0.0))
                phi = 2.0 * math.pi * np.random.random()  # noqa: NPY002
                p, q = s * math.cos(phi), s * math.sin(phi)
                if abs(dz) > 0.99999:
                    dx, dy, dz = p, q, math.copysign(c, dz)
                else:
                    r = math.sqrt(1.0 - dz * dz)
                    ux = (dx * dz * p - dy * q) / r + dx * c
                    uy = (dy * dz * p + dx * q) / r + dy * c
                    dx, dy, dz = ux, uy, dz * c - r * p
            if w < limit:
                if np.random.random() * limit >= w:  # noqa: NPY002
                    break
                w = limit
        total += score
        square += score * score
    return total, square, events


def plain_loop(link: mt.Link, photons: int, seed: int) -> tuple[float, float, float]:
    """Return gain, standard error and collisions of a photon.

    Parameters
    ----------
    link : Link
        One `Led` that points up below one level `Receiver` straight above it; homogeneous water
        with a `HenyeyGreenstein` function.
    photons, seed : int
        Photons, and the seed of numba's generator.
    """
    led, end, water = link.transmitter, link.receiver, link.water
    phase: Any = water.phase
    cosine, limit = math.cos(math.radians(end.fov_deg / 2.0)), 0.5 * math.exp(-water.a * led.depth)
    total, square, events = _follow(
        seed, photons, led.depth, led.order, water.a, water.b, phase.g, water.n,
        end.height, end.radius, cosine, limit,
    )  # fmt: skip
    mean = total / photons
    error = math.sqrt((square / photons - mean**2) / (photons - 1))
    return mean, error, events / photons
