"""Fading of channel gains: statistics of ensembles and time series, closed forms from the spectrum.

The statistics take the gains as an array. `gain_stderr` is the Monte Carlo standard error of
each gain, independent from one gain to the next; its variance is subtracted from the measured one.
An error common to all gains (common random numbers) neither adds to their spread nor cancels in
their mean: leave `gain_stderr` out, and pass it to `fading_statistics` as `common_stderr`.
"""

from typing import Any

from meshtrace.fading.correlation import (
    autocorrelation,
    block_length,
    coherence_time,
    effective_samples,
)
from meshtrace.fading.crossings import level_crossing_rate, mean_fade_duration
from meshtrace.fading.distribution import Distribution, Histogram, gain_cdf, gain_pdf, outage
from meshtrace.fading.fits import (
    DistributionFit,
    GoodnessOfFit,
    Model,
    fit_gamma_gamma,
    fit_lognormal,
    goodness_of_fit,
)
from meshtrace.fading.gains import Reference, remove_noise
from meshtrace.fading.intervals import Estimate
from meshtrace.fading.resolving import BandFading, band_fading, fading_band, resolve_band
from meshtrace.fading.scintillation import scintillation_index
from meshtrace.fading.spectral import gain_autocovariance, scintillation_of_spectrum
from meshtrace.fading.statistics import fading_statistics
from meshtrace.fading.summary import FadingStatistics

__all__ = [
    "BandFading",
    "Distribution",
    "DistributionFit",
    "Estimate",
    "FadingStatistics",
    "GoodnessOfFit",
    "Histogram",
    "Model",
    "Reference",
    "autocorrelation",
    "band_fading",
    "block_length",
    "coherence_time",
    "effective_samples",
    "fading_band",
    "fading_statistics",
    "fit_gamma_gamma",
    "fit_lognormal",
    "gain_autocovariance",
    "gain_cdf",
    "gain_pdf",
    "gamma_gamma",
    "goodness_of_fit",
    "level_crossing_rate",
    "mean_fade_duration",
    "outage",
    "remove_noise",
    "resolve_band",
    "scintillation_index",
    "scintillation_of_spectrum",
]


def __getattr__(name: str) -> Any:
    """Return the scipy law `gamma_gamma`, imported on first use: `scipy.stats` takes a second."""
    if name == "gamma_gamma":
        from meshtrace.fading.laws import gamma_gamma

        return gamma_gamma
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
