"""Several receivers of one signal: against counting bit by bit, limits, and capacity bounds."""

import math

import numpy as np
import pytest
from bit_level import branch, error_rate, simulate

from meshtrace.comms import OokLink, SiPM
from meshtrace.comms.budget import required_gain
from meshtrace.comms.combining import combined_ber, equivalent_gain, intensity_capacity
from meshtrace.errors import Refused

COUNTING = OokLink(bit_rate=1e6, model="GP", saturation=False)
WINDOW = OokLink(bit_rate=1e6)
LIMIT = 4.5  # standard errors: alpha 1e-4 over the cases of this file, after Sidak


def _fades(link, rng, n, correlation=0.5, target=0.01):
    """Return correlated lognormal gains (n, 2) about the one that a receiver needs for a target."""
    z = rng.standard_normal((n, 2))
    z[:, 1] = correlation * z[:, 0] + math.sqrt(1.0 - correlation**2) * z[:, 1]
    return required_gain(link, target) * np.exp(0.4 * z)


def _counts(link, gains, ones, rng):
    """Return the counts of every bit at every receiver, avalanche by avalanche."""
    low, high = link.levels(link.received_power(gains))
    primaries = rng.poisson(np.where(ones[:, None], high, low) * link.bit_time)
    return branch(primaries, link.sipm.branching, rng)


@pytest.mark.parametrize("combining", ["selection", "equal"])
def test_counts_bit_by_bit(combining):
    """Every bit has its own fade; thresholds are the best ones of each, found here by the laws."""
    rng = np.random.default_rng(4)
    fades = _fades(COUNTING, rng, 40, target=0.1)
    expected = combined_ber([COUNTING] * 2, fades, combining).mean()
    bits, errors = 4000, 0
    for gains in fades:
        ones = rng.random(bits) < 0.5
        counts = _counts(COUNTING, np.tile(gains, (bits, 1)), ones, rng)
        seen = counts.sum(axis=1) if combining == "equal" else counts[:, np.argmax(gains)]
        # the fewest errors of any threshold, on bits of a separate draw
        trial = rng.random(bits) < 0.5
        drawn = _counts(COUNTING, np.tile(gains, (bits, 1)), trial, rng)
        trials = drawn.sum(axis=1) if combining == "equal" else drawn[:, np.argmax(gains)]
        levels = np.arange(trials.max() + 2)
        wrong = [(trial & (trials < k)).sum() + (~trial & (trials >= k)).sum() for k in levels]
        errors += int(((seen >= levels[np.argmin(wrong)]) != ones).sum())
    found, n = errors / (bits * len(fades)), bits * len(fades)
    stderr = math.sqrt(expected * (1.0 - expected) / n)
    # a threshold from other bits misses the best one by a few per cent of the errors at most
    assert -LIMIT * stderr < found - expected < LIMIT * stderr + 0.03 * expected


@pytest.mark.thorough
@pytest.mark.parametrize("combining", ["equal", "maximal"])
def test_pulses_bit_by_bit(combining):
    """Two receivers of unequal light, through pulses, filters and thermal noise."""
    powers = [WINDOW.required_power(0.1), 0.4 * WINDOW.required_power(0.1)]
    gains = np.array(powers) / float(WINDOW.received_power(1.0))
    expected = float(combined_ber([WINDOW] * 2, gains, combining))
    runs = []
    for seed, power in enumerate(powers):
        # the same bits at both: the first draw of each block comes from a common seed
        runs.append(simulate(WINDOW, power, 20_000, seed=11, block=20_000))
        assert seed == 0 or (runs[0].bits == runs[1].bits).all()
    weights = np.ones(2)
    if combining == "maximal":
        spans = [float(np.diff(WINDOW.levels(power))[0]) for power in powers]
        weights = np.array(spans) / [float(WINDOW.moments(p)[1].mean()) for p in powers]
    value = weights @ np.stack([run.value for run in runs])
    thresholds = np.quantile(value, np.linspace(0.2, 0.8, 200))
    best = min(error_rate(runs[0]._replace(value=value), t) for t in thresholds)
    stderr = math.sqrt(expected * (1.0 - expected) / value.size)
    # the Gaussian law is within 8 % of counted errors, see test_bit_level_mc
    assert abs(best - expected) < LIMIT * stderr + 0.08 * expected


def test_limits():
    gain = required_gain(WINDOW, 1e-3)
    for combining in ("selection", "equal", "maximal"):
        alone = equivalent_gain([WINDOW], [gain], 1e-3, combining)
        assert alone == pytest.approx(gain, rel=1e-4)
    dark = np.array([gain, 0.0])
    assert combined_ber([WINDOW] * 2, dark, "maximal") == pytest.approx(1e-3, rel=1e-4)
    assert combined_ber([WINDOW] * 2, dark, "equal") > 1e-3
    assert combined_ber([WINDOW] * 2, [0.0, 0.0]) == 0.5
    # few counts and no other noise: light adds; much background: signal-to-noise ratios add
    quiet = SiPM(dark_count_rate=0.0, p_crosstalk=0.0, p_afterpulse=0.0)
    shot = OokLink(bit_rate=1e6, model="GP", saturation=False, sipm=quiet)
    gain = required_gain(shot, 1e-3)
    assert equivalent_gain([shot] * 2, [gain, gain], 1e-3, "equal") == pytest.approx(2 * gain, 1e-4)
    bright = OokLink(bit_rate=1e6, background_rate=1e12, saturation=False)
    gain = required_gain(bright, 1e-3)
    equal = equivalent_gain([bright] * 2, [[gain, gain]], 1e-3, "maximal")
    assert equal == pytest.approx(math.sqrt(2.0) * gain, rel=1e-2)
    uneven = equivalent_gain([bright] * 2, [[gain, 0.5 * gain]], 1e-3, "maximal")
    assert uneven == pytest.approx(math.hypot(1.0, 0.5) * gain, rel=1e-2)


@pytest.mark.parametrize("combining", ["selection", "equal", "maximal"])
def test_equivalent_gain_has_the_outage_of_the_array(combining):
    gains, need = _fades(WINDOW, np.random.default_rng(5), 60), required_gain(WINDOW, 1e-3)
    gains *= need / np.median(equivalent_gain([WINDOW] * 2, gains, 1e-3, combining))
    missed = combined_ber([WINDOW] * 2, gains, combining) > 1e-3
    equivalent = equivalent_gain([WINDOW] * 2, gains, 1e-3, combining)
    assert 5 < missed.sum() < 55
    np.testing.assert_array_equal(equivalent < need, missed)


@pytest.mark.parametrize(
    ("links", "gain", "field"),
    [
        ([WINDOW] * 2, [1e-6], "gain"),
        ([WINDOW, WINDOW.replace(bit_rate=2e6)], [1e-6, 1e-6], "links"),
        ([WINDOW, WINDOW.replace(model="A")], [1e-6, 1e-6], "links"),
        ([COUNTING] * 2, [1e-6, 1e-6], "model"),
    ],
)
def test_refusals(links, gain, field):
    with pytest.raises(Refused) as refusal:
        combined_ber(links, gain)
    assert refusal.value.field == field


def _information(peak, points, chances):
    """Return the mutual information [bit] of discrete inputs in Gaussian noise of variance 1."""
    y = np.linspace(-10.0, peak + 10.0, 8001)
    laws = np.exp(-0.5 * (y - peak * np.array(points)[:, None]) ** 2) / math.sqrt(2.0 * math.pi)
    mixed = np.array(chances) @ laws
    noise = 0.5 * math.log2(2.0 * math.pi * math.e)
    return float(-np.trapezoid(mixed * np.log2(np.maximum(mixed, 1e-300)), y)) - noise


@pytest.mark.parametrize("share", [0.2, 0.5])
@pytest.mark.parametrize("peak", [0.5, 3.0, 10.0])
def test_bounds_hold_what_inputs_reach(peak, share):
    """Inputs on a grid: none exceeds the upper bound, one of maximum entropy the lower."""
    points = np.linspace(0.0, 1.0, 65)
    reached = [_information(peak, [0.0, 1.0], [1.0 - share, share])]
    for mu in np.linspace(0.0, 12.0, 40):
        chances = np.exp(-mu * points)
        chances /= chances.sum()
        if chances @ points <= share + 1e-3:
            reached.append(_information(peak, points, chances))
    low, high = intensity_capacity(peak, share)
    assert max(reached) < high + 1e-3
    assert low < max(reached) + 1e-3


def test_bounds_of_arrays():
    low_of_one, high_of_one = intensity_capacity(10.0)
    assert intensity_capacity([[10.0, 10.0]]) == pytest.approx(intensity_capacity(20.0))
    assert intensity_capacity([10.0, 10.0]) == pytest.approx(intensity_capacity(10.0 * 2**0.5))
    low, high = intensity_capacity(1e5, 0.5)
    assert high - low == pytest.approx(0.5 * math.log2(2.0 * math.pi * math.e / 4.0), abs=1e-6)
    low, high = intensity_capacity(np.diag([10.0, 10.0]))
    assert low == pytest.approx(2.0 * low_of_one)
    assert high >= 2.0 * high_of_one - 1e-9
    assert intensity_capacity(np.diag([1e3, 1e3]))[0] > 1.9 * intensity_capacity([1e3])[0]
    assert intensity_capacity([[0.0, 0.0]]) == (0.0, 0.0)
    with pytest.raises(Refused, match="peak"):
        intensity_capacity(np.ones((2, 2, 2)))
