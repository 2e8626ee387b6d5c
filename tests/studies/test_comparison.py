"""Comparison of links: common chains, errors of differences, refusals, files."""

import numpy as np
import pytest

import meshtrace as mt
from meshtrace import results
from meshtrace.surfaces import FlatSea, JonswapSea

LINK = mt.Link()
SEA = JonswapSea(wind_speed=5.0)


def test_equal_links_do_not_differ():
    found = mt.compare({"a": LINK, "b": LINK}, SEA, photons=64)
    np.testing.assert_array_equal(found.difference, 0.0)
    np.testing.assert_array_equal(found.difference_stderr, 0.0)
    np.testing.assert_array_equal(found.ratio_db, 0.0)
    np.testing.assert_array_equal(found.ratio_db_stderr, 0.0)


def test_clear_water_differs_by_the_absorption():
    """Without scattering, through a small aperture on the axis, by exp(-delta a depth)."""
    clear = LINK.replace("water.b", 0.0).replace("receiver.radius", 1e-3)
    links = {"a": clear, "more": clear.replace("water.a", 0.2)}
    found = mt.compare(links, FlatSea(), photons=64)
    decibel = -10.0 / np.log(10.0) * (0.2 - 0.114) * 10.0
    assert found.ratio_db[1] == pytest.approx(decibel, rel=1e-6)


def test_gains_are_those_of_single_runs():
    links = {"low": LINK, "high": LINK.replace("receiver.height", 8.0)}
    found = mt.compare(links, SEA, photons=1024, seed=3)
    for i, link in enumerate(links.values()):
        one = mt.simulate(link, SEA, photons=4096, seed=4)
        error = np.hypot(one.gain_stderr, found.gain_stderr[i])
        assert abs(one.gain - found.gain[i]) < 3.9 * error


@pytest.mark.slow
def test_errors_of_differences_are_true():
    """Chi-square of 64 seeds about their mean: 42 to 90 with 97 % for true errors."""
    links = {"a": LINK, "b": LINK.replace("water.b", 0.05)}
    found = [mt.compare(links, FlatSea(), photons=256, seed=seed) for seed in range(64)]
    for name in ("difference", "ratio_db"):
        values = np.array([getattr(one, name)[1] for one in found])
        errors = np.array([getattr(one, f"{name}_stderr")[1] for one in found])
        assert 42.0 < (((values - values.mean()) / errors) ** 2).sum() < 90.0


def test_common_errors_cancel():
    links = {"a": LINK, "b": LINK.replace("receiver.height", 5.5)}
    one = mt.compare(links, SEA, photons=512)
    many = mt.compare(links, SEA, photons=64, realizations=6)
    for found in (one, many):
        assert found.difference_stderr[1] < 0.3 * np.hypot(*found.gain_stderr)


def test_scenarios_over_seas_of_their_own():
    """Winds of 2 and 13 m/s: each gain is that of the scenario alone."""
    scenarios = {f"{u}": mt.Scenario.from_toml(f"wind_speed = {u}.0") for u in (2, 13)}
    found = mt.compare(scenarios, photons=512)
    for i, scenario in enumerate(scenarios.values()):
        one = mt.simulate(scenario, photons=2048, seed=9)
        assert abs(one.gain - found.gain[i]) < 3.9 * np.hypot(one.gain_stderr, found.gain_stderr[i])


def test_files(tmp_path):
    found = mt.compare({"a": LINK, "b": LINK.at_depth(12.0)}, FlatSea(), photons=64)
    found.save(tmp_path / "c.nc")
    again = results.load(tmp_path / "c.nc")
    assert isinstance(again, mt.Comparison)
    assert (again.names, repr(again), again.summary()) == (
        ("a", "b"),
        repr(found),
        found.summary(),
    )
    assert again.provenance[1]["link"]["transmitter"]["depth"] == 12.0


@pytest.mark.parametrize(
    ("links", "options", "field"),
    [
        ({"a": LINK}, {}, "links"),
        ([LINK, LINK], {}, "links"),
        ({"a": LINK, "b": 3}, {}, "links.b"),
        ({"a": LINK, "b": LINK.replace(receiver=(mt.Receiver(), mt.Receiver(height=6)))}, {},
         "links.b.receiver"),
        ({"a": LINK, "b": LINK}, {"realizations": 0}, "realizations"),
        ({"a": LINK, "b": LINK}, {"realizations": 2, "surface": FlatSea()}, "surface"),
        ({"a": LINK, "b": LINK}, {"photons": 3}, "links.a.photons"),
    ],
)  # fmt: skip
def test_refusals(links, options, field):
    with pytest.raises(mt.Refused) as caught:
        mt.compare(links, **options)
    assert caught.value.field == field
