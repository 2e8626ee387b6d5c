"""Fixtures and options of all tests, the profiles of hypothesis, and the cache of kernels.

Kernels stay compiled between sessions, in a folder named by their digest: NUMBA_CACHE_DIR, or
that of the user. Properties are tested with 10 examples, under `.ci/run` with 30, `--long` with 100.
"""

from __future__ import annotations

import os
import re
import runpy
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from meshtrace import files

# Some tests replace MESHTRACE_CACHE_DIR, for tables.
os.environ.setdefault("NUMBA_CACHE_DIR", str(files.cache_directory()))

_profile = settings(derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
_EXAMPLES = 100 if os.environ.get("LONG") == "1" else 30 if os.environ.get("CI") else 10
settings.register_profile("meshtrace", _profile, max_examples=_EXAMPLES)
settings.load_profile("meshtrace")

# first, so that no worker is left with one of their files at the end
LONGEST = ("viz", "engine", "studies", "drills")

TESTS = Path(__file__).parent
GOLDEN = TESTS / "cli" / "golden"


def pytest_addoption(parser):
    parser.addoption(
        "--update-golden",
        action="store_true",
        help="replace the texts in tests/cli/golden, and the outputs on the pages of the guides",
    )
    parser.addoption(
        "--no-posix",
        action="store_true",
        help="run as on Windows, without fcntl, resource, forks and symbolic links",
    )


def pytest_configure(config):
    if config.getoption("--no-posix"):
        folder = TESTS / "no_posix"
        found = os.environ.get("PYTHONPATH")
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(folder), found)))
        runpy.run_path(str(folder / "sitecustomize.py"))


def pytest_collection_modifyitems(items, config):
    """Mark cases by cost and tests that use statistics; put the folders that take longest first."""
    named, found = set(), set()
    for item in items:
        for cost in ("slow", "thorough"):
            for mark in item.iter_markers(f"{cost}_but"):
                name = f"{item.path}::{item.originalname}"
                named |= {(name, case) for case in mark.args}
                found.add((name, item.callspec.id))
                if item.callspec.id not in mark.args:
                    item.add_marker(cost)
        if item.get_closest_marker("posix") and not hasattr(os, "fork"):
            item.add_marker(pytest.mark.skip(reason="uses what Windows lacks"))
        if any(name in vars(item.module) for name in ("z_test", "chi2_test", "sidak")):
            item.add_marker("statistical")
    chosen = config.getoption("lf", False) or any("[" in argument for argument in config.args)
    if named - found and not chosen:
        raise pytest.UsageError(f"slow_but, thorough_but: no such cases: {sorted(named - found)}")
    items.sort(key=lambda item: item.path.relative_to(TESTS).parts[0] not in LONGEST)


@pytest.fixture
def golden(request):
    """Return a function that compares a text with the one kept under a name.

    Numbers are compared only with numbers=True: other tests compare them with what Python returns.
    """

    def compare(name, text, numbers=False):
        path = GOLDEN / f"{name}.txt"
        if request.config.getoption("--update-golden"):
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")
        kept = path.read_text(encoding="utf-8")
        if not numbers:
            text, kept = plain(text), plain(kept)
        assert text == kept

    return compare


def plain(text):
    """Return a text without the values and the widths of its numbers."""
    number = r"(?<![\w.])[-+]?(\d[\d,]*\.?\d*(e[+-]?\d+)?|nan|inf)(?!\w)"
    return re.sub(r" *#", " #", re.sub(number, "#", text))


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


CALM = """
wind_speed = 0.0
receiver = { fov_deg = 30.0 }
daylight = { direct = 1.42, diffuse = 0.295 }
"""


@pytest.fixture(scope="session")
def calm_design(tmp_path_factory):
    """Return the design of a link over still water by day, made once by all processes of a run."""
    import meshtrace as mt

    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    file = folder / "calm_design.nc"
    if not file.exists():  # files are written atomically
        mt.design(mt.Scenario.from_toml(CALM), photons=128, realizations=8).save(file)
    return mt.Design.load(file)


@pytest.fixture(scope="session")
def calm_availability():
    """Return the availability of a link over still water whose absorption is uncertain."""
    import meshtrace as mt

    return mt.studies.availability(
        mt.Scenario.from_toml(CALM),
        {"water.a": {"distribution": "uniform", "loc": [0.1] * 11 + [0.2], "scale": 0.1}},
        threshold=2e-5, runs=8, realizations=4, photons=64,
    )  # fmt: skip


@pytest.fixture
def rng():
    """Return a generator of random numbers with a fixed seed."""
    import numpy as np

    return np.random.default_rng(1)


@pytest.fixture(scope="session")
def small_mesh():
    """Return a sinusoid of 0.1 m over |x|, |y| <= 6 m, in triangles of 0.5 m."""
    from meshtrace.surfaces import SinusoidalSea

    sea = SinusoidalSea(amplitude=0.1, wavelength=2.0, phase=0.4, direction_deg=30.0)
    return sea.mesh(extent=6.0, spacing=0.5)


@pytest.fixture(scope="session")
def medium(default_link):
    """Return the arrays of the default water without bubbles."""
    from meshtrace.engine.setup.arrays import medium_arrays

    return medium_arrays(default_link)


@pytest.fixture(scope="session")
def scene_of():
    """Return a function of link, mesh and normals that makes a `Scene`, as forced detection does."""
    from meshtrace.engine.forced import ForcedDetection

    def make(link, mesh, normals="vertex"):
        forced = ForcedDetection(link, 32, 1, normals, scattered="chains")
        return forced.planner.aim_over(mesh).scene(
            forced.arrays.emitters[0], forced.arrays.targets[0]
        )

    return make


@pytest.fixture(scope="session")
def scene(scene_of, small_mesh, default_link):
    """Return the scene of the default link over the small mesh."""
    return scene_of(default_link, small_mesh)
