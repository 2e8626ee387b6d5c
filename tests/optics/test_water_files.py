"""Readers of measured waters: SeaBASS, BGC-Argo profiles, text tables."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from meshtrace import InputWarning
from meshtrace.errors import Refused
from meshtrace.optics import Constituents, SpectralTable, Water
from meshtrace.optics.pure_water import pure_water_absorption, zhang_hu_he
from meshtrace.optics.water_files import read_spectrum
from meshtrace.scenario import Scenario

FILES = Path(__file__).parent / "files"


def test_a_seabass_profile_without_pure_water():
    water = Water.from_file(FILES / "profile.sb", 488.0)
    assert [row[0] for row in water.layers] == [0.0, 5.0, 12.0]  # 9 m lacks a value
    pure = float(pure_water_absorption(488.0)), float(zhang_hu_he(488.0))
    for (_, a, b), agp, c_440, c_490 in zip(
        water.layers, (0.051, 0.060, 0.040), (0.480, 0.590, 0.260), (0.430, 0.540, 0.215),
        strict=True,
    ):  # fmt: skip
        assert a == pytest.approx(agp + pure[0])
        # c between its own wavelengths, each with pure water
        w = np.array([440.0, 490.0])
        c = np.array([c_440, c_490]) + pure_water_absorption(w) + zhang_hu_he(w)
        assert b == pytest.approx(np.interp(488.0, w, c) - a)


def test_a_seabass_scan_with_a_column_of_wavelengths():
    table = read_spectrum(FILES / "scan.sb")
    assert isinstance(table, SpectralTable)
    assert [row[1:] for row in table.table][2] == (600.0, 0.3, pytest.approx(0.425))  # b is missing
    assert Water.from_file(FILES / "scan.sb", 450.0).b == pytest.approx(0.475)


def test_a_text_table_with_named_columns(tmp_path):
    water = Water.from_file(FILES / "table.csv", 500.0, bottom_depth=40.0)
    assert np.allclose(water.layers, [(0.0, 0.065, 0.275), (20.0, 0.05, 0.09)])
    assert water.at_wavelength(450.0).a == 0.05
    file = tmp_path / "plain.txt"
    file.write_text("400 0.1 0.2\n500 0.2 0.1\n")
    assert Water.from_file(file).b == pytest.approx(0.13)


def argo(path, **changes):
    """Write a profile as Argo does: two profiles of levels, of which the second has optics."""
    pressure = np.array([[2.0, 4.0, 6.0, 8.0], [3.0, 10.0, 30.0, 99999.0]])
    values = {
        "PRES": pressure,
        "TEMP": np.array([[21.0, 20.0, 19.0, 18.0], [20.5, 19.0, 15.0, 99999.0]]),
        "PSAL": np.full((2, 4), 36.5),
        "CHLA": np.array([[99999.0] * 4, [0.4, 0.6, 0.2, 99999.0]]),
        "CHLA_ADJUSTED": np.array([[99999.0] * 4, [0.2, 0.3, -0.01, 99999.0]]),
        "BBP700": np.array([[99999.0] * 4, [1.2e-3, 1.0e-3, 0.5e-3, 99999.0]]),
        **changes,
    }
    flags = {"CHLA_ADJUSTED": [list("9999"), list("5119")], "CHLA": [list("9999"), list("3339")],
             "BBP700": [list("9999"), list("1419")], "PRES": [list("1111"), list("1119")]}  # fmt: skip
    data = xr.Dataset({k: (("N_PROF", "N_LEVELS"), v) for k, v in values.items()})
    for name, rows in flags.items():
        data[f"{name}_QC"] = (("N_PROF", "N_LEVELS"), np.array(rows, dtype="S1"))
    data.to_netcdf(path, engine="h5netcdf")


def test_an_argo_profile_becomes_layers_of_chlorophyll(tmp_path):
    argo(tmp_path / "BD1234567_001.nc")
    found = read_spectrum(tmp_path / "BD1234567_001.nc")
    assert isinstance(found, Constituents)
    assert found.chlorophyll == ((0.0, 0.2), (10.0, 0.3), (30.0, 0.0))  # adjusted, 0 at least
    assert found.bbp700 == ((0.0, 1.2e-3), (30.0, 0.5e-3))  # 10 m is flagged as bad
    assert (found.temperature_c, found.salinity) == (20.5, 36.5)
    water = Water.from_file(tmp_path / "BD1234567_001.nc", 532.0)
    assert len(water.layers) == 3
    assert water.at_wavelength(470.0).a < water.at_wavelength(600.0).a


def test_an_argo_profile_without_good_chlorophyll_is_refused(tmp_path):
    argo(tmp_path / "bad.nc", CHLA_ADJUSTED=np.full((2, 4), 99999.0))
    with pytest.raises(Refused, match=r"bad.nc: .*PRES.*, allowed: PRES and CHLA with good values"):
        read_spectrum(tmp_path / "bad.nc")
    xr.Dataset({"gain": 1.0}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(Refused, match=r"other.nc: gain, allowed: PRES and CHLA"):
        read_spectrum(tmp_path / "other.nc")


def test_files_that_are_no_waters_are_refused(tmp_path):
    with pytest.raises(Refused, match=r"none.csv: no such file"):
        read_spectrum(tmp_path / "none.csv")
    (tmp_path / "names.csv").write_text("nm,x,y\n400,1,2\n")
    with pytest.raises(Refused, match=r"names.csv: nm, x, y, allowed: columns depth"):
        read_spectrum(tmp_path / "names.csv")
    text = (FILES / "scan.sb").read_text()
    (tmp_path / "no_b.sb").write_text(text.replace(",a,b,", ",a,bb,"))
    with pytest.raises(Refused, match=r"no_b.sb: wavelength, a, bb, a_sd, allowed: fields a or"):
        read_spectrum(tmp_path / "no_b.sb")
    (tmp_path / "damaged.nc").write_bytes(b"CDF no profile")
    with pytest.raises(Refused, match=r"damaged.nc: "):
        read_spectrum(tmp_path / "damaged.nc")
    (tmp_path / "text.sb").write_text("/begin_header\n/fields=a440,b440\n/end_header\nx y\n")
    with pytest.raises(Refused, match=r"text.sb: "):
        read_spectrum(tmp_path / "text.sb")


def test_a_file_in_a_link_file_is_beside_it_and_takes_other_values(tmp_path):
    argo(tmp_path / "float.nc")
    text = 'wind_speed = 0.0\n[water]\nfile = "float.nc"\ncdom = 0.05\nbottom_depth = 90.0'
    (tmp_path / "link.toml").write_text(text)
    scenario = Scenario.load(tmp_path / "link.toml")
    water = scenario.link.water
    assert (water.spectrum.cdom, water.bottom_depth) == (0.05, 90.0)
    assert water.spectrum.chlorophyll[1] == (10.0, 0.3)
    assert Scenario.from_toml(scenario.to_toml()) == scenario  # the values, without the file
    with pytest.raises(Refused, match=r"^water.cdom: 0.05, no such key"):
        Scenario.from_toml(f'[water]\nfile = "{FILES / "table.csv"}"\ncdom = 0.05')


def with_units(path, **units):
    """Write a profile whose values are in other units, with their names."""
    factors = {"PRES": 1.0, "CHLA_ADJUSTED": 1.0, "BBP700": 1.0, "PSAL": 1.0, "TEMP": 1.0}
    argo(path)
    with xr.open_dataset(path, engine="h5netcdf") as opened:
        data = opened.load()
    for name, (unit, factor) in units.items():
        assert name in factors
        values = xr.where(data[name] == 99999.0, 99999.0, factor * data[name])
        data[name] = values.assign_attrs(units=unit)
    data.to_netcdf(path, engine="h5netcdf")


@pytest.mark.parametrize(
    "units",
    [{"PRES": ("decibar", 1.0), "CHLA_ADJUSTED": ("mg/m3", 1.0), "BBP700": ("m-1", 1.0)},
     {"PRES": ("Pa", 1e4)}, {"PRES": ("bar", 0.1)}, {"CHLA_ADJUSTED": ("ug/l", 1.0)},
     {"CHLA_ADJUSTED": ("kg m-3", 1e-6)}, {"CHLA_ADJUSTED": ("g/m3", 1e-3)}, {"BBP700": ("cm-1", 1e-2)},
     {"PSAL": ("1", 1.0)}, {"PSAL": ("psu", 1.0)}],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore:.*converted to:meshtrace.InputWarning")
def test_units_of_an_argo_profile(units, tmp_path):
    with_units(tmp_path / "float.nc", **units)
    found = read_spectrum(tmp_path / "float.nc")
    np.testing.assert_allclose(found.chlorophyll, ((0.0, 0.2), (10.0, 0.3), (30.0, 0.0)))
    np.testing.assert_allclose(found.bbp700, ((0.0, 1.2e-3), (30.0, 0.5e-3)))
    assert (found.temperature_c, found.salinity) == (20.5, 36.5)


def test_kelvin_and_units_of_other_kinds(tmp_path):
    argo(tmp_path / "float.nc", TEMP=np.full((2, 4), 293.15))
    with xr.open_dataset(tmp_path / "float.nc", engine="h5netcdf") as opened:
        data = opened.load()
    data.TEMP.attrs["units"] = "K"
    data.to_netcdf(tmp_path / "kelvin.nc", engine="h5netcdf")
    with pytest.warns(InputWarning, match="^TEMP: K converted to degC$"):
        assert read_spectrum(tmp_path / "kelvin.nc").temperature_c == pytest.approx(20.0)
    with_units(tmp_path / "wrong.nc", CHLA_ADJUSTED=("m-1", 1.0))
    with pytest.raises(Refused, match="CHLA_ADJUSTED: in m-1, allowed: a unit"):
        read_spectrum(tmp_path / "wrong.nc")


@pytest.mark.parametrize("name", ["CHLA", "BBP700", "PRES", "CHLA_QC", "TEMP"])
def test_variables_of_unlike_lengths(name, tmp_path):
    """Once a traceback of numpy."""
    argo(tmp_path / "float.nc")
    with xr.open_dataset(tmp_path / "float.nc", engine="h5netcdf") as opened:
        data = opened.load().drop_vars(["CHLA_ADJUSTED", "CHLA_ADJUSTED_QC"])
    values = data[name].values[:, :3]
    data = data.drop_vars(name).assign({name: (("N_PROF", "N_OTHER"), values)})
    data.to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    if name == "CHLA":
        data.CHLA_QC[:] = b"1"
    with pytest.raises(Refused, match=r"(values over|values with) \d+ |levels|PRES and CHLA"):
        read_spectrum(tmp_path / "other.nc")
