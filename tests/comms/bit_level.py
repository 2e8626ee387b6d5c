"""Time-domain twin of the receiver: random bits, photon by photon, through poles and window.

It shares no formula with `meshtrace.comms.pulses` or the error rates of `meshtrace.comms.ook`: the LED's
pole runs as a recursion over the bits, every avalanche branches at random, and the filters act by
convolution with their impulse response.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter, oaconvolve

from meshtrace.comms import OokLink


class Channel(NamedTuple):
    """Delays [s] and weights of the light that arrives."""

    delay: NDArray[np.float64]
    weight: NDArray[np.float64]


class Samples(NamedTuple):
    """Sent bits and the receiver's sample of each, in primary counts per second."""

    bits: NDArray[np.bool_]
    value: NDArray[np.float64]


def branch(primaries: NDArray[np.int64], branching: float, rng: np.random.Generator) -> NDArray:
    """Total counts of primaries of which each starts a Poisson branching process."""
    total = primaries.copy()
    generation = primaries
    while generation.any():
        generation = rng.poisson(branching * generation)
        total += generation
    return total


def simulate(
    link: OokLink,
    power: float,
    n_bits: int,
    seed: int,
    steps: int = 40,
    block: int = 20_000,
    channel: Channel | None = None,
) -> Samples:
    """Send random bits and sample the receiver at the end of each, in independent blocks.

    Behind a channel the samples are taken later by the median delay.
    """
    rng = np.random.default_rng(seed)
    runs = [
        _block(link, power, block, rng, steps, channel) for _ in range(math.ceil(n_bits / block))
    ]
    return Samples(*(np.concatenate(part) for part in zip(*runs, strict=True)))


def _block(
    link: OokLink,
    power: float,
    n_bits: int,
    rng: np.random.Generator,
    steps: int,
    channel: Channel | None,
) -> Samples:
    warm_up, later = 12, 2
    bits = rng.random(n_bits + warm_up + later) < 0.5
    dt = link.bit_time / steps
    low, high = (float(level) for level in link.levels(power))
    drive = np.repeat(bits, steps)
    light, lag = _light_per_step(drive, link.led.time_constant, dt, low, high), 0
    if channel is not None:
        taps, lag = _taps(channel, dt)
        light = low * dt + np.maximum(oaconvolve(light - low * dt, taps)[: light.size], 0.0)
    counts = branch(rng.poisson(light), link.sipm.branching, rng)
    signal = oaconvolve(counts, _impulse_response(link, dt))[: counts.size]
    sample = signal[steps - 1 + lag :: steps] / link.sipm.excess_noise_factor
    sample += _thermal(link, sample.size, rng)
    return Samples(bits[warm_up:-later], sample[warm_up : warm_up + n_bits])


def _taps(channel: Channel, dt: float) -> tuple[NDArray[np.float64], int]:
    """Return the light of a channel by steps, and its median delay in steps.

    Each delay is shared out between two steps; the median falls on one of them.
    """
    order = np.argsort(channel.delay)
    share = np.cumsum(channel.weight[order]) / channel.weight.sum()
    median = channel.delay[order][np.searchsorted(share, 0.5)]
    lag = math.ceil(median / dt)
    at = (channel.delay - median) / dt + lag
    left = np.floor(at).astype(int)
    right = at - left
    size = left.max() + 2
    taps = np.bincount(left, channel.weight * (1.0 - right), size)
    taps += np.bincount(left + 1, channel.weight * right, size)
    return taps / taps.sum(), lag


def _light_per_step(
    drive: NDArray[np.bool_], tau: float, dt: float, low: float, high: float
) -> NDArray[np.float64]:
    decay = math.exp(-dt / tau)
    after = lfilter([1.0 - decay], [1.0, -decay], drive)
    before = np.concatenate(([0.0], after[:-1]))
    return low * dt + (high - low) * (drive * dt - tau * (after - before))


def _impulse_response(link: OokLink, dt: float) -> NDArray[np.float64]:
    """Response at the sample to a count in the middle of each earlier step."""
    tau, window = link.sipm.time_constant, link.averaging_window
    age = (np.arange(math.ceil((window + 30.0 * tau) / dt)) + 0.5) * dt
    if window == 0.0:
        return np.exp(-age / tau) / tau
    return (np.exp(-np.maximum(age - window, 0.0) / tau) - np.exp(-age / tau)) / window


def _thermal(link: OokLink, size: int, rng: np.random.Generator) -> NDArray[np.float64]:
    tau, window = link.sipm.time_constant, link.averaging_window
    energy = 0.5 / tau
    if window > 0.0:
        energy = (window - tau * (1.0 - math.exp(-window / tau))) / window**2
    density = 0.5 * link.tia.thermal_noise(link.sipm.electrons_per_count)
    return math.sqrt(density * energy) * rng.standard_normal(size)


def best_threshold(samples: Samples) -> float:
    """Threshold with the fewest errors on the given samples."""
    order = np.argsort(samples.value)
    ones = np.cumsum(samples.bits[order])
    zeros_above = np.count_nonzero(~samples.bits) - np.cumsum(~samples.bits[order])
    return float(samples.value[order][np.argmin(ones + zeros_above)])


def error_rate(samples: Samples, threshold: float) -> float:
    """Share of bits read wrongly with a threshold."""
    return float(np.mean((samples.value > threshold) != samples.bits))
