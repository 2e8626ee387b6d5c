"""Plots of studies: convergence with the mesh, and the performance of a link."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator

from meshtrace.comms.background import name_of_light
from meshtrace.errors import Refused
from meshtrace.studies.convergence.study import ConvergenceStudy
from meshtrace.studies.performance.tables import LinkPerformance

from .checks import checked
from .plots_curves import BER_SHOWN, plot_curves, positive
from .style import INK, axes, note

_STEPS = {
    "spacing": "mesh spacing [m]",
    "time_step": "time step [s]",
    "omega_max": "band limit [rad s$^{-1}$]",
}


@checked
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
    ax = axes(ax)
    for k, kind in enumerate(study.normals):
        fit, percent = study.fits[kind], 100.0 / study.gain[k, -1]
        target = fit.gain.value if study.reference is None else study.anchor[k]
        mean = percent * np.abs(study.gain[k] - target)
        errors = percent * study.difference_stderr[k]
        name = f"{kind} normals, mean: order {fit.order.value:.2f}"
        marks = ax.errorbar(study.values, mean, errors, fmt="o", capsize=2, label=name)
        color = marks[0].get_color()
        law = percent * np.abs(fit.coefficient * study.step**fit.order.value)
        ax.plot(study.values, law, color=color, lw=1.0)
        if np.isfinite(study.scatter[k]).any():
            one = percent * study.scatter[k]
            ax.plot(study.values, one, "^--", color=color, lw=0.8, label=f"{kind} normals, scatter")
    ax.axhline(100.0 * study.tolerance, color="0.5", lw=0.8, ls=":", label="tolerance")
    ax.set(xscale="log", yscale="log", xlabel=_STEPS[study.parameter])
    ax.set_xticks(study.values, [f"{value:g}" for value in study.values])
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.minorticks_off()
    ax.set_ylabel("error of the gain [%]")
    ax.legend()
    return ax


@checked
def plot_performance(
    performance: LinkPerformance, *, quantity: str = "ber", ax: Axes | None = None
) -> Axes:
    """Plot a quantity of a link over depth with its confidence band, one curve for each bit rate.

    Parameters
    ----------
    performance : LinkPerformance
        Of `link_performance`.
    quantity : str
        "ber", "outage", "received_power", "gain" or another estimate of it.
    ax : matplotlib Axes, optional
        Axes to draw on. The light is written above, the status of the
        calibration below.

    Returns
    -------
    Axes

    Raises
    ------
    Refused
        If it was computed at one depth only.
    """
    if len(performance.depths) < 2:
        raise Refused("performance.depths", performance.depths, "two depths or more")
    data = performance.to_dataset().transpose("bit_rate", "depth")
    rates = [f"{rate / 1e6:g} Mbit/s" for rate in performance.bit_rates]
    shown = positive(data.assign_coords(bit_rate=rates), quantity)
    ax = plot_curves(shown, quantity, style="o-", ax=ax)
    if quantity == "ber":
        ax.axhline(performance.limit, color=INK, lw=0.8, ls="--")
        ax.set_ylim(*BER_SHOWN)
    if f"{quantity}_low" in shown:
        seas = np.size(performance.fades[0].samples)
        light = name_of_light(performance.light)
        band = f"n = {seas} seas, band: {100.0 * performance.confidence:g} %"
        note(ax, f"{band}, background light: {light}")
    ax.set(yscale="log")
    pad = 0.03 * np.ptp(performance.depths)
    ax.set_xlim(min(performance.depths) - pad, max(performance.depths) + pad)
    place = {"xy": (0.0, -0.17), "xycoords": "axes fraction"}
    ax.annotate(performance.status, **place, fontsize=7.5, va="top", wrap=True)
    return ax
