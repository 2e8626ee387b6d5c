"""Numbers in the tables of the figures, by means independent of the drawing code."""

import math
from functools import partial

import numpy as np
import pytest
from mc_statistics import ALPHA, sidak, z_test

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import FlatSea
from paper import Number, Setting, make_figures
from paper.gains import signal_to_noise
from paper.links import FORMS, bubble_factor, decibel, forced, mean_gain, ratio, scenario
from paper.registry import load

TINY = {"realizations": 3, "photons": 64, "analog": 2000}
FLAT_GAIN = 5.9731e-5
"""Gain of the paper's link over a flat sea without bubbles, from an independent program."""


def rows(name, **effort):
    figure = load(name)
    output = figure.make(Setting(threads=1), **effort)
    return {row.quantity: row for row in figure.table(output)}


def test_distances_of_the_printed_cdf_follow_from_its_slip():
    """The printed CDF is off by D cos sin^2 with D = (1/8 - 1/16 pi) K: RMSE D/4, KS 2D/3 sqrt 3."""
    v, delta = (3.0 - 3.5835) / 2.0, 4.0 / (3.0 * 0.1**2)
    k = (1.0 - delta**v) / ((delta - 1.0) * delta**v)
    d = (1.0 / 8.0 - 1.0 / (16.0 * math.pi)) * k
    found = rows("ff-cdf")
    rmse, ks = found["RMSE of the CDF"], found["Kolmogorov-Smirnov distance"]
    assert rmse.paper.value == pytest.approx(d / 4.0, rel=2e-3)
    assert ks.paper.value == pytest.approx(2.0 * d / (3.0 * math.sqrt(3.0)), rel=1e-4)
    assert ks.default.value < 1e-8
    assert float(f"{rmse.paper.value:.2e}") == rmse.printed
    assert float(f"{ks.paper.value:.2e}") == ks.printed


@pytest.mark.thorough
def test_table_of_the_tilt_holds_the_known_deviations():
    found = rows("tilt", samples=1000)
    low, high = (found[f"standard deviation of the tilt, {u} m/s"] for u in (5, 13))
    assert low.default.value == pytest.approx(0.848294, abs=2e-6)
    assert low.paper.value == pytest.approx(0.483006, abs=2e-6)
    assert high.default.value == pytest.approx(5.20717, abs=2e-5)
    assert high.paper.value == pytest.approx(3.02437, abs=2e-5)
    assert found["KS of the Gamma law, 5 m/s"].paper.value == pytest.approx(6.72999e-3, abs=1e-6)


def test_table_of_the_factor_holds_the_defect_of_the_printed_density():
    found = rows("h-alpha")
    integral = found["integral of the density, 5 m/s"].paper.value
    assert math.log10(integral) == pytest.approx(-61.26, abs=0.01)
    factor = found["mean factor, 13 m/s"].paper.value
    assert factor == pytest.approx(0.963577, abs=5e-5)


def test_tables_of_the_bubbles_hold_the_known_coefficients():
    found = rows("bubble-scattering")["scattering coefficient of bubbles at 0 m, 13 m/s"]
    assert found.default.value == pytest.approx(8.45128e-2, rel=1e-5)
    assert found.paper.value == pytest.approx(8.80431252e-2, rel=1e-8)


def test_records_of_the_wind_scatter_about_their_mean():
    found = rows("wind", duration=2000.0)
    z = [
        number
        for axis in "xy"
        for number in (
            found[f"mean of the record along {axis}"].default,
            found[f"mean of the record along {axis}"].paper,
        )
    ]
    # gusts along both axes hold half of those along the wind, which stay longest: a wide error
    for number in z:
        assert z_test(number.value, number.stderr, 5.0) > sidak(ALPHA, len(z))


def test_mean_gain_of_a_flat_sea_is_the_known_one():
    (mean,) = mean_gain(0.0, "physical", Setting(threads=1), realizations=2, photons=1024, analog=0)
    found = mean.number
    assert z_test(found.value, found.stderr, FLAT_GAIN, 6e-9) > ALPHA


def test_printed_forms_by_forced_detection_meet_photons_one_by_one():
    made = forced(0.0, "paper", receiver={"radius": 0.25})
    fast = mt.simulate(made.link, FlatSea(), photons=4096, threads=1)
    slow = mt.simulate(made.link, FlatSea(), estimator="analog", photons=600_000, seed=3, threads=1)
    assert slow.gain_stderr < 0.03 * slow.gain
    assert z_test(slow.gain, slow.gain_stderr, fast.gain, fast.gain_stderr) > ALPHA
    assert (
        fast.gain
        > 1.2
        * mt.simulate(
            forced(0.0, "physical", receiver={"radius": 0.25}).link,
            FlatSea(),
            photons=2048,
            threads=1,
        ).gain
    )


def test_printed_forms_count_the_bubbles_as_photons_one_by_one():
    """Forced detection times the factor meets photons through bubbles, over still water."""
    wide = {"radius": 0.4}
    plain = forced(13.0, "paper", receiver=wide).link
    fast = mt.simulate(plain, FlatSea(), photons=4096, threads=1)
    bubbles = scenario(13.0, "paper", receiver=wide, run={"estimator": "analog"}).link
    slow = mt.simulate(bubbles, FlatSea(), estimator="analog", photons=400_000, seed=9, threads=1)
    factor = bubble_factor(13.0, "paper", Setting(threads=1), 40_000)
    assert 0.0 < factor.stderr < 0.02
    found = Number(fast.gain * factor.value, fast.gain * factor.stderr)
    # crests above the lamp change the factor by a few per cent between seas
    error = math.hypot(found.stderr, fast.gain_stderr, slow.gain_stderr, 0.01 * slow.gain)
    assert z_test(slow.gain, error, found.value) > ALPHA
    assert slow.gain > 1.02 * fast.gain


def test_weak_bubbles_hardly_change_the_gain():
    """Photons that meet no bubble cancel: the error is far below that of both gains."""
    factor = bubble_factor(5.0, "paper", Setting(threads=1), 4000)
    assert factor.value == pytest.approx(1.0, abs=0.01)
    assert factor.stderr < 0.003


def test_mean_gain_of_the_printed_forms_has_the_factor_of_the_bubbles(monkeypatch):
    effort = {"realizations": 2, "photons": 64, "analog": 1}
    setting = Setting(threads=1)
    options = {"receiver": [{"radius": 0.05}, {"radius": 0.02}, {"height": 4.0}], **effort}
    calls = []

    def factor(wind, form, setting, analog, **tables):
        calls.append((wind, form, tables["receiver"]))
        return Number(2.0, 0.02)

    monkeypatch.setattr("paper.links.bubble_factor", factor)
    doubled = mean_gain(13.0, "paper", setting, **options)
    assert calls == [(13.0, "paper", {}), (13.0, "paper", {"height": 4.0})]
    monkeypatch.setattr("paper.links.bubble_factor", lambda *a, **k: Number(1.0))
    for twice, once in zip(doubled, mean_gain(13.0, "paper", setting, **options), strict=True):
        assert twice.samples == pytest.approx(2.0 * once.samples)
        assert twice.chain_error == pytest.approx(
            math.hypot(2.0 * once.chain_error, 0.02 * once.samples.mean())
        )
    calls.clear()
    mean_gain(13.0, "physical", setting, **effort)
    mean_gain(0.0, "paper", setting, **effort)
    assert calls == []


@pytest.mark.thorough
def test_printed_signal_to_noise_follows_from_its_formula():
    """28.64 dB is an optical ratio of unscattered light, without refraction."""
    order = -math.log(2.0) / math.log(math.cos(math.radians(10.0)))
    gain = 0.5 * (order + 1.0) * (0.05 / 52.0) ** 2 * math.exp(-0.151 * 47.0)
    entries = signal_to_noise(Setting(threads=1), realizations=2, photons=64, analog=2000)
    found = {entry.key: entry for entry in entries}
    still, rough, margin = (found[key] for key in ("snr-still", "snr-wind", "margin"))
    # noise of 2.42e-12 W in print, rounded
    assert still.paper.value == pytest.approx(10.0 * math.log10(0.1 * gain / 2.42e-12), abs=0.01)
    assert still.paper.value == pytest.approx(28.64, abs=0.01)
    # etendue takes 19.7 dB from the traced light
    assert still.default.value == pytest.approx(15.5, abs=0.3)
    assert margin.default.value == pytest.approx(still.default.value - rough.default.value)
    # the closed formula over still water is another one: its difference from traced light is none
    assert 0.0 < margin.paper.value < 2.0
    assert rough.paper.stderr > 0.0


@pytest.mark.thorough
def test_sweep_over_receivers_meets_the_law_of_the_area():
    found = rows("gain-radius", **TINY)
    for row in found.values():
        assert row.default.value == pytest.approx(2.0, abs=0.05)


@pytest.mark.slow
def test_wide_beams_lose_what_their_solid_angle_says():
    """On axis the gain goes with (m + 1): scattering changes the ratio by a few percent."""
    order = [-math.log(2.0) / math.log(math.cos(math.radians(a))) for a in (5.0, 60.0)]
    expected = 10.0 * math.log10((order[0] + 1.0) / (order[1] + 1.0))
    effort = {**TINY, "analog": 200_000}  # few photons of a wide lamp are received
    loss = rows("gain-half-angle", **effort)["loss from 5 to 60 degrees, 5 m/s"]
    assert loss.default.value == pytest.approx(expected, abs=1.5)
    assert loss.default.value > loss.printed


def test_ratios_and_decibels_carry_their_errors():
    found = decibel(ratio(Number(4.0, 0.04), Number(2.0, 0.02)))
    assert found.value == pytest.approx(10.0 * math.log10(2.0))
    assert found.stderr == pytest.approx(10.0 / math.log(10.0) * 0.01 * math.sqrt(2.0))


QUICK_FIGURES = [("surfaces", {"seas": 2}), ("snell", {})]
SLOW_FIGURES = [
    ("offset", {}),
    ("uav-axes", {}),
    ("fates", {"photons": 20_000}),
    ("gain-series", {"times": 5, "photons": 64, "analog": 2000}),
    (
        "gain-distribution",
        {"realizations": 60, "paper_realizations": 60, "photons": 64, "analog": 2000},
    ),
    ("coverage-half-angle", {"photons": 20_000, "times": 1, "step": 1.0}),
    ("coverage-depth", {"photons": 20_000, "times": 1, "step": 1.0}),
    ("gain-depth", TINY),
    ("gain-height", TINY),
    ("gain-offset", TINY),
    ("ber-depth", {"realizations": 2, "photons": 128, "analog": 2000, "step": 10.0}),
    ("link", {"paths": 10}),
]


@pytest.mark.parametrize(
    ("name", "effort"),
    [*QUICK_FIGURES, *(pytest.param(*one, marks=pytest.mark.slow) for one in SLOW_FIGURES)],
)
@pytest.mark.thorough
def test_every_figure_is_drawn_with_finite_numbers(tmp_path, monkeypatch, name, effort):
    # pictures of any size: a palette for scenes takes half of the time
    monkeypatch.setattr(viz, "save_picture", partial(viz.save_picture, largest=10**8))
    one = load(name)
    monkeypatch.setattr(type(one), "effort", lambda self, quick: effort)
    (record,) = make_figures(tmp_path, [name], setting=Setting(threads=1))
    assert (tmp_path / f"{name}.png").stat().st_size > 10_000
    assert record["rows"]
    for row in record["rows"]:
        for form in ("default", "paper"):
            assert row[form] is None or np.isfinite(row[form]).all(), row["quantity"]
    assert FORMS == ("physical", "paper")
