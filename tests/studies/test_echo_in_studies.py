"""The channel's impulse response in sensitivities, optimisation, inference, over delay and colour."""

import math

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import meshtrace as mt
from meshtrace.comms import LedDriver, OokLink, SiPM
from meshtrace.comms.budget import required_gain
from meshtrace.surfaces import FlatSea

pytestmark = pytest.mark.filterwarnings(
    "ignore::meshtrace.FewSamplesWarning", "ignore::meshtrace.errors.DomainWarning"
)
RATE, VIEW = "detector.bit_rate", "receiver.fov_deg"
HARBOUR = mt.Link(
    transmitter=mt.Led(depth=8.0, wavelength_nm=514.5),
    receiver=mt.Receiver(height=3.0, fov_deg=60.0),
    water=mt.Water.from_type("petzold-harbour", 514.5),
)
FAST = OokLink(bit_rate=5e7, led=LedDriver(bandwidth=1e8), sipm=SiPM(bandwidth=1e8))


def runs(rates, seeds, photons=512, link=HARBOUR):
    """Return the margins of runs of their own [dB], shape (seeds, rates)."""
    found = [
        mt.link_performance(
            link, FlatSea(), ook=FAST, bit_rate=rates, photons=photons, seed=seed, realizations=2
        )
        for seed in seeds
    ]
    return np.array([[f.margin_optical_db.value for f in one.figures] for one in found])


def of_prompt_light(link, step=0.02):
    """Return the slope of the margin over ln(bit rate) behind an instantaneous channel [dB]."""
    ook = OokLink.of_link(link, FAST)
    rates = (ook.bit_rate * math.exp(side * step) for side in (-1.0, 1.0))
    low, high = (10.0 * math.log10(required_gain(ook.replace(bit_rate=r), 1e-3)) for r in rates)
    return (low - high) / (2.0 * step)


@pytest.mark.slow
def test_the_slope_over_the_bit_rate_in_turbid_water_is_that_of_runs():
    """Four seeds of either; |z| < 3.9, 1e-4."""
    step = 0.02
    mine = [
        mt.sensitivities(
            HARBOUR, FlatSea(), [RATE], "margin", ook=FAST, photons=512, seed=seed, step=step
        ).derivative(RATE).value * FAST.bit_rate
        for seed in range(1, 5)
    ]  # fmt: skip
    margins = runs([FAST.bit_rate * math.exp(side * step) for side in (-1.0, 1.0)], range(11, 15))
    slopes = np.diff(margins, axis=1)[:, 0] / (2.0 * step)
    off = np.mean(mine) - slopes.mean()
    error = math.hypot(np.std(mine, ddof=1), slopes.std(ddof=1)) / 2.0
    assert abs(off) < 3.9 * error
    assert error < 0.3
    assert abs(np.mean(mine) - of_prompt_light(HARBOUR)) > 0.3


@pytest.mark.slow
def test_the_best_link_has_the_margin_behind_its_own_response():
    seen = {}

    def cost(at, gains, weights):
        need = required_gain(at.detector, 1e-3)
        seen.setdefault(at.detector.bit_rate, (at.detector, float(gains @ weights)))
        return -math.log(float(gains @ weights) / need)

    study = HARBOUR, FlatSea(), {RATE: (4e7, 5e7)}
    options = {"realizations": 1, "ook": FAST, "photons": 128}
    own = mt.optimize(*study, cost, **options)
    found = mt.optimize(*study, "margin", **options)
    assert found.values == pytest.approx([4e7], rel=1e-9)
    behind, gain = seen[4e7]
    assert behind.spread_in_bits > 0.01
    margin = 10.0 * math.log10(gain / required_gain(behind, 1e-3))
    assert found.value == pytest.approx(margin, abs=1e-6)
    prompt = 10.0 * math.log10(gain / required_gain(behind.replace(response=None), 1e-3))
    assert prompt - found.value > 0.1
    assert found.cost == pytest.approx(own.cost, rel=1e-6)


@pytest.mark.slow
def test_error_rates_behind_the_channel_are_inferred():
    """The error rate of runs of their own gives their absorption, within the error of chains."""
    scenario = mt.Scenario(wind_speed=0.0, link=HARBOUR, surface=FlatSea(), detector=FAST)
    point = mt.link_performance(scenario, photons=1024, realizations=2, seed=3).at()
    rows = [{"ber": point.ber.value, "stderr": 0.02 * point.ber.value}]
    assert 1e-12 < point.ber.value < 0.3
    found = mt.infer(rows, scenario, ["water.a"], photons=1024, seed=4)
    assert abs(found.value["water.a"] - HARBOUR.water.a) < 4.0 * found.stderr["water.a"]


def test_the_spectrum_of_a_lamp_weighs_the_gain_as_a_quadrature_over_wavelengths():
    """Runs of one wavelength each, with equal seeds; the errors of their ratios are 2e-4."""
    link = mt.Link(
        transmitter=mt.Led(depth=20.0, wavelength_nm=520.0),
        water=mt.Water.from_type("jerlov-IB", 520.0),
    )
    wide = OokLink(led=LedDriver(width_nm=30.0)).replace("optics.filter_width_nm", 60.0)
    options = {"photons": 256, "seed": 3}
    found = mt.link_performance(link, FlatSea(), ook=wide, **options).transmission()
    nm = np.linspace(490.0, 550.0, 9)
    gains = [mt.simulate(link.at_wavelength(w), FlatSea(), **options).gain for w in nm.tolist()]
    fine = np.linspace(490.0, 550.0, 2001)
    weight = np.exp(-4.0 * math.log(2.0) * ((fine - 520.0) / 30.0) ** 2)
    relative = np.exp(CubicSpline(nm, np.log(gains) - math.log(gains[4]))(fine))
    expected = (weight * relative).sum() / weight.sum()
    plain = OokLink.of_link(link, wide).filter_share
    assert found.filter_share / plain == pytest.approx(expected, abs=2e-3)
    assert abs(expected - 1.0) > 0.01


def test_one_wavelength_or_equal_water_needs_no_spectrum():
    clear = mt.Link(water=mt.Water.from_type("jerlov-IB", 470.0))
    for link, width in ((clear, 0.0), (mt.Link(), 20.0), (clear.at_depth(0.005), 1.0)):
        ook = OokLink(led=LedDriver(width_nm=width))
        found = mt.link_performance(link, FlatSea(), ook=ook, photons=64)
        assert found.responses[0].gain_spectrum is None
