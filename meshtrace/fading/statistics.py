"""All fading statistics of an ensemble or a time series at once, as text and as a dataset."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.checks import NonNegative, Probability, Seed, check_call
from meshtrace.errors import require_array
from meshtrace.fading.distribution import (
    MOST_RESAMPLES,
    Distribution,
    Estimate,
    Histogram,
    Reference,
    Resamples,
    checked,
    checked_step,
    gain_cdf,
    gain_pdf,
    level_of,
    outage,
    remove_noise,
    scintillation_index,
)
from meshtrace.fading.fits import (
    DistributionFit,
    GoodnessOfFit,
    fit_gamma_gamma,
    fit_lognormal,
    goodness_of_fit,
)
from meshtrace.fading.series import (
    autocorrelation,
    block_length,
    coherence_time,
    effective_samples,
    level_crossing_rate,
    mean_fade_duration,
)
from meshtrace.models import Floats
from meshtrace.stored import Attribute, Columns, Part, Stored, Variable, Variables


@dataclass(frozen=True, eq=False, repr=False)
class FadingStatistics(Stored, kind="fading", title="meshtrace fading statistics"):
    """Fading statistics of one set of gains, as `fading_statistics` returns them.

    Parameters
    ----------
    n : int
        Number of gains.
    n_effective : float
        Effective sample size; n for an ensemble.
    block : int
        Block length [samples] of the bootstrap; 1 for an ensemble.
    confidence : float
        Level of all intervals [1].
    mean, mean_stderr, median : float
        Gain [1].
    scintillation_index : Estimate
        Monte Carlo variance removed [1].
    noise_share : float
        Share of the Monte Carlo noise in the variance of the gains [1].
    thresholds : tuple of float
        Thresholds [1], multiples of `relative_to`.
    relative_to : {"mean", "median", "absolute"}
        Reference of the thresholds.
    outage : tuple of Estimate
        P(gain < threshold) [1].
    pdf, cdf : Histogram, Distribution
        Density and distribution function of the gain.
    fits, goodness : tuple
        Fitted laws, and their tests.
    notes : tuple of str
        Limitations of the numbers.
    lag, autocorrelation : ndarray, optional
        Lags [s] and autocorrelation [1] of a series.
    coherence_time : Estimate, optional
        Lag of 1/e [s] of a series.
    level_crossing_rate, mean_fade_duration : tuple of Estimate
        Per threshold [s-1], [s]; empty for an ensemble.
    provenance : dict
        Origin of the gains.
    """

    n: int
    n_effective: float
    block: Annotated[int, Attribute("block_length")]
    confidence: float
    mean: Annotated[float, Variable(name="gain_mean")]
    mean_stderr: Annotated[float, Variable(name="gain_mean_stderr")]
    median: Annotated[float, Variable(name="gain_median")]
    scintillation_index: Annotated[Estimate, Columns(Estimate, "scintillation_index")]
    noise_share: Annotated[float, Variable()]
    thresholds: Annotated[tuple[float, ...], Variable("threshold", name="threshold")]
    relative_to: Annotated[Reference, Attribute("threshold_relative_to")]
    outage: Annotated[tuple[Estimate, ...], Columns(Estimate, "outage", "threshold")]
    pdf: Annotated[Histogram, Part(Histogram)]
    cdf: Annotated[Distribution, Part(Distribution)]
    fits: tuple[DistributionFit, ...]
    goodness: tuple[GoodnessOfFit, ...]
    notes: tuple[str, ...]
    lag: Annotated[Floats | None, Variable("lag")] = None
    autocorrelation: Annotated[Floats | None, Variable("lag")] = None
    coherence_time: Annotated[Estimate | None, Columns(Estimate, "coherence_time")] = None
    level_crossing_rate: Annotated[
        tuple[Estimate, ...], Columns(Estimate, "level_crossing_rate", "threshold")
    ] = ()
    mean_fade_duration: Annotated[
        tuple[Estimate, ...], Columns(Estimate, "mean_fade_duration", "threshold")
    ] = ()
    provenance: dict[str, Any] = field(default_factory=dict)

    def _headline(self) -> str:
        index = _text(self.scintillation_index)
        return f"{self.n} gains, mean {self.mean:.4e}, scintillation index {index}"

    def summary(self) -> str:
        """Return the statistics as text for a terminal."""
        kind = "independent gains" if self.lag is None else "gains of a time series"
        lines = [
            f"Fading of {self.n} {kind} (intervals {100.0 * self.confidence:g} %)",
            f"  mean gain            {self.mean:.6g} +- {self.mean_stderr:.2g}",
            f"  median gain          {self.median:.6g}",
            f"  scintillation index  {_text(self.scintillation_index)}",
            f"  Monte Carlo share    {100.0 * self.noise_share:.3g} % of the variance",
        ]
        if self.coherence_time is not None:
            lines += [
                f"  coherence time       {_seconds(self.coherence_time)}",
                f"  independent samples  {self.n_effective:.3g} (blocks of {self.block})",
            ]
        for i, threshold in enumerate(self.thresholds):
            what = f"gain < {threshold:g}"
            what += "" if self.relative_to == "absolute" else f" x {self.relative_to}"
            lines.append(f"  {what:<20} outage {_text(self.outage[i])}")
            if self.level_crossing_rate:
                lines.append(f"{'':<23}crossings {_text(self.level_crossing_rate[i])} per s")
                lines.append(f"{'':<23}mean fade {_seconds(self.mean_fade_duration[i])}")
        tests = {test.model: test for test in self.goodness}
        for fit in self.fits:
            values = ", ".join(f"{name} {value:.4g}" for name, value in fit.parameters.items())
            line = f"  {fit.model:<20} {values}; AIC {fit.aic:.6g}"
            if fit.model in tests:
                line += f"; KS {tests[fit.model].ks:.3g}, p = {tests[fit.model].p_value:.3g}"
            lines.append(line)
        return "\n".join(lines + [f"  note: {note}" for note in self.notes])

    def _derived(self) -> Variables:
        """Return the bins of the density, and the fitted laws with their tests."""
        edges, fits = self.pdf.edges, self.fits
        bins: Variables = {
            "gain_bin": ("gain_bin", 0.5 * (edges[1:] + edges[:-1])),
            "gain_bin_width": ("gain_bin", np.diff(edges)),
        }
        if not fits:
            return bins
        names = list(dict.fromkeys(name for fit in fits for name in fit.parameters))
        known = {test.model: test for test in self.goodness}
        # laws without a test have nan in its columns
        none = GoodnessOfFit("lognormal", math.nan, math.nan, 0)
        tests = [known.get(fit.model, none) for fit in fits]
        values = [[fit.parameters.get(name, math.nan) for name in names] for fit in fits]
        return bins | {
            "model": ("model", [fit.model for fit in fits]),
            "fit_parameter": ("fit_parameter", names),
            "fit_value": (("model", "fit_parameter"), values),
            "aic": ("model", [fit.aic for fit in fits]),
            "ks": ("model", [test.ks for test in tests]),
            "ks_p_value": ("model", [test.p_value for test in tests]),
        }


def _text(estimate: Estimate) -> str:
    """Format a value with its limits."""
    return f"{estimate.value:.4g} [{estimate.low:.4g}, {estimate.high:.4g}]"


def _seconds(estimate: Estimate) -> str:
    """Format a time with its limits, "-" if it is not defined."""
    return "-" if math.isnan(estimate.value) else f"{_text(estimate)} s"


_FEWEST_STEPS = 3  # times of a series below which it has no coherence time
_FEWEST_EFFECTIVE = 20.0  # independent samples below which intervals of a series are rough
_FEWEST_TESTED = 20  # independent gains below which a fit is not tested


@check_call
def fading_statistics(
    gain: ArrayLike,
    gain_stderr: ArrayLike | None = None,
    *,
    time: ArrayLike | None = None,
    common_stderr: NonNegative = 0.0,
    thresholds: Sequence[float] = (0.5, 0.8, 0.9, 1.0),
    relative_to: Reference = "mean",
    confidence: Probability = 0.95,
    resamples: Resamples = 999,
    test_resamples: Annotated[int, Field(ge=0, le=MOST_RESAMPLES)] = 199,
    seed: Seed = 1,
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
        Number of replicates for the intervals, and for the tests of fit; with 0 fits are not
        tested.
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
    not widen the spread and enters the standard error of the mean alone, in full. The fits to a
    series are tested on every k-th gain, with k = n / n_effective; its likelihoods count every
    gain, so that only the order of the AIC has a meaning.

    Examples
    --------
    >>> g = np.random.default_rng(4).lognormal(-10.0, 0.1, 300)
    >>> s = fading_statistics(g, 1e-7, test_resamples=0)
    >>> s.n, round(s.scintillation_index.value, 3), [fit.model for fit in s.fits]
    (300, 0.01, ['lognormal', 'gamma-gamma'])
    """
    g, variance = checked(gain, gain_stderr)
    stderr = np.sqrt(variance) if variance.any() else None
    noise, spread = float(variance.mean()), float(g.var(ddof=1))
    # as in `autocorrelation`, which refuses gains without fading: there the variance divides by n
    fades = bool(np.ptp(g) > 0.0 and spread * (g.size - 1) / g.size > noise)
    levels = tuple(require_array(thresholds, "thresholds", "numbers > 0").ravel().tolist())
    block = 1 if time is None else block_length(g)
    # options of all bootstraps
    boot: Any = {"block": block, "confidence": confidence, "resamples": resamples, "seed": seed}
    series: dict[str, Any] = {"n_effective": float(g.size)}
    if time is not None:
        series |= _series_part(time, g, stderr, fades, levels, relative_to, boot)
    n_effective = series["n_effective"]
    sample = remove_noise(g, stderr)
    fits, goodness, fit_notes = _all_fits(sample, n_effective, test_resamples, seed)
    outages = []
    for level in levels:
        # which gains are below the level, without their noise as in `outage`
        below = (sample < level_of(sample, level, relative_to)).astype(np.float64)
        trials = n_effective
        if n_effective != g.size and 0.0 < below.mean() < 1.0:
            # rare outages decorrelate faster than the gain, so that their autocorrelation counts
            trials = effective_samples(below)
        outages.append(outage(
            sample, level, relative_to=relative_to, n_effective=trials, confidence=confidence
        ))  # fmt: skip
    index = scintillation_index(g, stderr, **boot)
    # fading is correlated along a series, independent errors are not: each over its sample size
    mean_variance = max(spread - noise, 0.0) / n_effective + noise / g.size
    return FadingStatistics(
        n=g.size,
        block=block,
        confidence=confidence,
        mean=float(g.mean()),
        mean_stderr=math.hypot(math.sqrt(mean_variance), common_stderr),
        median=float(np.median(g)),
        scintillation_index=index,
        noise_share=noise / spread if spread > 0.0 else 0.0,
        thresholds=levels,
        relative_to=relative_to,
        outage=tuple(outages),
        pdf=gain_pdf(sample),
        cdf=gain_cdf(sample, n_effective=n_effective, confidence=confidence),
        fits=fits,
        goodness=goodness,
        notes=(*_notes(g, variance, fades, index, series), *fit_notes),
        **series,
    )


def _series_part(
    time: ArrayLike,
    g: Floats,
    stderr: Floats | None,
    fades: bool,
    levels: tuple[float, ...],
    relative_to: Reference,
    boot: dict[str, Any],
) -> dict[str, Any]:
    """Return the fields of `FadingStatistics` that only time series have.

    `boot` are the options of the bootstraps, `fades` is whether the gains vary by more than noise.
    """
    lag = checked_step(time, g.size) * np.arange(g.size // 2 + 1, dtype=np.float64)
    undefined = Estimate(math.nan, math.nan, math.nan)
    options = boot | {"relative_to": relative_to}
    return {
        "n_effective": effective_samples(g, stderr) if fades else float(g.size),
        "lag": lag,
        "autocorrelation": autocorrelation(g, stderr) if fades else np.full_like(lag, math.nan),
        "coherence_time": coherence_time(time, g, stderr, **boot)
        if fades and g.size >= _FEWEST_STEPS
        else undefined,
        "level_crossing_rate": tuple(level_crossing_rate(time, g, h, **options) for h in levels),
        "mean_fade_duration": tuple(mean_fade_duration(time, g, h, **options) for h in levels),
    }


def _all_fits(
    sample: Floats, n_effective: float, resamples: int, seed: int
) -> tuple[tuple[DistributionFit, ...], tuple[GoodnessOfFit, ...], list[str]]:
    """Fit and test all laws; return fits, tests, and notes on failures."""
    if not sample.all():
        return (), (), ["some gains are 0: no continuous law fitted"]
    if np.ptp(sample) <= 1e-12 * sample.max():
        return (), (), ["no variance above the Monte Carlo noise: no law fitted"]
    fits = (fit_lognormal(sample), fit_gamma_gamma(sample, n_effective=n_effective))
    notes = [f"{fit.model}: {fit.note}" for fit in fits if fit.note]
    # every k-th gain: these are about independent, as the test assumes
    apart = sample[:: math.ceil(sample.size / n_effective)]
    if resamples == 0:
        return fits, (), notes
    if apart.size < _FEWEST_TESTED:
        return fits, (), [*notes, f"only {apart.size} independent gains: fits not tested"]
    tests = tuple(goodness_of_fit(f.model, apart, resamples=resamples, seed=seed) for f in fits)
    return fits, tests, notes


def _notes(
    g: Floats, variance: Floats, fades: bool, index: Estimate, fields: dict[str, Any]
) -> Iterator[str]:
    """Yield the limitations of the statistics."""
    if not fades:
        yield "no fading above the Monte Carlo noise"
    if index.high < 0.0:
        yield (
            "the gains scatter less than independent errors of the stated size would: give the "
            "error common to all gains (common random numbers) as common_stderr"
        )
    # `remove_noise` expands the logarithm, which relative errors above 0.3 do not allow
    blurred = np.count_nonzero(variance > (0.3 * g) ** 2)
    if blurred:
        yield f"{blurred} gains have an error above 30 %: deep fades are blurred by noise"
    if "lag" not in fields:
        return
    n_effective, coherence = fields["n_effective"], fields["coherence_time"].value
    if n_effective < _FEWEST_EFFECTIVE:
        yield (
            f"the effective sample size is {n_effective:.2g}: the scintillation index is biased "
            f"low by about {100.0 / n_effective:.0f} %, and the intervals are approximate"
        )
    if math.isnan(coherence):
        yield f"the coherence time needs gains that vary, at {_FEWEST_STEPS} times or more"
    # shorter coherence times are interpolated within the first step
    if coherence < fields["lag"][1]:
        yield "the coherence time is below one time step: use shorter steps"
    # the difference of neighbouring gains has the error variances of both
    noise, steps = 2.0 * float(variance.mean()), float(np.mean(np.diff(g) ** 2))
    if noise and noise > 0.1 * steps:
        yield (
            f"Monte Carlo noise is {100.0 * min(1.0, noise / steps):.0f} % of the "
            "step-to-step variance: crossing rates are too high, fades too short; use common "
            "random numbers or more photons"
        )
