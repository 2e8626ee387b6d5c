"""Light of lamps, sun and sky: emission of photons, and daylight below the sea.

Daylight is met by backward photons, refracted onto a horizontal plane, and scattered up once.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.interface import reflectance
from meshtrace.kernels.jit import entry, inlined, outlined
from meshtrace.kernels.medium import (
    Medium,
    absorption_path,
    lookup,
    scattering_coefficients,
    scattering_path,
    water_path,
)
from meshtrace.kernels.random import Purpose, uniforms
from meshtrace.kernels.vectors import TWO_PI, UP, Vec3, along, dot, minus, norm, row, turn

_DARK = 41.5  # -ln of the intensity, over that on the axis, that counts as none: 1e-18, below the
# rounding of any sum


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
    size: NDArray[np.float64]  # beam radius, or half-width of the illuminated patch [m]
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
        # theta and azimuth are polar coordinates of a Gaussian in a plane (`emission_s` draws it):
        # dA = theta dtheta dphi for dOmega = sin(theta) dtheta dphi.
        shape = theta / math.sin(theta) if theta > 1e-6 else 1.0
        return emitter.norm * shape * math.exp(-2.0 * (theta / emitter.spread) ** 2)
    return emitter.norm if theta <= emitter.spread else 0.0


@inlined
def beam_width(emitter):
    """Return the angular scale of the intensity of a source [rad].

    Array twin: none, a scale.
    """
    # cos^m(theta) is near exp(-m theta^2 / 2); half the radius at 1/e^2 is a standard deviation
    if emitter.kind == SourceKind.LED:
        return 1.0 / math.sqrt(max(emitter.spread, 1.0))
    if emitter.kind == SourceKind.ISOTROPIC:
        return 1.0
    return 0.5 * emitter.spread


@inlined
def dark_angle(emitter):
    """Return the angle to the axis of a source beyond which it sends no light [rad].

    Array twin: `intensity`.
    """
    if emitter.kind == SourceKind.LED:
        return math.acos(math.exp(-_DARK / max(emitter.spread, 1e-3)))
    if emitter.kind == SourceKind.GAUSSIAN_BEAM:
        return emitter.spread * math.sqrt(0.5 * _DARK)
    return math.pi if emitter.kind == SourceKind.ISOTROPIC else emitter.spread


@inlined
def off_axis(p, emitter):
    """Return the angle between the axis of a source and the direction to P [rad].

    Array twin: numpy.arccos.
    """
    way = minus(p, emitter.position)
    return math.acos(min(max(dot(way, emitter.axis) / norm(way), -1.0), 1.0))


@inlined
def is_dark(p, h, dark, emitter):
    """Return whether no light of a source passes within a distance h of P.

    Array twin: `intensity`. `dark` is the `dark_angle`.
    """
    way = minus(p, emitter.position)
    length = norm(way)
    # P itself is not dark: most answers, without an arc cosine
    if h >= length or dot(way, emitter.axis) >= length * math.cos(dark):
        return False
    return off_axis(p, emitter) > dark + math.asin(h / length)


@inlined
def emission_s(kind, spread, u):
    """Return sin^2(theta / 2) of the angle to the axis of an emitted direction.

    Array twin: inverse distributions of `intensity` in the tests.
    """
    if kind == SourceKind.LED:
        # P(cos > c) = 1 - c^(m + 1) for a Lambertian order m, inverted.
        return 0.5 - 0.5 * math.exp(math.log(u) / (spread + 1.0))
    if kind == SourceKind.ISOTROPIC:
        return u
    if kind == SourceKind.TOP_HAT_BEAM:
        return u * math.sin(0.5 * spread) ** 2
    if kind == SourceKind.APERTURE:
        # Cosine law inside a cone: sin^2 is uniform; s = (1 - cos) / 2 without cancellation.
        sin2 = u * math.sin(spread) ** 2
        return 0.5 * sin2 / (1.0 + math.sqrt(1.0 - sin2))
    # Irradiance exp(-2 theta^2 / spread^2): the square of theta is exponential.
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
    # Few sources: a linear search of the cumulative powers.
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
    """Return a point of an extended source: a square of sky or sun, or a disk across its axis."""
    u0, u1, _, _ = uniforms(seed, photon, 0, Purpose.SOURCE.value)
    if SourceKind.SUN <= kind < SourceKind.APERTURE:
        return Vec3(p.x + size * (2.0 * u0 - 1.0), p.y + size * (2.0 * u1 - 1.0), p.z)
    # Even disks for top hats and apertures, the 1/e^2 radius of a Gaussian beam for others.
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


LEAST_COS = 1e-3
"""Least cosine of the zenith angle of skylight: the gradation divides by it."""


class Sky(NamedTuple):
    """Gradation over the zenith angle times indicatrix over the angle from the sun."""

    sun: Vec3  # direction to the sun
    p: float  # gradation p + a e^(b / cos z) [W m-2 sr-1 nm-1], z the zenith angle
    a: float
    b: float
    f: float  # indicatrix f + c e^(d chi) + e cos^2 chi, chi the angle from the sun
    c: float
    d: float
    e: float


class Backward(NamedTuple):
    """Start of backward photons at a receiver, and the light that they meet."""

    origin: NDArray[np.float64]  # (photons, 3), empty for photons that start at the sources
    direction: NDArray[np.float64]
    in_water: bool
    after_water: bool  # score only light that has been in the water
    sky: Sky
    sun: Vec3  # direction to the sun under water
    irradiance: float  # of the sun, across its direction below the surface [W m-2 nm-1]
    lost_water: float  # share of the scattering that takes light out of the sun's beam
    lost_bubble: float
    phase_water: NDArray[np.float64]  # over the angle from 0 to pi, smoothed [sr-1]
    phase_bubble: NDArray[np.float64]


NOWHERE = np.zeros((0, 3))
FORWARD = Backward(
    NOWHERE, NOWHERE, False, False, Sky(UP, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), UP, 0.0, 1.0, 1.0,
    np.zeros(2), np.zeros(2),
)  # fmt: skip
"""Photons that start at the sources."""

SKY_SCORE, SUN_SCORE, BUBBLE_SCORE = 0, 1, 2
N_SCORES = 3
"""Scores of a photon on its way back: sky on leaving, sun at its collisions, by bubbles."""


@inlined
def is_backward(back):
    """Return whether photons start at a receiver.

    Array twin: none.
    """
    return len(back.origin) > 0


@inlined
def launch_back(back, seed, photon):
    """Return position, direction, medium and a spare uniform of a backward photon.

    Array twin: the rows of `Backward`.
    """
    _, _, u, _ = uniforms(seed, photon, 0, Purpose.LAUNCH.value)
    return row(back.origin, photon), row(back.direction, photon), back.in_water, u


@outlined
def sunlight(back, medium: Medium, p, d, weight):
    """Return the expected sunlight that a tentative collision scatters into a path.

    By the water and by bubbles [W m-2 sr-1 nm-1]. d is the direction of the backward photon.
    Array twin: single scattering by quadrature in `tests/daylight`.
    The sun is refracted by still water; its disk of some degrees bounds the phase function.
    """
    angle = math.acos(min(max(dot(d, back.sun), -1.0), 1.0)) / math.pi
    water, bubbles = scattering_coefficients(medium, p)
    # Single scattering at the collision: b p(angle) of either scatterer, over the rate b_max of
    # tentative collisions.
    water *= lookup(back.phase_water, angle * (len(back.phase_water) - 1))
    if bubbles > 0.0:
        bubbles *= lookup(back.phase_bubble, angle * (len(back.phase_bubble) - 1))
    t = max(-p.z, 0.0) / back.sun.z
    top = along(p, back.sun, t)
    by_water = water_path(medium, p.z, top.z, t)
    by_bubbles = scattering_path(medium, p, top, t) - by_water
    # Light scattered by small angles stays in the sun's beam (quasi-single scattering).
    tau = back.lost_water * by_water + back.lost_bubble * by_bubbles
    tau += absorption_path(medium, p.z, top.z, t)
    collected = weight / medium.b_max * back.irradiance * math.exp(-tau)
    return collected * water, collected * bubbles


@inlined
def radiance(sky, direction):
    """Return the radiance of the sky in a direction.

    Array twin: `meshtrace.daylight.sky_radiance`.
    One product of two factors holds every pattern, so that one kernel is compiled.
    """
    cos_chi = min(max(dot(direction, sky.sun), -1.0), 1.0)
    # CIE general sky: gradation f(Z) times indicatrix (ISO 15469:2004).
    gradation = sky.p + sky.a * math.exp(sky.b / max(direction.z, LEAST_COS))
    glow = sky.f + sky.c * math.exp(sky.d * math.acos(cos_chi)) + sky.e * cos_chi * cos_chi
    return gradation * glow


@entry
def land_sunlight(z, zx, zy, corner, spacing, sun, n, c, depth, cells, cell, landed):
    """Add the unscattered sunlight of the points of a surface to the cells of a plane.

    Array twin: `refracted` in `tests/apps/test_irradiance.py`.
    Why so: one pass over the points, of 70 operations each, in place of forty arrays.

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
    landed : ndarray, shape (mx, my)
        Power on the cells per irradiance across the sunlight [m2], shared out between the four
        nearest ones.
    """
    for i in range(z.shape[0]):
        for j in range(z.shape[1]):
            p, q = zx[i, j], zy[i, j]
            # normal (-p, -q, 1) / long
            upright = sun[2] - p * sun[0] - q * sun[1]  # cosine of incidence times `long`
            if upright <= 0.0:
                continue
            long = math.sqrt(1.0 + p * p + q * q)
            cos_i = upright / long
            cos_t = math.sqrt(1.0 - (1.0 - cos_i * cos_i) / (n * n))
            # Vector form of Snell's law, for the unit vector to the sun.
            along = (cos_i / n - cos_t) / long
            down = sun[2] / n - along
            if down <= 0.0:
                continue
            way = (z[i, j] + depth) / down
            power = spacing * spacing * upright * (1.0 - reflectance(cos_i, cos_t, 1.0, n))
            power *= math.exp(-c * way)
            # `upright` is the area of the patch across the sunlight, over that of its projection
            x = corner[0] + i * spacing + way * (-sun[0] / n - along * p)
            y = corner[1] + j * spacing + way * (-sun[1] / n - along * q)
            u, v = (x - cells[0]) / cell - 0.5, (y - cells[1]) / cell - 0.5
            k, m = math.floor(u), math.floor(v)
            if k < 0 or m < 0 or k >= landed.shape[0] - 1 or m >= landed.shape[1] - 1:
                continue
            u, v = u - k, v - m
            landed[k, m] += (1.0 - u) * (1.0 - v) * power
            landed[k + 1, m] += u * (1.0 - v) * power
            landed[k, m + 1] += (1.0 - u) * v * power
            landed[k + 1, m + 1] += u * v * power


class Beams(NamedTuple):
    """Beams of sun and sky under still water, and the light that the water scatters up once.

    Beams of one slant, a ring, differ in azimuth alone.
    """

    travel: NDArray[np.float64]  # (beams, 3) unit vectors, downwards
    power: NDArray[np.float64]  # (beams,)
    ring: NDArray[np.int64]  # (beams,)
    slant: NDArray[np.float64]  # (rings,) cosines to the vertical, mu_0
    irradiance: NDArray[np.float64]  # (rings, wavelengths) for a power of 1
    phase: NDArray[np.float64]  # (angles, functions), on a uniform grid from 0 to pi
    m: NDArray[np.float64]  # (nodes,) air mass 1 / mu_0 + 1 / mu of beam and view, geometric series
    integral: NDArray[np.float64]  # (scatterers, nodes, wavelengths) over the depth
    mix: NDArray[np.float64]  # (scatterers, functions, wavelengths) of the phase functions
    floor: NDArray[np.float64]  # (nodes, wavelengths) radiance for an irradiance of 1, or (0, ...)


@entry
def add_upwelling(directions, beams, toward, scattered, radiances):
    """Add the radiance that travels up along directions.

    Array twin: `scattered_once` in `tests/daylight/test_background_air.py`.
    Why so: 281 beams have 15 slants, and phase functions of all wavelengths few common functions.

    Parameters
    ----------
    directions : ndarray, shape (n, 3)
        Unit vectors.
    beams : Beams
        Beams and water.
    toward, scattered : ndarray, shape (rings, functions + 1), (wavelengths,)
        Scratch: power of a ring times function, and alone; phase function.
    radiances : ndarray, shape (n, wavelengths)
        Radiances.
    """
    nodes, per_angle = len(beams.m), (len(beams.phase) - 1) / math.pi
    # The nodes are a geometric series: the interval follows from a logarithm.
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
            # extinction depends on the ring alone: phase functions are summed over it first
            for q in range(beams.phase.shape[1]):
                p = (1.0 - f) * beams.phase[j, q] + f * beams.phase[j + 1, q]
                toward[r, q] += power * p
            toward[r, -1] += power
        for r in range(len(beams.slant)):
            # Single scattering of depth z returns exp(-k z (1 / mu_0 + 1 / mu)): tabulated over
            # that sum.
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
                row, irradiance = radiances[i], beams.irradiance[r]
                for c in range(len(row)):
                    row[c] += irradiance[c] / mu * scattered[c]
            if len(beams.floor) > 0:
                # light mirrored by the bottom, even over all directions: by the plane irradiance
                level, row = toward[r, -1] * beams.slant[r], radiances[i]
                irradiance = beams.irradiance[r]
                low, high = beams.floor[j], beams.floor[j + 1]
                for c in range(len(row)):
                    row[c] += irradiance[c] * level * ((1.0 - f) * low[c] + f * high[c])
