"""Plots of results of any kind, drawn by the marks of their variables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.ticker import LogLocator
from scipy.ndimage import gaussian_filter

from meshtrace import fading
from meshtrace.comms.pulses import Eye
from meshtrace.errors import Described, Refused
from meshtrace.link import Link
from meshtrace.models import Floats
from meshtrace.results.background import PARTS, Background, BackgroundSeries
from meshtrace.results.coverage import CoverageMap, as_high, place_of_highest
from meshtrace.results.gain import FATE_MEANING, Fate, GainResult
from meshtrace.results.impulse import ImpulseResponse
from meshtrace.results.irradiance import IrradianceSeries
from meshtrace.results.series import GainSeries
from meshtrace.stored import Stored
from meshtrace.studies.comparison import Comparison, Duplex
from meshtrace.studies.convergence.drivers import FadingConvergence
from meshtrace.studies.convergence.study import ConvergenceStudy
from meshtrace.studies.inference import Inference
from meshtrace.studies.optimisation import Optimum
from meshtrace.studies.sensitivity.study import Sensitivities, swings
from meshtrace.studies.traces import ChannelTrace
from meshtrace.uav import Route
from meshtrace.validation.measured.suite import MeasuredTable

from . import marks
from .plots_curves import plot_curves, plot_performance, plot_sweep, plot_winds
from .style import INK, LED_COLOR, PALETTE, axis_label, label_of, verbatim

_SHOWN = 1e-6  # of the largest bar, down to which bars are drawn
_LARGEST_ERROR = 0.4  # of a bin of an impulse response that is drawn, over its value
_FITS = {"lognormal": fading.fit_lognormal, "gamma-gamma": fading.fit_gamma_gamma}
_LINE: Any = {"color": INK, "lw": 0.8}

_COSTS = {
    "gain": "minus logarithm of the mean gain",
    "outage": "quantile of ln(needed gain / gain)",
    "range": "minus range [m]",
    "margin": "minus logarithm of the margin",
    "custom": "cost",
}
"""What each objective of an optimisation minimises."""


def plot(result: Stored | xr.Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot a result of any kind, or the dataset of a sweep.

    Parameters
    ----------
    result : result or xarray.Dataset
        As returned by a study, `meshtrace.results.load` or `sweep`.
    ax : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes

    Raises
    ------
    Refused
        If there is no plot of this kind.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import FlatSea
    >>> plot(mt.simulate(mt.Link(), FlatSea(), photons=64)).get_xlabel()
    'number of scatterings $n$'
    """
    if isinstance(result, xr.Dataset):
        return plot_sweep(result, quantity="ber" if "ber" in result else "gain", ax=ax)
    kind = getattr(result, "kind", None)
    if kind not in _PLOTS:
        raise Refused("result", Described(type(result).__name__), f"a {', '.join(_PLOTS)}")
    return _PLOTS[kind](result, ax=ax)


# ---- gains -----------------------------------------------------------------------------------


def plot_gain(result: GainResult, *, ax: Axes | None = None) -> Axes:
    """Plot the fates of analog light, or the gain of forced detection by order of scattering.

    Parameters
    ----------
    result : GainResult
        Gain of one link.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    if result.gain_order is None:
        return plot_fates(result, ax=ax)
    direct = np.atleast_1d(0.0 if result.gain_ballistic is None else result.gain_ballistic)
    gains = np.column_stack([direct, result.gain_order])
    most, names = float(gains.max()), [f"receiver {i}" for i in range(len(gains))]
    last = max(np.flatnonzero((gains > _SHOWN * most).any(axis=0)), default=0)
    found = {"gain": np.where(gains > 0.0, gains, np.nan)}
    data = marks.dataset(found, receiver=names, order=range(gains.shape[1]))
    ax = marks.bars(marks.axes(ax), data if len(gains) > 1 else data.isel(receiver=0), "gain")
    if most > 0.0:
        ax.set(yscale="log", ylim=(_SHOWN * most, 2.0 * most))
    ax.set_xlim(-0.6, last + 0.6)
    return ax


def plot_fates(result: GainResult, *, ax: Axes | None = None) -> Axes:
    """Plot the fates of the light: share of the launched weight, logarithmic.

    Parameters
    ----------
    result : GainResult
        Result of the analog estimator.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes

    Raises
    ------
    Refused
        If the result has no fates.
    """
    shares = {name: tally.weight for name, tally in result.fates.items() if tally.weight > 0.0}
    if not shares:
        raise Refused("result", Described("no fates"), 'a result of estimator="analog"')
    meanings, values = [FATE_MEANING[Fate[name.upper()]] for name in shares], list(shares.values())
    ax = marks.bars(
        marks.axes(ax), marks.dataset({"share": values}, fate=meanings), "share", across=True
    )
    ax.bar_label(ax.containers[0], [f"{v:.2g}" for v in values], padding=3, fontsize=9)  # type: ignore[arg-type]
    decades = 10.0 ** np.arange(np.floor(np.log10(min(values))), 1.0)
    # room for the numbers beside the bars
    ax.set(xscale="log", xlabel="share of the emitted light", xticks=decades)
    ax.set_xlim(decades[0], 10.0)
    return ax


def plot_gain_series(series: GainSeries | xr.Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot the gain over time, or of each realization, with two standard errors.

    Parameters
    ----------
    series : GainSeries or xarray.Dataset
        A series, or a dataset with `gain` and `gain_stderr` over "time" or "realization" and,
        in the second place, receivers.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    data = _dataset(series, "gain", "gain_stderr")[["gain", "gain_stderr"]]
    along, *others = data["gain"].dims
    if along == "realization":  # seeds
        data = data.assign_coords(realization=np.arange(data.sizes[along]))
    for receiver in others[:1]:
        names = [f"receiver {i}" for i in range(data.sizes[receiver])]
        data = data.transpose(receiver, along).assign_coords({receiver: names})
    return plot_curves(data, "gain", style="o" if along == "realization" else "-", ax=ax)


def plot_series(series: GainSeries, *, ax: Axes | None = None) -> Axes:
    """Plot a series over time, and the density of the gains of an ensemble of one receiver."""
    if series.along == "time" or series.gain.ndim > 1:
        return plot_gain_series(series, ax=ax)
    try:
        return plot_gain_pdf(series, ax=ax)
    except Refused:  # too few seas for a law, or dark ones
        return plot_gain_series(series, ax=ax)


def plot_route(series: GainSeries, *, ax: Axes | None = None) -> Axes:
    """Plot the gain along the route of a receiver, from above.

    Parameters
    ----------
    series : GainSeries
        Of `time_series` with a route.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes

    Raises
    ------
    Refused
        If the receiver of the series does not move.
    """
    origin = getattr(series, "provenance", {})
    if "route" not in origin:
        raise Refused("series", Described("no route"), "a time series along a route")
    ax, route = marks.axes(ax), Route.model_validate(origin["route"])
    x, y = route.at(series.time, 1.0).position.T
    ax.plot(*np.transpose(route.positions), zorder=1, **_LINE)
    points = ax.scatter(x, y, c=series.gains[:, 0], s=24, zorder=2)
    side = "bottom" if np.ptp(x) > 1.5 * np.ptp(y) else "right"
    ax.figure.colorbar(points, ax=ax, label=axis_label("gain"), location=side)
    link = Link.model_validate(origin["link"])
    places = np.transpose([source.position for source in link.transmitters])
    ax.plot(*places, "*", color=LED_COLOR, mec=INK, ms=12, zorder=1.5, label="source")
    return marks.finished(ax, "x", "y", aspect="equal")


def plot_gain_pdf(
    series: GainSeries | xr.Dataset,
    *,
    fits: Sequence[str] = ("lognormal", "gamma-gamma"),
    bins: int | str = "auto",
    ax: Axes | None = None,
) -> Axes:
    """Plot the density of the gain with two standard errors, and fitted fading laws.

    Parameters
    ----------
    series : GainSeries or xarray.Dataset
        With `gain` and `gain_stderr` of one receiver; the noise is removed from the variance.
    fits : sequence of str
        Laws to fit: "lognormal", "gamma-gamma".
    bins : int or str
        Number of bins or a rule of `numpy.histogram_bin_edges`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes

    Raises
    ------
    Refused
        If a law is unknown or the gains cannot be fitted.
    """
    gain, laws = _fitted(series, fits)
    edges, found, stderr = fading.gain_pdf(*gain, bins=bins)
    ax = marks.axes(ax)
    ax.stairs(found, edges, fill=True, color=PALETTE["sky"], alpha=0.45)
    middle = 0.5 * (edges[1:] + edges[:-1])
    ax.errorbar(middle, found, 2.0 * stderr, fmt="none", ecolor=INK, lw=0.9)
    x = np.linspace(edges[0], edges[-1], 400)
    x = x[x > 0.0]
    for name, fit in laws.items():
        ax.plot(x, fit.law.pdf(x), label=f"{name}, index {fit.scintillation_index:.3g}")
    marks.note(ax, f"n = {np.size(gain[0])}, bars: ± 2 standard errors")
    return marks.finished(ax, "gain", "gain_pdf", ylim=(0.0, None))


def plot_gain_cdf(
    series: GainSeries | xr.Dataset,
    *,
    fits: Sequence[str] = ("lognormal", "gamma-gamma"),
    n_effective: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Plot the distribution function of the gain, logarithmic, with a 95 % band and fitted laws.

    Parameters
    ----------
    series, fits, ax
        As in `plot_gain_pdf`.
    n_effective : float, optional
        Independent samples, for the band; see `fading.effective_samples`.

    Returns
    -------
    Axes

    Raises
    ------
    Refused
        If a law is unknown or the gains cannot be fitted.
    """
    gain, laws = _fitted(series, fits)
    found = fading.gain_cdf(*gain, n_effective=n_effective)
    ax = marks.axes(ax)
    look: Any = {"color": INK, "label": "simulated", "drawstyle": "steps-post"}
    (line,) = ax.plot(found.gain, found.probability, **look)
    marks.band(ax, line, found.low, found.high)
    x = np.linspace(found.gain[0], found.gain[-1], 400)
    for dashes, (name, fit) in zip(("-", "--"), laws.items(), strict=False):
        ax.plot(x, fit.law.cdf(x), dashes, label=name)
    marks.note(ax, f"n = {len(found.gain)}, band: 95 %")
    return marks.finished(ax, "gain", "gain_cdf", yscale="log", ylim=(0.5 / len(found.gain), 1.3))


def _fitted(
    series: GainSeries | xr.Dataset, names: Sequence[str]
) -> tuple[tuple[Floats, Floats], dict[str, fading.DistributionFit]]:
    """Return gains with their standard errors, and the laws fitted to them."""
    for name in names:
        if name not in _FITS:
            raise Refused("fits", name, ", ".join(_FITS))
    data = _dataset(series, "gain", "gain_stderr")
    gain = data["gain"].to_numpy(), data["gain_stderr"].to_numpy()
    clean = fading.remove_noise(*gain)
    return gain, {name: _FITS[name](clean) for name in names}


def _dataset(result: GainSeries | CoverageMap | xr.Dataset, *names: str) -> xr.Dataset:
    """Return a result as a dataset with the named variables, each of one dimension or more."""
    data = result if isinstance(result, xr.Dataset) else result.to_dataset()
    for name in names:
        if name not in data or not data[name].ndim or data[name].dtype.kind not in "biuf":
            found = data[name].dims if name in data else None
            raise Refused(name, found, f"numbers {', '.join(names)} over one dimension or more")
    return data


def plot_autocorrelation(
    statistics: fading.FadingStatistics | fading.ChannelModel, *, ax: Axes | None = None
) -> Axes:
    """Plot the autocorrelation of the gain with the coherence time at 1/e, or that of a model.

    Parameters
    ----------
    statistics : FadingStatistics or ChannelModel
        Of a time series; of a model also that of the series, with two standard errors.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes

    Raises
    ------
    Refused
        If the statistics are those of an ensemble.
    """
    if isinstance(statistics, fading.ChannelModel):
        error, name = statistics.autocorrelation_stderr, "autocorrelation"
        rows = [statistics.autocorrelation, statistics.model_autocorrelation]
        both = {name: rows, f"{name}_stderr": [error, 0.0 * error]}
        data = marks.dataset(both, curve=["series", "model"], lag=statistics.lag)
        return marks.finished(marks.lines(marks.axes(ax), data, name))
    if statistics.lag is None or statistics.autocorrelation is None:
        raise Refused("statistics", Described("of an ensemble"), "those of a time series")
    data = marks.dataset({"autocorrelation": statistics.autocorrelation}, lag=statistics.lag)
    ax = marks.lines(marks.axes(ax), data, "autocorrelation")
    ax.axhline(np.exp(-1.0), ls="--", **_LINE)
    tau = statistics.coherence_time
    if tau is not None and np.isfinite(tau.value):
        shade = PALETTE["vermilion"]
        step = float(statistics.lag[1] - statistics.lag[0])
        finer = tau.value > step  # shorter ones are an interpolation between two samples
        label = f"coherence time {tau.value:.3g} s" if finer else f"coherence time < {step:.3g} s"
        ax.axvspan(tau.low, tau.high, color=shade, alpha=0.15, lw=0)
        ax.axvline(tau.value, color=shade, label=label)
        marks.note(ax, f"samples every {step:.3g} s, band: interval of the coherence time")
    return marks.finished(ax)


def plot_coverage(
    coverage: CoverageMap | xr.Dataset, *, decibel: bool = False, ax: Axes | None = None
) -> Axes:
    """Plot a coverage map with equal axes, contours, and the place of the highest gain.

    Contours at 3, 6, 10 and 20 dB below the highest gain are those of the map smoothed by a cell.
    The place is marked where errors resolve it, see `results.coverage.place_of_highest`.

    Parameters
    ----------
    coverage : CoverageMap or xarray.Dataset
        The map, with x, y and gain, and `gain_stderr` for the place of the highest gain.
    decibel : bool
        Show 10 log10 of the gain.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    data = _dataset(coverage, "x", "y", "gain")
    x, y, gain = (data[name].to_numpy() for name in ("x", "y", "gain"))
    if gain.shape != (*x.shape, *y.shape) or not gain.size:
        raise Refused("gain", Described(f"shape {gain.shape}"), "values over x and y")
    unknown = np.full(gain.shape, np.inf)
    stderr = data["gain_stderr"].to_numpy() if "gain_stderr" in data else unknown
    place, level = place_of_highest(gain, stderr), as_high(gain, stderr).sum()
    ax, label, shown = marks.axes(ax), axis_label("gain"), gain
    smooth = gaussian_filter(gain, 1.0, mode="nearest")
    if decibel:
        shown, label = 10.0 * np.log10(np.where(gain > 0.0, gain, np.nan)), f"{label} [dB]"
    marks.heat_map(ax, x, y, shown, label)
    if min(gain.shape) > 2 and smooth.max() > smooth.min():
        below = 10.0 * np.log10(np.maximum(smooth / smooth.max(), 1e-12))
        look: Any = {"colors": "white", "linewidths": 1.0, "linestyles": "-"}
        lines = ax.contour(x, y, below.T, [-20.0, -10.0, -6.0, -3.0], **look)
        ax.clabel(lines, fmt=lambda v: f"{v:g} dB", fontsize=8)
    if place is not None:
        at = x[place[0]], y[place[1]]
        ax.plot(*at, "*", color=LED_COLOR, mec=INK, ms=11, clip_on=False)
        marks.note(ax, f"star: highest gain, at x = {at[0]:.3g} m, y = {at[1]:.3g} m")
    elif np.isfinite(stderr).all() and smooth.max() > 0.0:
        marks.note(ax, f"highest gain: {level} cells within errors")
    return ax


# ---- signals and background ------------------------------------------------------------------


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


# ---- studies ---------------------------------------------------------------------------------


def plot_comparison(result: Comparison, *, ax: Axes | None = None) -> Axes:
    """Plot the gains of links relative to the first link [dB], with two standard errors.

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
    ax = marks.bars(marks.axes(ax), result.to_dataset(), "gain_ratio_db", across=True)
    ax.axvline(0.0, **_LINE)
    ax.set_xlabel(f"gain over {verbatim(result.names[0])} [dB]")
    return ax


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
    gains = [series.gains[:, 0] / series.gains[:, 0].mean() for series in (result.up, result.down)]
    name, times = result.up.along, result.up.coordinate
    along = {name: times if name == "time" else range(len(times))}
    data = marks.dataset({"gain over its mean": gains}, way=["up", "down"], **along)
    return marks.finished(marks.lines(marks.axes(ax), data, "gain over its mean"), ylim=(0.0, None))


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
    rows = {"up": result.gain, "down": result.down_gain}
    gains = {name: row.reshape(len(row), -1) for name, row in rows.items() if row is not None}
    over = [row[:, 0] / row[:, 0].mean() for row in gains.values()]
    data = marks.dataset({"over its mean": over}, part=list(gains), time=result.time)
    ax = marks.lines(marks.axes(ax), data, "over its mean", ("-", "--"))
    times, light = result.background_time, result.background_radiance
    if times is not None and light is not None:
        color = list(PALETTE.values())[2]
        ax.plot(times, light / light.mean(), "o", color=color, markersize=5.0, label="background")
    return marks.finished(ax, ylim=(0.0, None))


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
    ax = marks.axes(ax)
    for k, kind in enumerate(study.normals):
        fit, percent = study.fits[kind], 100.0 / study.gain[k, -1]
        target = fit.gain.value if study.reference is None else study.anchor[k]
        scatter = np.where(study.scatter[k] > 0.0, study.scatter[k], np.nan)
        law = np.abs(fit.coefficient * study.step**fit.order.value)
        rows = percent * np.array([np.abs(study.gain[k] - target), law, scatter])
        errors = percent * np.array([study.difference_stderr[k], 0.0 * law, 0.0 * law])
        named = f"{kind} normals, mean: order {fit.order.value:.2f}", "", f"{kind} normals, scatter"
        n = 3 if np.isfinite(scatter).any() else 2
        found = {"error": rows[:n], "error_stderr": errors[:n]}
        data = marks.dataset(found, curve=named[:n], **{study.parameter: study.values})
        color = list(PALETTE.values())[k]
        marks.lines(ax, data, "error", ("o", "-", "^--"), (color,), lw=1.0, markersize=5)
    ax.axhline(100.0 * study.tolerance, color="0.5", lw=0.8, ls=":", label="tolerance")
    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter("{x:g}")
    return _over_steps(ax, study.values, ylabel="error of the gain [%]")


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
    rows = np.array([study.with_tilts, study.band_alone, study.measured])
    errors = np.array([0.0 * rows[0], 0.0 * rows[1], study.measured_stderr])
    names = ["closed form, random slopes beyond", "closed form, nothing beyond", "measured"]
    n = 3 if np.isfinite(study.measured).any() else 2
    found = {"scintillation_index": rows[:n]}
    found |= {"scintillation_index_stderr": errors} if n == 3 else {}
    data = marks.dataset(found, curve=names[:n], omega_max=study.omega_max)
    ax = marks.lines(marks.axes(ax), data, "scintillation_index", ("-", "--", "o"))
    ax.axhline(study.all_waves, ls=":", label="all waves", **_LINE)
    return _over_steps(ax, study.omega_max, yscale="log")


def _over_steps(ax: Axes, values: Floats, **settings: Any) -> Axes:
    """Return finished axes over the steps of a study, logarithmic, each step named."""
    ax.set_xscale("log")
    ax.set_xticks(values, [f"{value:g}" for value in values])
    ax.minorticks_off()
    return marks.finished(ax, **settings)


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
        Bars in dB, in m for the range, the largest on top, with whiskers of two standard errors.
    """
    found = swings(s, change)
    names = [f"{one.name}\n{one.values[0]:.4g} to {one.values[1]:.4g} {one.unit}" for one in found]
    values = {
        "change": [one.change for one in found],
        "change_stderr": [one.stderr for one in found],
    }
    data = marks.dataset(
        values, name=[name.removesuffix(" 1") for name in names], side=["lower", "higher"]
    )
    ax = marks.bars(marks.axes(ax), data.transpose(), "change", across=True, beside=False)
    ax.tick_params(axis="y", labelsize=8)
    ax.axvline(0.0, **_LINE)
    form = ".2e" if s.of == "gain" else ".3g"
    base = f"{s.value:{form}} {s.unit}".removesuffix(" 1")
    ax.set_xlabel(f"change of the {s.of} from {base} [{'m' if s.of == 'range' else 'dB'}]")
    return ax


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
    ax = marks.axes(ax)
    ax.plot(o.history[:, 0], o.history[:, -1], "o", ms=4, label="candidates")
    ax.plot(o.values[0], o.cost, "*", ms=12, color="C1", label="best")
    ax.axvspan(*o.flatness[0], color="C1", alpha=0.15, label="within one standard error")
    return marks.finished(ax, xlabel=label_of(o.variables[0]), ylabel=_COSTS[o.objective])


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
    numbers, ax = np.arange(1, len(f.measured) + 1), marks.axes(ax)
    data = marks.dataset({"measured over fitted": f.measured / f.predicted}, measurement=numbers)
    marks.lines(ax, data, "measured over fitted", ("o",), markersize=6)
    ax.axhline(1.0, **_LINE)
    return ax


def plot_measured(table: MeasuredTable, *, ax: Axes | None = None) -> Axes:
    """Plot measured over computed values, with the bands of the computed ones.

    Parameters
    ----------
    table : MeasuredTable
        Of `validation.measured.run`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    ax, kept = marks.axes(ax), np.flatnonzero(np.isfinite(table.observed) & (table.computed > 0.0))
    several = len(set(table.experiment)) > 1
    names = [(table.experiment if several else table.observable)[i] for i in kept]
    if not names:
        raise Refused("table", Described("no measured numbers"), "a table with some")
    rows, value = np.arange(len(kept)), table.computed[kept]
    ends = (table.band_low, table.band_high, table.observed_low, table.observed_high)
    low, high, least, most = (np.maximum(end[kept], 0.0) / value for end in ends)
    at = table.observed[kept] / value
    outside = np.array([table.verdict[i] == "outside" for i in kept])
    ax.hlines(rows, low, high, color=PALETTE["blue"], alpha=0.3, lw=5.0, label="computed, band")
    for chosen, color, label in (
        (~outside, "black", "measured, inside"),
        (outside, PALETTE["vermilion"], "measured, outside"),
    ):
        if chosen.any():
            errors = np.maximum(np.abs([at - least, most - at])[:, chosen], 0.0)
            style: dict[str, Any] = {"color": color, "fmt": "o", "lw": 1.2, "label": label}
            ax.errorbar(at[chosen], rows[chosen], xerr=errors, **style)
    first = [names.index(name) for name in dict.fromkeys(names)]
    ax.set_yticks(first, [verbatim(names[i]) for i in first], fontsize="small")
    ax.axvline(1.0, **_LINE)
    ax.invert_yaxis()
    return marks.finished(ax, xlabel="measured over computed")


_PLOTS: dict[str, Callable[..., Any]] = {
    "gain": plot_gain,
    "series": plot_series,
    "coverage": plot_coverage,
    "impulse-response": plot_impulse_response,
    "fading": plot_autocorrelation,
    "markov-channel": plot_autocorrelation,
    "transformed-gaussian": plot_autocorrelation,
    "performance": plot_performance,
    "depth-sweep": plot_winds,
    "convergence": plot_convergence,
    "fading-convergence": plot_fading_convergence,
    "comparison": plot_comparison,
    "duplex": plot_duplex,
    "trace": plot_trace,
    "background": plot_background,
    "background-series": plot_background,
    "irradiance-series": plot_irradiance,
    "sensitivity": plot_tornado,
    "optimum": plot_optimum,
    "inference": plot_inference,
    "measured": plot_measured,
}
