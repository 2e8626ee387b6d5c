"""Plots of sensitivities, optimisations and inferences."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from meshtrace.studies.inference.result import Inference
from meshtrace.studies.optimisation.result import Optimum
from meshtrace.studies.sensitivity.result import Sensitivities
from meshtrace.studies.sensitivity.swings import swings

from .checks import checked
from .style import INK, axes


@checked
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
        `studies.sensitivity.swings`.
    ax : matplotlib Axes, optional
        Axes to draw on.

    Returns
    -------
    Axes
        Bars in dB, in m for the range, the largest on top; standard errors as whiskers.
    """
    ax = axes(ax)
    found = swings(s, change)
    place = np.arange(len(found))
    for side, (label, color) in enumerate((("lower", "C0"), ("higher", "C1"))):
        values = [one.change[side] for one in found]
        errors = [one.stderr[side] for one in found]
        ax.barh(place, values, 0.7, xerr=errors, color=color, label=label,
                error_kw={"elinewidth": 0.8, "capsize": 2, "ecolor": INK})  # fmt: skip
    names = [f"{one.name}\n{one.values[0]:.4g} to {one.values[1]:.4g} {one.unit}" for one in found]
    ax.set_yticks(place, [name.removesuffix(" 1") for name in names], fontsize=8)
    ax.invert_yaxis()
    ax.axvline(0.0, color=INK, lw=0.8)
    ax.grid(axis="y", visible=False)
    form = ".2e" if s.of == "gain" else ".3g"
    base = f"{s.value:{form}} {s.unit}".removesuffix(" 1")
    ax.set_xlabel(f"change of the {s.of} from {base} [{'m' if s.of == 'range' else 'dB'}]")
    ax.legend()
    return ax


@checked
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
    ax = axes(ax)
    ax.plot(o.history[:, 0], o.history[:, -1], "o", ms=4, label="candidates")
    ax.plot(o.values[0], o.cost, "*", ms=12, color="C1", label="best")
    ax.axvspan(*o.flatness[0], color="C1", alpha=0.15, label="within one standard error")
    ax.set(xlabel=o.variables[0], ylabel=f"cost of the {o.objective}")
    ax.legend()
    return ax


@checked
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
    ax = axes(ax)
    ax.plot(np.arange(1, len(f.measured) + 1), f.measured / f.predicted, "o")
    ax.axhline(1.0, color=INK, lw=0.8)
    ax.set(xlabel="measurement", ylabel="measured over fitted")
    return ax
