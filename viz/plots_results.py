"""Plots of results: gains, fading, maps, pulses, eye diagrams, daylight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from meshtrace import fading
from meshtrace.errors import Described, Refused
from meshtrace.models import Floats
from meshtrace.results.daylight import PARTS, Background, BackgroundSeries, IrradianceSeries
from meshtrace.results.gain import FATE_MEANING, Fate, GainResult
from meshtrace.results.impulse import ImpulseResponse
from meshtrace.results.series import CoverageMap, GainSeries, as_high, place_of_highest

from . import marks
from .plots_curves import plot_curves
from .style import INK, LED_COLOR, PALETTE, axis_label, number, verbatim

if TYPE_CHECKING:
    from meshtrace.comms.pulses import Eye

# Tuned, for the eye.
_SHOWN = 1e-6  # smallest gain of an order of scattering that is drawn, over the largest
_TIMES_SHOWN = 10.0  # length of the axis of lags, in coherence times
_COVERED = 20.0  # range of the colours of a map below its highest gain [dB]
_LARGEST_ERROR = 0.4  # largest relative standard error of a bin of an impulse response drawn
# names of functions, which load the closed forms when they are first used
_FITS = {"lognormal": "fit_lognormal", "gamma-gamma": "fit_gamma_gamma"}


def plot_gain(result: GainResult, *, ax: Axes | None = None) -> Axes:
    """Plot the fates of analog photons, or the gain of forced detection by order of scattering.

    Parameters
    ----------
    result : GainResult
        Gain of one link, with any number of receivers.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    if result.gain_order is None:
        return plot_fates(result, ax=ax)
    # column 0: unscattered light; then one per order of scattering
    unscattered = np.atleast_1d(0.0 if result.gain_ballistic is None else result.gain_ballistic)
    gains = np.column_stack([unscattered, result.gain_order])
    highest, receivers = float(gains.max()), [f"receiver {i}" for i in range(len(gains))]
    last = max(np.flatnonzero((gains > _SHOWN * highest).any(axis=0)), default=0)
    # a logarithmic axis has no place for 0
    gains = gains[:, : last + 1]
    quantities = {"gain": np.where(gains > 0.0, gains, np.nan)}
    data = marks.dataset(quantities, {"receiver": receivers, "order": range(last + 1)})
    shown = data if len(gains) > 1 else data.isel(receiver=0)
    ax = marks.lines(ax, shown, "gain", ("o:",), lw=0.8)
    if highest > 0.0:
        # below the smallest that is shown there is room for its dot
        ax.set(yscale="log", ylim=(0.5 * _SHOWN * highest, 2.0 * highest))
    ax.set_xlim(-0.6, last + 0.6)
    pairs = zip(result.gains, result.stderrs, strict=True)
    words = [f"{number(gain, '.3e')} ± {number(error, '.1e')}" for gain, error in pairs]
    more = ", ..." if len(words) > 3 else ""
    ax.set_title(f"gain {', '.join(words[:3])}{more}", loc="left")
    return ax


def plot_fates(result: GainResult, *, ax: Axes | None = None) -> Axes:
    """Plot the fates of photons as labelled bars: shares of the launched weight.

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
    data = marks.dataset({"share": values}, {"fate": meanings})
    ax = marks.bars(ax, data, "share", across=True)
    ax.bar_label(ax.containers[0], [number(v, ".2g") for v in values], padding=3, fontsize=9)  # type: ignore[arg-type]
    # room for the numbers beside the bars
    ax.set(xlabel="share of the emitted light", xlim=(0.0, 1.15 * max(values)))
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
    dimension, *receiver_dims = data["gain"].dims
    if seas := dimension == "realization":  # seeds are no abscissa: they are numbered
        data = data.assign_coords(realization=np.arange(data.sizes[dimension]))
    for receiver in receiver_dims[:1]:
        names = [f"receiver {i}" for i in range(data.sizes[receiver])]
        data = data.transpose(receiver, dimension).assign_coords({receiver: names})
    ax = plot_curves(data, "gain", style="o" if seas else "-", ax=ax)
    if seas:
        ax.set_xlabel("realization")
    return ax


def plot_correlation(series: GainSeries, *, ax: Axes | None = None) -> Axes:
    """Plot the correlation of fading between receivers, or between pairs of lamp and receiver.

    Parameters
    ----------
    series : GainSeries
        Of several receivers, or of several lamps with gains by lamp.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
        Bars with whiskers of two standard errors.

    Raises
    ------
    Refused
        If the series has a single channel, or no fading.
    """
    pairs = series.correlated_pairs()
    if not pairs or not np.isfinite(series.correlation).all():
        raise Refused("series", Described("one channel, or no fading"), "two channels that fade")
    names = [
        f"{pair.first}\n{pair.second}" + ("" if apart != apart else f", {apart:g} m")
        for pair in pairs
        for apart in [pair.distance]  # nan of pairs with lamps
    ]
    columns = {"gain_correlation": [pair.correlation for pair in pairs]}
    columns["gain_correlation_stderr"] = [pair.stderr for pair in pairs]
    data = marks.dataset(columns, {"pair": names})
    ax = marks.bars(ax, data, "gain_correlation", across=True)
    ax.axvline(0.0, color=INK, lw=0.8)
    return ax


def plot_series(series: GainSeries, *, ax: Axes | None = None) -> Axes:
    """Plot a series over time, or the density of the gains of an ensemble.

    Of an ensemble of several receivers, or by lamp, the correlation of their fading; a series in
    time of two channels has theirs as its title.
    """
    pairs = series.correlated_pairs()
    if series.along == "time":
        ax = plot_gain_series(series, ax=ax)
        if len(pairs) == 1 and np.isfinite(pairs[0].correlation):
            text = f"correlation {pairs[0].correlation:.2f} ± {pairs[0].stderr:.2f}"
            ax.set_title(text, loc="left", fontsize=8)
        return ax
    try:
        return plot_correlation(series, ax=ax) if pairs else plot_gain_pdf(series, ax=ax)
    except Refused:  # too few seas, or seas without light or fading
        return plot_gain_series(series, ax=ax)


def plot_route(series: GainSeries, *, ax: Axes | None = None) -> Axes:
    """Plot the gain along the route of a receiver, from above.

    Parameters
    ----------
    series : GainSeries
        Result of `time_series` with a route.
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
    from meshtrace.uav import Route

    ax, route = marks.axes(ax), Route.model_validate(origin["route"])
    # the height, here 1 m, does not matter from above
    x, y, _ = route.at(series.time, 1.0).T
    ax.plot(*np.transpose(route.positions), zorder=1, color=INK, lw=0.8)
    points = ax.scatter(x, y, c=series.gains[:, 0], s=24, zorder=2)
    # the colour bar along the longer side
    side = "bottom" if np.ptp(x) > 1.5 * np.ptp(y) else "right"
    ax.figure.colorbar(points, ax=ax, label=axis_label("gain"), location=side)
    from meshtrace.link import Link

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
    """Plot the probability density of the gain with two standard errors, and fitted fading laws.

    Parameters
    ----------
    series : GainSeries or xarray.Dataset
        Series with `gain` and `gain_stderr` of one receiver. For the fits the Monte Carlo noise is
        removed from the variance (`fading.remove_noise`).
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
    edges, density, density_stderr = fading.gain_pdf(*gain, bins=bins)
    ax = marks.axes(ax)
    ax.stairs(density, edges, fill=True, color=PALETTE["sky"], alpha=0.45)
    centers = 0.5 * (edges[1:] + edges[:-1])
    ax.errorbar(centers, density, 2.0 * density_stderr, fmt="none", ecolor=INK, lw=0.9)
    x = np.linspace(edges[0], edges[-1], 400)
    # bins may begin at 0, where the laws have no density
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
    """Plot the distribution function of the gain with a 95 % band and fitted laws.

    Parameters
    ----------
    series, fits, ax
        As in `plot_gain_pdf`.
    n_effective : float, optional
        Number of independent samples, for the band; see `fading.effective_samples`.

    Returns
    -------
    Axes

    Raises
    ------
    Refused
        If a law is unknown or the gains cannot be fitted.
    """
    gain, laws = _fitted(series, fits)
    cdf = fading.gain_cdf(*gain, n_effective=n_effective)
    ax = marks.axes(ax)
    (line,) = ax.plot(
        cdf.gain, cdf.probability, color=INK, label="simulated", drawstyle="steps-post"
    )
    marks.band(ax, line, cdf.low, cdf.high)
    x = np.linspace(cdf.gain[0], cdf.gain[-1], 400)
    for name, fit in laws.items():
        ax.plot(x, fit.law.cdf(x), label=name)
    marks.note(ax, f"n = {len(cdf.gain)}, band: 95 %")
    return marks.finished(ax, "gain", "gain_cdf", yscale="log", ylim=(0.5 / len(cdf.gain), 1.3))


def _fitted(
    series: GainSeries | xr.Dataset, names: Sequence[str]
) -> tuple[tuple[Floats, Floats], dict[str, fading.DistributionFit]]:
    """Return gains with their standard errors, and the laws fitted to them."""
    for name in names:
        if name not in _FITS:
            raise Refused("fits", name, ", ".join(_FITS))
    data = _dataset(series, "gain", "gain_stderr")
    gain = data["gain"].to_numpy(), data["gain_stderr"].to_numpy()
    without_noise = fading.remove_noise(*gain)
    return gain, {name: getattr(fading, _FITS[name])(without_noise) for name in names}


def _dataset(result: GainSeries | CoverageMap | xr.Dataset, *names: str) -> xr.Dataset:
    """Convert a result to a dataset; refuse it without these variables over a dimension."""
    data = result if isinstance(result, xr.Dataset) else result.to_dataset()
    for name in names:
        if name not in data or not data[name].ndim or data[name].dtype.kind not in "biuf":
            dims = data[name].dims if name in data else None
            raise Refused(name, dims, f"numbers {', '.join(names)} over one dimension or more")
    return data


def plot_autocorrelation(statistics: fading.FadingStatistics, *, ax: Axes | None = None) -> Axes:
    r"""Plot the autocorrelation of the gain with the coherence time at 1/e.

    A series without correlation would stay within the grey band, two standard errors
    :math:`\pm 2 / \sqrt{n_\mathrm{eff}}` of its effective samples. The axis ends at ten
    coherence times.

    Parameters
    ----------
    statistics : FadingStatistics
        Statistics of a time series.
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
    if statistics.lag is None or statistics.autocorrelation is None:
        raise Refused("statistics", Described("of an ensemble"), "those of a time series")
    curve = {"autocorrelation": statistics.autocorrelation}
    data = marks.dataset(curve, {"lag": statistics.lag})
    ax = marks.lines(ax, data, "autocorrelation")
    ax.axhline(np.exp(-1.0), ls="--", color=INK, lw=0.8)
    tau = statistics.coherence_time
    if tau is not None and np.isfinite(tau.value):
        shade = PALETTE["vermilion"]
        step = float(statistics.lag[1] - statistics.lag[0])
        finer = tau.value > step  # shorter ones are interpolated
        label = f"coherence time {tau.value:.3g} s" if finer else f"coherence time < {step:.3g} s"
        ax.axvspan(tau.low, tau.high, color=shade, alpha=0.15, lw=0)
        ax.axvline(tau.value, color=shade, label=label)
        noise = 2.0 / np.sqrt(statistics.n_effective)
        ax.axhspan(-noise, noise, color="0.5", alpha=0.15, lw=0, label="± 2 standard errors of 0")
        # a coherence time within a few steps would leave the axis almost empty of samples
        ax.set_xlim(0.0, min(_TIMES_SHOWN * max(tau.value, 5.0 * step), statistics.lag[-1]))
        marks.note(ax, f"samples every {step:.3g} s, band: interval of the coherence time")
    return marks.finished(ax)


def plot_coverage(
    coverage: CoverageMap | xr.Dataset, *, decibel: bool = True, ax: Axes | None = None
) -> Axes:
    """Plot a coverage map with equal axes, contours, and the place of the highest gain.

    Contours at 3, 6, 10 and 20 dB below the highest gain are those of the map smoothed by a cell.
    The place is marked where errors resolve it, see `results.series.place_of_highest`.

    Parameters
    ----------
    coverage : CoverageMap or xarray.Dataset
        The map, with x, y and gain, and `gain_stderr` for the place of the highest gain.
    decibel : bool
        Show 10 log10 of the gain, down to 20 dB below the highest one, or else the gain itself.
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
    no_errors = np.full(gain.shape, np.inf)
    stderr = data["gain_stderr"].to_numpy() if "gain_stderr" in data else no_errors
    place, cells_as_high = place_of_highest(gain, stderr), as_high(gain, stderr).sum()
    if ax is None:
        ax = marks.axes(None)
        # [inch] tuned: a square map and its colour bar
        ax.figure.set(figwidth=5.3, layout_engine="compressed")
    label, shown = axis_label("gain"), gain
    # smoothed by a cell: contours of a noisy map would be islands of single cells
    from scipy.ndimage import gaussian_filter  # here: maps alone need it

    smooth = gaussian_filter(gain, 1.0, mode="nearest")
    low, top = None, None
    if decibel and gain.max() > 0.0:
        shown, label = 10.0 * np.log10(np.where(gain > 0.0, gain, np.nan)), f"{label} [dB]"
        top = float(np.nanmax(shown))
        low = max(top - _COVERED, float(np.nanmin(shown)))
    marks.heat_map(ax, x, y, shown, label, vmin=low, vmax=top)
    if min(gain.shape) > 2 and smooth.max() > smooth.min():
        # decibels below the highest; the floor of -120 dB is for cells without light
        decibels = 10.0 * np.log10(np.maximum(smooth / smooth.max(), 1e-12))
        lines = ax.contour(
            x, y, decibels.T, [-20.0, -10.0, -6.0, -3.0], colors="white", linewidths=1.0,
            linestyles="-",
        )  # fmt: skip
        ax.clabel(lines, fmt=lambda v: f"{number(v)} dB", fontsize=8)
    if place is not None:
        highest = x[place[0]], y[place[1]]
        ax.plot(*highest, "*", color=LED_COLOR, mec=INK, ms=11, clip_on=False)
        marks.note(
            ax,
            f"star: highest gain, at x = {number(highest[0], '.3g')} m, "
            f"y = {number(highest[1], '.3g')} m",
        )
    elif np.isfinite(stderr).all() and smooth.max() > 0.0:
        marks.note(ax, f"highest gain: {cells_as_high} cells are equal within errors")
    return ax


def plot_impulse_response(
    responses: ImpulseResponse | Mapping[str, ImpulseResponse],
    *,
    decades: float = 5.0,
    ax: Axes | None = None,
) -> Axes:
    """Plot impulse responses on a logarithmic axis, with bands of two standard errors.

    A response ends at the first bin after its peak with a standard error beyond 40 % of its value:
    few photons reach such bins.

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
        reliable = (error <= _LARGEST_ERROR * h) & (h > 0.0)
        after_peak = np.arange(len(h)) > np.argmax(h)
        # up to the first noisy bin after the peak: beyond, single photons make bins of any height
        reliable &= np.cumsum(after_peak & ~reliable) == 0
        shown = np.where(reliable, np.maximum(h, floor), np.nan)
        spread = f"rms delay spread {1e9 * response.rms_delay_spread:.3g} ns"
        label = f"{name}, {spread}" if name else spread
        marks.density(ax, edges, shown, error, floor, label)
        last = max(last, float(np.max(edges[1:][reliable & (h > floor)], initial=0.0)))
    if not last > 0.0:
        raise Refused("responses", Described("single photons alone"), "responses with more light")
    marks.note(ax, "band: ± 2 standard errors")
    ax.set(xlabel=marks.scaled("delay", 0.0)[1], xlim=(0.0, last), yscale="log")
    return marks.finished(ax, y="impulse_response", ylim=(floor, 2.0 * top))


def plot_background(result: Background | BackgroundSeries, *, ax: Axes | None = None) -> Axes:
    """Plot the parts of the background radiance, as bars or over time.

    Parameters
    ----------
    result : Background or BackgroundSeries
        Result of `background` or `background_series`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    data = result.to_dataset().assign_coords(part=list(PARTS)).transpose("part", ...)
    # only parts that have light
    data = data.isel(part=[np.any(radiance) for radiance in result.parts.values()])
    if isinstance(result, BackgroundSeries):
        return marks.finished(marks.lines(ax, data, "part_radiance"), ylim=(0.0, None))
    ax = marks.bars(ax, data, "part_radiance")
    ax.set_title(verbatim(result.light_name), loc="left")
    return marks.finished(ax, y="background_radiance")


def plot_irradiance(series: IrradianceSeries, *, ax: Axes | None = None) -> Axes:
    """Plot the irradiance under a moving sea over time, one line per depth.

    Parameters
    ----------
    series : IrradianceSeries
        Result of `irradiance_series`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    data = series.to_dataset()[["spectral_irradiance"]].transpose("depth", "time")
    return marks.finished(marks.lines(ax, data, "spectral_irradiance"), ylim=(0.0, None))


def plot_eye(eye: Eye, *, ax: Axes | None = None) -> Axes:
    """Plot an eye diagram over two bits: mean and standard deviation of the signal by bit pattern.

    Parameters
    ----------
    eye : Eye
        Result of `OokLink.eye`.
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
        patterns = np.flatnonzero(eye.bits[:, 0] == bit)
        level, std = (eye.level[patterns] - floor) / eye.swing, eye.std[patterns] / eye.swing
        color = PALETTE[shade]
        for start in (0.0, time[-1]):  # drawn twice: any pattern may follow
            ax.plot(start + time, level.T, color=color, lw=0.8, alpha=0.6)
            ax.add_patch(_cover(start + time, level - std, level + std, color))
        ax.plot([], [], color=color, label=name)
    ax.margins(y=0.12)
    marks.note(ax, "band: ± 1 standard deviation")
    ax.set_title(f"opening {eye.opening:.2f}, Q = {eye.q_factor:.2f}")
    marks.finished(ax, xlabel="time [ns], two bits", ylabel="signal over its swing")
    ax.legend(loc="upper left", ncols=2)
    return ax


def _cover(x: Floats, low: Floats, high: Floats, color: str) -> PathPatch:
    """Return the union of the bands of many curves (curves, n) as a single patch."""
    forward, backward = np.broadcast_to(x, low.shape), np.broadcast_to(x[::-1], low.shape)
    corners = np.stack([np.hstack([forward, backward]), np.hstack([low, high[:, ::-1]])], axis=-1)
    closed = np.concatenate([corners, corners[:, :1]], axis=1)
    # one path: translucent bands of their own would be darker where they overlap
    outline = Path.make_compound_path(*(Path(loop, closed=True) for loop in closed))
    return PathPatch(outline, color=color, alpha=0.22, lw=0)
