"""Plots of sensitivities, optima and inferences show the numbers of their runs."""

import math

import numpy as np
import pytest

import meshtrace as mt
from meshtrace import apps, viz
from meshtrace.studies import swings
from meshtrace.surfaces import FlatSea


def test_tornado_bars_are_two_runs():
    s = mt.sensitivities(mt.Link(), FlatSea(), wrt=["water.b", "water.a"], photons=64)
    found = swings(s, 0.1)
    assert [one.name for one in found] == ["water.a", "water.b"]  # the largest on top
    path = -s.table["water.a"].relative  # mean path in the water [m]
    expected = [10.0 * math.log10(math.exp(sign * 0.0114 * path)) for sign in (1.0, -1.0)]
    assert found[0].change == pytest.approx(expected, rel=1e-3)
    ax = viz.plot_tornado(s, change={"water.a": (0.1026, 0.1254)})
    widths = [bar.get_width() for bar in ax.patches]
    assert widths == pytest.approx(expected, rel=1e-3)
    assert ax.get_xlabel() == f"change of the gain from {s.value:.2e} [dB]"


def test_tornado_of_the_range_is_in_metres():
    link = mt.Link().at_depth(40.0)
    s = mt.sensitivities(link, FlatSea(), wrt=["water.a"], quantity="range", ook=None, photons=256)
    low, high = swings(s, 0.1)[0].change
    # two-sided, and not the derivative: the light falls faster with a deeper lamp
    assert low == pytest.approx(3.0, abs=0.15)
    assert high == pytest.approx(-2.6, abs=0.15)
    slope = s.derivative("water.a").value * 0.0114
    assert high > slope > -low
    with pytest.raises(mt.Refused, match="change"):
        swings(s, 1.5)
    with pytest.raises(mt.Refused, match="no such key"):
        swings(s, {"water.b": (0.03, 0.04)})


def test_the_range_of_a_receiver_in_the_water():
    link = mt.Link().mirrored()
    s = mt.sensitivities(link, FlatSea(), wrt=["water.a"], quantity="range", ook=None, photons=256)
    ends = 0.112, 0.116
    (found,) = swings(s, {"water.a": ends})
    expected = [s.predict({"water.a": a}).value - s.value for a in ends]
    assert found.change == pytest.approx(expected, abs=2e-3)


def test_other_plots_show_the_numbers():
    over = {"transmitter.half_angle_deg": (5.0, 20.0)}
    o = mt.optimize(mt.Link(), FlatSea(), over, "gain", realizations=1, photons=64)
    ax = apps.plot_optimum(o)
    x, y = ax.get_lines()[0].get_data()
    assert np.array_equal(x, o.history[:, 0])
    np.testing.assert_allclose(y, -10.0 / np.log(10.0) * o.history[:, 1])  # what is maximised, up
    assert ax.get_lines()[1].get_ydata()[0] == pytest.approx(10.0 * np.log10(o.value), rel=1e-9)
    rows = [
        {"transmitter.depth": d, "gain": g, "stderr": 0.02 * g}
        for d, g in ((5.0, 3e-4), (10.0, 6e-5))
    ]
    f = mt.infer(rows, mt.Link(), ["water.a"], photons=64)
    assert np.array_equal(
        apps.plot_inference(f).get_lines()[0].get_ydata(), f.measured / f.predicted
    )
