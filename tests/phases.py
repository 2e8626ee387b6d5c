"""Samples of phase functions by the kernel, and their names in tests."""

import numpy as np

from meshtrace.kernels import jit, medium


@jit.allocating_entry
def draw(tables, u):
    s = np.empty_like(u)
    for i in range(u.size):
        s[i] = medium.sample_s(tables, u[i])
    return s


def label(phase):
    return " ".join(str(x) for x in phase.model_dump().values() if np.isscalar(x))
