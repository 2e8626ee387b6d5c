"""The commands sensitivity and optimize: tables, files, refusals."""

import pytest
from command_line import meshtrace, refusal

import meshtrace as mt

STILL = ("--set", "sea.spectrum=flat", "--photons", "64")


def test_sensitivity_prints_and_writes_the_table(tmp_path):
    path = tmp_path / "s.nc"
    text = meshtrace("sensitivity", *STILL, "--wrt", "water.a", "--wrt", "water.b", "-o", path)
    found = mt.Sensitivities.load(path)
    assert [row.name for row in found.table] == ["water.a", "water.b"]
    assert found.summary() in text.stdout
    assert found.table["water.a"].elasticity == pytest.approx(-1.14, abs=0.01)


def test_optimize_prints_and_writes_the_best_link(tmp_path):
    path = tmp_path / "o.nc"
    over = ("--bounds", "transmitter.half_angle_deg=5,20", "--objective", "gain", "-n", "1")
    text = meshtrace("optimize", *STILL, *over, "-o", path)
    found = mt.Optimum.load(path)
    assert found.values[0] == 5.0
    assert found.summary() in text.stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("sensitivity", *STILL, "--wrt", "water.aa"), "did you mean water.a"),
        (("sensitivity", *STILL, "--quantity", "gian"), "did you mean gain"),
        (("optimize", *STILL, "--bounds", "receiver.fov_deg"), "--bounds"),
        (("optimize", *STILL, "--bounds", "receiver.fov_deg=60"), "KEY=LOW,HIGH"),
        (("optimize", *STILL, "--bounds", "receiver.fov_deg=6,60", "--hover", "1"), "--hover: '1'"),
    ],
)
def test_refusals(words, message):
    assert message in refusal(*words)
