"""Plots of every kind of result, one function each; all return the matplotlib axes.

Curves are given as arrays, xarray objects or functions of the abscissa, under the names that
the legend shows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from numpy.typing import ArrayLike, NDArray

from meshtrace.fading import (
    DistributionFit,
    fit_gamma_gamma,
    fit_lognormal,
    gain_cdf,
    gain_pdf,
    remove_noise,
)
from meshtrace.fields import FIELDS
from meshtrace.impulse import ImpulseResponse
from meshtrace.pulses import Eye
from meshtrace.result import FATE_MEANING, Fate, GainResult

from .style import INK, PALETTE, axes, axis_label

if TYPE_CHECKING:
    import xarray as xr

    from meshtrace.fading import FadingStatistics
    from meshtrace.series import CoverageMap, GainSeries

Floats = NDArray[np.float64]
Curve = ArrayLike | Callable[[Floats], ArrayLike]
Curves = Mapping[str, Curve] | Curve

_FITS: dict[str, Callable[[Floats], DistributionFit]] = {
    "lognormal": fit_lognormal,
    "gamma-gamma": fit_gamma_gamma,
}
BER_FLOOR = 1e-12
"""Error ratios below are not drawn."""


def _named(curves: Curves) -> Mapping[str, Curve]:
    return curves if isinstance(curves, Mapping) else {"": curves}


def _values(curve: Curve, x: Floats) -> Floats:
    return np.asarray(curve(x) if callable(curve) else curve, dtype=float)


def _label(name: str) -> str:
    """Return the label of a registered variable, or the text as it is."""
    return axis_label(name) if name in FIELDS else name


def _draw(ax: Axes, x: Floats, curves: Curves, scale: float = 1.0) -> None:
    """Draw curves over x / scale, with a legend where they have names."""
    for name, curve in _named(curves).items():
        ax.plot(x * scale, _values(curve, x), label=name or None)
    if any(_named(curves)):
        ax.legend()


# --- optics ----------------------------------------------------------------------------------


def plot_phase_function(
    curves: Curves, theta: ArrayLike | None = None, *, ax: Axes | None = None
) -> Axes:
    r"""Plot phase functions over the scattering angle, both logarithmic.

    Parameters
    ----------
    curves : function or array, or mapping of str to these
        Phase functions [sr-1], such as `FournierForand().pdf`.
    theta : array_like, optional
        Scattering angles [rad]; 0.1 to 180 degrees by default.
    ax : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    Axes

    Examples
    --------
    >>> import meshtrace as mt
    >>> plot_phase_function({"FF": mt.FournierForand().pdf}).get_xlabel()
    'scattering angle $\\theta$ [°]'
    """
    ax = axes(ax)
    _draw(ax, _angles(theta), curves, np.degrees(1.0))
    ax.set(xscale="log", yscale="log", ylabel=axis_label("phase_function"))
    return _theta_axis(ax)


def plot_phase_cdf(
    curves: Curves, theta: ArrayLike | None = None, *, ax: Axes | None = None
) -> Axes:
    """Plot the probability of a scattering angle up to theta; arguments as `plot_phase_function`.

    Parameters
    ----------
    curves : function or array, or mapping of str to these
        Distribution functions, such as `FournierForand().cdf`.
    theta : array_like, optional
        Scattering angles [rad].
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes
    """
    ax = axes(ax)
    _draw(ax, _angles(theta), curves, np.degrees(1.0))
    ax.set(xscale="log", ylim=(0.0, 1.02), ylabel=r"distribution function $P(\theta)$")
    return _theta_axis(ax)


def _angles(theta: ArrayLike | None) -> Floats:
    return np.radians(np.geomspace(0.1, 180.0, 400)) if theta is None else np.asarray(theta, float)


def _theta_axis(ax: Axes) -> Axes:
    ax.set_xlabel(f"{FIELDS['theta'].long_name} ${FIELDS['theta'].symbol}$ [°]")
    ax.xaxis.set_major_formatter("{x:g}")
    return ax


def plot_bubble_profile(
    curves: Curves,
    depth: ArrayLike | None = None,
    *,
    quantity: str = "b_bub",
    ax: Axes | None = None,
) -> Axes:
    """Plot a quantity of the bubbles over the depth, which points down.

    Parameters
    ----------
    curves : function or array, or mapping of str to these
        The quantity at the depths, such as `HallNovarini(wind_speed=13.0).b`.
    depth : array_like, optional
        Depths [m]; 0 to 10 m by default.
    quantity : str
        "b_bub" or "n_bubbles", or a label of its own.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes
    """
    ax = axes(ax)
    z = np.linspace(0.0, 10.0, 201) if depth is None else np.asarray(depth, dtype=float)
    for name, curve in _named(curves).items():
        ax.plot(_values(curve, z), z, label=name or None)
    if any(_named(curves)):
        ax.legend()
    ax.set(xscale="log", xlabel=_label(quantity), ylabel=axis_label("depth"))
    ax.set_ylim(z.max(), z.min())
    return ax


# --- sea -------------------------------------------------------------------------------------


def plot_spectrum(curves: Curves, omega: ArrayLike, *, ax: Axes | None = None) -> Axes:
    """Plot wave frequency spectra.

    Parameters
    ----------
    curves : function or array, or mapping of str to these
        S(omega) [m2 s rad-1], such as `JonswapSea().spectrum`.
    omega : array_like
        Angular frequencies [rad s-1].
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes
    """
    ax = axes(ax)
    _draw(ax, np.asarray(omega, dtype=float), curves)
    ax.set(xlabel=axis_label("omega"), ylabel=axis_label("spectrum"))
    ax.set_ylim(bottom=0.0)
    return ax


def plot_spreading(curves: Curves, theta: ArrayLike, *, ax: Axes | None = None) -> Axes:
    """Plot directional spreadings over the direction off the wind.

    Parameters
    ----------
    curves : function or array, or mapping of str to these
        D(theta) [rad-1].
    theta : array_like
        Directions off the wind [rad].
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes
    """
    ax = axes(ax)
    _draw(ax, np.asarray(theta, dtype=float), curves, np.degrees(1.0))
    ax.set(xlabel=r"direction off the wind $\theta$ [°]")
    ax.set(ylabel=r"directional spreading $D(\theta)$ [rad$^{-1}$]")
    ax.set_ylim(bottom=0.0)
    return ax


# --- gain ------------------------------------------------------------------------------------


def plot_fates(result: GainResult, *, ax: Axes | None = None) -> Axes:
    """Plot what became of the light: share of the launched weight by fate, logarithmic.

    Parameters
    ----------
    result : GainResult
        Result of the analog estimator.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        If the result has no fates.
    """
    if not result.fates:
        raise ValueError('result: no fates, allowed a result of estimator="analog"')
    ax = axes(ax)
    shares = {name: tally.weight for name, tally in result.fates.items() if tally.weight > 0.0}
    meanings = [FATE_MEANING[Fate[name.upper()]] for name in shares]
    bars = ax.barh(meanings, list(shares.values()), color=PALETTE["blue"])
    ax.bar_label(bars, [f"{v:.2g}" for v in shares.values()], padding=3, fontsize=9)
    decades = 10.0 ** np.arange(np.floor(np.log10(min(shares.values()))), 1.0)
    ax.set(xscale="log", xlabel="share of the emitted light", xticks=decades)
    ax.set_xlim(decades[0], 10.0)  # what is written beside the bars needs room
    ax.invert_yaxis()
    ax.grid(axis="y", visible=False)
    return ax


def plot_gain_series(
    series: GainSeries | xr.Dataset | ArrayLike,
    gain: ArrayLike | None = None,
    gain_stderr: ArrayLike | None = None,
    *,
    ax: Axes | None = None,
) -> Axes:
    """Plot the gain over time, or over realizations, with a band of two standard errors.

    Parameters
    ----------
    series : GainSeries, xarray.Dataset or array_like, shape (n,)
        A series, or its times [s].
    gain, gain_stderr : array_like, shape (n,) or (n, receivers), optional
        Gains and their standard errors, with times as arrays.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        If times come without gains.
    """
    x, values, errors, along = _series(series, gain, gain_stderr)
    ax = axes(ax)
    for i, (g, e) in enumerate(zip(values.T, errors.T, strict=True)):
        name = f"receiver {i}" if values.shape[1] > 1 else None
        (line,) = ax.plot(x, g, label=name)
        ax.fill_between(x, g - 2.0 * e, g + 2.0 * e, color=line.get_color(), alpha=0.25, lw=0)
    if values.shape[1] > 1:
        ax.legend()
    ax.set(xlabel=_label(along), ylabel=axis_label("gain"))
    return ax


def _series(
    series: Any, gain: ArrayLike | None, stderr: ArrayLike | None
) -> tuple[Floats, Floats, Floats, str]:
    """Return abscissa (n,), gains and errors (n, receivers), and what the abscissa is."""
    if hasattr(series, "to_dataset") and not hasattr(series, "dims"):
        series = series.to_dataset()
    if hasattr(series, "data_vars"):
        along = str(series["gain"].dims[0])
        gain, stderr = series["gain"].to_numpy(), series["gain_stderr"].to_numpy()
        x = series[along].to_numpy() if along == "time" else np.arange(series.sizes[along])
    elif gain is None:
        raise ValueError("gain: None, allowed an array with times as arrays")
    else:
        along, x = "time", np.asarray(series, dtype=float)
    values = np.asarray(gain, dtype=float).reshape(len(x), -1)
    errors = np.zeros_like(values) if stderr is None else np.reshape(stderr, values.shape)
    return np.asarray(x, dtype=float), values, np.asarray(errors, dtype=float), along


def plot_gain_pdf(
    gain: ArrayLike,
    gain_stderr: ArrayLike | None = None,
    *,
    fits: Sequence[str] = ("lognormal", "gamma-gamma"),
    bins: int | str = "auto",
    ax: Axes | None = None,
) -> Axes:
    """Plot the density of the gain with its standard errors, and fitted fading laws.

    Parameters
    ----------
    gain, gain_stderr : array_like, shape (n,)
        Gains and their standard errors, whose share of the variance is removed.
    fits : sequence of str
        Laws to fit: "lognormal", "gamma-gamma".
    bins : int or str
        Number of bins or a rule of `numpy.histogram_bin_edges`.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        If a law is unknown or the gains cannot be fitted.
    """
    laws = _fitted(gain, gain_stderr, fits)
    histogram = gain_pdf(gain, gain_stderr, bins=bins)
    ax = axes(ax)
    middle = 0.5 * (histogram.edges[1:] + histogram.edges[:-1])
    ax.stairs(histogram.density, histogram.edges, fill=True, color=PALETTE["sky"], alpha=0.45)
    ax.errorbar(middle, histogram.density, histogram.density_stderr, fmt="none", ecolor=INK, lw=0.9)
    x = np.linspace(histogram.edges[0], histogram.edges[-1], 400)
    x = x[x > 0.0]
    for name, law in laws.items():
        ax.plot(x, law.pdf(x), label=f"{name}, index {law.scintillation_index:.3g}")
    if laws:
        ax.legend()
    ax.set(xlabel=axis_label("gain"), ylabel=axis_label("gain_pdf"))
    return ax


def plot_gain_cdf(
    gain: ArrayLike,
    gain_stderr: ArrayLike | None = None,
    *,
    fits: Sequence[str] = ("lognormal", "gamma-gamma"),
    n_effective: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot the distribution function of the gain, logarithmic, with a 95 % band and fitted laws.

    Parameters
    ----------
    gain, gain_stderr : array_like, shape (n,)
        Gains and their standard errors, whose share of the variance is removed.
    fits : sequence of str
        Laws to fit: "lognormal", "gamma-gamma".
    n_effective : float, optional
        Independent samples, for the band; see `fading.effective_samples`.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        If a law is unknown or the gains cannot be fitted.
    """
    laws = _fitted(gain, gain_stderr, fits)
    empirical = gain_cdf(gain, gain_stderr, n_effective=n_effective)
    ax = axes(ax)
    ax.step(empirical.gain, empirical.probability, where="post", color=INK, label="simulated")
    ax.fill_between(
        empirical.gain, empirical.low, empirical.high, step="post", color=INK, alpha=0.15, lw=0
    )
    x = np.linspace(empirical.gain[0], empirical.gain[-1], 400)
    for name, law in laws.items():
        ax.plot(x, law.cdf(x), label=name)
    ax.legend()
    ax.set(yscale="log", xlabel=axis_label("gain"), ylabel=axis_label("gain_cdf"))
    ax.set_ylim(0.5 / len(empirical.gain), 1.3)
    return ax


def _fitted(
    gain: ArrayLike, stderr: ArrayLike | None, names: Sequence[str]
) -> dict[str, DistributionFit]:
    for name in names:
        if name not in _FITS:
            raise ValueError(f"fits: {name!r}, allowed {', '.join(_FITS)}")
    clean = remove_noise(gain, stderr)
    return {name: _FITS[name](clean) for name in names}


def plot_autocorrelation(statistics: FadingStatistics, *, ax: Axes | None = None) -> Axes:
    """Plot the autocorrelation of the gain with the coherence time at 1/e.

    Parameters
    ----------
    statistics : FadingStatistics
        Of a time series.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        If the statistics are those of an ensemble.
    """
    if statistics.lag is None or statistics.autocorrelation is None:
        raise ValueError("statistics: of an ensemble, allowed those of a time series")
    ax = axes(ax)
    ax.plot(statistics.lag, statistics.autocorrelation)
    ax.axhline(np.exp(-1.0), color=INK, lw=0.8, ls="--")
    tau = statistics.coherence_time
    if tau is not None and np.isfinite(tau.value):
        shade = PALETTE["vermilion"]
        ax.axvspan(tau.low, tau.high, color=shade, alpha=0.15, lw=0)
        ax.axvline(tau.value, color=shade, label=f"coherence time {tau.value:.3g} s")
        ax.legend()
    ax.set(xlabel=axis_label("lag"), ylabel=axis_label("autocorrelation"))
    return ax


def plot_coverage(
    coverage: CoverageMap | xr.Dataset, *, decibel: bool = False, ax: Axes | None = None
) -> Axes:
    """Plot a coverage map, with its axes alike.

    Parameters
    ----------
    coverage : CoverageMap or xarray.Dataset
        The map, with x, y and gain.
    decibel : bool
        Show 10 log10 of the gain.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes
    """
    x, y, gain = (np.asarray(v) for v in (coverage.x, coverage.y, coverage.gain))
    ax, label = axes(ax), axis_label("gain")
    if decibel:
        with np.errstate(divide="ignore"):
            gain, label = 10.0 * np.log10(gain), f"{label} [dB]"
        gain = np.where(np.isfinite(gain), gain, np.nan)
    image = ax.pcolormesh(x, y, gain.T, shading="nearest", rasterized=True)
    ax.figure.colorbar(image, ax=ax, label=label)
    ax.set(aspect="equal", xlabel=axis_label("x"), ylabel=axis_label("y"))
    ax.grid(visible=False)
    return ax


def plot_sweep(
    x: Any,
    curves: Curves | None = None,
    errors: Curves | None = None,
    *,
    along: str = "",
    quantity: str = "gain",
    log: bool = True,
    ax: Axes | None = None,
) -> Axes:
    """Plot a quantity over a parameter of the link, with bands of two standard errors.

    Parameters
    ----------
    x : array_like or xarray.Dataset
        Values of the parameter, or a dataset with `quantity` and its `_stderr` along one
        dimension.
    curves, errors : array, or mapping of str to these
        The quantity, and its standard error under the same names.
    along : str
        Name of the parameter in `meshtrace.fields`, or a label of its own.
    quantity : str
        Name of the quantity in `meshtrace.fields`, or a label of its own.
    log : bool
        Logarithmic ordinate.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        If the abscissa comes without curves.
    """
    if hasattr(x, "data_vars"):
        along = along or str(x[quantity].dims[0])
        curves, errors = x[quantity].to_numpy(), x[f"{quantity}_stderr"].to_numpy()
        x = x[x[quantity].dims[0]].to_numpy()
    if curves is None:
        raise ValueError("curves: None, allowed arrays over x")
    at, named = np.asarray(x, dtype=float), _named(curves)
    bands = _named(errors) if errors is not None else {}
    ax = axes(ax)
    for name, curve in named.items():
        values = _values(curve, at)
        (line,) = ax.plot(at, values, "o-", markersize=4, label=name or None)
        if name in bands:
            e = 2.0 * _values(bands[name], at)
            ax.fill_between(at, values - e, values + e, color=line.get_color(), alpha=0.25, lw=0)
    if any(named):
        ax.legend()
    ax.set(xlabel=_label(along), ylabel=_label(quantity), yscale="log" if log else "linear")
    return ax


def plot_convergence(
    spacing: ArrayLike,
    curves: Curves,
    errors: Curves | None = None,
    *,
    quantity: str = "relative error of the gain",
    ax: Axes | None = None,
) -> Axes:
    """Plot errors over the mesh spacing with the order that a straight line fits.

    error = C spacing^p, by least squares of the logarithms, weighted by the standard errors.

    Parameters
    ----------
    spacing : array_like, shape (n,)
        Mesh spacings [m], n >= 2.
    curves, errors : array, or mapping of str to these
        Errors, > 0, and their standard errors under the same names.
    quantity : str
        Name of the error in `meshtrace.fields`, or a label of its own.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        If an error is not positive, or there are fewer than two spacings.
    """
    at, bands = np.asarray(spacing, dtype=float), _named(errors) if errors is not None else {}
    ax = axes(ax)
    for name, curve in _named(curves).items():
        values = _values(curve, at)
        stderr = _values(bands[name], at) if name in bands else None
        order, factor = fitted_order(at, values, stderr)
        label = f"{name}, order {order:.2f}" if name else f"order {order:.2f}"
        marks = ax.errorbar(at, values, stderr, fmt="o", capsize=2, label=label)
        ax.plot(at, factor * at**order, color=marks[0].get_color(), lw=1.0)
    ax.legend()
    ax.set(xscale="log", yscale="log", xlabel=axis_label("spacing"), ylabel=_label(quantity))
    ax.set_xticks(at, [f"{value:g}" for value in at])
    ax.set_xticks([], minor=True)
    return ax


def fitted_order(spacing: Floats, error: Floats, stderr: Floats | None) -> tuple[float, float]:
    """Return order p and factor C of error = C spacing^p.

    Examples
    --------
    >>> order, factor = fitted_order(np.array([0.1, 0.2]), np.array([0.03, 0.12]), None)
    >>> round(order, 12), round(factor, 12)
    (2.0, 3.0)
    """
    if len(spacing) < 2 or not (error > 0.0).all():
        raise ValueError(f"curves: {error}, allowed at least two errors > 0")
    weights = None if stderr is None else error / stderr
    order, log_factor = np.polyfit(np.log(spacing), np.log(error), 1, w=weights)
    return float(order), float(np.exp(log_factor))


# --- signals ---------------------------------------------------------------------------------


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
    x: ArrayLike, curves: Curves, *, along: str = "received_power", ax: Axes | None = None
) -> Axes:
    """Plot bit error ratios, logarithmic, over power, gain, depth or whatever else.

    Parameters
    ----------
    x : array_like
        Abscissa; a received power is shown in dBm.
    curves : function or array, or mapping of str to these
        Bit error ratios, such as `OokLink().ber`.
    along : str
        Name of the abscissa in `meshtrace.fields`, or a label of its own.
    ax : matplotlib Axes, optional
        Where to draw.

    Returns
    -------
    Axes
    """
    ax, at, label = axes(ax), np.asarray(x, dtype=float), _label(along)
    shown = at
    if along == "received_power":
        shown, label = 10.0 * np.log10(at / 1e-3), f"{FIELDS[along].long_name} [dBm]"
    for name, curve in _named(curves).items():
        values = _values(curve, at)
        ax.plot(shown, np.where(values >= BER_FLOOR, values, np.nan), label=name or None)
    if any(_named(curves)):
        ax.legend()
    ax.axhline(1e-3, color=INK, lw=0.8, ls="--")
    ax.set(yscale="log", xlabel=label, ylabel=axis_label("ber"))
    ax.set_ylim(1e-9, 1.0)
    return ax
