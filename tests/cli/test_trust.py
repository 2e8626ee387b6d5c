"""Files that name modules: none is run without trust, none by a result at all."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import command_line
import pytest

pytestmark = pytest.mark.process

MODULE = """
import pathlib
pathlib.Path("ran").touch()
import numpy as np
import meshtrace as mt
class Own(mt.PhaseFunction):
    def density(self, theta):
        return np.exp(-theta)
"""
LINK = '[water.phase]\nkind = "ownphase:Own"\n[sea]\nspectrum = "flat"\n[run]\nphotons = 64\n'
COMMANDS = {
    "run": ["run", "link.toml"],
    "new": ["new", "link.toml"],
    "view": ["view", "link.toml", "--export", "folder"],
    "explore": ["explore", "link.toml", "--no-browser"],
    "series": ["series", "link.toml", "--times", "0,1"],
    "ber": ["ber", "link.toml", "-n", "2"],
    "coverage": ["coverage", "link.toml"],
    "compare": ["compare", "link.toml", "other.toml"],
    "set": ["run", "--set", "water.phase.kind=ownphase:Own"],
    "sweep": ["sweep", "study.toml"],
    "swept": ["sweep", "swept.toml"],
}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "ownphase.py").write_text(MODULE)
    (tmp_path / "link.toml").write_text(LINK)
    (tmp_path / "other.toml").write_text(LINK)
    sweep = "[sweep]\nrtol = 0.5\n[sweep.parameters]\n"
    (tmp_path / "study.toml").write_text(f"{LINK}{sweep}wind_speed = [0.0]\n")
    kinds = '"water.phase" = ["petzold", { kind = "ownphase:Own" }]\n'
    flat = LINK[LINK.index("[sea]") :]
    (tmp_path / "swept.toml").write_text(f"{flat}{sweep}{kinds}")
    return tmp_path


def meshtrace(folder, *words):
    command = [sys.executable, "-m", "meshtrace", *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300)


@pytest.fixture
def here(folder, monkeypatch):
    """Enter the folder, whose module this process can import as a process of its own does."""
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(folder)
    assert Path(find_spec("ownphase").origin) == folder / "ownphase.py"
    yield folder
    assert not (folder / "ran").exists()


APART = ("run", "explore", "swept")  # for all; a server; workers


@pytest.mark.thorough
@pytest.mark.parametrize("name", [name for name in COMMANDS if name not in APART])
@pytest.mark.slow_but("view", "sweep", "set")
def test_no_command_runs_a_module_in_this_process(name, here):
    if name == "sweep":
        pytest.importorskip("distributed")
    line = command_line.refusal(*COMMANDS[name])
    assert f"would run {here}/ownphase.py: a link file may, with --trust" in line


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[] if n == "run" else pytest.mark.thorough) for n in APART]
)
@pytest.mark.slow_but("run", "explore")
def test_no_command_runs_a_module_that_a_file_names(name, folder):
    """Each once ran `ownphase.py` beside the link file."""
    if name == "swept":
        pytest.importorskip("distributed")
    done = meshtrace(folder, *COMMANDS[name])
    assert not (folder / "ran").exists()
    if name == "swept":  # a point with a value that is not allowed fails alone
        assert done.returncode == 1
    else:
        assert done.returncode == 2
        (line,) = done.stderr.splitlines()
        assert f"would run {folder}/ownphase.py: a link file may, with --trust" in line


@pytest.mark.thorough
def test_trusted_files_run_their_modules_and_results_never(here):
    done = meshtrace(here, "run", "link.toml", "--trust", "--json", "-o", "result.nc")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["gain"]
    (here / "ran").unlink()
    line = command_line.refusal("view", "result.nc", "--export", "a")
    assert line.startswith("result.nc: water.phase.kind")
    assert command_line.meshtrace("plot", "result.nc").exit_code == 0
    line = command_line.refusal("view", "result.nc", "--trust")
    assert line == "--trust: true, allowed: with a link file"


@pytest.mark.slow
def test_trusted_sweeps_import_in_their_workers(folder):
    pytest.importorskip("distributed")
    for study in ("study.toml", "swept.toml"):
        done = meshtrace(folder, "sweep", study, "--trust", "--workers", "1")
        assert done.returncode == 0, done.stderr
