"""Fading statistics on synthetic gains whose statistics are known.

Fixed seeds; every family of tests has significance 1e-4 after Sidak's correction.
"""

import math

import numpy as np
import pytest
from scipy import optimize, signal, stats

from meshtrace import fading

ALPHA = 1e-4


def _level(n_tests: int) -> float:
    """Return the significance of one of n tests (Sidak)."""
    return -math.expm1(math.log1p(-ALPHA) / n_tests)


def _assert_mean(values, expected, n_tests=1):
    """Assert by a t test that independent estimates have the expected mean."""
    values = np.asarray(values)
    t = (values.mean() - expected) / (values.std(ddof=1) / math.sqrt(values.size))
    p = 2.0 * stats.t.sf(abs(t), values.size - 1)
    assert p > _level(n_tests), f"mean {values.mean():.6g}, expected {expected:.6g}, t = {t:.2f}"


def _assert_coverage(hits, confidence, n_tests=1):
    """Assert by a binomial test that intervals cover as often as they say."""
    p = stats.binomtest(int(np.sum(hits)), len(hits), confidence).pvalue
    assert p > _level(n_tests), f"coverage {np.mean(hits):.3f}, stated {confidence}"


def _ar1(n, phi, rng):
    """Draw a stationary Gaussian AR(1) series of unit variance."""
    drive = math.sqrt(1.0 - phi**2) * rng.standard_normal(n)
    drive[0] = rng.standard_normal()
    return signal.lfilter([1.0], [1.0, -phi], drive)


def _band_limited(n, step, low, high, rng):
    """Draw a Gaussian series of unit variance with a flat spectrum in [low, high] rad/s."""
    period = 8 * n  # so long that the record does not see the process repeat
    omega = 2.0 * np.pi * np.fft.rfftfreq(period, step)
    inside = np.flatnonzero((omega >= low) & (omega <= high))
    amplitude = np.zeros(omega.size, dtype=complex)
    amplitude[inside] = rng.standard_normal(inside.size) + 1j * rng.standard_normal(inside.size)
    return np.fft.irfft(amplitude, period)[:n] * period / (2.0 * math.sqrt(inside.size))


def _band_correlation(lag, low, high):
    return (math.sin(high * lag) - math.sin(low * lag)) / ((high - low) * lag)


# --- Monte Carlo noise ---------------------------------------------------------------------


def test_scintillation_index_is_free_of_the_noise():
    rng = np.random.default_rng(101)
    n, si = 2000, 0.02
    sigma = math.sqrt(math.log1p(si))
    corrected, raw = [], []
    for _ in range(100):
        h = 6e-5 * rng.lognormal(-0.5 * sigma**2, sigma, n)
        stderr = h * rng.uniform(0.02, 0.08, n)
        g = h + stderr * rng.standard_normal(n)
        corrected.append(fading.scintillation_index(g, stderr, block=20, resamples=50).value)
        raw.append(fading.scintillation_index(g, block=20, resamples=50).value)
    _assert_mean(corrected, si)
    # The same test sees the noise where it is left in.
    with pytest.raises(AssertionError, match="expected"):
        _assert_mean(raw, si)


def test_no_fading_gives_an_index_of_zero_on_average():
    rng = np.random.default_rng(102)
    stderr = 0.05
    index = [
        fading.scintillation_index(
            1.0 + stderr * rng.standard_normal(100), stderr, resamples=50
        ).value
        for _ in range(400)
    ]
    assert min(index) < 0.0 < max(index)
    _assert_mean(index, 0.0)


def test_lognormal_fit_is_free_of_the_noise():
    rng = np.random.default_rng(103)
    n, sigma = 1000, 0.3
    noisy, clean = [], []
    for _ in range(100):
        h = rng.lognormal(-9.0, sigma, n)
        stderr = 0.1 * h
        g = h + stderr * rng.standard_normal(n)
        noisy.append(fading.fit_lognormal(g, stderr).parameters["sigma"] ** 2)
        clean.append(fading.fit_lognormal(h).parameters["sigma"] ** 2)
    # The maximum-likelihood variance is low by 1 / n; relative errors of 10 % leave O(0.1^4).
    _assert_mean(clean, sigma**2 * (1.0 - 1.0 / n))
    assert np.mean(noisy) == pytest.approx(np.mean(clean), abs=3.0 * 0.1**4)


def test_coherence_time_of_ar1_with_and_without_noise():
    rng = np.random.default_rng(104)
    n, phi, step = 20_000, 0.9, 0.1
    lag = math.floor(-1.0 / math.log(phi))
    high, low = phi**lag, phi ** (lag + 1)
    expected = step * (lag + (high - math.exp(-1.0)) / (high - low))
    time = step * np.arange(n)
    clean, noisy, blurred = [], [], []
    for _ in range(20):
        g = 1.0 + 0.1 * _ar1(n, phi, rng)
        observed = g + 0.07 * rng.standard_normal(n)
        clean.append(fading.coherence_time(time, g, resamples=50).value)
        noisy.append(fading.coherence_time(time, observed, 0.07, resamples=50).value)
        blurred.append(fading.coherence_time(time, observed, resamples=50).value)
    _assert_mean(clean, expected, 2)
    _assert_mean(noisy, expected, 2)
    assert np.mean(blurred) < 0.7 * expected


def test_effective_samples_of_ar1():
    rng = np.random.default_rng(105)
    n, phi = 20_000, 0.9
    counts = [fading.effective_samples(1.0 + 0.1 * _ar1(n, phi, rng)) for _ in range(20)]
    # The window of five correlation sums cuts off 2 phi^W / (1 - phi) = 1 % of the sum.
    assert np.mean(counts) == pytest.approx(n * (1.0 - phi) / (1.0 + phi), rel=0.05)


# --- crossings -----------------------------------------------------------------------------


def test_crossings_of_a_smooth_gaussian_process_follow_rice():
    rng = np.random.default_rng(106)
    low, high, step, n = 1.0, 4.0, 0.05, 12_000
    second = (high**3 - low**3) / (3.0 * (high - low))  # -R''(0)
    time, levels = step * np.arange(n), (-1.5, -0.7, 0.0, 1.0)
    rates, fades = [], []
    for _ in range(25):
        g = 1.0 + 0.1 * _band_limited(n, step, low, high, rng)
        found = [
            (
                fading.level_crossing_rate(
                    time, g, 1.0 + 0.1 * u, relative_to="absolute", resamples=50
                ).value,
                fading.mean_fade_duration(
                    time, g, 1.0 + 0.1 * u, relative_to="absolute", resamples=50
                ).value,
            )
            for u in levels
        ]
        rates.append([rate for rate, _ in found])
        fades.append([fade for _, fade in found])
    for u, rate, fade in zip(levels, np.transpose(rates), np.transpose(fades), strict=True):
        # Steps of 0.05 s miss a part (omega step)^2 / 24 = 3e-4 of the crossings: far below the
        # standard error of 0.5 %.
        rice = math.sqrt(second) / (2.0 * math.pi) * math.exp(-0.5 * u**2)
        _assert_mean(rate, rice, 8)
        _assert_mean(fade, stats.norm.cdf(u) / rice, 8)


def test_crossings_of_the_median_by_ar1():
    rng = np.random.default_rng(107)
    n, step = 10_000, 0.2
    for phi in (0.5, 0.9):
        rates = [
            fading.level_crossing_rate(
                step * np.arange(n),
                1.0 + 0.1 * _ar1(n, phi, rng),
                1.0,
                relative_to="absolute",
                resamples=50,
            ).value
            for _ in range(25)
        ]
        # P(x_i > 0 > x_i+1) of a bivariate normal (Sheppard 1899).
        _assert_mean(rates, math.acos(phi) / (2.0 * math.pi * step), 2)


# --- laws ----------------------------------------------------------------------------------

SHAPES = [(4.0, 2.0), (1.2, 0.5), (20.0, 3.0), (8.0, 8.0), (60.0, 50.0)]


@pytest.mark.parametrize(("alpha", "beta"), SHAPES)
def test_gamma_gamma_samples_follow_the_law(alpha, beta):
    rng = np.random.default_rng(108)
    g = fading.gamma_gamma.rvs(alpha, beta, scale=3e-5, size=20_000, random_state=rng)
    test = stats.kstest(g, lambda x: fading.gamma_gamma.cdf(x, alpha, beta, scale=3e-5))
    assert test.pvalue > _level(len(SHAPES))
    other = stats.kstest(g, lambda x: fading.gamma_gamma.cdf(x, alpha, beta, scale=2.7e-5))
    assert other.pvalue < 1e-2


@pytest.mark.parametrize(("alpha", "beta"), SHAPES)
def test_gamma_gamma_fit_by_its_likelihood_ratio(alpha, beta):
    g = fading.gamma_gamma.rvs(
        alpha, beta, scale=3e-5, size=20_000, random_state=np.random.default_rng(109)
    )
    fit = fading.fit_gamma_gamma(g)
    truth = np.log(fading.gamma_gamma.pdf(g, alpha, beta, scale=3e-5)).sum()
    ratio = 2.0 * (fit.log_likelihood - truth)
    # Wilks: chi-square with three degrees of freedom, never below zero.
    assert -2e-3 < ratio < stats.chi2.isf(_level(len(SHAPES)), 3)


def test_gamma_gamma_fit_is_free_of_the_noise():
    rng = np.random.default_rng(110)
    g = fading.gamma_gamma.rvs(6.0, 3.0, size=20_000, random_state=rng)
    observed = g * (1.0 + 0.1 * rng.standard_normal(g.size))
    clean, noisy, blurred = (
        fading.fit_gamma_gamma(*data).scintillation_index
        for data in ((g,), (observed, 0.1 * g), (observed,))
    )
    assert noisy == pytest.approx(clean, rel=0.01)
    assert blurred > 1.015 * clean


def test_the_better_law_has_the_lower_aic():
    rng = np.random.default_rng(111)
    sigma = 0.5
    for g, best in (
        (rng.lognormal(-0.5 * sigma**2, sigma, 4000), 0),
        (fading.gamma_gamma.rvs(4.0, 4.0, size=4000, random_state=rng), 1),
    ):
        fits = (fading.fit_lognormal(g), fading.fit_gamma_gamma(g))
        assert fits[best].aic + 10.0 < fits[1 - best].aic


@pytest.mark.thorough
def test_goodness_of_fit_is_calibrated_where_the_law_holds():
    rng = np.random.default_rng(112)
    p = np.array(
        [
            fading.goodness_of_fit(
                "lognormal", rng.lognormal(-9.0, 0.4, 80), resamples=19, seed=i
            ).p_value
            for i in range(400)
        ]
    )
    # Twenty equally likely values.
    counts = np.bincount(np.round(20.0 * p).astype(int) - 1, minlength=20)
    assert stats.chisquare(counts).pvalue > ALPHA
    # The table for a law known beforehand would call nearly every fit a good one.
    g = rng.lognormal(-9.0, 0.4, (400, 80))
    naive = [stats.kstest(x, fading.fit_lognormal(x).law.cdf).pvalue for x in g]
    assert stats.kstest(naive, "uniform").pvalue < ALPHA


@pytest.mark.slow
def test_goodness_of_fit_of_gamma_gamma_accepts_and_rejects():
    rng = np.random.default_rng(113)
    p = [
        fading.goodness_of_fit(
            "gamma-gamma",
            fading.gamma_gamma.rvs(4.0, 2.0, size=200, random_state=rng),
            resamples=19,
            seed=i,
        ).p_value
        for i in range(20)
    ]
    _assert_coverage(np.array(p) > 0.05, 0.95)
    two_humps = np.r_[rng.lognormal(0.0, 0.1, 300), rng.lognormal(1.0, 0.1, 300)]
    for model in ("lognormal", "gamma-gamma"):
        assert fading.goodness_of_fit(model, two_humps, resamples=39).p_value == 1.0 / 40.0


# --- intervals -----------------------------------------------------------------------------


@pytest.mark.thorough
def test_scintillation_interval_of_an_ensemble_covers():
    rng = np.random.default_rng(114)
    si = 0.02
    sigma = math.sqrt(math.log1p(si))
    hits = []
    for seed in range(250):
        h = rng.lognormal(0.0, sigma, 250)
        stderr = 0.05 * h
        g = h + stderr * rng.standard_normal(h.size)
        found = fading.scintillation_index(g, stderr, resamples=499, seed=seed)
        hits.append(found.low <= si <= found.high)
    _assert_coverage(hits, 0.95)


def test_outage_interval_covers():
    rng = np.random.default_rng(115)
    expected = stats.lognorm(0.3).cdf(0.6)
    hits = []
    for _ in range(500):
        found = fading.outage(rng.lognormal(0.0, 0.3, 300), 0.6, relative_to="absolute")
        hits.append(found.low <= expected <= found.high)
    _assert_coverage(hits, 0.95)


@pytest.mark.parametrize("band", [(1.0, 4.0), (2.0, 3.0)])
def test_intervals_of_a_series_cover(band):
    rng = np.random.default_rng(116)
    step, n, deviation, u = 0.1, 3000, 0.1, -1.0
    time, level = step * np.arange(n), 1.0 + 0.1 * u
    rho = _band_correlation(step, *band)
    both = stats.multivariate_normal(cov=[[1.0, rho], [rho, 1.0]]).cdf([u, u])
    rate = (stats.norm.cdf(u) - both) / step
    coherence = optimize.brentq(
        lambda lag: _band_correlation(lag, *band) - math.exp(-1.0), 0.1, 1.2
    )
    expected = (deviation**2, coherence, rate, stats.norm.cdf(u) / rate, stats.norm.cdf(u))
    hits = []
    for seed in range(100):
        g = 1.0 + deviation * _band_limited(n, step, *band, rng)
        block = fading.block_length(g)
        options = {"block": block, "resamples": 299, "seed": seed}
        absolute = {"relative_to": "absolute", **options}
        below = (g < level).astype(float)
        found = (
            fading.scintillation_index(g, **options),
            fading.coherence_time(time, g, **options),
            fading.level_crossing_rate(time, g, level, **absolute),
            fading.mean_fade_duration(time, g, level, **absolute),
            fading.outage(
                g, level, relative_to="absolute", n_effective=fading.effective_samples(below)
            ),
        )
        hits.append([e.low <= x <= e.high for e, x in zip(found, expected, strict=True)])
    for column in np.transpose(hits):
        _assert_coverage(column, 0.95, 10)


@pytest.mark.thorough
def test_an_interval_for_independent_gains_does_not_cover_for_a_series():
    rng = np.random.default_rng(117)
    hits = []
    for seed in range(60):
        g = 1.0 + 0.1 * _ar1(1000, 0.95, rng)
        found = fading.scintillation_index(g, resamples=299, seed=seed)
        hits.append(found.low <= 0.01 <= found.high)
    with pytest.raises(AssertionError, match="coverage"):
        _assert_coverage(hits, 0.95)


def test_mean_error_of_a_series_covers():
    rng = np.random.default_rng(118)
    time = 0.1 * np.arange(2000)
    z = []
    for _ in range(60):
        g = 1.0 + 0.1 * _ar1(2000, 0.9, rng) + 0.05 * rng.standard_normal(2000)
        s = fading.fading_statistics(
            g, 0.05, time=time, thresholds=(), resamples=50, test_resamples=0
        )
        z.append((s.mean - 1.0) / s.mean_stderr)
    # Sum of squares of 60 standard normals; the estimated error may be off by 10 %.
    low, high = stats.chi2.ppf([0.5 * ALPHA, 1.0 - 0.5 * ALPHA], 60)
    assert 0.8 * low < np.sum(np.square(z)) < 1.25 * high
