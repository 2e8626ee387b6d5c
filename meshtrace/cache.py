"""Cache folder of a user: compiled kernels and Mie tables."""

from __future__ import annotations

import os
from pathlib import Path


def cache_directory() -> Path:
    """Return MESHTRACE_CACHE_DIR, or the user's cache folder.

    Returns
    -------
    Path
        For a user without a home folder a path under the null device, where nothing can be
        written: callers warn as for any other folder that is not writable.
    """
    chosen = os.environ.get("MESHTRACE_CACHE_DIR")
    if chosen:
        return Path(chosen).absolute()
    import platformdirs

    try:
        folder = Path(platformdirs.user_cache_dir("meshtrace", appauthor=False))
    except RuntimeError:  # platformdirs 4.4 and later
        folder = Path()
    return folder if folder.is_absolute() else Path(os.devnull, "meshtrace")
