"""Vectors of three numbers, and rotations by a scattering angle."""

from __future__ import annotations

import math
from typing import NamedTuple

from meshtrace.kernels.jit import inlined

TWO_PI = 2.0 * math.pi


class Vec3(NamedTuple):
    """Point [m] or direction."""

    x: float
    y: float
    z: float


@inlined
def row(array, i):
    """Return row i of an (n, 3) array.

    Array twin: `array[i]`.
    """
    return Vec3(array[i, 0], array[i, 1], array[i, 2])


@inlined
def dot(a, b):
    """Return the scalar product.

    Array twin: numpy.dot.
    """
    return a.x * b.x + a.y * b.y + a.z * b.z


@inlined
def minus(a, b):
    """Return a - b.

    Array twin: numpy.subtract.
    """
    return Vec3(a.x - b.x, a.y - b.y, a.z - b.z)


@inlined
def along(p, d, t):
    """Return p + t d, the point at distance t of a ray.

    Array twin: `p + t * d`.
    """
    return Vec3(p.x + t * d.x, p.y + t * d.y, p.z + t * d.z)


@inlined
def combine(s, a, t, b):
    """Return s a + t b.

    Array twin: `s * a + t * b`.
    """
    return Vec3(s * a.x + t * b.x, s * a.y + t * b.y, s * a.z + t * b.z)


@inlined
def norm(a):
    """Return the length of a vector.

    Array twin: numpy.linalg.norm.
    """
    return math.sqrt(a.x * a.x + a.y * a.y + a.z * a.z)


@inlined
def on_circle(u):
    """Return cosine and sine of 2 pi u, 0 <= u <= 1.

    Array twin: numpy.cos, numpy.sin.
    One of the two functions is enough: the other is a square root and a sign.
    """
    c = math.cos(TWO_PI * u)
    return c, math.copysign(math.sqrt(max(1.0 - c * c, 0.0)), 0.5 - u)


@inlined
def turn(dx, dy, dz, s, u_phi):
    """Turn a unit direction by the polar angle of s = sin^2(theta/2) and azimuth 2 pi u_phi.

    Array twin: rotation of (sin theta cos phi, sin theta sin phi, cos theta) in the tests.
    The frame of Duff et al. (2017) has no pole: the textbook update divides by
    sqrt(1 - dz^2) and bends the beam of an on-axis source.
    """
    sin_theta = 2.0 * math.sqrt(max(s * (1.0 - s), 0.0))
    cos_theta = 1.0 - 2.0 * s
    cos_phi, sin_phi = on_circle(u_phi)
    p, q = sin_theta * cos_phi, sin_theta * sin_phi
    sign = math.copysign(1.0, dz)
    f = -1.0 / (sign + dz)
    g = dx * dy * f
    x = p * (1.0 + sign * dx * dx * f) + q * g + cos_theta * dx
    y = p * sign * g + q * (sign + dy * dy * f) + cos_theta * dy
    z = -p * sign * dx - q * dy + cos_theta * dz
    # rounding drifts by 1e-16 a turn; thousands of turns must stay on the unit sphere
    scale = 1.5 - 0.5 * (x * x + y * y + z * z)
    return x * scale, y * scale, z * scale
