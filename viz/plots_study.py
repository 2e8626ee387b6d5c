"""Plots of studies: comparisons, convergence, performance, sensitivities, optima, inferences."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator

from meshtrace.comms.background import name_of_light
from meshtrace.studies.comparison import Comparison, Duplex
from meshtrace.studies.convergence.fading import FadingConvergence
from meshtrace.studies.convergence.study import ConvergenceStudy
from meshtrace.studies.inference.study import Inference
from meshtrace.studies.optimisation.study import Optimum
from meshtrace.studies.performance.tables import DepthSweep, LinkPerformance
from meshtrace.studies.sensitivity.result import Sensitivities
from meshtrace.studies.sensitivity.study import swings

from .checks import checked
from .plots_curves import error_rates, plot_curves, positive
from .style import INK, PALETTE, axes, axis_label, finished, label_of, note, verbatim

_STEPS = {
    "spacing": "mesh spacing [m]",
    "time_step": "time step [s]",
    "omega_max": axis_label("omega_max"),
}

_COSTS = {
    "gain": "minus logarithm of the mean gain",
    "outage": "quantile of ln(needed gain / gain)",
    "range": "minus range [m]",
    "margin": "minus logarithm of the margin",
    "custom": "cost",
}
"""What each objective of an optimisation minimises."""


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
    ax.set_yticks(place, [verbatim(name) for name in result.names])
    ax.invert_yaxis()
    label = f"gain over {verbatim(result.names[0])} [dB]"
    return finished(ax, legend=False, no_grid="y", xlabel=label)


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
    return finished(ax, xlabel=along, ylabel="gain over its mean", ylim=(0.0, None))


@checked
def plot_convergence(study: ConvergenceStudy, *, ax: Axes | None = None) -> Axes:
    """Plot errors of the gain over the step of a study, with the fitted law.

    Parameters
    ----------
    study : ConvergenceStudy
        Of `convergence_study`, `time_step_study` or `band_limit_study`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    ax = axes(ax)
    for k, kind in enumerate(study.normals):
        fit, percent = study.fits[kind], 100.0 / study.gain[k, -1]
        target = fit.gain.value if study.reference is None else study.anchor[k]
        mean = percent * np.abs(study.gain[k] - target)
        errors = percent * study.difference_stderr[k]
        name = f"{kind} normals, mean: order {fit.order.value:.2f}"
        marks = ax.errorbar(study.values, mean, errors, fmt="o", capsize=2, label=name)
        color = marks[0].get_color()
        law = percent * np.abs(fit.coefficient * study.step**fit.order.value)
        ax.plot(study.values, law, color=color, lw=1.0)
        if np.isfinite(study.scatter[k]).any():
            one = np.where(study.scatter[k] > 0.0, percent * study.scatter[k], np.nan)
            ax.plot(study.values, one, "^--", color=color, lw=0.8, label=f"{kind} normals, scatter")
    ax.axhline(100.0 * study.tolerance, color="0.5", lw=0.8, ls=":", label="tolerance")
    ax.set(xscale="log", yscale="log", xlabel=_STEPS[study.parameter])
    ax.set_xticks(study.values, [f"{value:g}" for value in study.values])
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.minorticks_off()
    return finished(ax, ylabel="error of the gain [%]")


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
    ax.set(xscale="log", yscale="log", xlabel=axis_label("omega_max"))
    ax.set_xticks(study.omega_max, [f"{value:g}" for value in study.omega_max])
    ax.minorticks_off()
    return finished(ax, ylabel=axis_label("scintillation_index"))


@checked
def plot_performance(
    performance: LinkPerformance, *, quantity: str = "ber", ax: Axes | None = None
) -> Axes:
    """Plot a quantity of a link over depth with its confidence band, one curve for each bit rate.

    A link of one depth is drawn over the bit rates.

    Parameters
    ----------
    performance : LinkPerformance
        Of `link_performance`.
    quantity : str
        "ber", "outage", "received_power", "gain" or another estimate of it.
    ax : matplotlib Axes, optional
        Axes to draw on. The light is written above, the status of the
        calibration below.

    Returns
    -------
    Axes
    """
    data = _by_rate(performance.to_dataset().transpose("bit_rate", "depth"))
    shown = positive(data, quantity)
    ax = finished(plot_curves(shown, quantity, style="o-", ax=ax), legend=False, yscale="log")
    if quantity == "ber":
        error_rates(ax, data, performance.limit)
    if len(performance.depths) == 1:
        ax.set_title(f"depth {performance.depths[0]:g} m", loc="left")
    if f"{quantity}_low" in shown:
        seas = performance.provenance["realizations"]
        light = verbatim(name_of_light(performance.light))
        band = f"n = {seas} seas, band: {100.0 * performance.confidence:g} %"
        note(ax, f"{band}, background light: {light}")
    below = performance.status, (0.0, -0.17)
    ax.annotate(*below, xycoords="axes fraction", fontsize=7.5, va="top", wrap=True)
    return ax


def plot_winds(result: DepthSweep, *, ax: Axes | None = None) -> Axes:
    """Plot the bit error rate over depth, one curve for each wind, of the first bit rate.

    At one depth it is drawn over wind, one curve for each bit rate.
    """
    data, first = result.to_dataset(), result.performances[0]
    title = f"background light: {verbatim(name_of_light(first.light))}"
    if len(first.depths) == 1:
        data = _by_rate(data.isel(depth=0, drop=True).transpose("bit_rate", "wind_speed"))
        title = f"depth {first.depths[0]:g} m, {title}"
    else:
        data = data.isel(bit_rate=0, drop=True).transpose("wind_speed", "depth")
        data = data.assign_coords(wind_speed=[f"{u:g} m/s" for u in result.wind_speeds])
        title = f"{first.bit_rates[0] / 1e6:g} Mbit/s, {title}"
    ax = plot_curves(positive(data, "ber"), "ber", style="o-", ax=ax)
    ax.set_title(title)
    return error_rates(ax, data, first.limit)


def _by_rate(data: xr.Dataset) -> xr.Dataset:
    """Return a dataset with curves named by bit rate, or over the bit rate at a single depth."""
    if data.sizes.get("depth") == 1:
        return data.isel(depth=0, drop=True)
    return data.assign_coords(bit_rate=[f"{r / 1e6:g} Mbit/s" for r in data["bit_rate"].values])


@checked
def plot_tornado(
    s: Sensitivities,
    *,
    change: float | Mapping[str, tuple[float, float]] = 0.1,
    ax: Axes | None = None,
) -> Axes:
    """Plot the change of a quantity with each parameter at a lower and a higher value.

    Parameters
    ----------
    s : Sensitivities
        Of `sensitivities`; each end of a bar is a run with the chains of the study.
    change : float or mapping of str to (low, high)
        Relative change to either side, or the values of some parameters, see
        `studies.swings`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
        Bars in dB, in m for the range, the largest on top; standard errors as whiskers.
    """
    ax = axes(ax)
    found = swings(s, change)
    place = np.arange(len(found))
    for side, (label, color) in enumerate((("lower", "C0"), ("higher", "C1"))):
        values = [one.change[side] for one in found]
        errors = [one.stderr[side] for one in found]
        ax.barh(place, values, 0.7, xerr=errors, color=color, label=label,
                error_kw={"elinewidth": 0.8, "capsize": 2, "ecolor": INK})  # fmt: skip
    names = [f"{one.name}\n{one.values[0]:.4g} to {one.values[1]:.4g} {one.unit}" for one in found]
    ax.set_yticks(place, [name.removesuffix(" 1") for name in names], fontsize=8)
    ax.invert_yaxis()
    ax.axvline(0.0, color=INK, lw=0.8)
    form = ".2e" if s.of == "gain" else ".3g"
    base = f"{s.value:{form}} {s.unit}".removesuffix(" 1")
    label = f"change of the {s.of} from {base} [{'m' if s.of == 'range' else 'dB'}]"
    return finished(ax, no_grid="y", xlabel=label)


@checked
def plot_optimum(o: Optimum, *, ax: Axes | None = None) -> Axes:
    """Plot the cost of all candidates over the first variable, with the best one.

    Parameters
    ----------
    o : Optimum
        Of `optimize`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    ax = axes(ax)
    ax.plot(o.history[:, 0], o.history[:, -1], "o", ms=4, label="candidates")
    ax.plot(o.values[0], o.cost, "*", ms=12, color="C1", label="best")
    ax.axvspan(*o.flatness[0], color="C1", alpha=0.15, label="within one standard error")
    return finished(ax, xlabel=label_of(o.variables[0]), ylabel=_COSTS[o.objective])


@checked
def plot_inference(f: Inference, *, ax: Axes | None = None) -> Axes:
    """Plot measured over fitted gains.

    Parameters
    ----------
    f : Inference
        Of `infer`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    ax = axes(ax)
    ax.plot(np.arange(1, len(f.measured) + 1), f.measured / f.predicted, "o")
    ax.axhline(1.0, color=INK, lw=0.8)
    return finished(ax, legend=False, xlabel="measurement", ylabel="measured over fitted")
