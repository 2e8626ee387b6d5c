"""A Scenario wherever a link and a sea may stand: the same numbers as of its parts."""

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.scenario import Scenario

SCENARIO = Scenario.from_config(
    {
        "wind_speed": 7.0,
        "bubbles": "none",
        "sea": {"spacing": 0.3, "extent": 7.0},
        "detector": {"preset": "paper"},
        "run": {"photons": 128, "seed": 4, "threads": 1, "normals": "facet"},
    }
)
LINK, SEA = SCENARIO.link, SCENARIO.surface
MESH = mt.Meshing(spacing=0.3, extent=7.0, normals="facet")
OPTIONS = {"photons": 128, "seed": 4, "mesh": MESH}


def test_series_follows_the_scenario():
    times = [0.0, 0.5]
    parts = mt.time_series(LINK, SEA, times, **OPTIONS)
    for series in (mt.time_series(SCENARIO, times), mt.time_series(SCENARIO, times=times)):
        np.testing.assert_array_equal(series.gain, parts.gain)
    other = mt.time_series(SCENARIO, times, seed=5)
    assert not np.array_equal(other.gain, parts.gain)


def test_ensemble_follows_the_scenario():
    parts = mt.ensemble(LINK, 2, SEA, **OPTIONS)
    np.testing.assert_array_equal(mt.ensemble(SCENARIO, 2).gain, parts.gain)


def test_map_follows_the_scenario():
    options = {"extent": 1.0, "step": 0.5, "photons": 4096}
    mesh = SEA.mesh(extent=7.0, spacing=0.3)
    with pytest.warns(mt.DomainWarning):
        whole = mt.coverage_map(SCENARIO, **options)
    with pytest.warns(mt.DomainWarning):
        parts = mt.coverage_map(LINK, mesh, seed=4, mesh=MESH, **options)
    np.testing.assert_array_equal(whole.gain, parts.gain)


def test_performance_follows_the_scenario():
    whole = mt.link_performance(SCENARIO, realizations=2)
    assert whole.ooks[0].model == "PC"
    gain = mt.ensemble(SCENARIO, 2).gain
    assert whole.at().gain.value == pytest.approx(gain.mean(), rel=1e-12)
    flown = SCENARIO.model_copy(update={"uav": mt.Uav()})
    found = mt.link_performance(flown, realizations=2)
    assert found.provenance["wind"]["wind_speed"] == 7.0
    law = mt.Uav().tilt_law(mt.Dryden(wind_speed=7.0))
    assert found.fades[0].tilt.law == law


def test_depths_follow_the_scenario():
    found = mt.depth_sweep(SCENARIO, (10.0, 12.0), bit_rate=1e6, wind_speeds=(0.0,), realizations=2)
    assert found.performances[0].ooks[0].model == "PC"
    assert found.performances[0].provenance["run"]["seed"] == 4


def test_analog_scenario_is_refused():
    analog = Scenario.from_config({"run": {"estimator": "analog"}})
    with pytest.raises(Refused, match=r"run\.estimator: 'analog', allowed: forced"):
        mt.sensitivities(analog)


def test_link_alone_has_the_sea_of_its_wind():
    windy = mt.Link().in_wind(11.0)
    found = mt.ensemble(windy, 1, photons=64)
    assert found.provenance["surface"]["spectrum"]["wind_speed"] == 11.0
