"""Sweeps: inputs, kept points and refusals, without processes."""

from __future__ import annotations

import json
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from typer.testing import CliRunner

import meshtrace as mt
from meshtrace import cli
from meshtrace.errors import Refused
from meshtrace.scenario import Scenario
from meshtrace.studies import sweep, sweep_file, sweeps
from meshtrace.studies.cluster import Cluster
from meshtrace.studies.sweeps import Sweep, Task, read_study
from meshtrace.surfaces import FlatSea, JonswapSea, MeshSequence, SinusoidalSea

dask = pytest.importorskip("dask")
distributed = pytest.importorskip("distributed")

FLAT = {"spectrum": "flat"}


@pytest.fixture(scope="module")
def address():
    """Scheduler of one worker in a thread of this process."""
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0"
    ) as cluster:
        yield cluster.scheduler_address


def run(parameters, address, **options):
    options = {
        "surface": FLAT, "rtol": None, "photons": 64, "workers": address,
        **options,
    }  # fmt: skip
    return sweep(options.pop("link", mt.Link()), parameters, **options)


def study(parameters, **options):
    link = {"sea": FLAT, "bubbles": "none", "run": {"photons": 64}}
    defaults = {"realizations": 1, "rtol": None, "photons": None, "seed": 1, **options}
    return Sweep(Scenario.from_config(link).to_toml(), parameters, **defaults)


def test_tasks_cover_all_points_and_realizations():
    asked = study(
        {"wind_speed": [5.0, 13.0], "water.b": [0.1, 0.2, 0.3]}, realizations=sweeps.BLOCK + 3
    )
    tasks = list(asked.tasks())
    assert len(set(tasks)) == len(tasks) == 2 * 3 * 2
    hits = np.zeros((2, 3, sweeps.BLOCK + 3), int)
    for task in tasks:
        hits[task.region] += 1
    assert (hits == 1).all()
    assert asked.changes(Task((1, 2), 0, 1)) == {"wind_speed": 13.0, "water.b": 0.3}


def test_point_is_the_run_of_its_scenario():
    asked = study({"transmitter.depth": [6.0]}, seed=5)
    outcome = asked.compute(Task((0,), 0, 1))
    link = mt.Link(transmitter=mt.Led(depth=6.0))
    whitecaps = Scenario.from_config({}).link.whitecaps
    link = link.model_copy(update={"whitecaps": whitecaps})
    flat = Scenario.from_config({"sea": FLAT}).surface
    single = mt.simulate(link, flat, photons=64, seed=5, threads=1)
    assert outcome[0][0, :-1].tolist() == [
        single.gain,
        single.gain_stderr,
        single.gain_ballistic,
    ]
    assert outcome[1] == '[""]'


def test_realizations_are_those_of_an_ensemble():
    # unscattered light has no Monte Carlo error where no slopes are random
    link = {
        "physics": {"unresolved": "none"},
        "bubbles": "none",
        "whitecaps": "none",
        "run": {"photons": 64},
    }
    asked = Sweep(Scenario.from_config(link).to_toml(), {"water.b": [0.0]}, 3, None, None, 4)
    outcome = asked.compute(Task((0,), 0, 3))
    smooth = mt.Link(water=mt.Water(b=0.0), physics=mt.Physics(unresolved="none"))
    several = mt.ensemble(smooth, 3, photons=64, seed=4)
    np.testing.assert_allclose(outcome[0][:, 2], several.gain_ballistic, rtol=1e-12)


def test_points_share_their_random_numbers():
    asked = study({"transmitter.power_mw": [1.0, 2.0]})
    first, second = (asked.compute(task)[0] for task in asked.tasks())
    np.testing.assert_array_equal(
        first[:, :-1], second[:, :-1]
    )  # the gain is relative to the power


def test_failing_point_is_reported_in_one_line(address):
    data = run({"transmitter.depth": [10.0, -1.0, 0.001]}, address, surface={"spectrum": "jonswap"})
    errors = data["error"].values[:, 0]
    assert errors[0] == ""
    assert errors[1] == "transmitter.depth: -1.0, allowed: 0 < depth <= 12000"
    assert "depth: 0.001 m, allowed" in errors[2]
    assert np.isfinite(data["gain"].values[:, 0]).tolist() == [True, False, False]


def test_coordinates_are_the_parameters(address):
    parameters = {
        "transmitter.depth": np.array([5.0, 10.0]),
        "water.type": ["jerlov-I", "jerlov-IB"],
        "receiver.position": [(0.0, 0.0), (0.5, 0.0)],
    }
    data = run(parameters, address)
    assert data["gain"].dims == (*parameters, "realization")
    assert data["transmitter.depth"].values.tolist() == [5.0, 10.0]
    assert data["transmitter.depth"].attrs["units"] == "m"
    assert data["water.type"].values.tolist() == ["jerlov-I", "jerlov-IB"]
    assert data["receiver.position"].values.tolist() == ["[0.0, 0.0]", "[0.5, 0.0]"]
    assert data["gain"].attrs["units"] == "1"
    assert (data["gain"] > data["gain_ballistic"]).all()
    assert (data["seconds"] > 0.0).all()
    assert json.loads(data.attrs["identity"])["parameters"]["transmitter.depth"] == [5.0, 10.0]


def test_sweep_writes_netcdf(address, tmp_path):
    data = run({"water.type": ["jerlov-I"]}, address)
    data.to_netcdf(tmp_path / "sweep.nc", engine="h5netcdf")


def test_list_of_receivers_is_a_dimension(address):
    link = mt.Link(receiver=(mt.Receiver(), mt.Receiver(position=(1.0, 0.0))))
    data = run({"water.b": [0.01, 0.03]}, address, link=link, realizations=2)
    assert data["gain"].shape == (2, 2, 2)
    assert data["gain"].dims[-1] == "receiver"
    assert data["seconds"].shape == (2, 2)


def test_analog_points_have_no_unscattered_part(address):
    link = {"bubbles": "none", "run": {"estimator": "analog"}, "receiver": {"radius": 2.0}}
    data = run({"water.b": [0.01]}, address, link=link, photons=4096)
    assert np.isnan(data["gain_ballistic"]).all()
    assert (data["gain"] > 0.0).all()


def test_tolerance_is_met(address):
    data = run({"water.b": [0.037, 0.2]}, address, rtol=0.003, photons=None)
    assert (data["gain_stderr"] <= 0.003 * data["gain"]).all()


def test_sea_is_taken_as_it_is(address):
    wave = SinusoidalSea(amplitude=0.05, wavelength=4.0)
    data = run({"water.b": [0.0]}, address, surface=wave)
    single = mt.simulate(mt.Link(water=mt.Water(b=0.0)), wave, photons=64)
    assert float(data["gain_ballistic"][0, 0]) == single.gain_ballistic


def test_water_follows_the_swept_chlorophyll_and_wavelength(address):
    wave = SinusoidalSea(amplitude=0.05, wavelength=4.0)
    data = run({"water.chlorophyll": [0.0, 1.0]}, address, surface=wave)
    for i, chlorophyll in enumerate((0.0, 1.0)):
        spectrum = mt.optics.Constituents(chlorophyll=chlorophyll)
        link = mt.Link(water=mt.Water(spectrum=spectrum, wavelength_nm=470.0))
        assert float(data["gain"][i, 0]) == mt.simulate(link, wave, photons=64).gain
    link = mt.Link(water=mt.Water.from_type("jerlov-II"))
    data = run({"transmitter.wavelength_nm": [470.0, 550.0]}, address, surface=wave, link=link)
    green = mt.simulate(link.at_wavelength(550.0), wave, photons=64)
    assert float(data["gain"][1, 0]) == green.gain


def test_meshes_from_files_are_a_surface(address, tmp_path):
    wave = SinusoidalSea(amplitude=0.05, wavelength=4.0)
    wave.mesh(extent=16.0, spacing=0.5).to_trimesh().export(tmp_path / "wave_0.ply")
    meshes = MeshSequence(str(tmp_path / "wave_*.ply"))
    data = run({"water.b": [0.0]}, address, surface=meshes)
    single = mt.simulate(mt.Link(water=mt.Water(b=0.0)), meshes, photons=64)
    assert float(data["gain_ballistic"][0, 0]) == single.gain_ballistic


def test_link_alone_goes_with_a_sea_that_follows_the_wind(address):
    data = run({"wind_speed": [5.0, 13.0]}, address, surface=None)
    for i, wind_speed in enumerate((5.0, 13.0)):
        single = mt.simulate(mt.Link(), JonswapSea(wind_speed=wind_speed), photons=64)
        assert float(data["gain"][i, 0]) == single.gain


def test_finished_points_are_read_not_computed(address, tmp_path):
    store = tmp_path / "depths.store"
    first = run({"water.b": [0.0, 0.1]}, address, store=store)
    second = run({"water.b": [0.0, 0.1]}, 1, store=store)
    assert first.identical(second)  # seconds included: nothing ran


def test_task_lost_with_its_worker_is_reported_and_stays_to_be_done(address, tmp_path, monkeypatch):
    store, parameters = tmp_path / "lost.store", {"water.b": [0.0, 0.1]}
    evaluate = Cluster.map

    def dying(self, setup, jobs):
        for i, found in evaluate(self, setup, jobs):
            yield i, RuntimeError("its worker died") if i == 0 else found

    with monkeypatch.context() as patch:
        patch.setattr(Cluster, "map", dying)
        data = run(parameters, address, store=store)
    lost, other = data["error"].values[:, 0]
    assert lost == "RuntimeError: its worker died"
    assert other == ""
    assert np.isnan(sweeps.read_store(store)["gain"].values[:, 0]).tolist() == [True, False]
    again = run(parameters, address, store=store)  # by the next call
    assert (again["error"] == "").all()
    assert again["seconds"].values[1] == data["seconds"].values[1]


def test_other_version_in_the_store_is_refused(address, tmp_path, monkeypatch):
    store = tmp_path / "depths.store"
    with monkeypatch.context() as patch:
        patch.setattr("meshtrace.studies.store.version", lambda name: "0.0.1")
        run({"water.b": [0.0]}, address, store=store)
    with pytest.raises(ValueError, match=r"store: .*meshtrace: '0\.0\.1' there"):
        run({"water.b": [0.0]}, address, store=store)


def test_other_sweep_in_the_store_is_refused(address, tmp_path):
    store = tmp_path / "depths.store"
    run({"water.b": [0.0, 0.1]}, address, store=store)
    with pytest.raises(ValueError, match=r"store: .*seed: 1 there, 2 here.*allowed"):
        run({"water.b": [0.0, 0.1]}, address, store=store, seed=2)
    with pytest.raises(ValueError, match=r"parameters\.water\.b: \[0\.0, 0\.1\] there"):
        run({"water.b": [0.0]}, address, store=store)


@pytest.mark.parametrize("content", ["precious\n", "", None])
def test_file_that_is_no_store_is_refused(address, tmp_path, content):
    path = tmp_path / "thesis"
    path.mkdir() if content is None else path.write_text(content)
    with pytest.raises(ValueError, match=r"store: .*thesis'.*, allowed: one, or a new path"):
        run({"water.b": [0.0]}, address, store=path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis"]
    assert content is None or path.read_text() == content


@pytest.mark.parametrize(
    ("parameters", "options", "message"),
    [
        ({}, {}, r"parameters: none, allowed"),
        ({"water.b": []}, {}, r"water\.b: \[\], allowed"),
        ({"water.b": 0.1}, {}, r"parameters\.water\.b: 0\.1, allowed: a list"),
        ({"water.bb": [0.1, 0.2]}, {}, r"water\.bb: 0\.1, no such key"),
        ({"water.b": [-1.0, -2.0]}, {}, r"water\.b: -1\.0, allowed"),
        ({"water.b": [0.1]}, {"realizations": 0}, r"realizations: 0, allowed"),
        ({"water.b": [0.1]}, {"realizations": 1.5}, r"realizations: 1\.5, allowed"),
        ({"water.b": [0.1]}, {"seed": -1}, r"seed: -1, allowed"),
        ({"water.b": [0.1]}, {"rtol": 2.0}, r"run\.rtol: 2\.0, allowed"),
        ({"water.b": [0.1]}, {"photons": 0}, r"run\.photons: 0, allowed"),
        ({"water.b": [0.1]}, {"workers": 0}, r"workers: 0, allowed"),
    ],
)
def test_wrong_arguments_are_named(parameters, options, message):
    with pytest.raises(ValueError, match=message):
        run(parameters, "tcp://127.0.0.1:1", **options)


def test_progress_counts_finished_and_kept_points(address, tmp_path):
    for values, kept in (([0.0, 0.1], 0), ([0.0, 0.1], 2)):
        told = []
        run({"water.b": values}, address, store=tmp_path / "a.store", progress=told.append)
        assert told == [1] * len(values), kept


def test_missing_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(Refused, match=r"workers: distributed is not installed.*meshtrace\[batch\]"):
        sweep(mt.Link(), {"water.b": [0.1]})


def write_study(folder, text):
    path = folder / "study.toml"
    path.write_text(text)
    return path


def test_study_file_is_a_link_file_with_a_sweep(address, tmp_path):
    path = write_study(
        tmp_path,
        """
        bubbles = "none"
        [sea]
        spectrum = "flat"
        [run]
        seed = 7
        photons = 64
        [sweep]
        rtol = 1.0
        store = "kept.store"
        [sweep.parameters]
        transmitter.depth = [5.0, 10.0]
        "receiver.height" = [4.0]
        """,
    )
    data = sweep_file(path, workers=address)
    assert data["gain"].dims == ("transmitter.depth", "receiver.height", "realization")
    identity = json.loads(data.attrs["identity"])
    assert (identity["seed"], identity["photons"], identity["rtol"]) == (7, 64, 1.0)
    assert (tmp_path / "kept.store").is_file()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("wind_speed = 5.0", r"sweep: missing, allowed: a table"),
        ("[sweep]\nseeds = 3", r"sweep\.seeds: 3, no such key"),
        ("[sweep", r"allowed: TOML"),
        ("[sweep]\n[sweep.parameters]\nwind_speed = 5.0", r"parameters: 5\.0, allowed: a list"),
        ("wind = 5.0\n[sweep]", r"wind: 5\.0, no such key"),
    ],
)
def test_wrong_study_files_are_reported_in_one_line(tmp_path, text, message):
    with pytest.raises(ValueError, match=message) as caught:
        sweep_file(write_study(tmp_path, text))
    assert "\n" not in str(caught.value)


def sweep_command(*arguments):
    return CliRunner().invoke(cli.app, ["sweep", *map(str, arguments)])


def test_command_prints_a_row_for_each_point_and_keeps_all(address, tmp_path):
    text = """
        bubbles = "none"
        sea.spectrum = "flat"
        run.photons = 64
        [sweep]
        rtol = 1.0
        realizations = 2
        [sweep.parameters]
        "transmitter.depth" = [5.0, -1.0]
        "water.type" = ["jerlov-I", "jerlov-IB"]
    """
    path, kept = write_study(tmp_path, text), tmp_path / "kept.nc"
    result = sweep_command(path, "--workers", address, "-o", kept)
    assert result.exit_code == 1, result.stderr  # as some points failed
    head, _, *rows = result.stdout.split("\n\n")[0].splitlines()
    assert head.split() == ["transmitter.depth", "water.type", "gain", "stderr", "scatter"]
    assert [row.split()[:2] for row in rows] == [
        [depth, water] for depth in ("5", "-1") for water in ("jerlov-I", "jerlov-IB")
    ]
    assert "warning: 4 of 8 runs failed, the first: transmitter.depth: -1.0" in result.stderr
    assert (tmp_path / "study.store").is_file()  # beside the study, without being asked
    with xr.open_dataset(kept, engine="h5netcdf") as data:
        gain = data["gain"].values[0, 0]
        chains = data["gain_stderr"].values[0, 0]
    assert rows[0].split()[2] == f"{gain.mean():.4e}"
    assert rows[0].split()[3] == f"{np.hypot(*chains) / 2:.1e}"
    assert rows[0].split()[4] == f"{gain.std(ddof=1):.1e}"


def test_command_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "distributed", None)
    result = sweep_command(write_study(tmp_path, "[sweep.parameters]\nwind_speed = [5.0]"))
    assert result.exit_code == 2
    assert result.stderr.splitlines()[-1].endswith('pip install "meshtrace[batch]"')
    assert result.stderr.count("error") == 1


def test_scheduler_that_is_none_is_reported_in_one_line(tmp_path):
    path = write_study(tmp_path, "[sweep.parameters]\nwind_speed = [5.0]")
    result = sweep_command(path, "--workers", "nonsense")
    assert result.exit_code == 2
    assert "error: --workers: 'nonsense'" in result.stderr


@pytest.mark.thorough
def test_point_without_light_ends(address):
    # a lamp that shines past the receiver: no number of chains reaches a relative error
    link = {"bubbles": "none", "receiver": {"position": [40.0, 0.0], "fov_deg": 5.0}}
    data = run({"water.b": [0.0]}, address, link=link, rtol=0.01, photons=64)
    assert data["gain"].values.tolist() == [[0.0]]
    assert data["error"].values.tolist() == [[""]]


def test_study_of_the_examples_is_allowed():
    path = Path(__file__).parents[2] / "examples" / "study.toml"
    assert read_study(path)[1] == path.with_name("study.store")
    config = tomllib.loads(path.read_text())
    table = config.pop("sweep")
    asked = Sweep(
        Scenario.from_config(config).to_toml(),
        dict(table["parameters"]),
        table["realizations"],
        table["rtol"],
        None,
        table["seed"],
    )
    asked.check()
    assert len(list(asked.tasks())) == 12


def test_missing_study_file_is_reported(tmp_path):
    with pytest.raises(ValueError, match=r"No such file"):
        sweep_file(tmp_path / "none.toml")


def test_settings_of_dask_are_left_alone(address):
    before = dask.config.get("scheduler", None)
    run({"water.b": [0.0]}, address, link={"bubbles": "none"}, photons=64)
    assert dask.config.get("scheduler", None) == before
    with dask.config.set(scheduler="dask.distributed"):  # of a client that has closed
        run({"water.b": [0.0]}, address, link={"bubbles": "none"}, photons=64)


def test_a_point_has_the_gains_of_all_wavelengths(address, tmp_path):
    link, at = mt.Link(water=mt.Water.from_type("jerlov-IB")), [450.0, 500.0]
    options = {"link": link, "wavelengths_nm": at, "store": tmp_path / "sweep.store"}
    found = run({"transmitter.depth": [5.0, 8.0]}, address, **options)
    assert found["gain"].dims == ("transmitter.depth", "realization", "wavelength")
    for i, depth in enumerate(found["transmitter.depth"].values):
        there = mt.simulate(link.at_depth(depth), FlatSea(), photons=64, wavelengths_nm=at)
        np.testing.assert_array_equal(found["gain"][i, 0], there["gain"][:, 0])
    again = run({"transmitter.depth": [5.0, 8.0]}, "tcp://127.0.0.1:1", **options)
    assert again.equals(found)
    assert again.equals(sweeps.read_store(tmp_path / "sweep.store"))
    with pytest.raises(Refused, match="no wavelength among the parameters"):
        run({"transmitter.wavelength_nm": [450.0]}, address, **options)


def test_a_study_file_of_wavelengths_by_day(address, tmp_path):
    text = """
    [sea]
    spectrum = "flat"
    [water]
    type = "jerlov-IB"
    [daylight]
    model = "night"
    [sweep]
    photons = 64
    wavelengths_nm = [450.0, 500.0]
    [sweep.parameters]
    transmitter.depth = [5.0]
    """
    path = tmp_path / "study.toml"
    path.write_text(text)
    found = sweep_file(path, workers=address)
    assert not found["error"].item()
    assert found["ber"].shape == (1, 1, 2)
    assert (found["background_radiance"] > 0.0).all()
