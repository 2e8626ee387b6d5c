"""Canvases and datasets of the figures, in the style of `meshtrace.viz`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from meshtrace.fields import FIELDS, attrs
from meshtrace.paper.links import FORM_NAMES, FORMS, ROUGH, Form
from meshtrace.paper.registry import Entry, Number, row
from meshtrace.viz.style import INK, PALETTE, RC

WIND_COLORS = {0.0: PALETTE["black"], 5.0: PALETTE["blue"], 13.0: PALETTE["vermilion"]}


@contextmanager
def style() -> Iterator[None]:
    """Draw in the style of the gallery, independent of the user's settings."""
    with mpl.rc_context(RC):
        yield


def panels(
    rows: int = 1, columns: int = 1, *, width: float = 5.2, height: float = 3.9, **options: Any
) -> tuple[Figure, Any]:
    """Return a figure off screen and its axes (rows, columns); sizes of a panel in inches."""
    picture = Figure(figsize=(columns * width, rows * height), layout="constrained")
    FigureCanvasAgg(picture)
    return picture, picture.subplots(rows, columns, squeeze=False, **options)


def form_panels(**options: Any) -> tuple[Figure, dict[Form, Any]]:
    """Return a figure and its axes by form: correct physics beside the forms as published."""
    picture, axes = panels(1, len(FORMS), **options)
    for ax, form in zip(axes[0], FORMS, strict=True):
        ax.set_title(FORM_NAMES[form])
    return picture, dict(zip(FORMS, axes[0], strict=True))


def mark_printed(ax: Any, x: Sequence[float], y: Sequence[float]) -> None:
    """Mark published numbers with stars."""
    look: Any = {"color": PALETTE["orange"], "markeredgecolor": INK, "markersize": 13}
    ax.plot(x, y, "*", zorder=5, label="printed", **look)


def dataset(variables: dict[str, Any], **coords: Any) -> xr.Dataset:
    """Return variables over all coordinates; registered names get their attributes."""

    def attributes(name: str) -> dict[str, str]:
        return attrs(name) if name in FIELDS else {}

    return xr.Dataset(
        {name: (tuple(coords), values, attributes(name)) for name, values in variables.items()},
        {name: (name, list(values), attributes(name)) for name, values in coords.items()},
    )


def wind_name(speed: float) -> str:
    """Return the name of a wind in legends."""
    return "flat sea" if speed == 0.0 else f"{speed:g} m/s"


def wind_rows(key: str, numbers: Mapping[tuple[Form, float], Number | float]) -> list[Entry]:
    """Return a row of rows.toml for each rough sea, of numbers by form and wind."""
    return [row(key, [numbers[form, u] for form in FORMS], wind=wind_name(u), u=u) for u in ROUGH]
