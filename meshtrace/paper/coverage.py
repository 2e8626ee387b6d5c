"""Figures of the gain over the plane of the receiver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import meshtrace as mt
from meshtrace.paper.canvas import dataset, panels, wind_name
from meshtrace.paper.links import FORM_NAMES, FORMS, Form, decibel, ratio, scenario
from meshtrace.paper.registry import FigureOutput, Number, Setting, row
from meshtrace.viz import axis_label

WINDS = (5.0, 13.0)
EXTENT = 5.0
"""Half-width of the maps [m]."""

DEPTH = 15.0
"""Depth of the colours [dB]."""

CENTRE = 1.0
"""Radius about the axis that counts as the centre [m]."""

RING = (3.0, 4.0)
"""Distances from the axis between which the fall of the gain is taken [m]."""


def coverage_half_angle(setting: Setting, **effort: Any) -> FigureOutput:
    """Draw coverage maps for three half angles."""
    return _maps("half_angle_deg", (10.0, 20.0, 30.0), "half angle {:g}°", setting, **effort)


def coverage_depth(setting: Setting, **effort: Any) -> FigureOutput:
    """Draw coverage maps for three depths."""
    return _maps("depth", (15.0, 30.0, 40.0), "depth {:g} m", setting, **effort)


def _maps(
    name: str,
    values: Sequence[float],
    title: str,
    setting: Setting,
    photons: int,
    times: int,
    step: float,
) -> FigureOutput:
    cases = [(form, wind) for form in FORMS for wind in WINDS]
    made = {
        (form, wind, value): _map(form, wind, name, value, setting, photons, times, step)
        for form, wind in cases
        for value in values
    }
    picture, axes = panels(len(cases), len(values), width=4.0, height=3.3)
    for i, (form, wind) in enumerate(cases):
        for j, value in enumerate(values):
            what = f"{FORM_NAMES[form]}, {wind_name(wind)}, {title.format(value)}"
            _draw(axes[i, j], made[form, wind, value], what)
    words = {"inner": RING[0], "outer": RING[1], "centre": CENTRE}
    numbers = [
        row(
            "fall",
            [_fall(made[form, wind, value]) for form in FORMS],
            wind=wind_name(wind),
            case=title.format(value),
            **words,
        )
        for wind in WINDS
        for value in values
    ]
    first = next(iter(made.values()))
    shape = (len(FORMS), len(WINDS), len(values), len(first.x), len(first.y))
    data = dataset(
        ("form", "wind_speed", name, "x", "y"),
        {
            k: np.reshape([getattr(m, k) for m in made.values()], shape)
            for k in ("gain", "gain_stderr")
        },
        form=FORMS,
        wind_speed=WINDS,
        **{name: values},
        x=first.x,
        y=first.y,
    )
    return FigureOutput(picture, data, numbers)


def _map(
    form: Form,
    wind: float,
    name: str,
    value: float,
    setting: Setting,
    photons: int,
    times: int,
    step: float,
) -> mt.CoverageMap:
    made = scenario(wind, form, transmitter={name: value}, run={"estimator": "analog"})
    return mt.coverage_map(
        made.link,
        made.surface,
        extent=EXTENT,
        step=step,
        times=[2.0 * i for i in range(times)],
        photons=photons,
        seed=setting.seed,
        threads=setting.threads,
    )


def _draw(ax: Any, found: mt.CoverageMap, title: str) -> None:
    with np.errstate(divide="ignore"):
        level = 10.0 * np.log10(found.gain / _centre(found).value)
    level = np.maximum(level, -DEPTH)
    look: Any = {"vmin": -DEPTH, "vmax": 1.0, "shading": "nearest", "rasterized": True}
    image = ax.pcolormesh(found.x, found.y, level.T, **look)
    text = f"relative gain [dB]\n0 dB is {decibel(_centre(found)).value:.1f} dB"
    ax.figure.colorbar(image, ax=ax, label=text)
    angle = np.linspace(0.0, 2.0 * np.pi, 60)
    radius = mt.Receiver().radius
    ax.plot(radius * np.cos(angle), radius * np.sin(angle), color="#00e676", lw=1.5)
    ax.set_title(title, fontsize=9.5)
    ax.set(aspect="equal", xlabel=axis_label("x"), ylabel=axis_label("y"))
    ax.grid(visible=False)


def _centre(found: mt.CoverageMap) -> Number:
    """Return the mean gain within `CENTRE` of the axis."""
    return _mean(found, 0.0, CENTRE)


def _mean(found: mt.CoverageMap, inner: float, outer: float) -> Number:
    """Return the mean gain of the cells between two distances from the axis [m]."""
    x, y = np.meshgrid(found.x, found.y, indexing="ij")
    distance = np.hypot(x, y)
    inside = (distance >= inner) & (distance < outer)
    error = np.sqrt(np.sum(found.gain_stderr[inside] ** 2)) / inside.sum()
    return Number(float(found.gain[inside].mean()), float(error))


def _fall(found: mt.CoverageMap) -> Number:
    """Return the gain in the ring over that of the centre [dB]."""
    return decibel(ratio(_mean(found, *RING), _centre(found)))
