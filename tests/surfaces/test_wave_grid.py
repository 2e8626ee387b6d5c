"""Sums on grids by non-uniform FFT agree with the plain sum, and do not depend on threads."""

from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import numpy as np
import pytest

from meshtrace.surfaces import JonswapSea, WaveComponents, resolved_sea, triangulate
from meshtrace.surfaces.waves import WaveGrid, elevation_and_slopes


def sea_waves(n, longest, shortest, seed=0):
    """Return waves of random directions and phases, of equal steepness per octave."""
    rng = np.random.default_rng(seed)
    k = 2.0 * np.pi / np.exp(rng.uniform(np.log(shortest), np.log(longest), n))
    heading = rng.uniform(-np.pi, np.pi, n)
    phase = rng.uniform(0.0, 2.0 * np.pi, n)
    kx, ky = k * np.cos(heading), k * np.sin(heading)
    return WaveComponents(0.05 / k / np.sqrt(n), np.sqrt(9.81 * k), kx, ky, phase)


def plain(waves, x, y, time):
    """Return elevation and slopes in extended precision, wave by wave."""
    exact = [np.asarray(a, np.longdouble) for a in waves]
    found = np.zeros((3, len(x), len(y)), np.longdouble)
    x, y = np.asarray(x, np.longdouble)[:, None], np.asarray(y, np.longdouble)
    for a, omega, kx, ky, phase in zip(*exact, strict=True):
        phi = omega * np.longdouble(time) + phase - kx * x - ky * y
        found[0] += a * np.cos(phi)
        found[1] += a * kx * np.sin(phi)
        found[2] += a * ky * np.sin(phi)
    return found.astype(float)


EVEN = triangulate.GridLines(2.0, 0.1).axis(), triangulate.GridLines(1.5, 0.1).axis(0.25)
GRADED = (
    triangulate.GridLines(3.0, 0.05, fine_extent=0.5).axis(),
    triangulate.GridLines(2.0, 0.06, fine_extent=0.5).axis(0.3),
)
CASES = {
    "even": (200, 20.0, 0.3, EVEN),
    "even number of lines": (100, 20.0, 0.3, (EVEN[0][:-1], EVEN[1])),
    "graded": (200, 20.0, 0.3, GRADED),
    "even and graded": (200, 20.0, 0.3, (EVEN[0], GRADED[1])),
    "thousands of waves": (5000, 20.0, 0.3, tuple(axis[::4] for axis in EVEN)),
    "long waves": (200, 2000.0, 100.0, EVEN),
    "shorter than two lines": (200, 1.0, 0.05, EVEN),
    "large domain": (100, 50.0, 3.0, (np.linspace(-500.0, 500.0, 81), np.linspace(0.0, 400.0, 61))),
    "one line": (2000, 20.0, 0.3, (EVEN[0], np.array([0.7]))),
}


@lru_cache
def wanted_of(name):
    n, longest, shortest, axes = CASES[name]
    waves = sea_waves(n, longest, shortest)
    return waves, axes, plain(waves, *axes, 3.0)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("fast", [True, False], ids=["fft", "direct"])
def test_it_is_the_plain_sum(name, fast):
    waves, axes, wanted = wanted_of(name)
    grid = WaveGrid(waves.kx, waves.ky, *axes)
    grid._fast = fast
    weights = elevation_and_slopes(waves, 3.0)
    got = grid.sum(weights)
    assert got.shape == wanted.shape
    rms = np.sqrt(0.5 * np.square(np.abs(weights)).sum(axis=1))
    # hs and steepness are 4 rms
    error = 1e-5 if fast else 5e-12
    assert (np.abs(got - wanted).max(axis=(1, 2)) < error * rms).all()


@pytest.mark.parametrize("axes", [EVEN, GRADED], ids=["even", "graded"])
def test_it_holds_far_from_the_origin(axes):
    x, y = (1e4 + axis for axis in axes)
    waves = sea_waves(200, 100.0, 1.0)
    wanted = plain(waves, x, y, 0.0)[0]
    got = WaveGrid(waves.kx, waves.ky, x, y).sum(elevation_and_slopes(waves, 0.0))[0]
    assert np.abs(got - wanted).max() < 1e-5 * np.sqrt(0.5 * np.square(waves.amplitude).sum())


def test_the_faster_way_is_taken():
    few, many = sea_waves(5, 20.0, 0.3), sea_waves(2000, 20.0, 0.3)
    assert not WaveGrid(few.kx, few.ky, *EVEN)._fast
    for axes in (EVEN, GRADED):
        assert WaveGrid(many.kx, many.ky, *axes)._fast
    # lines that lie 100 wavelengths apart
    far = np.linspace(-3.0, 3.0, 51) ** 3 * 10.0
    assert not WaveGrid(many.kx, many.ky, far, far)._fast
    assert WaveGrid(many.kx[:0], many.ky[:0], *EVEN).sum(np.zeros((2, 0), complex)).max() == 0.0


def test_one_two_or_three_sums_are_the_same():
    waves, axes, _ = wanted_of("graded")
    grid = WaveGrid(waves.kx, waves.ky, *axes)
    weights = elevation_and_slopes(waves, 3.0)
    together = grid.sum(weights)
    for rows in (slice(0, 1), slice(1, 3)):
        np.testing.assert_allclose(grid.sum(weights[rows]), together[rows], rtol=0.0, atol=1e-6)


def test_threads_and_other_frames_leave_every_bit():
    sea = resolved_sea(5.0).model_copy(update={"omega_max": 13.0})
    x = triangulate.GridLines(3.0, 0.05, fine_extent=0.5).axis()
    times = np.arange(12) * 0.1
    one = [sea.with_seed(0).grid(x, x, t) for t in times]
    with ThreadPoolExecutor(4) as pool:
        several = list(pool.map(lambda t: sea.grid(x, x, t), times[::-1]))[::-1]
    alone = resolved_sea(5.0).model_copy(update={"omega_max": 13.0})
    np.testing.assert_array_equal(one, several)
    np.testing.assert_array_equal(one[5], alone.grid(x, x, times[5]))


def test_a_choppy_sea_takes_its_displacements_from_one_sum():
    sea = JonswapSea(wind_speed=8.0, choppy=True, omega_max=4.0)
    x, y = EVEN
    got = sea._sheet.on_grid(sea._grid(x, y), x, y, 2.0)
    points = np.meshgrid(x, y, indexing="ij")
    wanted = sea._sheet._over(*points, 2.0)
    for one, other in zip(got, wanted, strict=True):
        np.testing.assert_allclose(
            one, other, rtol=0.0, atol=1e-6 * 2.1
        )  # of hs, and its derivatives
