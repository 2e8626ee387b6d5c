"""Tests of pictures need an extra: without it they are skipped."""

import pytest
from extras import lack_of

NOTE = lack_of("tests/viz", "viz", "matplotlib", "pyvista", "trame_client", "imageio")
collect_ignore_glob = ["test_*.py"] if NOTE else []


def pytest_report_header():
    return NOTE or None


@pytest.fixture(autouse=True)
def _close_figures():
    yield
    from matplotlib import pyplot

    pyplot.close("all")
