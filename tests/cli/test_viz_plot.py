"""`meshtrace plot` draws the files of all commands, with names and units."""

import re

import pytest
from command_line import meshtrace, refusal

from meshtrace import viz
from meshtrace.cli import tools
from meshtrace.studies import store

FEW = ("--photons", "64")
SWEEP = """bubbles = "none"
[sweep]
realizations = 2
photons = 64
[sweep.parameters]
wind_speed = [5.0, 13.0]
"transmitter.half_angle_deg" = [10.0, 30.0]
"transmitter.depth" = [5.0, 10.0]
"""
DAY = """[receiver]
fov_deg = 20.0
[detector]
optics = {filter_width_nm = 2.0}
[daylight]
model = "clear"
[sweep]
rtol = 0.3
[sweep.parameters]
daylight.sun_zenith_deg = [10.0, 30.0]
"""
FADING = ("converge", "--what", "fading", "--omega-max")
WRITING = {
    "run": ("run", *FEW),
    "run, analog": ("run", "--photons", "5000", "--estimator", "analog"),
    "series": ("series", "--times", "0,0.5,1", *FEW),
    "ensemble": ("ensemble", "-n", "12", *FEW),
    "ensemble of two": ("ensemble", "-n", "2", *FEW),
    "ber": ("ber", "-n", "3", *FEW),
    "ber over depth": ("ber", "-n", "3", "--depths", "30,40", *FEW),
    "ber over wind": ("ber", "-n", "3", "--wind", "5,9", *FEW),
    "ber over both": ("ber", "-n", "3", "--wind", "5,9", "--depths", "30,40", *FEW),
    "compare": ("compare", "a.toml", "b.toml", *FEW),
    "converge": ("converge", "--spacings", "1,0.7,0.5,0.35", *FEW),
    "converge over time": ("converge", "--time-steps", "1,0.5,0.25,0.125", *FEW),
    "converge over the band": ("converge", "--omega-max", "4,6,8,9", *FEW),
    "converge of fading": (*FADING, "4,8,16,32"),
    "coverage": ("coverage", "--photons", "2000"),
    "availability": ("availability", "--runs", "8", "-n", "4", *FEW),
    "sensitivity": ("sensitivity", "--wrt", "water.a", *FEW),
    "optimize": ("optimize", "--bounds", "receiver.fov_deg=6,90", "-n", "4", *FEW),
    "design": ("design", "-n", "8", *FEW),
    "irradiance": ("irradiance", "--times", "0,0.1", "--photons", "1000"),
    "lidar": ("lidar", "--seas", "2", *FEW),
    "traces": ("traces", "--hours", "1e-4", "--rate", "10", *FEW),
    "sweep": ("sweep", "sweep.toml", "--workers", "1"),
    "sweep by day": ("sweep", "day.toml", "--workers", "1"),
}
NO_RESULTS = {"explore", "new", "plot", "validate", "view", "warm", "water"}
"""Commands that print, open windows, draw pictures or write JSON."""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, text in (("a", ""), ("b", "wind_speed = 9\n"), ("sweep", SWEEP), ("day", DAY)):
        (tmp_path / f"{name}.toml").write_text(text)
    return tmp_path


def test_every_command_is_listed():
    from typer.main import get_command

    from meshtrace import cli

    writing = {words[0] for words in WRITING.values()}
    assert writing | NO_RESULTS == set(get_command(cli.app).commands)
    assert not writing & NO_RESULTS


@pytest.mark.process
@pytest.mark.thorough
@pytest.mark.parametrize("name", WRITING)
@pytest.mark.filterwarnings("ignore")
@pytest.mark.slow_but(
    "run", "series", "ensemble", "ber", "compare", "coverage", "sensitivity", "converge of fading"
)
def test_every_result_is_drawn(name, folder):
    words = WRITING[name]
    if words[0] == "sweep":
        pytest.importorskip("distributed")
    made = meshtrace(*words, "-o", "result.nc")
    assert made.exit_code == 0, made.output
    files = [folder / "result.nc", *folder.glob("*.store")]
    assert len(files) == (2 if words[0] == "sweep" else 1)
    for file in files:
        drawn = meshtrace("plot", file, "-o", "a.png")
        assert drawn.exit_code == 0, drawn.output
        assert (folder / "a.png").stat().st_size > 5000
        ax = viz.plot(tools._content(file))
        assert any(len(line.get_xdata()) for line in ax.get_lines()) or ax.patches or ax.collections
        for label in labels(ax):  # neither a key of a link file nor a bare number
            assert label
            assert not re.fullmatch(r"[\w]+\.[\w.]+|[-\d.e, ]+", label), label


def labels(ax):
    """Yield the names of the axes, and those of the curves or the title of their legend."""
    yield ax.get_xlabel()
    if not ax.yaxis_inverted():  # the names of bars
        yield ax.get_ylabel()
    legend = ax.get_legend()
    if legend is not None:
        title = legend.get_title().get_text()
        yield from [title] if title else [text.get_text() for text in legend.get_texts()]


@pytest.mark.filterwarnings("ignore")
def test_what_is_no_result_is_refused(folder):
    with store.Store(folder / "none.store").loop("gains", {}):
        pass
    assert "is not that of a sweep" in refusal("plot", folder / "none.store", "-o", "a.png")
    (folder / "other.json").write_text("{}")
    assert "undamaged" in refusal("plot", folder / "other.json", "-o", "a.png")
