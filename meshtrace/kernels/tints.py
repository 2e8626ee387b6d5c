"""Weights of one path at other wavelengths, as logarithms of their ratios to its own weight.

The geometry of a path does not depend on absorption, scattering and phase function: at another
wavelength j its weight is

    ln(w_j / w) = sum_k ln(b_j p_j / b p)(z_k, theta_k) - int (c_j - c)(z) dl

over its scatterings k and its way through the water. The functions of all wavelengths are
combinations of few common ones, which a path sums up.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.jit import inlined, outlined
from meshtrace.kernels.medium import lookup, mean_between
from meshtrace.kernels.phase import SMALLEST_ANGLE

TINTS = 8
"""Common functions that a photon sums up at most."""


class Tints(NamedTuple):
    """Common functions of the wavelengths, one row each.

    Those of the depth are tables on a uniform grid below z = 0, of two nodes in uniform water,
    those of the scattering angle on equal cells of its logarithm, or one for equal functions.
    """

    step: float  # [m]
    c: NDArray[np.float64]  # (tints, nodes) attenuation [m-1]
    c_path: NDArray[np.float64]  # its integral from z = 0
    b: NDArray[np.float64]  # (tints, nodes) logarithm of the scattering coefficient
    phase: NDArray[np.float64]  # (tints, cells) logarithm of the phase function
    bubble_c: NDArray[np.float64]  # (tints,) attenuation by bubbles, over their own
    bubble: NDArray[np.float64]  # (tints, cells) logarithm of b p of the bubbles
    log_first: float
    per_log: float


NO_TINTS = None
"""Paths of one wavelength: a type of its own, for which kernels are compiled without any sums."""


@inlined
def reset_tint(tints, tint):
    """Start the sums of a path.

    Array twin: `tint[:] = 0`.
    """
    if tints is not None:
        for r in range(len(tints.c)):
            tint[r] = 0.0


@inlined
def copy_tint(tints, tint, out):
    """Write the sums of a path.

    Array twin: `out[:] = tint`.
    """
    if tints is not None:
        for r in range(len(tints.c)):
            out[r] = tint[r]


@inlined
def tint_way(tints, tint, z0, z1, length):
    """Add a straight way through the water from height z0 to z1.

    Array twin: direct runs of the wavelengths.
    """
    if tints is not None:
        _add_way(tints, tint, z0, z1, length)


@outlined
def _add_way(tints, tint, z0, z1, length):
    """Add a way, see `tint_way`."""
    if tints.c.shape[1] == 2:  # a uniform water
        for r in range(len(tints.c)):
            tint[r] -= length * tints.c[r, 0]
        return
    for r in range(len(tints.c)):
        tint[r] -= length * mean_between(tints.c[r], tints.c_path[r], tints.step, -z0, -z1)


@inlined
def tint_cell(tints, theta):
    """Return the cell of a scattering angle.

    Array twin: numpy.searchsorted in the edges.
    """
    if tints.phase.shape[1] == 1:
        return 0
    j = int((math.log(max(theta, SMALLEST_ANGLE)) - tints.log_first) * tints.per_log)
    return min(max(j, 0), tints.phase.shape[1] - 1)


@inlined
def tint_scattering(tints, tint, z, theta, by_bubble):
    """Add a scattering by the water at height z, or by a bubble.

    Array twin: direct runs of the wavelengths.
    """
    if tints is not None:
        _add_scattering(tints, tint, z, theta, by_bubble)


@outlined
def _add_scattering(tints, tint, z, theta, by_bubble):
    """Add a scattering, see `tint_scattering`."""
    j = tint_cell(tints, theta)
    for r in range(len(tints.c)):
        if by_bubble:
            tint[r] += tints.bubble[r, j]
        else:
            tint[r] += lookup(tints.b[r], -z / tints.step) + tints.phase[r, j]


@inlined
def is_tinted(tints):
    """Return whether paths sum up functions, which ask for scattering angles.

    Array twin: none.
    """
    return tints is not None
