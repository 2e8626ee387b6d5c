"""Outage of interleaved codes against closed forms and against drawn code words."""

import numpy as np
import pytest
from mc_statistics import ALPHA, z_test
from scipy import optimize, stats

from meshtrace.comms import OokLink
from meshtrace.comms.budget import average_ber, ber_of_gains, outage, required_gain
from meshtrace.comms.capacity import hard_information
from meshtrace.comms.interleaving import fade_margin_db, interleaved_outage, mean_below

LINK = OokLink(bit_rate=1e6)
NODES = (np.arange(200_000) + 0.5) / 200_000
GAMMA = stats.gamma(3.0, scale=1.0 / 3.0).ppf(NODES)  # scintillation index 1/3
LOGNORMAL = stats.lognorm(0.5).ppf(NODES)
RATE = 0.8
LIMIT = optimize.brentq(lambda p: float(hard_information(p)) - RATE, 1e-6, 0.4, xtol=1e-12)
NEEDED = required_gain(LINK, LIMIT)


@pytest.mark.parametrize("n", [1, 2, 4, 16, 64])
@pytest.mark.parametrize("limit", [0.2, 0.5, 0.9, 1.1])
def test_means_of_gamma_draws_follow_the_gamma_law(n, limit):
    # a mean of n draws of shape a is gamma of shape n a
    expected = stats.gamma(3.0 * n, scale=1.0 / (3.0 * n)).cdf(limit)
    assert mean_below(GAMMA, limit, n) == pytest.approx(expected, rel=0.02, abs=1e-9)


def test_diversity_order_is_the_number_of_fades():
    # P(mean < x) ~ x^(a n) for small x
    for n in (1, 2, 3):
        low, high = (mean_below(GAMMA, x, n) for x in (0.05, 0.1))
        law = stats.gamma(3.0 * n, scale=1.0 / (3.0 * n))
        expected = np.log2(law.cdf(0.1) / law.cdf(0.05))
        assert np.log2(high / low) == pytest.approx(expected, rel=0.03)
        assert 0.8 < np.log2(high / low) / (3.0 * n) < 1.0


def test_one_fade_is_the_outage_of_the_gain():
    gain = 1.4 * NEEDED * LOGNORMAL
    plain = outage(LINK, gain, LIMIT).value
    assert interleaved_outage(LINK, gain, RATE) == pytest.approx(plain, abs=1e-3)
    assert plain == pytest.approx(stats.norm.cdf(-np.log(1.4) / 0.5), abs=1e-3)


@pytest.mark.statistical
@pytest.mark.parametrize("m", [2, 5])
def test_interleaved_outage_against_drawn_code_words(m):
    gain, rng, words = 1.3 * NEEDED * LOGNORMAL, np.random.default_rng(5), 40_000
    information = hard_information(ber_of_gains(LINK, rng.choice(gain, (words, m)).ravel()))
    missed = (information.reshape(words, m).mean(axis=1) < RATE).mean()
    expected = interleaved_outage(LINK, gain, RATE, m)
    stderr = float(np.sqrt(expected * (1.0 - expected) / words))
    assert 0.01 < expected < 0.5
    assert z_test(float(missed), stderr, expected) > ALPHA


@pytest.mark.slow
def test_margins_fall_with_the_number_of_fades():
    margins = [fade_margin_db(LINK, GAMMA, RATE, m, 1e-2) for m in (1, 4, 16, 64)]
    # one fade: the 1 % quantile of the gain has to suffice
    quantile = stats.gamma(3.0, scale=1.0 / 3.0).ppf(1e-2)
    assert margins[0] == pytest.approx(-10.0 * np.log10(quantile), abs=0.02)
    assert np.all(np.diff(margins) < 0.0)
    # many fades: the mean information of all of them decides, at a little more power
    scaled = NEEDED * GAMMA * 10.0 ** (0.1 * margins[-1])
    assert RATE < hard_information(ber_of_gains(LINK, scaled)).mean() < RATE + 0.1
    assert fade_margin_db(LINK, 7.0 * GAMMA, RATE, 4, 1e-2) == pytest.approx(margins[1], abs=2e-3)


def test_average_error_rate_in_lognormal_fading_is_the_gauss_hermite_sum():
    link = OokLink(bit_rate=1e6, model="G0", saturation=False)
    mean, sigma = 2.0 * required_gain(link, 1e-3), 0.5
    nodes, weights = np.polynomial.hermite.hermgauss(60)
    faded = mean * np.exp(np.sqrt(2.0) * sigma * nodes - 0.5 * sigma**2)
    expected = weights @ link.ber(link.received_power(faded)) / np.sqrt(np.pi)
    found = average_ber(link, mean * np.exp(-0.5 * sigma**2) * LOGNORMAL, resamples=1)
    assert found.value == pytest.approx(expected, rel=0.01)


def test_error_rate_of_counted_photons_in_gamma_fading():
    # ideal counting, BER = exp(-N) / 2: the mean over gamma fading is (1 + N / a)^-a / 2
    sipm = LINK.sipm.model_copy(
        update={"dark_count_rate": 0.0, "p_crosstalk": 0.0, "p_afterpulse": 0.0}
    )
    led = LINK.led.model_copy(update={"extinction_ratio": 0.0})
    link = OokLink(bit_rate=1e6, model="GP", saturation=False, sipm=sipm, led=led)
    unit = 1e-12 / float(link.received_power(1.0))
    one = float(link.levels(1e-12)[1]) * link.bit_time
    assert float(link.ber(1e-12)) == pytest.approx(0.5 * np.exp(-one), rel=1e-6)
    gain = unit * (8.0 / one) * GAMMA
    expected = 0.5 * (1.0 + 8.0 / 3.0) ** -3.0
    assert average_ber(link, gain, resamples=1).value == pytest.approx(expected, rel=0.01)


def test_refusals():
    for values, limit, n, text in [
        ([], 0.5, 1, r"values: \[\], allowed: \(m,\)"),
        ([np.nan], 0.5, 1, "values"),
        ([1.0], "a", 1, "limit"),
        ([1.0], 0.5, 0, "n: 0, allowed: an integer 1 <= n <= 256"),
    ]:
        with pytest.raises(ValueError, match=text):
            mean_below(values, limit, n)
    with pytest.raises(ValueError, match=r"rate: 1\.5, allowed: 0 < rate < 1"):
        interleaved_outage(LINK, [1e-8], 1.5)
    with pytest.raises(ValueError, match=r"outage: 0\.001, allowed: attainable with 60 dB"):
        fade_margin_db(LINK, [0.0, 1.0], RATE)
