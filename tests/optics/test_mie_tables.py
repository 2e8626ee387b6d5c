"""Slow checks of the bubble phase table: its recipe, an independent average, published values."""

import numpy as np
import pytest

from meshtrace.optics import HallNovarini, mie
from meshtrace.optics.bubbles import compute_bubble_phase

# real index m, size parameter x, Q_sca, g: Wiscombe 1979, NCAR/TN-140+STR
WISCOMBE = (
    (0.75, 10.0, 2.232265, 0.896473),
    (0.75, 1000.0, 1.997908, 0.844944),
    (1.5, 10.0, 2.881999, 0.742913),
    (1.5, 100.0, 2.094388, 0.818246),
    (1.5, 1000.0, 2.013945, 0.827882),
)
BUBBLES = HallNovarini(wind_speed=13.0)


@pytest.mark.parametrize(("m", "x", "q_sca", "g"), WISCOMBE)
def test_wiscombe(m, x, q_sca, g):
    q = mie.efficiencies(m, x)
    assert q.q_sca == pytest.approx(q_sca, abs=1e-6)
    assert q.g == pytest.approx(g, abs=1e-6)


@pytest.mark.slow
@pytest.mark.external
def test_recipe_gives_the_shipped_table():
    theta_edges, cdf = BUBBLES.phase_table()
    table = compute_bubble_phase()
    np.testing.assert_allclose(table.theta_edges, theta_edges, rtol=1e-14)
    np.testing.assert_allclose(table.cdf, cdf, atol=1e-10)
    assert table.q_sca == pytest.approx(BUBBLES.scattering_efficiency, rel=1e-12)


@pytest.mark.slow
@pytest.mark.external
def test_fewer_sizes_agree():
    _, cdf = BUBBLES.phase_table()
    table = compute_bubble_phase(sizes=1024, rotations=16)
    assert np.abs(table.cdf - cdf).max() < 1.4e-4
    assert table.q_sca == pytest.approx(BUBBLES.scattering_efficiency, rel=1e-4)
    assert abs(table.closure) < 2e-4


@pytest.mark.slow
@pytest.mark.external
def test_phase_function_hardly_depends_on_depth():
    """The bounds that allow one phase function for all depths."""
    surface = compute_bubble_phase(sizes=2048, rotations=16)
    degrees = np.rad2deg(surface.theta_edges)
    for depth, bound in [(1.0, 3.7e-3), (2.0, 1.2e-2), (3.0, 1.9e-2)]:
        table = compute_bubble_phase(depth=depth, sizes=2048, rotations=16)
        difference = np.abs(table.cdf - surface.cdf)
        assert difference.max() == pytest.approx(bound, rel=0.05)
        assert degrees[difference.argmax()] < 0.1
        assert difference[degrees > 1.0].max() < 3e-3
    assert table.g == pytest.approx(0.85022, abs=1e-5)
    assert table.q_sca == pytest.approx(2.0264, abs=1e-4)


@pytest.mark.slow
@pytest.mark.external
def test_density_equals_an_independent_average():
    """Random sizes from a numerical inverse, many angles each, 12 windows of angle."""
    windows = np.array(
        [(c * 0.98, c * 1.02) for c in (0.1, 0.5, 1.0, 2.0)]
        + [(c - 0.5, c + 0.5) for c in (5.5, 10.0, 30.0, 60.0, 82.5, 90.0, 120.0, 150.0)]
    )
    rng = np.random.default_rng(1)
    r = np.geomspace(BUBBLES.r_min, BUBBLES.r_max, 200_001)
    weight = BUBBLES.size_distribution(r, 0.0) * r**2
    quantile = np.concatenate(([0.0], np.cumsum((weight[1:] + weight[:-1]) / 2 * np.diff(r))))
    upper, lower = np.cos(np.deg2rad(windows)).T
    batches = []
    for _ in range(6):
        u = (np.arange(2000) + rng.random(2000)) / 2000
        x = 2 * np.pi * 1.33 / 470e-9 * np.interp(u, quantile / quantile[-1], r)[::-1]
        cosine = upper[:, None] + (lower - upper)[:, None] * (
            (np.arange(100) + rng.random((windows.shape[0], 100))) / 100
        )
        intensity = mie._intensities(1 / 1.33, x, cosine.ravel()) / (np.pi * x**2)
        mean = intensity.mean(axis=1) / mie.efficiencies(1 / 1.33, x).q_sca.mean()
        batches.append(mean.reshape(cosine.shape).mean(axis=1))
    beta = np.mean(batches, axis=0)
    stderr = np.std(batches, axis=0, ddof=1) / np.sqrt(len(batches))
    theta_edges, cdf = BUBBLES.phase_table()
    inside = np.interp((1 - np.cos(np.deg2rad(windows))) / 2, np.sin(theta_edges / 2) ** 2, cdf)
    table = np.diff(inside)[:, 0] / (2 * np.pi * (upper - lower))
    # The table's own error in such windows is about 5e-4 (bin width and averaging).
    assert np.all(np.abs(table - beta) < 4 * np.hypot(stderr, 5e-4 * beta))
