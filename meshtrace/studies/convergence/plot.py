"""A study as a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from meshtrace.studies.convergence.study import UNITS, ConvergenceStudy

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_NAMES = {"spacing": "mesh spacing", "time_step": "time step", "omega_max": "band limit"}


def plot_study(study: ConvergenceStudy, ax: Axes | None = None) -> Axes:
    """Plot errors of a study and their fitted law, see `ConvergenceStudy.plot`."""
    from meshtrace.viz.style import axes

    ax = axes(ax)
    for k, kind in enumerate(study.normals):
        fit, percent = study.fits[kind], 100.0 / study.gain[k, -1]
        target = fit.gain.value if study.reference is None else study.anchor[k]
        mean = percent * np.abs(study.gain[k] - target)
        marks = ax.errorbar(
            study.values, mean, percent * study.difference_stderr[k], fmt="o", capsize=2,
            label=f"{kind} normals, mean: order {fit.order.value:.2f}",
        )  # fmt: skip
        color = marks[0].get_color()
        law = percent * np.abs(fit.coefficient * study.step**fit.order.value)
        ax.plot(study.values, law, color=color, lw=1.0)
        if np.isfinite(study.scatter[k]).any():
            one = percent * study.scatter[k]
            ax.plot(study.values, one, "^--", color=color, lw=0.8, label=f"{kind} normals, scatter")
    ax.axhline(100.0 * study.tolerance, color="0.5", lw=0.8, ls=":", label="tolerance")
    ax.set(
        xscale="log", yscale="log", ylabel="error of the gain [%]",
        xlabel=f"{_NAMES[study.parameter]} [{UNITS[study.parameter]}]",
    )  # fmt: skip
    ax.legend()
    return ax
