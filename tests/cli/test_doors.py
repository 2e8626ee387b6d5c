"""Processes of Python started in the folder of a stranger run none of its modules."""

import asyncio
import os
import subprocess
import sys
from pathlib import Path

import pytest

import meshtrace as mt
from meshtrace import parallel
from meshtrace.apps.explorer import stages
from meshtrace.cli import console
from meshtrace.errors import Refused
from meshtrace.scenario import Scenario

pytestmark = pytest.mark.process

PACKAGE = Path(mt.__file__).parent
NAMES = (
    "meshtrace", "numpy", "numba", "scipy", "typer", "sitecustomize", "usercustomize",
    "multiprocessing", "distributed", "pickle", "tempfile", "json", "asyncio", "socket",
)  # fmt: skip


@pytest.fixture
def hostile(tmp_path, monkeypatch):
    """Enter a folder whose modules write their names to a file, which must not appear."""
    folder, ran = tmp_path / "stranger", tmp_path / "ran"
    folder.mkdir()
    for name in NAMES:
        text = f"with open({str(ran)!r}, 'a') as file: file.write(__name__ + ' ')\n"
        (folder / f"{name}.py").write_text(text)
    monkeypatch.chdir(folder)
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    probe = subprocess.run([sys.executable, "-c", "import numpy"], cwd=folder)
    assert probe.returncode == 0
    assert ran.read_text() == "numpy "  # as of any Python that starts there
    ran.unlink()
    yield folder
    assert not ran.exists(), ran.read_text()


def ahead(monkeypatch, toml, trust=False):
    """Return the exit code of the process that compiles for a link file."""
    started, popen = [], subprocess.Popen
    monkeypatch.setattr(
        console.subprocess, "Popen", lambda *a, **k: started.append(popen(*a, **k)) or started[-1]
    )
    with console.compiling_ahead(Scenario.from_toml(toml, trust=trust)):
        return started[0].wait(timeout=300)


STILL = '[sea]\nspectrum = "flat"\n'


@pytest.mark.thorough
def test_the_process_that_compiles_ahead(hostile, monkeypatch):
    assert ahead(monkeypatch, STILL) == 0


@pytest.mark.thorough
def test_trusted_modules_of_the_working_directory_are_found_by_it(tmp_path, monkeypatch):
    """They are imported by name, as ever."""
    (tmp_path / "doorphase.py").write_text(
        "import os, numpy as np, meshtrace as mt\n"
        f"os.mkdir({str(tmp_path / 'ran')!r} + str(os.getpid()))\n"
        "class Own(mt.PhaseFunction):\n"
        "    def density(self, theta):\n"
        "        return np.exp(-theta)\n"
    )
    monkeypatch.chdir(tmp_path)
    link = f'[water.phase]\nkind = "doorphase:Own"\n{STILL}'
    assert ahead(monkeypatch, link, trust=True) == 0
    assert len(list(tmp_path.glob("ran*"))) == 2  # this process and that


@pytest.mark.thorough
def test_the_process_that_designs(hostile, monkeypatch):
    """Also where this process was started by `python -m`, which puts the folder first."""
    monkeypatch.syspath_prepend(hostile)
    link = mt.Link(receiver=mt.WaterReceiver(depth=5.0))
    under = Scenario.from_toml("wind_speed = 0.0").replace(link=link)
    with pytest.raises(Refused, match="ends on one side"):
        asyncio.run(stages.design_of(under))


WORKERS = """
import os, sys, time
from meshtrace.studies.cluster import Cluster
def setup():
    def job(i):
        time.sleep(0.2)
        return os.getpid()
    return job
if __name__ == "__main__":
    pids = set()
    for _, pid in Cluster(2).map(setup, range(1000)):
        pids.add(pid)
        if len(pids) == 2:
            break
    print(len(pids))
"""


@pytest.mark.thorough
def test_the_workers_of_a_study(hostile, tmp_path):
    """As of a console script, whose own folder comes first in place of the working directory."""
    pytest.importorskip("distributed")
    script = tmp_path / "script.py"
    script.write_text(WORKERS)
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120)
    assert done.stdout == "2\n", done.stderr


def test_the_environment_is_as_before_behind_workers(monkeypatch):
    for before in (None, "", "1"):
        monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
        if before is not None:
            monkeypatch.setenv("PYTHONSAFEPATH", before)
        with parallel.safe_processes():
            assert os.environ["PYTHONSAFEPATH"] == "1"
        assert os.environ.get("PYTHONSAFEPATH") == before


def test_the_console_script(hostile):
    script = Path(sys.executable).with_name("meshtrace")
    if not script.exists():
        pytest.skip("not installed beside this Python")
    done = subprocess.run([script, "--version"], capture_output=True, text=True, timeout=60)
    assert done.stdout.startswith("meshtrace "), done.stderr


def test_python_with_its_option(hostile):
    """Without -P, `python -m` runs what lies in the working directory before any of this code."""
    command = [sys.executable, "-P", "-m", "meshtrace", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.stdout.startswith("meshtrace "), done.stderr


def test_one_function_starts_python():
    files = [f for f in PACKAGE.rglob("*.py") if f.name != "parallel.py"]
    for text in (f.read_text(encoding="utf-8") for f in files):
        assert "sys.executable" not in text
        assert "multiprocessing" not in text or "spawn" not in text
        starts = text.count("distributed.LocalCluster(")
        assert starts == 0 or "safe_processes()," in text
