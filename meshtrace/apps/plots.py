"""Plots of traces, channel models, designs, optima, inferences and measured comparisons."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes

from meshtrace.checks import check_call
from meshtrace.errors import Described, Refused
from meshtrace.models import Floats
from meshtrace.studies.neighbours import DECIBELS
from meshtrace.viz import marks
from meshtrace.viz.style import INK, PALETTE, label_of, verbatim

from .channels import ChannelModel
from .designs.page import Design, Period
from .inference import Inference
from .lidar import ECHOES, LidarResult
from .measured.suite import MeasuredTable
from .optimisation import Optimum
from .traces import ChannelTrace

_MERITS: dict[str, tuple[Callable[[Floats], Floats], str]] = {
    "gain": (lambda cost: -DECIBELS * cost, "mean gain [dB]"),
    "outage": (lambda cost: -DECIBELS * cost, "gain over that needed, at the quantile [dB]"),
    "range": (lambda cost: -cost, "range [m]"),
    "margin": (lambda cost: -DECIBELS * cost, "margin [dB]"),
    "capacity": (lambda cost: 1e-6 * np.exp(-cost), "capacity [Mbit/s]"),
    "custom": (lambda cost: cost, "cost"),
}
"""Quantity of each objective by the cost that an optimisation minimises, and its label."""


@check_call
def plot_channel(model: ChannelModel, *, ax: Axes | None = None) -> Axes:
    """Plot the autocorrelation of a channel model and of its fitted series.

    Parameters
    ----------
    model : ChannelModel
        Of `MarkovChannel.fit` or `TransformedGaussian.fit`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
        With two standard errors of the autocorrelation of the series.
    """
    error, name = model.autocorrelation_stderr, "autocorrelation"
    curves = {
        name: [model.autocorrelation, model.model_autocorrelation],
        f"{name}_stderr": [error, 0.0 * error],
    }
    data = marks.dataset(curves, {"curve": ["series", "model"], "lag": model.lag})
    return marks.finished(marks.lines(ax, data, name))


@check_call
def plot_trace(result: ChannelTrace, *, ax: Axes | None = None) -> Axes:
    """Plot the gains of a channel trace and its background over their means.

    Parameters
    ----------
    result : ChannelTrace
        Of `channel_trace`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    links = {"up": result.gain, "down": result.down_gain}
    gains = {name: row.reshape(len(row), -1) for name, row in links.items() if row is not None}
    relative = [row[:, 0] / row[:, 0].mean() for row in gains.values()]
    data = marks.dataset({"over its mean": relative}, {"part": list(gains), "time": result.time})
    ax = marks.lines(ax, data, "over its mean", ("-", "--"))
    times, radiance = result.background_time, result.background_radiance
    if times is not None and radiance is not None:
        color = list(PALETTE.values())[2]
        ax.plot(
            times, radiance / radiance.mean(), "o", color=color, markersize=5.0, label="background"
        )
    return marks.finished(ax, ylim=(0.0, None))


@check_call
def plot_lidar(result: LidarResult, *, ax: Axes | None = None) -> Axes:
    """Plot the waveform of a lidar: echoes of surface, column and bottom over the depth.

    Parameters
    ----------
    result : LidarResult
        Of `lidar`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
        With the delay along x and the received share of the energy, by bin, on a logarithmic axis.
    """
    ax = marks.axes(ax)
    edges = 1e9 * result.delay_edges
    for name, energy, color in zip(ECHOES, result.echo, PALETTE.values(), strict=False):
        if energy.any():
            ax.stairs(np.where(energy > 0.0, energy, np.nan), edges, color=color, label=name)
    # five decades below the echo of the bottom: fainter bins are single photons
    least = 1e-5 * result.echo[2].max() or 1e-9 * result.echo.max()
    return marks.finished(
        ax,
        "delay after the echo of still water [ns]",
        "received share of the energy in a bin",
        yscale="log",
        ylim=(least, 2.0 * result.echo.max()),
    )


@check_call
def plot_optimum(o: Optimum, *, ax: Axes | None = None) -> Axes:
    """Plot the quantity of all candidates over the first variable, with the best one.

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
    ax = marks.axes(ax)
    merit, label = _MERITS[o.objective]
    ax.plot(o.history[:, 0], merit(o.history[:, -1]), "o", ms=4, label="candidates")
    shade = PALETTE["vermilion"]
    ax.plot(o.values[0], merit(np.array(o.cost)), "*", ms=12, color=shade, label="best")
    ax.axvspan(*o.flatness[0], color=shade, alpha=0.15, label="within one standard error")
    return marks.finished(ax, xlabel=label_of(o.variables[0]), ylabel=label)


@check_call
def plot_design(d: Design, *, period: Period = "day", ax: Axes | None = None) -> Axes:
    """Plot the reserve over each scanned key, relative to the values of the link.

    Parameters
    ----------
    d : Design
        Of `design`.
    period : {"night", "day"}
        Part of the day, with the background light that it has.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
        A curve for each key with the flat range drawn thick; above the line the link closes.
    """
    ax = marks.axes(ax)
    for choice, values, reserves in zip(d.choices, d.scanned, d.reserves, strict=True):
        if choice.period != period or choice.present == 0.0:
            continue
        shown = np.where(np.isfinite(reserves), reserves, np.nan)
        low, high = choice.flat
        flat = np.where((values >= low) & (values <= high), shown, np.nan)
        (line,) = ax.plot(values / choice.present, shown, label=label_of(choice.key))
        ax.plot(values / choice.present, flat, lw=4.0, color=line.get_color(), alpha=0.5)
    ax.axhline(0.0, color=INK, lw=0.8)
    ax.plot(1.0, d.at(period).reserve, "o", color=INK)
    marks.finished(
        ax, xscale="log", xlabel="value over that of the link", ylabel=f"reserve by {period} [dB]"
    )
    # up to seven curves have no free corner inside the axes
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return ax


@check_call
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
    coords, ax = {"measurement": np.arange(1, len(f.measured) + 1)}, marks.axes(ax)
    data = marks.dataset({"measured over fitted": f.measured / f.predicted}, coords)
    marks.lines(ax, data, "measured over fitted", ("o",), markersize=6)
    ax.axhline(1.0, color=INK, lw=0.8)
    return ax


@check_call
def plot_measured(table: MeasuredTable, *, ax: Axes | None = None) -> Axes:
    """Plot measured over computed values, with the bands of the computed ones.

    Parameters
    ----------
    table : MeasuredTable
        Of `apps.measured.run`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    # a predicted row has nothing to compare, and a ratio needs a value above 0
    finite = np.flatnonzero(np.isfinite(table.observed) & (table.computed > 0.0))
    several = len(set(table.experiment)) > 1
    names = [(table.experiment if several else table.observable)[i] for i in finite]
    if not names:
        raise Refused("table", Described("no measured numbers"), "a table with some")
    ax = marks.axes(ax)
    places, value = np.arange(len(finite)), table.computed[finite]
    ends = (table.band_low, table.band_high, table.observed_low, table.observed_high)
    low, high, least, most = (np.maximum(end[finite], 0.0) / value for end in ends)
    at = table.observed[finite] / value
    outside = np.array([table.verdict[i] == "outside" for i in finite])
    ax.hlines(places, low, high, color=PALETTE["blue"], alpha=0.3, lw=5.0, label="computed, band")
    for chosen, color, label in (
        (~outside, "black", "measured, inside"),
        (outside, PALETTE["vermilion"], "measured, outside"),
    ):
        if chosen.any():
            errors = np.maximum(np.abs([at - least, most - at])[:, chosen], 0.0)
            ax.errorbar(
                at[chosen], places[chosen], xerr=errors, color=color, fmt="o", lw=1.2, label=label
            )
    first = [names.index(name) for name in dict.fromkeys(names)]
    ax.set_yticks(first, [verbatim(names[i]) for i in first], fontsize="small")
    ax.axvline(1.0, color=INK, lw=0.8)
    ax.invert_yaxis()
    return marks.finished(ax, xlabel="measured over computed")
