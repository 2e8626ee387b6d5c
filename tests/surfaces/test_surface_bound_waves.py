"""Bound waves of second order against published kernels, double sums and Monte Carlo moments."""

import json
import math
import pickle
from itertools import pairwise

import numpy as np
import pytest

from meshtrace.errors import Refused
from meshtrace.surfaces import (
    JonswapSea,
    MeasuredSea,
    SpectralSea,
    Tma,
    bands,
    nonlinear,
    sea_from_config,
)
from meshtrace.surfaces.nonlinear import interaction_kernels
from meshtrace.surfaces.statistics import components_hs

# wave vectors [rad/m] and kernels made by an independent program
VECTORS = np.array([[1.0, 0.0], [0.0, 1.0], [0.5, 0.0], [0.990403, 0.677571]])
K_MINUS = [
    [0, 1, -0.5, 0.145951],
    [1, 0, 0.675363, 0.455774],
    [-0.5, 0.675363, 0, -0.335898],
    [0.145951, 0.455774, -0.335898, 0],
]
K_PLUS = [
    [2, -0.093836, 1.5, 1.657056],
    [-0.093836, 2, -0.087386, 0.962419],
    [1.5, -0.087386, 1, 1.289888],
    [1.657056, 0.962419, 1.289888, 2.4],
]
DIRECTIONAL_SKEWNESS = 0.13809  # of the paper's band at 5 m/s


def pairs(kx, ky):
    """Return the kernels of all pairs of some waves."""
    return interaction_kernels(kx[:, None], ky[:, None], kx, ky)


def skewness(sea, turned_down_wind=False):
    """Return 3/2 sum S_i S_j (K+ + K-) / sigma^3 of the free waves."""
    waves = sea.free_waves
    power = 0.5 * waves.amplitude**2
    k = np.hypot(waves.kx, waves.ky)
    minus, plus = pairs(k, 0.0 * k) if turned_down_wind else pairs(waves.kx, waves.ky)
    return 1.5 * power @ (plus + minus) @ power / power.sum() ** 1.5


def test_kernels_of_four_vectors():
    minus, plus = pairs(*VECTORS.T)
    np.testing.assert_allclose(minus, K_MINUS, atol=2e-6)
    np.testing.assert_allclose(plus, K_PLUS, atol=2e-6)


def test_equal_waves_have_no_difference_wave():
    angle = np.linspace(0.0, 2.0 * math.pi, 17)
    for k in (0.1, 1.0, 30.0):
        kx, ky = k * np.cos(angle), k * np.sin(angle)
        assert np.abs(interaction_kernels(kx, ky, kx, ky)[0]).max() < 1e-15 * k
        near = interaction_kernels(kx, ky, kx * (1 + 1e-6), ky * (1 + 1e-6))[0]
        np.testing.assert_allclose(near, -1e-6 * k, rtol=1e-2)


def test_kernels_of_one_direction():
    k = np.array([0.2, 0.5, 1.0, 7.0])
    minus, plus = pairs(0.6 * k, -0.8 * k)
    np.testing.assert_allclose(plus, k[:, None] + k, rtol=1e-12)
    np.testing.assert_allclose(minus, -np.abs(k[:, None] - k), atol=1e-12)


def test_kernels_depend_on_the_angle_between_the_waves_only():
    rng = np.random.default_rng(1)
    kx, ky, px, py = rng.normal(size=(4, 50))
    c, s = math.cos(0.7), math.sin(0.7)
    here = interaction_kernels(kx, ky, px, py)
    turned = interaction_kernels(c * kx - s * ky, s * kx + c * ky, c * px - s * py, s * px + c * py)
    swapped = interaction_kernels(px, py, kx, ky)
    np.testing.assert_allclose(turned, here, atol=1e-11)
    np.testing.assert_allclose(swapped, here, atol=1e-11)


def test_one_wave_is_stokes_second_order():
    wave = MeasuredSea(omega=[2.0], theta=[0.3], variance=[[0.005]], order=2, capillary=False)
    a, k = 0.1, 4.0 / 9.81
    x, t = np.linspace(0.0, 20.0, 41), 1.7
    first = wave.model_copy(update={"order": 1}).components
    phi = 2.0 * t - k * x * math.cos(0.3) + first.phase[0]
    stokes = a * np.cos(phi) + 0.5 * k * a**2 * np.cos(2.0 * phi)
    np.testing.assert_allclose(wave.elevation(x, 0.0, t), stokes, atol=1e-14)


def test_elevation_is_the_double_sum(monkeypatch):
    monkeypatch.setattr(nonlinear, "NEGLIGIBLE", 0.0)
    sea = JonswapSea(waves="paper", wind_speed=5.0, seed=4, order=2, wind_direction_deg=25.0)
    waves, x, y, t = sea.free_waves, 3.1, -7.7, 12.0
    phi = waves.omega * t - waves.kx * x - waves.ky * y + waves.phase
    minus, plus = pairs(waves.kx, waves.ky)
    pair = waves.amplitude[:, None] * waves.amplitude
    eta = np.sum(waves.amplitude * np.cos(phi)) + 0.25 * np.sum(
        pair * (minus * np.cos(phi[:, None] - phi) + plus * np.cos(phi[:, None] + phi))
    )
    assert sea.elevation(x, y, t) == pytest.approx(eta, abs=1e-13)
    assert (sea.components.omega >= 0.0).all()


def test_small_bound_waves_are_left_out():
    sea = JonswapSea(waves="paper", wind_speed=5.0, seed=4, order=2)
    free, waves = sea.free_waves, sea.components
    n = len(free.amplitude)
    for whole, part in zip(waves, free, strict=True):
        np.testing.assert_array_equal(whole[:n], part)
    bound = [a[n:] for a in waves]
    assert 2000 < len(bound[0]) < 4000  # of 8102
    used = free.amplitude > 0.0
    minus, plus = pairs(free.kx[used], free.ky[used])
    pair = np.outer(free.amplitude[used], free.amplitude[used])
    off = ~np.eye(used.sum(), dtype=bool)
    sums, differences = 0.5 * pair * plus, 0.5 * pair * minus
    # each pair once, and half the amplitude for a wave with itself
    whole = 0.5 * np.sum(sums[off] ** 2 + differences[off] ** 2) + np.sum(np.diag(0.5 * sums) ** 2)
    assert whole * (1 - 1.001e-4) <= np.sum(bound[0] ** 2) <= whole
    lean = 1.5 * sum_of_products(free, waves, n)
    sigma = components_hs(free) / 4.0
    assert lean / sigma**3 == pytest.approx(DIRECTIONAL_SKEWNESS, rel=2e-3)


def sum_of_products(free, waves, n):
    """Return sum_ij S_i S_j K_ij over the bound waves that were kept."""
    k = {(w, x, y): a for a, w, x, y in zip(*(c[:n] for c in waves[:4]), strict=True) if a}
    keys, total = list(k), 0.0
    vectors = np.array(keys)
    sums = (vectors[:, None] + vectors).reshape(-1, 3)
    differences = (vectors[:, None] - vectors).reshape(-1, 3)
    amplitude = np.array([k[key] for key in keys])
    product = np.outer(amplitude, amplitude).ravel()
    for table in (sums, differences):
        found = {tuple(np.round(row, 9)): p for row, p in zip(table, product, strict=True)}
        for a, *key in zip(*(c[n:] for c in waves[:4]), strict=True):
            p = found.get(tuple(np.round(key, 9)))
            total += p * a if p else 0.0  # 2 S_i S_j K of two waves, S^2 K of one
    return total


def test_skewness_by_formula():
    sea = JonswapSea(waves="paper", wind_speed=5.0)
    assert skewness(sea) == pytest.approx(DIRECTIONAL_SKEWNESS, rel=1e-3)
    assert skewness(sea, turned_down_wind=True) == pytest.approx(0.16031, rel=1e-3)
    windy = skewness(JonswapSea(waves="paper", wind_speed=13.0), turned_down_wind=True)
    assert windy == pytest.approx(0.19863, rel=1e-3)
    k = np.hypot(*sea.free_waves[2:4])
    power = 0.5 * sea.free_waves.amplitude**2
    one_direction = 3.0 * power @ np.minimum(k[:, None], k) @ power / power.sum() ** 1.5
    assert skewness(sea, turned_down_wind=True) == pytest.approx(one_direction, rel=1e-12)


def test_moments_by_monte_carlo():
    moments = []
    for seed in range(24):
        sea = JonswapSea(waves="paper", wind_speed=5.0, seed=seed, order=2)
        linear = sea.model_copy(update={"order": 1})
        x, y = np.random.default_rng(seed).uniform(-500.0, 500.0, (2, 700))
        z = sea.elevation(x, y)
        # the third moment of the linear sea is 0: subtracted, it takes noise away
        cube = np.mean(z**3 - linear.elevation(x, y) ** 3)
        moments.append([z.mean(), np.mean(z**2), cube])
    mean, square, cube = np.mean(moments, axis=0)
    error = np.std(moments, axis=0) / math.sqrt(len(moments))
    sigma2 = 0.5 * np.sum(sea.components.amplitude**2)
    assert abs(mean) < 4.0 * error[0]
    assert square == pytest.approx(sigma2, abs=4.0 * error[1])
    skew, skew_error = cube / sigma2**1.5, error[2] / sigma2**1.5
    assert skew_error < 0.01
    assert skew == pytest.approx(DIRECTIONAL_SKEWNESS, abs=4.0 * skew_error)


def test_steepness_of_the_crests():
    """S1 = 2 pi Hs / (g T1^2) of the paper's band, and the parameters of Forristall (2000)."""
    waves = JonswapSea(waves="paper", wind_speed=5.0).free_waves
    power = 0.5 * waves.amplitude**2
    mean_omega = power @ waves.omega / power.sum()  # 2 pi / T1
    s1 = components_hs(waves) * mean_omega**2 / (2.0 * math.pi * 9.81)
    assert s1 == pytest.approx(0.04289, rel=1e-3)
    assert (0.3536 + 0.2892 * s1, 2.0 - 2.1597 * s1) == pytest.approx((0.366, 1.9074), rel=1e-4)
    assert (0.3536 + 0.2568 * s1, 2.0 - 1.7912 * s1) == pytest.approx((0.3646, 1.9232), rel=1e-4)
    # of one direction in a narrow band the skewness is three times this (Tayfun 1980)
    peak = JonswapSea(wind_speed=5.0).spectrum.omega_p ** 2 / 9.81
    assert 3.0 * peak * math.sqrt(power.sum()) == pytest.approx(0.15818, rel=1e-3)


@pytest.mark.thorough
def test_crests_follow_forristall_roughly(monkeypatch):
    # short crests in deep water, for the steepness of the test above
    monkeypatch.setattr(nonlinear, "NEGLIGIBLE", 1e-2)
    alpha, beta, crests = 0.3646, 1.9232, []
    sea = JonswapSea(waves="paper", wind_speed=5.0, order=2)
    for seed in range(2):
        x, y = np.random.default_rng(seed).uniform(-2e3, 2e3, (2, 80))
        z = np.stack([sea.with_seed(seed).elevation(x, y, t) for t in 0.12 * np.arange(260)])
        for series in z.T:
            up = np.flatnonzero((series[:-1] < 0.0) & (series[1:] >= 0.0))
            crests += [series[i:j].max() for i, j in pairwise(up)]
    crests = np.array(crests) / components_hs(sea.free_waves)
    assert len(crests) > 1000
    for probability in (0.1, 0.05):  # crests of a linear sea are lower by 6 %
        expected = alpha * (-math.log(probability)) ** (1.0 / beta)
        assert np.quantile(crests, 1.0 - probability) == pytest.approx(expected, rel=0.03)


def test_slope_variance_holds_the_bound_waves():
    sea = JonswapSea(waves="paper", wind_speed=5.0, order=2, mss="band")
    linear = sea.model_copy(update={"order": 1})
    squares = []
    for seed in range(20):
        x, y = np.random.default_rng(seed).uniform(-500.0, 500.0, (2, 400))
        one, two = (s.with_seed(seed).slopes(x, y) for s in (linear, sea))
        squares.append(np.mean(np.square(two)) - np.mean(np.square(one)))
    waves, n = sea.components, len(linear.components.amplitude)
    k2 = waves.kx**2 + waves.ky**2
    expected = 0.25 * np.sum((waves.amplitude**2 * k2)[n:])
    error = np.std(squares) / math.sqrt(len(squares))
    assert np.mean(squares) == pytest.approx(expected, abs=4.0 * error)


def test_waves_beyond_a_frequency_make_none():
    sea = JonswapSea(waves="paper", wind_speed=5.0, order=2, order_omega_max=1.3)
    free, waves = sea.free_waves, sea.components
    assert len(waves.omega) > len(free.omega)
    assert waves.omega[len(free.omega) :].max() == pytest.approx(2.4)  # 1.2 rad/s twice
    whole = JonswapSea(waves="paper", wind_speed=5.0, order=2)
    far = whole.model_copy(update={"omega_max": 8.0})
    top = 2.0 * 3.0 * whole.spectrum.omega_p
    assert far.components.omega[len(far.free_waves.omega) :].max() <= top


def test_seeds_share_bound_waves_and_grid_factors():
    sea = JonswapSea(waves="paper", seed=1, order=2)
    sea.mesh(extent=1.0, spacing=0.5)
    other = sea.with_seed(2)
    np.testing.assert_array_equal(other.components.kx, sea.components.kx)
    assert other._grids is sea._grids
    fresh = JonswapSea(waves="paper", seed=2, order=2)
    np.testing.assert_array_equal(
        other.mesh(extent=1.0, spacing=0.5).vertices, fresh.mesh(extent=1.0, spacing=0.5).vertices
    )
    x, y = np.linspace(-3, 3, 5), np.linspace(0, 2, 4)
    points = np.meshgrid(x, y, indexing="ij")
    np.testing.assert_allclose(fresh.grid(x, y, 1.0)[0], fresh.elevation(*points, 1.0), atol=1e-6)


def test_round_trips():
    sea = JonswapSea(waves="paper", seed=1, order=2, order_omega_max=3.0)
    again = sea_from_config(json.loads(json.dumps(sea.to_config())))
    assert again == sea
    assert "order=2" in repr(again)
    assert pickle.loads(pickle.dumps(sea)) == sea
    assert sea != JonswapSea(waves="paper", seed=1)
    # a configuration of before has no order and is linear
    old = {"kind": "jonswap", "waves": "paper", "wind_speed": 5.0, "seed": 1}
    assert sea_from_config(old) == JonswapSea(waves="paper", seed=1)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: JonswapSea(order=2, choppy=True), r"^order: 2, allowed: 1 with choppy = true"),
        (lambda: JonswapSea(order=3), r"^order: 3, allowed: 1 or 2"),
        (lambda: JonswapSea(order=2, depth=5.0), r"^order: 2, allowed: 1 with depth"),
        (lambda: SpectralSea(spectrum=Tma(wind_speed=8.0, depth=6.0), order=2), r"1 with depth"),
        (lambda: JonswapSea(order_omega_max=3.0), r"^order_omega_max: 3.0, allowed: only with"),
        (
            lambda: (
                JonswapSea(
                    order=2,
                    waves=bands.PAPER_BANDS[5.0].replace(d_omega=0.01),
                    omega_max=6.0,
                    order_omega_max=6.0,
                ).components
            ),
            r"^order_omega_max: 6 rad/s makes \d+ bound waves, allowed: at most 4000000",
        ),
    ],
)
def test_refusals(make, text):
    with pytest.raises(Refused, match=text):
        make()


def test_too_many_bound_waves_are_refused(monkeypatch):
    monkeypatch.setattr(JonswapSea, "most_components", 1000)
    with pytest.raises(Refused, match=r"bound waves, allowed: at most 1000 bound waves"):
        _ = JonswapSea(waves="paper", order=2).components


@pytest.mark.parametrize("wind_speed", [5.0, 13.0])
def test_the_natural_band_of_second_order_is_sparse(wind_speed):
    linear = JonswapSea(wind_speed=wind_speed)
    sea = JonswapSea(wind_speed=wind_speed, order=2)
    assert len(sea.free_waves.omega) < 150
    assert len(sea.components.omega) < 30_000
    assert components_hs(sea.free_waves) == pytest.approx(
        components_hs(linear.components), rel=0.005
    )
    # other places of the waves in each cell, the same variance
    assert not set(sea.free_waves.omega) & set(linear.components.omega)
