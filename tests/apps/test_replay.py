"""Waveforms through stored traces, against closed forms."""

import numpy as np
import pytest

from meshtrace import apps
from meshtrace.errors import Refused
from meshtrace.results import ImpulseResponse

TIME = np.linspace(0.0, 2.0, 21)


def trace(gain, **more):
    return apps.ChannelTrace(TIME, np.asarray(gain), *np.zeros((2, *np.shape(gain))), 0.0, **more)


def response(delay, weight):
    """Return an impulse response of arrivals; a replay reads nothing else of it."""
    delay, weight = np.asarray(delay, float), np.asarray(weight, float)
    h = np.zeros(1)
    return ImpulseResponse(
        np.array([0.0, 1.0]), h, h, 0.0, 0.0, 0.0, 0.0, 0.0, delay, weight, np.zeros(len(delay))
    )


RISING = trace(1e-5 * (1.0 + TIME))


def test_gains_are_linear_between_frames(rng):
    x, rate, start = rng.random(300), 200.0, 0.33
    t = start + np.arange(300) / rate
    found = apps.replay(x, rate, RISING, start=start)
    np.testing.assert_allclose(found, 1e-5 * (1.0 + t) * x, rtol=1e-13)


def test_echoes_come_at_their_delays(rng):
    """Two arrivals a whole number of samples apart: y = g (w0 x(t) + w1 x(t - d)) / (w0 + w1)."""
    x, rate = rng.random(150), 100.0
    found = apps.replay(x, rate, RISING, response([0.0, 0.07], [3.0, 1.0]))
    late = np.concatenate([np.zeros(7), x[:-7]])
    gain = 1e-5 * (1.0 + np.arange(150) / rate)
    np.testing.assert_allclose(found, gain * (0.75 * x + 0.25 * late), rtol=1e-12, atol=1e-20)


def test_a_tone_passes_an_exponential_channel():
    """H(f) = 1 / (1 + 2 pi i f T) in gain and phase, once the channel has filled."""
    scale, rate, f = 2e-3, 1e5, 60.0
    delay = scale * -np.log1p(-(np.arange(20_000) + 0.5) / 20_000)
    t = np.arange(20_000) / rate
    found = apps.replay(
        np.exp(2j * np.pi * f * t).real, rate, RISING, response(delay, np.ones(20_000))
    )
    expected = (np.exp(2j * np.pi * f * t) / (1.0 + 2j * np.pi * f * scale)).real * 1e-5 * (1.0 + t)
    full = t > 20.0 * scale
    assert np.abs(found - expected)[full].max() < 2e-4 * np.abs(expected).max()


def test_directions_and_receivers():
    two = trace(np.stack([1.0 + TIME, 3.0 + TIME], axis=1))
    assert apps.replay([1.0], 10.0, two, receiver=1) == pytest.approx([3.0])
    columns = {f"down_{name}": 2.0 * TIME for name in ("gain", "gain_stderr", "gain_ballistic")}
    both = trace(TIME, down_gain_mean_stderr=0.0, **columns)
    assert apps.replay([1.0, 1.0], 1.0, both, direction="down") == pytest.approx([0.0, 2.0])


@pytest.mark.parametrize(
    ("change", "field"),
    [({"start": 1.5}, "waveform"), ({"receiver": 1}, "receiver"), ({"direction": "down"}, "direction"),
     ({"waveform": [[1.0]]}, "waveform"), ({"waveform": []}, "waveform"),
     ({"rate": 1e12, "response": response([0.0, 1.0], [1.0, 1.0])}, "rate")],
)  # fmt: skip
def test_what_the_trace_lacks_is_refused(change, field):
    arguments = {"waveform": np.ones(100), "rate": 100.0, "trace": RISING, **change}
    with pytest.raises(Refused, match=rf"^{field}: "):
        apps.replay(**arguments)
