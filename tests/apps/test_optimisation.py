"""Optimisation: known optima, bounds, quantiles, validation, files."""

import math

import numpy as np
import pytest

import meshtrace as mt
from meshtrace.apps import candidates
from meshtrace.studies import Variant
from meshtrace.studies.campaign import campaign_of
from meshtrace.surfaces import FlatSea, JonswapSea

ANGLE = "transmitter.half_angle_deg"
STILL = (0.0, 0.0), None


def test_the_gain_on_the_axis_is_best_at_the_bound():
    o = mt.optimize(mt.Link(), FlatSea(), {ANGLE: (3.0, 30.0)}, "gain", realizations=1, photons=256)
    assert o.values[0] == 3.0
    assert f"{ANGLE} is at the bound 3" in o.notes
    assert o.validation.improved
    expected = mt.simulate(mt.Link().replace(ANGLE, 3.0), FlatSea(), photons=2048)
    assert o.value == pytest.approx(expected.gain, rel=0.02)
    assert o.best == mt.Link().replace(ANGLE, 3.0)


@pytest.mark.thorough
def test_a_bound_is_near_on_the_scale_of_the_search():
    def cost(at, gains, weights):
        return abs(math.log(at.link.only_receiver.radius / 2e-3))

    o = mt.optimize(
        mt.Link(), FlatSea(), {"receiver.radius": (1e-4, 10.0)}, cost, realizations=1, photons=32
    )
    assert o.values[0] == pytest.approx(2e-3, rel=0.05)
    assert not any("bound" in note for note in o.notes)


@pytest.mark.slow
def test_half_angle_for_hover_errors_of_a_metre():
    o = mt.optimize(
        mt.Link(), FlatSea(), {ANGLE: (3.0, 30.0)}, "outage", hover_std=(1.0, 1.0),
        realizations=48, photons=1024,
    )  # fmt: skip
    assert o.values[0] == pytest.approx(8.0, abs=2.0)
    assert 0.0 < o.validation.difference < 0.1  # 0.2 dB over 10 deg
    assert o.flatness[0, 0] <= o.values[0] <= o.flatness[0, 1]
    assert len(o.history) < 40


def test_the_start_at_the_optimum_is_not_improved():
    link = mt.Link().replace(ANGLE, 3.0)
    o = mt.optimize(link, FlatSea(), {ANGLE: (3.0, 30.0)}, "gain", realizations=1, photons=64)
    assert "no improvement found" in o.notes
    assert not o.validation.improved


def test_field_of_view_from_one_run_is_that_of_its_own_run():
    link, hovering = mt.Link(), ((0.5, 0.5), None)
    campaign = campaign_of(link.replace("receiver.fov_deg", 80.0), FlatSea(), run={"photons": 512})
    quick = candidates.Sample(campaign, 6, *hovering, ("receiver.fov_deg", ANGLE))
    slow = candidates.Sample(campaign, 6, *hovering, ())
    for fov in (25.0, 3.0, 1.0):  # at the narrow ones the edge of the view cuts facets in the light
        new = link.replace("receiver.fov_deg", fov).replace(ANGLE, 17.0)
        assert quick.gains(Variant(new, None)) == pytest.approx(
            slow.gains(Variant(new, None)), rel=2e-3
        )


def test_field_of_view_of_a_lens_counts_its_etendue():
    # a wide view collects less: the narrowest that takes the light is best
    o = mt.optimize(
        mt.Link(), FlatSea(), {"receiver.fov_deg": (6.0, 90.0)}, "margin", realizations=1,
        photons=512,
    )  # fmt: skip
    assert o.values[0] < 10.0
    assert o.validation.difference * 10.0 / math.log(10.0) == pytest.approx(19.4, abs=0.7)


def test_several_variables_with_a_constraint():
    over = {ANGLE: (5.0, 20.0), "receiver.radius": (0.02, 0.1)}
    o = mt.optimize(
        mt.Link(), FlatSea(), over, "gain", realizations=1, photons=64,
        constraints=[lambda at: 0.06 - at.link.receiver.radius],
    )  # fmt: skip
    assert o.values[0] == pytest.approx(5.0, rel=0.03)
    assert o.values[1] == pytest.approx(0.06, rel=0.02)
    assert o.best.receiver.radius <= 0.06 + 1e-9


def test_custom_and_global():
    def far_from_eight(at, gains, weights):
        assert gains.shape == weights.shape == (1,)
        return (at.link.transmitter.half_angle_deg - 8.0) ** 2

    over = {ANGLE: (5.0, 20.0)}
    for method in ("bounded", "global"):
        o = mt.optimize(
            mt.Link(), FlatSea(), over, far_from_eight, realizations=1, photons=64, method=method
        )
        assert o.values[0] == pytest.approx(8.0, abs=0.2)


@pytest.mark.slow
def test_range():
    o = mt.optimize(
        mt.Link().replace("transmitter.depth", 50.0), FlatSea(), {ANGLE: (8.0, 12.0)}, "range",
        realizations=1, photons=64,
    )  # fmt: skip
    assert o.values[0] == 8.0
    start = mt.sensitivities(mt.Link(), FlatSea(), [ANGLE], "range", photons=512)
    gained = start.derivative(ANGLE).value * -2.0
    assert o.validation.difference == pytest.approx(gained, rel=0.25)
    assert o.value == pytest.approx(start.value + o.validation.difference, rel=0.02)


@pytest.mark.thorough
def test_seas_and_tilts_are_common_and_fresh_ones_are_not():
    sea, flight = JonswapSea(wind_speed=5.0), mt.Flight()
    options = dict(realizations=2, photons=64, flight=flight, hover_std=(0.5, 0.5))
    o = mt.optimize(mt.Link(), sea, {ANGLE: (8.0, 14.0)}, "gain", **options)
    again = mt.optimize(mt.Link(), sea, {ANGLE: (8.0, 14.0)}, "gain", threads=1, **options)
    assert np.array_equal(o.history, again.history)
    assert o.validation == again.validation
    assert o.validation.best != o.value


@pytest.mark.parametrize("objective", ["margin", "range"])
@pytest.mark.slow_but("margin")
def test_a_closed_eye_is_the_worst_candidate(objective):
    over = {"detector.bit_rate": (5e6, 1e8)}
    link = mt.Link().replace("transmitter.depth", 50.0)
    options = {"realizations": 1, "photons": 64, "bit_rate": 1e8}
    o = mt.optimize(link, FlatSea(), over, objective, **options)
    assert o.values[0] < 1e7
    assert max(o.costs) == (0.0 if objective == "range" else -math.log(1e-30))


def test_weighted_quantile():
    rng = np.random.default_rng(2)
    values, weights = rng.standard_normal(20_000), rng.random(20_000)
    assert candidates.weighted_quantile(values, weights, 0.1) == pytest.approx(-1.2816, abs=0.03)
    assert candidates.weighted_quantile(np.array([3.0, 1.0]), np.array([1.0, 1.0]), 0.5) == 2.0


def test_strata_of_hover_errors_have_the_law_of_a_normal_place():
    campaign = campaign_of(mt.Link(), FlatSea(), run={"photons": 64})
    sample = candidates.Sample(campaign, 400, (1.0, 2.0), None, ())
    assert sample.weights.sum() == pytest.approx(1.0)
    square = sample.weights @ np.square(sample._offsets)
    assert square == pytest.approx([1.0, 4.0], rel=0.05)


def test_file(tmp_path):
    o = mt.optimize(mt.Link(), FlatSea(), {ANGLE: (3.0, 30.0)}, "gain", realizations=1, photons=64)
    o.save(tmp_path / "o.nc")
    loaded = mt.Optimum.load(tmp_path / "o.nc")
    assert loaded.summary() == o.summary()
    assert loaded.best == o.best


@pytest.mark.parametrize(
    ("over", "options", "message"),
    [
        ({}, {}, "bounds: "),
        ({ANGLE: (5.0, 5.0)}, {}, "low < high"),
        ({ANGLE: (5.0, 95.0)}, {}, "half_angle_deg"),
        ({"wind_speed": (5.0, 9.0)}, {}, r"allowed: water\.\*, .*receiver\.\*, "),
        ({"detector.aperture": (5.0, 9.0)}, {}, r"detector\.bit_rate, .*, receiver\.\*"),
        ({ANGLE: (5.0, 9.0)}, {"objective": "gian"}, "objective"),
        ({ANGLE: (5.0, 9.0)}, {"objective": "margin", "ook": None}, "ook"),
        ({ANGLE: (5.0, 9.0)}, {"hover_std": (1.0,)}, "hover_std"),
        ({ANGLE: (5.0, 9.0)}, {"method": "simplex"}, "method"),
        ({ANGLE: (5.0, 9.0)}, {"quantile": 2.0}, "quantile"),
    ],
)
def test_refusals(over, options, message):
    with pytest.raises(mt.Refused, match=message):
        mt.optimize(mt.Link(), FlatSea(), over, **{"realizations": 1, "photons": 64, **options})
