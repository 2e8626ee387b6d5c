"""Vectors of two and three numbers, and rotations by a scattering angle.

Tuples of floats: compiled code holds them in registers, where arrays would take memory.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from meshtrace.kernels.jit import inlined

TWO_PI = 2.0 * math.pi


class Vec2(NamedTuple):
    """Point [m] or slope in a plane."""

    x: float
    y: float


class Vec3(NamedTuple):
    """Point [m] or direction."""

    x: float
    y: float
    z: float


ORIGIN = Vec3(0.0, 0.0, 0.0)
UP = Vec3(0.0, 0.0, 1.0)


@inlined
def row(array, i):
    """Return row i of an (n, 3) array as a vector.

    Array twin: `array[i]`.
    """
    return Vec3(array[i, 0], array[i, 1], array[i, 2])


@inlined
def write(out, a):
    """Write a vector into an array of three numbers.

    Array twin: `out[:] = a`.
    """
    out[0], out[1], out[2] = a.x, a.y, a.z


@inlined
def dot(a, b):
    """Return the scalar product.

    Array twin: numpy.dot.
    """
    return a.x * b.x + a.y * b.y + a.z * b.z


@inlined
def cross(a, b):
    """Return the vector product.

    Array twin: numpy.cross.
    """
    return Vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


@inlined
def plus(a, b):
    """Return a + b.

    Array twin: numpy.add.
    """
    return Vec3(a.x + b.x, a.y + b.y, a.z + b.z)


@inlined
def minus(a, b):
    """Return a - b.

    Array twin: numpy.subtract.
    """
    return Vec3(a.x - b.x, a.y - b.y, a.z - b.z)


@inlined
def scaled(s, a):
    """Return s a.

    Array twin: `s * a`.
    """
    return Vec3(s * a.x, s * a.y, s * a.z)


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
def blend(u, v, a, b, c):
    """Return the point of a triangle with the barycentrics (1 - u - v, u, v).

    Array twin: `(1 - u - v) * a + u * b + v * c`.
    """
    return along(combine(1.0 - u - v, a, u, b), c, v)


@inlined
def norm(a):
    """Return the length of a vector.

    Array twin: numpy.linalg.norm.
    """
    return math.sqrt(a.x * a.x + a.y * a.y + a.z * a.z)


@inlined
def unit(a):
    """Return the unit vector along a vector.

    Array twin: `a / numpy.linalg.norm(a)`.
    """
    return scaled(1.0 / norm(a), a)


@inlined
def minus2(a, b):
    """Return a - b in the plane.

    Array twin: numpy.subtract.
    """
    return Vec2(a.x - b.x, a.y - b.y)


@inlined
def dot2(a, b):
    """Return the scalar product in the plane.

    Array twin: numpy.dot.
    """
    return a.x * b.x + a.y * b.y


@inlined
def cross2(a, b):
    """Return the signed area of the parallelogram of two vectors in the plane.

    Array twin: numpy.linalg.det.
    """
    return a.x * b.y - a.y * b.x


@inlined
def on_circle(u):
    """Return cosine and sine of 2 pi u, 0 <= u <= 1.

    Array twin: numpy.cos, numpy.sin.
    One of the two functions is enough: the other is a square root and a sign.
    """
    # The sine is positive in the first half turn, u < 1/2.
    c = math.cos(TWO_PI * u)
    return c, math.copysign(math.sqrt(max(1.0 - c * c, 0.0)), 0.5 - u)


@inlined
def turn(d, s, u_phi):
    """Turn a unit direction by a polar angle theta, s = sin^2(theta / 2), at azimuth 2 pi u_phi.

    Array twin: rotation of (sin theta cos phi, sin theta sin phi, cos theta) in the tests.
    The frame about d of Duff et al. (2017), J. Comput. Graph. Tech. 6(1), has no pole: the textbook
    update divides by sqrt(1 - dz^2), which loses digits for vertical light.
    """
    # sin^2(theta/2) keeps the digits of small angles, whose cosine is 1: sin = 2 sqrt(s (1 - s))
    sin_theta = 2.0 * math.sqrt(max(s * (1.0 - s), 0.0))
    cos_theta = 1.0 - 2.0 * s
    cos_phi, sin_phi = on_circle(u_phi)
    p, q = sin_theta * cos_phi, sin_theta * sin_phi
    # Orthonormal frame of d without a square root or branch, f and g the a and b of Duff et al.
    sign = math.copysign(1.0, d.z)
    # |sign + d.z| >= 1, since both have the same sign
    f = -1.0 / (sign + d.z)
    g = d.x * d.y * f
    out = Vec3(
        p * (1.0 + sign * d.x * d.x * f) + q * g + cos_theta * d.x,
        p * sign * g + q * (sign + d.y * d.y * f) + cos_theta * d.y,
        -p * sign * d.x - q * d.y + cos_theta * d.z,
    )
    # Rounding changes the length by 1e-16 a turn, and there may be thousands. One Newton step for
    # 1 / sqrt(|out|^2) from 1 restores it without a root.
    return scaled(1.5 - 0.5 * dot(out, out), out)
