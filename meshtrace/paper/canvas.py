"""Canvases for the pictures of this package, in the style of `meshtrace.viz`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from meshtrace.viz.style import INK, PALETTE, RC

WIND_COLORS = {0.0: PALETTE["black"], 5.0: PALETTE["blue"], 13.0: PALETTE["vermilion"]}


@contextmanager
def style() -> Iterator[None]:
    """Draw in the style of the gallery, whatever the user has set."""
    with mpl.rc_context(RC):
        yield


def panels(
    rows: int = 1, columns: int = 1, *, width: float = 5.2, height: float = 3.9, **options: Any
) -> tuple[Figure, Any]:
    """Return a figure off screen and its axes (rows, columns); sizes of a panel in inches."""
    picture = Figure(figsize=(columns * width, rows * height), layout="constrained")
    FigureCanvasAgg(picture)
    return picture, picture.subplots(rows, columns, squeeze=False, **options)


def mark_printed(ax: Any, x: Sequence[float], y: Sequence[float]) -> None:
    """Mark what the paper prints."""
    ax.plot(
        np.asarray(x),
        np.asarray(y),
        "*",
        color=PALETTE["orange"],
        markeredgecolor=INK,
        markersize=13,
        zorder=5,
        label="printed",
    )


def wind_name(speed: float) -> str:
    """Return how a wind is called in legends."""
    return "flat sea" if speed == 0.0 else f"{speed:g} m/s"
