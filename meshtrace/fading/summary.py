"""All fading statistics of one set of gains, as text and as a dataset."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from meshtrace.fading.distribution import Distribution, Histogram
from meshtrace.fading.fits import DistributionFit, GoodnessOfFit
from meshtrace.fading.gains import FloatArray, Reference
from meshtrace.fading.intervals import Estimate
from meshtrace.fields import attrs
from meshtrace.stored import Stored, Variable, Variables

if TYPE_CHECKING:
    import xarray

_ESTIMATES = (
    "scintillation_index",
    "outage",
    "coherence_time",
    "level_crossing_rate",
    "mean_fade_duration",
)
_PDF = {"gain_bin_edge": "gain_bin_edge", "gain_pdf": "gain_bin", "gain_pdf_stderr": "gain_bin"}
_CDF = ("gain", "gain_cdf", "gain_cdf_low", "gain_cdf_high")
_LIMITS = {"": "", "_low": ", lower confidence limit", "_high": ", upper confidence limit"}


@dataclass(frozen=True, eq=False, repr=False)
class FadingStatistics(Stored):
    """Fading statistics of one set of gains, made by `fading_statistics`.

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
    block: int
    confidence: float
    mean: Annotated[float, Variable("", name="gain_mean")]
    mean_stderr: Annotated[float, Variable("", name="gain_mean_stderr")]
    median: Annotated[float, Variable("", name="gain_median")]
    scintillation_index: Estimate
    noise_share: Annotated[float, Variable("")]
    thresholds: Annotated[tuple[float, ...], Variable("threshold", name="threshold")]
    relative_to: Reference
    outage: tuple[Estimate, ...]
    pdf: Histogram
    cdf: Distribution
    fits: tuple[DistributionFit, ...]
    goodness: tuple[GoodnessOfFit, ...]
    notes: tuple[str, ...]
    lag: Annotated[FloatArray | None, Variable("lag")] = None
    autocorrelation: Annotated[FloatArray | None, Variable("lag")] = None
    coherence_time: Estimate | None = None
    level_crossing_rate: tuple[Estimate, ...] = ()
    mean_fade_duration: tuple[Estimate, ...] = ()
    provenance: dict[str, Any] = field(default_factory=dict)

    kind: ClassVar[str] = "fading"
    title: ClassVar[str] = "meshtrace fading statistics"
    _attributes: ClassVar[tuple[str, ...]] = (
        *("n", "n_effective", "block=block_length", "confidence", "notes", "fits", "goodness"),
        "relative_to=threshold_relative_to",
    )

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
        lines += self._threshold_lines() + self._fit_lines()
        return "\n".join(lines + [f"  note: {note}" for note in self.notes])

    def _threshold_lines(self) -> list[str]:
        lines = []
        for i, threshold in enumerate(self.thresholds):
            what = f"gain < {threshold:g}"
            what += "" if self.relative_to == "absolute" else f" x {self.relative_to}"
            lines.append(f"  {what:<20} outage {_text(self.outage[i])}")
            if self.level_crossing_rate:
                lines.append(f"{'':<23}crossings {_text(self.level_crossing_rate[i])} per s")
                fade = self.mean_fade_duration[i]
                lines.append(f"{'':<23}mean fade {_seconds(fade)}")
        return lines

    def _fit_lines(self) -> list[str]:
        tests = {test.model: test for test in self.goodness}
        lines = []
        for fit in self.fits:
            values = ", ".join(f"{name} {value:.4g}" for name, value in fit.parameters.items())
            line = f"  {fit.model:<20} {values}; AIC {fit.aic:.6g}"
            if fit.model in tests:
                line += f"; KS {tests[fit.model].ks:.3g}, p = {tests[fit.model].p_value:.3g}"
            lines.append(line)
        return lines

    def to_variables(self) -> Variables:
        """Return the arrays by their names in files, with dimensions and attributes."""
        pdf, cdf = self.pdf, self.cdf
        found = super().to_variables()
        for name, dims, values in (
            ("gain_bin", ("gain_bin",), 0.5 * (pdf.edges[1:] + pdf.edges[:-1])),
            ("gain_bin_width", ("gain_bin",), np.diff(pdf.edges)),
            *((name, (_PDF[name],), values) for name, values in zip(_PDF, pdf, strict=True)),
            *((name, ("gain",), values) for name, values in zip(_CDF, cdf, strict=True)),
            *(self._fit_variables() if self.fits else ()),
        ):
            found[name] = (dims, np.asarray(values), attrs(name))
        for name in _ESTIMATES:
            estimates = getattr(self, name)
            dims = () if isinstance(estimates, Estimate) else ("threshold",)
            columns = zip(_LIMITS, np.transpose(estimates), strict=True) if estimates else ()
            for suffix, column in columns:
                about = attrs(name)
                about["long_name"] += _LIMITS[suffix]
                found[name + suffix] = (dims, column, about)
        return found

    @classmethod
    def arrays(cls, data: xarray.Dataset) -> dict[str, Any]:
        """Return the fields that the variables of a dataset hold."""

        def estimates(name: str) -> Any:
            if name not in data:
                return None if name == "coherence_time" else ()
            columns = np.stack([data[name + suffix] for suffix in _LIMITS], axis=-1)
            rows = tuple(Estimate(*row.tolist()) for row in np.atleast_2d(columns))
            return rows if data[name].dims else rows[0]

        found = super().arrays(data)
        return found | {
            "thresholds": tuple(found["thresholds"].tolist()),
            "pdf": Histogram(*(data[name].to_numpy() for name in _PDF)),
            "cdf": Distribution(*(data[name].to_numpy() for name in _CDF)),
            **{name: estimates(name) for name in _ESTIMATES},
        }

    def _fit_variables(self) -> Iterator[tuple[str, tuple[str, ...], object]]:
        names = list(dict.fromkeys(name for fit in self.fits for name in fit.parameters))
        tests = {test.model: test for test in self.goodness}
        none = GoodnessOfFit("lognormal", math.nan, math.nan, 0)
        values = [[fit.parameters.get(name, math.nan) for name in names] for fit in self.fits]
        yield "model", ("model",), [fit.model for fit in self.fits]
        yield "fit_parameter", ("fit_parameter",), names
        yield "fit_value", ("model", "fit_parameter"), values
        yield "aic", ("model",), [fit.aic for fit in self.fits]
        yield "ks", ("model",), [tests.get(fit.model, none).ks for fit in self.fits]
        yield "ks_p_value", ("model",), [tests.get(fit.model, none).p_value for fit in self.fits]


def _text(estimate: Estimate) -> str:
    return f"{estimate.value:.4g} [{estimate.low:.4g}, {estimate.high:.4g}]"


def _seconds(estimate: Estimate) -> str:
    """Return a time as text, "-" for one that the gains do not have."""
    return "-" if math.isnan(estimate.value) else f"{_text(estimate)} s"
