"""`meshtrace validate`: arithmetic of its table, its closed forms, and its exit code."""

import json
import math

import pytest
from typer.testing import CliRunner

from meshtrace import cli
from meshtrace.validation import Check, closed_forms, format_table, validate


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


def test_table_marks_what_fails():
    good, bad = Check("one", "s", 1.0, 1.0, stderr=0.1), Check("two", "s", 1.0, 2.0, stderr=0.1)
    lines = format_table([good, bad]).splitlines()
    assert [line.endswith("FAILED") for line in lines[2:]] == [False, True]
    assert lines[0].split()[:4] == ["quantity", "source", "expected", "got"]


def test_unscattered_gain_has_its_limit():
    """(m + 1) / 2 (r / (d + n h))^2 exp(-c d) T(0) for a small lens."""
    m = -math.log(2.0) / math.log(math.cos(math.radians(10.0)))
    point = 0.5 * (m + 1.0) * (1e-4 / (10.0 + 1.33 * 5.0)) ** 2 * math.exp(-1.51) * 0.97994069
    assert closed_forms.unscattered_gain(radius=1e-4) == pytest.approx(point, rel=1e-6)
    assert closed_forms.unscattered_gain() == pytest.approx(4.5166617e-5, rel=1e-7)


def test_every_check_passes_with_few_photons():
    """Closed forms of all families: by 4 standard errors, or 4 times the stated accuracy."""
    checks = validate(quick=True)
    assert len(checks) == 9
    assert [check for check in checks if not check.passed] == []


def test_checks_of_the_engine_see_a_wrong_index(monkeypatch):
    """An index of 1.4 in place of 1.33, and 0.2 % of absorption in the white slab."""
    from meshtrace.link import Link

    slab_link = closed_forms.slab_link

    def wrong(*arguments, **fields):
        link = Link(*arguments, **fields)
        return link.model_copy(update={"water": link.water.model_copy(update={"n": 1.4})})

    def grey(thickness, albedo, *rest):
        return slab_link(thickness, min(albedo, 0.998), *rest)

    monkeypatch.setattr(closed_forms, "Link", wrong)
    failed = [check for check in closed_forms.still_water_checks(1_000_000) if not check.passed]
    assert len(failed) == 7
    monkeypatch.undo()
    monkeypatch.setattr(closed_forms, "slab_link", grey)
    assert [check.passed for check in closed_forms.slab_checks(50_000)] == [True, False]


@pytest.fixture
def suite(monkeypatch):
    """Put a suite in place that takes no time; return how to set what comes out."""
    got = {"value": 1.0, "photons": []}

    def checks(photons):
        got["photons"].append(photons)
        return [Check("q", "s", 1.0, got["value"], stderr=0.1)]

    monkeypatch.setattr(closed_forms, "SUITE", {"family": (checks, 200)})
    return got


def test_quick_takes_fewer_photons(suite):
    named = []
    validate(quick=True, progress=named.append)
    validate()
    assert suite["photons"] == [10, 200]
    assert named == ["family"]


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
