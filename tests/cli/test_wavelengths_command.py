"""Wavelengths on the command line."""

import json

import pytest
from command_line import meshtrace, refusal

import meshtrace as mt
from meshtrace.surfaces import FlatSea


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "link.toml"
    link = mt.Link(water=mt.Water.from_type("jerlov-IB"))
    path.write_text(mt.Scenario(link=link, surface=FlatSea(), wind_speed=0.0).to_toml())
    return path


def test_run_prints_a_row_for_each_wavelength(file, tmp_path):
    kept = tmp_path / "gain.nc"
    common = [file, "--photons", "256", "--wavelengths", "450:550:50"]
    lines = meshtrace("run", *common, "-o", kept).stdout.splitlines()
    assert [line.split()[0] for line in lines[1:4]] == ["450", "500", "550"]
    found = json.loads(meshtrace("run", *common, "--json").stdout)
    assert list(found) == ["450", "500", "550"]
    loaded = mt.results.load(kept)
    assert loaded.at_wavelength(500.0).gain == found["500"]["gain"]


def test_a_water_of_one_wavelength_is_refused():
    assert "spectrum" in refusal("run", "--wavelengths", "450,500", "--photons", "64")
