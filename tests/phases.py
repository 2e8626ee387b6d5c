"""Samples of phase functions by the kernel, and their names in tests."""

import numba
import numpy as np

from meshtrace.kernels.phase import sample_s


@numba.njit
def draw(tables, u):
    s = np.empty_like(u)
    for i in range(u.size):
        s[i] = sample_s(tables, u[i])
    return s


def label(phase):
    return " ".join(str(x) for x in phase.model_dump().values() if np.isscalar(x))
