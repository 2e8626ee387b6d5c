"""Radiance of the sky in closed form, for light that leaves the sea on its way back."""

from __future__ import annotations

import math
from typing import NamedTuple

from meshtrace.kernels.jit import inlined
from meshtrace.kernels.vectors import Vec3, dot

LEAST_COS = 1e-3


class Sky(NamedTuple):
    """Gradation over the zenith angle times indicatrix over the angle from the sun."""

    sun: Vec3  # direction to the sun
    p: float  # gradation p + a e^(b / cos z) [W m-2 sr-1 nm-1]
    a: float
    b: float
    f: float  # indicatrix f + c e^(d chi) + e cos^2 chi
    c: float
    d: float
    e: float


@inlined
def radiance(sky, direction):
    """Return the radiance of the sky in a direction.

    Array twin: `meshtrace.daylight.patterns.sky_radiance`.
    One product of two factors holds every pattern, so that one kernel is compiled.
    """
    cos_chi = min(max(dot(direction, sky.sun), -1.0), 1.0)
    gradation = sky.p + sky.a * math.exp(sky.b / max(direction.z, LEAST_COS))
    glow = sky.f + sky.c * math.exp(sky.d * math.acos(cos_chi)) + sky.e * cos_chi * cos_chi
    return gradation * glow
