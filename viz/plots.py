"""Plots of results of any kind."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import xarray as xr
from matplotlib.axes import Axes

from meshtrace.errors import Described, Refused
from meshtrace.stored import Stored

from . import plots_gain, plots_signal, plots_study
from .checks import checked
from .plots_curves import plot_sweep


@checked
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
    'number of scatterings'
    """
    if isinstance(result, xr.Dataset):
        return plot_sweep(result, quantity="ber" if "ber" in result else "gain", ax=ax)
    kind = getattr(result, "kind", None)
    if kind not in _PLOTS:
        raise Refused("result", Described(type(result).__name__), f"a {', '.join(_PLOTS)}")
    return _PLOTS[kind](result, ax=ax)


_PLOTS: dict[str, Callable[..., Any]] = {
    "gain": plots_gain.plot_gain,
    "series": plots_gain.plot_series,
    "coverage": plots_gain.plot_coverage,
    "impulse-response": plots_signal.plot_impulse_response,
    "fading": plots_gain.plot_autocorrelation,
    "performance": plots_study.plot_performance,
    "depth-sweep": plots_study.plot_winds,
    "convergence": plots_study.plot_convergence,
    "fading-convergence": plots_study.plot_fading_convergence,
    "comparison": plots_study.plot_comparison,
    "duplex": plots_study.plot_duplex,
    "background": plots_signal.plot_background,
    "background-series": plots_signal.plot_background,
    "sensitivity": plots_study.plot_tornado,
    "optimum": plots_study.plot_optimum,
    "inference": plots_study.plot_inference,
}
