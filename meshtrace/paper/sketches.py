"""Figures of geometry: the link, the UAV's axes, and the offset of the receiver."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyvista as pv
import xarray as xr

import meshtrace as mt
from meshtrace import viz
from meshtrace.paper.links import FORMS, gusts
from meshtrace.paper.registry import Drawing, Number, Setting, compared, figure
from meshtrace.surfaces import FlatSea, JonswapSea
from meshtrace.uav.airframe import UAVS
from meshtrace.viz.style import PALETTE

SIZE = (1400, 875)
"""Pixels of a scene."""

WIND = 13.0


def _shot(scene: Any) -> Any:
    """Return the picture of a scene and close it."""
    picture = np.asarray(scene.screenshot(return_img=True))[..., :3].copy()
    scene.close()
    return picture


@figure("link", "1", "the link", quick={"paths": 60}, full={"paths": 150})
def link(setting: Setting, paths: int) -> Drawing:
    """Draw lamp, sea, bubbles, light and UAV."""
    made = mt.Link(bubbles=mt.HallNovarini(wind_speed=WIND))
    sea = JonswapSea(wind_speed=WIND, seed=setting.seed)
    light = mt.trace_paths(made, sea, paths, seed=setting.seed)
    scene = viz.scene(
        made, sea, paths=light, received=40, seed=setting.seed, off_screen=True, window_size=SIZE
    )
    picture = _shot(scene)
    led, receiver = made.transmitters[0], made.receivers[0]
    why = "Taken from the paper's table of parameters by both."
    values = (
        ("depth of the lamp", getattr(led, "depth", np.nan), "depth"),
        ("height of the receiver", receiver.center[2], "height"),
        ("half angle at half power", getattr(led, "half_angle_deg", np.nan), "half-angle"),
        ("radius of the aperture", receiver.radius, "radius"),
    )
    rows = [
        compared(what, (Number(float(value)), Number(float(value))), why, printed=key)
        for what, value, key in values
    ]
    caption = (
        f"The paper's link over a JONSWAP sea at {WIND:g} m/s, to scale but for lamp, receiver and "
        "UAV, with paths of photons: some as they come, and some that reach the receiver."
    )
    return Drawing(picture, light.to_dataset(), rows, caption)


@figure("uav-axes", "3", "axes of the UAV and their angles")
def uav_axes(setting: Setting) -> Drawing:
    """Draw a quadcopter that leans into the wind, with its axes of roll, pitch and yaw."""
    tilts = [np.degrees(UAVS["dji-m300-rtk"].tilt_law(gusts(WIND, form)).mean()) for form in FORMS]
    receiver = mt.Receiver(tilt_deg=float(tilts[0]))
    made = mt.Link(receiver=receiver)
    scene = viz.scene(
        made, FlatSea(), labels=False, color="plain", off_screen=True, window_size=SIZE
    )
    _close_up(scene, receiver)
    picture = _shot(scene)
    rows = [
        compared(
            f"mean tilt at {WIND:g} m/s",
            (Number(float(t)) for t in tilts),
            "Stronger gusts add to the mean square of the wind, and so to the tilt; the paper "
            "prints no mean.",
            unit="degree",
        )
    ]
    data = xr.Dataset(
        {"tilt": ("form", np.radians(tilts), {"units": "rad", "long_name": "mean tilt"})},
        {"form": list(FORMS)},
    )
    caption = (
        f"Axes of roll, pitch and yaw of a UAV, here leaning as it does on average at {WIND:g} m/s "
        "(wind along x, to the right): cos(alpha) = cos(pitch) cos(roll). Simulations use the "
        "angle alpha and the direction in which it leans."
    )
    return Drawing(picture, data, rows, caption)


def _close_up(scene: Any, receiver: mt.Receiver) -> None:
    """Draw the axes of a UAV and look at it from nearby."""
    size = 0.14 * scene.stage.size
    center = np.array(receiver.center)
    up = np.array(receiver.axis)
    forward = np.array([up[2], 0.0, -up[0]])
    axes = {
        "roll": (forward, "vermilion"),
        "pitch": (np.cross(up, forward), "green"),
        "yaw": (up, "blue"),
    }
    center = center + 0.014 * scene.stage.size * up
    for direction, color in axes.values():
        arrow = pv.Arrow(
            start=center, direction=direction, scale=size, shaft_radius=0.012, tip_radius=0.035,
            tip_length=0.12,
        )  # fmt: skip
        scene.add_mesh(arrow, color=PALETTE[color], ambient=0.45)
    ends = [center + 1.1 * size * direction for direction, _ in axes.values()]
    viz.add_labels(scene, ends, list(axes))
    center = center + 0.3 * size * up
    scene.camera.focal_point = tuple(center)
    scene.camera.position = tuple(center + 4.2 * size * np.array([-0.45, -0.8, 0.42]) * 1.25)
    scene.reset_camera_clipping_range()


@figure("offset", "18", "offset of the receiver")
def offset(setting: Setting) -> Drawing:
    """Draw the link with a receiver that is not above the lamp."""
    distance = 2.0
    made = mt.Link(receiver=mt.Receiver(position=(distance, 0.0)))
    sea = JonswapSea(seed=setting.seed)
    scene = viz.scene(made, sea, received=25, seed=setting.seed, off_screen=True, window_size=SIZE)
    height = mt.Receiver().height
    line = pv.Line((0.0, 0.0, height), (distance, 0.0, height))
    scene.add_mesh(line, color=PALETTE["green"], line_width=4)
    plumb = pv.Line((0.0, 0.0, -10.0), (0.0, 0.0, height))
    scene.add_mesh(plumb, color=PALETTE["green"], line_width=2)
    viz.add_labels(scene, [np.array([0.0, 0.0, height + 0.7])], ["offset"])
    picture = _shot(scene)
    why = "Half of the field of view, seen from the receiver; the same for both forms."
    reach = height * float(np.tan(np.radians(0.5 * mt.Receiver().fov_deg)))
    rows = [
        compared(
            "radius of the field of view on still water",
            (Number(reach), Number(reach)),
            why,
            unit="m",
        )
    ]
    data = xr.Dataset({"offset": ((), distance, {"units": "m"})})
    caption = (
        f"The receiver {distance:g} m down-wind of the lamp, with light that still reaches it. The "
        "gain over the offset has a figure of its own."
    )
    return Drawing(picture, data, rows, caption)
