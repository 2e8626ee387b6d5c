"""Plots of gains: over time, over many seas, over a plane, and what became of the light."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from meshtrace.fading import (
    DistributionFit,
    fit_gamma_gamma,
    fit_lognormal,
    gain_cdf,
    gain_pdf,
    remove_noise,
)
from meshtrace.results.gain import FATE_MEANING, Fate, GainResult

from .curves import Floats, label_of
from .style import INK, PALETTE, axes, axis_label

if TYPE_CHECKING:
    import xarray as xr

    from meshtrace.fading import FadingStatistics
    from meshtrace.results.coverage import CoverageMap
    from meshtrace.results.series import GainSeries

_FITS: dict[str, Callable[[Floats], DistributionFit]] = {
    "lognormal": fit_lognormal,
    "gamma-gamma": fit_gamma_gamma,
}


def plot_fates(result: GainResult, *, ax: Axes | None = None) -> Axes:
    """Plot what became of the light: share of the launched weight by fate, logarithmic.

    Parameters
    ----------
    result : GainResult
        Result of the analog estimator.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        If the result has no fates.
    """
    if not result.fates:
        raise ValueError('result: no fates, allowed a result of estimator="analog"')
    ax = axes(ax)
    shares = {name: tally.weight for name, tally in result.fates.items() if tally.weight > 0.0}
    meanings = [FATE_MEANING[Fate[name.upper()]] for name in shares]
    bars = ax.barh(meanings, list(shares.values()), color=PALETTE["blue"])
    ax.bar_label(bars, [f"{v:.2g}" for v in shares.values()], padding=3, fontsize=9)
    decades = 10.0 ** np.arange(np.floor(np.log10(min(shares.values()))), 1.0)
    ax.set(xscale="log", xlabel="share of the emitted light", xticks=decades)
    ax.set_xlim(decades[0], 10.0)  # what is written beside the bars needs room
    ax.invert_yaxis()
    ax.grid(axis="y", visible=False)
    return ax


def plot_gain_series(
    series: GainSeries | xr.Dataset | ArrayLike,
    gain: ArrayLike | None = None,
    gain_stderr: ArrayLike | None = None,
    *,
    ax: Axes | None = None,
) -> Axes:
    """Plot the gain over time, or over realizations, with a band of two standard errors.

    Parameters
    ----------
    series : GainSeries, xarray.Dataset or array_like, shape (n,)
        A series, or its times [s].
    gain, gain_stderr : array_like, shape (n,) or (n, receivers), optional
        Gains and their standard errors, with times as arrays.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        If times come without gains.
    """
    x, values, errors, along = _series(series, gain, gain_stderr)
    ax = axes(ax)
    for i, (g, e) in enumerate(zip(values.T, errors.T, strict=True)):
        name = f"receiver {i}" if values.shape[1] > 1 else None
        (line,) = ax.plot(x, g, label=name)
        ax.fill_between(x, g - 2.0 * e, g + 2.0 * e, color=line.get_color(), alpha=0.25, lw=0)
    if values.shape[1] > 1:
        ax.legend()
    ax.set(xlabel=label_of(along), ylabel=axis_label("gain"))
    return ax


def _series(
    series: Any, gain: ArrayLike | None, stderr: ArrayLike | None
) -> tuple[Floats, Floats, Floats, str]:
    """Return abscissa (n,), gains and errors (n, receivers), and what the abscissa is."""
    if hasattr(series, "to_dataset") and not hasattr(series, "dims"):
        series = series.to_dataset()
    if hasattr(series, "data_vars"):
        along = str(series["gain"].dims[0])
        gain, stderr = series["gain"].to_numpy(), series["gain_stderr"].to_numpy()
        x = series[along].to_numpy() if along == "time" else np.arange(series.sizes[along])
    elif gain is None:
        raise ValueError("gain: None, allowed an array with times as arrays")
    else:
        along, x = "time", np.asarray(series, dtype=float)
    values = np.asarray(gain, dtype=float).reshape(len(x), -1)
    errors = np.zeros_like(values) if stderr is None else np.reshape(stderr, values.shape)
    return np.asarray(x, dtype=float), values, np.asarray(errors, dtype=float), along


def plot_gain_pdf(
    gain: ArrayLike,
    gain_stderr: ArrayLike | None = None,
    *,
    fits: Sequence[str] = ("lognormal", "gamma-gamma"),
    bins: int | str = "auto",
    ax: Axes | None = None,
) -> Axes:
    """Plot the density of the gain with its standard errors, and fitted fading laws.

    Parameters
    ----------
    gain, gain_stderr : array_like, shape (n,)
        Gains and their standard errors, whose share of the variance is removed.
    fits : sequence of str
        Laws to fit: "lognormal", "gamma-gamma".
    bins : int or str
        Number of bins or a rule of `numpy.histogram_bin_edges`.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        If a law is unknown or the gains cannot be fitted.
    """
    laws = _fitted(gain, gain_stderr, fits)
    histogram = gain_pdf(gain, gain_stderr, bins=bins)
    ax = axes(ax)
    middle = 0.5 * (histogram.edges[1:] + histogram.edges[:-1])
    ax.stairs(histogram.density, histogram.edges, fill=True, color=PALETTE["sky"], alpha=0.45)
    ax.errorbar(middle, histogram.density, histogram.density_stderr, fmt="none", ecolor=INK, lw=0.9)
    x = np.linspace(histogram.edges[0], histogram.edges[-1], 400)
    x = x[x > 0.0]
    for name, law in laws.items():
        ax.plot(x, law.pdf(x), label=f"{name}, index {law.scintillation_index:.3g}")
    if laws:
        ax.legend()
    ax.set(xlabel=axis_label("gain"), ylabel=axis_label("gain_pdf"))
    return ax


def plot_gain_cdf(
    gain: ArrayLike,
    gain_stderr: ArrayLike | None = None,
    *,
    fits: Sequence[str] = ("lognormal", "gamma-gamma"),
    n_effective: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot the distribution function of the gain, logarithmic, with a 95 % band and fitted laws.

    Parameters
    ----------
    gain, gain_stderr : array_like, shape (n,)
        Gains and their standard errors, whose share of the variance is removed.
    fits : sequence of str
        Laws to fit: "lognormal", "gamma-gamma".
    n_effective : float, optional
        Independent samples, for the band; see `fading.effective_samples`.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        If a law is unknown or the gains cannot be fitted.
    """
    laws = _fitted(gain, gain_stderr, fits)
    empirical = gain_cdf(gain, gain_stderr, n_effective=n_effective)
    ax = axes(ax)
    ax.step(empirical.gain, empirical.probability, where="post", color=INK, label="simulated")
    ax.fill_between(
        empirical.gain, empirical.low, empirical.high, step="post", color=INK, alpha=0.15, lw=0
    )
    x = np.linspace(empirical.gain[0], empirical.gain[-1], 400)
    for name, law in laws.items():
        ax.plot(x, law.cdf(x), label=name)
    ax.legend()
    ax.set(yscale="log", xlabel=axis_label("gain"), ylabel=axis_label("gain_cdf"))
    ax.set_ylim(0.5 / len(empirical.gain), 1.3)
    return ax


def _fitted(
    gain: ArrayLike, stderr: ArrayLike | None, names: Sequence[str]
) -> dict[str, DistributionFit]:
    for name in names:
        if name not in _FITS:
            raise ValueError(f"fits: {name!r}, allowed {', '.join(_FITS)}")
    clean = remove_noise(gain, stderr)
    return {name: _FITS[name](clean) for name in names}


def plot_autocorrelation(statistics: FadingStatistics, *, ax: Axes | None = None) -> Axes:
    """Plot the autocorrelation of the gain with the coherence time at 1/e.

    Parameters
    ----------
    statistics : FadingStatistics
        Of a time series.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        If the statistics are those of an ensemble.
    """
    if statistics.lag is None or statistics.autocorrelation is None:
        raise ValueError("statistics: of an ensemble, allowed those of a time series")
    ax = axes(ax)
    ax.plot(statistics.lag, statistics.autocorrelation)
    ax.axhline(np.exp(-1.0), color=INK, lw=0.8, ls="--")
    tau = statistics.coherence_time
    if tau is not None and np.isfinite(tau.value):
        shade = PALETTE["vermilion"]
        ax.axvspan(tau.low, tau.high, color=shade, alpha=0.15, lw=0)
        ax.axvline(tau.value, color=shade, label=f"coherence time {tau.value:.3g} s")
        ax.legend()
    ax.set(xlabel=axis_label("lag"), ylabel=axis_label("autocorrelation"))
    return ax


def plot_coverage(
    coverage: CoverageMap | xr.Dataset, *, decibel: bool = False, ax: Axes | None = None
) -> Axes:
    """Plot a coverage map, with its axes alike.

    Parameters
    ----------
    coverage : CoverageMap or xarray.Dataset
        The map, with x, y and gain.
    decibel : bool
        Show 10 log10 of the gain.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes
    """
    x, y, gain = (np.asarray(v) for v in (coverage.x, coverage.y, coverage.gain))
    ax, label = axes(ax), axis_label("gain")
    if decibel:
        with np.errstate(divide="ignore"):
            gain, label = 10.0 * np.log10(gain), f"{label} [dB]"
        gain = np.where(np.isfinite(gain), gain, np.nan)
    image = ax.pcolormesh(x, y, gain.T, shading="nearest", rasterized=True)
    ax.figure.colorbar(image, ax=ax, label=label)
    ax.set(aspect="equal", xlabel=axis_label("x"), ylabel=axis_label("y"))
    ax.grid(visible=False)
    return ax
