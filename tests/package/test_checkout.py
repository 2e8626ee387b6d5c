"""Python started in a checkout, whose folder meshtrace/ hides an installed package."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.process

ROOT = Path(__file__).parents[2]
PARTS = ["meshtrace", "surfaces", "viz"]
CODE = (
    "from meshtrace.surfaces import JonswapSea; import meshtrace.viz.style, meshtrace as mt;"
    "print(mt.__file__, sys.modules['meshtrace.surfaces'].__file__, "
    "sys.modules['meshtrace.viz'].__file__)"
)


def copy(folders, target):
    ignored = shutil.ignore_patterns("__pycache__")
    for folder in folders:
        shutil.copytree(ROOT / folder, target / folder, ignore=ignored)


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """Copy what Python sees of a checkout."""
    target = tmp_path_factory.mktemp("checkout")
    copy(PARTS, target)
    shutil.copy(ROOT / "pyproject.toml", target)
    return target


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Lay the packages out as a wheel does."""
    target = tmp_path_factory.mktemp("site-packages")
    copy(["meshtrace"], target)
    copy(["surfaces", "viz"], target / "meshtrace")
    return target


def files_of(start, path):
    """Return where a fresh interpreter, started in a folder, finds the three packages."""
    # -S leaves out site-packages, and with it whatever is installed for these tests
    dependencies = [entry for entry in sys.path if entry.endswith("site-packages")]
    code = f"import sys; sys.path += {[*map(str, path), *dependencies]!r}; {CODE}"
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-S", "-c", code],
        cwd=start,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return [Path(file).parents[1] for file in done.stdout.split()]


def test_not_installed(checkout):
    assert files_of(checkout, []) == [checkout, checkout, checkout]


def test_installed_from_a_wheel(checkout, installed):
    assert files_of(checkout, [installed]) == [checkout, checkout, checkout]


def test_a_wheel_alone(tmp_path, installed):
    found = files_of(tmp_path, [installed])
    assert found == [installed, installed / "meshtrace", installed / "meshtrace"]


def test_installed_in_place():
    """The packages that these tests import, from the checkout itself."""
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; {CODE}"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert [Path(file).parents[1] for file in done.stdout.split()] == [ROOT] * 3, done.stderr
