"""The statistical tests accept correct samplers and reject wrong ones."""

import numpy as np
import pytest
from mc_statistics import ALPHA, chi2_test, sidak, z_test


def histogram_of_powers(rng, exponent):
    """Draw u^exponent, which is uniform for exponent 1 only."""
    samples = rng.random(100_000) ** exponent
    return np.histogram(samples, bins=np.linspace(0.0, 1.0, 51))[0]


def test_chi2_accepts_a_right_sampler_and_rejects_a_wrong_one():
    rng = np.random.default_rng(1)
    uniform = np.full(50, 0.02)
    assert chi2_test(histogram_of_powers(rng, 1.0), uniform) > ALPHA
    assert chi2_test(histogram_of_powers(rng, 1.03), uniform) < ALPHA


def test_chi2_p_values_of_a_right_sampler_are_uniform():
    rng = np.random.default_rng(2)
    probabilities = np.array([0.1, 0.2, 0.3, 0.4])
    p = np.array(
        [chi2_test(rng.multinomial(5000, probabilities), probabilities) for _ in range(1000)]
    )
    counts = np.histogram(p, bins=np.linspace(0.0, 1.0, 11))[0]
    assert chi2_test(counts, np.full(10, 0.1)) > ALPHA


def test_chi2_equals_the_textbook_value_without_pooling():
    # chi2 = 4 on one degree of freedom is a deviation of two sigma
    assert chi2_test([60, 40], [0.5, 0.5]) == pytest.approx(0.0455, abs=5e-5)


def test_chi2_pools_bins_that_expect_too_little():
    counts = np.array([50, 0, 0, 1, 49])
    probabilities = np.array([0.495, 0.004, 0.003, 0.004, 0.494])
    assert chi2_test(counts, probabilities) == pytest.approx(
        chi2_test([50, 50], [0.495, 0.505]), abs=1e-12
    )


def test_chi2_refuses_probabilities_that_do_not_sum_to_one():
    with pytest.raises(ValueError, match=r"probabilities: sum 0\.9"):
        chi2_test([5, 5], [0.45, 0.45])
    with pytest.raises(ValueError, match="two bins"):
        chi2_test([2, 2], [0.5, 0.5])


def test_z_test():
    assert z_test(1.0, 0.5, 0.0) == pytest.approx(0.0455, abs=1e-4)
    assert z_test(3.0, 3.0, 0.0, 4.0) == pytest.approx(0.5485, abs=1e-4)
    with pytest.raises(ValueError, match="stderr"):
        z_test(1.0, 0.0, 1.0)
    with pytest.raises(ValueError, match="stderr"):
        z_test(1.0, float("nan"), 1.0)


def test_sidak():
    assert sidak(1e-4, 1) == pytest.approx(1e-4)
    assert 1.0 - (1.0 - sidak(1e-4, 20)) ** 20 == pytest.approx(1e-4)
