import subprocess
import sys

import pytest


@pytest.mark.process
def test_import_leaves_heavy_libraries_alone():
    code = (
        "import sys, meshtrace.surfaces\n"
        "print([m for m in ('xarray', 'trimesh', 'matplotlib', 'pyvista', 'scipy.spatial')"
        " if m in sys.modules])\n"
    )
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert run.stdout.strip() == "[]"
