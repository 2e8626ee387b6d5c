"""The sampling kernel against its array twin, the CDF, and one compilation for all."""

import numba
import numpy as np
import pytest
from phases import draw, label

from meshtrace.optics import (
    FournierForand,
    HenyeyGreenstein,
    HistogramPhase,
    MixturePhase,
    Petzold,
    Rayleigh,
    TabulatedPhase,
)

EDGES = np.linspace(0.0, np.pi, 181)
SINGLE = [
    FournierForand(),
    FournierForand(cdf_coef="paper"),
    FournierForand(n=1.021, mu=3.0742),
    FournierForand(n=1.15, mu=4.874),
    HenyeyGreenstein(g=0.924),
    HenyeyGreenstein(g=0.0),
    HenyeyGreenstein(g=-0.9),
    Rayleigh(),
    Rayleigh(gamma=0.01),
    Petzold(),
    Petzold(water="coastal"),
    TabulatedPhase(theta_deg=(0.0, 1.0, 90.0, 180.0), value=(9.0, 9.0, 1.0, 2.0)),
    HistogramPhase(theta_edges=EDGES, cdf=Petzold().cdf(EDGES) / Petzold().cdf(np.pi)),
]
MIXTURES = [
    MixturePhase(components=(FournierForand(), Rayleigh()), weights=(0.9, 0.1)),
    MixturePhase(components=(HenyeyGreenstein(g=0.9), Petzold(), Rayleigh()), weights=(1, 1, 1)),
]
TINY = np.geomspace(1e-16, 1e-3, 500)
U = np.concatenate([[0.0], TINY, np.random.default_rng(5).random(20_000), 1.0 - TINY[1:]])


@pytest.mark.parametrize("phase", SINGLE + MIXTURES, ids=label)
def test_the_kernel_inverts_the_cdf(phase):
    s = draw(phase.tables(), U)
    # half a step where a density jumps
    tolerance = 7.7e-6 if isinstance(phase, HistogramPhase) else 5.2e-7
    assert np.max(np.abs(phase._cdf_s(s) - U)) <= tolerance


@pytest.mark.parametrize("phase", SINGLE + MIXTURES, ids=label)
def test_the_sample_grows_with_u(phase):
    s = draw(phase.tables(), np.sort(U))
    assert np.all(np.diff(s) >= -1e-15)


@pytest.mark.parametrize("phase", SINGLE + MIXTURES, ids=label)
def test_the_kernel_agrees_with_its_array_twin(phase):
    theta = 2.0 * np.arcsin(np.sqrt(draw(phase.tables(), U)))
    np.testing.assert_allclose(theta, phase.sample(U), rtol=1e-9, atol=1e-7)


@pytest.mark.parametrize("phase", SINGLE + MIXTURES, ids=label)
def test_samples_are_angles_even_at_the_ends(phase):
    s = draw(phase.tables(), np.array([0.0, 5e-324, 1e-300, 0.5, 1.0 - 2.0**-53, 1.0]))
    assert np.all((s >= 0.0) & (s <= 1.0))
    assert s[0] == 0.0


def test_fournier_forand_quantiles():
    quantiles = {
        1e-3: 7.16630229e-5,
        0.01: 0.00370767237,
        0.1: 0.192928164,
        0.25: 0.967497283,
        0.5: 3.83531888,
        0.75: 12.0659459,
        0.9: 31.1718685,
        0.99: 113.437217,
        0.999: 160.633785,
    }
    u = np.array(list(quantiles))
    theta = np.array(list(quantiles.values()))
    phase = FournierForand()
    np.testing.assert_allclose(phase.cdf(np.radians(theta)), u, rtol=2e-9)
    sampled = np.degrees(2.0 * np.arcsin(np.sqrt(draw(phase.tables(), u))))
    np.testing.assert_allclose(sampled, theta, rtol=1e-4)


def test_small_angles_are_not_rounded():
    u = np.array([1e-10, 1e-6])
    s = draw(FournierForand().tables(), u)
    np.testing.assert_allclose(s, (u / 4.168222) ** (1.0 / 0.29175), rtol=1e-2)


def test_one_compilation_serves_every_phase_function():
    types = {numba.typeof(phase.tables()) for phase in SINGLE + MIXTURES}
    assert len(types) == 1
    assert types.pop().types[0].layout == "C"


def test_tables_are_computed_once():
    assert FournierForand().tables() is FournierForand().tables()
    assert FournierForand().tables() is not FournierForand(n=1.2).tables()


def test_a_mixture_of_one_phase_function_with_itself_is_that():
    phase = FournierForand()
    twice = MixturePhase(components=(phase, phase), weights=(0.9, 0.1))
    np.testing.assert_allclose(twice.tables().nodes, phase.tables().nodes, rtol=1e-9)
