"""Fading statistics: closed forms, brute-force twins, reference values and input errors."""

import itertools
import math

import numpy as np
import pytest
from scipy import integrate, stats

from meshtrace import fading, fields
from meshtrace.fading import distribution as distribution_module
from meshtrace.fading import laws
from meshtrace.fading import series as series_module


@pytest.fixture(scope="module")
def gains():
    return 5.97e-5 * np.random.default_rng(11).lognormal(-0.005, 0.1, 300)


@pytest.fixture(scope="module")
def series():
    time = 0.1 * np.arange(600)
    phase = np.random.default_rng(12).uniform(0.0, 2.0 * np.pi, 40)
    omega = np.random.default_rng(13).uniform(1.0, 4.0, 40)
    wave = math.sqrt(2.0 / 40.0) * np.cos(omega[:, None] * time + phase[:, None]).sum(axis=0)
    return time, 5.97e-5 * (1.0 + 0.08 * wave)


# --- noise and moments ---------------------------------------------------------------------


def test_scintillation_index_is_the_stated_formula(gains):
    stderr = np.linspace(1e-6, 3e-6, gains.size)
    expected = (gains.var(ddof=1) - np.mean(stderr**2)) / gains.mean() ** 2
    for block in (1, 10):
        estimate = fading.scintillation_index(gains, stderr, block=block, resamples=99)
        assert float(estimate) == pytest.approx(expected, rel=1e-12)
        assert estimate.low < estimate.value < estimate.high


def test_removing_noise_takes_its_variance_from_the_logarithm(gains):
    stderr = 0.05 * gains
    freed = fading.remove_noise(gains, stderr)
    assert np.log(freed).var(ddof=1) == pytest.approx(
        np.log(gains).var(ddof=1) - 0.05**2, rel=1e-10
    )
    assert freed.mean() == pytest.approx(gains.mean(), rel=1e-12)
    np.testing.assert_array_equal(np.argsort(freed), np.argsort(gains))


def test_noise_that_explains_the_spread_leaves_none(gains):
    freed = fading.remove_noise(gains, 0.5 * gains)
    assert np.ptp(freed) == 0.0
    with pytest.raises(ValueError, match="no variance above the Monte Carlo noise"):
        fading.fit_lognormal(gains, 0.5 * gains)


def test_zero_gains_stay_zero():
    freed = fading.remove_noise([0.0, 1.0, 2.0, 3.0], 0.1)
    assert freed[0] == 0.0
    assert freed.mean() == pytest.approx(1.5, rel=1e-12)


# --- correlation ---------------------------------------------------------------------------


def test_autocorrelation_against_the_double_loop(series):
    g = series[1][:60] / 5.97e-5
    stderr = 0.02
    x = g - g.mean()
    rho = fading.autocorrelation(g, stderr, max_lag=20)
    for lag in range(1, 21):
        pairs = [x[i] * x[i + lag] for i in range(60 - lag)]
        assert rho[lag] == pytest.approx(np.mean(pairs) / (g.var() - stderr**2), rel=1e-9)
    assert rho[0] == 1.0


def test_effective_samples_of_repeated_gains():
    # Every gain held for 10 samples: triangular correlation, 1 + 2 sum(rho) = 10.
    g = np.repeat(np.random.default_rng(14).uniform(1.0, 2.0, 4000), 10)
    assert fading.effective_samples(g) == pytest.approx(4000.0, rel=0.15)
    # Politis-White: sum |k| rho = 33, sum rho = 10, three times (1.5 3.3^2 n)^(1/3).
    assert fading.block_length(g) == pytest.approx(260.0, rel=0.15)


def test_block_means_against_slices():
    x = np.random.default_rng(15).uniform(size=50)
    means = distribution_module.block_means((x, x**2), 7, 5, seed=3)
    starts = np.random.default_rng(3).integers(0, 44, (5, 7))
    for k in range(5):
        drawn = np.concatenate([x[i : i + 7] for i in starts[k]])
        assert means[0, k] == pytest.approx(drawn.mean(), rel=1e-12)
        assert means[1, k] == pytest.approx(np.mean(drawn**2), rel=1e-12)


def test_coherence_time_of_a_cosine():
    time = 0.05 * np.arange(4000)
    g = 1.0 + 0.3 * np.cos(2.0 * np.pi * time / 5.0)
    expected = 5.0 * math.acos(math.exp(-1.0)) / (2.0 * np.pi)
    # The ends of 40 periods leave 1 / (80 pi) in the correlation.
    assert fading.coherence_time(time, g).value == pytest.approx(expected, rel=4e-3)


def test_first_crossing_is_interpolated_or_infinite():
    e = math.exp(-1.0)
    rho = np.array([[1.0, 1.0, 1.0], [0.9, e + 0.1, 0.0], [0.8, e - 0.3, -1.0]])
    np.testing.assert_allclose(
        series_module._first_crossing(rho), [math.inf, 1.25, 1.0 - e], rtol=1e-12
    )


def test_coherence_time_beyond_half_the_record_has_it_as_its_limit():
    # All lags up to the half are positive, and the noise leaves 15 % of the variance.
    g = 500.0 + np.array([41.0, 54.0, -20.0, 1.0, -76.0])
    estimate = fading.coherence_time(0.5 * np.arange(5.0), g, math.sqrt(0.9) * g.std())
    assert estimate == (math.inf, 1.0, math.inf)


# --- crossings and fades -------------------------------------------------------------------


def test_fades_against_a_walk_through_the_record(series):
    time, g = series
    threshold = 0.95
    level, falls, below = threshold * g.mean(), 0, 0.0
    for before, after in itertools.pairwise(g):
        falls += before >= level > after
        below += 0.05 * (int(before < level) + int(after < level))
    rate = fading.level_crossing_rate(time, g, threshold)
    fade = fading.mean_fade_duration(time, g, threshold)
    assert falls > 5
    assert rate.value == pytest.approx(falls / (time[-1] - time[0]), rel=1e-9)
    assert fade.value == pytest.approx(below / falls, rel=1e-9)


@pytest.mark.parametrize(("relative_to", "scale"), [("mean", 1.0), ("median", None)])
def test_thresholds_are_relative_to_their_reference(series, relative_to, scale):
    time, g = series
    reference = g.mean() if scale else np.median(g)
    for function in (fading.level_crossing_rate, fading.mean_fade_duration):
        relative = function(time, g, 0.97, relative_to=relative_to, resamples=50)
        absolute = function(time, g, 0.97 * reference, relative_to="absolute", resamples=50)
        assert relative == absolute
    relative = fading.outage(g, 0.97, relative_to=relative_to)
    assert relative == fading.outage(g, 0.97 * reference, relative_to="absolute")


def test_no_fade_has_a_poisson_limit_and_no_duration():
    time, g = np.arange(101.0), np.linspace(1.0, 1.1, 101)
    rate = fading.level_crossing_rate(time, g, 0.5)
    assert (rate.value, rate.low) == (0.0, 0.0)
    assert rate.high == pytest.approx(-math.log(0.025) / 100.0, rel=1e-9)
    assert math.isnan(fading.mean_fade_duration(time, g, 0.5).value)


def test_few_fades_have_garwood_and_exponential_limits():
    g = np.ones(101)
    g[[10, 40, 70]] = 0.1
    time = np.arange(101.0)
    rate = fading.level_crossing_rate(time, g, 0.5)
    # Garwood 1936: three events, 95 %: 0.6187 to 8.7673.
    assert (100.0 * rate.low, 100.0 * rate.high) == pytest.approx((0.61867, 8.76727), rel=1e-4)
    fade = fading.mean_fade_duration(time, g, 0.5)
    assert fade.value == pytest.approx(1.0)
    limits = 6.0 / stats.chi2.ppf([0.975, 0.025], 6)
    assert (fade.low, fade.high) == pytest.approx(tuple(limits), rel=1e-9)


@pytest.mark.parametrize(("count", "n"), [(0, 30), (1, 30), (7, 30), (30, 30)])
def test_outage_interval_is_that_of_scipy(count, n):
    g = np.r_[np.full(count, 0.1), np.full(n - count, 1.0)]
    low, high = stats.binomtest(count, n).proportion_ci(method="wilson")
    estimate = fading.outage(g, 0.5, relative_to="absolute")
    assert estimate == pytest.approx((count / n, low, high), abs=1e-12)


def test_histogram_integrates_to_one_and_cdf_steps(gains):
    histogram = fading.gain_pdf(gains, bins=20)
    assert np.sum(histogram.density * np.diff(histogram.edges)) == pytest.approx(1.0, rel=1e-12)
    distribution = fading.gain_cdf(gains)
    np.testing.assert_array_equal(distribution.gain, np.sort(gains))
    assert np.mean(gains <= distribution.gain[99]) == distribution.probability[99]
    half = math.sqrt(math.log(40.0) / 600.0)
    assert distribution.high[150] - distribution.probability[150] == pytest.approx(half, rel=1e-9)


# --- laws ----------------------------------------------------------------------------------


def _mixture(function, log_x):
    """Integrate over one gamma factor, whose logarithm runs along log_x."""
    return np.trapezoid(function(np.exp(log_x)), log_x)


@pytest.mark.parametrize(
    ("alpha", "beta"),
    [(4.0, 2.0), (1.2, 0.5), (2.0, 2.0), (300.0, 299.0), (2000.0, 1.5), (1e4, 20.0), (1e5, 1e5)],
)
def test_gamma_gamma_against_the_mixture_integral(alpha, beta):
    one, two = stats.gamma(alpha, scale=1.0 / alpha), stats.gamma(beta, scale=1.0 / beta)
    spread = math.sqrt(1.0 / alpha + 1.0 / beta + 1.0 / (alpha * beta))
    log_x = np.linspace(-40.0, 15.0, 4000) / math.sqrt(alpha)
    for h in (max(0.02, 1.0 - 3.0 * spread), 1.0, 1.0 + 3.0 * spread):
        density = _mixture(lambda x, h=h: np.exp(one.logpdf(x) + two.logpdf(h / x)), log_x)
        share = _mixture(lambda x, h=h: x * one.pdf(x) * two.cdf(h / x), log_x)
        assert fading.gamma_gamma.pdf(h, alpha, beta) == pytest.approx(density, rel=1e-8)
        assert fading.gamma_gamma.cdf(h, alpha, beta) == pytest.approx(share, abs=1e-8)


def test_gamma_gamma_of_half_integer_order_is_elementary():
    # K_1/2(x) = sqrt(pi / 2 x) exp(-x), with alpha = 2, beta = 1.5.
    h = np.array([1e-6, 0.01, 0.5, 1.0, 4.0, 30.0])
    x = 2.0 * np.sqrt(3.0 * h)
    expected = 2.0 * 3.0**1.75 / math.gamma(1.5) * h**0.75 * np.sqrt(0.5 * np.pi / x) * np.exp(-x)
    np.testing.assert_allclose(fading.gamma_gamma.pdf(h, 2.0, 1.5), expected, rtol=1e-12)


def test_gamma_gamma_scales_with_the_mean_and_is_symmetric():
    h = np.array([0.0, -1.0, 0.3, 2.0])
    density = fading.gamma_gamma.pdf(h, 4.0, 2.0)
    assert (density[:2] == 0.0).all()
    np.testing.assert_allclose(density, fading.gamma_gamma.pdf(h, 2.0, 4.0), rtol=1e-12)
    np.testing.assert_allclose(
        fading.gamma_gamma.pdf(6e-5 * h, 4.0, 2.0, scale=6e-5), density / 6e-5, rtol=1e-12
    )
    cdf = fading.gamma_gamma.cdf([0.0, -1.0, 1e9], 4.0, 2.0)
    np.testing.assert_allclose(cdf, [0.0, 0.0, 1.0], atol=1e-9)


@pytest.mark.parametrize("order", [20.0, 60.0, 150.0])
def test_bessel_expansion_where_the_scaled_function_overflows(order):
    # ln K obeys the recurrence K_(v+1) = K_(v-1) + (2 v / x) K_v across the change of method.
    x = np.geomspace(1e-14, 1.0, 40) if order < 50.0 else np.geomspace(1e-3, 30.0, 40)
    below, here, above = (laws._log_kv(order + i, x) for i in (-1.0, 0.0, 1.0))
    expected = np.logaddexp(below, np.log(2.0 * order / x) + here)
    np.testing.assert_allclose(above, expected, atol=3e-6)
    assert np.isfinite(above).all()


def test_scintillation_of_the_laws_is_that_of_their_density():
    fit = fading.DistributionFit("gamma-gamma", {"alpha": 4.0, "beta": 2.5, "mean": 2.0}, 1, 3, 0.0)
    for power, expected in ((0, 1.0), (1, 2.0), (2, 4.0 * (1.0 + fit.scintillation_index))):
        moment, _ = integrate.quad(
            lambda u, p=power: fit.law.pdf(np.exp(u)) * np.exp((p + 1) * u), -30.0, 7.0, limit=200
        )
        assert moment == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize(
    ("si", "margin_db"), [(0.006, 0.79), (0.012, 1.13), (0.1, 3.33), (0.4, 6.59), (0.7, 8.51)]
)
def test_one_percent_outage_margin_of_the_lognormal_table(si, margin_db):
    # Lognormal margins for 1 % outage in the link design table, printed to 0.01 dB.
    sigma = math.sqrt(math.log1p(si))
    parameters = {"mu": -0.5 * sigma**2, "sigma": sigma}
    fit = fading.DistributionFit("lognormal", parameters, 1, 2, 0.0)
    assert fit.scintillation_index == pytest.approx(si, rel=1e-12)
    shallow, deep = fit.law.cdf(10.0 ** (-0.1 * np.array([margin_db - 0.006, margin_db + 0.006])))
    assert deep < 0.01 < shallow


def test_lognormal_fit_is_that_of_scipy(gains):
    fit = fading.fit_lognormal(gains)
    sigma, _, scale = stats.lognorm.fit(gains, floc=0.0)
    assert fit.parameters["sigma"] == pytest.approx(sigma, rel=1e-6)
    assert math.exp(fit.parameters["mu"]) == pytest.approx(scale, rel=1e-6)
    log_likelihood = stats.lognorm(sigma, scale=scale).logpdf(gains).sum()
    assert fit.log_likelihood == pytest.approx(log_likelihood, abs=1e-6)
    assert fit.aic == pytest.approx(4.0 - 2.0 * log_likelihood, abs=1e-5)


@pytest.mark.parametrize(("alpha", "beta"), [(4.0, 2.0), (8.0, 8.0), (30.0, 3.0), (1.1, 0.6)])
def test_gamma_gamma_fit_against_a_simplex_search(alpha, beta):
    from scipy import optimize

    g = fading.gamma_gamma.rvs(
        alpha, beta, scale=2e-5, size=900, random_state=np.random.default_rng(16)
    )
    fit = fading.fit_gamma_gamma(g)

    def cost(v):
        return -np.sum(fading.gamma_gamma.logpdf(g, *np.exp(v[:2]), scale=np.exp(v[2])))

    start = np.log([1.3 * alpha, 0.9 * beta, 2e-5])
    found = optimize.minimize(cost, start, method="Nelder-Mead", options={"maxiter": 400})
    assert fit.log_likelihood >= -found.fun - 1e-2
    assert -cost(np.log(list(fit.parameters.values()))) == pytest.approx(
        fit.log_likelihood, abs=1e-3
    )
    assert fit.parameters["alpha"] >= fit.parameters["beta"]


def test_gamma_gamma_fit_says_when_the_shapes_are_not_identifiable():
    g = fading.gamma_gamma.rvs(600.0, 200.0, size=1000, random_state=np.random.default_rng(17))
    fit = fading.fit_gamma_gamma(g)
    assert "cannot be separated" in fit.note
    assert fit.n_free == 2
    assert fit.parameters["alpha"] == pytest.approx(fit.parameters["beta"], rel=1e-9)
    assert fit.scintillation_index == pytest.approx(float(fading.scintillation_index(g)), rel=0.02)


def test_gamma_gamma_fit_of_gamma_gains_stops_at_its_limit():
    g = np.random.default_rng(18).gamma(2.0, 0.5, 4000)
    # Gains raised to a power above one are more skewed in the logarithm than any of the family.
    fit = fading.fit_gamma_gamma(1.0 / (1.0 / g + 0.05))
    assert "gamma law" in fit.note
    assert fit.parameters["alpha"] > 900.0 * fit.parameters["beta"]


def test_fitted_laws_draw_from_themselves(gains):
    rng = np.random.default_rng(19)
    for fit in (fading.fit_lognormal(gains), fading.fit_gamma_gamma(gains)):
        drawn = fit.law.rvs(size=4000, random_state=rng)
        assert stats.kstest(drawn, fit.law.cdf).pvalue > 1e-4


def test_goodness_of_fit_against_scipy(gains):
    ours = fading.goodness_of_fit("lognormal", gains, resamples=999, seed=1)
    theirs = stats.goodness_of_fit(
        stats.norm, np.log(gains), statistic="ks", n_mc_samples=999, random_state=2
    )
    assert ours.ks == pytest.approx(theirs.statistic, rel=1e-2)  # there sigma divides by n - 1
    spread = math.sqrt(2.0 * theirs.pvalue * (1.0 - theirs.pvalue) / 999.0)
    assert abs(ours.p_value - theirs.pvalue) < 4.0 * spread


# --- the whole -----------------------------------------------------------------------------


def test_statistics_of_an_ensemble(gains):
    s = fading.fading_statistics(gains, 1e-6, test_resamples=19, resamples=99)
    assert (s.n, s.n_effective, s.block) == (300, 300.0, 1)
    assert s.mean == gains.mean()
    assert s.mean_stderr == pytest.approx(gains.std(ddof=1) / math.sqrt(300.0), rel=1e-12)
    assert s.noise_share == pytest.approx(1e-12 / gains.var(ddof=1), rel=1e-12)
    assert [fit.model for fit in s.fits] == ["lognormal", "gamma-gamma"]
    assert [test.n for test in s.goodness] == [300, 300]
    assert s.lag is None
    text = s.summary()
    assert "300 independent gains" in text
    assert "scintillation index" in text
    assert "fitted with alpha = beta" in text
    assert "coherence" not in text


def test_common_noise_widens_the_mean_and_nothing_else(gains):
    plain = fading.fading_statistics(gains, test_resamples=0, resamples=99)
    common = fading.fading_statistics(gains, common_stderr=2e-6, test_resamples=0, resamples=99)
    assert common.scintillation_index == plain.scintillation_index
    assert common.mean_stderr == pytest.approx(math.hypot(plain.mean_stderr, 2e-6), rel=1e-12)
    assert common.noise_share == 0.0


def test_common_noise_stated_as_independent_is_noticed(gains):
    s = fading.fading_statistics(gains, 0.3 * gains, test_resamples=0, resamples=99)
    assert s.scintillation_index.high < 0.0
    assert any("common_stderr" in note for note in s.notes)
    assert s.fits == ()


def test_statistics_of_a_series(series):
    time, g = series
    s = fading.fading_statistics(g, time=time, test_resamples=19, resamples=99)
    assert 1.0 < s.n_effective < 600.0
    assert s.lag[1] == pytest.approx(0.1)
    assert s.autocorrelation[0] == 1.0
    assert s.coherence_time == fading.coherence_time(time, g, resamples=99)
    assert s.level_crossing_rate[3] == fading.level_crossing_rate(time, g, 1.0, resamples=99)
    assert s.mean_fade_duration[3] == fading.mean_fade_duration(time, g, 1.0, resamples=99)
    assert all(test.n < 600 for test in s.goodness)
    assert "coherence time" in s.summary()


def test_notes_on_a_poor_series():
    time = np.arange(40.0)
    g = 1.0 + 0.01 * np.sin(time / 15.0)
    notes = " ".join(fading.fading_statistics(g, 0.002, time=time, resamples=50).notes)
    assert "effective sample size" in notes
    assert "step-to-step" in notes
    white = np.random.default_rng(20).uniform(1.0, 2.0, 400)
    s = fading.fading_statistics(white, time=0.1 * np.arange(400), resamples=50, test_resamples=0)
    assert any("below one time step" in note for note in s.notes)


def test_blocked_and_constant_gains_are_reported():
    blocked = fading.fading_statistics([0.0, 1.0, 1.2, 0.8, 0.9, 0.0, 1.1, 1.0], resamples=50)
    assert blocked.fits == ()
    assert any("some gains are 0" in note for note in blocked.notes)
    assert blocked.outage[0].value == 0.25
    constant = fading.fading_statistics(np.full(9, 2e-5), time=np.arange(9.0))
    assert constant.scintillation_index == (0.0, 0.0, 0.0)
    assert math.isnan(constant.coherence_time.value)
    assert any("no fading" in note for note in constant.notes)


@pytest.mark.parametrize("thresholds", [(0.5, 0.9, 1.0), ()])
def test_dataset_has_registered_attributes_and_survives_a_file(series, thresholds, tmp_path):
    import xarray as xr

    time, g = series
    s = fading.fading_statistics(
        g, time=time, thresholds=thresholds, resamples=50, test_resamples=19
    )
    data = s.to_dataset()
    for name, variable in data.variables.items():
        base = name.removesuffix("_low").removesuffix("_high")
        assert variable.attrs["units"] == fields.attrs(base)["units"]
    assert data.sizes["threshold"] == len(thresholds)
    assert data["coherence_time"].item() == s.coherence_time.value
    assert (
        data["fit_value"].sel(model="lognormal", fit_parameter="sigma").item()
        == (s.fits[0].parameters["sigma"])
    )
    path = tmp_path / "fading.nc"
    if thresholds:
        data.to_netcdf(path, engine="scipy")
        with xr.open_dataset(path, engine="scipy", decode_timedelta=False) as read:
            xr.testing.assert_equal(read.load(), data)


def test_results_are_the_same_for_the_same_seed(series):
    time, g = series
    first, again, other = (
        fading.coherence_time(time, g, resamples=99, seed=seed) for seed in (1, 1, 2)
    )
    assert first == again
    assert first != other


# --- errors --------------------------------------------------------------------------------

GOOD = [1.0, 2.0, 1.5, 1.2]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: fading.fading_statistics([1.0]),
            r"gain: shape \(1,\), allowed: \(n,\) with n >= 2",
        ),
        (lambda: fading.fading_statistics([[1.0, 2.0]]), r"gain: shape \(1, 2\)"),
        (lambda: fading.fading_statistics([1.0, math.nan]), "gain.1.: nan"),
        (lambda: fading.fading_statistics([1.0, math.inf]), "gain.1.: inf"),
        (lambda: fading.fading_statistics([-1e-6, 1.0]), "gain.0.: -1e-06, allowed: finite"),
        (lambda: fading.fading_statistics([0.0, 0.0]), "gain: all 0"),
        (lambda: fading.fading_statistics(GOOD, [0.1, 0.1]), r"gain_stderr: shape \(2,\)"),
        (lambda: fading.fading_statistics(GOOD, -0.1), "gain_stderr.0.: -0.1"),
        (
            lambda: fading.fading_statistics(GOOD, common_stderr=-1.0),
            "common_stderr: -1.0, allowed",
        ),
        (lambda: fading.fading_statistics(GOOD, confidence=95.0), "confidence: 95.0, allowed: 0 <"),
        (lambda: fading.fading_statistics(GOOD, resamples=49), "resamples: 49, allowed"),
        (lambda: fading.fading_statistics(GOOD, test_resamples=-1), "test_resamples: -1"),
        (lambda: fading.fading_statistics(GOOD, time=[0.0, 1.0]), r"time: shape \(2,\), allowed"),
        (lambda: fading.fading_statistics(GOOD, time=[0.0, 1.0, 2.0, 4.0]), "time: not equally"),
        (lambda: fading.fading_statistics(GOOD, time=[3.0, 2.0, 1.0, 0.0]), "time: not equally"),
        (lambda: fading.fading_statistics(GOOD, time=[0.0, 1.0, 2.0, math.nan]), r"time\[3\]: nan"),
        (lambda: fading.fading_statistics(GOOD, thresholds=[0.0]), "threshold: 0.0, allowed"),
        (lambda: fading.outage(GOOD, 0.5, relative_to="max"), "relative_to: 'max', allowed"),
        (lambda: fading.outage(GOOD, 0.5, n_effective=5.0), "n_effective: 5.0, allowed"),
        (lambda: fading.gain_cdf(GOOD, n_effective=0.0), "n_effective: 0.0, allowed"),
        (
            lambda: fading.scintillation_index(GOOD, block=3),
            "block: 3, allowed: an integer 1 <= block",
        ),
        (lambda: fading.coherence_time(np.arange(4.0), GOOD, block=0), "block: 0, allowed"),
        (lambda: fading.autocorrelation(GOOD, max_lag=4), "max_lag: 4, allowed"),
        (lambda: fading.autocorrelation(GOOD, 1.0), "gain: variance .* Monte Carlo noise"),
        (lambda: fading.fit_lognormal([0.0, 1.0, 2.0]), "gain: 1 of 3 are 0, allowed: gains > 0"),
        (lambda: fading.fit_gamma_gamma([1.0, 1.0]), "gain: no variance"),
        (lambda: fading.goodness_of_fit("gamma", GOOD), "model: .gamma., did you mean gamma-gamma"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()
