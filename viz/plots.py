"""Plot of a result of any kind."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import xarray as xr
from matplotlib.axes import Axes

from meshtrace.errors import Described, Refused
from meshtrace.stored import Stored

from .plots_curves import plot_performance, plot_sweep, plot_water, plot_wavelengths, plot_winds
from .plots_fading import (
    plot_autocorrelation,
    plot_coverage,
    plot_gain,
    plot_series,
)
from .plots_signals import plot_background, plot_impulse_response, plot_irradiance
from .plots_studies import (
    plot_comparison,
    plot_convergence,
    plot_design,
    plot_duplex,
    plot_fading_convergence,
    plot_inference,
    plot_measured,
    plot_optimum,
    plot_tornado,
    plot_trace,
)


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
            return plot_water(result, ax=ax)
        return plot_sweep(result, quantity="ber" if "ber" in result else "gain", ax=ax)
    kind = getattr(result, "kind", None)
    if kind not in _PLOTS:
        raise Refused("result", Described(type(result).__name__), f"a {', '.join(_PLOTS)}")
    return _PLOTS[kind](result, ax=ax)


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
    "wavelengths": plot_wavelengths,
    "sensitivity": plot_tornado,
    "design": plot_design,
    "optimum": plot_optimum,
    "inference": plot_inference,
    "measured": plot_measured,
}
