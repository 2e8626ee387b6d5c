"""Fixtures that several folders share, and a cache of kernels that belongs to the session."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile

import pytest

# Every session compiles anew, as a new user does; its subprocesses and workers share what it has
# compiled. To keep the kernels between sessions, name a folder in MESHTRACE_TEST_CACHE.
if "MESHTRACE_TEST_CACHE" not in os.environ:
    os.environ["MESHTRACE_TEST_CACHE"] = tempfile.mkdtemp(prefix="meshtrace-tests-")
    atexit.register(shutil.rmtree, os.environ["MESHTRACE_TEST_CACHE"], ignore_errors=True)
os.environ["NUMBA_CACHE_DIR"] = os.environ["MESHTRACE_TEST_CACHE"]


@pytest.fixture(scope="session")
def flat_mesh():
    """Still water over |x|, |y| <= 20 m, in triangles of 1 m."""
    from meshtrace.surfaces import FlatSea

    return FlatSea().mesh(extent=20.0, spacing=1.0)


@pytest.fixture(scope="session")
def default_link():
    """Return the paper's default link, without bubbles."""
    import meshtrace as mt

    return mt.Link()
