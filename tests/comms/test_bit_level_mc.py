"""Bit-level Monte Carlo (pulses, photons, filters, threshold) against the analytic error rates."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bit_level import branch, error_rate, simulate
from scipy.stats import norm

from meshtrace.comms import OokLink, SiPM
from meshtrace.comms.decisions import generalized_poisson_decision, generalized_poisson_logpmf

CASES = [
    (model, rate, target)
    for model in ("W", "A")
    for rate in (1e6, 5e6, 1e7)
    for target in (1e-2, 1e-3)
]
LIMIT = float(norm.isf(0.5 * (1.0 - (1.0 - 1e-4) ** (1.0 / len(CASES)))))


@pytest.mark.parametrize(("model", "bit_rate", "target"), CASES)
@pytest.mark.thorough
@pytest.mark.slow_but(
    "W-1000000.0-0.001", "W-5000000.0-0.01", "A-5000000.0-0.001", "A-10000000.0-0.01"
)
def test_error_rate_agrees(model, bit_rate, target):
    """z-test against the exact law (alpha 1e-4 over the family) at its best threshold.

    There the Gaussian model's own error rate lies within 8 % of the exact one, see `test_ook_ber`;
    beyond the Monte Carlo error it must therefore agree within 8 % too.
    """
    gaussian = OokLink(bit_rate=bit_rate, model=model)
    power = gaussian.required_power(target)
    exact = OokLink(bit_rate=bit_rate, model="CP", window=gaussian.averaging_window)
    samples = simulate(gaussian, power, 100_000 if target > 5e-3 else 300_000, seed=17)
    found = error_rate(samples, exact.threshold(power))
    expected = float(exact.ber(power))
    stderr = math.sqrt(expected * (1.0 - expected) / samples.bits.size)
    assert abs(found - expected) < LIMIT * stderr
    assert abs(found - target) < 0.08 * target + LIMIT * stderr


@pytest.mark.parametrize(
    ("model", "bit_rate", "excess"), [("W", 1e6, 1.5), ("W", 5e6, 1.4), ("A", 1e6, 2.2)]
)
@pytest.mark.slow_but("W-5000000.0-1.4", "A-1000000.0-2.2")
def test_gaussian_threshold_costs_errors(model, bit_rate, excess):
    """The Gaussian threshold is too low for skewed counts: more errors than the model says."""
    gaussian = OokLink(bit_rate=bit_rate, model=model)
    power = gaussian.required_power(1e-3)
    samples = simulate(gaussian, power, 200_000, seed=23)
    exact = OokLink(bit_rate=bit_rate, model="CP", window=gaussian.averaging_window)
    assert gaussian.threshold(power) < exact.threshold(power)
    assert error_rate(samples, gaussian.threshold(power)) > excess * 1e-3


@pytest.mark.parametrize("bit_rate", [1e6, 5e6, 1e7])
@pytest.mark.slow_but("5000000.0")
def test_sample_moments_agree(bit_rate):
    """Campbell's mean and variance of the samples, z-tests with alpha 1e-4 over the family."""
    window = OokLink(bit_rate=bit_rate).averaging_window
    link = OokLink(bit_rate=bit_rate, window=window)
    power, count = 1e-10, 12
    samples = simulate(link, power, 200_000, seed=5)
    bits = np.stack([np.roll(samples.bits, k) for k in range(count)], axis=1)
    low, high = (float(level) for level in link.levels(power))
    shot = bits @ link.filters.shot_cursors(link.bit_time, count)
    energy = link.filters.noise_energy
    mean = low + (high - low) * (bits @ link.filters.mean_cursors(link.bit_time, count))
    variance = link.sipm.excess_noise_factor * (low * energy + (high - low) * shot)
    variance += 0.5 * link.tia.thermal_noise(link.sipm.electrons_per_count) * energy
    # Earlier bits are unknown at the joints of the simulation's blocks.
    known = np.arange(samples.value.size) % 20_000 >= count
    z = ((samples.value - mean) / np.sqrt(variance))[known]
    one = samples.bits[known]
    limit = float(norm.isf(0.5 * (1.0 - (1.0 - 1e-4) ** (1.0 / 18.0))))
    # Neighbouring samples share counts; means of long blocks do not.
    for group in (z[one], z[~one], z):
        for order, expected in ((1, 0.0), (2, 1.0)):
            blocks = np.array([part.mean() for part in np.array_split(group**order, 400)])
            stderr = blocks.std(ddof=1) / math.sqrt(blocks.size)
            assert abs(blocks.mean() - expected) < limit * stderr


def test_counting_without_filters_agrees():
    """Branching photons counted per bit against the generalized Poisson error rate."""
    rng = np.random.default_rng(2)
    lam, n_bits = SiPM().branching, 400_000
    law = generalized_poisson_decision(2.0, 20.0, lam)
    bits = rng.random(n_bits) < 0.5
    counts = branch(rng.poisson(np.where(bits, 20.0, 2.0)), lam, rng)
    found = np.mean((counts >= float(law.threshold)) != bits)
    expected = float(law.ber)
    assert abs(found - expected) < norm.isf(5e-5) * math.sqrt(expected / n_bits)


def test_branching_follows_the_generalized_poisson_law():
    from scipy.stats import chisquare

    rng = np.random.default_rng(7)
    counts = branch(rng.poisson(5.0, 200_000), 0.3, rng)
    edges = np.arange(30)
    expected = np.exp(generalized_poisson_logpmf(edges, 5.0, 0.3)) * counts.size
    observed = np.bincount(np.minimum(counts, 30), minlength=31).astype(float)
    expected = np.append(expected, counts.size - expected.sum())
    assert chisquare(observed, expected).pvalue > 1e-4
