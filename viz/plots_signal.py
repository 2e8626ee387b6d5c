"""Plots of signals: impulse responses, background light and eye diagrams."""

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
from meshtrace.results.background import Background, BackgroundSeries
from meshtrace.results.impulse import ImpulseResponse

from .checks import checked
from .style import INK, PALETTE, axes, axis_label, finished, note, verbatim

LARGEST_ERROR = 0.4
"""Relative standard error of an impulse response, beyond which a bin is not drawn."""


@checked
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
    ax, last = axes(ax), 0.0
    floor = top * 10.0**-decades
    for name, response in named.items():
        spread = f"rms delay spread {1e9 * response.rms_delay_spread:.3g} ns"
        edges = 1e9 * response.edges
        h, error = response.h, response.h_stderr
        known = (error <= LARGEST_ERROR * h) & (h > 0.0)
        later = np.arange(len(h)) > np.argmax(h)
        known &= np.cumsum(later & ~known) == 0
        high, low = (np.where(known, np.maximum(h + s * error, floor), np.nan) for s in (2.0, -2.0))
        steps = ax.stairs(np.where(known, np.maximum(h, floor), np.nan), edges, lw=1.5)
        steps.set_label(f"{name}, {spread}" if name else spread)
        band: Any = {"color": steps.get_edgecolor(), "alpha": 0.25, "lw": 0}
        ax.stairs(high, edges, baseline=low, fill=True, **band)
        last = max(last, float(np.max(edges[1:][known & (h > floor)], initial=0.0)))
    if not last > 0.0:
        raise Refused("responses", Described("single photons alone"), "responses with more light")
    note(ax, "band: ± 2 standard errors")
    ax.set(yscale="log", xlim=(0.0, last), ylim=(floor, 2.0 * top))
    delay = r"delay after the first light $\tau$ [ns]"
    return finished(ax, xlabel=delay, ylabel=axis_label("impulse_response"))


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
        return finished(ax, xlabel=axis_label("time"), ylabel=label, ylim=(0.0, None))
    names = [name for name, radiance in result.parts.items() if radiance > 0.0]
    heights = [result.parts[name] for name in names]
    errors = [2.0 * result.parts_stderr[name] for name in names]
    ax.bar(names, heights, yerr=errors, color=PALETTE["sky"], ecolor=INK, capsize=3)
    return finished(ax, legend=False, no_grid="x", ylabel=label, title=verbatim(result.light))


@checked
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
    ax, time = axes(ax), 1e9 * eye.time
    floor = eye.level.min()
    for bit, shade, name in ((True, "vermilion", "one"), (False, "blue", "zero")):
        chosen = np.flatnonzero(eye.bits[:, 0] == bit)
        level = (eye.level[chosen] - floor) / eye.swing
        std = eye.std[chosen] / eye.swing
        for start in (0.0, time[-1]):  # every pattern may follow in the second bit
            ax.plot(start + time, level.T, color=PALETTE[shade], lw=0.8, alpha=0.6)
            ax.add_patch(_band(start + time, level - std, level + std, PALETTE[shade]))
        ax.plot([], [], color=PALETTE[shade], label=name)
    ax.margins(y=0.12)
    ax.legend(loc="upper left", ncols=2)
    note(ax, "band: ± 1 standard deviation")
    title = f"opening {eye.opening:.2f}, Q = {eye.q_factor:.2f}"
    label = "signal over its swing"
    return finished(ax, legend=False, title=title, xlabel="time [ns], two bits", ylabel=label)


def _band(x: Floats, low: Floats, high: Floats, color: str) -> PathPatch:
    """Return the area covered by many curves (curves, n), in one tone."""
    there, back = np.broadcast_to(x, low.shape), np.broadcast_to(x[::-1], low.shape)
    around = np.stack([np.hstack([there, back]), np.hstack([low, high[:, ::-1]])], axis=-1)
    closed = np.concatenate([around, around[:, :1]], axis=1)
    outline = Path.make_compound_path(*(Path(loop, closed=True) for loop in closed))
    return PathPatch(outline, color=color, alpha=0.22, lw=0)
