"""Sobol points and Poisson's law of the chains against scipy, which takes long to import."""

import numpy as np
import pytest
from scipy import stats

from meshtrace.engine.chains import sampling, sets

HIGHEST = len(sets.poisson_law(1.0)) - 1
WIDEST = sampling.DIMENSIONS * HIGHEST + 6


@pytest.mark.parametrize(("width", "doublings"), [(1, 1), (9, 10), (WIDEST, 6), (12, 18)])
def test_points_are_those_of_scipy(width, doublings):
    expected = stats.qmc.Sobol(width, rng=np.random.default_rng(3)).random_base2(doublings)
    assert np.array_equal(
        sets.sobol_points(width, 2**doublings, np.random.default_rng(3)), expected
    )


def test_a_number_between_powers_of_two_leaves_out_the_last():
    many, few = (sets.sobol_points(5, n, np.random.default_rng(1)) for n in (64, 37))
    assert np.array_equal(few, many[:37])


@pytest.mark.parametrize("mean", [1e-6, 0.3, 7.0, 72.0, 2000.0])
def test_poisson_law(mean):
    expected = stats.poisson.pmf(np.arange(HIGHEST + 1), mean)
    assert sets.poisson_law(mean) == pytest.approx(expected, rel=1e-12)
