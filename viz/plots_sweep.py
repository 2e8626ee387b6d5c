"""Plots of a quantity over what is varied: a parameter of the link, or the mesh spacing."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from .curves import Curves, Floats, by_name, evaluated, label_of
from .style import axes, axis_label


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
    at, named = np.asarray(x, dtype=float), by_name(curves)
    bands = by_name(errors) if errors is not None else {}
    ax = axes(ax)
    for name, curve in named.items():
        values = evaluated(curve, at)
        (line,) = ax.plot(at, values, "o-", markersize=4, label=name or None)
        if name in bands:
            e = 2.0 * evaluated(bands[name], at)
            ax.fill_between(at, values - e, values + e, color=line.get_color(), alpha=0.25, lw=0)
    if any(named):
        ax.legend()
    ax.set(xlabel=label_of(along), ylabel=label_of(quantity), yscale="log" if log else "linear")
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
    at, bands = np.asarray(spacing, dtype=float), by_name(errors) if errors is not None else {}
    ax = axes(ax)
    for name, curve in by_name(curves).items():
        values = evaluated(curve, at)
        stderr = evaluated(bands[name], at) if name in bands else None
        order, factor = fitted_order(at, values, stderr)
        label = f"{name}, order {order:.2f}" if name else f"order {order:.2f}"
        marks = ax.errorbar(at, values, stderr, fmt="o", capsize=2, label=label)
        ax.plot(at, factor * at**order, color=marks[0].get_color(), lw=1.0)
    ax.legend()
    ax.set(xscale="log", yscale="log", xlabel=axis_label("spacing"), ylabel=label_of(quantity))
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
