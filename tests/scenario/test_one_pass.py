"""A link file is read in one pass: each key goes straight to its model."""

import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pydantic
import pytest
import xarray as xr

import meshtrace as mt
from meshtrace.errors import Refused

ROOT = str(Path(mt.__file__).parent)

VALUE = 7.0123456
CONFIGS = {
    "wind_speed": {"wind_speed": VALUE},
    "sea, flat": {"sea": {"fetch": VALUE}},
    "sea, spectrum": {"sea": {"spectrum": {"kind": "jonswap", "fetch": VALUE}}},
    "sea, spreading": {"sea": {"spreading": {"kind": "cos2s", "s": VALUE}}},
    "sea, mesh": {"sea": {"extent": VALUE}},
    "water": {"water": {"bottom_depth": 10.0 * VALUE}},
    "water, phase": {"water": {"phase": {"model": "fournier-forand", "mu": VALUE / 2.0}}},
    "bubbles": {"bubbles": {"wind_speed": VALUE}},
    "whitecaps": {"whitecaps": {"wind_speed": VALUE}},
    "transmitter": {"transmitter": {"depth": VALUE}},
    "receiver": {"receiver": [{"height": 3.0}, {"height": VALUE}]},
    "detector": {"detector": {"led": {"width_nm": VALUE}}},
    "uav": {"uav": {"mass": VALUE}},
    "run": {"run": {"estimator": "analog", "roulette": 0.1 * VALUE}},
}


def leaf(config):
    """Return the last value of nested tables and lists."""
    while isinstance(config, dict | list):
        config = list(config.values() if isinstance(config, dict) else config)[-1]
    return config


def holds(data, value):
    """Return whether plain data hold a value; a model has been made of its data already."""
    if isinstance(data, Mapping):
        return any(holds(item, value) for item in data.values())
    if isinstance(data, list | tuple):
        return any(holds(item, value) for item in data)
    return type(data) is float and data == value


def travel(config):
    """Return the numbers of functions that a value enters, and that return it, as plain data.

    What a model computes of its own values is no way of the key: it has arrived.
    """
    value, stays, climbs = leaf(config), [], []

    def arrived(frame):
        models = (f.f_locals.get("self") for f in frames(frame))
        return any(
            isinstance(model, pydantic.BaseModel) and value in list(model.__dict__.values())
            for model in models
        )

    def frames(frame):
        while frame is not None and frame.f_code.co_name != "from_config":
            yield frame
            frame = frame.f_back

    def watch(frame, event, result):
        code = frame.f_code
        if not code.co_filename.startswith(ROOT) or code.co_name.startswith("<"):
            return
        if event == "call" and not arrived(frame):
            names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount + 2]
            if any(holds(frame.f_locals.get(name), value) for name in names):
                stays.append(code.co_qualname)
        if event == "return" and holds(result, value) and not arrived(frame):
            climbs.append(code.co_qualname)

    sys.setprofile(watch)
    try:
        mt.Scenario.from_config(config)
    finally:
        sys.setprofile(None)
    return stays, climbs


@pytest.mark.parametrize("name", CONFIGS)
def test_a_key_reaches_its_models_by_few_functions(name):
    mt.Scenario.from_config(CONFIGS[name])  # what is done once a process is no part of the way
    stays, climbs = travel(CONFIGS[name])
    assert len(stays) <= 25, stays
    assert len(climbs) <= 5, climbs
    assert stays


def test_files_of_the_parts_of_a_sea_are_relative_to_the_link_file(tmp_path):
    (tmp_path / "swell.csv").write_text("0.5,0.0\n0.8,1.0\n1.1,0.2\n")
    text = '[[sea.part]]\nspectrum = "tabulated"\nfile = "swell.csv"\n[[sea.part]]\n'
    sea = mt.Scenario.from_toml(text, folder=tmp_path).surface
    assert sea.parts[0].spectrum.omega == (0.5, 0.8, 1.1)


def test_the_date_of_a_record_goes_to_its_reader(tmp_path):
    dates = np.array(["2024-05-01T00:00", "2024-05-01T06:00"], "datetime64[ns]")
    frequency, direction = np.linspace(0.05, 0.5, 20), np.arange(0.0, 360.0, 30.0)
    density = np.multiply.outer([0.01, 0.04], np.exp(-(((frequency - 0.2) / 0.05) ** 2)))
    variable = ("time", "freq", "dir"), np.repeat(density[..., None], 12, axis=2)
    coordinates = {"time": dates, "freq": frequency, "dir": direction}
    xr.Dataset({"efth": variable}, coordinates).to_netcdf(tmp_path / "buoy.nc")
    text = '[sea]\nspectrum = "measured"\nfile = "buoy.nc"\nmss = "cox-munk"\ntime = "{}"'
    early, late = (
        mt.Scenario.from_toml(text.format(date), folder=tmp_path)
        for date in ("2024-05-01T00:00", "2024-05-01T06:00")
    )
    assert np.sum(late.surface.variance) == pytest.approx(4.0 * np.sum(early.surface.variance))
    assert late.meshing.time == 0.0


@pytest.mark.parametrize("table", ["sea", "bubbles", "whitecaps"])
def test_false_is_no_wind_of_0(table):
    with pytest.raises(Refused) as refusal:
        mt.Scenario.from_config({table: {"wind_speed": False}})
    assert refusal.value.field == f"{table}.wind_speed"
