"""The reference case W2A-1: its own numbers, the example, and the score of other programs."""

import csv
import runpy
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mc_statistics import sidak
from scipy.stats import t
from typer.testing import CliRunner
from w2a1_quadrature import unscattered

from meshtrace import cli
from meshtrace.apps import w2a1
from meshtrace.validation import Check

EXAMPLE = Path(__file__).parents[2] / "examples" / "w2a1"


def perfect_rows():
    """Return the rows of a program that meets the reference."""
    case = w2a1.reference()
    for name, row in case["cases"].items():
        yield name, "", row["unscattered"], row["total"], row["total_stderr"]
    for name, row in case["series_frozen_phases"].items():
        # totals about the right spread: two values
        spread = row["total_rel_std"] * np.sqrt((row["n"] - 1) / row["n"])
        for i, gain in enumerate(row["unscattered_gain"]):
            side = 0 if i == row["n"] - 1 else 1 - 2 * (i % 2)
            factor = np.sqrt(row["n"] / (row["n"] - 1))
            yield name, row["t0"] + i * row["dt"], gain, 1.0 + side * factor * spread, ""


def write(path, rows, more=()):
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("case", "time", "unscattered", "total", "total_stderr", *more))
        writer.writerows(rows)
    return path


def scored(path):
    done = subprocess.run(
        [sys.executable, EXAMPLE / "score.py", path], capture_output=True, text=True, check=False
    )
    return done.stdout + done.stderr


def test_the_example_holds_the_same_case():
    packaged = Path(w2a1.__file__).with_name("w2a1.json")
    assert (EXAMPLE / "w2a1.json").read_bytes() == packaged.read_bytes()
    case = w2a1.reference()
    assert w2a1.STEPS == len(case["cases"]) + len(case["series_frozen_phases"])


def test_score_of_a_perfect_program_and_of_a_wrong_one(tmp_path):
    rows = list(perfect_rows())
    assert scored(write(tmp_path / "a.csv", rows)).splitlines()[-1] == "score 44 of 44"
    rows[0] = (*rows[0][:2], 1.01 * rows[0][2], 1.002 * rows[0][3], 0.01 * rows[0][3])
    rows[26] = (*rows[26][:2], 1.01 * rows[26][2], rows[26][3], "")
    lines = scored(write(tmp_path / "b.csv", rows)).splitlines()
    failed = [line.split()[1:3] for line in lines if line.startswith("FAIL")]
    name = rows[0][0]
    assert failed == [[name, "unscattered"], [name, "total"], ["jonswap5/series", "unscattered"]]
    assert lines[-1] == "score 41 of 44"
    wrong = [("flat/default", "", 4.7e-05, "", "", error) for error in (2e-07, 4e-07)]
    heads = ("unscattered_stderr",)
    far, vague = (scored(write(tmp_path / "e.csv", [row], heads)) for row in wrong)
    assert "FAIL  flat/default unscattered" in far
    assert "error beyond 0.5 %" in vague
    short = scored(write(tmp_path / "c.csv", [("flat/default", "", 4.51666165e-05, "", "")]))
    assert short.splitlines()[-1] == "score 1 of 1"
    assert "allowed: a case or series" in scored(write(tmp_path / "d.csv", [("x", "", 1, 1, 1)]))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name,gain\nflat/default,1\n", "case: None, allowed: a case or series"),
        ("case,unscattered\nflat/default,bright\n", "unscattered: 'bright', allowed: a number"),
        ("case,unscattered\nflat/default,1\nflat/default,1\n", "case: 'flat/default', allowed: once"),
        ("case,time,total\njonswap5/series,,1\n", "time: '', allowed: 0 + k 0.5 s"),
        ("case,time,total\njonswap5/series,0.3,1\n", "time: '0.3', allowed: 0 + k 0.5 s"),
        ("case,time,total\njonswap5/series,20.5,1\n", "time: '20.5', allowed"),
        ("case,time,total\njonswap5/series,0,1\n", "FAIL  jonswap5/series spread of total"),
    ],
)  # fmt: skip
def test_bad_files_are_refused_in_one_line(tmp_path, text, message):
    (tmp_path / "a.csv").write_text(text)
    found = scored(tmp_path / "a.csv")
    assert message in found
    assert "Traceback" not in found


def test_a_file_that_is_none_is_refused(tmp_path):
    assert "allowed: a CSV file" in scored(tmp_path / "missing.csv")
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00case")
    assert "allowed: a CSV file" in scored(tmp_path / "b.csv")


def test_repeated_and_empty_times_of_a_series_do_not_pass(tmp_path):
    rows = [row for row in perfect_rows() if row[0] == "jonswap5/series"]
    doubled = scored(write(tmp_path / "a.csv", [rows[0], *rows[:-1]]))
    assert doubled.splitlines()[-1] == "score 0 of 2"
    rows[3] = (*rows[3][:2], "", *rows[3][3:])
    assert scored(write(tmp_path / "b.csv", rows)).splitlines()[-1] == "score 1 of 2"
    rows = [(name, time, "", total, error) for name, time, _, total, error in rows]
    assert scored(write(tmp_path / "c.csv", rows)).splitlines()[-1] == "score 1 of 1"


CASES = tuple(w2a1.reference()["cases"])


@pytest.mark.thorough
@pytest.mark.parametrize(
    "case",
    [c if i % 3 == 0 else pytest.param(c, marks=pytest.mark.slow) for i, c in enumerate(CASES)],
)
def test_unscattered_gains_by_quadrature(case):
    """NumPy alone over the analytic surfaces; 1000 points along the image of a disk."""
    name, variant = case.split("/")
    waves = {"flat": np.zeros((1, 5)), "sinusoid": [[0.05, 0.0, 2.0 * np.pi / 3.0, 0.0, 0.0]]}
    if name not in waves:
        waves[name] = w2a1._waves(int(name.removeprefix("jonswap")))
    given, attenuation = w2a1.reference()["variants"][variant], 0.114 + 0.037
    found = unscattered(waves[name], given, attenuation)
    assert found == pytest.approx(w2a1.reference()["cases"][case]["unscattered"], rel=3e-5)


def mitsuba_scores(rows):
    """Return z of unscattered and total by case, errors in quadrature."""
    found = {}
    for row in rows:
        expected = w2a1.reference()["cases"][row["case"]]
        for key in ("unscattered", "total"):
            error = np.hypot(float(row[f"{key}_stderr"]), expected.get(f"{key}_stderr", 0.0))
            found[row["case"], key] = (float(row[key]) - expected[key]) / error
    return found


def test_kept_numbers_of_mitsuba_agree():
    """All |z| <= 3: of 40 numbers one is further off by chance in at most 11 % (Bonferroni)."""
    with (EXAMPLE / "mitsuba.csv").open() as file:
        rows = list(csv.DictReader(file))
    scores = mitsuba_scores(rows)
    assert len(scores) == 2 * len(w2a1.reference()["cases"]) == 40
    assert max(map(abs, scores.values())) <= 3.0
    for row in rows:
        total = float(row["total"]), float(row["total_stderr"])
        listed = w2a1.reference()["cases"][row["case"]].get("total_independent_mitsuba")
        assert (listed is not None) == (total[1] <= 0.005 * total[0])
        assert listed is None or listed == pytest.approx(total, rel=0.05)


@pytest.mark.external
def test_mitsuba_agrees():
    """Where Mitsuba is installed: 12 numbers of 10^6 photons, significance 0.01 of them all."""
    pytest.importorskip("mitsuba")
    script = EXAMPLE / "mitsuba_run.py"
    cases = [
        "jonswap5/r25cm",
        "jonswap5/r1m",
        "sinusoid/r1m",
        "flat/r1m",
        "flat/fov6_r1m",
        "flat/depth40_r1m",
    ]
    command = [sys.executable, script, "--photons", "1e6", "--seed", "3", "--cases", *cases]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode and "LLVM" in done.stderr:
        pytest.skip("Mitsuba 3 has no LLVM that it can use")
    rows = list(csv.DictReader(done.stdout.splitlines()))
    assert [row["case"] for row in rows] == cases, done.stderr
    assert all(float(row["total_stderr"]) < 0.02 * float(row["total"]) for row in rows)
    scores = mitsuba_scores(rows)
    # errors of 64 batches: Student's t of 63 degrees of freedom
    assert min(2.0 * t.sf(abs(z), 63) for z in scores.values()) > sidak(0.01, len(scores))


def test_waves_of_the_seas_are_those_of_the_list():
    found = list(w2a1._wave_checks())
    assert len(found) == 3
    assert all(abs(check.z) <= 1.0 for check in found)


@pytest.mark.parametrize(
    "case", ["flat/fov6", "jonswap5/r25cm", "jonswap5/r1m", "sinusoid/offset1m"]
)
def test_cases(case):
    row, found = w2a1.reference()["cases"][case], w2a1.gain(case, chains=2048)
    assert found.gain_ballistic == pytest.approx(row["unscattered"], rel=row["unscattered_tol_rel"])
    assert found.gain_stderr < 0.005 * found.gain
    error = np.hypot(found.gain_stderr, row["total_stderr"])
    assert abs(found.gain - row["total"]) < 3.0 * error


@pytest.mark.slow
def test_all_of_it():
    start = time.perf_counter()
    assert w2a1.score(w2a1.checks()) == 47
    assert time.perf_counter() - start < 180.0


def test_command(monkeypatch):
    good = Check("q", "W2A-1", 1.0, 1.0, tolerance=1e-3)
    monkeypatch.setattr(w2a1, "checks", lambda quick, progress: iter([good]))
    result = CliRunner().invoke(cli.app, ["validate", "--case", "w2a1"])
    assert result.exit_code == 0
    assert "Score by the rules of the case: 1 of 1." in result.output
    refused = CliRunner().invoke(cli.app, ["validate", "--case", "w2a2"])
    assert refused.exit_code != 0


def test_script(monkeypatch, tmp_path, capfd):
    monkeypatch.chdir(tmp_path)
    results = [
        SimpleNamespace(gain_ballistic=1.0, gain=1.0 + 0.001 * i, gain_stderr=0.001)
        for i in range(41)
    ]
    monkeypatch.setattr(w2a1, "gain", lambda name: results[0])
    monkeypatch.setattr(w2a1, "series", lambda name: results)
    runpy.run_path(str(EXAMPLE / "run.py"), run_name="__main__")
    assert "score 0 of 44" in capfd.readouterr().out
    assert len((tmp_path / "results.csv").read_text().splitlines()) == 1 + 20 + 82
