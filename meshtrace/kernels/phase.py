"""Phase functions: sampling of scattering angles, and tables over the angle.

For sampling every phase function is one mixture of tabulated components. The angle is carried as
``s = sin^2(theta / 2)``: ``cos(theta) = 1 - 2 s`` and ``sin(theta) = 2 sqrt(s (1 - s))`` then keep
all digits at small angles, where most of the light of sea water goes. Tables are cells of the
logarithm of the angle, with the integral of the function and the inverse of that.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.jit import ZERO, inlined


class Component(IntEnum):
    """Kinds of components of a phase function."""

    HENYEY_GREENSTEIN = 0
    RAYLEIGH = 1
    QUANTILES = 2
    BINS = 3


ROW = 4
"""Number of values in one row of a `BINS` component."""


class PhaseTables(NamedTuple):
    """Phase function as arrays of one type, for a single compilation of the kernels.

    Parameters
    ----------
    kind : ndarray of int64, shape (n,)
        `Component` code of each component.
    param : ndarray of float64, shape (n, 4)
        `HENYEY_GREENSTEIN`: g. `RAYLEIGH`: gamma. `QUANTILES`: number of intervals N, number of
        intervals k0 that are stored as a power of s, exponent e of these. `BINS`: number of bins.
    cum_weight : ndarray of float64, shape (n,)
        Cumulative weight of the components; the last one is 1.
    start : ndarray of int64, shape (n + 1,)
        Index of the first node of each component.
    nodes : ndarray of float64
        `QUANTILES`: s^(1/e) at u = 0 ... k0/N, then s at u = k0/N ... 1.
        `BINS`: rows (F, s_hi, ratio, e); F is the CDF at the lower edge, s_hi the upper edge, and
        inside the bin s = s_hi (ratio + r (1 - ratio))^e, where r runs from 0 to 1; for e = 0,
        s = s_hi exp((r - 1) ratio). A last row holds F = 1.
    guide_start : ndarray of int64, shape (n + 1,)
        Index of the first entry of each component's guide table.
    guide : ndarray of int64
        `BINS`: the bin that holds u = j / (length of the guide table), for every j.
    """

    kind: NDArray[np.int64]
    param: NDArray[np.float64]
    cum_weight: NDArray[np.float64]
    start: NDArray[np.int64]
    nodes: NDArray[np.float64]
    guide_start: NDArray[np.int64]
    guide: NDArray[np.int64]


@inlined
def _henyey_greenstein_s(g: float, u: float) -> float:
    """Invert the Henyey-Greenstein CDF.

    Array twin: `meshtrace.optics.phase.HenyeyGreenstein.sample`.
    Written in s the inversion is rational and has no singularity at g = 0.
    """
    d = 1.0 + g - 2.0 * g * u
    return (1.0 - g) * (1.0 - g) * u * (1.0 + g - g * u) / (d * d)


@inlined
def _rayleigh_s(gamma: float, u: float) -> float:
    """Invert the CDF of 1 + gamma cos^2.

    Array twin: `meshtrace.optics.phase.Rayleigh.sample`.
    The cubic c + gamma c^3 / 3 = A has the one real root (e - 1/e) / sqrt(gamma).
    """
    root = np.sqrt(gamma)
    x = 1.5 * root * (1.0 + gamma / 3.0) * abs(1.0 - 2.0 * u)
    e = (x + np.sqrt(x * x + 1.0)) ** (1.0 / 3.0)
    cos_theta = min((e - 1.0 / e) / root, 1.0)
    return 0.5 * (1.0 - cos_theta) if u < 0.5 else 0.5 * (1.0 + cos_theta)


@inlined
def _quantile_s(tables: PhaseTables, j: int, u: float) -> float:
    """Interpolate the quantiles of component j on their uniform grid of u.

    Array twin: `meshtrace.optics.phase.FournierForand.sample`.
    Only the first k0 intervals, where s is a power of u, pay for a power.
    """
    x = u * tables.param[j, 0]
    k0 = tables.param[j, 1]
    i = min(int(x), int(tables.param[j, 0]) - 1)
    first = tables.start[j] + i
    if x < k0:
        y = tables.nodes[first]
        return (y + (x - i) * (tables.nodes[first + 1] - y)) ** tables.param[j, 2]
    s = tables.nodes[first + 1]
    return s + (x - i) * (tables.nodes[first + 2] - s)


@inlined
def _bin_s(tables: PhaseTables, j: int, u: float) -> float:
    """Find the bin of component j that holds u by its guide table and invert the CDF inside it.

    Array twin: `meshtrace.optics.phase.HistogramPhase.sample`.
    The guide makes the search O(1); the order of u is kept, unlike by an alias table.
    """
    size = tables.guide_start[j + 1] - tables.guide_start[j]
    last = int(tables.param[j, 0]) - 1
    i = tables.guide[tables.guide_start[j] + min(int(u * size), size - 1)]
    row = tables.start[j] + ROW * i
    while i < last and tables.nodes[row + ROW] <= u:
        i += 1
        row += ROW
    low = tables.nodes[row]
    s_hi = tables.nodes[row + 1]
    ratio = tables.nodes[row + 2]
    exponent = tables.nodes[row + 3]
    r = (u - low) / (tables.nodes[row + ROW] - low)
    if exponent == 1.0:
        return s_hi * (ratio + r * (1.0 - ratio))
    if exponent == 0.0:
        return s_hi * np.exp((r - 1.0) * ratio)
    return s_hi * (ratio + r * (1.0 - ratio)) ** exponent


@inlined
def _component_s(tables: PhaseTables, j: int, u: float) -> float:
    """Sample component j.

    Array twin: `meshtrace.optics.phase.PhaseFunction.sample`.
    The most frequent kind is tested first.
    """
    kind = tables.kind[j]
    if kind == Component.QUANTILES:
        return _quantile_s(tables, j, u)
    if kind == Component.HENYEY_GREENSTEIN:
        return _henyey_greenstein_s(tables.param[j, 0], u)
    if kind == Component.BINS:
        return _bin_s(tables, j, u)
    return _rayleigh_s(tables.param[j, 0], u)


@inlined
def sample_s(tables: PhaseTables, u: float) -> float:
    """Return s = sin^2(theta / 2) of a scattering angle for one uniform u in [0, 1).

    Array twin: `meshtrace.optics.phase.PhaseFunction.sample`.
    One u picks the component and is then stretched to [0, 1), so a photon uses one draw per event.
    """
    if len(tables.kind) == 1:
        return min(_component_s(tables, ZERO, u), 1.0)
    j = 0
    low = 0.0
    while j < len(tables.kind) - 1 and u >= tables.cum_weight[j]:
        low = tables.cum_weight[j]
        j += 1
    stretched = min((u - low) / (tables.cum_weight[j] - low), 1.0)
    return min(_component_s(tables, j, stretched), 1.0)


SMALLEST_ANGLE = 1e-13  # [rad], first edge of the tables


class AngleTable(NamedTuple):
    """A phase function on cells of equal width in ln(theta).

    Parameters
    ----------
    log_first, per_log : float
        ln of the first edge, and cells per unit of ln(theta).
    edge : ndarray, shape (n + 1,)
        Edges [rad]; the last is pi. Below the first the value is that of the first cell.
    beta : ndarray, shape (n,)
        Mean of each cell over solid angle [sr-1].
    """

    log_first: float
    per_log: float
    edge: NDArray[np.float64]
    beta: NDArray[np.float64]


@inlined
def _cell(table, theta):
    if theta <= table.edge[0]:
        return 0
    j = int((math.log(theta) - table.log_first) * table.per_log)
    return min(max(j, 0), len(table.beta) - 1)


@inlined
def phase_at(table, theta):
    """Return the phase function [sr-1] at an angle.

    Array twin: `PhaseFunction.pdf`, averaged over cells.
    """
    return table.beta[_cell(table, theta)]
