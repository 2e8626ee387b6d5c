"""Sums of other wavelengths: none of their code where there is one wavelength."""

import numpy as np
from numba import typeof, types

from meshtrace.kernels import jit
from meshtrace.kernels.tints import (
    NO_TINTS,
    copy_tint,
    is_tinted,
    reset_tint,
    tint_scattering,
    tint_way,
)


@jit.allocating_entry
def all_steps(tints, sums, out):
    reset_tint(tints, sums)
    tint_way(tints, sums, -2.0, -1.0, 1.0)
    tint_scattering(tints, sums, -1.0, 0.1, False)
    copy_tint(tints, sums, out)
    return is_tinted(tints)


def test_one_wavelength_has_kernels_without_sums():
    assert isinstance(typeof(NO_TINTS), types.NoneType)
    sums, out = np.full(8, 3.0), np.full(8, 4.0)
    assert not all_steps(NO_TINTS, sums, out)
    assert (sums == 3.0).all()
    assert (out == 4.0).all()
