"""Files of results, damaged and whole; texts of all kinds."""

import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from typing import NamedTuple

import h5py
import numpy as np
import pytest
import xarray as xr

import meshtrace as mt
from meshtrace import errors, stored
from meshtrace.apps import measured
from meshtrace.errors import Refused
from meshtrace.results import load
from meshtrace.results.gain import bound_where_dark
from meshtrace.results.provenance import _git_commit, environment
from meshtrace.results.tallies import error_of_groups
from meshtrace.stored import Stored, read_dataset, write_dataset
from meshtrace.studies import ConvergenceStudy, fading_study
from meshtrace.studies.refinement import Reference
from meshtrace.surfaces import FlatSea, resolved_sea

FLAT = FlatSea().mesh(extent=80.0, spacing=40.0)


def _studies(design, availability):
    """Return results of studies over still water, as small as can be."""
    link, sea = mt.Link(), FlatSea()
    day = mt.Daylight(direct=1.0, diffuse=0.3)
    wrt = ["water.a", "receiver.height"]
    return {
        "comparison": mt.compare({"a": link, "b": link.at_depth(12.0)}, sea, photons=64),
        "duplex": mt.duplex(link, link.mirrored(), sea, times=[0.0, 1.0], photons=64),
        "background": mt.background(link, sea, day, photons=64),
        "background-series": mt.background_series(link, sea, day, times=[0.0, 1.0], photons=64),
        "irradiance-series": mt.irradiance_series(
            FlatSea(), day, water=mt.Water(a=0.1, b=0.0), times=[0.0, 1.0], photons=1000,
            patch=(0.1, 0.05),
        ),
        "sensitivity": mt.sensitivities(link, sea, wrt, photons=64),
        "optimum": mt.optimize(
            link, sea, {"transmitter.half_angle_deg": (5.0, 20.0)}, objective="gain", photons=64,
            realizations=2,
        ),
        "design": design,
        "availability": availability,
        "pixels": mt.studies.pixel_signals(
            mt.Link(receiver=mt.Receiver(pixels=2)), sea, day, photons=64, rays=64
        ),
        "wavelengths": mt.simulate(
            link.replace("water", mt.Water.from_type("jerlov-II")), sea, photons=64,
            wavelengths_nm=[450.0, 500.0],
        ),
        "inference": mt.infer(
            {"transmitter.depth": [8.0, 10.0, 12.0], "gain": [9e-5, 6e-5, 4e-5], "stderr": [1e-6] * 3},
            link, ["water.a"], photons=64,
        ),
    }  # fmt: skip


@pytest.fixture(scope="module")
def results(calm_design, calm_availability):
    """Return a small result of every kind."""
    link = mt.Link(receiver=mt.Receiver(radius=1.0))
    gain = mt.simulate(link, FLAT, estimator="analog", photons=8192, record=[mt.Arrivals()])
    forced = mt.simulate(mt.Link(), FlatSea(), photons=64)
    rng = np.random.default_rng(1)
    series = mt.GainSeries(
        "realization",
        np.arange(40),
        rng.uniform(1.0, 2.0, 40),
        np.full(40, 0.01),
        np.ones(40),
        0.01,
    )
    moving = replace(series, along="time", coordinate=0.1 * np.arange(40))
    grid = np.linspace(0.0, 1.0, 3)
    coverage = mt.CoverageMap(grid, grid, np.ones((3, 3)), np.full((3, 3), 0.1), {"times": [0.0]})
    shortcuts = {"realizations": 8, "photons": 64}
    performance = mt.link_performance(mt.Link(), **shortcuts)
    steps = np.array([2.0, 1.0, 0.5, 0.25])
    ones = np.ones((1, 4))
    study = ConvergenceStudy(
        parameter="spacing",
        values=steps,
        normals=("vertex",),
        samples=1.0 + 0.01 * steps[:, None, None] ** 2 + 1e-4 * rng.normal(size=(1, 4, 2, 32)),
        ballistic=0.5 + 0.0 * rng.normal(size=(1, 4, 2)),
        scatter=1e-3 * ones,
        slope_variance=0.03 * ones,
        total_reflection=0.1 * ones,
        mesh_time=ones,
        bvh_time=2.0 * ones,
        evaluation_time=3.0 * ones,
        reference=Reference(1.0 + 1e-4 * rng.normal(size=32), 0.5, 1e-5, 0.03, 1),
    )
    found = {
        "gain": gain,
        "forced": forced,
        "series": series,
        "moving": moving,
        "coverage": coverage,
        "impulse": mt.impulse_response(gain),
        "fading": series.fading(),
        "fading-moving": moving.fading(),
        "markov-channel": mt.apps.MarkovChannel.fit(moving.gain, 0.1, 3),
        "transformed-gaussian": mt.apps.TransformedGaussian.fit(moving.gain, 0.1),
        "performance": performance,
        "depth-sweep": mt.DepthSweep((0.0, 5.0), (performance, performance)),
        "convergence": study,
        **_studies(calm_design, calm_availability),
        "measured": measured.run(["cox-munk"]),
        "lidar": mt.lidar(
            mt.Link(
                water=mt.Water(bottom_depth=3.0, bottom_albedo=0.2),
                transmitter=mt.AirTopHatBeam(height=20.0, divergence_deg=0.5),
                receiver=mt.Receiver(height=20.0, fov_deg=2.0),
            ),
            FlatSea(),
            photons=64,
        ),
        "trace": mt.channel_trace(mt.Link(), FlatSea(), hours=1e-4, rate=10.0, photons=64),
        "fading-convergence": fading_study(mt.Link(), resolved_sea(5.0), [2.0, 3.0, 4.0, 6.0]),
    }
    assert {type(r) for r in found.values()} == set(Stored._classes.values())
    return found


@pytest.mark.thorough
def test_every_result_comes_back_from_its_file(results, tmp_path):
    for name, result in results.items():
        result.save(tmp_path / "a.nc")
        back = load(tmp_path / "a.nc")
        assert type(back) is type(result)
        assert type(result).load(tmp_path / "a.nc").to_dataset().identical(back.to_dataset())
        xr.testing.assert_allclose(back.to_dataset(), result.to_dataset(), rtol=1e-13)
        assert back.to_dataset().attrs.keys() == result.to_dataset().attrs.keys(), name
        assert back.provenance == result.provenance
        assert back.summary() == result.summary()


@pytest.mark.thorough
def test_every_result_has_a_short_repr_a_text_and_a_table(results):
    for name, result in results.items():
        assert len(repr(result).splitlines()) <= 2, name
        assert len(repr(result)) < 200, name
        assert "environment" not in repr(result)
        assert str(result) == result.summary()
        assert result.to_dataset().attrs["format_version"] == stored.FORMAT_VERSION
        html = result._repr_html_()
        assert "xr-wrap" in html
        assert "environment" not in html


def test_every_number_in_a_file_has_a_checksum(results, tmp_path):
    results["gain"].save(tmp_path / "a.nc")
    with h5py.File(tmp_path / "a.nc") as file:
        assert "gain" in file
        for name in file:
            bare = b"netCDF dimension but not" in file[name].attrs.get("NAME", b"")
            assert bare or file[name].fletcher32, name


def test_other_kinds_and_versions_are_refused(results, tmp_path):
    results["coverage"].save(tmp_path / "a.nc")
    with pytest.raises(Refused, match="coverage") as caught:
        mt.GainSeries.load(tmp_path / "a.nc")
    assert str(tmp_path / "a.nc") in str(caught.value)
    versions = ({"format_version": stored.FORMAT_VERSION + i} for i in (-1, 1))
    for change in (*versions, {"kind": "sweep"}, {"kind": None}):
        data = results["coverage"].to_dataset().assign_attrs(change)
        data.attrs = {key: value for key, value in data.attrs.items() if value is not None}
        write_dataset(data, tmp_path / "a.nc")
        with pytest.raises(Refused, match=r"a\.nc"):
            load(tmp_path / "a.nc")
    write_dataset(results["coverage"].to_dataset().drop_vars("gain"), tmp_path / "a.nc")
    with pytest.raises(Refused, match=r"a\.nc.*gain"):
        load(tmp_path / "a.nc")


# ---- damage --------------------------------------------------------------------------------


def loaded_or_refused(path):
    """Return the dataset of a file, None if it is refused in one line that names it."""
    try:
        return load(path).to_dataset()
    except Refused as error:
        assert str(error).startswith(str(path))
        assert "\n" not in str(error)
        return None


def test_no_flipped_bit_changes_a_number(results, tmp_path):
    """800 single bits anywhere in a file, its last 48 bytes, the digest, among them."""
    path, whole = tmp_path / "a.nc", results["coverage"].to_dataset()
    results["coverage"].save(path)
    content = path.read_bytes()
    rng = np.random.default_rng(11)
    places = [*rng.integers(0, len(content), 752), *range(len(content) - 48, len(content))]
    refused = 0
    for place in places:
        damaged = bytearray(content)
        damaged[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        found = loaded_or_refused(path)
        refused += found is None
        assert found is None or found.identical(whole), place
    assert refused == len(places)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.slow
def test_damage_of_files_without_a_digest_is_one_line_or_none(results, tmp_path):
    """Files that other tools wrote to have none: what cannot be read is refused."""
    path = tmp_path / "a.nc"
    results["forced"].save(path)
    content = path.read_bytes()[:-48]
    rng, refused = np.random.default_rng(12), 0
    for place in rng.integers(0, len(content), 200):
        damaged = bytearray(content)
        damaged[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        refused += loaded_or_refused(path) is None
    assert refused > 10


def test_cut_and_foreign_files_are_refused_in_one_line(results, tmp_path):
    path = tmp_path / "a.nc"
    results["gain"].save(path)
    content = path.read_bytes()
    for size in np.linspace(0, len(content) - 100, 40).astype(int):
        path.write_bytes(content[:size])
        assert loaded_or_refused(path) is None
    for text in (b"", b"CDF\x01", b"\x89HDF\r\n\x1a\n", b"plain text", os.urandom(5000)):
        path.write_bytes(text)
        assert loaded_or_refused(path) is None
    assert loaded_or_refused(tmp_path) is None
    assert loaded_or_refused(tmp_path / "none.nc") is None
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "fifo")
        assert loaded_or_refused(tmp_path / "fifo") is None


def test_an_empty_file_is_refused(tmp_path):
    path = tmp_path / "a.nc"
    path.touch()
    with pytest.raises(
        Refused, match=r"a\.nc: the file is empty, allowed: an undamaged netCDF file"
    ):
        load(path)


def test_a_file_changed_by_another_tool_is_read(results, tmp_path):
    """The digest goes when HDF5 writes to a file: what was meant is no damage."""
    results["coverage"].save(tmp_path / "a.nc")
    with h5py.File(tmp_path / "a.nc", "a") as file:
        file.attrs["comment"] = "looked at"
    assert read_dataset(tmp_path / "a.nc").attrs["comment"] == "looked at"


FULL_DISK = """
import resource, sys
from meshtrace.results import load
result = load(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
try:
    result.save(sys.argv[2])
except OSError as error:
    print(error)
"""


@pytest.mark.posix
@pytest.mark.process
@pytest.mark.thorough
def test_a_full_disk_keeps_the_old_file(results, tmp_path, tmp_path_factory):
    good, kept = tmp_path / "good.nc", tmp_path_factory.mktemp("kept") / "a.nc"
    good.write_bytes(b"good")
    results["coverage"].save(kept)
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, kept, good], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("\n") == 1
    assert str(good) in done.stdout
    assert good.read_bytes() == b"good"
    assert [p.name for p in tmp_path.iterdir()] == ["good.nc"]


# ---- provenance and bounds -----------------------------------------------------------------


def test_the_commit_is_that_of_a_checkout_of_this_package_only(tmp_path):
    def git(*words):
        subprocess.run(
            ["git", "-c", "user.name=a", "-c", "user.email=a@b", *words],
            cwd=tmp_path,
            check=True,
            capture_output=True,
        )

    git("init")
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "other"\n')
    git("add", ".")
    git("commit", "-m", "x")
    assert _git_commit(tmp_path) == "unknown"
    (tmp_path / "pyproject.toml").write_text('[project]\nname = "meshtrace"\n')
    assert len(_git_commit(tmp_path)) == 40
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "pyproject.toml").write_text('[project]\nname = "meshtrace"\n')
    assert _git_commit(tmp_path / "inner") == "unknown"
    assert environment()["git_commit"]


def test_no_light_is_a_bound_and_not_zero(tmp_path):
    """Rule of three: 3 / n, the 95 % limit of a Poisson mean of which none was seen."""
    far = mt.Receiver(radius=1e-4, position=(30.0, 0.0))
    link = mt.Link(receiver=far)
    dark = mt.simulate(link, FLAT, estimator="analog", photons=1000)
    assert dark.gain == 0.0
    assert dark.gain_bound == pytest.approx(3e-3)
    assert np.exp(-dark.gain_bound * 1000) == pytest.approx(0.05, rel=0.01)
    assert "dark to below 0.003 at 95 % confidence: no light received" in dark.summary()
    assert "dark to below 0.003" in repr(dark)
    dark.save(tmp_path / "a.nc")
    assert mt.GainResult.load(tmp_path / "a.nc").gain_bound == dark.gain_bound
    again = mt.simulate(link, FLAT, estimator="analog", photons=2000, first_photon=1000)
    assert mt.merge([dark, again]).gain_bound == pytest.approx(1e-3)
    both = mt.simulate(
        mt.Link(receiver=(mt.Receiver(radius=5.0), far)), FLAT, estimator="analog", photons=1000
    )
    np.testing.assert_array_equal(both.gain_bound, [np.nan, 3e-3])
    assert bound_where_dark(np.array([0.1, 0.2]), 10) is None
    assert both.gains.shape == both.stderrs.shape == (2,)
    assert dark.gains.shape == dark.stderrs.shape == (1,)


# ---- kills ---------------------------------------------------------------------------------

ENDLESS_SAVES = """
import itertools, sys
from meshtrace.results import load
result = load(sys.argv[1])
print("ready", flush=True)
for _ in itertools.count():
    result.save(sys.argv[2])
"""


@pytest.mark.parametrize("kills", [4, pytest.param(30, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_kills_while_saving_leave_a_whole_file(results, tmp_path, kills):
    good, kept, rng = tmp_path / "good.nc", tmp_path / "kept.nc", np.random.default_rng(5)
    results["gain"].save(good)
    results["gain"].save(kept)
    expected = load(kept).to_dataset()
    for _ in range(kills):
        process = subprocess.Popen(
            [sys.executable, "-c", ENDLESS_SAVES, kept, good],
            stdout=subprocess.PIPE,
        )
        assert process.stdout.readline() == b"ready\n"
        time.sleep(rng.uniform(0.0, 0.3))
        process.kill()
        process.wait()
        process.stdout.close()
        assert load(good).to_dataset().identical(expected)


class Interval(NamedTuple):
    value: float
    low: float


class Point(NamedTuple):
    name: str
    gain: Interval
    outage: bool


def test_rows_within_rows_are_columns_and_come_back():
    rows = [Point("a", Interval(1.0, 0.5), True), Point("b", Interval(2.0, 1.5), False)]
    table = stored.Columns(Point, "", "link")
    found = table.write(rows)
    assert {name: (dims, column.tolist()) for name, (dims, column) in found.items()} == {
        "link": (("link",), ["a", "b"]), "gain": (("link",), [1.0, 2.0]),
        "gain_low": (("link",), [0.5, 1.5]), "outage": (("link",), [1, 0]),
    }  # fmt: skip
    assert table.read(xr.Dataset(found), list) == rows
    assert table.read(xr.Dataset(), list) is errors.MISSING


class Place(NamedTuple):
    depth: float
    bit_rate: float
    ber: Interval


def test_rows_of_two_dimensions_have_their_coordinates():
    rows = [Place(z, b, Interval(z + b, 0.0)) for z in (10.0, 20.0) for b in (1.0, 2.0, 3.0)]
    table = stored.Columns(Place, "", "depth", "bit_rate")
    data = xr.Dataset(table.write(rows))
    assert data["ber"].sel(depth=20.0, bit_rate=3.0) == 23.0
    assert data["depth"].dims == ("depth",)
    assert table.read(data.transpose(), list) == rows


def test_a_result_has_a_line_of_text():
    class Silent(Stored):
        pass

    with pytest.raises(TypeError, match="_headline"):
        Silent()


def test_errors_of_groups_are_those_along_an_axis():
    samples = np.random.default_rng(2).normal(size=(3, 32, 4))
    expected = [[np.std(one, ddof=1) / np.sqrt(32) for one in row.T] for row in samples]
    np.testing.assert_allclose(error_of_groups(samples, 1), expected, rtol=1e-12)
    np.testing.assert_array_equal(error_of_groups(samples[0]), error_of_groups(samples, 1)[0])


def saved_series():
    gain = 1e-5 * (1.0 + np.arange(6.0))
    return mt.GainSeries("time", np.arange(6.0), gain, 0.01 * gain, gain, 1e-7)


@pytest.mark.parametrize(
    "change",
    [lambda d: d.assign(gain=d.gain.expand_dims(new=2)), lambda d: d.assign(gain=d.gain.isel(time=0, drop=True)),
     lambda d: d.isel(time=slice(0)), lambda d: d.assign(gain=d.gain.astype(str)),
     lambda d: d.assign(gain=("other", d.gain.values)), lambda d: d.assign(gain=d.gain.astype(complex)),
     lambda d: d.assign(gain=1e200 * d.gain), lambda d: d.assign_attrs(mean_stderr=1e300),
     lambda d: d.assign_attrs(kind=np.arange(3)), lambda d: d.assign_attrs(kind=5), lambda d: d.assign_attrs(kind=[]),
     lambda d: d.assign_attrs(format_version=[]), lambda d: d.assign_attrs(format_version=np.arange(3)),
     lambda d: d.assign_attrs(format_version="2"), lambda d: d.assign_attrs(provenance=5),
     lambda d: d.drop_vars("gain"), lambda d: d.assign_attrs(provenance="[")],
)  # fmt: skip
def test_forged_results_are_refused(change, tmp_path):
    """Their digest is right: once tracebacks of several kinds, when read or shown."""
    data = saved_series().to_dataset()
    write_dataset(data, tmp_path / "sound.nc")
    load(tmp_path / "sound.nc").summary()
    write_dataset(change(data), tmp_path / "forged.nc")
    with pytest.raises(Refused, match=r"forged.nc: "):
        load(tmp_path / "forged.nc")


@pytest.mark.parametrize("kind", ["coverage", "fading"])
def test_forged_results_with_other_dimensions_are_refused(kind, tmp_path):
    """Once read, and an IndexError in their summary."""
    if kind == "coverage":
        axis = np.arange(3.0)
        result = mt.CoverageMap(axis, axis, np.ones((3, 3)), 0.1 * np.ones((3, 3)))
        data = result.to_dataset()
        data = data.assign(gain_stderr=data["gain_stderr"].isel(y=0, drop=True))
    else:
        gain = 1.0 + 0.1 * np.random.default_rng(3).random(50)
        series = mt.GainSeries("realization", np.arange(50), gain, 0.01 * gain, gain, 1e-3)
        data = series.fading().to_dataset().drop_vars("outage_high")
    path = tmp_path / "forged.nc"
    write_dataset(data, path)
    with pytest.raises(Refused, match=r"of dimensions|no variable outage_high beside outage"):
        load(path)


@pytest.mark.thorough
@pytest.mark.parametrize("share", ["none", None, 2.0, []])
def test_a_forged_share_of_tilts_is_refused(share, results, tmp_path):
    """Once read, and a ValueError in the summary."""
    data = results["performance"].to_dataset()
    provenance = {**json.loads(data.attrs["provenance"]), "tilt_outage": share}
    write_dataset(data.assign_attrs(provenance=json.dumps(provenance)), tmp_path / "forged.nc")
    with pytest.raises(Refused, match="tilt_outage"):
        load(tmp_path / "forged.nc")


@pytest.mark.parametrize(
    ("kind", "change"),
    [("inference", lambda d: d.assign(inferred_unit=d.inferred_unit.astype("S4"))),
     ("markov-channel", lambda d: d.isel(threshold=slice(1))),
     ("markov-channel", lambda d: d.isel(next_state=slice(1))),
     ("trace", lambda d: d.drop_vars("down_gain_mean_stderr")),
     ("sensitivity", lambda d: d.assign(sensitivity_second=xr.full_like(d.sensitivity_second, 1e300))),
     ("sensitivity", lambda d: d.assign(sensitivity_base=d.sensitivity_base.isel(parameter=0, drop=True))),
     ("fading", lambda d: d.assign(scintillation_index_high=("new", [1.0])))],
)  # fmt: skip
def test_forged_columns_and_parts_are_refused(kind, change, results, tmp_path):
    """Once read, and a traceback in the summary or numbers that no study writes."""
    write_dataset(change(results[kind].to_dataset()), tmp_path / "forged.nc")
    with pytest.raises(Refused, match=r"forged.nc: "):
        load(tmp_path / "forged.nc")
