"""Phase functions tabulated for the kernels of adjoint paths."""

import math
from functools import lru_cache

import numpy as np

from meshtrace.kernels.phase import SMALLEST_ANGLE, AngleTable
from meshtrace.optics.phase import PhaseFunction

_CELLS_PER_LOG = 200.0


@lru_cache(maxsize=32)
def angle_table(phase: PhaseFunction) -> AngleTable:
    """Tabulate a phase function and its integral over the scattering angle.

    Parameters
    ----------
    phase : PhaseFunction
        The phase function.

    Notes
    -----
    A cell holds the mean over its solid angle by 4 Gauss points in theta; cells are 0.5 % wide.
    """
    log_first = math.log(SMALLEST_ANGLE)
    cells = math.ceil((math.log(math.pi) - log_first) * _CELLS_PER_LOG)
    per_log = cells / (math.log(math.pi) - log_first)
    edge = np.exp(log_first + np.arange(cells + 1) / per_log)
    edge[-1] = math.pi
    node, weight = np.polynomial.legendre.leggauss(4)
    half = 0.5 * np.diff(edge)[:, None]
    theta = edge[:-1, None] + half * (1.0 + node)
    solid = weight * np.sin(theta)
    beta = (phase.pdf(theta) * solid).sum(axis=1) / solid.sum(axis=1)
    parts = beta * np.diff(edge)
    tail = np.append(np.cumsum(parts[::-1])[::-1], 0.0)
    return AngleTable(log_first, per_log, edge, beta, tail)
