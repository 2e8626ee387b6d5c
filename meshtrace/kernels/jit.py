"""How kernels are compiled, and why passing tuples of arrays costs nothing here.

numba counts references: every array in every argument of every call is counted up and down
with atomic instructions. A photon makes some twenty calls with some forty arrays: counting
them took 4.8 microseconds, all of the physics takes 0.2. Kernels make no arrays, the caller
holds those it passes, so the counting is switched off (`_nrt`) and hot functions are inlined.
Functions below the entry points are never called from Python and need no wrappers for it,
which saves a third of the compile time.
"""

from __future__ import annotations

from typing import Any

from numba import njit

# numba's own stubs do not know the last two options and `_nrt`
_bare: dict[str, Any] = {
    "_nrt": False,
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}

_entry: dict[str, Any] = {"cache": True, "nogil": True, "_nrt": False}

entry: Any = njit(**_entry)
"""Decorator of functions called from Python: cached on disk, without the GIL."""

inlined: Any = njit(forceinline=True, **_bare)
"""Decorator of hot functions; they must not make arrays."""

outlined: Any = njit(**_bare)
"""Decorator of functions that few photons reach: kept out of the hot code."""
