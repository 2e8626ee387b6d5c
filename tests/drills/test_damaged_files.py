"""Files damaged by the hundred: a refusal in one line or a fresh computation, never other numbers.

Cut, empty, overwritten, with flipped bits, and of another kind. `hostile.py` holds the same for
stores and the two kinds of results that runs write most.
"""

import io
import json
import subprocess
import sys
import warnings
from pathlib import Path
from random import Random

import numpy as np
import pytest
from hostile_parts import damage

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.optics import mie
from meshtrace.results import load
from meshtrace.stored import read_dataset, write_dataset
from paper.runner import read_record, write_record
from paper.water import WaterProfile, load_profiles

pytestmark = pytest.mark.drill

MANY = [40, pytest.param(400, marks=pytest.mark.slow)]

OTHERS = [b"\x89PNG\r\n\x1a\n" + bytes(90), b"{}", b"[]", b"\x93NUMPY\x01\x00", b"PK\x03\x04" + bytes(60),
          b"CDF\x01" + bytes(40), b"\x89HDF\r\n\x1a\n" + bytes(90), b"kind = 'x'\n", b"\x00" * 5000]  # fmt: skip


def damages(content, many, name):
    """Yield damaged bytes."""
    random = Random(name)
    yield from OTHERS
    for _ in range(many):
        yield damage(random, content)[0]


def results():
    """Yield a result of each kind that can be made without a simulation."""
    gain = 1e-5 * (1.0 + np.random.default_rng(5).random(40))
    times = 0.5 * np.arange(40.0)
    series = mt.GainSeries("time", times, gain, 0.01 * gain, gain, 1e-7)
    yield series
    yield series.fading()
    cells = np.arange(3.0)
    yield mt.CoverageMap(cells, cells, np.ones((3, 3)), np.ones((3, 3)), {})


@pytest.mark.parametrize("many", MANY)
@pytest.mark.parametrize("i", range(3))
def test_results(i, many, tmp_path):
    sound = list(results())[i]
    path = tmp_path / "result.nc"
    sound.save(path)
    expected, refused = sound.to_dataset(), 0
    for content in damages(path.read_bytes(), many, f"results {i}"):
        path.write_bytes(content)
        try:
            found = load(path).to_dataset()
        except Refused as error:
            assert str(error).startswith(str(path))
            refused += 1
        else:
            assert found.identical(expected)
    assert refused > many / 2


@pytest.mark.parametrize("many", MANY)
def test_profiles(many, tmp_path):
    """Files of others have no checksum of ours: numbers may differ, but nothing else happens."""
    import xarray as xr

    path = tmp_path / "cast.nc"
    rows = {name: ("DEPTH", np.linspace(20.0, 30.0, 8)) for name in ("TEMP", "PSAL")}
    xr.Dataset(rows, {"DEPTH": np.arange(8.0)}).to_netcdf(path, engine="h5netcdf")
    for content in damages(path.read_bytes(), many, "profiles"):
        path.write_bytes(content)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                assert all(isinstance(found, WaterProfile) for found in load_profiles(path))
            except Refused as error:
                assert "allowed: " in str(error)


@pytest.mark.parametrize("many", MANY)
def test_records_of_figures(many, tmp_path):
    path = tmp_path / "record.json"
    record = {"key": "x", "rows": [{"value": 1.25, "name": "gain"}], "kept": False}
    write_record(path, record)
    sound = path.read_bytes()
    assert read_record(path) == record
    found = []
    for content in damages(sound, many, "records"):
        path.write_bytes(content)
        found.append(read_record(path))
    assert all(one in (None, record) for one in found)
    assert found.count(None) > many / 2


def test_a_record_of_another_number_is_none(tmp_path):
    path = tmp_path / "record.json"
    write_record(path, {"value": 1.25})
    content = json.loads(path.read_text())
    path.write_text(json.dumps({**content, "value": 1.26}))
    assert read_record(path) is None
    path.write_text(json.dumps({"value": 1.25}))
    assert read_record(path) is None


@pytest.mark.parametrize("many", MANY)
def test_tables_of_mie(many):
    """Of the cache: computed again, with a warning, whatever zipfile and numpy raise."""
    (file,) = list(Path(mie.__file__).parent.glob("data/*.npz"))[:1]
    content = file.read_bytes()
    text = str(np.load(io.BytesIO(content))["inputs"])
    sound = vars(mie._read(io.BytesIO(content), text))
    wrong = 0
    for bad in damages(content, many, "mie"):
        try:
            found = vars(mie._read(io.BytesIO(bad), text))
        except Exception:
            wrong += 1
        else:
            assert all(np.array_equal(found[name], sound[name]) for name in sound)
    assert wrong > many / 2


def test_any_damage_of_a_mie_table_costs_a_warning(tmp_path, monkeypatch):
    """An encrypted, or unknown, kind of zip file once ended in NotImplementedError."""
    monkeypatch.setenv("MESHTRACE_CACHE_DIR", str(tmp_path))
    table = mie.MieTable(np.array([0.0, np.pi]), np.array([0.0, 1.0]), 1.0, 0.9, 0.0)
    inputs = {"x": 1}

    def kept():
        return mie.cached_table("test", inputs, lambda: table)

    kept()
    (file,) = tmp_path.glob("test-*.npz")
    content = file.read_bytes()
    at = content.index(b"PK\x01\x02") + 10  # compression method in the central directory
    file.write_bytes(content[:at] + b"\x63" + content[at + 1 :])
    with pytest.warns(UserWarning, match="damaged, computed again"):
        np.testing.assert_array_equal(kept().cdf, table.cdf)
    assert file.read_bytes() == content


@pytest.mark.parametrize("many", MANY)
def test_datasets(many, tmp_path):
    import xarray as xr

    path = tmp_path / "data.nc"
    sound = xr.Dataset(
        {"gain": ("time", np.arange(50.0)), "name": ((), "x")}, {"time": np.arange(50.0)}
    )
    write_dataset(sound, path)
    content = path.read_bytes()
    for content in [damage(Random(f"datasets {i}"), content)[0] for i in range(many)]:
        path.write_bytes(content)
        try:
            found = read_dataset(path)
        except Refused:
            continue
        xr.testing.assert_equal(found, sound)


def test_a_lost_last_block_is_noticed(tmp_path):
    """4 kB of zeros pass fletcher32, and take the digest at the end of the file with them."""
    import xarray as xr

    path = tmp_path / "data.nc"
    write_dataset(xr.Dataset({"gain": ("time", np.arange(50.0))}), path)
    content = path.read_bytes()
    for lost in (1, 20, 48, 100, 500, 4096):
        path.write_bytes(content[:-lost] + bytes(lost))
        with pytest.raises(Refused, match="damaged"):
            read_dataset(path)


def test_files_of_other_writers_need_no_digest(tmp_path):
    import xarray as xr

    data = xr.Dataset({"gain": ("time", np.arange(50.0))})
    for engine, form in (("h5netcdf", "NETCDF4"), ("scipy", "NETCDF3_CLASSIC")):
        path = tmp_path / f"{engine}.nc"
        data.to_netcdf(path, engine=engine, format=form)
        xr.testing.assert_equal(read_dataset(path), data)


@pytest.mark.process
@pytest.mark.thorough
def test_an_object_of_a_heap_without_size_is_no_endless_loop(tmp_path):
    """HDF5 reads it for ever, in a file of another writer."""
    import xarray as xr

    path = tmp_path / "foreign.nc"
    data = xr.Dataset({"a": (("x", "y"), np.ones((8, 12)))}, {"x": np.arange(8.0)})
    data.to_netcdf(path, engine="h5netcdf")
    sound = path.read_bytes()
    assert read_dataset(path)["a"].shape == (8, 12)
    size = sound.index(b"GCOL\x01") + 24  # of the first object
    assert int.from_bytes(sound[size : size + 8], "little") == 8
    for bit in range(24):  # the next object then begins elsewhere
        damaged = bytearray(sound)
        damaged[size + bit // 8] ^= 1 << bit % 8
        (tmp_path / f"{bit}.nc").write_bytes(damaged)
    code = """
import pathlib, sys
from meshtrace.errors import Refused
from meshtrace.stored import read_dataset
for path in sorted(pathlib.Path(sys.argv[1]).glob("?*.nc")):
    try:
        read_dataset(path)
    except Refused as error:
        print(error)
"""
    command = [sys.executable, "-P", "-W", "ignore", "-c", code, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert any("an object of a global heap has no size" in line for line in lines)
    assert all("allowed: an undamaged netCDF file" in line for line in lines)
