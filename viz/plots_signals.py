"""Plots of signals and light by day: pulses, eye diagrams, background, irradiance."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from meshtrace.comms.pulses import Eye
from meshtrace.errors import Described, Refused
from meshtrace.models import Floats
from meshtrace.results.background import PARTS, Background, BackgroundSeries
from meshtrace.results.impulse import ImpulseResponse
from meshtrace.results.irradiance import IrradianceSeries

from . import marks
from .style import PALETTE, verbatim

_LARGEST_ERROR = 0.4  # of a bin of an impulse response that is drawn, over its value


def plot_impulse_response(
    responses: ImpulseResponse | Mapping[str, ImpulseResponse],
    *,
    decades: float = 5.0,
    ax: Axes | None = None,
) -> Axes:
    """Plot impulse responses, logarithmic, with bands of two standard errors.

    A response ends at the first bin after its peak with a standard error beyond 40 % of its value,
    that of a few photons.

    Parameters
    ----------
    responses : ImpulseResponse or mapping of str to these
        The responses.
    decades : float
        Range of the ordinate below the highest value; lower values are cut off.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    named = responses if isinstance(responses, Mapping) else {"": responses}
    top = max((float(np.max(response.h, initial=0.0)) for response in named.values()), default=0.0)
    if not 0.0 < top < np.inf:
        raise Refused("responses", Described("no light"), "responses with light")
    if not 0.0 < decades < 300.0:
        raise Refused("decades", decades, "0 < decades < 300")
    ax, last = marks.axes(ax), 0.0
    floor = top * 10.0**-decades
    for name, response in named.items():
        edges, h, error = marks.scaled("delay", response.edges)[0], response.h, response.h_stderr
        known = (error <= _LARGEST_ERROR * h) & (h > 0.0)
        later = np.arange(len(h)) > np.argmax(h)
        known &= np.cumsum(later & ~known) == 0
        shown = np.where(known, np.maximum(h, floor), np.nan)
        spread = f"rms delay spread {1e9 * response.rms_delay_spread:.3g} ns"
        label = f"{name}, {spread}" if name else spread
        marks.density(ax, edges, shown, error, floor, label)
        last = max(last, float(np.max(edges[1:][known & (h > floor)], initial=0.0)))
    if not last > 0.0:
        raise Refused("responses", Described("single photons alone"), "responses with more light")
    marks.note(ax, "band: ± 2 standard errors")
    limits: Any = {"xlim": (0.0, last), "ylim": (floor, 2.0 * top)}
    label = marks.scaled("delay", 0.0)[1]
    return marks.finished(ax, y="impulse_response", xlabel=label, yscale="log", **limits)


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
    data = result.to_dataset().assign_coords(part=list(PARTS)).transpose("part", ...)
    data = data.isel(part=[np.any(radiance) for radiance in result.parts.values()])
    if isinstance(result, BackgroundSeries):
        return marks.finished(marks.lines(marks.axes(ax), data, "part_radiance"), ylim=(0.0, None))
    ax = marks.bars(marks.axes(ax), data, "part_radiance")
    ax.set_title(verbatim(result.light), loc="left")
    return marks.finished(ax, y="background_radiance")


def plot_irradiance(series: IrradianceSeries, *, ax: Axes | None = None) -> Axes:
    """Plot the irradiance under a moving sea over time, a line for each depth.

    Parameters
    ----------
    series : IrradianceSeries
        Of `irradiance_series`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    data = series.to_dataset()[["spectral_irradiance"]].transpose("depth", "time")
    return marks.finished(
        marks.lines(marks.axes(ax), data, "spectral_irradiance"), ylim=(0.0, None)
    )


def plot_eye(eye: Eye, *, ax: Axes | None = None) -> Axes:
    """Plot an eye diagram over two bits: mean signal of each bit pattern, standard deviation.

    Parameters
    ----------
    eye : Eye
        Of `OokLink.eye`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    if not eye.level.size or not np.isfinite(eye.level).all():
        raise Refused("eye", Described("no levels, or nan"), "an eye of OokLink.eye")
    ax, time = marks.axes(ax), marks.scaled("delay", eye.time)[0]
    floor = eye.level.min()
    for bit, shade, name in ((True, "vermilion", "one"), (False, "blue", "zero")):
        chosen = np.flatnonzero(eye.bits[:, 0] == bit)
        level, std = (eye.level[chosen] - floor) / eye.swing, eye.std[chosen] / eye.swing
        color = PALETTE[shade]
        for start in (0.0, time[-1]):  # every pattern may follow in the second bit
            ax.plot(start + time, level.T, color=color, lw=0.8, alpha=0.6)
            ax.add_patch(_cover(start + time, level - std, level + std, color))
        ax.plot([], [], color=color, label=name)
    ax.margins(y=0.12)
    ax.legend(loc="upper left", ncols=2)
    marks.note(ax, "band: ± 1 standard deviation")
    title = f"opening {eye.opening:.2f}, Q = {eye.q_factor:.2f}"
    labels = {"xlabel": "time [ns], two bits", "ylabel": "signal over its swing"}
    return marks.finished(ax, legend=False, title=title, **labels)


def _cover(x: Floats, low: Floats, high: Floats, color: str) -> PathPatch:
    """Return the area covered by the bands of many curves (curves, n), in one tone."""
    there, back = np.broadcast_to(x, low.shape), np.broadcast_to(x[::-1], low.shape)
    around = np.stack([np.hstack([there, back]), np.hstack([low, high[:, ::-1]])], axis=-1)
    closed = np.concatenate([around, around[:, :1]], axis=1)
    outline = Path.make_compound_path(*(Path(loop, closed=True) for loop in closed))
    return PathPatch(outline, color=color, alpha=0.22, lw=0)
