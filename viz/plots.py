"""Plots of results of any kind."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from meshtrace.comms.background import name_of_light
from meshtrace.errors import Described, Refused
from meshtrace.results.background import Background, BackgroundSeries
from meshtrace.results.gain import GainResult
from meshtrace.stored import Stored
from meshtrace.studies.comparison import Comparison
from meshtrace.studies.convergence.fading import FadingConvergence
from meshtrace.studies.duplex import Duplex
from meshtrace.studies.performance.tables import DepthSweep

from .checks import checked
from .plots_answers import plot_inference, plot_optimum, plot_tornado
from .plots_curves import plot_curves, plot_sweep
from .plots_gain import plot_autocorrelation, plot_coverage, plot_fates, plot_gain_series
from .plots_signal import plot_impulse_response
from .plots_study import plot_convergence, plot_performance
from .style import INK, PALETTE, axes, axis_label

_SHOWN = 1e-6  # of the largest bar, down to which bars are drawn


@checked
def plot(result: Stored | xr.Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot a result of any kind, or the dataset of a sweep.

    Parameters
    ----------
    result : result or xarray.Dataset
        As returned by a study, `meshtrace.results.load` or `sweep`.
    ax : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes

    Raises
    ------
    Refused
        If there is no plot of this kind.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import FlatSea
    >>> plot(mt.simulate(mt.Link(), FlatSea(), photons=64)).get_xlabel()
    'number of scatterings'
    """
    if isinstance(result, xr.Dataset):
        return plot_sweep(result, ax=ax)
    kind = getattr(result, "kind", None)
    if kind not in _PLOTS:
        raise Refused("result", Described(type(result).__name__), f"a {', '.join(_PLOTS)}")
    return _PLOTS[kind](result, ax=ax)


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
    width = 0.8 / len(ballistic)
    for i, (direct, orders) in enumerate(zip(ballistic, result.gain_order, strict=True)):
        gains = np.array([direct, *orders])
        place = np.arange(len(gains)) + (i - 0.5 * (len(ballistic) - 1)) * width
        ax.bar(place[gains > 0.0], gains[gains > 0.0], width, label=f"receiver {i}")
    if len(ballistic) > 1:
        ax.legend()
    ax.xaxis.get_major_locator().set_params(integer=True)
    ax.set(yscale="log", xlabel="number of scatterings", ylabel=axis_label("gain"))
    most = float(max(ballistic.max(), result.gain_order.max()))
    if most > 0.0:
        ax.set_ylim(_SHOWN * most, 2.0 * most)
    ax.grid(axis="x", visible=False)
    return ax


@checked
def plot_comparison(result: Comparison, *, ax: Axes | None = None) -> Axes:
    """Plot the gains of links over that of the first one [dB], with two standard errors.

    Parameters
    ----------
    result : Comparison
        Of `compare`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    ax = axes(ax)
    place = np.arange(len(result.names))
    ax.barh(place, result.ratio_db, color=PALETTE["sky"], height=0.6)
    ax.errorbar(
        result.ratio_db, place, xerr=2.0 * result.ratio_db_stderr, fmt="none", ecolor="k", capsize=3
    )
    ax.axvline(0.0, color="k", lw=0.8)
    ax.set(yticks=place, yticklabels=result.names, xlabel=f"gain over {result.names[0]} [dB]")
    ax.invert_yaxis()
    ax.grid(axis="y", visible=False)
    return ax


@checked
def plot_fading_convergence(study: FadingConvergence, *, ax: Axes | None = None) -> Axes:
    """Plot the scintillation index over the highest frequency of the waves.

    Parameters
    ----------
    study : FadingConvergence
        Of `fading_study`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    ax = axes(ax)
    ax.plot(study.omega_max, study.with_tilts, label="closed form, random slopes beyond")
    ax.plot(study.omega_max, study.band_alone, "--", label="closed form, nothing beyond")
    if np.isfinite(study.measured).any():
        errors = 2.0 * study.measured_stderr
        ax.errorbar(study.omega_max, study.measured, errors, fmt="o", capsize=3, label="measured")
    ax.axhline(study.all_waves, color=INK, lw=0.8, ls=":", label="all waves")
    ax.set(xscale="log", yscale="log", xlabel=r"highest frequency of the waves [rad s$^{-1}$]")
    ax.set_ylabel(axis_label("scintillation_index"))
    ax.legend()
    return ax


@checked
def plot_background(result: Background | BackgroundSeries, *, ax: Axes | None = None) -> Axes:
    """Plot the background radiance by its parts, as bars or over time.

    Parameters
    ----------
    result : Background or BackgroundSeries
        Of `background` or `background_series`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    ax, label = axes(ax), axis_label("background_radiance")
    if isinstance(result, BackgroundSeries):
        for name, radiance in result.parts.items():
            if radiance.any():
                ax.plot(result.time, radiance, label=name)
        ax.set(xlabel=axis_label("time"), ylabel=label, ylim=(0.0, None))
        ax.legend()
        return ax
    names = [name for name, radiance in result.parts.items() if radiance > 0.0]
    radiance = [result.parts[name] for name in names]
    errors = [2.0 * result.parts_stderr[name] for name in names]
    ax.bar(names, radiance, yerr=errors, color=PALETTE["sky"], ecolor=INK, capsize=3)
    ax.set(ylabel=label, title=result.light)
    ax.grid(axis="x", visible=False)
    return ax


@checked
def plot_duplex(result: Duplex, *, ax: Axes | None = None) -> Axes:
    """Plot the gains of both directions over their means, over time or realizations.

    Parameters
    ----------
    result : Duplex
        Of `duplex`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    ax = axes(ax)
    for name, series in (("up", result.up), ("down", result.down)):
        gain = series.gains[:, 0]
        x = series.time if series.along == "time" else np.arange(len(gain))
        ax.plot(x, gain / gain.mean(), label=name)
    along = axis_label("time") if result.up.along == "time" else "realization"
    ax.set(xlabel=along, ylabel="gain over its mean", ylim=(0.0, None))
    ax.legend()
    return ax


def _plot_winds(result: DepthSweep, *, ax: Axes | None = None) -> Axes:
    """Plot the bit error rate of the first bit rate over depth, one curve for each wind."""
    data = result.to_dataset().isel(bit_rate=0, drop=True).transpose("wind_speed", "depth")
    names = [f"{speed:g} m/s" for speed in result.wind_speeds]
    ax = plot_curves(data.assign_coords(wind_speed=names), "ber", style="o-", ax=ax)
    first = result.performances[0]
    light = name_of_light(first.light)
    ax.set(yscale="log", title=f"{first.bit_rates[0] / 1e6:g} Mbit/s, background light: {light}")
    return ax


_PLOTS: dict[str, Callable[..., Any]] = {
    "gain": plot_gain,
    "series": plot_gain_series,
    "coverage": plot_coverage,
    "impulse-response": plot_impulse_response,
    "fading": plot_autocorrelation,
    "performance": plot_performance,
    "depth-sweep": _plot_winds,
    "convergence": plot_convergence,
    "fading-convergence": plot_fading_convergence,
    "comparison": plot_comparison,
    "duplex": plot_duplex,
    "background": plot_background,
    "background-series": plot_background,
    "sensitivity": plot_tornado,
    "optimum": plot_optimum,
    "inference": plot_inference,
}
