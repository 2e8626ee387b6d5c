"""Receivers that move along waypoints."""

import numpy as np
import pytest

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import FlatSea, JonswapSea

ROUTE = mt.Route(times=(0.0, 4.0, 6.0), positions=((-2, 0), (2, 0), (2, 1)), heights=(5, 5, 7))


def test_places():
    places = ROUTE.at([0.0, 1.0, 5.0, 6.0], height=3.0)
    np.testing.assert_allclose(places, [(-2, 0, 5), (-1, 0, 5), (2, 0.5, 6), (2, 1, 7)])
    level = mt.Route(times=(0, 1), positions=((0, 0), (1, 0)))
    np.testing.assert_array_equal(level.at([0.5], height=3.0), [(0.5, 0.0, 3.0)])


def test_gains_are_those_of_links_at_each_place():
    times = [0.0, 2.0, 5.0]
    series = mt.time_series(mt.Link(), FlatSea(), times, photons=256, route=ROUTE)
    for gain, x, y, height in zip(series.gain, (-2, 0, 2), (0, 0, 0.5), (5, 5, 6), strict=True):
        link = mt.Link(receiver=mt.Receiver(position=(x, y), height=height))
        one = mt.simulate(link, FlatSea(), photons=256, seed=series.provenance["run"]["seed"])
        assert gain == pytest.approx(one.gain, rel=1e-9)
    assert series.provenance["route"]["positions"][1] == [2.0, 0.0]


def test_flight_along_a_route():
    flight = mt.Flight(mt.Uav(), mt.Dryden(wind_speed=13.0))
    options = {"times": [0.0, 2.0], "photons": 256, "route": ROUTE}
    level = mt.time_series(mt.Link(), FlatSea(), **options)
    flown = mt.time_series(mt.Link(), FlatSea(), **options, flight=flight)
    assert (flown.gain != level.gain).all()
    assert {"route", "uav", "wind"} <= flown.provenance.keys()


def test_results_do_not_depend_on_threads():
    options = {"times": [0.0, 1.0, 2.0], "photons": 128, "route": ROUTE}
    sea = JonswapSea(wind_speed=5.0, seed=2)
    one, two = (mt.time_series(mt.Link(), sea, **options, threads=n) for n in (1, 2))
    np.testing.assert_array_equal(one.gain, two.gain)


@pytest.mark.parametrize(
    ("times", "positions", "heights", "message"),
    [
        ((0.0,), ((0, 0),), None, "two or more increasing times"),
        ((0.0, 0.0), ((0, 0), (1, 0)), None, "two or more increasing times"),
        ((0.0, 1.0), ((0, 0),), None, "positions: 1 of them, allowed: 2"),
        ((0.0, 1.0), ((0, 0), (1, 0)), (5,), "heights: 1 of them, allowed: 2"),
        ((0.0, 1.0), ((0, 0), (1, 0)), (5, -1), "heights"),
    ],
)
def test_refused_routes(times, positions, heights, message):
    with pytest.raises(mt.Refused, match=message):
        mt.Route(times=times, positions=positions, heights=heights)


def test_refused_series():
    with pytest.raises(mt.Refused, match=r"times: 7\.0, allowed: 0 <= times <= 6"):
        mt.time_series(mt.Link(), FlatSea(), [0.0, 7.0], route=ROUTE)
    two = mt.Link(receiver=(mt.Receiver(), mt.Receiver(height=6.0)))
    with pytest.raises(mt.Refused, match="one receiver in the air"):
        mt.time_series(two, FlatSea(), [0.0, 1.0], route=ROUTE)
    with pytest.raises(mt.Refused, match=r"route: \{\}, allowed: a Route"):
        mt.time_series(mt.Link(), FlatSea(), [0.0, 1.0], route={})


def test_picture():
    series = mt.time_series(mt.Link(), FlatSea(), [0.0, 2.0, 5.0], photons=64, route=ROUTE)
    ax = viz.plot_route(series)
    points = ax.collections[0]
    np.testing.assert_allclose(points.get_offsets(), [(-2, 0), (0, 0), (2, 0.5)])
    np.testing.assert_array_equal(points.get_array(), series.gain)
    with pytest.raises(mt.Refused, match="a time series along a route"):
        viz.plot_route(mt.time_series(mt.Link(), FlatSea(), [0.0, 1.0], photons=64))
