"""Outputs of the commands: refused before the work, printed before they are written."""

import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr
from typer.testing import CliRunner

from meshtrace import cli
from meshtrace.results import load


def meshtrace(*arguments):
    return CliRunner().invoke(cli.app, [str(word) for word in arguments])


@pytest.mark.parametrize(
    "command",
    [
        ["run"],
        ["series", "--times", "0,1"],
        ["ensemble", "-n", "2"],
        ["ber"],
        ["converge"],
    ],
    ids=lambda command: command[0],
)
def test_outputs_are_refused_before_the_work(tmp_path, monkeypatch, command):
    (tmp_path / "link.toml").write_text("")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "fifo")
    else:
        (tmp_path / "fifo").mkdir()
    # any work would build a sea
    monkeypatch.setattr("meshtrace.scenario.Scenario.mesh", None)
    monkeypatch.setattr("meshtrace.scenario.Scenario.simulate", None)
    for name in ("link.toml", "fifo", ".", "none/a.nc", "x" * 300, os.devnull):
        done = meshtrace(*command, tmp_path / "link.toml", "--output", tmp_path / name)
        assert done.exit_code == 2
        assert done.stdout == ""
        assert done.stderr.startswith("error: --output: ")
        assert done.stderr.count("\n") == 1
    assert (tmp_path / "link.toml").read_text() == ""


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (["run", "-o", "a.toml"], "--output"),  # no input, but a link file
        (["run", "-o", "new.TOML"], "--output"),
        (["run", "sea.toml", "-o", "swell.nc"], "--output"),
        (["run", "sea.toml", "-o", "../FOLDER/swell.nc"], "--output"),
        (["compare", "a.toml", "b.dat", "-o", "b.dat"], "--output"),
        (["compare", "a.toml", "sea.toml", "-o", "swell.nc"], "--output"),
        (["compare", "a.toml", "b.dat", "-o", "c.png", "--plot", "./c.png"], "--plot"),
        (["coverage", "-o", "c.png", "--plot", "c.png"], "--plot"),
        (["sensitivity", "a.toml", "-o", "c.png", "--plot", "c.png"], "--plot"),
    ],
)
def test_inputs_and_other_outputs_are_kept(tmp_path, monkeypatch, words, option):
    """An output once replaced a link file, a spectrum that a link file names, or another output."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("meshtrace.scenario.Scenario.mesh", None)
    monkeypatch.setattr("meshtrace.scenario.Scenario.simulate", None)
    for name in ("a.toml", "b.dat"):
        (tmp_path / name).write_text("wind_speed = 5.0")
    (tmp_path / "sea.toml").write_text(
        "[sea]\nspectrum = 'measured'\nfile = 'swell.nc'\ntail = 'elfouhaily'"
    )
    freq, direction = np.linspace(0.05, 0.5, 8), np.arange(0.0, 360.0, 30.0)
    efth = np.outer(np.exp(-(((freq - 0.2) / 0.05) ** 2)), np.ones(12)) * 1e-3
    data = xr.Dataset({"efth": (("freq", "dir"), efth)}, {"freq": freq, "dir": direction})
    data.to_netcdf(tmp_path / "swell.nc", engine="h5netcdf")
    kept = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    done = meshtrace(*(word.replace("FOLDER", tmp_path.name) for word in words))
    assert done.exit_code == 2
    assert done.stderr.startswith(f"error: {option}: ")
    assert done.stderr.count("\n") == 1
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == kept


@pytest.mark.posix
@pytest.mark.thorough
def test_a_full_disk_keeps_the_old_file_and_prints_the_result(tmp_path):
    import resource

    good = tmp_path / "good.nc"
    good.write_bytes(b"good")
    words = ["run", "--photons", "64", "--threads", "1", "-o", good]
    done = subprocess.run(
        [sys.executable, "-m", "meshtrace", *words],
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192)),
    )
    assert done.returncode == 2
    assert "channel gain" in done.stdout
    assert done.stderr.splitlines()[-1] == f"error: {good}: File too large"
    assert "Traceback" not in done.stderr
    assert good.read_bytes() == b"good"
    assert os.listdir(tmp_path) == ["good.nc"]


def test_the_written_result_says_what_was_printed(tmp_path):
    done = meshtrace("run", "--photons", 64, "-o", tmp_path / "a.nc")
    assert done.exit_code == 0
    text, _, last = done.stdout.rstrip("\n").rpartition("\n\n")
    assert last == f"written to {tmp_path / 'a.nc'}"
    # but for the time that the run took
    text = re.sub(r" in [\d.]+ s$", "", text, flags=re.MULTILINE)
    assert load(tmp_path / "a.nc").summary() == text


def test_no_light_is_a_bound_in_json_and_in_the_file(tmp_path):
    words = ["--set", "receiver.radius=1e-5", "--estimator", "analog", "--photons", 1000]
    data = json.loads(meshtrace("run", *words, "--json").stdout)
    assert data["gain"] == 0.0
    assert data["gain_bound"] == pytest.approx(3e-3)
    meshtrace("run", *words, "-o", tmp_path / "a.nc")
    assert float(load(tmp_path / "a.nc").gain_bound) == pytest.approx(3e-3)
    lit = json.loads(meshtrace("run", "--photons", 64, "--json").stdout)
    assert lit["gain_bound"] is None


def test_the_spectra_of_a_water_are_drawn(tmp_path):
    (tmp_path / "link.toml").write_text('wind_speed = 0.0\n[water]\ntype = "II"\n')
    shown = meshtrace("water", tmp_path / "link.toml", "--plot", tmp_path / "water.png")
    assert shown.stdout.startswith("jerlov-II (Solonenko and Mobley 2015)\n")
    assert (tmp_path / "water.png").stat().st_size > 1000
    profile = tmp_path / "profile.csv"
    profile.write_text("depth,wavelength,a,b\n0,400,0.1,0.3\n9,400,0.2,0.4\n")
    shown = meshtrace("water", "--file", profile)
    assert "1 wavelengths at 2 depths, at the surface" in shown.stdout
    assert "400               0.1       0.3       0.4       1.3300" in shown.stdout


def test_the_scatter_of_a_single_sea_is_a_dash():
    import xarray as xr

    from meshtrace.cli.studies import _rows

    gain = xr.DataArray(np.array([[1.0], [2.0]]), dims=("depth", "realization"))
    data = xr.Dataset({"gain": gain, "gain_stderr": 0.1 * gain}, {"depth": [1.0, 2.0]})
    head, _, *rows = _rows(data)
    assert [row.split()[-1] for row in (head, *rows)] == ["scatter", "-", "-"]


@pytest.mark.parametrize(
    "words",
    [
        ["run", "-o", "a.png"],
        ["ber", "--plot", "a.nc"],
        ["series", "--plot", "none/a.png"],
        ["irradiance", "-o", "a.csv"],
        ["traces", "-o", "none/a.nc"],
        ["lidar", "--plot", "a.xyz"],
        ["water", "--plot", "none/a.png"],
        ["validate", "--suite", "measured", "-o", "a.png"],
        ["view", "--screenshot", "none/a.png"],
        ["view", "--html", "a.png"],
        ["plot", "link.toml"],
    ],
    ids=" ".join,
)
def test_unwritable_outputs_are_refused_before_the_work(tmp_path, monkeypatch, words):
    (tmp_path / "link.toml").write_text("")
    monkeypatch.chdir(tmp_path)
    for work in ("Scenario.mesh", "Scenario.simulate"):
        monkeypatch.setattr(f"meshtrace.scenario.{work}", None)
    done = meshtrace(*words)
    assert done.exit_code == 2
    assert done.stdout == ""
    assert done.stderr.startswith("error: ")
    assert "meshtrace view" in done.stderr or words[0] != "plot"


@pytest.mark.parametrize("package", ["matplotlib", "pyvista"])
def test_a_plot_without_the_extra_is_refused_before_the_work(tmp_path, monkeypatch, package):
    monkeypatch.setitem(sys.modules, "meshtrace.viz", None)
    if package == "matplotlib":
        monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setattr("meshtrace.scenario.Scenario.case", None)
    done = meshtrace("ber", "--plot", tmp_path / "a.png")
    assert done.exit_code == 2
    assert "meshtrace[viz]" in done.stderr
