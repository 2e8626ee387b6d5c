"""Fading of channel gains: statistics of ensembles and time series, closed forms from the spectrum.

The statistics take the gains as an array. `gain_stderr` is the Monte Carlo standard error of
each gain, independent from one gain to the next; its variance is subtracted from the measured one.
An error common to all gains (common random numbers) neither adds to their spread nor cancels in
their mean: leave `gain_stderr` out, and pass it to `fading_statistics` as `common_stderr`.
"""

from meshtrace.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
