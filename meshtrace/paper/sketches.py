"""Figures of scenes: the seas, the link, the UAV's axes, and the offset of the receiver."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pyvista as pv
import xarray as xr

import meshtrace as mt
from meshtrace import viz
from meshtrace.paper.canvas import dataset, panels, wind_name
from meshtrace.paper.links import FORMS, ROUGH, UAV, gusts
from meshtrace.paper.registry import Entry, FigureOutput, Number, Setting, row
from meshtrace.surfaces import FlatSea, JonswapSea
from meshtrace.surfaces.statistics import components_hs
from meshtrace.viz.style import PALETTE, draw_map

STYLE = viz.SceneStyle(off_screen=True, window_size=(1400, 875))
"""Style of the scenes."""

SEA_STYLE = viz.SceneStyle(labels=False, off_screen=True, window_size=(1120, 720))

WIND = 13.0
HALF_WIDTH = 50.0
"""Half-width of the paper's square [m]."""


def _shot(scene: Any) -> Any:
    """Return the picture of a scene and close it."""
    picture = np.asarray(scene.screenshot(return_img=True))[..., :3].copy()
    scene.close()
    return picture


def link(setting: Setting, paths: int) -> FigureOutput:
    """Draw LED, sea, bubbles, light and UAV."""
    made = mt.Link(bubbles=mt.HallNovarini(wind_speed=WIND))
    sea = JonswapSea(wind_speed=WIND, seed=setting.seed, waves="paper")
    light = mt.trace_paths(made, sea, paths, seed=setting.seed)
    scene = viz.scene(made, sea, paths=light, received=40, seed=setting.seed, style=STYLE)
    picture = _shot(scene)
    led, receiver = made.transmitters[0], made.receivers[0]
    values = (
        ("depth of the LED", getattr(led, "depth", np.nan), "depth"),
        ("height of the receiver", receiver.center[2], "height"),
        ("half angle at half power", getattr(led, "half_angle_deg", np.nan), "half-angle"),
        ("radius of the aperture", receiver.radius, "radius"),
    )
    numbers = [row("parameter", (v, v), name=name, key=key) for name, v, key in values]
    return FigureOutput(picture, light.to_dataset(), numbers, {"wind": WIND})


def uav_axes(setting: Setting) -> FigureOutput:
    """Draw a quadcopter that leans into the wind, with its axes of roll, pitch and yaw."""
    tilts = [np.degrees(UAV.tilt_law(gusts(WIND, form)).mean()) for form in FORMS]
    receiver = mt.Receiver(tilt_deg=float(tilts[0]))
    made = mt.Link(receiver=receiver)
    scene = viz.scene(made, FlatSea(), style=replace(STYLE, labels=False, color="plain"))
    _close_up(scene, receiver)
    picture = _shot(scene)
    attributes = {"units": "rad", "long_name": "mean tilt"}
    data = xr.Dataset({"tilt": ("form", np.radians(tilts), attributes)}, {"form": list(FORMS)})
    return FigureOutput(picture, data, [row("tilt", tilts, wind=WIND)], {"wind": WIND})


def _close_up(scene: Any, receiver: mt.Receiver) -> None:
    """Draw the axes of a UAV and look at it from nearby."""
    size = 0.14 * scene.stage.size
    center = np.array(receiver.center)
    up = np.array(receiver.axis)
    forward = np.array([up[2], 0.0, -up[0]])
    axes = {"roll": forward, "pitch": np.cross(up, forward), "yaw": up}
    center = center + 0.014 * scene.stage.size * up
    look: Any = {"scale": size, "shaft_radius": 0.012, "tip_radius": 0.035, "tip_length": 0.12}
    for direction, color in zip(axes.values(), ("vermilion", "green", "blue"), strict=True):
        arrow = pv.Arrow(start=center, direction=direction, **look)
        scene.add_mesh(arrow, color=PALETTE[color], ambient=0.45)
    viz.add_labels(scene, [center + 1.1 * size * towards for towards in axes.values()], list(axes))
    center = center + 0.3 * size * up
    scene.camera.focal_point = tuple(center)
    scene.camera.position = tuple(center + 4.2 * size * np.array([-0.45, -0.8, 0.42]) * 1.25)
    scene.reset_camera_clipping_range()


def offset(setting: Setting) -> FigureOutput:
    """Draw the link with a receiver off the axis of the LED."""
    distance = 2.0
    made = mt.Link(receiver=mt.Receiver(position=(distance, 0.0)))
    sea = JonswapSea(seed=setting.seed, waves="paper")
    scene = viz.scene(made, sea, received=25, seed=setting.seed, style=STYLE)
    height = mt.Receiver().height
    above = (0.0, 0.0, height)
    for end, width in (((distance, 0.0, height), 4), ((0.0, 0.0, -10.0), 2)):
        scene.add_mesh(pv.Line(above, end), color=PALETTE["green"], line_width=width)
    viz.add_labels(scene, [np.array([0.0, 0.0, height + 0.7])], ["offset"])
    picture = _shot(scene)
    reach = height * float(np.tan(np.radians(0.5 * mt.Receiver().fov_deg)))
    data = xr.Dataset({"offset": ((), distance, {"units": "m"})})
    return FigureOutput(picture, data, [row("reach", (reach, reach))], {"distance": distance})


def surfaces(setting: Setting, seas: int) -> FigureOutput:
    """Draw a JONSWAP sea in both winds, as a scene and as a map."""
    axis = np.linspace(-HALF_WIDTH, HALF_WIDTH, 201)
    picture, axes = panels(2, 2, width=5.6, height=4.0)
    elevation, numbers = [], []
    for j, wind in enumerate(ROUGH):
        sea = JonswapSea(wind_speed=wind, seed=setting.seed, waves="paper")
        z = sea.grid(axis, axis)[0]
        limit = float(np.abs(z).max())
        scene = viz.scene(None, sea.mesh(extent=HALF_WIDTH, spacing=0.5), style=SEA_STYLE)
        viz.look(scene, elevation_deg=28.0)
        scene.camera.zoom(1.15)
        axes[0, j].imshow(_shot(scene))
        axes[0, j].set(title=wind_name(wind))
        axes[0, j].set_axis_off()
        colors: Any = {"cmap": viz.water_map(), "vmin": -limit, "vmax": limit}
        draw_map(axes[1, j], axis, axis, z, viz.axis_label("elevation"), **colors)
        elevation.append(z)
        numbers += _numbers(sea, axis, setting.seed, seas)
    coords = {"wind_speed": ROUGH, "x": axis, "y": axis}
    data = dataset({"elevation": np.array(elevation)}, **coords)
    return FigureOutput(picture, data, numbers)


def _numbers(sea: JonswapSea, axis: Any, seed: int, seas: int) -> list[Entry]:
    spans = []
    for i in range(seas):
        z = sea.with_seed(seed + i).grid(axis, axis)[0]
        spans.append((np.ptp(z), np.ptp(z[:, len(axis) // 2])))
    square, line = (_mean(values) for values in zip(*spans, strict=True))
    hs = components_hs(sea.components)
    words = {"wind": wind_name(sea.wind_speed), "u": sea.wind_speed}
    found: dict[str, Number | float] = {"square": square, "line": line, "hs": hs}
    return [row(key, (number, number), **words) for key, number in found.items()]


def _mean(values: tuple[float, ...]) -> Number:
    return Number(float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(len(values))))
