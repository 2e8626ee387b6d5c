"""The water as arrays: phase functions, coefficients over depth, optical paths, collisions.

Free paths are sampled by delta tracking [1]_. Scattering angles are interpolated between quantiles
of the phase function. The angle is carried as ``s = sin^2(theta / 2)``: ``cos(theta) = 1 - 2 s``
and ``sin(theta) = 2 sqrt(s (1 - s))`` then keep all digits at small angles, where most of the light
of sea water goes. The values of phase functions are tables over the logarithm of the angle.

References
----------
.. [1] E. R. Woodcock, T. Murphy, P. J. Hemmings and T. C. Longworth, "Techniques used in the GEM
   code for Monte Carlo neutronics calculations in reactors and other systems of complex
   geometry", ANL-7050 (1965).
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.jit import entry, inlined
from meshtrace.kernels.vectors import along, minus, norm, row


class PhaseTables(NamedTuple):
    """Quantiles of a phase function, the same type for all, so that kernels compile once.

    Parameters
    ----------
    nodes : ndarray of float64, shape (n + 2,)
        s^(1/e) at u = 0, 1/n ... k/n, then s at u = k/n ... 1: the node k/n is held in both forms.
    powers : int
        Number k of the first intervals, in which s goes as a power of u.
    exponent : float
        That power e.
    """

    nodes: NDArray[np.float64]
    powers: int
    exponent: float


@inlined
def sample_s(tables: PhaseTables, u: float) -> float:
    """Return s = sin^2(theta / 2) of a scattering angle for one uniform u in [0, 1).

    Array twin: `meshtrace.optics.phase.PhaseFunction.sample`.
    Quantiles are linear between equal steps of u. Only the first intervals pay for a power.
    """
    intervals = len(tables.nodes) - 2
    # Inversion of a tabulated distribution function; at equal steps of u without a search.
    x = u * intervals
    i = min(int(x), intervals - 1)
    # Near u = 0 the quantile s(u) rises as u^e, since phase functions of sea water peak forwards;
    # s^(1/e) is linear in u for such a power law.
    if x < tables.powers:
        y = tables.nodes[i]
        return min((y + (x - i) * (tables.nodes[i + 1] - y)) ** tables.exponent, 1.0)
    s = tables.nodes[i + 1]
    return min(s + (x - i) * (tables.nodes[i + 2] - s), 1.0)


SMALLEST_ANGLE = 1e-13
"""First edge of tables over the logarithm of the scattering angle [rad]."""

LOG_SMALLEST = math.log(SMALLEST_ANGLE)
_LOG_SPAN = math.log(math.pi) - LOG_SMALLEST
ANGLE_CELLS = math.ceil(200.0 * _LOG_SPAN)
"""Cells of a phase function, equally wide in ln(theta): at most 0.5 % of the angle."""

CELLS_PER_LOG = ANGLE_CELLS / _LOG_SPAN


@inlined
def phase_at(beta, theta):
    """Return the phase function [sr-1] at an angle theta [rad].

    Array twin: `PhaseFunction.pdf`, averaged over cells.
    `beta` (`ANGLE_CELLS`,) has the means of the cells; below the first edge the first one holds.
    """
    if theta <= SMALLEST_ANGLE:
        return beta[0]
    # Rounding may step over the last edge, pi.
    j = int((math.log(theta) - LOG_SMALLEST) * CELLS_PER_LOG)
    return beta[min(max(j, 0), ANGLE_CELLS - 1)]


class DepthMode(IntEnum):
    """Level from which the depth of bubbles is measured, `BubblePopulation.depth`."""

    NONE = 0  # no bubbles
    MEAN_LEVEL = 1  # z = 0, with negative depths in crests
    CLAMPED = 2  # z = 0, with the depth 0 in crests
    LOCAL = 3  # the surface above the point


class Absorption(IntEnum):
    """Treatment of absorption, `Physics.absorption`."""

    CONTINUOUS = 0  # exp(-a path) on the weight, free paths from b alone
    IMPLICIT = 1  # the albedo on the weight at each scattering
    ANALOG = 2  # photons end with the probability of absorption
    PAPER = 3  # the albedo on the weight at each interaction, and as probability of a scattering


_PIECES = 4  # of a path below a wavy surface; tuned: more follow its depth closer and cost time
_NO_RASTER = np.zeros((2, 2))  # flat at z = 0, not read


class Medium(NamedTuple):
    """Optical properties of the water, with z up and still water at z = 0.

    Layers are tabulated on a uniform grid of depths below z = 0, bubbles on a uniform grid of
    depths below the level that `depth_mode` names. Rasters are heights z at the nodes
    (raster_x + i raster_step, raster_y + j raster_step).
    """

    a: float  # absorption of homogeneous water [m-1]
    b: float  # scattering of homogeneous water [m-1]
    n_water: float  # refractive indices
    n_air: float
    layered: bool  # whether the tables of layers replace a and b
    layer_step: float  # [m]
    layer_a: NDArray[np.float64]  # [m-1]
    layer_b: NDArray[np.float64]  # [m-1]
    layer_a_path: NDArray[np.float64]  # integral of a from z = 0 [1]
    layer_b_path: NDArray[np.float64]  # integral of b from z = 0 [1]
    depth_mode: int  # DepthMode
    bubble_start: float  # depth of the first node [m]
    bubble_step: float  # [m]
    bubble_b: NDArray[np.float64]  # b_bub, scattering by bubbles [m-1]
    bubble_path: NDArray[np.float64]  # integral of b_bub from the first node [1]
    b_max: float  # upper bound of b + b_bub, rate of tentative collisions [m-1]
    c_max: float  # the same of a + b + b_bub
    bottom_z: float  # -inf: none
    bottom_albedo: float
    absorption: int  # Absorption
    local_c: bool  # free paths with the coefficient at their start (paper, E6)
    phase_water: PhaseTables
    phase_bubble: PhaseTables
    raster_x: float = 0.0  # first node [m]
    raster_y: float = 0.0
    raster_step: float = 1.0  # [m]
    raster: NDArray[np.float64] = _NO_RASTER  # height of the topmost surface [m]
    overhangs: bool = False
    # under overhangs: height of the lowest surface, and of the middle of the air between it and the
    # underside of the jet [m]; elsewhere both are `raster`
    raster_low: NDArray[np.float64] = _NO_RASTER
    raster_split: NDArray[np.float64] = _NO_RASTER


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
def local_elevation(medium, p):
    """Return the elevation of the surface that the depth of a point is measured from.

    Array twin: scipy.interpolate.RegularGridInterpolator.
    Where the sea overhangs that is the lowest surface on the vertical for a point under the jet,
    and the topmost for a point in it.
    """
    # The middle of the air between them tells points under the jet from those in it.
    if medium.overhangs and p.z <= _on_raster(medium, medium.raster_split, p):
        return _on_raster(medium, medium.raster_low, p)
    return _on_raster(medium, medium.raster, p)


@inlined
def _on_raster(medium, r, p):
    """Return the bilinear interpolant of a raster at (p.x, p.y), constant outside."""
    nx, ny = r.shape
    # Just short of the last node, so that i + 1 and j + 1 exist.
    px = min(max((p.x - medium.raster_x) / medium.raster_step, 0.0), nx - 1.000001)
    py = min(max((p.y - medium.raster_y) / medium.raster_step, 0.0), ny - 1.000001)
    i, j = int(px), int(py)
    fx, fy = px - i, py - j
    return (1.0 - fx) * ((1.0 - fy) * r[i, j] + fy * r[i, j + 1]) + fx * (
        (1.0 - fy) * r[i + 1, j] + fy * r[i + 1, j + 1]
    )


@inlined
def bubble_scattering(medium, p):
    """Return b_bub [m-1] at a point.

    Array twin: `HallNovarini.b` of the depth below the chosen level.
    """
    if medium.depth_mode == DepthMode.NONE:
        return 0.0
    depth = -p.z
    if medium.depth_mode == DepthMode.LOCAL:
        depth = local_elevation(medium, p) - p.z
    # In crests above z = 0, CLAMPED takes the profile's value at the surface and does not
    # extrapolate; for LOCAL this removes the error of the raster next to the surface.
    if medium.depth_mode != DepthMode.MEAN_LEVEL:
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
    A table of the integral makes it exact at any slant; level paths take the local value.
    """
    if not medium.layered:
        return medium.a * length
    # Depth is linear in length, so that the mean over the depths is the mean along the path.
    return length * mean_between(medium.layer_a, medium.layer_a_path, medium.layer_step, -z0, -z1)


@inlined
def water_path(medium, z0, z1, length):
    """Return the integral of b of the water along a straight path from height z0 to z1.

    Array twin: see `absorption_path`.
    """
    if not medium.layered:
        return medium.b * length
    return length * mean_between(medium.layer_b, medium.layer_b_path, medium.layer_step, -z0, -z1)


@inlined
def scattering_path(medium, p, q, length):
    """Return the integral of b + b_bub along a straight path from p to q.

    Array twin: quadrature of `Water` and `HallNovarini.b` in the tests.
    Depths below a wavy surface are taken as linear over `_PIECES` parts of the path.
    """
    tau = water_path(medium, p.z, q.z, length)
    if medium.depth_mode == DepthMode.NONE:
        return tau
    table, path, step = medium.bubble_b, medium.bubble_path, medium.bubble_step
    if medium.depth_mode != DepthMode.LOCAL:
        shift = medium.bubble_start
        return tau + length * mean_between(table, path, step, -p.z - shift, -q.z - shift)
    # The depth below a wave is not linear along the path: trapezoids over a few pieces.
    before = local_elevation(medium, p) - p.z
    for i in range(1, _PIECES + 1):
        at = along(p, minus(q, p), i / _PIECES)
        depth = local_elevation(medium, at) - at.z
        tau += length / _PIECES * mean_between(table, path, step, before, depth)
        before = depth
    return tau


@inlined
def mean_between(table, path, step, d0, d1):
    """Return the mean of a tabulated coefficient between two depths.

    Array twin: quadrature of `Water` layers in the tests.
    """
    # The difference of the integrals would cancel; at 1e-7 m some nine of sixteen digits are left.
    if abs(d1 - d0) < 1e-7:
        return lookup(table, 0.5 * (d0 + d1) / step)
    return (_cumulative(table, path, step, d1) - _cumulative(table, path, step, d0)) / (d1 - d0)


@inlined
def _cumulative(table, path, step, depth):
    """Return the integral of a linearly interpolated table, constant outside, up to a depth."""
    # beyond both ends of the table the coefficient is that of its end
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
def sample_free_path(medium, p, u):
    """Return a tentative free path [m], exponential with the rate b_max or c_max.

    Array twin: -log(1 - u) / c.
    Delta tracking: a tentative collision is real with probability c(z) / c_max, which is exact
    for any profile; a homogeneous medium has no null collisions.
    """
    # Continuous absorption is a weight, and takes no part in free paths.
    rate = medium.b_max if medium.absorption == Absorption.CONTINUOUS else medium.c_max
    if medium.local_c:
        a, b = water_coefficients(medium, p.z)
        rate = b + bubble_scattering(medium, p)
        if medium.absorption != Absorption.CONTINUOUS:
            rate += a
    if rate <= 0.0:
        return math.inf
    return -math.log(1.0 - u) / rate


@inlined
def collide(medium, p, weight, u_kind, u_theta):
    """Return (s, weight, by_bubble) after a tentative collision at p.

    Array twin: `tests/statistical`, chi-square of the mixture.
    u_kind chooses the kind of the collision, u_theta the angle: s = sin^2(theta / 2), or s < 0 for
    an unchanged direction. A weight 0 is an absorbed photon (analog absorption).
    """
    a, b = water_coefficients(medium, p.z)
    b_bub = bubble_scattering(medium, p)
    scatter = b + b_bub
    mode = medium.absorption
    if mode == Absorption.CONTINUOUS:
        total, majorant = scatter, medium.b_max
    else:
        total, majorant = a + scatter, medium.c_max
    if medium.local_c:  # the paper knows no null collisions
        majorant = total
    # One uniform decides all: [0, b) water, [b, scatter) bubble, [scatter, total) absorption,
    # [total, majorant) null collision of delta tracking (Woodcock et al. 1965).
    pick = u_kind * majorant
    if pick >= total:
        return -1.0, weight, False
    if mode == Absorption.IMPLICIT or mode == Absorption.PAPER:
        weight *= scatter / total
    if mode == Absorption.IMPLICIT:
        # Implicit capture: every collision scatters, and [0, total) is compressed to [0, scatter).
        pick *= scatter / total
    elif pick >= scatter:
        # Absorption. In Algorithm 1 as published the photon goes on, with the weight of above (E5).
        return -1.0, 0.0 if mode == Absorption.ANALOG else weight, False
    if pick < b:
        return sample_s(medium.phase_water, u_theta), weight, False
    return sample_s(medium.phase_bubble, u_theta), weight, True


@inlined
def scattering_coefficients(medium, p):
    """Return (b, b_bub) [m-1] at a point.

    Array twin: `Water.b`, `HallNovarini.b`.
    """
    return water_coefficients(medium, p.z)[1], bubble_scattering(medium, p)


@inlined
def depth_between(medium, p, q, length):
    """Return the optical depth a + b + b_bub over a straight path of a length from p to q.

    Array twin: see `scattering_path`.
    """
    return absorption_path(medium, p.z, q.z, length) + scattering_path(medium, p, q, length)


@entry
def straight_depths(medium, start, ends, depths):
    """Write the optical depths (n,) of straight paths from a point to ends (n, 3).

    Array twin: see `scattering_path`.
    """
    for i in range(len(ends)):
        end = row(ends, i)
        depths[i] = depth_between(medium, start, end, norm(minus(end, start)))


@inlined
def is_uniform(medium):
    """Return whether the coefficients are the same everywhere.

    Array twin: none.
    """
    return not medium.layered and medium.depth_mode == DepthMode.NONE
