"""A phase function over the logarithm of the angle, with its integral and the inverse of that."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.jit import inlined

SMALLEST_ANGLE = 1e-13  # [rad], first edge of the tables


class AngleTable(NamedTuple):
    """A phase function on cells of equal width in ln(theta), and its integral over theta.

    Parameters
    ----------
    log_first, per_log : float
        ln of the first edge, and cells per unit of ln(theta).
    edge : ndarray, shape (n + 1,)
        Edges [rad]; the last is pi. Below the first the value is that of the first cell.
    beta : ndarray, shape (n,)
        Mean of each cell over solid angle [sr-1].
    tail : ndarray, shape (n + 1,)
        Integral of beta dtheta from an edge to pi [rad sr-1].
    """

    log_first: float
    per_log: float
    edge: NDArray[np.float64]
    beta: NDArray[np.float64]
    tail: NDArray[np.float64]


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


@inlined
def tail_at(table, theta):
    """Return the integral of beta dtheta from an angle to pi.

    Array twin: quadrature of `PhaseFunction.pdf` in the tests.
    Summed from pi downwards, it keeps the digits of large angles in spite of the forward peak.
    """
    j = _cell(table, theta)
    return table.tail[j + 1] + table.beta[j] * (table.edge[j + 1] - theta)


@inlined
def angle_of_tail(table, low, high, value):
    """Return the angle between low and high whose tail is a value.

    Array twin: `tail_at`, of which it is the inverse.
    """
    i, j = _cell(table, low), _cell(table, high) + 1
    while j - i > 1:
        k = (i + j) // 2
        if table.tail[k] > value:
            i = k
        else:
            j = k
    theta = table.edge[j] - (value - table.tail[j]) / table.beta[i]
    return min(max(theta, low), high)
