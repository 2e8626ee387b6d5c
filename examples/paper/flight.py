"""Figures of scenes, and of wind, tilt and their factor of the gain at the UAV."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pyvista as pv
import xarray as xr

import meshtrace as mt
from meshtrace import viz
from meshtrace.surfaces import JonswapSea
from meshtrace.surfaces.statistics import components_hs
from meshtrace.uav import compare_laws
from paper.links import FORM_NAMES, FORMS, ROUGH, UAV, Form, gusts, panels, wind_name
from paper.registry import Entry, FigureOutput, Number, Setting, row

KNOT = 1852.0 / 3600.0
"""One knot [m s-1]."""

MODERATE_W20 = 30.0
"""Wind at 20 feet for moderate turbulence [kt], Appendix B."""

_RED = viz.style.PALETTE["vermilion"]


def _laws(wind: float, form: Form) -> tuple[Any, Any]:
    """Return the exact law of the tilt and the paper's Gamma law."""
    dryden = gusts(wind, form)
    return UAV.tilt_law(dryden), UAV.tilt_law(dryden, "gamma")


def tilt(setting: Setting, samples: int) -> FigureOutput:
    """Draw sampled tilts, their exact law and the paper's Gamma law."""
    picture, axes = panels(2, 2)
    variables: dict[str, Any] = {}
    for ax, (form, wind) in zip(axes.flat, itertools.product(FORMS, ROUGH), strict=True):
        exact, gamma = _laws(wind, form)
        drawn = UAV.tilt(gusts(wind, form).sample_wind(samples, setting.seed)).angle
        grid = np.linspace(exact.ppf(1e-6), exact.ppf(1.0 - 1e-6), 400)
        density, edges = np.histogram(drawn, bins=80, density=True)
        key, per_degree = f"{form}_{wind:g}", np.radians(1.0)
        look: Any = {"fill": True, "color": viz.style.PALETTE["sky"], "alpha": 0.5}
        ax.stairs(density * per_degree, np.degrees(edges), **look, label="sampled")
        laws = (
            (exact, "exact law", "exact", "-", viz.style.INK),
            (gamma, "Gamma", "gamma", "--", _RED),
        )
        for law, label, name, dashes, color in laws:
            pdf = law.pdf(grid)
            ax.plot(np.degrees(grid), pdf * per_degree, dashes, color=color, label=label)
            variables[f"pdf_{name}_{key}"] = (f"angle_{key}", pdf, {"units": "rad-1"})
        x, y = r"tilt $\alpha$ [°]", r"probability density [1/°]"
        viz.marks.finished(ax, title=f"{wind_name(wind)}, {FORM_NAMES[form]}", xlabel=x, ylabel=y)
        variables[f"angle_{key}"] = (f"angle_{key}", grid, {"units": "rad"})
        variables[f"pdf_sampled_{key}"] = (f"bin_{key}", density, {"units": "rad-1"})
        variables[f"edges_{key}"] = (f"edge_{key}", edges, {"units": "rad"})
    numbers = [entry for wind in ROUGH for entry in _tilt_numbers(wind)]
    return FigureOutput(picture, xr.Dataset(variables), numbers)


def _tilt_numbers(wind: float) -> list[Entry]:
    pairs = [_laws(wind, form) for form in FORMS]
    distances = [compare_laws(exact, gamma) for exact, gamma in pairs]
    words = {"wind": wind_name(wind), "u": wind}
    numbers = [row("std", [float(np.degrees(exact.std())) for exact, _ in pairs], **words)]
    for name in ("rmse", "mae", "ks", "kl"):
        key = "ks" if name == "ks" else "distance"
        found = [float(getattr(d, name)) for d in distances]
        numbers.append(row(key, found, name=name.upper(), key=name, **words))
    return numbers


def h_alpha(setting: Setting) -> FigureOutput:
    """Draw the density of h_alpha with the field of view's mass at 0."""
    fov = float(np.radians(mt.Receiver().fov_deg))
    picture, axes = panels(1, 2)
    variables: dict[str, Any] = {}
    numbers = []
    for ax, wind in zip(axes[0], ROUGH, strict=True):
        laws = _laws(wind, "physical")[0], _laws(wind, "paper")[1]
        low = max(min(float(np.cos(law.ppf(1.0 - 1e-3))) for law in laws), 0.0)
        h, key = np.linspace(low, 1.0, 801)[:-1], f"h_{wind:g}"
        names = ("default, exact law", "paper preset, Gamma law")
        for form, name, law in zip(FORMS, names, laws, strict=True):
            ax.plot(h, law.h_pdf(h, fov), label=name)
            _mark_edge(ax, low, fov)
            variables[f"pdf_{form}_{wind:g}"] = (key, law.h_pdf(h, fov), {"units": "1"})
        variables[key] = (key, h, {"units": "1"})
        x, y = r"factor $h_\alpha$", r"probability density $f(h_\alpha)$"
        viz.marks.finished(ax, title=wind_name(wind), xlabel=x, ylabel=y)
        words = {"wind": wind_name(wind)}
        published = float(laws[1].tilt_coefficient ** (laws[1].shape - 1.0))
        numbers.append(row("mean", [float(law.h_moment(1, fov)) for law in laws], **words))
        numbers.append(row("outside", [float(law.outage(fov)) for law in laws], **words))
        numbers.append(row("integral", (1.0, published), **words))
    return FigureOutput(picture, xr.Dataset(variables), numbers)


def _mark_edge(ax: Any, low: float, fov: float) -> None:
    """Mark the least factor within the field of view, the end of the density."""
    edge = float(np.cos(0.5 * fov))
    if edge > low and not ax.texts:
        ax.axvline(edge, color=viz.style.INK, lw=0.8, ls=":")
        look: Any = {"fontsize": 9, "ha": "right", "va": "center", "rotation": 90}
        ax.text(edge, 0.5, "edge of the field of view ", transform=ax.get_xaxis_transform(), **look)


def wind(setting: Setting, duration: float) -> FigureOutput:
    """Draw Dryden records with a mean of 5 m/s along both axes."""
    mean = np.array([5.0, 5.0])
    speed = float(np.hypot(*mean))
    times = np.arange(0.0, duration, 0.05)
    turn = np.array([[1.0, -1.0], [1.0, 1.0]]) / np.sqrt(2.0)
    picture, axes = panels(2, 1, width=8.0, height=2.7, sharex=True)
    records, stds, errors = {}, [], []
    for form in FORMS:
        dryden = mt.Dryden.preset(form, wind_speed=speed, height=5.0, w20=MODERATE_W20 * KNOT)
        records[form] = dryden.simulate_wind(times, setting.seed)[:, :2] @ turn.T
        stds.append(float(dryden.std[0]))
        errors.append(float(dryden.std[0] * np.sqrt(2.0 * dryden.correlation_times[0] / duration)))
        for i in range(2):
            axes[i, 0].plot(times, records[form][:, i], lw=1.0, label=FORM_NAMES[form])
    for i, name in enumerate("xy"):
        axes[i, 0].axhline(mean[i], color=viz.style.INK, lw=0.8, ls=":", label="mean")
        viz.marks.finished(axes[i, 0], ylabel=f"wind $V_{name}$ [m s$^{{-1}}$]", legend=False)
    axes[0, 0].legend(ncols=3)
    axes[1, 0].set(xlabel="time $t$ [s]", xlim=(0.0, min(duration, 120.0)))
    numbers = []
    for i, axis in enumerate("xy"):
        means = [float(records[form][:, i].mean()) for form in FORMS]
        numbers.append(row("mean", map(Number, means, errors), axis=axis))
    numbers.append(row("std", stds))
    dims, units = ("time", "component"), {"units": "m s-1"}
    data = xr.Dataset(
        {f"wind_{form}": (dims, record, units) for form, record in records.items()},
        {"time": ("time", times, {"units": "s"}), "component": ["x", "y"]},
    )
    return FigureOutput(picture, data, numbers)


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
    led, receiver = made.transmitters[0], made.receivers[0]
    values = (
        ("depth of the LED", getattr(led, "depth", np.nan), "depth"),
        ("height of the receiver", receiver.center[2], "height"),
        ("half angle at half power", getattr(led, "half_angle_deg", np.nan), "half-angle"),
        ("radius of the aperture", receiver.radius, "radius"),
    )
    numbers = [row("parameter", (v, v), name=name, key=key) for name, v, key in values]
    return FigureOutput(scene, light.to_dataset(), numbers, {"wind": WIND})


def uav_axes(setting: Setting) -> FigureOutput:
    """Draw a quadcopter that leans into the wind, with its axes of roll, pitch and yaw."""
    tilts = [np.degrees(UAV.tilt_law(gusts(WIND, form)).mean()) for form in FORMS]
    receiver = mt.Receiver(tilt_deg=float(tilts[0]))
    made = mt.Link(receiver=receiver)
    sea = JonswapSea(wind_speed=WIND, seed=setting.seed, waves="paper")
    scene = viz.scene(made, sea, style=STYLE.replace(labels=False))
    _close_up(scene, receiver)
    attributes = {"units": "rad", "long_name": "mean tilt"}
    data = xr.Dataset({"tilt": ("form", np.radians(tilts), attributes)}, {"form": list(FORMS)})
    return FigureOutput(scene, data, [row("tilt", tilts, wind=WIND)], {"wind": WIND})


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
        scene.add_mesh(arrow, color=viz.style.PALETTE[color], ambient=0.45)
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
        scene.add_mesh(pv.Line(above, end), color=viz.style.PALETTE["green"], line_width=width)
    viz.add_labels(scene, [np.array([0.0, 0.0, height + 0.7])], ["offset"])
    reach = height * float(np.tan(np.radians(0.5 * mt.Receiver().fov_deg)))
    data = xr.Dataset({"offset": ((), distance, {"units": "m"})})
    return FigureOutput(scene, data, [row("reach", (reach, reach))], {"distance": distance})


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
        viz.marks.heat_map(
            axes[1, j], axis, axis, z, viz.axis_label("elevation"), colors=viz.water_map(),
            vmin=-limit, vmax=limit,
        )  # fmt: skip
        elevation.append(z)
        numbers += _numbers(sea, axis, setting.seed, seas)
    coords = {"wind_speed": ROUGH, "x": axis, "y": axis}
    data = viz.marks.dataset({"elevation": np.array(elevation)}, coords)
    return FigureOutput(picture, data, numbers)


def _numbers(sea: JonswapSea, axis: Any, seed: int, seas: int) -> list[Entry]:
    spans = []
    for i in range(seas):
        z = sea.with_seed(seed + i).grid(axis, axis)[0]
        spans.append((np.ptp(z), np.ptp(z[:, len(axis) // 2])))
    means, errors = np.mean(spans, axis=0), np.std(spans, axis=0, ddof=1) / np.sqrt(seas)
    square, line = map(Number, means.tolist(), errors.tolist())
    words = {"wind": wind_name(sea.wind_speed), "u": sea.wind_speed}
    hs = components_hs(sea.components)
    found: dict[str, Number | float] = {"square": square, "line": line, "hs": hs}
    return [row(key, (number, number), **words) for key, number in found.items()]
