"""Measurements of speed: contents and refusals; no bound on any time."""

import copy
import json
import time

import bench as room
import pytest
import works
from bench import bench, compare, report
from clocks import best_of, of_command
from works import (
    analog_rate,
    background_light,
    counts_up_to,
    coverage_cost,
    figure_of_merit,
    makespan,
    new_sea,
    realization,
    resolved_sea,
    speedup_by_jobs,
    thread_scaling,
    to_tolerance,
    worker_scaling,
)

import meshtrace as mt
from meshtrace import parallel
from meshtrace.engine.setup import ends, meshing
from meshtrace.parallel import ordered_map
from meshtrace.scenario import Scenario
from meshtrace.surfaces import FlatSea, JonswapSea

LINK = mt.Link()
SEA = JonswapSea(seed=3, waves="paper")


@pytest.fixture(scope="module")
def meshes():
    return meshing.mesh_for(LINK, SEA)[0], meshing.mesh_for(
        LINK, SEA, reach=ends.crossing_reach(LINK)
    )[0]


@pytest.fixture(scope="module")
def threads(meshes):
    return thread_scaling(LINK, *meshes, photons=20_000, chains=256, rounds=1, most=3)


def test_counts_are_powers_of_two_and_the_largest():
    assert [counts_up_to(n) for n in (1, 2, 3, 8, 12)] == [
        [1],
        [1, 2],
        [1, 2, 3],
        [1, 2, 4, 8],
        [1, 2, 4, 8, 12],
    ]


def test_thread_scaling_is_relative_to_one_thread(threads):
    assert threads["threads"] == [1, 2, 3]
    for rate, speedup in (
        ("photons_per_s", "analog_speedup"),
        ("chains_per_s", "forced_speedup"),
    ):
        assert threads[speedup][0] == 1.0
        assert threads[speedup] == pytest.approx([r / threads[rate][0] for r in threads[rate]])


def test_rays_of_a_small_tank_are_recorded():
    link = LINK.replace("transmitter.depth", 0.1).replace("receiver.height", 0.1)
    found = analog_rate(link, FlatSea().mesh(extent=1.0, spacing=0.02), photons=2_000, rounds=1)
    assert found["rays_per_photon"] > 0.5


def test_time_on_other_processes_does_not_count():
    """A job that sleeps stands for one that waits for its turn on a busy machine."""
    assert best_of(1, lambda: time.sleep(0.2))[0] < 0.1
    assert best_of(1, lambda: time.sleep(0.2), clock=time.perf_counter)[0] >= 0.2


@pytest.mark.thorough
def test_ratios_are_those_of_cpu_time(meshes, monkeypatch):
    """Rays that wait for 0.3 s beside milliseconds of work leave the ratio as it is."""
    quiet = analog_rate(LINK, meshes[0], photons=20_000, rounds=2)["ratio"]
    cast = works.replay
    monkeypatch.setattr(works, "replay", lambda *work: (time.sleep(0.3), cast(*work)))
    assert analog_rate(LINK, meshes[0], photons=20_000, rounds=2)["ratio"] < 2.0 * quiet


def test_jobs_go_to_the_first_free_thread():
    assert makespan([3.0, 1.0, 1.0, 1.0], 2) == 3.0
    assert makespan([1.0, 1.0, 1.0, 3.0], 2) == 4.0
    assert makespan([1.0, 1.0], 16) == 1.0
    assert makespan([], 2) == 0.0


def test_jobs_of_one_thread_are_timed():
    with parallel.job_times() as rows:
        assert list(ordered_map(abs, [-1, 2], threads=1)) == [1, 2]
        assert list(ordered_map(abs, [-3], threads=1)) == [3]
        assert list(ordered_map(abs, [-3], threads=2)) == [3]
    assert [len(row) for row in rows] == [2, 1]
    assert list(ordered_map(abs, [-1], threads=1)) == [1]
    assert [len(row) for row in rows] == [2, 1]


def test_speedup_by_jobs_follows_from_their_times(threads):
    def busy(n):
        return sum(i * i for i in range(n))

    found = speedup_by_jobs(lambda: list(ordered_map(busy, [300_000] * 8, threads=1)), (1, 2, 4))
    assert found["jobs"] == 8
    assert 0.0 <= found["serial"] < 0.5
    assert found["speedup"][0] == pytest.approx(1.0, rel=1e-6)
    assert 1.0 < found["speedup"][1] <= 2.0 + 1e-9
    assert found["speedup"][1] < found["speedup"][2] <= 4.0 + 1e-9
    for kind in ("analog_by_jobs", "forced_by_jobs"):
        assert threads[kind]["threads"] == [2, 16]
        assert threads[kind]["jobs"] > 0


def test_samples_double_until_the_tolerance_is_reached():
    samples, found = to_tolerance(lambda n: {"rtol": n**-0.5, "drawn": n + 7}, 64, 0.05)
    assert (samples, found["drawn"]) == (512, 519)
    assert to_tolerance(lambda n: {"rtol": 1.0}, 64, 0.05, most=100)[0] == 128


@pytest.mark.slow
def test_worker_scaling_runs_a_sweep():
    pytest.importorskip("distributed")
    found = worker_scaling(Scenario.from_config({"bubbles": "none"}), 8, chains=64, most=1)
    assert found["workers"] == [1]
    assert found["speedup"] == [1.0]
    assert found["realizations_per_s"][0] > 0.0


@pytest.fixture(scope="module")
def measured(meshes, threads):
    """Return what `bench` returns, of a few photons."""
    return {
        "environment": {},
        "cores": 2,
        "load": 3.25,
        "analog": analog_rate(LINK, meshes[0], photons=20_000, rounds=1),
        "analog_tilted": analog_rate(LINK, meshes[0], photons=20_000, rounds=1),
        "merit": figure_of_merit(LINK, meshes[1], 256, 50_000, rounds=1, seeds=3),
        "new_sea": new_sea(LINK, SEA, rtol=0.2, rounds=1),
        "resolved_sea": resolved_sea(LINK, SEA, rtol=0.2, rounds=1, realizations=2),
        "realization": realization(LINK, SEA, chains=64, realizations=2),
        "background": background_light(LINK, SEA, rtol=0.5),
        "first_run": {
            "seconds": 7.0,
            "cpu_seconds": 12.34,
            "warm_seconds": 1.1,
            "warm_cpu_seconds": 1.26,
        },
        "downlink": new_sea(LINK.mirrored(), SEA, rtol=0.2, rounds=1),
        "coverage": coverage_cost(LINK, SEA, extent=0.2, rtol=0.2),
        "fine_coverage": coverage_cost(LINK, SEA, extent=0.2, rtol=0.1),
        "peak_memory_mib": 1.0,
        "thread_scaling": threads,
        "worker_scaling": {
            "workers": [1, 2],
            "realizations": 8,
            "realizations_per_s": [4.0, 7.0],
            "speedup": [1.0, 1.75],
        },
    }


@pytest.mark.thorough
def test_report_names_every_measurement(measured, threads):
    text = report(measured)
    assert "2: 1.75x (8 seas" in text
    merit = measured["merit"]
    assert f"scatter over stated error {merit['scatter_over_error']:.2f}" in text
    assert f"3: {threads['analog_speedup'][2]:.2f}x" in text
    assert "7.0 s (12.3 CPU s) with compilation, 1.1 s (1.3 CPU s) afterwards" in text
    assert f"{measured['new_sea']['kept_seconds']:.3f} with chains that are kept" in text
    assert text.startswith("load  ")
    assert "3.2 on 2 cores before; CPU seconds of one thread" in text
    for name in ("realization", "background", "coverage"):
        assert f"{name} to {measured[name]['rtol']:.2%}" in text
        assert measured[name]["cpu_seconds"] > 0.0
    assert f"fine coverage to {measured['fine_coverage']['rtol']:.2%}" in text
    refused = dict.fromkeys(("background", "coverage", "fine_coverage", "first_run", "downlink"))
    assert "coverage" not in report({**measured, **refused})
    assert 'pip install "meshtrace[batch]"' in report({**measured, "worker_scaling": None})


@pytest.mark.slow
def test_bench_measures_all_of_it(monkeypatch, measured):
    monkeypatch.setattr("bench.worker_scaling", lambda scenario, seas: seas)
    first = measured["first_run"]
    monkeypatch.setattr("bench.first_run", lambda: first)
    short = {"cpu_seconds": 1.0}
    for name in ("background_light", "coverage_cost", "realization"):
        monkeypatch.setattr(f"bench.{name}", lambda link, sea, **options: short)
    found = bench(Scenario.from_config({"bubbles": "none"}), quick=True, cold=True)
    assert found["first_run"] == first
    assert set(found) == set(measured)
    assert found["load"] >= 0.0
    assert found["worker_scaling"] == 32
    assert found["analog"]["ratio"] > 0.0
    assert 0.0 < found["merit"]["ratio"] < found["merit"]["ratio_kept"]
    json.dumps(found)


@pytest.mark.thorough
def test_program_writes_what_was_measured(tmp_path, monkeypatch, capsys, measured):
    asked = []
    monkeypatch.setattr("bench.bench", lambda s, **o: asked.append(o) or measured)
    path = tmp_path / "bench.json"
    room.main(["--quick", "-o", str(path)])
    assert json.loads(path.read_text()) == measured
    assert capsys.readouterr().out == report(measured) + "\n"
    assert asked == [{"quick": True, "cold": False}]


def test_timed_processes_start_in_no_hostile_folder(tmp_path, monkeypatch):
    """They once started in the temporary folder of all users."""
    for name in ("json", "numpy", "meshtrace"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('code of the folder ran')")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    of_command("-c", "import meshtrace, numpy, json")


def exit_of(capsys, *words):
    """Return the exit code, the output and the errors of the program."""
    try:
        room.main([str(word) for word in words])
    except SystemExit as done:
        return (done.code, *capsys.readouterr())
    return (0, *capsys.readouterr())


def test_works_are_compared_in_rays_of_their_run(measured):
    """A processor of half the speed changes no ratio; a slower work is named."""
    half = copy.deepcopy(measured)
    for name in ("analog", "analog_tilted"):
        for key in ("photons_per_s", "rays_per_s"):
            half[name][key] *= 0.5
    works = {
        **dict.fromkeys(("new_sea", "downlink"), "seconds"),
        **dict.fromkeys(("realization", "background", "coverage", "fine_coverage"), "cpu_seconds"),
        "resolved_sea": "seconds_per_realization",
    }
    for name, key in works.items():
        half[name][key] *= 2.0
    for key in ("setup_seconds", "forced_seconds"):
        half["merit"][key] *= 2.0
    table, slower = compare(half, measured)
    ratios = [line.split()[-1] for line in table.splitlines()[2:]]
    assert ratios == ["1.000"] * 11
    assert slower == []
    half["new_sea"]["seconds"] *= 1.16
    half["realization"]["cpu_seconds"] *= 1.14
    assert compare(half, measured)[1] == ["new sea seconds"]
    earlier = {name: row for name, row in measured.items() if name != "fine_coverage"}
    assert len(compare(half, earlier)[0].splitlines()) == 12
    assert len(compare({**half, "coverage": None}, measured)[0].splitlines()) == 12


def test_program_fails_where_a_work_is_slower(tmp_path, monkeypatch, capsys, measured):
    monkeypatch.setattr("bench.bench", lambda s, **o: measured)
    old = copy.deepcopy(measured)
    old["downlink"]["seconds"] *= 0.8
    path = tmp_path / "old.json"
    for before, code in ((measured, 0), (old, 1)):
        path.write_text(json.dumps(before))
        done = exit_of(capsys, "--compare", path)
        assert done[0] == code
    assert done[2] == "slower by more than 15%: downlink seconds\n"
    for text in ("{}", "[1]", "no JSON"):
        path.write_text(text)
        code, _, errors = exit_of(capsys, "--compare", path)
        assert code == 2
        assert errors.startswith(("error: --compare: ", "error: compare: "))


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ('[sea]\nspectrum = "flat"\n', [], "sea: "),
        ("", ["--output", "/nowhere/at/all.json"], "[Errno 2]"),
    ],
)
def test_what_cannot_be_measured_is_one_line(tmp_path, capsys, text, options, message):
    link = tmp_path / "link.toml"
    link.write_text(text)
    code, output, errors = exit_of(capsys, link, *options)
    assert (code, output) == (2, "")
    assert errors.startswith(f"error: {message}")
    assert errors.count("\n") == 1
