"""Models of series of gains on processes of known law, fitted to one part and compared with another.

Fixed seeds; significance 1e-4 of each family.
"""

import math

import numpy as np
import pytest
from mc_statistics import ALPHA, chi2_test, sidak
from scipy import signal, stats

import meshtrace as mt
from meshtrace import apps, fading
from meshtrace.apps import channels
from meshtrace.comms import OokLink
from meshtrace.comms.budget import ber_of_gains
from meshtrace.comms.capacity import hard_information
from meshtrace.errors import Refused
from meshtrace.results import load
from meshtrace.surfaces import resolved_sea

P = np.array([[0.9, 0.08, 0.02], [0.05, 0.9, 0.05], [0.01, 0.04, 0.95]])
LEVELS = np.array([0.2, 1.0, 2.0])
STEP, LOW, HIGH, SIGMA = 0.02, 4.0, 16.0, 0.5


def chain(n, rng, transition=P):
    """Return states of a Markov chain, by its definition."""
    steps, state, found = np.cumsum(transition, axis=1), 0, np.empty(n, dtype=int)
    for t, u in enumerate(rng.random(n)):
        state = int(np.searchsorted(steps[state], u))
        found[t] = state
    return found


def gaussian(n, rng):
    """Return a smooth Gaussian series with a flat spectrum from LOW to HIGH rad/s."""
    period = 4 * n
    omega = 2.0 * np.pi * np.fft.rfftfreq(period, STEP)
    inside = np.flatnonzero((omega >= LOW) & (omega <= HIGH))
    amplitude = np.zeros(omega.size, dtype=complex)
    amplitude[inside] = rng.standard_normal(inside.size) + 1j * rng.standard_normal(inside.size)
    return np.fft.irfft(amplitude, period)[:n] * period / (2.0 * math.sqrt(inside.size))


def lognormal(n, seed):
    return np.exp(SIGMA * gaussian(n, np.random.default_rng(seed)))


def rice(score):
    """Return the rate at which the Gaussian series falls through a score."""
    second = (HIGH**3 - LOW**3) / (3.0 * (HIGH - LOW))
    return math.sqrt(second) / (2.0 * math.pi) * math.exp(-0.5 * score**2)


def times(g):
    return STEP * np.arange(len(g))


def histogram(g, threshold, edges):
    """Return how many fades last as many steps as bins say."""
    steps = fading.fade_durations(times(g), g, threshold, relative_to="absolute") / STEP
    return np.histogram(np.round(steps), edges)[0]


@pytest.fixture(scope="module")
def seen():
    return lognormal(30_000, 1)


@pytest.fixture(scope="module")
def generator(seen):
    return apps.TransformedGaussian.fit(seen, STEP, "lognormal")


# --- durations of fades --------------------------------------------------------------------


def test_fades_of_a_sine_last_half_a_period():
    t = 0.01 * np.arange(2000)
    found = fading.fade_durations(t, 1.0 + 0.1 * np.sin(2.0 * np.pi * t / 4.0 + 0.1), 1.0)
    assert found == pytest.approx(np.full(5, 2.0))


def test_fades_cut_by_an_end_are_left_out():
    g = [0.1, 1.0, 0.1, 0.1, 1.0, 0.1]
    assert fading.fade_durations(times(g), g, 0.5) == pytest.approx([2.0 * STEP])
    assert fading.fade_durations(times(g), np.ones(6), 0.5).size == 0


# --- Markov chains -------------------------------------------------------------------------


@pytest.mark.thorough
@pytest.mark.statistical
def test_transitions_and_probabilities_lie_within_their_errors():
    rng = np.random.default_rng(2)
    steady = np.linalg.matrix_power(P, 1000)[0]
    deviations = []
    for _ in range(60):
        model = apps.MarkovChannel.fit(
            LEVELS[chain(6000, rng)], STEP, (0.5, 1.5), relative_to="absolute"
        )
        z = (model.transition - P) / model.transition_stderr
        deviations.append([*z.ravel(), *(model.steady_state - steady) / model.steady_state_stderr])
    deviations = np.array(deviations)
    # the spread of a standard error of 199 replicates is 5 %; blocks make it low by a few percent
    assert deviations.std() == pytest.approx(1.0, abs=0.08)
    bound = stats.norm.isf(0.5 * sidak(ALPHA, deviations.shape[1])) / math.sqrt(len(deviations))
    assert np.abs(deviations.mean(axis=0)).max() < 1.1 * bound


@pytest.mark.statistical
def test_samples_of_a_chain_have_its_transitions():
    g = LEVELS[chain(20_000, np.random.default_rng(3))]
    model = apps.MarkovChannel.fit(g, STEP, (0.5, 1.5), relative_to="absolute")
    states = model.states(model.sample(200_000, seed=4))
    for i, row in enumerate(model.transition):
        after = np.bincount(states[1:][states[:-1] == i], minlength=3)
        assert chi2_test(after, row) > sidak(ALPHA, 3)
    assert np.bincount(states) / states.size == pytest.approx(model.steady_state, abs=0.02)


def test_crossing_rates_are_those_of_the_series(seen):
    model = apps.MarkovChannel.fit(seen, STEP, 6)
    for h, rate, fade in zip(
        model.threshold, model.level_crossing_rate, model.mean_fade_duration, strict=True
    ):
        below = {"relative_to": "absolute", "resamples": 50}
        assert rate == pytest.approx(
            fading.level_crossing_rate(times(seen), seen, h, **below).value, rel=5e-3
        )
        assert fade == pytest.approx(
            fading.mean_fade_duration(times(seen), seen, h, **below).value, rel=5e-3
        )
    assert model.steady_state == pytest.approx(np.full(6, 1.0 / 6.0), abs=1e-3)


def test_states_give_error_rates(seen):
    link = OokLink()
    gain = 1.6 * limit(1e-3) * seen
    model = apps.MarkovChannel.fit(gain, STEP)
    ber, states = ber_of_gains(link, gain), model.states(gain)
    bad, good = np.bincount(states, ber) / np.bincount(states)
    assert model.steady_state @ [bad, good] == pytest.approx(ber.mean(), rel=1e-3)
    assert bad > 10.0 * good


def limit(ber):
    """Return the gain at which bits have an error rate."""
    link = OokLink()
    return link.required_power(ber) / float(link.received_power(1.0))


@pytest.mark.statistical
def test_a_chain_of_first_order_fails_on_waves(seen):
    """Fades of waves have a scale, those of a chain of two states are geometric."""
    model = apps.MarkovChannel.fit(seen, STEP)
    assert "no memory of the waves' phase" in model.notes[0]
    edges = [0.5, 2.5, 4.5, 6.5, 8.5, 10.5, 14.5, 1e9]
    expected = histogram(model.sample(300_000), model.threshold[0], edges)
    other = histogram(lognormal(30_000, 5), model.threshold[0], edges)
    assert chi2_test(other, expected / expected.sum()) < 1e-10
    # a chain is one of a chain
    two = np.array([[0.9, 0.1], [0.02, 0.98]])
    g = LEVELS[chain(60_000, np.random.default_rng(6), two)]
    model = apps.MarkovChannel.fit(g[:30_000], STEP)
    assert model.notes == ()
    duration = np.arange(1, 200)
    geometric = 0.1 * 0.9 ** (duration - 1)
    counts = histogram(g[30_000:], 0.5, [*(duration - 0.5), 1e9])
    assert chi2_test(counts, [*geometric[:-1], 0.9 ** (duration[-1] - 1)]) > ALPHA


# --- transformed Gaussian series -----------------------------------------------------------


@pytest.mark.parametrize("rho", [-0.8, -0.3, 0.1, 0.5, 0.9, 1.0])
def test_correlation_of_a_lognormal_law(rho):
    power = channels._hermite_powers(np.exp(SIGMA * np.linspace(-4.9, 4.9, 981)))
    exact = math.expm1(SIGMA**2 * rho) / math.expm1(SIGMA**2)
    assert channels._transformed(np.array(rho), power) == pytest.approx(exact, abs=2e-4)


def test_quantiles_of_a_gamma_gamma_law():
    g = fading.gamma_gamma.rvs(4.0, 2.0, size=3000, random_state=np.random.default_rng(7))
    law = fading.fit_gamma_gamma(g, n_effective=fading.effective_samples(g)).law
    scores, quantile = np.linspace(-4.9, 4.9, 981), channels._quantiles(g, "gamma-gamma")
    inside = np.abs(scores) < 4.5
    assert stats.norm.ppf(law.cdf(quantile[inside])) == pytest.approx(scores[inside], abs=0.01)


@pytest.mark.statistical
def test_generator_has_law_and_correlation(generator):
    g = generator.sample(10**6, seed=8)
    rho = fading.autocorrelation(g, max_lag=generator.lag.size - 1)
    assert rho == pytest.approx(generator.model_autocorrelation, abs=0.02)
    off = generator.model_autocorrelation - generator.autocorrelation
    assert np.abs(off[:10]).max() < 0.03
    assert generator.notes == ()
    # independent gains, ten seconds apart
    apart = np.log(g[::500])
    law = stats.norm(math.log(generator.gain_quantile[490]), SIGMA)
    assert stats.kstest(apart, law.cdf).pvalue > 0.01
    assert generator.sample(50, seed=8).tolist() != generator.sample(50, seed=9).tolist()


@pytest.mark.statistical
def test_generator_crosses_as_rice_says(generator):
    """The fit's 600 s know the deviation, by which a score is off, to 1 / (2 sqrt(B T)) = 1.5 %."""
    g = generator.sample(10**6, seed=10)
    for score in (-2.0, -1.0, 0.0, 1.0, 2.0):
        rate = fading.level_crossing_rate(
            times(g), g, math.exp(SIGMA * score), relative_to="absolute", resamples=50
        ).value
        error = math.hypot(0.015 * score**2, 0.02 * score, 0.02)
        assert rate == pytest.approx(rice(score), rel=3.9 * error)


@pytest.mark.statistical
def test_generator_against_fades_that_it_has_not_seen(generator):
    """Durations below half the mean, rates and outages of coded words of 0.1 to 0.4 s."""
    other, own = lognormal(30_000, 11), generator.sample(300_000, seed=12)
    edges = [0.5, 1.5, 2.5, 3.5, 4.5, 5.5, 6.5, 7.5, 8.5, 10.5, 1e9]
    expected = histogram(own, 0.6, edges)
    assert chi2_test(histogram(other, 0.6, edges), expected / expected.sum()) > ALPHA
    for threshold in (0.5, 1.0, 1.5):
        seen = fading.level_crossing_rate(
            times(other), other, threshold, relative_to="absolute", confidence=0.9999
        )
        rate = fading.level_crossing_rate(
            times(own), own, threshold, relative_to="absolute", resamples=50
        )
        assert seen.low < rate.value < seen.high
    for steps in (5, 10, 20):
        there, here = word_outages(other, steps), word_outages(own, steps)
        error = math.hypot(there.std() / math.sqrt(there.size), here.std() / math.sqrt(here.size))
        # words next to each other share fades: twice the error of independent ones
        assert abs(there.mean() - here.mean()) < 3.9 * 2.0 * error
        assert there.mean() > 0.001


def word_outages(g, steps):
    """Return which words of some steps carry less than 0.8 bit per use, 0.8 dB above the limit."""
    information = hard_information(ber_of_gains(OokLink(), 1.2 * limit(0.031) * g))
    words = information[: g.size // steps * steps].reshape(-1, steps).mean(axis=1)
    return (words < 0.8).astype(float)


def test_a_correlation_that_no_law_has_is_noted():
    """A skewed law has no correlation of -1."""
    turn = np.tile([0.0, 1.0], 4000) * 4.0 - 2.0
    g = np.exp(turn + 0.2 * np.random.default_rng(13).standard_normal(turn.size))
    model = apps.TransformedGaussian.fit(g, STEP, "lognormal")
    assert "no transformed Gaussian series of this law" in model.notes[0]


def test_an_empirical_law_keeps_the_extremes(seen):
    model = apps.TransformedGaussian.fit(seen, STEP, "empirical")
    g = model.sample(20_000, seed=14)
    assert seen.min() <= g.min() < g.max() <= seen.max()
    assert model.model_scintillation_index == pytest.approx(model.scintillation_index, rel=0.01)


# --- all models ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "fit",
    [
        lambda g: apps.MarkovChannel.fit(g, STEP, 3),
        lambda g: apps.TransformedGaussian.fit(g, STEP),
    ],
)
def test_models_are_stored(fit, seen, tmp_path):
    model = fit(seen[:1000])
    model.save(tmp_path / "model.nc")
    again = load(tmp_path / "model.nc")
    assert type(again) is type(model)
    assert again.summary() == model.summary()
    assert again.sample(100, seed=3).tolist() == model.sample(100, seed=3).tolist()
    assert model.mean == pytest.approx(math.exp(0.5 * SIGMA**2), abs=4.0 * model.mean_stderr)


def test_autocorrelation_of_a_first_order_series_within_its_errors():
    """Blocks: errors are true to a fifth; the closed form is 0.9^k."""
    rng = np.random.default_rng(15)
    z = []
    for _ in range(30):
        x = signal.lfilter([math.sqrt(0.19)], [1.0, -0.9], rng.standard_normal(5000))
        model = apps.MarkovChannel.fit(5.0 + x, STEP, 2)
        z.append((model.autocorrelation - 0.9 ** np.arange(model.lag.size))[1:8]
                 / model.autocorrelation_stderr[1:8])  # fmt: skip
    assert np.std(z) == pytest.approx(1.0, abs=0.35)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda g: apps.MarkovChannel.fit(g, 0.0), "dt: 0.0, allowed: > 0"),
        (lambda g: apps.MarkovChannel.fit(g, STEP, (1.0, 0.5)), "thresholds: .*increasing"),
        (lambda g: apps.MarkovChannel.fit(g, STEP, 1), "thresholds: 1, allowed"),
        (lambda g: apps.MarkovChannel.fit(g, STEP, (99.0,)), "state 1 is never left"),
        (lambda g: apps.MarkovChannel.fit(0.0 * g + 1.0, STEP), "gain: all equal"),
        (
            lambda g: apps.TransformedGaussian.fit(g, STEP, "normal"),
            "law: 'normal', did you mean",
        ),
        (lambda g: apps.TransformedGaussian.fit(g, STEP, seed=-1), "seed: -1"),
        (lambda g: apps.TransformedGaussian.fit(g, STEP).sample(0), "n: 0, allowed"),
    ],
)
def test_refuses(call, message):
    with pytest.raises(ValueError, match=message):
        call(lognormal(500, 16))


@pytest.mark.slow
def test_a_series_over_a_resolved_sea():
    """Fitted to one half, compared with the other: rates within the errors of both halves."""
    series = mt.time_series(
        mt.Link(), resolved_sea(5.0, seed=3), STEP * np.arange(600), photons=128
    )
    first, second = series.gain[:300], series.gain[300:]
    model = apps.TransformedGaussian.fit(first, STEP)
    assert model.scintillation_index == pytest.approx(0.25, abs=0.15)
    g = model.sample(200_000, seed=1)
    for threshold in (0.7, 1.0):
        rate = fading.level_crossing_rate(times(g), g, threshold, resamples=50).value
        low, high = zip(
            *(fading.level_crossing_rate(times(h), h, threshold, confidence=0.9999)[1:]
              for h in (first, second)),
            strict=True,
        )  # fmt: skip
        assert min(low) < rate < max(high)
    chain_of_two = apps.MarkovChannel.fit(first, STEP)
    assert chain_of_two.transition[0, 0] < chain_of_two.transition[1, 1]


def focused(n, seed):
    """Return gains of a lens of a smooth random curvature: flashes are shorter than fades."""
    rng = np.random.default_rng(seed)
    kernel = np.exp(-0.5 * (np.arange(-20, 21) / 5.0) ** 2)
    x = np.convolve(rng.standard_normal(n), kernel / np.linalg.norm(kernel), "same")
    return 1.0 / (0.2 + np.abs(1.0 + 0.8 * x))


def test_fades_below_a_threshold_come_as_often_as_in_the_series():
    """Crossing rates of a fresh series: with a threshold a third as far off as without."""
    level, dt = 0.7, 0.02
    seen, fresh = focused(200_000, 1), focused(200_000, 2)
    mean = seen.mean()

    def rate(gain):
        below = gain < level * mean
        return np.count_nonzero(below[1:] & ~below[:-1])

    wanted = rate(fresh)
    off = [
        rate(apps.TransformedGaussian.fit(seen, dt, "empirical", threshold=h).sample(200_000))
        / wanted
        - 1.0
        for h in (level, None)
    ]
    assert abs(off[0]) < 0.07
    assert abs(off[1]) > 3.0 * abs(off[0])
    with pytest.raises(Refused, match=r"threshold: 50\.0, allowed: a gain that the series crosses"):
        apps.TransformedGaussian.fit(seen, dt, "empirical", threshold=50.0)
