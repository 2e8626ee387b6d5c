"""Tests that need extra packages: skipped without them, an error under CI."""

import os
from importlib.util import find_spec

import pytest


def lack_of(folder, extra, *packages):
    """Return a note if packages are missing, "" if all are installed."""
    if all(find_spec(name) for name in packages):
        return ""
    note = f'{folder} needs extra packages: pip install "meshtrace[{extra}]"'
    if os.environ.get("CI") == "true":
        raise pytest.UsageError(note)
    return note
