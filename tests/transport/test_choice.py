"""Choice between chains and adjoint paths, from their pilots."""

import numpy as np
import pytest

from meshtrace.transport.choice import ScatteredPilot, chain_cost, choose


def pilot(mean, relative_error, samples):
    error = relative_error * mean
    return ScatteredPilot(np.array([mean]), np.array([error**2 * samples]), np.array([error]))


@pytest.mark.parametrize(
    ("expected", "error_of_paths", "method"),
    [(20.0, 0.6, "chains"), (20.0, 0.1, "adjoint"), (0.4, 0.6, "adjoint")],
    ids=["one heavy path", "certain", "clear water"],
)
def test_twice_the_light_of_turbid_paths_must_be_certain(expected, error_of_paths, method):
    chains, paths = pilot(1.0, 0.1, 500), pilot(2.3, error_of_paths, 2048)
    assert choose(chains, paths, expected) == [method]


def test_chains_may_vary_more_where_paths_are_long():
    chains, paths = pilot(1.0, 0.05, 4000), pilot(1.0, 0.05, 2048)
    assert choose(chains, paths, 0.4) == ["adjoint"]
    assert choose(chains, paths, 20.0) == ["chains"]
    assert chain_cost(20.0) == pytest.approx(0.1)
    assert chain_cost(10.0) == pytest.approx(0.2)
