"""Tests of the explorer need an extra: without it they are skipped."""

from extras import lack_of

NOTE = lack_of("tests/apps/explorer", "explore", "trame", "pyvista")
collect_ignore_glob = ["test_*.py"] if NOTE else []


def pytest_report_header():
    return NOTE or None
