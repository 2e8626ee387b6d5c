"""Figure of the sea surfaces."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from meshtrace import viz
from meshtrace.fields import attrs
from meshtrace.paper.canvas import panels, wind_name
from meshtrace.paper.registry import Drawing, Number, Setting, compared, figure
from meshtrace.surfaces import JonswapSea
from meshtrace.surfaces.statistics import components_hs

WINDS = (5.0, 13.0)
HALF_WIDTH = 50.0
"""Half-width of the paper's square [m]."""


@figure("surfaces", "8", "sea surfaces", quick={"seas": 20}, full={"seas": 400})
def surfaces(setting: Setting, seas: int) -> Drawing:
    """Draw a JONSWAP sea in both winds, as a scene and as a map."""
    axis = np.linspace(-HALF_WIDTH, HALF_WIDTH, 201)
    picture, axes = panels(2, 2, width=5.6, height=4.0)
    elevation, rows = [], []
    for j, wind in enumerate(WINDS):
        sea = JonswapSea(wind_speed=wind, seed=setting.seed)
        elevation.append(sea.grid(axis, axis)[0])
        mesh = sea.mesh(extent=HALF_WIDTH, spacing=0.5)
        limit = float(np.abs(elevation[-1]).max())
        scene = viz.scene(
            None, mesh, labels=False, color_limit=limit, off_screen=True, window_size=(1120, 720)
        )
        viz.look(scene, elevation_deg=28.0)
        scene.camera.zoom(1.05)
        scene.remove_scalar_bar()
        axes[0, j].imshow(scene.screenshot(return_img=True))
        scene.close()
        axes[0, j].set(title=wind_name(wind))
        axes[0, j].set_axis_off()
        _draw_map(axes[1, j], axis, elevation[-1])
        rows += _rows(sea, axis, setting.seed, seas)
    data = xr.Dataset(
        {"elevation": (("wind_speed", "x", "y"), np.array(elevation), attrs("elevation"))},
        {
            "wind_speed": ("wind_speed", list(WINDS), attrs("wind_speed")),
            "x": ("x", axis, attrs("x")),
            "y": ("y", axis, attrs("y")),
        },
    )
    caption = (
        "JONSWAP seas of 30 km of fetch on the paper's square of 100 m, with its bands of "
        "frequencies; wind along x. Default and paper preset have the same sea: it is the paper's. "
        "The straight streaks at 5 m/s come from its few directions, each of which carries all "
        "frequencies; a smaller d_theta blurs them."
    )
    return Drawing(picture, data, rows, caption)


def _draw_map(ax: Any, axis: Any, elevation: Any) -> None:
    limit = float(np.abs(elevation).max())
    look: Any = {"cmap": viz.water_map(), "vmin": -limit, "vmax": limit, "rasterized": True}
    image = ax.pcolormesh(axis, axis, elevation.T, shading="nearest", **look)
    ax.figure.colorbar(image, ax=ax, label=viz.axis_label("elevation"))
    ax.set(aspect="equal", xlabel=viz.axis_label("x"), ylabel=viz.axis_label("y"))
    ax.grid(visible=False)


def _rows(sea: JonswapSea, axis: Any, seed: int, seas: int) -> list[Any]:
    spans = []
    for i in range(seas):
        z = sea.with_seed(seed + i).grid(axis, axis)[0]
        spans.append((np.ptp(z), np.ptp(z[:, len(axis) // 2])))
    square, line = (_mean(values) for values in zip(*spans, strict=True))
    hs = Number(components_hs(sea.components))
    name = wind_name(sea.wind_speed)
    return [
        compared(
            f"height from lowest trough to highest crest on the square, {name}",
            (square, square),
            "Mean over independent seas, which scatter far less than this differs from the print; "
            "the print does not say of which part of the surface it is.",
            printed=f"peak-to-peak-{sea.wind_speed:g}",
        ),
        compared(
            f"the same on one line of 100 m along the wind, {name}",
            (line, line),
            "A line meets fewer crests than the square; single seas scatter about this mean by "
            "about as much as the print differs from it.",
            printed=f"peak-to-peak-{sea.wind_speed:g}",
        ),
        compared(
            f"significant wave height, {name}",
            (hs, hs),
            "Of the waves within the paper's band; it prints none.",
            unit="m",
        ),
    ]


def _mean(values: tuple[float, ...]) -> Number:
    return Number(float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(len(values))))
