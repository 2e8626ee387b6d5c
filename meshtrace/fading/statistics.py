"""All fading statistics of an ensemble or a time series at once."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.errors import require_array, require_between, require_whole
from meshtrace.fading.correlation import (
    autocorrelation,
    block_length,
    coherence_time,
    effective_samples,
)
from meshtrace.fading.crossings import level_crossing_rate, mean_fade_duration
from meshtrace.fading.distribution import gain_cdf, gain_pdf, outage
from meshtrace.fading.fits import (
    DistributionFit,
    GoodnessOfFit,
    fit_gamma_gamma,
    fit_lognormal,
    goodness_of_fit,
)
from meshtrace.fading.gains import (
    MOST_RESAMPLES,
    FloatArray,
    Reference,
    check_bootstrap,
    checked,
    checked_step,
    level_of,
    remove_noise,
)
from meshtrace.fading.intervals import Estimate
from meshtrace.fading.scintillation import scintillation_index
from meshtrace.fading.summary import FadingStatistics

# Below these numbers the intervals of a series are rough, and a fit is not tested.
_FEWEST_STEPS = 3  # of a coherence time
_FEWEST_EFFECTIVE = 20.0
_FEWEST_TESTED = 20


def fading_statistics(
    gain: ArrayLike,
    gain_stderr: ArrayLike | None = None,
    *,
    time: ArrayLike | None = None,
    common_stderr: float = 0.0,
    thresholds: Sequence[float] = (0.5, 0.8, 0.9, 1.0),
    relative_to: Reference = "mean",
    confidence: float = 0.95,
    resamples: int = 999,
    test_resamples: int = 199,
    seed: int = 1,
) -> FadingStatistics:
    """Return all fading statistics of an ensemble or, with `time`, of a time series.

    Parameters
    ----------
    gain : array_like, shape (n,)
        Channel gains [1].
    gain_stderr : array_like, shape () or (n,), optional
        Monte Carlo standard error of each gain [1], independent from one gain to the next.
    time : array_like, shape (n,), optional
        Equally spaced times [s]; without them the gains are independent realizations.
    common_stderr : float, optional
        Standard error of the mean [1] from random numbers common to all gains.
    thresholds : sequence of float, optional
        Thresholds [1] of outage, crossing rate and fade duration.
    relative_to : {"mean", "median", "absolute"}, optional
        Reference of the thresholds.
    confidence : float, optional
        Level of all intervals [1].
    resamples, test_resamples : int, optional
        Number of replicates for the intervals, and for the tests of fit; 0 tests leave them out.
    seed : int, optional
        Seed of all replicates.

    Returns
    -------
    FadingStatistics
        With `summary()` and `to_dataset()`.

    Raises
    ------
    Refused
        If a value is negative or not finite, the times are not equally spaced, or an option is
        out of range.

    Notes
    -----
    The variance of independent errors is removed from the spread of the gains. A common error does
    not widen it: only the mean carries it, in full. A series is tested for fit on every k-th gain,
    with k = n / n_effective; its likelihoods count every gain, so that only the order of the AIC
    has a meaning.

    Examples
    --------
    >>> g = np.random.default_rng(4).lognormal(-10.0, 0.1, 300)
    >>> s = fading_statistics(g, 1e-7, test_resamples=0)
    >>> s.n, round(s.scintillation_index.value, 3), [fit.model for fit in s.fits]
    (300, 0.01, ['lognormal', 'gamma-gamma'])
    """
    g, variance = checked(gain, gain_stderr)
    require_between(common_stderr, 0.0, math.inf, "common_stderr", "[)", "finite >= 0")
    require_whole(test_resamples, 0, MOST_RESAMPLES, "test_resamples")
    check_bootstrap(confidence, resamples)
    stderr = np.sqrt(variance) if variance.any() else None
    noise, spread = float(variance.mean()), float(g.var(ddof=1))
    fades = bool(np.ptp(g) > 0.0 and spread * (g.size - 1) / g.size > noise)
    levels = tuple(require_array(thresholds, "thresholds", "numbers > 0").ravel().tolist())
    block = 1 if time is None else block_length(g)
    boot: Any = {"block": block, "confidence": confidence, "resamples": resamples, "seed": seed}
    n_effective = float(g.size)
    series: dict[str, Any] = {}
    if time is not None:
        n_effective = effective_samples(g, stderr) if fades else n_effective
        series = _series_part(time, g, stderr, fades, levels, relative_to, boot)
    sample = remove_noise(g, stderr)
    fits, goodness, fit_notes = _all_fits(sample, n_effective, test_resamples, seed)
    index = scintillation_index(g, stderr, **boot)
    own = max(spread - noise, 0.0) / n_effective + noise / g.size
    return FadingStatistics(
        n=g.size,
        n_effective=n_effective,
        block=block,
        confidence=confidence,
        mean=float(g.mean()),
        mean_stderr=math.hypot(math.sqrt(own), common_stderr),
        median=float(np.median(g)),
        scintillation_index=index,
        noise_share=noise / spread if spread > 0.0 else 0.0,
        thresholds=levels,
        relative_to=relative_to,
        outage=tuple(_outages(sample, levels, relative_to, n_effective, confidence)),
        pdf=gain_pdf(sample),
        cdf=gain_cdf(sample, n_effective=n_effective, confidence=confidence),
        fits=fits,
        goodness=goodness,
        notes=(
            *_noise_notes(g, variance, fades, index),
            *(_series_notes(g, noise, n_effective, series) if series else ()),
            *fit_notes,
        ),
        **series,
    )


def _series_part(
    time: ArrayLike,
    g: FloatArray,
    stderr: FloatArray | None,
    fades: bool,
    levels: tuple[float, ...],
    relative_to: Reference,
    boot: dict[str, Any],
) -> dict[str, Any]:
    """Return the fields of the statistics that a time series alone has."""
    lag = checked_step(time, g.size) * np.arange(g.size // 2 + 1, dtype=np.float64)
    nothing = Estimate(math.nan, math.nan, math.nan)
    below = {"relative_to": relative_to, **boot}
    return {
        "lag": lag,
        "autocorrelation": autocorrelation(g, stderr) if fades else np.full_like(lag, math.nan),
        "coherence_time": coherence_time(time, g, stderr, **boot)
        if fades and g.size >= _FEWEST_STEPS
        else nothing,
        "level_crossing_rate": tuple(level_crossing_rate(time, g, h, **below) for h in levels),
        "mean_fade_duration": tuple(mean_fade_duration(time, g, h, **below) for h in levels),
    }


def _outages(
    sample: FloatArray,
    levels: tuple[float, ...],
    relative_to: Reference,
    n_effective: float,
    confidence: float,
) -> Iterator[Estimate]:
    """Yield the outage below each threshold, with the number of trials behind it."""
    options: Any = {"relative_to": relative_to, "confidence": confidence}
    for threshold in levels:
        trials = n_effective
        if n_effective != sample.size:
            below = (sample < level_of(sample, threshold, relative_to)).astype(np.float64)
            # Rare outages decorrelate faster than the gain: their own correlation counts.
            trials = effective_samples(below) if 0.0 < below.mean() < 1.0 else n_effective
        yield outage(sample, threshold, n_effective=trials, **options)


def _all_fits(
    sample: FloatArray, n_effective: float, resamples: int, seed: int
) -> tuple[tuple[DistributionFit, ...], tuple[GoodnessOfFit, ...], list[str]]:
    if not sample.all():
        return (), (), ["some gains are 0: no continuous law fitted"]
    if np.ptp(sample) <= 1e-12 * sample.max():
        return (), (), ["no variance above the Monte Carlo noise: no law fitted"]
    fits = (fit_lognormal(sample), fit_gamma_gamma(sample, n_effective=n_effective))
    notes = [f"{fit.model}: {fit.note}" for fit in fits if fit.note]
    apart = sample[:: math.ceil(sample.size / n_effective)]
    if resamples == 0:
        return fits, (), notes
    if apart.size < _FEWEST_TESTED:
        return fits, (), [*notes, f"only {apart.size} independent gains: fits not tested"]
    tests = tuple(goodness_of_fit(f.model, apart, resamples=resamples, seed=seed) for f in fits)
    return fits, tests, notes


def _noise_notes(g: FloatArray, variance: FloatArray, fades: bool, index: Estimate) -> list[str]:
    notes = []
    if not fades:
        notes.append("no fading above the Monte Carlo noise")
    if index.high < 0.0:
        notes.append(
            "the gains scatter less than independent errors of the stated size would: give the "
            "error common to all gains (common random numbers) as common_stderr"
        )
    blurred = np.count_nonzero(variance > (0.3 * g) ** 2)
    if blurred:
        notes.append(f"{blurred} gains have an error above 30 %: deep fades are blurred by noise")
    return notes


def _series_notes(
    g: FloatArray, independent: float, n_effective: float, series: dict[str, Any]
) -> list[str]:
    notes = []
    if n_effective < _FEWEST_EFFECTIVE:
        notes.append(
            f"the effective sample size is {n_effective:.2g}: the scintillation index is biased "
            f"low by about {100.0 / n_effective:.0f} %, and the intervals are approximate"
        )
    if math.isnan(series["coherence_time"].value):
        notes.append(f"the coherence time needs gains that vary, at {_FEWEST_STEPS} times or more")
    if series["coherence_time"].value < series["lag"][1]:
        notes.append("the coherence time is below one time step: use shorter steps")
    steps = float(np.mean(np.diff(g) ** 2))
    if independent and 2.0 * independent > 0.1 * steps:
        notes.append(
            f"Monte Carlo noise is {100.0 * min(1.0, 2.0 * independent / steps):.0f} % of the "
            "step-to-step variance: crossing rates are too high, fades too short; use common "
            "random numbers or more photons"
        )
    return notes
