"""The program that redraws the paper: files, page and kept figures."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from test_profiles import write_argo

from paper import FIGURES, Setting, make_figures
from paper.__main__ import main
from paper.registry import load
from paper.runner import key, number_text

CHEAP = ("ff-cdf", "bubble-density", "stations")
PROGRAM = Path(__file__).parents[2] / "examples" / "paper"


@pytest.fixture
def figures(capsys):
    def run(*arguments):
        main([str(argument) for argument in arguments])
        return capsys.readouterr().out

    return run


@pytest.fixture
def refusal(capsys):
    def run(*arguments):
        with pytest.raises(SystemExit, match="2"):
            main([str(argument) for argument in arguments])
        shown = capsys.readouterr()
        assert shown.out == ""
        assert shown.err.startswith("error: ")
        assert shown.err.count("\n") == 1
        return shown.err

    return run


def only(*names):
    return [word for name in names for word in ("--only", name)]


def test_cheap_figures_have_picture_data_table_and_a_page(tmp_path, figures):
    assert "3 drawn, 0 kept" in figures("-o", tmp_path, "--quick", *only(*CHEAP))
    page = (tmp_path / "index.html").read_text()
    for name in CHEAP:
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        with xr.open_dataset(tmp_path / f"{name}.nc", engine="h5netcdf") as data:
            assert data.data_vars
        record = json.loads((tmp_path / f"{name}.json").read_text())
        with (tmp_path / f"{name}.csv").open(newline="") as file:
            table = list(csv.DictReader(file))
        assert len(table) == len(record["rows"]) > 0
        assert all(row["difference"].endswith(".") for row in table)
        assert f'src="{name}.png"' in page
        assert f'href="{name}.nc"' in page
    assert (
        page.index('id="ff-cdf"') < page.index('id="bubble-density"') < page.index('id="stations"')
    )
    assert "Not drawn yet: link," in page


@pytest.mark.thorough
def test_second_run_keeps_what_is_there_and_redraws_what_is_missing(tmp_path):
    make_figures(tmp_path, CHEAP, quick=True)
    (tmp_path / "stations.png").unlink()
    (tmp_path / "bubble-density.json").write_text("{ half a record")
    made = {r["name"]: r["kept"] for r in make_figures(tmp_path, CHEAP, quick=True)}
    assert made == {"ff-cdf": True, "bubble-density": False, "stations": False}
    assert all(r["kept"] for r in make_figures(tmp_path, CHEAP, quick=True))


@pytest.mark.thorough
def test_interrupted_run_goes_on_where_it_was(tmp_path, monkeypatch):
    def interrupted(*arguments):
        raise KeyboardInterrupt

    load("bubble-density")
    with monkeypatch.context() as patch:
        patch.setattr("paper.optics._bubbles", interrupted)
        with pytest.raises(KeyboardInterrupt):
            make_figures(tmp_path, CHEAP, quick=True)
    assert (tmp_path / "ff-cdf.json").is_file()
    assert not (tmp_path / "bubble-density.json").exists()
    made = [r["kept"] for r in make_figures(tmp_path, CHEAP, quick=True)]
    assert made == [True, False, False]


def test_key_follows_all_inputs_and_no_others(tmp_path):
    write_argo(tmp_path / "a.nc")
    given = Setting(profiles=(tmp_path / "a.nc",))
    sweep, water = load("gain-depth"), load("temperature-salinity")
    first = key(sweep, Setting(), True)
    assert key(sweep, Setting(threads=2), True) == first
    assert key(sweep, given, True) == first
    assert len({first, key(sweep, Setting(), False), key(sweep, Setting(seed=2), True)}) == 3
    assert key(water, given, True) != key(water, Setting(), True)


def test_profiles_are_read_and_drawn(tmp_path, figures):
    write_argo(tmp_path / "cast.nc")
    name = "temperature-salinity"
    figures("-o", tmp_path / "out", *only(name), "--profiles", tmp_path / "cast.nc")
    record = json.loads((tmp_path / "out" / f"{name}.json").read_text())
    assert "NOT the paper's data" not in record["caption"]
    with xr.open_dataset(tmp_path / "out" / f"{name}.nc", engine="h5netcdf") as data:
        assert list(data.profile.to_numpy()) == ["cast 1", "cast 2"]
        assert (data.offset.sel(zenith=data.zenith[-1]) > 0.0).all()


def test_stand_ins_say_that_they_are_not_the_papers_data(tmp_path):
    (record,) = make_figures(tmp_path, ["temperature-salinity"])
    assert record["caption"].startswith("NOT the paper's data")


def test_bad_input_is_one_line(tmp_path, refusal):
    (tmp_path / "file").write_text("")
    assert "--only: 'nope', allowed: link," in refusal("-o", tmp_path, "--only", "nope")
    assert "File exists" in refusal("-o", tmp_path / "file", *only("ff-cdf"))
    for name in ("no.nc", "file"):
        text = refusal("-o", tmp_path, *only("stations"), "--profiles", tmp_path / name)
        assert f"{name}: " in text
        assert "allowed: an undamaged netCDF file" in text


@pytest.mark.process
def test_program_lists_all_figures():
    line = [sys.executable, str(PROGRAM), "--list"]
    shown = subprocess.run(line, capture_output=True, text=True, check=True)
    assert shown.stdout.split() == list(FIGURES)


def test_all_numbered_figures_of_the_paper_are_there():
    found = [load(name) for name in FIGURES]
    assert [one.name for one in found] == list(FIGURES)
    numbers = [int(one.number.rstrip("ab")) for one in found]
    assert sorted(set(numbers)) == list(range(1, 24))
    assert numbers == sorted(numbers)
    assert all(set(one.quick) == set(one.full) for one in found)


@pytest.mark.parametrize(
    ("number", "text"),
    [
        ((5.9731e-5, 6.2e-8), "5.973e-05 &plusmn; 6e-08"),
        ((43.26, 0.12), "43.3 &plusmn; 0.1"),
        ((0.0, 0.0), "0"),
        ((np.nan, 0.0), "none"),
        ((0.002, 0.01), "0.002 &plusmn; 0.01"),
        (None, "&ndash;"),
    ],
)
def test_numbers_are_rounded_to_their_errors(number, text):
    assert number_text(number) == text
