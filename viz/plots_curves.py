"""Plots of variables of datasets over one dimension: media, wave spectra, sweeps, error rates."""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from meshtrace.errors import Described, Refused, require_array
from meshtrace.fields import FIELDS
from meshtrace.models import Floats

from .checks import checked
from .style import INK, axes, finished, label_of, note, verbatim

BER_SHOWN = (1e-9, 1.0)
"""Limits of the axis of error rates."""


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
        there are any, are drawn as bands.
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
    for name, values, low, high in curves:
        try:
            (line,) = ax.plot(x, values, style, markersize=4, label=name)
        except ValueError as error:
            raise Refused("style", style, "a line and a marker as in o--") from error
        if low is not None and high is not None:
            ax.fill_between(x, low, high, color=line.get_color(), alpha=0.25, lw=0)
    if f"{quantity}_low" not in data and f"{quantity}_stderr" in data:
        note(ax, "band: ± 2 standard errors")
    return finished(ax, xlabel=label, ylabel=label_of(quantity))


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
    """Plot a quantity over one or two parameters, with bands; see `plot_curves`.

    Parameters
    ----------
    data : xarray.Dataset
        Of `sweep`, or any with `quantity` over parameters. Gains over several realizations are
        drawn as means with standard errors from their scatter.
    quantity : str
        Name of the variable.
    log : bool
        Logarithmic ordinate.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Raises
    ------
    Refused
        If there are more than two parameters of several values.
    """
    ax = plot_curves(_over_parameters(data, quantity), quantity, style="o-", ax=ax)
    return finished(ax, yscale="log" if log else "linear")


def _over_parameters(data: xr.Dataset, quantity: str) -> xr.Dataset:
    """Return a variable averaged over realizations, over its one or two parameters."""
    if quantity not in data or data[quantity].dtype.kind not in "biuf":
        return data
    names = [name for name in data.data_vars if str(name).startswith(quantity)]
    found = data[names]
    n = found.sizes.get("realization", 0)
    if n > 1:
        scatter = found[quantity].std("realization", ddof=1) / np.sqrt(n)
        found = found[[quantity]].mean("realization").assign({f"{quantity}_stderr": scatter})
    found = found.squeeze(drop=True)
    dims = found[quantity].dims
    if len(dims) > 2:
        allowed = "one or two parameters of several values; select others by .sel"
        raise Refused("data", Described(f"{len(dims)} of them"), allowed)
    along = [name for name in dims if found[name].dtype.kind in "iuf"]
    return found.transpose(..., along[-1]) if along else found


@checked
def plot_ber(data: xr.Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot bit error rates `ber`, logarithmic, over any dimension; see `plot_curves`.

    A `received_power` [W] is shown in dBm; the dashed line is 1e-3.
    """
    ax = plot_curves(positive(data, "ber"), "ber", ax=ax)
    ax.axhline(1e-3, color=INK, lw=0.8, ls="--")
    return finished(ax, yscale="log", ylim=BER_SHOWN)


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
