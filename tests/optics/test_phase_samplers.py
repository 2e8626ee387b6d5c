"""Chi-square test of every phase-function sampler against the quadrature of its own pdf."""

import numpy as np
import pytest
from mc_statistics import ALPHA, chi2_test, sidak
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

SAMPLES = 1_000_000
HISTOGRAM_EDGES = np.linspace(0.0, np.pi, 61)
TABLE_DEG = (0.2, 1.0, 4.0, 30.0, 90.0, 140.0)
PHASES = [
    FournierForand(),
    FournierForand(cdf_coef="paper"),
    FournierForand(n=1.04, mu=3.201),
    FournierForand(n=1.15, mu=4.874),
    HenyeyGreenstein(g=0.924),
    HenyeyGreenstein(g=0.0),
    HenyeyGreenstein(g=-0.5),
    Rayleigh(),
    Rayleigh.sea_water(),
    Petzold(),
    Petzold(water="clear"),
    Petzold(water="coastal"),
    Petzold(water="harbour"),
    TabulatedPhase(theta_deg=TABLE_DEG, value=(900.0, 80.0, 4.0, 0.05, 0.002, 0.004)),
    HistogramPhase(theta_edges=HISTOGRAM_EDGES, cdf=HenyeyGreenstein(g=0.7).cdf(HISTOGRAM_EDGES)),
    MixturePhase(components=(FournierForand(), Rayleigh.sea_water()), weights=(0.9, 0.1)),
    MixturePhase(
        components=(
            MixturePhase(components=(Petzold(), HenyeyGreenstein(g=-0.3)), weights=(1.0, 2.0)),
            FournierForand(n=1.08, mu=3.483),
        ),
        weights=(5.0, 1.0),
    ),
]


def bin_edges():
    """Return edges from 1e-4 degrees on, among them every kink of the tables above."""
    petzold_deg = 10.0 ** np.arange(-1.0, 1.01, 0.1)
    fine = [0.0, 1e-4, 1e-3, 1e-2, 0.03, *petzold_deg.round(3), *TABLE_DEG]
    return np.unique(
        np.concatenate([np.radians(fine), HISTOGRAM_EDGES, np.radians(range(5, 180, 5))])
    )


def probabilities(phase, edges):
    """Integrate 2 pi pdf sin over each bin by Gauss' rule in log(theta); the first is the rest."""
    x, weight = np.polynomial.legendre.leggauss(24)
    low, high = np.log(edges[1:-1, None]), np.log(edges[2:, None])
    theta = np.minimum(np.exp(low + (high - low) * (x + 1.0) / 2.0), np.pi)
    density = 2.0 * np.pi * phase.pdf(theta) * np.sin(theta) * theta
    rest = np.sum(weight * density, axis=1) * (high - low)[:, 0] / 2.0
    return np.append(1.0 - rest.sum(), rest)


@pytest.mark.parametrize("index", range(len(PHASES)), ids=[label(phase) for phase in PHASES])
def test_samples_follow_the_pdf(index):
    phase, edges = PHASES[index], bin_edges()
    u = np.random.default_rng([2026, index]).random(SAMPLES)
    theta = 2.0 * np.arcsin(np.sqrt(draw(phase.tables(), u)))
    counts = np.histogram(theta, bins=edges)[0]
    assert counts.sum() == SAMPLES
    assert chi2_test(counts, probabilities(phase, edges)) > sidak(ALPHA, len(PHASES))


def test_the_test_tells_the_printed_cdf_from_the_exact_one():
    # the 9.7e-4 between the two forms is seen, so a sampler that far off would be
    edges = bin_edges()
    u = np.random.default_rng(7).random(SAMPLES)
    theta = 2.0 * np.arcsin(np.sqrt(draw(FournierForand(cdf_coef="paper").tables(), u)))
    counts = np.histogram(theta, bins=edges)[0]
    assert chi2_test(counts, probabilities(FournierForand(), edges)) < ALPHA
