"""How kernels are compiled, and why passing tuples of arrays costs nothing here.

numba counts references: every array in every argument of every call is counted up and down
with atomic instructions. A photon makes some twenty calls with some forty arrays: counting
them took 4.8 microseconds, all of the physics takes 0.2. Kernels make no arrays, the caller
holds those it passes, so the counting is switched off (`_nrt`) and hot functions are inlined.
Functions below the entry points are never called from Python and need no wrappers for it,
which saves a third of the compile time.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from numba import njit

# numba's own stubs do not know the last two options and `_nrt`
_bare: dict[str, Any] = {
    "_nrt": False,
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}

_entry: dict[str, Any] = {"cache": True, "nogil": True, "_nrt": False}


@cache
def sources() -> bytes:
    """Return a digest of all kernels."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.digest()


def entry(function: Callable[..., Any]) -> Any:
    """Decorate a function that Python calls: cached on disk, without the GIL.

    numba asks only whether the file of this function has changed, and would go on with what it
    compiled of kernels that the file imports: the stamp on the cache is that of all kernels.
    """
    compiled = njit(**_entry)(function)
    if compiled is not function:  # as it is under NUMBA_DISABLE_JIT, for debuggers
        compiled._cache._cache_file._source_stamp = sources()
    return compiled


inlined: Any = njit(forceinline=True, **_bare)
"""Decorator of hot functions; they must not make arrays."""

outlined: Any = njit(**_bare)
"""Decorator of functions that few photons reach: kept out of the hot code."""
