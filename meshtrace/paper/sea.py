"""Figure of the sea surfaces."""

from __future__ import annotations

from typing import Any

import numpy as np

from meshtrace import viz
from meshtrace.paper.canvas import dataset, panels, wind_name
from meshtrace.paper.registry import Entry, FigureOutput, Number, Setting, row
from meshtrace.surfaces import JonswapSea
from meshtrace.surfaces.statistics import components_hs
from meshtrace.viz.style import draw_map

WINDS = (5.0, 13.0)
HALF_WIDTH = 50.0
"""Half-width of the paper's square [m]."""

STYLE = viz.SceneStyle(labels=False, off_screen=True, window_size=(1120, 720))


def surfaces(setting: Setting, seas: int) -> FigureOutput:
    """Draw a JONSWAP sea in both winds, as a scene and as a map."""
    axis = np.linspace(-HALF_WIDTH, HALF_WIDTH, 201)
    picture, axes = panels(2, 2, width=5.6, height=4.0)
    elevation, numbers = [], []
    for j, wind in enumerate(WINDS):
        sea = JonswapSea(wind_speed=wind, seed=setting.seed, band="paper")
        z = sea.grid(axis, axis)[0]
        limit = float(np.abs(z).max())
        scene = viz.scene(None, sea.mesh(extent=HALF_WIDTH, spacing=0.5), style=STYLE)
        viz.look(scene, elevation_deg=28.0)
        scene.camera.zoom(1.15)
        axes[0, j].imshow(scene.screenshot(return_img=True))
        scene.close()
        axes[0, j].set(title=wind_name(wind))
        axes[0, j].set_axis_off()
        colors: Any = {"cmap": viz.water_map(), "vmin": -limit, "vmax": limit}
        draw_map(axes[1, j], axis, axis, z, viz.axis_label("elevation"), **colors)
        elevation.append(z)
        numbers += _numbers(sea, axis, setting.seed, seas)
    coords = {"wind_speed": WINDS, "x": axis, "y": axis}
    data = dataset(("wind_speed", "x", "y"), {"elevation": np.array(elevation)}, **coords)
    return FigureOutput(picture, data, numbers)


def _numbers(sea: JonswapSea, axis: Any, seed: int, seas: int) -> list[Entry]:
    spans = []
    for i in range(seas):
        z = sea.with_seed(seed + i).grid(axis, axis)[0]
        spans.append((np.ptp(z), np.ptp(z[:, len(axis) // 2])))
    square, line = (_mean(values) for values in zip(*spans, strict=True))
    hs = components_hs(sea.components)
    words = {"wind": wind_name(sea.wind_speed), "u": sea.wind_speed}
    found = {"square": square, "line": line, "hs": hs}
    return [row(key, (number, number), **words) for key, number in found.items()]


def _mean(values: tuple[float, ...]) -> Number:
    return Number(float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(len(values))))
