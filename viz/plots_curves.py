"""Plots of curves over one dimension: media, wave spectra, sweeps, error rates of links."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes

from meshtrace.errors import Described, Refused
from meshtrace.fields import FIELDS, attrs
from meshtrace.results.series import ByWavelength, by_wavelength

from .marks import along, axes, curves, finished, lines, note, variable
from .style import INK, label_of, number, verbatim

if TYPE_CHECKING:  # studies take as long to import as matplotlib
    from meshtrace.studies import DepthSweep, LinkPerformance

_LEAST_BUBBLES = 1e-6  # lower end of the axis (tuned), relative to the densest layer

BER_SHOWN = (1e-9, 1.0)
"""Limits of the axis of error rates (tuned)."""


def plot_curves(
    data: xr.Dataset, quantity: str, *, style: str = "-", ax: Axes | None = None
) -> Axes:
    """Plot a variable over its last dimension, one curve per value of the other one.

    Parameters
    ----------
    data : xarray.Dataset
        With `quantity` over one or two dimensions; the coordinate of the first of two names the
        curves. Limits `quantity` + "_low" and "_high", or else two standard errors "_stderr", are
        drawn as bands of lines and as bars of markers without a line.
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
    return lines(ax, data, quantity, (style,))


def plot_phase_function(data: xr.Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot `phase_function` [sr-1] over `theta` [rad], both logarithmic; see `plot_curves`."""
    ax = plot_curves(data, "phase_function", ax=ax)
    ax.set(xscale="log", yscale="log")
    ax.xaxis.set_major_formatter("{x:g}")
    return ax


def plot_phase_cdf(data: xr.Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot `phase_cdf`, the probability of a scattering angle up to `theta` [rad]."""
    ax = plot_curves(data, "phase_cdf", ax=ax)
    ax.set(xscale="log", ylim=(0.0, 1.02), ylabel=r"distribution function $P(\theta)$")
    ax.xaxis.set_major_formatter("{x:g}")
    return ax


def plot_bubble_profile(
    data: xr.Dataset, *, quantity: str = "b_bub", ax: Axes | None = None
) -> Axes:
    """Plot a profile of `b_bub` or `n_bubbles` over `depth` [m], which increases downwards."""
    z, _ = along(data, quantity)
    ax = axes(ax)
    most = float(data[quantity].max())
    for name, values, _, _ in curves(data, quantity):
        ax.plot(values, z, label=name)
    # depth points down
    ax.set(xscale="log", xlim=(_LEAST_BUBBLES * most, 2.0 * most), ylim=(z.max(), z.min()))
    return finished(ax, quantity, "depth")


def plot_water(data: xr.Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot absorption, scattering and attenuation of a water over the wavelength.

    Parameters
    ----------
    data : xarray.Dataset
        As returned by `Water.spectra`.
    ax : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes

    Examples
    --------
    >>> import meshtrace as mt
    >>> plot_water(mt.Water.from_type("jerlov-II").spectra()).get_yscale()
    'log'
    """
    ax = axes(ax)
    for name, style in zip("abc", ("-", "--", ":"), strict=True):
        lines(ax, data, name, (style,), label=f"{FIELDS[name].long_name} ${name}$")
    # the name alone, without the publications
    text = str(data.attrs["source"]).partition(" (")[0]
    note(ax, f"{text}; n = {float(data.n[0]):.4f} to {float(data.n[-1]):.4f}")
    return finished(ax, yscale="log", ylabel="coefficient [m$^{-1}$]")


def plot_wavelengths(result: ByWavelength[Any], *, ax: Axes | None = None) -> Axes:
    """Plot results at several wavelengths: gain, mean gain (also of a map), radiance or margin.

    Parameters
    ----------
    result : ByWavelength
        As returned by `simulate`, `ensemble`, `time_series`, `coverage_map`, `background` or
        `link_performance` with `wavelengths_nm`.
    ax : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        With a curve for each receiver and bands of two standard errors, of margins with their
        confidence intervals.

    Raises
    ------
    Refused
        If results of this kind cannot be plotted.
    """
    kind = result.results[0].kind
    if kind not in _OVER_WAVELENGTH:
        raise Refused("result", Described(f"of kind {kind}"), ", ".join(_OVER_WAVELENGTH))
    name, triple = _OVER_WAVELENGTH[kind]
    values = np.array([triple(result_at) for _, result_at in result])  # (wavelengths, 3, receivers)
    nm = ("wavelength_nm", result.wavelength_nm, attrs("wavelength_nm"))
    receivers = [f"receiver {r}" for r in range(values.shape[2])]
    data = xr.Dataset(coords={"wavelength_nm": nm, "receiver": receivers})
    for i, suffix in enumerate(("", "_low", "_high")):
        data[name + suffix] = (("receiver", "wavelength_nm"), values[:, i].T)
    if len(receivers) == 1:
        data = data.isel(receiver=0)
    return lines(ax, data, name)


def _with_errors(values: Any, errors: Any) -> list[Any]:
    """Return (values, low, high) with limits at two standard errors, each of shape (n,)."""
    values, errors = np.atleast_1d(values), np.atleast_1d(errors)
    return [values, values - 2.0 * errors, values + 2.0 * errors]


# the errors of the pixels of a map are taken as independent: those of their sum add in squares
_OVER_WAVELENGTH: dict[str, tuple[str, Callable[[Any], list[Any]]]] = {
    "gain": ("gain", lambda r: _with_errors(r.gains, r.stderrs)),
    "series": ("gain", lambda r: _with_errors(r.gains.mean(axis=0), r.mean_stderrs)),
    "coverage": (
        "gain",
        lambda r: _with_errors(r.gain.mean(), np.linalg.norm(r.gain_stderr) / r.gain.size),
    ),
    "background": ("radiance", lambda r: _with_errors(r.radiance, r.radiance_stderr)),
    "performance": ("margin_optical_db", lambda r: [[x] for x in r.at().margin_optical_db]),
}
"""By the kind of the results: the variable, and a function of a result to (values, low, high)."""


def plot_spectrum(data: xr.Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot wave frequency spectra `spectrum` over `omega` [rad s-1]; see `plot_curves`."""
    return finished(plot_curves(data, "spectrum", ax=ax), ylim=(0.0, None))


def plot_spreading(data: xr.Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot `spreading`, the density over direction `theta` [rad] relative to the wind."""
    ax = plot_curves(data, "spreading", ax=ax)
    label = r"directional spreading $D(\theta)$ [rad$^{-1}$]"
    xlabel = r"direction off the wind $\theta$ [°]"
    return finished(ax, xlabel=xlabel, ylabel=label, ylim=(0.0, None))


def plot_sweep(
    data: xr.Dataset, *, quantity: str = "gain", log: bool = True, ax: Axes | None = None
) -> Axes:
    """Plot a quantity of a sweep over one parameter, one curve per combination of the others.

    Parameters
    ----------
    data : xarray.Dataset
        As returned by `sweep`, or any with `quantity` over parameters. Gains of several
        realizations are drawn as means with standard errors from their scatter. The abscissa is
        the last parameter with more than one value, preferably of numbers.
    quantity : str
        Name of the variable.
    log : bool
        Whether the ordinate is logarithmic.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    if quantity not in data or not data[quantity].ndim or data[quantity].dtype.kind not in "biuf":
        return plot_curves(data, quantity, ax=ax)  # which refuses it by name
    shown, parameters = _over_parameters(data, quantity)
    name = str(shown[quantity].dims[-1])
    words = shown[name].to_numpy() if shown[name].dtype.kind not in "iuf" else None
    if words is not None:
        # words are drawn at 0, 1, 2 ... in their order
        shown = shown.assign_coords({name: np.arange(len(words))})
    ax = plot_curves(positive(shown, quantity) if log else shown, quantity, style="o-", ax=ax)
    if words is not None:
        ax.set_xticks(np.arange(len(words)), words)
        ax.set_xlabel(verbatim(name))
    # values of fields ("water.a") and variables need the name; others are names themselves
    if any("." in name or name in FIELDS for name in parameters):
        ax.get_legend().set_title("\n".join(map(label_of, parameters)))  # type: ignore[union-attr]
    if quantity == "ber":
        error_rates(ax, shown, 1e-3)
    if quantity in data and "light" in data[quantity].attrs:
        ax.set_title(f"background light: {data[quantity].light}", fontsize=9, pad=16)
    return finished(ax, legend=False, clear=True, yscale="log" if log else "linear")


def _over_parameters(data: xr.Dataset, quantity: str) -> tuple[xr.Dataset, list[str]]:
    """Return a variable as (curve, abscissa), and the parameters in which the curves differ.

    It is averaged over realizations.
    """
    selected = by_wavelength(data)
    selected = selected[[name for name in data.data_vars if str(name).startswith(quantity)]]
    n = selected.sizes.get("realization", 0)
    if n > 1:
        # standard error of the mean of independent realizations
        scatter = selected[quantity].std("realization", ddof=1) / np.sqrt(n)
        selected = selected[[quantity]].mean("realization").assign({f"{quantity}_stderr": scatter})
    elif n == 1 and selected[quantity].ndim > 1:
        selected = selected.squeeze("realization", drop=True)
    dims = [str(name) for name in selected[quantity].dims]

    def preference(name: str) -> tuple[bool, bool]:
        return selected.sizes[name] > 1, selected[name].dtype.kind in "iuf"

    # the last parameter of those equally preferred, since `max` returns the first of them
    abscissa = max(reversed(dims), key=preference)
    others = [name for name in dims if name != abscissa and selected.sizes[name] > 1]
    selected = selected.squeeze([n for n in dims if n not in (abscissa, *others)], drop=True)
    if not others:
        return selected, []
    names = [
        ", ".join(f"{v:g}" if isinstance(v, float) else str(v) for v in point)
        for point in itertools.product(*(selected[name].to_numpy().tolist() for name in others))
    ]
    stacked = selected.transpose(*others, abscissa).stack(curve=others, create_index=False)
    return stacked.transpose("curve", abscissa).assign_coords(curve=names), others


def plot_ber(data: xr.Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot bit error rates `ber` on a logarithmic axis over any dimension; see `plot_curves`.

    A `received_power` [W] is shown in dBm. The dashed line is at 1e-3; triangles stand for rates
    below the axis.
    """
    ax = plot_curves(positive(data, "ber"), "ber", ax=ax)
    return error_rates(ax, data, 1e-3)


def error_rates(ax: Axes, data: xr.Dataset, limit: float) -> Axes:
    """Set up the axis of plotted error rates `ber`, and draw a line at a limit.

    Rates below the axis become triangles at its lower end. A line without markers gets them only
    if all of it is below: otherwise it is seen to leave the axis.
    """
    x, (least, _), has_markers = along(data, "ber")[0], BER_SHOWN, False
    for line, (_, values, _, _) in zip(list(ax.get_lines()), curves(data, "ber"), strict=False):
        is_below = np.asarray(values < least)
        if line.get_marker() == "None" and not is_below.all():
            continue
        x_low, has_markers = x[is_below], has_markers or bool(is_below.any())
        ax.plot(x_low, np.full(len(x_low), least), "v", color=line.get_color(), ms=5, clip_on=False)
    if has_markers:
        ax.plot([], [], "v", color=INK, ms=5, label=f"below {number(least)}")
    ax.axhline(limit, color=INK, lw=0.8, ls="--")
    return finished(ax, legend=has_markers, yscale="log", ylim=BER_SHOWN)


def plot_performance(
    performance: LinkPerformance, *, quantity: str = "ber", ax: Axes | None = None
) -> Axes:
    """Plot a quantity of a link over depth with its confidence band, one curve per bit rate.

    At a single depth, the abscissa is the bit rate.

    Parameters
    ----------
    performance : LinkPerformance
        As returned by `link_performance`.
    quantity : str
        "ber", "outage", "received_power", "gain" or another estimate in it.
    ax : matplotlib Axes, optional
        Axes to draw on. The background light is written above them, the status of the calibration
        below.

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
        if not math.isnan(performance.depths[0]):
            ax.set_title(f"depth {performance.depths[0]:g} m", loc="left")
    if f"{quantity}_low" in shown:
        seas = performance.provenance["realizations"]
        band = f"n = {seas} seas, band: {100.0 * performance.confidence:g} %"
        note(ax, f"{band}, {_light_name(performance)}")
    caption = performance.status, (0.0, -0.17)
    ax.annotate(*caption, xycoords="axes fraction", fontsize=7.5, va="top", wrap=True)
    return ax


def _light_name(performance: LinkPerformance) -> str:
    from meshtrace.comms.background import name_of_light

    return f"background light: {verbatim(name_of_light(performance.background_light))}"


def plot_winds(result: DepthSweep, *, ax: Axes | None = None) -> Axes:
    """Plot the bit error rate at the first bit rate over depth, one curve per wind speed.

    At a single depth, the abscissa is the wind speed, with one curve for each bit rate.
    """
    data, first = result.to_dataset(), result.performances[0]
    title = _light_name(first)
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
    """Name the curves of a dataset by bit rate, or drop the dimension of a single depth."""
    if data.sizes.get("depth") == 1:
        return data.isel(depth=0, drop=True)
    return data.assign_coords(bit_rate=[f"{r / 1e6:g} Mbit/s" for r in data["bit_rate"].values])


def positive(data: xr.Dataset, quantity: str) -> xr.Dataset:
    """Prepare a variable for a logarithmic axis: zeros become nan, lower limits of 0 tiny."""
    values = variable(data, quantity)
    shown = data.assign({quantity: values.where(values > 0.0)})
    # a band down to 0 reaches below the axis, but must have a logarithm
    low = f"{quantity}_low"
    return shown.assign({low: data[low].clip(min=1e-300)}) if low in data else shown
