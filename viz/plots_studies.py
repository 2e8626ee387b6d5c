"""Plots of studies: comparisons, convergence, sensitivities, optima; plot of any result."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pkgutil import resolve_name
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import LogLocator

from meshtrace import studies
from meshtrace.errors import Described, Refused
from meshtrace.models import Floats
from meshtrace.stored import Stored

from . import marks, plots_curves, plots_results
from .style import INK, PALETTE, label_of, number, printed_units, verbatim


def plot_comparison(result: studies.Comparison, *, ax: Axes | None = None) -> Axes:
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
    data = result.to_dataset()
    if ax is None:
        ax = marks.axes(None)
        # [inch] tuned: a line for each link
        ax.figure.set(figheight=1.2 + 0.45 * len(result.names))
    marks.bars(ax, data, "gain_ratio_db", across=True)
    ratios, errors = (data[f"gain_ratio_db{end}"].to_numpy() for end in ("", "_stderr"))
    words = [
        f"{number(r, '+.3g')} ± {number(e, '.1g')} dB" for r, e in zip(ratios, errors, strict=True)
    ]
    # the first link is what the others are compared with
    words[0] = f"gain {number(np.ravel(result.gain)[0], '.3g')}"
    for row, (ratio, text) in enumerate(zip(ratios, words, strict=True)):
        if not np.isfinite(ratio):  # a dark link has no bar to stand beside
            ratio, text = 0.0, "no light"
        side = -1 if ratio < 0.0 else 1
        align = "left" if side > 0 else "right"
        ax.annotate(
            text, (ratio, row), (6 * side, 0), textcoords="offset points", ha=align, va="center"
        )
    ax.use_sticky_edges = False  # bars would end at the frame, and words outside of it
    ax.margins(x=0.5)
    ax.axvline(0.0, color=INK, lw=0.8)
    ax.set_xlabel(f"gain over {verbatim(result.names[0])} [dB]")
    return ax


def plot_duplex(result: studies.Duplex, *, ax: Axes | None = None) -> Axes:
    """Plot the gain of both directions, relative to its mean, over time or realizations.

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
    places = times if name == "time" else range(len(times))
    data = marks.dataset({"gain over its mean": gains}, {"way": ["up", "down"], name: places})
    return marks.finished(marks.lines(ax, data, "gain over its mean"), ylim=(0.0, None))


_FITTED = 3  # points that a law of two parameters needs to be seen


def plot_convergence(study: studies.ConvergenceStudy, *, ax: Axes | None = None) -> Axes:
    """Plot errors of the gain over the step of a study, with the fitted law.

    The law is drawn between points that exceed twice their standard error, of chains and of
    placements, three or more; other points are hollow.

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
        # a logarithmic axis has no place for 0
        scatter = np.where(study.scatter[k] > 0.0, study.scatter[k], np.nan)
        law = np.abs(fit.coefficient * study.step**fit.order.value)
        mean, stderr = np.abs(study.gain[k] - target), study.mean_stderr[k]
        above = mean > 2.0 * stderr
        # a law through noise has any order: it is drawn where points stand above their errors
        order = "order not resolved"
        if above.sum() >= _FITTED:
            order = f"order {fit.order.value:.2f}"
            law[: np.argmax(above)] = law[len(above) - np.argmax(above[::-1]) :] = np.nan
        else:
            law[:] = np.nan
        errors_percent = percent * np.array([mean, law, scatter])
        named = f"{kind} normals, mean: {order}", "", f"{kind} normals, scatter"
        n = 3 if np.isfinite(scatter).any() else 2
        quantities = {"error": errors_percent[:n]}
        quantities["error_stderr"] = percent * np.array([stderr, 0.0 * law, 0.0 * law])[:n]
        data = marks.dataset(quantities, {"curve": named[:n], study.parameter: study.values})
        color = list(PALETTE.values())[k]
        marks.lines(ax, data, "error", ("o", "-", "^--"), (color,), lw=1.0, markersize=5)
        if not above.all():
            within = np.where(above, np.nan, errors_percent[0])
            ax.plot(study.values, within, "o", ms=5, mfc="white", mec=color)
            marks.note(ax, "hollow: within ± 2 standard errors of zero", "left")
    ax.axhline(100.0 * study.tolerance, color="0.5", lw=0.8, ls=":", label="tolerance")
    ax.set(yscale="log", ylabel="error of the gain [%]")
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter("{x:g}")
    _over_steps(ax, study.values)
    # below: bars reach down to zero anywhere, so that no corner is free
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
    return ax


def plot_fading_convergence(study: studies.FadingConvergence, *, ax: Axes | None = None) -> Axes:
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
    indices = np.array([study.with_tilts, study.band_alone, study.measured])
    errors = np.array([0.0 * indices[0], 0.0 * indices[1], study.measured_stderr])
    names = ["closed form, random slopes beyond", "closed form, nothing beyond", "measured"]
    # without simulations there are closed forms alone
    n = 3 if np.isfinite(study.measured).any() else 2
    quantities = {"scintillation_index": indices[:n]}
    quantities |= {"scintillation_index_stderr": errors} if n == 3 else {}
    data = marks.dataset(quantities, {"curve": names[:n], "omega_max": study.omega_max})
    ax = marks.lines(ax, data, "scintillation_index", ("-", "--", "o"))
    ax.axhline(study.all_waves, ls=":", label="all waves", color=INK, lw=0.8)
    ax.set_yscale("log")
    return _over_steps(ax, study.omega_max)


def _over_steps(ax: Axes, values: Floats) -> Axes:
    """Finish axes with a logarithmic abscissa and a tick at each step of a study."""
    ax.set_xscale("log")
    ax.set_xticks(values, [f"{value:g}" for value in values])
    # each step is named; minor ticks of decades would only fall between the names
    ax.minorticks_off()
    return marks.finished(ax)


def plot_tornado(
    s: studies.Sensitivities,
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
    bars = studies.swings(s, change)
    names = [
        f"{bar.name}\n{bar.values[0]:.4g} to {bar.values[1]:.4g} {printed_units(bar.unit)}"
        for bar in bars
    ]
    values = {"change": [b.change for b in bars], "change_stderr": [b.stderr for b in bars]}
    # of a dimensionless parameter, and of an angle
    names = [name.removesuffix(" 1").replace(" °", "°") for name in names]
    data = marks.dataset(values, {"name": names, "side": ["lower", "higher"]})
    # `bars` takes the groups first
    ax = marks.bars(ax, data.transpose(), "change", across=True, beside=False)
    ax.set_yticks(range(len(names)), names, fontsize=8)
    ax.axvline(0.0, color=INK, lw=0.8)
    form, unit = ".2e" if s.quantity == "gain" else ".3g", "m" if s.quantity == "range" else "dB"
    base = f"{s.value:{form}} {s.unit}".removesuffix(" 1")
    ax.set_xlabel(f"change of the {s.quantity} from {base} [{unit}]")
    return ax


def plot_pixels(signals: studies.PixelSignals, *, ax: Axes | None = None) -> Axes:
    """Plot the counts of the pixels of a receiver, signal and background side by side.

    Parameters
    ----------
    signals : PixelSignals
        Result of `studies.pixel_signals`. Both pictures have one scale of colours, over four
        decades; x of the image runs to the right, y upwards. The circle is the field of view, with
        the angles at its rim, and the best pixel has a frame.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
    """
    ax = marks.axes(ax)
    edge, rates = signals.edge, (signals.signal_rate, signals.background_rate)
    highest, shift = max(float(rate.max()) for rate in rates), 1.2 * float(np.ptp(signals.edge))
    scale, half = LogNorm(1e-4 * highest, highest), float(edge[-1])
    rim, side = f"{math.degrees(math.atan(half)):.3g}°", float(edge[1] - edge[0])
    for k, (rate, name) in enumerate(zip(rates, ("signal", "background"), strict=True)):
        # pixels without light stay white
        seen = np.ma.masked_equal(rate.T, 0.0)
        seen = np.ma.maximum(seen, 1e-4 * highest)
        image = ax.pcolormesh(edge + k * shift, edge, seen, norm=scale, rasterized=True)
        ax.add_patch(Circle((k * shift, 0.0), half, fill=False, edgecolor=INK, lw=0.8))
        ax.text(k * shift, 1.06 * half, name, ha="center", va="bottom", color=INK)
        for sign, mark in ((-1.0, "\N{MINUS SIGN}" + rim), (0.0, "0°"), (1.0, rim)):
            ax.text(k * shift + sign * half, -1.06 * half, mark, ha="center", va="top", color=INK)
        ax.text(
            k * shift, -1.22 * half, "angle of arrival", ha="center", va="top", color=INK, size=9
        )
        i, j = signals.best_pixel
        corner = float(edge[i]) + k * shift, float(edge[j])
        frame = Rectangle(corner, side, side, fill=False, edgecolor=PALETTE["vermilion"], lw=1.6)
        ax.add_patch(frame)
    frame.set_label("best pixel")
    ax.legend(handles=[frame], loc="upper left", frameon=False, bbox_to_anchor=(0.0, 1.0))
    ax.figure.colorbar(image, ax=ax, label="counts [s$^{-1}$]", shrink=0.7, aspect=16)
    ax.set(aspect="equal", ylim=(-1.45 * half, 1.5 * half), xlim=(-1.1 * half, shift + 1.1 * half))
    ax.axis("off")
    return ax


def plot_availability(a: studies.Availability, *, ax: Axes | None = None) -> Axes:
    """Plot the availability by month, or over the parameter of the range if no input has months.

    Parameters
    ----------
    a : Availability
        Of `studies.availability`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
        Shares in which the link works, and with at most the wanted outage, with two standard
        errors.
    """
    names = ["works", f"outage at most {100.0 * a.outage:g} %"]
    if not a.months and a.parameter:
        errors = [a.curve_share_stderr, np.zeros_like(a.curve_share)]
        shares = {"share": [a.curve_share, a.curve_steady_share], "share_stderr": errors}
        data = marks.dataset(shares, {"curve": names, "curve_value": a.curve_value})
        ax = marks.lines(ax, data, "share", ("-", "--"))
        ax.axhline(a.target, color=INK, lw=0.8)
        return marks.finished(ax, xlabel=label_of(a.parameter), ylim=(0.0, 1.0))
    periods = a.periods[1:] or a.periods
    each = np.array([p[1:5] for p in periods]).T
    shares = {"share": [each[0], each[2]], "share_stderr": [each[1], each[3]]}
    data = marks.dataset(shares, {"curve": names, "period": [p.name for p in periods]})
    return marks.finished(marks.bars(ax, data, "share"), ylim=(0.0, 1.0))


def plot(result: Stored | xr.Dataset, *, ax: Axes | None = None) -> Axes:
    """Plot a result of any kind, or the dataset of a sweep or of `Water.spectra`.

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
        if "wavelength_nm" in result.dims and "source" in result.attrs:
            return plots_curves.plot_water(result, ax=ax)
        return plots_curves.plot_sweep(result, quantity="ber" if "ber" in result else "gain", ax=ax)
    kind = getattr(result, "kind", None)
    if kind not in _PLOTS:
        raise Refused("result", Described(type(result).__name__), f"a {', '.join(_PLOTS)}")
    draw = _PLOTS[kind]
    if isinstance(draw, str):  # of an application, which imports this module
        draw = resolve_name(draw)
    return draw(result, ax=ax)


_PLOTS: dict[str, Callable[..., Any] | str] = {
    "gain": plots_results.plot_gain,
    "series": plots_results.plot_series,
    "coverage": plots_results.plot_coverage,
    "impulse-response": plots_results.plot_impulse_response,
    "fading": plots_results.plot_autocorrelation,
    "markov-channel": "meshtrace.apps.plots:plot_channel",
    "transformed-gaussian": "meshtrace.apps.plots:plot_channel",
    "performance": plots_curves.plot_performance,
    "depth-sweep": plots_curves.plot_winds,
    "convergence": plot_convergence,
    "fading-convergence": plot_fading_convergence,
    "comparison": plot_comparison,
    "duplex": plot_duplex,
    "trace": "meshtrace.apps.plots:plot_trace",
    "background": plots_results.plot_background,
    "background-series": plots_results.plot_background,
    "irradiance-series": plots_results.plot_irradiance,
    "wavelengths": plots_curves.plot_wavelengths,
    "sensitivity": plot_tornado,
    "availability": plot_availability,
    "pixels": plot_pixels,
    "design": "meshtrace.apps.plots:plot_design",
    "optimum": "meshtrace.apps.plots:plot_optimum",
    "inference": "meshtrace.apps.plots:plot_inference",
    "lidar": "meshtrace.apps.plots:plot_lidar",
    "measured": "meshtrace.apps.plots:plot_measured",
}
