"""Compiled functions that all tracers share: vectors, random numbers, medium, facets, scene.

"Array twin" in the docstring of a kernel names the plain or independent code that it is checked
against, mostly in the tests; "Why so" gives the reason for a kernel that is less plain than its
twin.
"""

import os
import warnings
from typing import Any

from meshtrace.errors import Refused


def _import_numba() -> None:
    """Import numba, and shorten its errors and warnings about the environment.

    Raises
    ------
    Refused
        If NUMBA_NUM_THREADS is no whole number of one or more, with which numba does not start.
    """
    threads = os.environ.get("NUMBA_NUM_THREADS", "1")
    if not (threads.strip().isdecimal() and int(threads) >= 1):
        raise Refused("NUMBA_NUM_THREADS", threads, "a whole number >= 1, or unset")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        from numba.core import config
    for warning in caught:
        # numba falls back to its default; its message has a traceback after the first line
        warnings.warn(str(warning.message).partition("\n")[0], warning.category, stacklevel=3)
    # At each compilation numba reads its settings from a file of the working directory. Another
    # user may have written it, to name a cache folder with kernels of that user.
    settings: Any = config
    settings._config_fname = os.devnull
    settings.reload_config()


_import_numba()
