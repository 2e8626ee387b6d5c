"""Tests of pictures need an extra: without it they are skipped."""

import pytest
from extras import lack_of

NOTE = lack_of("tests/viz", "viz", "matplotlib", "pyvista", "trame_client", "imageio")
collect_ignore_glob = ["test_*.py"] if NOTE else []


def pytest_report_header():
    return NOTE or None


@pytest.fixture(autouse=True)
def _look_at_figures():
    """No figure that a test leaves open has a fault that its artists show; then they are closed."""
    yield
    from looks import faults
    from matplotlib import pyplot

    found = [faults(pyplot.figure(number)) for number in pyplot.get_fignums()]
    pyplot.close("all")
    assert not any(found), found
