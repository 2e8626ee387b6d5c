"""Plots of variables of datasets over one dimension: media, wave spectra, sweeps, error rates."""

from __future__ import annotations

import itertools
import math
from collections.abc import Hashable, Iterator
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from meshtrace.errors import Described, Refused, require_array
from meshtrace.fields import FIELDS
from meshtrace.models import Floats

from .checks import checked
from .style import INK, axes, finished, label_of, note, verbatim

BER_SHOWN = (1e-9, 1.0)
"""Limits of the axis of error rates."""

_NAMED = 12
"""Most curves that are named; of more, every second, third ... is."""


@checked
def plot_curves(
    data: xr.Dataset, quantity: str, *, style: str = "-", ax: Axes | None = None
) -> Axes:
    """Plot a variable over its last dimension, one curve for each value of the other one.

    Parameters
    ----------
    data : xarray.Dataset
        With `quantity` of one or two dimensions; the coordinate of the first of two names the
        curves. Limits `quantity` + "_low" and "_high", or two standard errors "_stderr" where
        there are any, are drawn as bands, those of markers without a line as bars.
    quantity : str
        Name of the variable; registered names (`meshtrace.fields`) set the labels of the axes.
    style : str
        Line and marker, as matplotlib writes them.
    ax : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes

    Raises
    ------
    Refused
        If the variable is missing or has other dimensions.

    Examples
    --------
    >>> import numpy as np, xarray as xr
    >>> depth = np.array([5.0, 10.0])
    >>> gain = xr.Dataset({"gain": ("depth", [1e-4, 1e-5])}, {"depth": depth})
    >>> plot_curves(gain, "gain").get_xlabel()
    'depth below still water $d$ [m]'
    """
    x, label = _abscissa(data, quantity)
    curves = list(_curves(data, quantity))
    ax = axes(ax)
    every = math.ceil(len(curves) / _NAMED)
    if every > 1:
        ax.set_prop_cycle(color=colormaps["viridis"](np.linspace(0.0, 0.95, len(curves))))
    for i, (name, values, low, high) in enumerate(curves):
        try:
            (line,) = ax.plot(x, values, style, markersize=4, label=None if i % every else name)
        except ValueError as error:
            raise Refused("style", style, "a line and a marker as in o--") from error
        if low is not None and high is not None:
            _draw_limits(ax, line, values, low, high)
    if f"{quantity}_low" not in data and f"{quantity}_stderr" in data:
        note(ax, f"{'band' if '-' in style else 'bars'}: ± 2 standard errors")
    return finished(ax, xlabel=label, ylabel=label_of(quantity))


def _draw_limits(ax: Axes, line: Line2D, values: Any, low: Any, high: Any) -> None:
    """Draw the limits of a line as a band, those of markers without a line as bars."""
    x, color = line.get_xdata(), line.get_color()
    if len(values) > 1 and line.get_linestyle() != "None":
        ax.fill_between(x, low, high, color=color, alpha=0.25, lw=0)
    else:
        around = np.maximum([values - low, high - values], 0.0)
        ax.errorbar(x, values, around, fmt="none", ecolor=color, capsize=3, lw=1.0)


@checked
def plot_phase_function(data: xr.Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot `phase_function` [sr-1] over `theta` [rad], both logarithmic; see `plot_curves`."""
    ax = plot_curves(data, "phase_function", ax=ax)
    ax.set(xscale="log", yscale="log")
    ax.xaxis.set_major_formatter("{x:g}")
    return ax


@checked
def plot_phase_cdf(data: xr.Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot `phase_cdf`, the probability of a scattering angle up to `theta` [rad]."""
    ax = plot_curves(data, "phase_cdf", ax=ax)
    ax.set(xscale="log", ylim=(0.0, 1.02), ylabel=r"distribution function $P(\theta)$")
    ax.xaxis.set_major_formatter("{x:g}")
    return ax


@checked
def plot_bubble_profile(
    data: xr.Dataset, *, quantity: str = "b_bub", ax: Axes | None = None
) -> Axes:
    """Plot `b_bub` or `n_bubbles` over `depth` [m], which points down; see `plot_curves`."""
    z, label = _abscissa(data, quantity)
    ax = axes(ax)
    for name, values, _, _ in _curves(data, quantity):
        ax.plot(values, z, label=name)
    limits = (z.max(), z.min())
    return finished(ax, xscale="log", xlabel=label_of(quantity), ylabel=label, ylim=limits)


@checked
def plot_spectrum(data: xr.Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot wave frequency spectra `spectrum` over `omega` [rad s-1]; see `plot_curves`."""
    return finished(plot_curves(data, "spectrum", ax=ax), ylim=(0.0, None))


@checked
def plot_spreading(data: xr.Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot directional spreadings `spreading` over `theta` [rad] off the wind."""
    ax = plot_curves(data, "spreading", ax=ax)
    label = r"directional spreading $D(\theta)$ [rad$^{-1}$]"
    return finished(
        ax, xlabel=r"direction off the wind $\theta$ [°]", ylabel=label, ylim=(0.0, None)
    )


@checked
def plot_sweep(
    data: xr.Dataset, *, quantity: str = "gain", log: bool = True, ax: Axes | None = None
) -> Axes:
    """Plot a quantity of a sweep over a parameter, one curve for each point of the others.

    Parameters
    ----------
    data : xarray.Dataset
        Of `sweep`, or any with `quantity` over parameters. Gains over several realizations are
        drawn as means with standard errors from their scatter. The abscissa is the last parameter
        of several numbers, or the last one.
    quantity : str
        Name of the variable.
    log : bool
        Logarithmic ordinate.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    if quantity not in data or not data[quantity].ndim or data[quantity].dtype.kind not in "biuf":
        return plot_curves(data, quantity, ax=ax)  # refuses it
    shown, parameters = _over_parameters(data, quantity)
    along = str(shown[quantity].dims[-1])
    words = shown[along].to_numpy() if shown[along].dtype.kind not in "iuf" else None
    if words is not None:
        shown = shown.assign_coords({along: np.arange(len(words))})
    ax = plot_curves(positive(shown, quantity) if log else shown, quantity, style="o-", ax=ax)
    if words is not None:
        ax.set_xticks(np.arange(len(words)), words)
    if any("." in name or name in FIELDS for name in parameters):  # others have names as values
        ax.legend(title="\n".join(map(label_of, parameters)))
    if quantity == "ber":
        error_rates(ax, shown, 1e-3)
    if quantity in data and "light" in data[quantity].attrs:
        ax.set_title(f"background light: {data[quantity].light}", fontsize=9, pad=16)
    return finished(ax, legend=False, yscale="log" if log else "linear")


def _over_parameters(data: xr.Dataset, quantity: str) -> tuple[xr.Dataset, list[str]]:
    """Return a variable over one parameter, curve by curve, and the parameters of the curves.

    It is averaged over realizations.
    """
    found = data[[name for name in data.data_vars if str(name).startswith(quantity)]]
    n = found.sizes.get("realization", 0)
    if n > 1:
        scatter = found[quantity].std("realization", ddof=1) / np.sqrt(n)
        found = found[[quantity]].mean("realization").assign({f"{quantity}_stderr": scatter})
    elif n == 1 and found[quantity].ndim > 1:
        found = found.squeeze("realization", drop=True)
    dims = [str(name) for name in found[quantity].dims]

    def use(name: str) -> tuple[bool, bool]:
        return found.sizes[name] > 1, found[name].dtype.kind in "iuf"

    along = max(reversed(dims), key=use)
    others = [name for name in dims if name != along and found.sizes[name] > 1]
    found = found.squeeze([n for n in dims if n not in (along, *others)], drop=True)
    if not others:
        return found, []
    names = [
        ", ".join(f"{v:g}" if isinstance(v, float) else str(v) for v in point)
        for point in itertools.product(*(found[name].to_numpy().tolist() for name in others))
    ]
    curves = found.transpose(*others, along).stack(curve=others, create_index=False)
    return curves.transpose("curve", along).assign_coords(curve=names), others


@checked
def plot_ber(data: xr.Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot bit error rates `ber`, logarithmic, over any dimension; see `plot_curves`.

    A `received_power` [W] is shown in dBm; the dashed line is 1e-3, triangles are lower rates than
    the axis has.
    """
    ax = plot_curves(positive(data, "ber"), "ber", ax=ax)
    return error_rates(ax, data, 1e-3)


def error_rates(ax: Axes, data: xr.Dataset, limit: float) -> Axes:
    """Set the axis of plotted error rates `ber`, with a line at a limit.

    Rates below the axis, where whole curves may be, are triangles at its end; a line without
    markers of which a part is shown has none.
    """
    x, (least, _), marked = _abscissa(data, "ber")[0], BER_SHOWN, False
    for line, (_, values, _, _) in zip(list(ax.get_lines()), _curves(data, "ber"), strict=False):
        below = np.asarray(values < least)
        if line.get_marker() == "None" and not below.all():
            continue
        low, marked = x[below], marked or bool(below.any())
        ax.plot(low, np.full(len(low), least), "v", color=line.get_color(), ms=5, clip_on=False)
    if marked:
        ax.plot([], [], "v", color=INK, ms=5, label="below 1e-9")
        legend = ax.get_legend()
        ax.legend(title=legend.get_title().get_text() if legend else None)
    ax.axhline(limit, color=INK, lw=0.8, ls="--")
    return finished(ax, legend=False, yscale="log", ylim=BER_SHOWN)


def positive(data: xr.Dataset, quantity: str) -> xr.Dataset:
    """Return a dataset for a logarithmic axis: nan for 0; a lower limit of 0 is below the axis."""
    values = _variable(data, quantity)
    shown = data.assign({quantity: values.where(values > 0.0)})
    low = f"{quantity}_low"
    return shown.assign({low: data[low].clip(min=1e-300)}) if low in data else shown


def _curves(data: xr.Dataset, quantity: str) -> Iterator[tuple[Any, ...]]:
    """Yield name, values, lower and upper limit of each curve."""
    values, dims = data[quantity], data[quantity].dims
    kinds = [kind for kind in ("low", "high", "stderr") if f"{quantity}_{kind}" in data]
    limits = {kind: _variable(data, f"{quantity}_{kind}", dims) for kind in kinds}
    low, high = limits.get("low"), limits.get("high")
    if "stderr" in limits:
        low, high = (values + s * limits["stderr"] for s in (-2.0, 2.0))
    if values.ndim == 1:
        yield None, values, low, high
        return
    by = values.dims[0]
    for i, name in enumerate(data[by].to_numpy()):
        lines = (None if a is None else a.isel({by: i}) for a in (values, low, high))
        yield verbatim(name), *lines


def _abscissa(data: xr.Dataset, quantity: str) -> tuple[Floats, str]:
    """Return the last dimension as shown, angles in degrees and powers in dBm, and its label."""
    along = str(_variable(data, quantity).dims[-1])
    x = require_array(data[along].to_numpy(), along, "numbers along the axis")
    field = FIELDS.get(along)
    if field is not None and field.units == "rad":
        return np.degrees(x), f"{field.long_name} ${field.symbol}$ [°]"
    if field is not None and along == "received_power":
        return 10.0 * np.log10(x / 1e-3), f"{field.long_name} [dBm]"
    if along == "bit_rate":
        return x / 1e6, "bit rate [Mbit/s]"
    return x, label_of(along)


def _variable(data: xr.Dataset, name: str, dims: tuple[Hashable, ...] = ()) -> xr.DataArray:
    """Return a variable of numbers, of some dimensions or of any one or two."""
    found = data.get(name)
    if found is None or (found.dims != dims if dims else found.ndim not in (1, 2)):
        allowed = f"a variable over {dims}" if dims else "a variable of one or two dimensions"
        raise Refused(name, None if found is None else found.dims, allowed)
    if found.dtype.kind not in "biuf" or not found.size:
        raise Refused(name, Described(f"{found.size} values of {found.dtype}"), "numbers")
    return found
