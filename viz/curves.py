"""Curves as plots take them: arrays, xarray objects or functions of the abscissa, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike, NDArray

from meshtrace.fields import FIELDS

from .style import axis_label

Floats = NDArray[np.float64]
Curve = ArrayLike | Callable[[Floats], ArrayLike]
Curves = Mapping[str, Curve] | Curve


def by_name(curves: Curves) -> Mapping[str, Curve]:
    """Return curves by name; one alone has none."""
    return curves if isinstance(curves, Mapping) else {"": curves}


def evaluated(curve: Curve, x: Floats) -> Floats:
    """Return the values of a curve at x."""
    return np.asarray(curve(x) if callable(curve) else curve, dtype=float)


def label_of(name: str) -> str:
    """Return the label of a registered variable, or the text as it is."""
    return axis_label(name) if name in FIELDS else name


def draw_curves(ax: Axes, x: Floats, curves: Curves, scale: float = 1.0) -> None:
    """Draw curves over x * scale, with a legend where they have names."""
    for name, curve in by_name(curves).items():
        ax.plot(x * scale, evaluated(curve, x), label=name or None)
    if any(by_name(curves)):
        ax.legend()
