"""The sea surface: Snell, Fresnel, whitecaps at one crossing."""

from __future__ import annotations

import math
from typing import NamedTuple

from meshtrace.kernels.jit import inlined, outlined

SNELL_PHYSICAL, SNELL_PAPER = 0, 1
DIRECTION_VECTOR, DIRECTION_PAPER = 0, 1
FRESNEL_WEIGHT, FRESNEL_ROULETTE, FRESNEL_PAPER_BOTH = 0, 1, 2
FOV_ANGLE, FOV_PAPER_POSITION = 0, 1


class Interface(NamedTuple):
    """Switches of the crossing, see `meshtrace.link.Physics`."""

    snell: int
    direction: int
    fresnel: int
    follow_reflected: bool
    follow_second_hit: bool
    foam_transmittance: float  # T_u
    fov: int


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
def refract(dx, dy, dz, nx, ny, nz, cos_i, n1, n2):
    """Return (cos_t, direction) behind the surface; cos_t < 0: total internal reflection.

    Array twin: `meshtrace.optics.fresnel.refract`.
    The normal points along the light (cos_i > 0). Vector form of Snell's law.
    """
    eta = n1 / n2
    sin2_t = eta * eta * (1.0 - cos_i * cos_i)
    if sin2_t >= 1.0:
        return -1.0, 0.0, 0.0, 0.0
    cos_t = math.sqrt(1.0 - sin2_t)
    k = cos_t - eta * cos_i
    return cos_t, eta * dx + k * nx, eta * dy + k * ny, eta * dz + k * nz


@outlined
def refract_as_printed(dx, dy, dz, nx, ny, nz, cos_i, n1, n2, snell, direction):
    """Return (cos_t, rho, direction) with the paper's printed forms; cos_t < 0: reflected.

    Array twin: none, the formulas are those of the paper (eqs. theta_r, mu_post_surface).
    Errata E2 (Snell upside-down) and E3 (sine of the components) on wish.
    """
    sin_i = math.sqrt(max(1.0 - cos_i * cos_i, 0.0))
    if sin_i >= n2 / n1:
        return -1.0, 1.0, 0.0, 0.0, 0.0
    sin_t = sin_i * (n2 / n1 if snell == SNELL_PAPER else n1 / n2)
    if sin_t >= 1.0:  # upside-down Snell, from the air
        return -1.0, 1.0, 0.0, 0.0, 0.0
    theta_t = math.asin(sin_t)
    cos_t = math.cos(theta_t)
    if snell == SNELL_PAPER:
        # the printed angles enter the printed Fresnel formula, which is symmetric in them
        rho = reflectance(cos_i, cos_t, n2, n1)
    else:
        rho = reflectance(cos_i, cos_t, n1, n2)
    tx, ty, tz = dx - cos_i * nx, dy - cos_i * ny, dz - cos_i * nz
    norm = math.sqrt(tx * tx + ty * ty + tz * tz)
    if norm > 0.0:
        tx, ty, tz = tx / norm, ty / norm, tz / norm
    if direction == DIRECTION_PAPER:
        px, py, pz = math.sin(theta_t * tx), math.sin(theta_t * ty), math.sin(theta_t * tz)
    else:
        px, py, pz = sin_t * tx, sin_t * ty, sin_t * tz
    return cos_t, rho, cos_t * nx + px, cos_t * ny + py, cos_t * nz + pz
