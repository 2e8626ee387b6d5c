"""Plots of what the light goes through: phase functions, bubbles, wave spectra."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from meshtrace.fields import FIELDS

from .curves import Curves, Floats, by_name, draw_curves, evaluated, label_of
from .style import axes, axis_label


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
    draw_curves(ax, _angles(theta), curves, np.degrees(1.0))
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
    draw_curves(ax, _angles(theta), curves, np.degrees(1.0))
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
    for name, curve in by_name(curves).items():
        ax.plot(evaluated(curve, z), z, label=name or None)
    if any(by_name(curves)):
        ax.legend()
    ax.set(xscale="log", xlabel=label_of(quantity), ylabel=axis_label("depth"))
    ax.set_ylim(z.max(), z.min())
    return ax


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
    draw_curves(ax, np.asarray(omega, dtype=float), curves)
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
    draw_curves(ax, np.asarray(theta, dtype=float), curves, np.degrees(1.0))
    ax.set(xlabel=r"direction off the wind $\theta$ [°]")
    ax.set(ylabel=r"directional spreading $D(\theta)$ [rad$^{-1}$]")
    ax.set_ylim(bottom=0.0)
    return ax
