"""Plots of gains: over time, over many seas, over a plane, and the fates of the light."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from scipy.ndimage import gaussian_filter

from meshtrace import fading
from meshtrace.errors import Described, Refused
from meshtrace.link import Link
from meshtrace.models import Floats
from meshtrace.results.coverage import CoverageMap, as_high, place_of_highest
from meshtrace.results.gain import FATE_MEANING, Fate, GainResult
from meshtrace.results.series import GainSeries
from meshtrace.uav import Route

from .checks import checked
from .plots_curves import plot_curves
from .style import INK, LED_COLOR, PALETTE, axes, axis_label, draw_map, finished, note

_SHOWN = 1e-6  # of the largest bar, down to which bars are drawn
_FITS = {"lognormal": fading.fit_lognormal, "gamma-gamma": fading.fit_gamma_gamma}


@checked
def plot_gain(result: GainResult, *, ax: Axes | None = None) -> Axes:
    """Plot the fates of analog light, or the gain of forced detection by order of scattering.

    Parameters
    ----------
    result : GainResult
        Gain of one link.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    if result.gain_order is None:
        return plot_fates(result, ax=ax)
    ax = axes(ax)
    ballistic = np.atleast_1d(0.0 if result.gain_ballistic is None else result.gain_ballistic)
    most, last = float(max(ballistic.max(), result.gain_order.max())), 0
    width = 0.8 / len(ballistic)
    for i, (direct, orders) in enumerate(zip(ballistic, result.gain_order, strict=True)):
        gains = np.array([direct, *orders])
        place = np.arange(len(gains)) + (i - 0.5 * (len(ballistic) - 1)) * width
        ax.bar(place[gains > 0.0], gains[gains > 0.0], width, label=f"receiver {i}")
        last = max(last, *np.flatnonzero(gains > _SHOWN * most), 0)
    locator: Any = ax.xaxis.get_major_locator()
    locator.set_params(integer=True)
    ax.set(yscale="log", xlabel="number of scatterings", ylabel=axis_label("gain"))
    ax.set_xlim(-0.6, last + 0.6)
    if most > 0.0:
        ax.set_ylim(_SHOWN * most, 2.0 * most)
    return finished(ax, legend=len(ballistic) > 1, no_grid="x")


@checked
def plot_fates(result: GainResult, *, ax: Axes | None = None) -> Axes:
    """Plot the fates of the light: share of the launched weight, logarithmic.

    Parameters
    ----------
    result : GainResult
        Result of the analog estimator.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes

    Raises
    ------
    Refused
        If the result has no fates.
    """
    shares = {name: tally.weight for name, tally in result.fates.items() if tally.weight > 0.0}
    if not shares:
        raise Refused("result", Described("no fates"), 'a result of estimator="analog"')
    ax = axes(ax)
    meanings = [FATE_MEANING[Fate[name.upper()]] for name in shares]
    bars = ax.barh(meanings, list(shares.values()), color=PALETTE["blue"])
    ax.bar_label(bars, [f"{v:.2g}" for v in shares.values()], padding=3, fontsize=9)
    decades = 10.0 ** np.arange(np.floor(np.log10(min(shares.values()))), 1.0)
    ax.set(xscale="log", xlabel="share of the emitted light", xticks=decades)
    ax.invert_yaxis()
    # room for the numbers beside the bars
    return finished(ax, legend=False, no_grid="y", xlim=(decades[0], 10.0))


@checked
def plot_gain_series(series: GainSeries | xr.Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot the gain over time, or of each realization, with two standard errors.

    Parameters
    ----------
    series : GainSeries or xarray.Dataset
        A series, or a dataset with `gain` and `gain_stderr` over "time" or "realization" and,
        in the second place, receivers.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    data = _dataset(series, "gain", "gain_stderr")[["gain", "gain_stderr"]]
    along, *others = data["gain"].dims
    if along == "realization":  # seeds
        data = data.assign_coords(realization=np.arange(data.sizes[along]))
    for receiver in others[:1]:
        names = [f"receiver {i}" for i in range(data.sizes[receiver])]
        data = data.transpose(receiver, along).assign_coords({receiver: names})
    return plot_curves(data, "gain", style="o" if along == "realization" else "-", ax=ax)


def plot_series(series: GainSeries, *, ax: Axes | None = None) -> Axes:
    """Plot a series over time, and the density of the gains of an ensemble of one receiver."""
    if series.along == "time" or series.gain.ndim > 1:
        return plot_gain_series(series, ax=ax)
    try:
        return plot_gain_pdf(series, ax=ax)
    except Refused:  # too few seas for a law, or dark ones
        return plot_gain_series(series, ax=ax)


@checked
def plot_route(series: GainSeries, *, ax: Axes | None = None) -> Axes:
    """Plot the gain along the route of a receiver, from above.

    Parameters
    ----------
    series : GainSeries
        Of `time_series` with a route.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes

    Raises
    ------
    Refused
        If the receiver of the series does not move.
    """
    origin = getattr(series, "provenance", {})
    if "route" not in origin:
        raise Refused("series", Described("no route"), "a time series along a route")
    ax, route = axes(ax), Route.model_validate(origin["route"])
    x, y = route.at(series.time, 1.0).position.T
    ax.plot(*np.transpose(route.positions), color=INK, lw=0.8, zorder=1)
    points = ax.scatter(x, y, c=series.gains[:, 0], s=24, zorder=2)
    side = "bottom" if np.ptp(x) > 1.5 * np.ptp(y) else "right"
    ax.figure.colorbar(points, ax=ax, label=axis_label("gain"), location=side)
    link = Link.model_validate(origin["link"])
    places = np.transpose([source.position for source in link.transmitters])
    ax.plot(*places, "*", color=LED_COLOR, mec=INK, ms=12, zorder=1.5, label="source")
    return finished(ax, aspect="equal", xlabel=axis_label("x"), ylabel=axis_label("y"))


@checked
def plot_gain_pdf(
    series: GainSeries | xr.Dataset,
    *,
    fits: Sequence[str] = ("lognormal", "gamma-gamma"),
    bins: int | str = "auto",
    ax: Axes | None = None,
) -> Axes:
    """Plot the density of the gain with its standard errors, and fitted fading laws.

    Parameters
    ----------
    series : GainSeries or xarray.Dataset
        With `gain` and `gain_stderr` of one receiver; the noise is removed from the variance.
    fits : sequence of str
        Laws to fit: "lognormal", "gamma-gamma".
    bins : int or str
        Number of bins or a rule of `numpy.histogram_bin_edges`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes

    Raises
    ------
    Refused
        If a law is unknown or the gains cannot be fitted.
    """
    gain, laws = _fitted(series, fits)
    histogram = fading.gain_pdf(*gain, bins=bins)
    ax, edges, density = axes(ax), histogram.edges, histogram.density
    middle = 0.5 * (edges[1:] + edges[:-1])
    ax.stairs(density, edges, fill=True, color=PALETTE["sky"], alpha=0.45)
    ax.errorbar(middle, density, histogram.density_stderr, fmt="none", ecolor=INK, lw=0.9)
    x = np.linspace(edges[0], edges[-1], 400)
    x = x[x > 0.0]
    for name, fit in laws.items():
        ax.plot(x, fit.law.pdf(x), label=f"{name}, index {fit.scintillation_index:.3g}")
    note(ax, f"n = {np.size(gain[0])}, bars: ± 1 standard error")
    return finished(ax, xlabel=axis_label("gain"), ylabel=axis_label("gain_pdf"))


@checked
def plot_gain_cdf(
    series: GainSeries | xr.Dataset,
    *,
    fits: Sequence[str] = ("lognormal", "gamma-gamma"),
    n_effective: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot the distribution function of the gain, logarithmic, with a 95 % band and fitted laws.

    Parameters
    ----------
    series, fits, ax
        As in `plot_gain_pdf`.
    n_effective : float, optional
        Independent samples, for the band; see `fading.effective_samples`.

    Returns
    -------
    Axes

    Raises
    ------
    Refused
        If a law is unknown or the gains cannot be fitted.
    """
    gain, laws = _fitted(series, fits)
    found = fading.gain_cdf(*gain, n_effective=n_effective)
    ax = axes(ax)
    ax.step(found.gain, found.probability, where="post", color=INK, label="simulated")
    ax.fill_between(found.gain, found.low, found.high, step="post", color=INK, alpha=0.15, lw=0)
    x = np.linspace(found.gain[0], found.gain[-1], 400)
    for dashes, (name, fit) in zip(("-", "--"), laws.items(), strict=False):
        ax.plot(x, fit.law.cdf(x), dashes, label=name)
    note(ax, f"n = {len(found.gain)}, band: 95 %")
    ax.set(yscale="log", xlabel=axis_label("gain"), ylabel=axis_label("gain_cdf"))
    return finished(ax, ylim=(0.5 / len(found.gain), 1.3))


def _fitted(
    series: GainSeries | xr.Dataset, names: Sequence[str]
) -> tuple[tuple[Floats, Floats], dict[str, fading.DistributionFit]]:
    """Return gains with their standard errors, and the laws fitted to them."""
    for name in names:
        if name not in _FITS:
            raise Refused("fits", name, ", ".join(_FITS))
    data = _dataset(series, "gain", "gain_stderr")
    gain = data["gain"].to_numpy(), data["gain_stderr"].to_numpy()
    clean = fading.remove_noise(*gain)
    return gain, {name: _FITS[name](clean) for name in names}


def _dataset(result: GainSeries | CoverageMap | xr.Dataset, *names: str) -> xr.Dataset:
    """Return a result as a dataset with the named variables, each of one dimension or more."""
    data = result if isinstance(result, xr.Dataset) else result.to_dataset()
    for name in names:
        if name not in data or not data[name].ndim or data[name].dtype.kind not in "biuf":
            found = data[name].dims if name in data else None
            raise Refused(name, found, f"numbers {', '.join(names)} over one dimension or more")
    return data


@checked
def plot_autocorrelation(statistics: fading.FadingStatistics, *, ax: Axes | None = None) -> Axes:
    """Plot the autocorrelation of the gain with the coherence time at 1/e.

    Parameters
    ----------
    statistics : FadingStatistics
        Of a time series.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes

    Raises
    ------
    Refused
        If the statistics are those of an ensemble.
    """
    if statistics.lag is None or statistics.autocorrelation is None:
        raise Refused("statistics", Described("of an ensemble"), "those of a time series")
    ax = axes(ax)
    ax.plot(statistics.lag, statistics.autocorrelation)
    ax.axhline(np.exp(-1.0), color=INK, lw=0.8, ls="--")
    tau = statistics.coherence_time
    if tau is not None and np.isfinite(tau.value):
        shade = PALETTE["vermilion"]
        step = float(statistics.lag[1] - statistics.lag[0])
        finer = tau.value > step  # shorter ones are an interpolation between two samples
        label = f"coherence time {tau.value:.3g} s" if finer else f"coherence time < {step:.3g} s"
        ax.axvspan(tau.low, tau.high, color=shade, alpha=0.15, lw=0)
        ax.axvline(tau.value, color=shade, label=label)
        note(ax, f"samples every {step:.3g} s, band: interval of the coherence time")
    return finished(ax, xlabel=axis_label("lag"), ylabel=axis_label("autocorrelation"))


@checked
def plot_coverage(
    coverage: CoverageMap | xr.Dataset, *, decibel: bool = False, ax: Axes | None = None
) -> Axes:
    """Plot a coverage map with equal axes, contours, and the place of the highest gain.

    Contours are those of the map smoothed by a cell. The place is marked where errors resolve it,
    see `results.coverage.place_of_highest`.

    Parameters
    ----------
    coverage : CoverageMap or xarray.Dataset
        The map, with x, y and gain, and `gain_stderr` for the place of the highest gain.
    decibel : bool
        Show 10 log10 of the gain.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    data = _dataset(coverage, "x", "y", "gain")
    x, y, gain = (data[name].to_numpy() for name in ("x", "y", "gain"))
    if gain.shape != (*x.shape, *y.shape) or not gain.size:
        raise Refused("gain", Described(f"shape {gain.shape}"), "values over x and y")
    stderr = (
        data["gain_stderr"].to_numpy() if "gain_stderr" in data else np.full(gain.shape, np.inf)
    )
    place, level = place_of_highest(gain, stderr), as_high(gain, stderr).sum()
    ax, label = axes(ax), axis_label("gain")
    smooth = gaussian_filter(gain, 1.0, mode="nearest")
    if decibel:
        with np.errstate(divide="ignore"):
            gain, label = 10.0 * np.log10(gain), f"{label} [dB]"
        gain = np.where(np.isfinite(gain), gain, np.nan)
    draw_map(ax, x, y, gain, label)
    if min(gain.shape) > 2 and smooth.max() > smooth.min():
        _contours(ax, x, y, smooth)
    if place is not None:
        at = x[place[0]], y[place[1]]
        ax.plot(*at, "*", color=LED_COLOR, mec=INK, ms=11, clip_on=False)
        note(ax, f"star: highest gain, at x = {at[0]:.3g} m, y = {at[1]:.3g} m")
    elif np.isfinite(stderr).all() and smooth.max() > 0.0:
        note(ax, f"highest gain: {level} cells within errors")
    return ax


def _contours(ax: Axes, x: Floats, y: Floats, gain: Floats) -> None:
    """Draw contours at 3, 6, 10 and 20 dB below the highest gain."""
    below = np.array([-20.0, -10.0, -6.0, -3.0])
    level = 10.0 * np.log10(np.maximum(gain / gain.max(), 1e-12))
    lines = ax.contour(x, y, level.T, below, colors="white", linewidths=1.0, linestyles="-")
    ax.clabel(lines, fmt=lambda v: f"{v:g} dB", fontsize=8)
