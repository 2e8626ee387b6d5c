"""Tests of the explorer need its extra: without it they are left out, where all is checked not."""

import os
from importlib.util import find_spec

import pytest

NEEDED = 'tests/explorer needs extra packages: pip install "meshtrace[explore]"'

collect_ignore_glob = []
if not all(find_spec(name) for name in ("trame", "trame_vtk", "trame_vuetify", "pyvista")):
    if os.environ.get("CI") == "true":
        raise pytest.UsageError(NEEDED)
    collect_ignore_glob = ["test_*.py"]


def pytest_report_header():
    """Say that tests are left out."""
    return NEEDED if collect_ignore_glob else None
