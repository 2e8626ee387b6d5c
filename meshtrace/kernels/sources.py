"""Where photons start: lamps and beams under water, sun and sky above it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.jit import inlined, outlined
from meshtrace.kernels.random import Purpose, uniforms
from meshtrace.kernels.vectors import TWO_PI, turn

LAMBERTIAN, GAUSSIAN, TOP_HAT, ISOTROPIC, SUN, SKY_UNIFORM, SKY_CARDIOIDAL = range(7)

_LAUNCH = int(Purpose.LAUNCH)
_SOURCE = int(Purpose.SOURCE)


class Sources(NamedTuple):
    """Sources as arrays, one row each, see `meshtrace.link`."""

    kind: NDArray[np.int64]
    position: NDArray[np.float64]  # (n, 3)
    axis: NDArray[np.float64]  # (n, 3) unit
    spread: NDArray[np.float64]  # Lambertian order, or divergence half-angle [rad]
    size: NDArray[np.float64]  # beam radius or half-width of the lit patch [m]
    in_water: NDArray[np.bool_]
    cum_power: NDArray[np.float64]  # cumulative share of the power, ends at 1


@inlined
def launch(sources, seed, photon):
    """Return position, direction, medium and a spare uniform of a new photon.

    Array twin: the closed-form distributions, chi-square tested.
    Two uniforms make the direction; extended sources draw two more for the position.
    """
    u0, u1, u2, u3 = uniforms(seed, photon, 0, _LAUNCH)
    i = 0
    if len(sources.kind) > 1:
        while i < len(sources.kind) - 1 and u3 >= sources.cum_power[i]:
            i += 1
    kind = sources.kind[i]
    x, y, z = sources.position[i, 0], sources.position[i, 1], sources.position[i, 2]
    ax, ay, az = sources.axis[i, 0], sources.axis[i, 1], sources.axis[i, 2]
    spread, size = sources.spread[i], sources.size[i]
    if kind == LAMBERTIAN:
        s = 0.5 - 0.5 * math.exp(math.log(u0) / (spread + 1.0))
        dx, dy, dz = turn(ax, ay, az, s, u1)
    elif kind == ISOTROPIC:
        dx, dy, dz = turn(ax, ay, az, u0, u1)
    elif kind == TOP_HAT:
        dx, dy, dz = turn(ax, ay, az, u0 * math.sin(0.5 * spread) ** 2, u1)
    elif kind == GAUSSIAN:
        theta = spread * math.sqrt(-0.5 * math.log(u0))
        dx, dy, dz = turn(ax, ay, az, math.sin(0.5 * min(theta, math.pi)) ** 2, u1)
    elif kind == SUN:
        dx, dy, dz = ax, ay, az
    else:
        cos_theta = math.sqrt(u0) if kind == SKY_UNIFORM else cardioidal_cosine(u0)
        dx, dy, dz = turn(ax, ay, az, 0.5 * (1.0 - cos_theta), u1)
    if size > 0.0:
        x, y, z = _spread_out(kind, x, y, z, ax, ay, az, size, seed, photon)
    return x, y, z, dx, dy, dz, sources.in_water[i], u2


@outlined
def _spread_out(kind, x, y, z, ax, ay, az, size, seed, photon):
    u0, u1, _, _ = uniforms(seed, photon, 0, _SOURCE)
    if kind >= SUN:
        return x + size * (2.0 * u0 - 1.0), y + size * (2.0 * u1 - 1.0), z
    r = size * (math.sqrt(u0) if kind == TOP_HAT else math.sqrt(-0.5 * math.log(u0)))
    ox, oy, oz = turn(ax, ay, az, 0.5, u1)
    return x + r * ox, y + r * oy, z + r * oz


@outlined
def cardioidal_cosine(u):
    """Return the cosine of the zenith angle under a cardioidal sky, L = L0 (1 + 2 cos).

    Array twin: root of (3 m^2 + 4 m^3) / 7 = u.
    Flux per cosine is (m + 2 m^2); Newton from sqrt(u) converges from above.
    """
    m = math.sqrt(u)
    for _ in range(20):
        step = ((3.0 + 4.0 * m) * m * m - 7.0 * u) / (6.0 * m + 12.0 * m * m)
        m -= step
        if abs(step) < 1e-15:
            break
    return m


@inlined
def lambert_reflection(u_cos, u_phi):
    """Return the direction of light reflected up by a Lambertian bottom.

    Array twin: cos theta = sqrt(u).
    """
    cos_theta = math.sqrt(u_cos)
    sin_theta = math.sqrt(1.0 - u_cos)
    phi = TWO_PI * u_phi
    return sin_theta * math.cos(phi), sin_theta * math.sin(phi), cos_theta
