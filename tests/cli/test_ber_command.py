"""The commands ber, series and ensemble, and the sections [detector] and [uav] of link files."""

import json

import numpy as np
import xarray as xr
from command_line import meshtrace

import meshtrace as mt
from meshtrace.comms.ook import OokLink
from meshtrace.scenario import Scenario

FAST = ["--photons", "256"]


def shown(*arguments):
    result = meshtrace(*arguments, *FAST)
    assert result.exit_code == 0, result.stderr
    return result.stdout


def test_ber_as_json_is_link_performance():
    text = shown("ber", "--wind", "0,13", "--bit-rates", "5e6", "--json", "-n", 3)
    for found, wind in zip(json.loads(text), (0.0, 13.0), strict=True):
        scenario = Scenario.from_config({"wind_speed": wind, "run": {"photons": 256}})
        expected = mt.link_performance(
            scenario.link,
            scenario.surface,
            wind_speed=wind,
            bit_rate=5e6,
            realizations=3,
            photons=256,
        ).at()
        figures = found["figures"][0]
        assert found["wind_speed"] == wind
        assert figures["ber"] == expected.ber._asdict()
        assert figures["capacity"]["soft"] == expected.capacity.soft
        assert found["provenance"]["run"]["photons"] == 256


def test_ber_prints_table_ranges_and_status(tmp_path):
    file = tmp_path / "ber.nc"
    options = ("--preset", "paper-ranges", "--wind", "0", "--depths", "45:55:5", "-o", file)
    text = shown("ber", *options, "--bit-rates", "1e6")
    with xr.open_dataset(file, engine="h5netcdf") as data:
        assert data["depth"].to_numpy().tolist() == [45.0, 50.0, 55.0]
        assert f"{float(data['range'][0]):.1f} m" in text


def test_ber_with_a_uav_as_factor_and_coupled():
    options = ("ber", "--uav", "dji-m300-rtk", "--wind", "13", "--bit-rates", "1e6", "-n", 4)
    for extra in ((), ("--coupled",)):
        (found,) = json.loads(shown(*options, *extra, "--json"))
        assert found["provenance"]["coupled"] == bool(extra)
        assert found["provenance"]["uav"]["mass"] == 8.37
        assert found["provenance"]["wind"]["wind_speed"] == 13.0


def test_ber_writes_all_winds(tmp_path):
    shown("ber", "--wind", "0,5", "-n", 2, "-o", tmp_path / "ber.nc")
    with xr.open_dataset(tmp_path / "ber.nc", engine="h5netcdf") as data:
        assert data["wind_speed"].to_numpy().tolist() == [0.0, 5.0]


def test_series_prints_and_writes_fading(tmp_path):
    file = tmp_path / "series.nc"
    text = shown("series", "--times", "0:2:0.5", "-o", file)
    gains = mt.GainSeries.load(file)
    assert gains.time.tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert f"{gains.gain.mean():.6g}" in text


def test_ensemble_prints_its_distribution(tmp_path):
    file = tmp_path / "ensemble.nc"
    text = shown("ensemble", "-n", 6, "-o", file)
    gains = mt.GainSeries.load(file)
    assert gains.along == "realization"
    assert f"{np.median(gains.gain):.4e}" in text


SECTIONS = """
[detector]
preset = "paper"
bit_rate = 5e6
saturation = false
[detector.optics]
filter_transmission = 0.8
[uav]
preset = "dji-m300-rtk-no-payload"
gimbal = true
"""


def test_sections_replace_fields_of_presets():
    scenario = Scenario.from_toml(SECTIONS)
    base = OokLink.preset("paper")
    optics = base.optics.model_copy(update={"filter_transmission": 0.8})
    expected = {"bit_rate": 5e6, "saturation": False, "optics": optics}
    assert scenario.detector == base.model_copy(update=expected)
    assert scenario.uav == mt.Uav(mass=6.3, gimbal=True)
    assert Scenario.from_toml(scenario.to_toml()) == scenario
    assert Scenario.from_toml("").detector is None
