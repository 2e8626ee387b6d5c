"""What all tracers share as compiled functions: vectors, random numbers, medium, facets, scene."""

import os
import warnings
from typing import Any

from meshtrace.errors import Refused


def _import_numba() -> None:
    """Import numba, whose complaints about its environment are tracebacks.

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
        # numba falls back to its default; behind the first line stands the traceback of its parser
        warnings.warn(str(warning.message).partition("\n")[0], warning.category, stacklevel=3)
    # numba reads a file of the working directory, too, at each compilation: in the folder of a
    # stranger it could name a cache folder whose kernels are the stranger's
    settings: Any = config
    settings._config_fname = os.devnull
    settings.reload_config()


_import_numba()
