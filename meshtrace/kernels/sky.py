"""Radiance of the sky in closed form, for light that leaves the sea on its way back."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.jit import inlined, outlined
from meshtrace.kernels.medium import (
    Medium,
    absorption_path,
    lookup,
    scattering_coefficients,
    scattering_depth,
)
from meshtrace.kernels.random import Purpose, uniforms
from meshtrace.kernels.vectors import UP, Vec3, dot, row

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


class Backward(NamedTuple):
    """Start of photons at a receiver, and the light that they meet on their way back."""

    origin: NDArray[np.float64]  # (photons, 3), empty for photons that start at the sources
    direction: NDArray[np.float64]
    in_water: bool
    after_water: bool  # score only light that has been in the water
    sky: Sky
    sun: Vec3  # direction to the sun under water
    irradiance: float  # of the sun, across its direction below the surface [W m-2 nm-1]
    kept: float  # share of the scattering that takes light out of the sun's beam
    phase_water: NDArray[np.float64]  # over the angle from 0 to pi, smoothed [sr-1]
    phase_bubble: NDArray[np.float64]


NOWHERE = np.zeros((0, 3))
FORWARD = Backward(
    NOWHERE, NOWHERE, False, False, Sky(UP, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), UP, 0.0, 1.0,
    np.zeros(2), np.zeros(2),
)  # fmt: skip
"""Photons that start at the sources."""

SKY_SCORE, SUN_SCORE = 0, 1
N_SCORES = 2
"""Scores of a photon on its way back: sky on leaving, sun at its collisions."""


@inlined
def is_backward(back):
    """Return whether photons start at a receiver.

    Array twin: none.
    """
    return len(back.origin) > 0


@inlined
def launch_back(back, seed, photon):
    """Return position, direction, medium and a spare uniform of a photon on its way back.

    Array twin: the rows of `Backward`.
    """
    _, _, u, _ = uniforms(seed, photon, 0, Purpose.LAUNCH.value)
    return row(back.origin, photon), row(back.direction, photon), back.in_water, u


@outlined
def sunlight(back, medium: Medium, p, d, weight):
    """Return the expected sunlight that a tentative collision scatters into a path.

    Array twin: single scattering by quadrature in `tests/daylight`.
    The sun is refracted by still water; its disk of some degrees bounds the phase function.
    """
    angle = math.acos(min(max(dot(d, back.sun), -1.0), 1.0)) / math.pi
    water, bubbles = scattering_coefficients(medium, p)
    scattered = water * lookup(back.phase_water, angle * (len(back.phase_water) - 1))
    if bubbles > 0.0:
        scattered += bubbles * lookup(back.phase_bubble, angle * (len(back.phase_bubble) - 1))
    t = max(-p.z, 0.0) / back.sun.z
    tau = back.kept * scattering_depth(medium, p, back.sun, t)
    tau += absorption_path(medium, p.z, p.z + t * back.sun.z, t)
    return weight * scattered / medium.b_max * back.irradiance * math.exp(-tau)


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
