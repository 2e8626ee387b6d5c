"""The table of `meshtrace validate`: its arithmetic, its references, and its exit code."""

import json
import math
from pathlib import Path

import pytest
from scipy.integrate import quad
from typer.testing import CliRunner

import meshtrace.validation.suite
from meshtrace import cli
from meshtrace.optics.fresnel import fresnel_reflectance
from meshtrace.validation import SUITE, Check, format_table, validate
from meshtrace.validation.check import half_digit, printed
from meshtrace.validation.flat_sea import unscattered_gain
from meshtrace.validation.optics import optics_checks, walsh_reflectance
from meshtrace.validation.receiver import BIT_ERRORS, REQUIRED, TILTS, receiver_checks
from meshtrace.validation.suite import Family

REFERENCE = json.loads(
    (Path(__file__).parents[1] / "data" / "link_reference.json").read_text(encoding="utf-8")
)


def test_z_takes_both_errors():
    assert Check("q", "s", 1.0, 1.5, stderr=0.3, tolerance=0.4).z == pytest.approx(1.0)
    assert Check("q", "s", 1.0, 0.0, tolerance=0.2).z == pytest.approx(-5.0)
    assert not Check("q", "s", 1.0, 0.0, tolerance=0.2).passed
    assert Check("q", "s", 1.0, 1.4, stderr=0.1).passed


@pytest.mark.parametrize("got", [math.nan, math.inf])
def test_what_is_not_finite_fails(got):
    assert not Check("q", "s", 1.0, got, stderr=0.1).passed


def test_what_has_no_error_fails():
    """A check without scale is a mistake of the suite, even where the values agree."""
    assert not Check("q", "s", 1.0, 1.0).passed


@pytest.mark.parametrize(
    ("text", "half"), [("0.09739", 5e-6), ("1.07e-3", 5e-6), ("5", 0.5), ("2.42e-12", 5e-15)]
)
def test_half_of_the_last_digit(text, half):
    assert half_digit(text) == pytest.approx(half, rel=1e-12)
    assert printed("q", "s", text, float(text)).tolerance == pytest.approx(half, rel=1e-12)


def test_table_marks_what_fails():
    good, bad = Check("one", "s", 1.0, 1.0, stderr=0.1), Check("two", "s", 1.0, 2.0, stderr=0.1)
    lines = format_table([good, bad]).splitlines()
    assert [line.endswith("FAILED") for line in lines[2:]] == [False, True]
    assert lines[0].split()[:4] == ["quantity", "source", "expected", "got"]


def test_closed_form_of_diffuse_reflectance_is_its_integral():
    for n in (1.2, 1.33, 1.5):
        expected = quad(
            lambda mu, n=n: 2.0 * mu * float(fresnel_reflectance(mu, 1.0, n)),
            0.0,
            1.0,
            epsrel=1e-10,
        )[0]
        assert walsh_reflectance(n) == pytest.approx(expected, rel=1e-9)


def test_unscattered_gain_has_its_limit():
    """(m + 1) / 2 (r / (d + n h))^2 exp(-c d) T(0) for a small lens."""
    m = -math.log(2.0) / math.log(math.cos(math.radians(10.0)))
    point = 0.5 * (m + 1.0) * (1e-4 / (10.0 + 1.33 * 5.0)) ** 2 * math.exp(-1.51) * 0.97994069
    assert unscattered_gain(radius=1e-4) == pytest.approx(point, rel=1e-6)
    assert unscattered_gain() == pytest.approx(4.5166617e-5, rel=1e-7)


def test_references_of_the_receiver_are_those_of_the_table():
    for (preset, speed), value in TILTS.items():
        key = f"{'paper' if preset == 'paper' else 'mil'}_U{speed:g}"
        assert value == REFERENCE["uav"][key]["alpha_std_deg_exact"]
    for model, (slow, fast, _) in BIT_ERRORS.items():
        for rate, value in ((1_000_000, slow), (5_000_000, fast)):
            expected = REFERENCE["rx"]["BER"][f"P1e-10_Rb{rate}"][model]
            assert value == pytest.approx(expected, rel=1e-5)
        power = REFERENCE["rx"]["Preq_W"]["0.001"][model][0]
        assert float(REQUIRED[model]) == pytest.approx(power, rel=1e-5)


@pytest.mark.parametrize("checks", [optics_checks, receiver_checks])
def test_checks_without_transport_pass(checks):
    assert [check for check in checks(100_000) if not check.passed] == []


def test_checks_see_a_wrong_program(monkeypatch):
    """What is wrong fails, and nothing beside it."""
    import meshtrace.validation.optics as module

    monkeypatch.setattr(module, "hemispheric_reflectance", lambda n1, n2: 0.066)
    monkeypatch.setattr(module.FournierForand, "sample", lambda self, u: 0.3 * u)
    failed = {check.quantity for check in optics_checks(100_000) if not check.passed}
    assert failed == {
        "diffuse reflectance, from the air",
        "diffuse reflectance, from the water",
        "Fournier-Forand, drawn: g",
    }


@pytest.fixture
def suite(monkeypatch):
    """Put a suite in place that takes no time; return how to set what comes out."""
    got = {"value": 1.0, "photons": []}

    def checks(photons):
        got["photons"].append(photons)
        return [Check("q", "s", 1.0, got["value"], stderr=0.1)]

    monkeypatch.setattr(meshtrace.validation.suite, "SUITE", {"family": Family(checks, 20, 10)})
    return got


def test_quick_takes_fewer_photons(suite):
    named = []
    validate(quick=True, progress=named.append)
    validate()
    assert suite["photons"] == [10, 20]
    assert named == ["family"]
    assert all(family.quick_photons <= family.photons for family in SUITE.values())


@pytest.mark.parametrize(("value", "code"), [(1.3, 0), (1.5, 1), (math.nan, 1)])
def test_exit_code(suite, value, code):
    suite["value"] = value
    result = CliRunner().invoke(cli.app, ["validate", "--quick"])
    assert result.exit_code == code, result.stderr
    assert f"1 checks, {code} beyond" in result.stdout


def test_json(suite):
    suite["value"] = 0.9
    data = json.loads(CliRunner().invoke(cli.app, ["validate", "--json"]).stdout)
    assert data["failed"] == 0
    assert data["checks"][0]["z"] == pytest.approx(-1.0)
