"""Exponentials of rows against the C library."""

import numpy as np

from meshtrace.kernels import jit, tints


@jit.allocating_entry
def replaced(x, powers):
    tints.exponentiate(x, powers)


def exponentials(x):
    values = np.array(x)
    replaced(values, np.empty_like(values))
    return values


def test_against_numpy():
    halves = np.log(2.0) * (np.arange(-1000, 1001) + 0.5)  # where the power of two changes
    for x in (np.linspace(-700.0, 700.0, 100_001), np.geomspace(1e-300, 1.0, 1000), halves):
        np.testing.assert_allclose(exponentials(x), np.exp(x), rtol=4e-16)
    for n in range(9):  # with and without a remainder of the vectors
        x = np.linspace(-3.0, 1.0, n)
        np.testing.assert_allclose(exponentials(x), np.exp(x), rtol=4e-16)


def test_exact_and_limited():
    found = exponentials(np.array([0.0, -0.0, -1e4, -np.inf, 1e4, np.inf]))
    ends = np.exp([-700.0, 700.0])
    np.testing.assert_allclose(found, [1.0, 1.0, *ends[[0, 0, 1, 1]]], rtol=4e-16)
    assert (found[:2] == 1.0).all()
