"""The sea surface: Snell, Fresnel, whitecaps at one crossing."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

from meshtrace.kernels.jit import inlined, outlined
from meshtrace.kernels.vectors import ORIGIN, Vec3, along, combine, dot, norm, scaled


class Snell(IntEnum):
    """Form of the law of refraction, `Physics.snell`."""

    PHYSICAL = 0
    PAPER = 1


class Direction(IntEnum):
    """Form of the refracted direction, `Physics.direction`."""

    VECTOR = 0
    PAPER = 1


class FresnelMode(IntEnum):
    """Treatment of the reflectance, `Physics.fresnel`."""

    WEIGHT = 0
    ROULETTE = 1
    PAPER_BOTH = 2


class FieldOfView(IntEnum):
    """Test of the field of view, `Physics.fov`."""

    ANGLE = 0
    PAPER_POSITION = 1


class Interface(NamedTuple):
    """Switches of the crossing, see `meshtrace.link.Physics`."""

    snell: int  # Snell
    direction: int  # Direction
    fresnel: int  # FresnelMode
    follow_reflected: bool
    follow_second_hit: bool
    foam_transmittance: float  # T_u
    fov: int  # FieldOfView


@inlined
def reflectance(cos_i, cos_t, n1, n2):
    """Return the Fresnel reflectance of unpolarised light from n1 into n2.

    Array twin: `meshtrace.optics.fresnel.fresnel_reflectance`.
    Amplitude form: no 0/0 at normal incidence.
    """
    rs = (n1 * cos_i - n2 * cos_t) / (n1 * cos_i + n2 * cos_t)
    rp = (n2 * cos_i - n1 * cos_t) / (n2 * cos_i + n1 * cos_t)
    return 0.5 * (rs * rs + rp * rp)


@inlined
def refract(d, n, cos_i, n1, n2):
    """Return (cos_t, direction) behind the surface; cos_t < 0: total internal reflection.

    Array twin: `meshtrace.optics.fresnel.refract`.
    The normal points along the light (cos_i > 0). Vector form of Snell's law.
    """
    eta = n1 / n2
    sin2_t = eta * eta * (1.0 - cos_i * cos_i)
    if sin2_t >= 1.0:
        return -1.0, ORIGIN
    cos_t = math.sqrt(1.0 - sin2_t)
    return cos_t, combine(eta, d, cos_t - eta * cos_i, n)


@outlined
def refract_as_printed(d, n, cos_i, n1, n2, interface):
    """Return (cos_t, rho, direction) in the forms of the paper; cos_t < 0: reflected.

    Array twin: none, the formulas are those of the paper (eqs. theta_r, mu_post_surface).
    Errata E2 (Snell upside-down) and E3 (sine of the components), each by its switch.
    """
    sin_i = math.sqrt(max(1.0 - cos_i * cos_i, 0.0))
    if sin_i >= n2 / n1:
        return -1.0, 1.0, ORIGIN
    sin_t = sin_i * (n2 / n1 if interface.snell == Snell.PAPER else n1 / n2)
    if sin_t >= 1.0:  # upside-down Snell, from the air
        return -1.0, 1.0, ORIGIN
    theta_t = math.asin(sin_t)
    cos_t = math.cos(theta_t)
    if interface.snell == Snell.PAPER:
        # the published angles enter the published Fresnel formula, which is symmetric in them
        rho = reflectance(cos_i, cos_t, n2, n1)
    else:
        rho = reflectance(cos_i, cos_t, n1, n2)
    t = along(d, n, -cos_i)
    length = norm(t)
    if length > 0.0:
        t = Vec3(t.x / length, t.y / length, t.z / length)
    if interface.direction == Direction.PAPER:
        tangential = Vec3(math.sin(theta_t * t.x), math.sin(theta_t * t.y), math.sin(theta_t * t.z))
    else:
        tangential = scaled(sin_t, t)
    return cos_t, rho, along(tangential, n, cos_t)


@inlined
def transmit(d, n, cos_i, n1, n2, interface):
    """Return (cos_t, rho, direction) behind the surface; cos_t < 0 and rho = 1: reflected.

    Array twin: `refract` and `reflectance`.
    """
    if interface.snell == Snell.PHYSICAL and interface.direction == Direction.VECTOR:
        cos_t, out = refract(d, n, cos_i, n1, n2)
        return cos_t, reflectance(cos_i, cos_t, n1, n2) if cos_t >= 0.0 else 1.0, out
    return refract_as_printed(d, n, cos_i, n1, n2, interface)


@inlined
def branches(d, n, g, n1, n2, interface):
    """Return reflectance, transmitted and reflected direction at a normal along the light.

    Array twin: `meshtrace.optics.fresnel`.
    An interpolated normal may contradict its facet (g): the light would leave on the wrong
    side. Then the facet's own normal is taken, which cannot.
    """
    rho, transmitted, reflected = 1.0, ORIGIN, ORIGIN
    for _ in range(2):
        cos_i = min(dot(d, n), 1.0)
        _, rho, transmitted = transmit(d, n, cos_i, n1, n2, interface)
        reflected = along(d, n, -2.0 * cos_i)
        sound = cos_i > 0.0 and not (rho < 1.0 and dot(transmitted, g) <= 0.0)
        if sound and dot(reflected, g) < 0.0:
            break
        n = g
    return rho, transmitted, reflected
