"""Both directions over the same surfaces, and downlinks in the other studies."""

import math

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.errors import Refused
from meshtrace.surfaces import FlatSea, SinusoidalSea, sea_in_wind

UP, DOWN = mt.Link(), mt.Link().mirrored()
WAVE = SinusoidalSea(amplitude=0.05, wavelength=3.0)
LINK_FILE = """
wind_speed = 0.0
[transmitter]
kind = "air-led"
height = 6.0
half_angle_deg = 12.0
tilt_deg = 1.0
[receiver]
kind = "water-receiver"
depth = 8.0
radius = 0.1
fov_deg = 40.0
"""
SMALL = {"photons": 64, "mesh": mt.Meshing(extent=4.0, spacing=0.2)}


@pytest.fixture(scope="module")
def both():
    return mt.duplex(UP, DOWN, WAVE, np.arange(12) * 0.12, **SMALL)


def test_both_directions_fade_together_where_light_crosses_at_the_same_place(both):
    assert both.correlation == pytest.approx(np.corrcoef(both.up.gain, both.down.gain)[0, 1])
    assert both.correlation > 0.98
    assert both.down.gain.mean() == pytest.approx(1.33**2 * both.up.gain.mean(), rel=0.03)
    assert both.up.time.tolist() == both.down.time.tolist()


def test_each_direction_is_its_own_time_series_over_the_common_mesh(both):
    alone = mt.time_series(DOWN, WAVE, both.down.time, **SMALL)
    np.testing.assert_allclose(both.down.gain_ballistic, alone.gain_ballistic, rtol=1e-9)


def test_outage_of_both_lies_between_that_of_each_and_their_product(both):
    half = np.median(both.up.gain), np.median(both.down.gain)
    found = both.outage(*half)
    assert (found.up, found.down, found.independent) == (0.5, 0.5, 0.25)
    assert found.both + found.either == pytest.approx(1.0)
    assert 0.25 < found.both <= 0.5
    with pytest.raises(Refused, match=r"^up_gain: nan"):
        both.outage(math.nan, 0.0)


def test_a_duplex_is_stored(both, tmp_path):
    both.save(tmp_path / "both.nc")
    again = mt.Duplex.load(tmp_path / "both.nc")
    assert (again.up.gain == both.up.gain).all()
    assert (again.down.gain_stderr == both.down.gain_stderr).all()
    assert again.correlation == both.correlation
    assert again.summary() == both.summary()
    assert "correlation of the gains" in both.summary()


@pytest.mark.parametrize(
    ("up", "down", "sea", "options", "text"),
    [
        (DOWN, UP, WAVE, {"times": [0.0]}, "^up: 1 receivers, direction down"),
        (UP, UP, WAVE, {"times": [0.0]}, "^down: 1 receivers, direction up"),
        (UP, DOWN, WAVE, {}, "^times: "),
        (UP, DOWN, WAVE, {"times": [0.0], "realizations": 2}, "^times: "),
        (UP, DOWN, FlatSea(), {"realizations": 2}, "^surface: FlatSea"),
    ],
)
def test_other_pairs_are_refused(up, down, sea, options, text):
    with pytest.raises(Refused, match=text):
        mt.duplex(up, down, sea, **options)


@pytest.mark.thorough
def test_ensembles_and_flights_take_a_downlink():
    sea = sea_in_wind(5.0)
    found = mt.ensemble(DOWN, 2, sea, photons=64, mesh=mt.Meshing(extent=6.0, spacing=0.3))
    assert (found.gain > 0.0).all()
    flight = mt.Flight(mt.Uav(), mt.Dryden(wind_speed=13.0))
    level = mt.time_series(DOWN, FlatSea(), [0.0, 1.0], photons=64)
    flown = mt.time_series(DOWN, FlatSea(), [0.0, 1.0], photons=64, flight=flight)
    assert (flown.gain < level.gain).all()
    tilted = DOWN.replace("transmitter.tilt_deg", 5.0)
    with pytest.raises(Refused, match=r"^transmitter\.tilt_deg: 5"):
        mt.time_series(tilted, FlatSea(), [0.0, 1.0], photons=64, flight=flight)


def test_bits_are_sent_down():
    found = mt.link_performance(DOWN, FlatSea(), depths=[20.0, 30.0], photons=64)
    assert found.figures[0].depth == 20.0
    up = mt.link_performance(UP, FlatSea(), depths=[20.0, 30.0], photons=64)
    assert found.figures[0].ber.value <= up.figures[0].ber.value
    assert mt.OokLink.of_link(DOWN).optics.medium_index == DOWN.water.n


@pytest.mark.statistical
def test_the_map_under_water_agrees_with_receivers_at_its_places():
    link = mt.Link(
        transmitter=mt.AirLed(), receiver=mt.WaterReceiver(radius=0.25), water=mt.Water(b=0.0)
    )
    found = mt.coverage_map(link, FlatSea(), 1.25, 0.5, photons=400_000)
    at = [mt.WaterReceiver(radius=0.28, position=(x, 0.0)) for x in (0.0, 1.0)]
    direct = mt.simulate(link.replace(receiver=tuple(at)), FlatSea(), photons=32).gain
    cells = np.array([found.gain[2, 2], found.gain[4, 2]])
    expected = direct * (0.25 / 0.28) ** 2
    error = np.array([found.gain_stderr[2, 2], found.gain_stderr[4, 2]])
    assert (np.abs(cells - expected) < 4.0 * error + 0.02 * expected).all()


@pytest.mark.slow
def test_a_study_with_a_link_file_of_a_downlink():
    scenario = mt.Scenario.from_toml(LINK_FILE)
    assert scenario.link.direction == "down"
    again = mt.Scenario.from_toml(scenario.to_toml())
    assert again.link == scenario.link
    points = mt.sweep(
        scenario, {"receiver.depth": [6.0, 12.0]}, rtol=None, photons=64, workers=1
    )  # fmt: skip
    assert points.gain.squeeze()[0] > points.gain.squeeze()[1]
