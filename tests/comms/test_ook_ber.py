"""Error rates, thresholds and required powers of `OokLink` against the reference tables."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from meshtrace.comms import LedDriver, OokLink, OpticalFrontEnd, SiPM
from meshtrace.comms.decisions import (
    gaussian_decision,
    generalized_poisson_decision,
    generalized_poisson_logpmf,
    pattern_decision,
    soft_information,
)

RX = json.loads((Path(__file__).parents[1] / "data" / "link_reference.json").read_text())["rx"]
RATES = (1_000_000, 5_000_000, 10_000_000)
TOLERANCE = {"GP": 1e-6, "G0": 1e-4, "PC": 1e-4, "A": 1e-4}
LAM = SiPM().branching


def reference_link(model: str, bit_rate: float, **fields) -> OokLink:
    """Return a link as in the tables, without saturation."""
    return OokLink(bit_rate=bit_rate, model=model, saturation=False, **fields)


@pytest.mark.parametrize("model", sorted(TOLERANCE))
@pytest.mark.parametrize("bit_rate", RATES)
@pytest.mark.parametrize("power", ["2e-11", "1e-10"])
def test_ber_matches_reference(model, bit_rate, power):
    expected = RX["BER"][f"P{power}_Rb{bit_rate}"][model]
    found = reference_link(model, bit_rate).ber(float(power))
    assert float(found) == pytest.approx(expected, rel=TOLERANCE[model])


@pytest.mark.parametrize("model", sorted(TOLERANCE))
@pytest.mark.parametrize("target", ["0.001", "0.002", "0.0038"])
def test_required_power_matches_reference(model, target):
    for bit_rate, expected in zip(RATES, RX["Preq_W"][target][model], strict=True):
        found = reference_link(model, bit_rate).required_power(float(target))
        assert found == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("bit_rate", "power", "share"),
    [(1e6, 1.865e-11, 0.9), (2e6, None, 0.75), (5e6, 1.395e-10, 0.1)],
)
def test_window_model_matches_table(bit_rate, power, share):
    link = reference_link("W", bit_rate)
    assert link.averaging_window * bit_rate == pytest.approx(share, abs=0.051)
    if power is not None:
        assert link.required_power(1e-3) == pytest.approx(power, rel=5e-3)


def test_window_vanishes_at_ten_megabit():
    """At 10 Mbit/s the best window is none: W is then A, with less than the table's 9.27e-10 W."""
    window, sampled = reference_link("W", 1e7), reference_link("A", 1e7)
    assert window.averaging_window == 0.0
    assert window.required_power(1e-3) == pytest.approx(sampled.required_power(1e-3), rel=1e-9)


@pytest.mark.parametrize(("key", "expected"), sorted(RX["GP_units"].items()))
def test_counting_matches_reference(key, expected):
    n0, n1 = (float(part.split("=")[1]) for part in key.split(","))
    found = generalized_poisson_decision(n0, n1, LAM)
    assert float(found.ber) == pytest.approx(expected, rel=1e-6)
    poisson = generalized_poisson_decision(n0, n1, 0.0)
    assert float(poisson.ber) == pytest.approx(RX["Poisson_units"][key], rel=1e-6)


def test_counting_threshold_is_the_best_of_all():
    """Brute force over every integer threshold."""
    k = np.arange(200)
    p0, p1 = (np.exp(generalized_poisson_logpmf(k, n, LAM)) for n in (2.9, 24.0))
    errors = [0.5 * (p0[t:].sum() + p1[:t].sum()) for t in range(60)]
    found = generalized_poisson_decision(2.9, 24.0, LAM)
    assert float(found.ber) == pytest.approx(min(errors), rel=1e-12)
    assert int(found.threshold) == int(np.argmin(errors))


def test_counting_of_many_photons_becomes_gaussian():
    n0, n1 = 1e8, 1.0007e8
    variance = np.array([n0, n1]) / (1.0 - LAM) ** 3
    gaussian = gaussian_decision(n0 / (1.0 - LAM), n1 / (1.0 - LAM), *variance)
    counted = generalized_poisson_decision(n0, n1, LAM)
    assert 1e-4 < float(counted.ber) < 1e-3
    assert float(counted.ber) == pytest.approx(float(gaussian.ber), rel=1e-2)
    assert float(counted.threshold) == pytest.approx(float(gaussian.threshold), rel=1e-6)
    assert float(generalized_poisson_decision(1.0, 1e5, LAM).ber) == 0.0


def test_generalized_poisson_moments():
    k = np.arange(400)
    p = np.exp(generalized_poisson_logpmf(k, 30.0, 0.2))
    mean = p @ k
    assert p.sum() == pytest.approx(1.0, abs=1e-12)
    assert mean == pytest.approx(30.0 / 0.8, rel=1e-12)
    assert p @ (k - mean) ** 2 == pytest.approx(30.0 / 0.8**3, rel=1e-10)
    assert np.exp(generalized_poisson_logpmf([0, 1], 0.0, 0.2)) == pytest.approx([1.0, 0.0])


@pytest.mark.parametrize(
    ("n0", "n1", "poisson", "branched"),
    [(2, 20, 0.995989, 0.995117), (1, 10, 0.943612, 0.938256), (0.5, 12, 0.990236, 0.988372)],
)
def test_soft_information_matches_table(n0, n1, poisson, branched):
    assert soft_information(n0, n1, 0.0) == pytest.approx(poisson, abs=1e-6)
    assert soft_information(n0, n1, LAM) == pytest.approx(branched, abs=1e-6)
    hard = float(generalized_poisson_decision(n0, n1, LAM).ber)
    entropy = -hard * math.log2(hard) - (1.0 - hard) * math.log2(1.0 - hard)
    assert soft_information(n0, n1, LAM) > 1.0 - entropy
    assert soft_information(n0, n0, LAM) == pytest.approx(0.0, abs=1e-12)
    assert soft_information(1e4, 1e9, LAM) == 1.0


def test_gaussian_threshold_against_a_scan():
    for m1, v0, v1 in ((5.0, 1.0, 1.0), (5.0, 1.0, 4.0), (3.0, 2.0, 0.5), (8.0, 1.0, 1.0 + 1e-13)):
        best = gaussian_decision(0.0, m1, v0, v1)
        std = np.sqrt([v0, v1])
        by_scan = pattern_decision(np.array([0.0, m1]), std, [False, True])
        assert float(best.ber) == pytest.approx(float(by_scan.ber), rel=1e-6)
        assert float(best.threshold) == pytest.approx(float(by_scan.threshold), abs=2e-3)


def test_pattern_decision_against_a_fine_scan():
    """1e5 thresholds on the patterns of a nearly closed eye."""
    from scipy.special import ndtr

    link = reference_link("A", 1e7)
    power = np.array([2e-11, 1e-10, 9e-10])
    mean, variance = link.moments(power)
    one = link.patterns()[:, 0]
    for row, spread, ber in zip(mean, np.sqrt(variance), link.ber(power), strict=True):
        scan = np.linspace((row - 4.0 * spread).min(), (row + 4.0 * spread).max(), 20_001)
        errors = np.zeros_like(scan)
        for level, noise, bit in zip(row, spread, one, strict=True):
            errors += ndtr((scan - level) / noise * (1.0 if bit else -1.0))
        assert float(ber) == pytest.approx(errors.min() / one.size, rel=1e-5)


@pytest.mark.parametrize("model", ["W", "A", "CP", "PC", "G0", "GP"])
@pytest.mark.thorough
def test_ber_falls_with_power_and_keeps_its_shape(model):
    link = OokLink(bit_rate=5e6, model=model)
    power = np.geomspace(1e-12, 5e-10, 12).reshape(3, 4)
    ber = link.ber(power)
    assert ber.shape == power.shape
    assert np.all(np.diff(ber.ravel()) < 0.0)
    assert float(link.ber(0.0)) == 0.5
    assert float(link.ber(link.required_power(1e-4))) == pytest.approx(1e-4, rel=1e-6)
    low, high = (float(level) for level in link.levels(2e-10))
    assert low < link.threshold(2e-10) < high


def test_required_power_of_a_closed_eye_is_infinite():
    closed = OokLink(bit_rate=3e7)
    assert closed.required_power(1e-3) == math.inf
    assert closed.overload_power(1e-3) == math.inf
    assert OokLink(bit_rate=3e7, equalizer="dfe").required_power(1e-3) < 1e-6


@pytest.mark.parametrize("bit_rate", RATES)
@pytest.mark.parametrize("model", ["W", "CP"])
@pytest.mark.thorough
@pytest.mark.slow_but("W-1000000", "W-5000000", "W-10000000", "CP-1000000")
def test_decision_feedback_needs_less_power(model, bit_rate):
    plain = OokLink(bit_rate=bit_rate, model=model)
    equalized = plain.model_copy(update={"equalizer": "dfe"})
    gain_db = 10.0 * math.log10(plain.required_power(1e-3) / equalized.required_power(1e-3))
    assert gain_db > (0.02 if bit_rate == 1_000_000 else 0.5)


@pytest.mark.parametrize("bit_rate", RATES)
@pytest.mark.thorough
@pytest.mark.slow_but("1000000")
def test_gaussian_window_model_is_close_to_the_exact_law(bit_rate):
    """The Gaussian model W errs by less than 0.1 dB in required power, its rate by 8 %."""
    gaussian, exact = (OokLink(bit_rate=bit_rate, model=model) for model in ("W", "CP"))
    for target in (1e-2, 1e-3):
        ratio = exact.required_power(target) / gaussian.required_power(target)
        assert abs(10.0 * math.log10(ratio)) < 0.1
        power = gaussian.required_power(target)
        assert float(exact.ber(power)) == pytest.approx(target, rel=0.08)


@pytest.mark.parametrize("background", [3.6e9, 3e10])
def test_the_exact_law_of_many_counts_is_the_gaussian_one(background):
    """Below and above 5000 counts in a sample."""
    gaussian, exact = (
        OokLink(model=model, saturation=False, background_rate=background) for model in ("W", "CP")
    )
    power = gaussian.required_power(1e-3)
    assert float(exact.ber(power)) == pytest.approx(1e-3, rel=0.02)
    assert exact.threshold(power) == pytest.approx(gaussian.threshold(power), rel=2e-3)
    assert float(exact.ber(1e-6)) < 1e-12


def test_exact_law_approaches_counting_without_interference():
    """Fast poles and a window of one bit: model CP becomes model GP."""
    fast = {"led": LedDriver(bandwidth=1e10), "sipm": SiPM(bandwidth=1e10)}
    exact = reference_link("CP", 1e6, window=1e-6, **fast)
    counting = reference_link("GP", 1e6, **fast)
    for power in (1e-11, 2e-11):
        assert float(exact.ber(power)) == pytest.approx(float(counting.ber(power)), rel=5e-3)


def test_saturation_acts_at_short_range_only():
    saturated, linear = OokLink(), OokLink(saturation=False)
    assert saturated.required_power(1e-3) == pytest.approx(linear.required_power(1e-3), rel=1e-3)
    low, high = saturated.levels(6e-6)
    assert high / linear.levels(6e-6)[1] < 0.15
    assert low / high > 0.3
    overload = saturated.overload_power(1e-3)
    assert float(saturated.ber(overload)) == pytest.approx(1e-3, rel=1e-6)
    assert float(saturated.ber(2.0 * overload)) > 1e-3
    assert linear.overload_power(1e-3) == math.inf


@pytest.mark.parametrize(("bit_rate", "penalty_db"), [(1e6, 4.3), (5e6, 2.2), (1e7, 1.5)])
def test_moonlight_penalty_matches_table(bit_rate, penalty_db):
    dark = reference_link("G0", bit_rate)
    power = dark.optics.background_power(8.6e-8, dark.sipm.area)
    rate = float(dark.sipm.count_rate(power, dark.led.wavelength))
    lit = dark.model_copy(update={"background_rate": rate})
    ratio = lit.required_power(1e-3) / dark.required_power(1e-3)
    assert 10.0 * math.log10(ratio) == pytest.approx(penalty_db, abs=0.05)


def test_power_is_peak_shifts_by_the_duty():
    average = OokLink()
    peak = OokLink(led=LedDriver(power_is_peak=True))
    shift = peak.required_power(1e-3) / average.required_power(1e-3)
    assert shift == pytest.approx(2.0 / 1.1, rel=1e-5)


@pytest.mark.parametrize("bit_rate", RATES)
def test_eye_ends_on_the_decision(bit_rate):
    link = OokLink(bit_rate=bit_rate, model="A", saturation=False)
    power = link.required_power(1e-3)
    eye = link.eye(power, points=20)
    assert eye.level.shape == eye.std.shape == (link.patterns().shape[0], 20)
    assert eye.time[-1] == pytest.approx(link.bit_time)
    assert eye.ber[-1] == pytest.approx(1e-3, rel=1e-6)
    assert np.all(eye.ber[:-1] >= eye.ber[-1] * (1.0 - 1e-6))
    expected = {1_000_000: 0.999991, 5_000_000: 0.797495, 10_000_000: 0.289410}[bit_rate]
    assert eye.opening == pytest.approx(expected, abs=1e-4)
    assert 1.0 < eye.q_factor < 3.5


def test_presets():
    paper = OokLink.preset("paper-ranges", bit_rate=5e6)
    assert (paper.model, paper.optics.etendue_limited) == ("PC", False)
    assert paper.absorption_factor == 2.0
    assert "not physics" in paper.status
    assert OokLink.preset("physical") == OokLink()
    assert OokLink.preset("paper").absorption_factor == 1.0
    with pytest.raises(ValueError, match="name: 'best', allowed: physical, paper, paper-ranges"):
        OokLink.preset("best")


@pytest.mark.parametrize(
    "fields",
    [{"bit_rate": 0.0}, {"model": "X"}, {"window": 2e-6}, {"memory": 0}, {"equaliser": "dfe"}],
)
def test_bad_fields_are_refused(fields):
    with pytest.raises(ValueError, match=next(iter(fields))):
        OokLink(**fields)


def test_bad_arguments_are_refused():
    link = OokLink()
    for call, name in (
        (lambda: link.ber(-1.0), "power"),
        (lambda: link.ber(math.nan), "power"),
        (lambda: link.received_power(math.inf), "gain"),
        (lambda: link.required_power(0.5), "ber"),
        (lambda: link.threshold(0.0), "power"),
        (lambda: link.eye(0.0), "power"),
        (lambda: OokLink(model="GP").eye(1e-10), "model"),
        (lambda: generalized_poisson_decision(3.0, 2.0, 0.0), "n0"),
    ):
        with pytest.raises(ValueError, match=f"{name}.*allowed"):
            call()


def test_round_trip():
    link = OokLink.preset("paper", bit_rate=5e6, optics=OpticalFrontEnd(fov_deg=10.0))
    assert OokLink.model_validate_json(link.model_dump_json()) == link


def test_a_closed_eye_needs_infinite_power_at_any_bit_rate():
    for rate in (1e8, 1e9, 1e10):
        assert OokLink(bit_rate=rate, window=0.0).required_power(1e-3) == math.inf
