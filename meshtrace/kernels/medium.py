"""The water as arrays: coefficients over depth, optical paths, choice of the scatterer."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.jit import inlined
from meshtrace.kernels.phase import PhaseTables, sample_s

# how a bubble's depth is measured (HallNovarini.depth)
DEPTH_NONE, DEPTH_MEAN_LEVEL, DEPTH_CLAMPED, DEPTH_LOCAL = 0, 1, 2, 3
# what an interaction does to the weight (Physics.absorption)
CONTINUOUS, IMPLICIT, ANALOG, PAPER = 0, 1, 2, 3


_PIECES = 4  # of a path below a wavy surface


class Medium(NamedTuple):
    """Optical properties of the water.

    Layers are tabulated on a uniform grid of depths below z = 0, bubbles on a uniform grid of
    depths below the level that `depth_mode` names.
    """

    a: float  # absorption of homogeneous water [m-1]
    b: float  # scattering of homogeneous water [m-1]
    n_water: float
    n_air: float
    layered: bool
    layer_step: float  # [m]
    layer_a: NDArray[np.float64]
    layer_b: NDArray[np.float64]
    layer_a_path: NDArray[np.float64]  # integral of a from z = 0 [1]
    layer_b_path: NDArray[np.float64]  # integral of b from z = 0 [1]
    depth_mode: int
    bubble_start: float  # depth of the first node [m]
    bubble_step: float
    bubble_b: NDArray[np.float64]  # [m-1]
    bubble_path: NDArray[np.float64]  # integral of b_bub from the first node [1]
    b_max: float  # majorant of scattering [m-1]
    c_max: float  # majorant of attenuation [m-1]
    bottom_z: float  # -inf: none
    bottom_albedo: float
    absorption: int
    local_c: bool  # free paths with the coefficient at their start (paper, E6)
    raster_x: float
    raster_y: float
    raster_step: float
    raster: NDArray[np.float64]  # elevation over (x, y), for depths below the local surface
    phase_water: PhaseTables
    phase_bubble: PhaseTables


@inlined
def lookup(table, position):
    """Return the linear interpolant of a table at a fractional index, constant outside.

    Array twin: numpy.interp on a uniform grid.
    """
    if position <= 0.0:
        return table[0]
    i = int(position)
    if i >= len(table) - 1:
        return table[-1]
    return table[i] + (position - i) * (table[i + 1] - table[i])


@inlined
def local_elevation(medium, x, y):
    """Return the elevation at (x, y) from the raster of the mesh, bilinear, clamped.

    Array twin: scipy.interpolate.RegularGridInterpolator.
    """
    nx, ny = medium.raster.shape
    px = min(max((x - medium.raster_x) / medium.raster_step, 0.0), nx - 1.000001)
    py = min(max((y - medium.raster_y) / medium.raster_step, 0.0), ny - 1.000001)
    i, j = int(px), int(py)
    fx, fy = px - i, py - j
    r = medium.raster
    return (1.0 - fx) * ((1.0 - fy) * r[i, j] + fy * r[i, j + 1]) + fx * (
        (1.0 - fy) * r[i + 1, j] + fy * r[i + 1, j + 1]
    )


@inlined
def bubble_scattering(medium, x, y, z):
    """Return b_bub [m-1] at a point.

    Array twin: `HallNovarini.b` of the depth below the chosen level.
    """
    if medium.depth_mode == DEPTH_NONE:
        return 0.0
    depth = -z
    if medium.depth_mode == DEPTH_LOCAL:
        depth = local_elevation(medium, x, y) - z
    if medium.depth_mode != DEPTH_MEAN_LEVEL:
        depth = max(depth, 0.0)
    position = (depth - medium.bubble_start) / medium.bubble_step
    if position >= len(medium.bubble_b) - 1:
        return 0.0
    return lookup(medium.bubble_b, position)


@inlined
def water_coefficients(medium, z):
    """Return (a, b) [m-1] of the water without bubbles at height z.

    Array twin: `Water.a` and `Water.b`, or its layers interpolated.
    """
    if not medium.layered:
        return medium.a, medium.b
    position = -z / medium.layer_step
    return lookup(medium.layer_a, position), lookup(medium.layer_b, position)


@inlined
def absorption_path(medium, z0, z1, length):
    """Return the integral of a along a straight path from height z0 to z1.

    Array twin: quadrature of `Water` layers in the tests.
    A cumulative table makes it exact at any slant; level paths take the local value.
    """
    if not medium.layered:
        return medium.a * length
    return length * _mean(medium.layer_a, medium.layer_a_path, medium.layer_step, -z0, -z1)


@inlined
def scattering_path(medium, x0, y0, z0, x1, y1, z1, length):
    """Return the integral of b + b_bub along a straight path.

    Array twin: quadrature of `Water` and `HallNovarini.b` in the tests.
    Depths below a wavy surface are taken as linear over `_PIECES` parts of the path.
    """
    tau = medium.b * length
    if medium.layered:
        tau = length * _mean(medium.layer_b, medium.layer_b_path, medium.layer_step, -z0, -z1)
    if medium.depth_mode == DEPTH_NONE:
        return tau
    if medium.depth_mode != DEPTH_LOCAL:
        shift = medium.bubble_start
        return tau + length * _mean(
            medium.bubble_b, medium.bubble_path, medium.bubble_step, -z0 - shift, -z1 - shift
        )
    before = local_elevation(medium, x0, y0) - z0
    for i in range(1, _PIECES + 1):
        f = i / _PIECES
        depth = local_elevation(medium, x0 + f * (x1 - x0), y0 + f * (y1 - y0)) - (
            z0 + f * (z1 - z0)
        )
        tau += (
            length
            / _PIECES
            * _mean(medium.bubble_b, medium.bubble_path, medium.bubble_step, before, depth)
        )
        before = depth
    return tau


@inlined
def _mean(table, path, step, d0, d1):
    """Return the mean of a tabulated coefficient between two depths."""
    if abs(d1 - d0) < 1e-7:
        return lookup(table, 0.5 * (d0 + d1) / step)
    return (_cumulative(table, path, step, d1) - _cumulative(table, path, step, d0)) / (d1 - d0)


@inlined
def _cumulative(table, path, step, depth):
    """Return the integral of a linearly interpolated table, constant outside, up to a depth."""
    last = (len(table) - 1) * step
    if depth <= 0.0:
        return depth * table[0]
    if depth >= last:
        return path[-1] + (depth - last) * table[-1]
    position = depth / step
    i = int(position)
    f = position - i
    return path[i] + step * f * (table[i] + 0.5 * f * (table[i + 1] - table[i]))


@inlined
def sample_free_path(medium, x, y, z, u):
    """Return a tentative free path [m]: exponential with the majorant.

    Array twin: -log(1 - u) / c.
    Delta tracking: a tentative collision is real with probability c(z) / c_max, which is exact
    for any profile; a homogeneous medium has no null collisions.
    """
    rate = medium.b_max if medium.absorption == CONTINUOUS else medium.c_max
    if medium.local_c:
        a, b = water_coefficients(medium, z)
        rate = b + bubble_scattering(medium, x, y, z)
        if medium.absorption != CONTINUOUS:
            rate += a
    if rate <= 0.0:
        return math.inf
    return -math.log(1.0 - u) / rate


@inlined
def collide(medium, x, y, z, weight, u_kind, u_theta):
    """Return (s, weight) after a tentative collision; s < 0: the direction stays.

    Array twin: `tests/statistical`, chi-square of the mixture.
    One uniform chooses null, water or bubble; weight 0 means absorbed (analog absorption).
    """
    a, b = water_coefficients(medium, z)
    b_bub = bubble_scattering(medium, x, y, z)
    scatter = b + b_bub
    mode = medium.absorption
    if mode == CONTINUOUS:
        total, majorant = scatter, medium.b_max
    else:
        total, majorant = a + scatter, medium.c_max
    if medium.local_c:
        majorant = total
    pick = u_kind * majorant
    if pick >= total:
        return -1.0, weight
    if mode == CONTINUOUS:
        pick_b = pick
    else:
        albedo = scatter / total
        if mode == ANALOG:
            if pick >= scatter:
                return -1.0, 0.0
            pick_b = pick
        elif mode == IMPLICIT:
            weight *= albedo
            pick_b = pick * albedo
        else:  # as printed in Algorithm 1: weighted at every interaction, turned in a few
            weight *= albedo
            if pick >= scatter:
                return -1.0, weight
            pick_b = pick
    if pick_b < b:
        return sample_s(medium.phase_water, u_theta), weight
    return sample_s(medium.phase_bubble, u_theta), weight
