"""Light of lamps, sun and sky: emission of photons, and daylight below the sea.

Three estimates of daylight: for backward photons, which start at a receiver; of the direct sunlight
that waves refract onto a horizontal plane; of the light that the water scatters up once.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels import tables
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

# -ln of the intensity, over that on the axis, that counts as no light: 1e-18, below the rounding of
# any sum.
_DARK = 41.5


class SourceKind(IntEnum):
    """Angular patterns, as `pattern` of the sources of `meshtrace.link`."""

    LED = 0
    GAUSSIAN_BEAM = 1
    TOP_HAT_BEAM = 2
    ISOTROPIC = 3
    TABLE = 4
    SUN = 5
    UNIFORM_SKY = 6
    CARDIOIDAL_SKY = 7
    APERTURE = 8
    """Lambertian inside a cone: the light of an aperture, reversed."""


class Sources(NamedTuple):
    """Sources as arrays, one row each, see `meshtrace.link`."""

    kind: NDArray[np.int64]  # SourceKind
    position: NDArray[np.float64]  # (n, 3)
    axis: NDArray[np.float64]  # (n, 3) unit
    spread: NDArray[np.float64]  # Lambertian order, or half-angle of a cone or at 1/e^2 [rad]
    size: NDArray[np.float64]  # beam radius, or half-width of the square of sun or sky [m]
    in_water: NDArray[np.bool_]
    cum_power: NDArray[np.float64]  # cumulative share of the power, ends at 1
    e1: NDArray[np.float64]  # (n, 3) unit, across the axis: zero of the azimuths of a table
    table: NDArray[np.int64]  # address of a table of intensities, see `kernels.tables`, else 0


@inlined
def intensity(emitter, w):
    """Return the intensity [sr-1] of an `Emitter` of unit power along a unit vector w.

    Array twin: `Led` (m + 1) / (2 pi) cos^m, integrated to 1 in the tests.
    """
    cos_theta = dot(w, emitter.axis)
    if emitter.kind == SourceKind.LED:
        return emitter.norm * cos_theta**emitter.spread if cos_theta > 0.0 else 0.0
    if emitter.kind == SourceKind.ISOTROPIC:
        return emitter.norm
    if emitter.kind == SourceKind.TABLE:
        return tables.intensity(emitter.table, w, emitter.axis, emitter.e1, emitter.e2)
    theta = math.acos(min(max(cos_theta, -1.0), 1.0))
    if emitter.kind == SourceKind.APERTURE:
        return emitter.norm * max(cos_theta, 0.0) if theta <= emitter.spread else 0.0
    if emitter.kind == SourceKind.GAUSSIAN_BEAM:
        # theta and azimuth are polar coordinates of a Gaussian in a plane (`emission_s` draws it):
        # dA = theta dtheta dphi for dOmega = sin(theta) dtheta dphi.
        # Below 1e-6 the ratio is 1 to the last digit, and 0/0 on the axis.
        shape = theta / math.sin(theta) if theta > 1e-6 else 1.0
        return emitter.norm * shape * math.exp(-2.0 * (theta / emitter.spread) ** 2)
    return emitter.norm if theta <= emitter.spread else 0.0


@inlined
def beam_width(emitter):
    """Return the angular scale of the intensity of a source [rad].

    Array twin: none, a scale.
    """
    if emitter.kind == SourceKind.LED:
        # cos^m(theta) is near exp(-m theta^2 / 2)
        return 1.0 / math.sqrt(max(emitter.spread, 1.0))
    if emitter.kind == SourceKind.ISOTROPIC:
        return 1.0
    # half the radius of a Gaussian at 1/e^2 is its standard deviation; tables have the like of it
    return 0.5 * emitter.spread


@inlined
def dark_angle(emitter):
    """Return the angle to the axis of a source beyond which it sends no light [rad].

    Array twin: `intensity`.
    """
    if emitter.kind == SourceKind.LED:
        # cos^m = exp(-_DARK); an order near 0 is as dark at a right angle alone
        return math.acos(math.exp(-_DARK / max(emitter.spread, 1e-3)))
    if emitter.kind == SourceKind.GAUSSIAN_BEAM:
        # exp(-2 (theta / spread)^2) = exp(-_DARK)
        return emitter.spread * math.sqrt(0.5 * _DARK)
    if emitter.kind == SourceKind.TABLE:
        return tables.number(emitter.table, tables.Place.DARK.value)
    return math.pi if emitter.kind == SourceKind.ISOTROPIC else emitter.spread


@inlined
def off_axis(p, emitter):
    """Return the angle between the axis of a source and the direction to a point p [rad].

    Array twin: numpy.arccos.
    """
    way = minus(p, emitter.position)
    return math.acos(min(max(dot(way, emitter.axis) / norm(way), -1.0), 1.0))


@inlined
def is_dark(p, h, dark, emitter):
    """Return whether no light of a source passes within a distance h [m] of a point p.

    Array twin: `intensity`. `dark` is the `dark_angle`.
    """
    way = minus(p, emitter.position)
    length = norm(way)
    # The source or p itself has light: most answers, without an arc cosine.
    if h >= length or dot(way, emitter.axis) >= length * math.cos(dark):
        return False
    # asin(h / length): angular radius of the sphere about p, seen from the source
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
    """Return position, direction, index of the source and a spare uniform of a new photon.

    Array twin: the closed-form distributions, chi-square tested.
    Of four uniforms two make the direction, one the source; extended sources draw two more for the
    position.
    """
    u0, u1, u2, u3 = uniforms(seed, photon, 0, Purpose.LAUNCH.value)
    i = 0
    # Few sources: a linear search of the cumulative powers.
    if len(sources.kind) > 1:
        while i < len(sources.kind) - 1 and u3 >= sources.cum_power[i]:
            i += 1
    kind = sources.kind[i]  # lamps come before SUN in `SourceKind`, skies after it
    p, axis = row(sources.position, i), row(sources.axis, i)
    spread, size = sources.spread[i], sources.size[i]
    if kind == SourceKind.TABLE:
        d = tables.direction(sources.table[i], u0, u1, axis, row(sources.e1, i))
    elif kind < SourceKind.SUN or kind == SourceKind.APERTURE:
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
    """Return a random point of a source: on a level square of sun or sky, else on a disk.

    p is its centre; the disk is perpendicular to its axis.
    """
    u0, u1, _, _ = uniforms(seed, photon, 0, Purpose.SOURCE.value)
    if SourceKind.SUN <= kind < SourceKind.APERTURE:
        return Vec3(p.x + size * (2.0 * u0 - 1.0), p.y + size * (2.0 * u1 - 1.0), p.z)
    # Uniform on the disk of a top hat or an aperture, else Gaussian with its radius at 1/e^2.
    even = kind == SourceKind.TOP_HAT_BEAM or kind == SourceKind.APERTURE
    r = size * math.sqrt(u0 if even else -0.5 * math.log(u0))
    # s = sin^2(theta / 2) = 1/2 turns the axis by a right angle
    return along(p, turn(axis, 0.5, u1), r)


@outlined
def cardioidal_cosine(u):
    """Return the cosine of the zenith angle under a cardioidal sky, L = L0 (1 + 2 cos).

    Array twin: root of (3 m^2 + 4 m^3) / 7 = u.
    The flux through a level plane per cosine m is L m ~ m + 2 m^2, and u its share up to m.
    Newton's first step from sqrt(u) leads above the root, the others fall towards it.
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
    """CIE sky (ISO 15469:2004): gradation over the zenith times indicatrix about the sun."""

    sun: Vec3  # unit vector to the sun, in the air
    p: float  # gradation p + a e^(b / cos z) [W m-2 sr-1 nm-1], z the zenith angle
    a: float
    b: float
    f: float  # indicatrix f + c e^(d chi) + e cos^2 chi, chi the angle from the sun
    c: float
    d: float
    e: float


class Backward(NamedTuple):
    """Rays of backward photons from a receiver, and the daylight that they collect."""

    origin: NDArray[np.float64]  # (photons, 3), empty for photons that start at the sources
    direction: NDArray[np.float64]  # (photons, 3), against the travel of the light
    in_water: bool  # whether the receiver is
    after_water: bool  # score only light that has been in the water
    sky: Sky
    sun: Vec3  # unit vector to the sun as seen under water
    irradiance: float  # of the sun, across its direction below the surface [W m-2 nm-1]
    # share of the scattering by water or bubbles that takes light out of the sun's beam, 1 for a
    # receiver in the water, else beyond a small angle
    lost_water: float
    lost_bubble: float
    phase_water: NDArray[np.float64]  # at equal steps of the angle from 0 to pi, smoothed [sr-1]
    phase_bubble: NDArray[np.float64]


NOWHERE = np.zeros((0, 3))
FORWARD = Backward(
    NOWHERE, NOWHERE, False, False, Sky(UP, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), UP, 0.0, 1.0, 1.0,
    np.zeros(2), np.zeros(2),
)  # fmt: skip
"""Photons that start at the sources."""

SKY_SCORE, SUN_SCORE, BUBBLE_SCORE = 0, 1, 2
N_SCORES = 3
"""Columns of the scores of a backward photon, and their number.

Skylight on leaving to the sky, sunlight scattered at collisions by the water, and by bubbles.
"""


@inlined
def is_backward(back):
    """Return whether photons start at a receiver.

    Array twin: none.
    """
    return len(back.origin) > 0


@inlined
def launch_back(back, seed, photon):
    """Return position, direction, whether in water, and a spare uniform of a backward photon.

    Array twin: the rows of `Backward`.
    """
    _, _, u, _ = uniforms(seed, photon, 0, Purpose.LAUNCH.value)
    return row(back.origin, photon), row(back.direction, photon), back.in_water, u


@outlined
def sunlight(back, medium: Medium, p, d, weight):
    """Return the sunlight expected to be scattered into a path at a tentative collision at p.

    By the water and by bubbles [W m-2 sr-1 nm-1]. d is the direction of the backward photon before
    the collision, so that its angle to the sun is that of the scattering.
    Array twin: single scattering by quadrature in `tests/daylight`.
    The sun is refracted by still water. Its disk is widened to a few degrees, over which the phase
    functions are averaged and their peaks bounded: less noise for more bias.
    """
    half_turns = math.acos(min(max(dot(d, back.sun), -1.0), 1.0)) / math.pi
    water, bubbles = scattering_coefficients(medium, p)
    # Single scattering: b times the phase function [m-1 sr-1] of either scatterer.
    water *= lookup(back.phase_water, half_turns * (len(back.phase_water) - 1))
    if bubbles > 0.0:
        bubbles *= lookup(back.phase_bubble, half_turns * (len(back.phase_bubble) - 1))
    to_surface = max(-p.z, 0.0) / back.sun.z
    entry_point = along(p, back.sun, to_surface)
    by_water = water_path(medium, p.z, entry_point.z, to_surface)
    by_bubbles = scattering_path(medium, p, entry_point, to_surface) - by_water
    # Quasi-single scattering (Gordon 1973): small angles leave light in the sun's beam.
    tau = back.lost_water * by_water + back.lost_bubble * by_bubbles
    tau += absorption_path(medium, p.z, entry_point.z, to_surface)
    # over the rate b_max of tentative collisions per length
    collected = weight / medium.b_max * back.irradiance * math.exp(-tau)
    return collected * water, collected * bubbles


@inlined
def radiance(sky, direction):
    """Return the radiance of the sky in a direction.

    Array twin: `meshtrace.daylight.sky_radiance`.
    All patterns of the sky are values of the same seven numbers: one kernel serves them.
    """
    cos_chi = min(max(dot(direction, sky.sun), -1.0), 1.0)
    # CIE general sky: gradation f(Z) times indicatrix (ISO 15469:2004).
    gradation = sky.p + sky.a * math.exp(sky.b / max(direction.z, LEAST_COS))
    glow = sky.f + sky.c * math.exp(sky.d * math.acos(cos_chi)) + sky.e * cos_chi * cos_chi
    return gradation * glow


@entry
def land_sunlight(z, zx, zy, corner, spacing, sun, n, c, depth, cells, cell, landed):
    """Add the unscattered sunlight refracted by a sea surface to the cells of a level plane.

    Array twin: `refracted` in `tests/apps/test_irradiance.py`.
    Why so: one pass over the points, of 70 operations each, in place of forty arrays.

    Parameters
    ----------
    z, zx, zy : ndarray, shape (nx, ny)
        Height [m] and slopes along x and y at `corner` + `spacing` (i, j).
    corner, spacing : (float, float), float
        Place of the first point and distance of the points [m].
    sun : (float, float, float)
        Unit vector to the sun.
    n : float
        Refractive index of the water over that of the air.
    c, depth : float
        Attenuation [m-1], and depth of the plane below z = 0 [m].
    cells, cell : (float, float), float
        Corner of the plane (x, y) and edge of its cells [m].
    landed : ndarray, shape (mx, my)
        Power on the cells over the irradiance across the sunlight [m2]; each point is shared out
        between the four nearest cell centres (bilinear), and lost beyond the outermost.
    """
    for i in range(z.shape[0]):
        for j in range(z.shape[1]):
            slope_x, slope_y = zx[i, j], zy[i, j]
            # The normal is N / |N| with N = (-slope_x, -slope_y, 1) and |N| = length.
            facing = sun[2] - slope_x * sun[0] - slope_y * sun[1]  # sun . N
            if facing <= 0.0:
                continue
            length = math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
            cos_i = facing / length
            cos_t = math.sqrt(1.0 - (1.0 - cos_i * cos_i) / (n * n))
            # Vector form of Snell's law: light travels along -sun / n + normal_part N below.
            normal_part = (cos_i / n - cos_t) / length
            down = sun[2] / n - normal_part
            if down <= 0.0:
                continue
            path = (z[i, j] + depth) / down
            # The patch has the area spacing^2 |N|; across the sunlight that is spacing^2 sun . N.
            power = spacing * spacing * facing * (1.0 - reflectance(cos_i, cos_t, 1.0, n))
            power *= math.exp(-c * path)
            x = corner[0] + i * spacing + path * (-sun[0] / n - normal_part * slope_x)
            y = corner[1] + j * spacing + path * (-sun[1] / n - normal_part * slope_y)
            # in cells from the centre of the first one
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
    power: NDArray[np.float64]  # (beams,) irradiance across a beam, over `irradiance` of its ring
    ring: NDArray[np.int64]  # (beams,) index of the ring, the sun's last
    slant: NDArray[np.float64]  # (rings,) mu_0, cosines to the vertical under water
    irradiance: NDArray[np.float64]  # (rings, wavelengths) of sky or sun [W m-2 nm-1]
    phase: NDArray[np.float64]  # (angles, functions) common to all phase functions, from 0 to pi
    m: NDArray[np.float64]  # (nodes,) 1 / mu_0 + 1 / mu of beam and view, a geometric series
    # int b exp(-m int k dz) dz over the depth, attenuation k (scatterers, nodes, wavelengths)
    integral: NDArray[np.float64]
    mix: NDArray[np.float64]  # (scatterers, functions, wavelengths) phase functions = mix . phase
    # (nodes, wavelengths) radiance of the bottom for an irradiance of 1; (0, ...) without a bottom
    floor: NDArray[np.float64]


@entry
def add_upwelling(directions, beams, toward, scattered, radiances):
    """Add the upwelling radiance just below the surface along directions.

    Array twin: `scattered_once` in `tests/daylight/test_background_air.py`.
    Why so: 281 beams have 15 slants, and the phase functions of all wavelengths are
    combinations of few common functions, so that little is summed for each wavelength.

    Parameters
    ----------
    directions : ndarray, shape (n, 3)
        Unit vectors of travel, upwards.
    beams : Beams
        Beams and water.
    toward, scattered : ndarray, shape (rings, functions + 1), (wavelengths,)
        Scratch: power of each ring times each function of the scattering angle, with the power
        alone in the last column; the phase function times power at each wavelength.
    radiances : ndarray, shape (n, wavelengths)
        Radiances [W m-2 sr-1 nm-1], added to.
    """
    nodes, per_angle = len(beams.m), (len(beams.phase) - 1) / math.pi
    # The nodes are a geometric series: the interval follows from a logarithm.
    per_m = (nodes - 1) / math.log(beams.m[nodes - 1] / beams.m[0])
    for i in range(len(directions)):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        mu = max(z, 1e-3)  # level light has no finite 1 / mu
        toward[:] = 0.0
        for b in range(len(beams.power)):
            cosine = x * beams.travel[b, 0] + y * beams.travel[b, 1] + z * beams.travel[b, 2]
            position = math.acos(min(max(cosine, -1.0), 1.0)) * per_angle
            j = min(int(position), len(beams.phase) - 2)
            # f: the fraction of the step from node j to j + 1
            f, power, r = position - j, beams.power[b], beams.ring[b]
            # extinction depends on the ring alone: phase functions are summed over it first
            for q in range(beams.phase.shape[1]):
                p = (1.0 - f) * beams.phase[j, q] + f * beams.phase[j + 1, q]
                toward[r, q] += power * p
            toward[r, -1] += power
        for r in range(len(beams.slant)):
            # Light scattered once at depth z is weakened by exp(-k z (1 / mu_0 + 1 / mu)): the
            # tables are over that sum.
            air_mass = 1.0 / beams.slant[r] + 1.0 / mu
            j = min(max(int(math.log(air_mass / beams.m[0]) * per_m), 0), nodes - 2)
            f = min(max((air_mass - beams.m[j]) / (beams.m[j + 1] - beams.m[j]), 0.0), 1.0)
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
                # the bottom reflects the horizontal irradiance, with equal radiance to all sides
                horizontal, row = toward[r, -1] * beams.slant[r], radiances[i]
                irradiance = beams.irradiance[r]
                low, high = beams.floor[j], beams.floor[j + 1]
                for c in range(len(row)):
                    row[c] += irradiance[c] * horizontal * ((1.0 - f) * low[c] + f * high[c])
