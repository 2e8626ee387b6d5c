"""Building blocks of plots: axes labelled by variable names and units, and five kinds of marks.

Lines, bands, bars, maps and densities, of which all plots of results and of the paper consist.
Dimensions, coordinates, limits and standard errors of a dataset decide what is drawn: the last
dimension is along the axis, the coordinate of the one before names curves or groups of bars.
"""

from __future__ import annotations

import itertools
import math
import re
import textwrap
from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import Normalize, to_hex
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import StepPatch
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from meshtrace.errors import Described, Refused, require_array
from meshtrace.fields import FIELDS, attrs
from meshtrace.models import Floats

from .style import INK, PALETTE, RC, STROKES, axis_label, label_of, verbatim

_SCALES: dict[str, tuple[Callable[[Floats], Floats], str]] = {
    "rad": (np.degrees, "°"),
    "received_power": (lambda watt: 10.0 * np.log10(watt / 1e-3), "dBm"),
    "bit_rate": (lambda rate: rate / 1e6, "Mbit/s"),
    "delay": (lambda seconds: 1e9 * seconds, "ns"),
}
"""Axis units that replace the units of variables, by name or unit of the variable."""

_LONGEST = 52  # characters of a label beside axes
_BESIDE = 5  # most names of a legend inside the axes: more find no free corner
_NAMED = 12  # most curves that are named; of more, every second, third ... is


# ---- axes ------------------------------------------------------------------------------------


def axes(ax: Axes | None) -> Axes:
    """Return `ax`, or the axes of a new figure."""
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    # not in the context: in a notebook the first figure turns the interactive mode on, without
    # which later ones are not shown, and the context would turn it off again
    figure = plt.figure(figsize=RC["figure.figsize"], layout="constrained")
    with mpl.rc_context(RC):
        return figure.subplots()


def scaled(name: str, values: ArrayLike) -> tuple[Floats, str]:
    """Convert a variable to the units of its axis; return it with the label of the axis."""
    array = np.asarray(values)
    field = FIELDS.get(name)
    scale = "rad" if field is not None and field.units == "rad" else name
    if field is None or scale not in _SCALES:
        return array, label_of(name)
    transform, unit = _SCALES[scale]
    return transform(array), f"{field.long_name} ${field.symbol}$ [{unit}]"


def finished(
    ax: Axes, x: str = "", y: str = "", *, legend: bool = True, clear: bool = False, **settings: Any
) -> Axes:
    """Set labels, scales and limits of axes, and add a legend if any mark has a name.

    Parameters
    ----------
    ax : matplotlib Axes
        Axes with all their marks.
    x, y : str
        Names of variables, whose labels the axes get.
    legend : bool
        Draw a legend, beside the axes if it is long; else an earlier one stays.
    clear : bool
        Move the legend beside the axes if it would cover a curve.
    **settings
        Of `Axes.set`.
    """
    for side, name in (("xlabel", x), ("ylabel", y)):
        settings |= {side: label_of(name)} if name else {}
    ax.set(**settings)
    ax.set_ylabel(wrapped(ax.get_ylabel()))
    _told_apart(ax)
    named, drawn = len(ax.get_legend_handles_labels()[1]), ax.get_legend()
    if legend and named:
        # a legend that is drawn anew has lost its title
        drawn = ax.legend(title=drawn.get_title().get_text() if drawn else None)
    too_long = legend and named > _BESIDE
    if drawn is not None and (too_long or (clear and _covers_curve(ax, drawn))):
        drawn.set_loc("upper left")
        drawn.set_bbox_to_anchor((1.0, 1.0), ax.transAxes)
    return ax


def _covers_curve(ax: Axes, legend: Legend) -> bool:
    """Return whether a legend lies over a curve."""
    # the place of a legend is known once it is laid out
    ax.figure.canvas.figure.draw_without_rendering()
    box = legend.get_window_extent()
    paths = (line.get_path().transformed(line.get_transform()) for line in ax.lines)
    return any(path.intersects_bbox(box, filled=False) for path in paths)


def _told_apart(ax: Axes) -> None:
    """Set dashes and markers by colour, so that curves differ in grey print."""
    for line in ax.get_lines():
        dashes, marker, _ = STROKES.get(to_hex(line.get_color()).upper(), ("-", "o", ""))
        if line.get_linestyle() == "-":
            line.set_linestyle(dashes)
        if line.get_marker() == "o":
            line.set_marker(marker)
    for patch in ax.patches:
        if isinstance(patch, StepPatch) and not patch.get_fill():
            shade = to_hex(patch.get_edgecolor()).upper()
            patch.set_linestyle(STROKES.get(shade, ("-",))[0])


def _titled(ax: Axes, data: xr.Dataset, quantity: str) -> Axes:
    """Title a legend of numbers with the name and unit of their variable."""
    by, legend = data[quantity].dims[0], ax.get_legend()
    if legend is not None and data[quantity].ndim == 2 and data[by].dtype.kind in "iuf":
        legend.set_title(label_of(str(by)))
    return ax


def wrapped(label: str) -> str:
    """Break a long label into two lines without splitting TeX or units."""
    shown = re.sub(r"\\\w+|[${}^_\\]", "", label)
    if len(shown) <= _LONGEST:
        return label
    # a character at which no line is broken holds units and symbols together
    whole = re.sub(r"\[.*\]|\$[^$]*\$", lambda part: part[0].replace(" ", "\0"), label)
    return "\n".join(textwrap.wrap(whole, round(0.6 * len(label)))).replace("\0", " ")


def note(ax: Axes, text: str, side: Literal["left", "right"] = "right") -> None:
    """Write a note above one end of the axes, unless it is there already."""
    if text not in (text_drawn.get_text() for text_drawn in ax.texts):
        where = 0.0 if side == "left" else 1.0, 1.01
        ax.annotate(text, where, xycoords="axes fraction", ha=side, va="bottom", fontsize=8)


# ---- data ------------------------------------------------------------------------------------


def dataset(variables: dict[str, Any], coords: dict[str, Any]) -> xr.Dataset:
    """Return a dataset of variables over all coordinates, with attributes of registered names."""

    def attributes(name: str) -> dict[str, str]:
        known = name in FIELDS or name.removesuffix("_stderr") in FIELDS
        return attrs(name) if known else {}

    return xr.Dataset(
        {name: (tuple(coords), values, attributes(name)) for name, values in variables.items()},
        {name: (name, list(values), attributes(name)) for name, values in coords.items()},
    )


def variable(data: xr.Dataset, name: str, dims: tuple[Hashable, ...] = ()) -> xr.DataArray:
    """Return a numeric variable with the given dimensions (default: 1-D or 2-D)."""
    variable = data.get(name)
    if variable is None or (variable.dims != dims if dims else variable.ndim not in (1, 2)):
        allowed = f"a variable over {dims}" if dims else "a variable of one or two dimensions"
        raise Refused(name, None if variable is None else variable.dims, allowed)
    if variable.dtype.kind not in "biuf" or not variable.size:
        raise Refused(name, Described(f"{variable.size} values of {variable.dtype}"), "numbers")
    return variable


def along(data: xr.Dataset, quantity: str) -> tuple[Floats, str]:
    """Return the last coordinate of a variable in the units of its axis, and the axis label."""
    name = str(variable(data, quantity).dims[-1])
    return scaled(name, require_array(data[name].to_numpy(), name, "numbers along the axis"))


def curves(data: xr.Dataset, quantity: str) -> Iterator[tuple[Any, ...]]:
    """Yield the name, values, lower and upper limits of each curve or group of bars."""
    values, dims = variable(data, quantity), data[quantity].dims
    kinds = [kind for kind in ("low", "high", "stderr") if f"{quantity}_{kind}" in data]
    limits = {kind: variable(data, f"{quantity}_{kind}", dims) for kind in kinds}
    low, high = limits.get("low"), limits.get("high")
    if "stderr" in limits:
        low, high = (values + s * limits["stderr"] for s in (-2.0, 2.0))
    if values.ndim == 1:
        yield None, *(None if a is None else a.to_numpy() for a in (values, low, high))
        return
    by = values.dims[0]
    for i, name in enumerate(data[by].to_numpy()):
        bands = (None if a is None else a.isel({by: i}).to_numpy() for a in (values, low, high))
        yield verbatim(name), *bands


# ---- marks -----------------------------------------------------------------------------------


def lines(
    ax: Axes | None,
    data: xr.Dataset,
    quantity: str,
    styles: Sequence[str] = ("-",),
    colors: Sequence[Any] = (),
    **look: Any,
) -> Axes:
    """Draw the curves of a variable with their limits; curves named "" are not in the legend.

    Parameters
    ----------
    ax : matplotlib Axes or None
        Axes to draw on; None for those of a new figure.
    data : xarray.Dataset
        With `quantity` over one or two dimensions.
    quantity : str
        Name of the variable. Between its limits, or within two standard errors, lines have a band
        and markers without a line bars.
    styles, colors : sequence
        Of the curves in turn.
    **look
        Of `Axes.plot`.
    """
    x, label = along(data, quantity)
    ax, drawn = axes(ax), list(curves(data, quantity))
    every = math.ceil(len(drawn) / _NAMED)
    if len(drawn) > len(PALETTE):  # shades in their order
        shades = colormaps["viridis"](np.linspace(0.0, 0.95, len(drawn)))
        ax.set_prop_cycle(color=shades)
    styled = zip(drawn, itertools.cycle(styles), itertools.cycle(colors or (None,)), strict=False)
    for i, ((name, values, low, high), style, color) in enumerate(styled):
        options: Any = {"markersize": 4, "label": None if i % every else name or None} | look
        if color:  # a colour of None would end the cycle of colours
            options["color"] = color
        try:
            (line,) = ax.plot(x, values, style, **options)
        except ValueError as error:
            raise Refused("style", style, "a line and a marker as in o--") from error
        if len(drawn) > len(PALETTE) and line.get_linestyle() == "-":
            # two shades in turn are too close for grey print
            line.set_linestyle(("-", "--", "-.", ":")[i % 4])
        if low is not None and high is not None:
            band(ax, line, low, high)
    if f"{quantity}_low" not in data and f"{quantity}_stderr" in data:
        note(ax, f"{'band' if '-' in styles[0] else 'bars'}: ± 2 standard errors")
    if data[data[quantity].dims[-1]].dtype.kind in "iu":
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    return _titled(finished(ax, y=quantity, xlabel=label), data, quantity)


def band(ax: Axes, line: Line2D, low: Any, high: Any) -> None:
    """Draw the limits of a curve as a band, or as error bars if it has markers alone."""
    x, y, color = line.get_xdata(), np.asarray(line.get_ydata()), line.get_color()
    if y.size > 1 and line.get_linestyle() != "None":
        steps = line.get_drawstyle().partition("steps-")[2] or None
        ax.fill_between(x, low, high, step=steps, color=color, alpha=0.25, lw=0)  # type: ignore[arg-type]
    elif np.isfinite(low).any():
        # matplotlib refuses negative bars, which a value outside of its limits would have
        around = np.maximum([y - low, high - y], 0.0)
        ax.errorbar(x, y, around, fmt="none", ecolor=color, capsize=3, lw=1.0)


def bars(
    ax: Axes | None, data: xr.Dataset, quantity: str, *, across: bool = False, beside: bool = True
) -> Axes:
    """Draw a variable as bars with whiskers of two standard errors; nan has no bar.

    Parameters
    ----------
    ax : matplotlib Axes or None
        Axes to draw on; None for those of a new figure.
    data : xarray.Dataset
        With `quantity` over names or counts, or groups of them.
    quantity : str
        Name of the variable.
    across : bool
        Draw horizontal bars, the first on top.
    beside : bool
        Draw groups beside each other, else from one line.
    """
    groups, names = list(curves(data, quantity)), str(data[quantity].dims[-1])
    ax = axes(ax)
    room = 0.8 / len(groups) if beside else 0.8
    for i, (name, values, _, high) in enumerate(groups):
        shift = (i - 0.5 * (len(groups) - 1)) * room if beside else 0.0
        (known,) = np.isfinite(values).nonzero()
        drawn = (ax.barh if across else ax.bar)(known + shift, values[known], room, label=name)
        for bar in drawn:
            hatch = STROKES.get(to_hex(bar.get_facecolor()).upper(), ("", "", ""))[2]
            bar.set(hatch=hatch, edgecolor="white", linewidth=0.0)
        if high is not None:
            spans = (high - values)[known]
            where = (values[known], known + shift) if across else (known + shift, values[known])
            x_spans, y_spans = (spans, None) if across else (None, spans)
            ax.errorbar(*where, y_spans, x_spans, fmt="none", ecolor=INK, elinewidth=1.0, capsize=3)
    axis, words = ax.yaxis if across else ax.xaxis, data[names].to_numpy()
    counts = words.dtype.kind in "iu"
    if not counts:
        texts = ("\n".join(map(verbatim, str(word).split("\n"))) for word in words)
        axis.set_ticks(np.arange(len(words)), list(texts))
    if across:
        ax.invert_yaxis()
    if f"{quantity}_stderr" in data:
        note(ax, "bars: ± 2 standard errors")
    ax.grid(axis="y" if across else "x", visible=False)
    labels = (quantity, "") if across else (names if counts else "", quantity)
    return _titled(finished(ax, *labels), data, quantity)


def heat_map(
    ax: Axes, x: Any, y: Any, values: Any, label: str, *, colors: Any = None,
    norm: Normalize | None = None, vmin: float | None = None, vmax: float | None = None,
) -> Any:  # fmt: skip
    """Draw values (x, y) as a colour map with equal axes [m]; a label adds a colour bar."""
    # matplotlib takes lines along y first
    image = ax.pcolormesh(
        x, y, values.T, shading="nearest", cmap=colors, norm=norm, vmin=vmin, vmax=vmax,
        rasterized=True,
    )  # fmt: skip
    if label:
        ax.figure.colorbar(image, ax=ax, label=label)
    seen_from_above(ax)
    return image


def seen_from_above(ax: Axes) -> Axes:
    """Set up axes as a map: x and y [m] at equal scale, round ticks, no grid."""
    ax.set(aspect="equal", xlabel=axis_label("x"), ylabel=axis_label("y"))
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    ax.grid(visible=False)
    return ax


def density(ax: Axes, edges: Any, values: Any, stderr: Any, least: float, label: str) -> None:
    """Draw a histogram as an outline with a band of two standard errors above a least value."""
    steps = ax.stairs(values, edges, lw=1.5, label=label)
    low, high = (np.maximum(values + s * stderr, least) for s in (-2.0, 2.0))
    color = steps.get_edgecolor()
    ax.stairs(high, edges, baseline=low, fill=True, color=color, alpha=0.25, lw=0)
