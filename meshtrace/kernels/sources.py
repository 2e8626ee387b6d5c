"""Emission of photons: sources under water, sun and sky above it."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.jit import inlined, outlined
from meshtrace.kernels.random import Purpose, uniforms
from meshtrace.kernels.vectors import TWO_PI, Vec3, along, dot, row, turn


class SourceKind(IntEnum):
    """Angular patterns, as `pattern` of the sources of `meshtrace.link`."""

    LED = 0
    GAUSSIAN_BEAM = 1
    TOP_HAT_BEAM = 2
    ISOTROPIC = 3
    SUN = 4
    UNIFORM_SKY = 5
    CARDIOIDAL_SKY = 6
    APERTURE = 7
    """Lambertian inside a cone: the light of an aperture, reversed."""


class Sources(NamedTuple):
    """Sources as arrays, one row each, see `meshtrace.link`."""

    kind: NDArray[np.int64]  # SourceKind
    position: NDArray[np.float64]  # (n, 3)
    axis: NDArray[np.float64]  # (n, 3) unit
    spread: NDArray[np.float64]  # Lambertian order, or divergence half-angle [rad]
    size: NDArray[np.float64]  # beam radius or half-width of the lit patch [m]
    in_water: NDArray[np.bool_]
    cum_power: NDArray[np.float64]  # cumulative share of the power, ends at 1


@inlined
def intensity(emitter, w):
    """Return the emitted intensity [sr-1] per unit power.

    Array twin: `Led` (m + 1) / (2 pi) cos^m, integrated to 1 in the tests.
    """
    cos_theta = dot(w, emitter.axis)
    if emitter.kind == SourceKind.LED:
        return emitter.norm * cos_theta**emitter.spread if cos_theta > 0.0 else 0.0
    if emitter.kind == SourceKind.ISOTROPIC:
        return emitter.norm
    theta = math.acos(min(max(cos_theta, -1.0), 1.0))
    if emitter.kind == SourceKind.APERTURE:
        return emitter.norm * max(cos_theta, 0.0) if theta <= emitter.spread else 0.0
    if emitter.kind == SourceKind.GAUSSIAN_BEAM:
        # density per solid angle of the sampler: theta Gaussian in the plane
        shape = theta / math.sin(theta) if theta > 1e-6 else 1.0
        return emitter.norm * shape * math.exp(-2.0 * (theta / emitter.spread) ** 2)
    return emitter.norm if theta <= emitter.spread else 0.0


@inlined
def emission_s(kind, spread, u):
    """Return sin^2(theta / 2) of the angle to the axis of an emitted direction.

    Array twin: inverse distributions of `intensity` in the tests.
    """
    if kind == SourceKind.LED:
        return 0.5 - 0.5 * math.exp(math.log(u) / (spread + 1.0))
    if kind == SourceKind.ISOTROPIC:
        return u
    if kind == SourceKind.TOP_HAT_BEAM:
        return u * math.sin(0.5 * spread) ** 2
    if kind == SourceKind.APERTURE:
        sin2 = u * math.sin(spread) ** 2
        return 0.5 * sin2 / (1.0 + math.sqrt(1.0 - sin2))
    theta = spread * math.sqrt(-0.5 * math.log(u))
    return math.sin(0.5 * min(theta, math.pi)) ** 2


@inlined
def launch(sources, seed, photon):
    """Return position, direction, source and a spare uniform of a new photon.

    Array twin: the closed-form distributions, chi-square tested.
    Two uniforms make the direction; extended sources draw two more for the position.
    """
    u0, u1, u2, u3 = uniforms(seed, photon, 0, Purpose.LAUNCH.value)
    i = 0
    if len(sources.kind) > 1:
        while i < len(sources.kind) - 1 and u3 >= sources.cum_power[i]:
            i += 1
    kind = sources.kind[i]
    p, axis = row(sources.position, i), row(sources.axis, i)
    spread, size = sources.spread[i], sources.size[i]
    if kind < SourceKind.SUN or kind == SourceKind.APERTURE:
        d = turn(axis, emission_s(kind, spread, u0), u1)
    elif kind == SourceKind.SUN:
        d = axis
    else:
        cos_theta = math.sqrt(u0) if kind == SourceKind.UNIFORM_SKY else cardioidal_cosine(u0)
        d = turn(axis, 0.5 * (1.0 - cos_theta), u1)
    if size > 0.0:
        p = _spread_out(kind, p, axis, size, seed, photon)
    return p, d, i, u2


@outlined
def _spread_out(kind, p, axis, size, seed, photon):
    u0, u1, _, _ = uniforms(seed, photon, 0, Purpose.SOURCE.value)
    if SourceKind.SUN <= kind < SourceKind.APERTURE:
        return Vec3(p.x + size * (2.0 * u0 - 1.0), p.y + size * (2.0 * u1 - 1.0), p.z)
    even = kind == SourceKind.TOP_HAT_BEAM or kind == SourceKind.APERTURE
    r = size * math.sqrt(u0 if even else -0.5 * math.log(u0))
    return along(p, turn(axis, 0.5, u1), r)


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
    return Vec3(sin_theta * math.cos(phi), sin_theta * math.sin(phi), cos_theta)
