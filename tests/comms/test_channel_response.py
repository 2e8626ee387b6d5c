"""Bits behind the response of the channel: limits, closed form, and a twin in the time domain."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bit_level import Channel, error_rate, simulate
from scipy.stats import norm

import meshtrace as mt
from meshtrace.comms import ChannelResponse, LedDriver, OokLink, SiPM
from meshtrace.comms.capacity import capacity
from meshtrace.comms.decisions import mixed_information, soft_information
from meshtrace.comms.pulses import PulseFilters
from meshtrace.errors import Refused
from meshtrace.surfaces import FlatSea

FAST = {"led": LedDriver(bandwidth=1e8), "sipm": SiPM(bandwidth=1e8)}
MODELS = ("W", "A", "PC", "CP")


def exponential(tau, n=20_000, pulses=64):
    """Return the response of a pole, by the middles of n equal shares."""
    delay = -tau * np.log1p(-(np.arange(n) + 0.5) / n)
    return ChannelResponse.from_arrivals(delay, np.ones(n), pulses=pulses)


# --- limits --------------------------------------------------------------------------------


@pytest.mark.parametrize("model", MODELS)
def test_a_short_response_gives_the_prompt_error_rate(model):
    prompt = OokLink(bit_rate=5e7, model=model, window=1e-8, **FAST)
    short = exponential(0.99e-3 * prompt.bit_time)
    longer = exponential(1.1e-3 * prompt.bit_time)
    power = prompt.required_power(1e-3) if model != "CP" else 1e-9
    assert prompt.replace(response=short).ber(power) == prompt.ber(power)
    found = float(prompt.replace(response=longer).ber(power))
    # the response enters where it costs little, so that curves have no visible step
    assert found != float(prompt.ber(power))
    assert found == pytest.approx(float(prompt.ber(power)), rel=0.02)


@pytest.mark.parametrize("window", [0.0, 15e-9])
def test_a_common_delay_does_not_matter(window):
    prompt = PulseFilters(2e-9, 4e-9, window)
    late = PulseFilters(2e-9, 4e-9, window, ChannelResponse(delay=(7e-9,), share=(1.0,)))
    for name in ("mean_cursors", "shot_cursors"):
        expected = getattr(prompt, name)(20e-9, 6)
        found = getattr(late, name)(20e-9, 7)
        assert found[:6] == pytest.approx(expected, rel=1e-12, abs=1e-300)
        assert found[6] == 0.0  # of the next bit


@pytest.mark.parametrize("tau", [1e-9, 8e-9, 60e-9])
def test_cursors_behind_a_pole_are_those_of_three_poles(tau):
    led, sipm, bit_time = 3e-9, 5e-9, 20e-9
    response = exponential(tau, pulses=4096)
    found = PulseFilters(led, sipm, 0.0, response).mean_cursors(bit_time, 40)
    poles = np.array([led, sipm, tau])
    others = [np.delete(poles, i) for i in range(3)]
    parts = [p**2 / np.prod(p - q) for p, q in zip(poles, others, strict=True)]
    ahead = math.ceil(tau * math.log(2.0) / bit_time)
    at = np.arange(-ahead, 40 - ahead + 1) * bit_time + tau * math.log(2.0)
    step = np.where(at > 0.0, 1.0 - np.exp(-np.maximum(at, 0.0)[:, None] / poles) @ parts, 0.0)
    step[0] = 0.0  # all light before is that of the next bits
    ends = np.diff(np.append(step[0], step[1:]))
    assert found == pytest.approx(np.roll(ends, -ahead), abs=2e-4)


def test_pulses_keep_light_and_mean_and_spread():
    rng = np.random.default_rng(4)
    delay = np.concatenate([np.zeros(50), rng.exponential(1e-9, 5000), [3e-7]])
    weight = rng.random(delay.size)
    found = ChannelResponse.from_arrivals(delay, weight)
    share, at = np.array(found.share), np.array(found.delay)
    mean = weight @ delay / weight.sum()
    assert len(share) <= 64
    assert share.sum() == pytest.approx(1.0, rel=1e-12)
    assert share @ at == pytest.approx(mean, rel=1e-12)
    spread = math.sqrt(weight @ (delay - mean) ** 2 / weight.sum())
    assert found.rms_spread == pytest.approx(spread, rel=5e-3)


def test_a_response_follows_its_light_without_steps():
    rng = np.random.default_rng(6)
    delay = rng.exponential(3e-9, 4000)
    base = ChannelResponse.from_arrivals(delay, np.ones(4000))
    ook = OokLink(bit_rate=5e7, window=1e-8, **FAST)

    def need(step):
        seen = ChannelResponse.from_arrivals(delay, np.exp(-step * delay / 3e-9), pulses=base.delay)
        assert seen.delay == base.delay
        return math.log(ook.replace(response=seen).required_power(1e-3))

    steps = 1e-3 * np.arange(-2, 3)
    needs = np.array([need(step) for step in steps])
    slopes = np.diff(needs) / 1e-3
    assert slopes.max() < 0.0
    assert np.ptp(slopes) < 0.02 * abs(slopes.mean())


def test_angles_keep_the_mean_shift():
    rng = np.random.default_rng(5)
    angle, weight = rng.random(3000), rng.random(3000)
    found = ChannelResponse.from_arrivals(np.zeros(3000), weight, angle)
    square = np.sin(np.radians(found.angle_deg)) ** 2
    assert square.mean() == pytest.approx(weight @ np.sin(angle) ** 2 / weight.sum(), rel=1e-9)
    angle[:2000] = np.nan
    assert ChannelResponse.from_arrivals(np.zeros(3000), weight, angle).angle_deg == ()


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: ChannelResponse(delay=(0.0, 0.0), share=(0.5, 0.5)), "delay"),
        (lambda: ChannelResponse(delay=(0.0, 1e-9), share=(0.5, 0.6)), "share"),
        (lambda: ChannelResponse(delay=(0.0,), share=(0.5, 0.5)), "share"),
        (lambda: ChannelResponse.from_arrivals([0.0, -1e-9], [1.0, 1.0]), "delay, weight"),
        (lambda: ChannelResponse.from_arrivals([0.0], [0.0]), "delay, weight"),
        (lambda: ChannelResponse.from_arrivals([0.0], [1.0], pulses=0), "pulses"),
    ],
)
def test_refused(make, name):
    with pytest.raises(Refused, match=f"^{name}: "):
        make()


# --- rates ---------------------------------------------------------------------------------


def test_feedback_removes_earlier_bits_only():
    response = exponential(12e-9)
    link = OokLink(bit_rate=5e7, response=response, model="A", **FAST)
    fed = link.replace(equalizer="dfe")
    bits = fed.patterns()
    ahead = fed.filters.bits_ahead(fed.bit_time)
    assert ahead == 1
    mean = fed.moments(1e-9)[0]
    same = (bits[:, 0] == bits[0, 0]) & (bits[:, -1] == bits[0, -1])
    assert np.ptp(mean[same]) == 0.0
    assert np.ptp(link.moments(1e-9)[0][same]) > 0.0
    assert mean[bits[:, -1]].mean() > mean[~bits[:, -1]].mean()
    assert fed.required_power(1e-3) < link.required_power(1e-3)


def test_mixed_information_has_its_limits():
    for low, high in ((2.0, 20.0), (1200.0, 1300.0)):
        alone = soft_information(low, high, 0.03)
        assert mixed_information([low], [high], [1.0], 0.03) == pytest.approx(alone, abs=1e-4)
        split = mixed_information([low, low], [high, high], [0.3, 0.7], 0.03)
        assert split == pytest.approx(alone, abs=1e-4)
    # the light of another bit that is as bright hides half of the patterns
    bright = mixed_information([0.0, 1e6], [1e6, 2e6], [0.5, 0.5], 0.0)
    assert bright == pytest.approx(0.5, abs=1e-3)


def test_capacity_falls_with_the_spread():
    rates = [
        capacity(OokLink(bit_rate=5e7, response=response, **FAST), [1e-6, 2e-6, 3e-6])
        for response in (None, exponential(1e-9), exponential(6e-9), exponential(20e-9))
    ]
    for name in ("hard", "soft", "hard_outage"):
        values = [getattr(rate, name) for rate in rates]
        assert values == sorted(values, reverse=True)
        assert values[-1] < 0.9 * values[0]
    assert all(rate.hard <= rate.soft for rate in rates)


# --- the time domain -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def harbour():
    """Return the impulse response of harbour water in a wide view."""
    link = mt.Link(
        transmitter=mt.Led(depth=8.0, wavelength_nm=514.5),
        receiver=mt.Receiver(height=3.0, fov_deg=180.0),
        water=mt.Water.from_type("petzold-harbour", 514.5),
    )
    result = mt.simulate(link, FlatSea(), photons=1024, record=[mt.Arrivals()])
    return mt.results.impulse_response(result)


CASES = [(2e7, 1e-2), (5e7, 1e-2)]
LIMIT = float(norm.isf(0.5 * (1.0 - (1.0 - 1e-4) ** (1.0 / len(CASES)))))


@pytest.mark.parametrize(("bit_rate", "target"), CASES)
@pytest.mark.thorough
@pytest.mark.slow_but("50000000.0-0.01")
def test_error_rate_agrees_with_bits_through_the_channel(harbour, bit_rate, target):
    """z-test against the exact law at its best threshold, alpha 1e-4 over the family."""
    response = ChannelResponse.from_arrivals(harbour.delay, harbour.weight)
    gaussian = OokLink(bit_rate=bit_rate, response=response, **FAST)
    power, window = gaussian.required_power(target), gaussian.averaging_window
    exact = gaussian.replace(model="CP", window=window)
    channel = Channel(harbour.delay, harbour.weight)
    samples = simulate(gaussian, power, 100_000, seed=17, steps=100, channel=channel)
    found = error_rate(samples, exact.threshold(power))
    expected = float(exact.ber(power))
    stderr = math.sqrt(expected * (1.0 - expected) / samples.bits.size)
    assert abs(found - expected) < LIMIT * stderr
    assert abs(found - target) < 0.08 * target + LIMIT * stderr
    prompt = exact.replace(response=None)
    assert found - float(prompt.ber(power)) > LIMIT * stderr
