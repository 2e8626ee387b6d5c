"""Plots of signals: impulse responses, eye diagrams, bit error ratios."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from numpy.typing import ArrayLike

from meshtrace.comms.pulses import Eye
from meshtrace.fields import FIELDS
from meshtrace.results.impulse import ImpulseResponse

from .curves import Curves, Floats, by_name, evaluated, label_of
from .style import INK, PALETTE, axes, axis_label

if TYPE_CHECKING:
    from meshtrace.studies.performance.tables import LinkPerformance

BER_SHOWN = (1e-9, 1.0)
"""Error ratios of the axis; curves run on to their last value that is not 0."""


def plot_impulse_response(
    responses: ImpulseResponse | Mapping[str, ImpulseResponse],
    *,
    decades: float = 5.0,
    ax: Axes | None = None,
) -> Axes:
    """Plot impulse responses, logarithmic, with bands of two standard errors.

    Parameters
    ----------
    responses : ImpulseResponse or mapping of str to these
        The responses.
    decades : float
        How far below the highest value the axes reach; what never comes that high is cut off.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes
    """
    named = responses if isinstance(responses, Mapping) else {"": responses}
    ax, last = axes(ax), 0.0
    top = max(float(response.h.max()) for response in named.values())
    floor = top * 10.0**-decades
    for name, response in named.items():
        spread = f"rms delay spread {1e9 * response.rms_delay_spread:.3g} ns"
        edges = 1e9 * response.edges
        high, low = (np.maximum(response.h + s * response.h_stderr, floor) for s in (2.0, -2.0))
        steps = ax.stairs(np.maximum(response.h, floor), edges, lw=1.5)
        steps.set_label(f"{name}, {spread}" if name else spread)
        band: Any = {"color": steps.get_edgecolor(), "alpha": 0.25, "lw": 0}
        ax.stairs(high, edges, baseline=low, fill=True, **band)
        last = max(last, float(edges[1:][response.h > floor].max()))
    ax.set(yscale="log", xlim=(0.0, last), ylim=(floor, 2.0 * top))
    ax.set(xlabel=r"delay after the first light $\tau$ [ns]", ylabel=axis_label("impulse_response"))
    ax.legend()
    return ax


def plot_eye(eye: Eye, *, ax: Axes | None = None) -> Axes:
    """Plot an eye diagram: the mean signal of each bit pattern and its standard deviation.

    Parameters
    ----------
    eye : Eye
        Of `OokLink.eye`.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes
    """
    ax, time = axes(ax), 1e9 * eye.time
    floor = eye.level.min()
    for bit, shade, name in ((True, "vermilion", "one"), (False, "blue", "zero")):
        chosen = np.flatnonzero(eye.bits[:, 0] == bit)
        level = (eye.level[chosen] - floor) / eye.swing
        std = eye.std[chosen] / eye.swing
        ax.plot(time, level.T, color=PALETTE[shade], lw=0.8, alpha=0.6)
        ax.add_patch(_band(time, level - std, level + std, PALETTE[shade]))
        ax.plot([], [], color=PALETTE[shade], label=name)
    ax.margins(y=0.12)
    ax.legend(loc="upper center", ncols=2)
    ax.set(xlabel="time within the bit [ns]", ylabel="signal over its swing")
    ax.set_title(f"opening {eye.opening:.2f}, Q = {eye.q_factor:.2f}")
    return ax


def _band(x: Floats, low: Floats, high: Floats, color: str) -> PathPatch:
    """Return what many curves (curves, n) cover together, in one tone where they overlap."""
    there, back = np.broadcast_to(x, low.shape), np.broadcast_to(x[::-1], low.shape)
    around = np.stack([np.hstack([there, back]), np.hstack([low, high[:, ::-1]])], axis=-1)
    closed = np.concatenate([around, around[:, :1]], axis=1)
    outline = Path.make_compound_path(*(Path(loop, closed=True) for loop in closed))
    return PathPatch(outline, color=color, alpha=0.22, lw=0)


def plot_ber(
    x: ArrayLike,
    curves: Curves,
    *,
    bands: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
    along: str = "received_power",
    ax: Axes | None = None,
) -> Axes:
    """Plot bit error ratios, logarithmic, over power, gain, depth or whatever else.

    Parameters
    ----------
    x : array_like
        Abscissa; a received power is shown in dBm.
    curves : function or array, or mapping of str to these
        Bit error ratios, such as `OokLink().ber`.
    bands : mapping of str to (low, high), optional
        Confidence limits of curves, by their names.
    along : str
        Name of the abscissa in `meshtrace.fields`, or a label of its own.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes
    """
    ax, at, label = axes(ax), np.asarray(x, dtype=float), label_of(along)
    shown = at
    if along == "received_power":
        shown, label = 10.0 * np.log10(at / 1e-3), f"{FIELDS[along].long_name} [dBm]"
    for name, curve in by_name(curves).items():
        (line,) = ax.plot(shown, _positive(evaluated(curve, at)), label=name or None)
        if name in (bands or {}):
            _draw_band(ax, shown, bands[name], line.get_color())
    if any(by_name(curves)):
        ax.legend()
    ax.axhline(1e-3, color=INK, lw=0.8, ls="--")
    ax.set(yscale="log", xlabel=label, ylabel=axis_label("ber"))
    ax.set_ylim(*BER_SHOWN)
    return ax


def plot_performance(
    performance: LinkPerformance, *, quantity: str = "ber", ax: Axes | None = None
) -> Axes:
    """Plot a figure of a link over depth with its confidence band, one curve for each bit rate.

    Parameters
    ----------
    performance : LinkPerformance
        Of `link_performance`.
    quantity : str
        "ber", "outage", "received_power", "gain" or another estimate of it.
    ax : matplotlib Axes, optional
        Where to draw. What the calibration is worth stands below.

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        If it was computed at one depth only.
    """
    if len(performance.depths) < 2:
        raise ValueError(f"performance: at {performance.depths} m, allowed two depths or more")
    ax, depth = axes(ax), np.array(performance.depths)
    curves = performance.estimates(quantity).transpose(1, 2, 0)
    for rate, (value, low, high) in zip(performance.bit_rates, curves, strict=True):
        shown = _positive(value)
        (line,) = ax.plot(depth, shown, "o-", markersize=4, label=f"{rate / 1e6:g} Mbit/s")
        _draw_band(ax, depth, (low, high), line.get_color())
    if quantity == "ber":
        ax.axhline(performance.limit, color=INK, lw=0.8, ls="--")
        ax.set_ylim(*BER_SHOWN)
    ax.set(yscale="log", xlabel=axis_label("depth"), ylabel=label_of(quantity))
    pad = 0.03 * np.ptp(depth)
    ax.set_xlim(depth.min() - pad, depth.max() + pad)
    ax.legend()
    ax.annotate(
        performance.status,
        (0.0, -0.17),
        xycoords="axes fraction",
        fontsize=7.5,
        va="top",
        wrap=True,
    )
    return ax


def _positive(values: ArrayLike) -> Floats:
    """Return values as a logarithmic axis takes them: 0 is not drawn."""
    found = np.asarray(values, dtype=float)
    return np.where(found > 0.0, found, np.nan)


def _draw_band(ax: Axes, x: Floats, limits: tuple[ArrayLike, ArrayLike], color: Any) -> None:
    """Shade between two limits; a lower one of 0 reaches below the axis."""
    low, high = (_positive(limit) for limit in limits)
    low = np.where(np.isnan(low), 1e-300, low)
    ax.fill_between(x, low, high, color=color, alpha=0.2, lw=0)
