"""Types of all rooms reach the code of a user, with the settings of the project."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LINES = """
from meshtrace.surfaces import FlatSea
from meshtrace.viz import SceneStyle

x: int = FlatSea(height="a").nonsense
y: int = SceneStyle().nonsense
"""


@pytest.mark.process
@pytest.mark.thorough
def test_wrong_names_of_the_linked_rooms_are_found(tmp_path):
    pytest.importorskip("mypy")
    (tmp_path / "use.py").write_text(LINES)
    done = subprocess.run(
        [sys.executable, "-m", "mypy", str(tmp_path / "use.py")],
        cwd=ROOT,
        env={**os.environ, "MYPYPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=600,
    )
    for name in ("FlatSea", "SceneStyle"):
        assert f'"{name}" has no attribute "nonsense"' in done.stdout, done.stdout + done.stderr
