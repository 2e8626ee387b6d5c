"""The commands ber, series and ensemble, and the sections [detector] and [uav] of link files."""

import json

import numpy as np
import pytest
import xarray as xr
from command_line import meshtrace, refusal

import meshtrace as mt
from meshtrace.comms import OokLink
from meshtrace.errors import Refused
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


@pytest.mark.thorough
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


@pytest.mark.thorough
def test_ber_by_day_names_its_light():
    pytest.importorskip("pvlib")
    options = ("ber", "--wind", "0", "--bit-rates", "1e6", "--filter-nm", "2", "-n", 2)
    by_angle = [
        json.loads(shown(*options, name, angle, "--json"))[0]
        for name, angle in (("--sun-elevation", 60), ("--sun-zenith", 30))
    ]
    assert by_angle[0] == by_angle[1]
    assert by_angle[0]["background_light"].startswith("clear sky at zenith angle 30 deg, ")
    assert "counts/s through 2 nm" in by_angle[0]["background_light"]
    text = shown(*options, "--daylight", "overcast", "--sun-elevation", 20)
    assert "background light: overcast sky at zenith angle 70 deg, " in text
    assert "background light: none: dark" in shown(*options)


LIGHTS = {
    "horizon": ("--sun-zenith 90", "[daylight]\nsun_zenith_deg = 90.0",
                lambda: mt.Daylight.clear_sky(90.0), "sun_zenith_deg: 90.0, allowed: 0 <= "),
    "night": ("--daylight moon --sun-zenith 95", '[daylight]\nmodel = "moon"\nsun_zenith_deg = 95.0',
              lambda: mt.Daylight.moon(zenith_deg=95.0), "sun_zenith_deg: 95.0, allowed: 0 <= "),
    "nan": ("--daylight overcast --sun-zenith nan",
            '[daylight]\nmodel = "overcast"\nsun_zenith_deg = nan',
            lambda: mt.Daylight.overcast(float("nan")), "sun_zenith_deg: nan, allowed: "),
    "wavelength": ("--daylight night --set transmitter.wavelength_nm=1200.0",
                   'daylight = "night"\n[transmitter]\nkind = "led"\nwavelength_nm = 1200.0',
                   lambda: mt.Daylight.night(wavelength_nm=1200.0),
                   "wavelength_nm: 1200.0, allowed: 300 <= wavelength_nm <= 1100"),
    "filter": ("--filter-nm 0", "[detector]\noptics = {filter_width_nm = 0.0}",
               lambda: OokLink().replace("optics.filter_width_nm", 0.0),
               "filter_width_nm: 0.0, allowed: > 0"),
    "view": ("--set receiver.fov_deg=360.0", "[receiver]\nfov_deg = 360.0",
             lambda: mt.Receiver(fov_deg=360.0), "fov_deg: 360.0, allowed: 0 < fov_deg <= 180"),
    "lens": ("--set detector.optics.concentrator_index=0.5",
             "[detector]\noptics = {concentrator_index = 0.5}",
             lambda: OokLink().replace("optics.concentrator_index", 0.5),
             "concentrator_index: 0.5, allowed: 1 <= concentrator_index <= 4"),
    "lamp": ("--set transmitter.kind=air-led --set transmitter.height=0.0 "
             "--set receiver.kind=water-receiver",
             '[transmitter]\nkind = "air-led"\nheight = 0.0\n[receiver]\nkind = "water-receiver"',
             lambda: mt.AirLed(height=0.0), "height: 0.0, allowed: > 0"),
    "depth": ("--set transmitter.kind=air-led --set receiver.kind=water-receiver "
              "--set receiver.depth=-1.0",
              '[transmitter]\nkind = "air-led"\n[receiver]\nkind = "water-receiver"\ndepth = -1.0',
              lambda: mt.WaterReceiver(depth=-1.0), "depth: -1.0, allowed: 0 < depth"),
}  # fmt: skip


@pytest.mark.parametrize("name", LIGHTS)
def test_corners_are_refused_alike_by_command_line_file_and_python(name):
    options, text, make, message = LIGHTS[name]
    line = refusal("ber", *options.split())
    assert message in line
    with pytest.raises(Refused) as by_file:
        Scenario.from_toml(text)
    with pytest.raises(Refused) as by_python:
        make()
    assert message in str(by_python.value)
    assert repr(by_file.value.value) == repr(by_python.value.value)
    assert by_file.value.allowed == by_python.value.allowed
    assert line == str(by_file.value)


@pytest.mark.parametrize("elevation", ["0", "-5", "90.5", "nan"])
def test_elevations_below_the_horizon_are_refused(elevation):
    line = refusal("ber", "--sun-elevation", elevation)
    assert line.startswith(f"--sun-elevation: {float(elevation)!r}, allowed: 1 to 90 (below the ")
    both = refusal("ber", "--sun-elevation", "30", "--sun-zenith", "60")
    assert both == "--sun-elevation: 30.0, allowed: without --sun-zenith"
