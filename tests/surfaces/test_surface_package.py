import doctest
import importlib
import pkgutil
import subprocess
import sys

import pytest

import meshtrace.surfaces

MODULES = sorted(m.name for m in pkgutil.iter_modules(meshtrace.surfaces.__path__))


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_docstrings(name):
    result = doctest.testmod(importlib.import_module(f"meshtrace.surfaces.{name}"))
    assert result.failed == 0


def test_public_names_exist():
    for name in meshtrace.surfaces.__all__:
        assert hasattr(meshtrace.surfaces, name)


@pytest.mark.process
def test_import_leaves_heavy_libraries_alone():
    code = (
        "import sys, meshtrace.surfaces\n"
        "print([m for m in ('xarray', 'trimesh', 'matplotlib', 'pyvista', 'scipy.spatial')"
        " if m in sys.modules])\n"
    )
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert run.stdout.strip() == "[]"
