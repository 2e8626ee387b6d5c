"""Figures of photons one by one: their fates, and the gain over the plane of the receiver."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

import meshtrace as mt
from meshtrace.paper.canvas import dataset, form_panels, panels, wind_name
from meshtrace.paper.links import FORM_NAMES, FORMS, RADIUS, ROUGH, decibel, ratio, scenario
from meshtrace.paper.registry import FigureOutput, Number, Setting, row
from meshtrace.results.gain import FATE_MEANING, Fate
from meshtrace.viz import plot_fates
from meshtrace.viz.style import draw_map

EXTENT = 5.0
"""Half-width of the maps [m]."""

DEPTH = 15.0
"""Range of the colours below 0 dB [dB]."""

CENTRE = 1.0
"""Radius of the central disk [m]."""

RING = (3.0, 4.0)
"""Inner and outer radius of the ring whose gain is compared with the centre [m]."""


def fates(setting: Setting, photons: int) -> FigureOutput:
    """Draw shares of the light by fate."""
    picture, axes = form_panels(width=6.4)
    shares = {}
    for form, ax in axes.items():
        made = scenario(ROUGH[1], form, receiver={"radius": RADIUS}, run={"estimator": "analog"})
        options: Any = {"estimator": "analog", "photons": photons, **setting.run}
        result = mt.simulate(made.link, made.surface, **options)
        plot_fates(result, ax=ax)
        shares[form] = {name: tally.weight for name, tally in result.fates.items()}
    table = pd.DataFrame(shares).fillna(0.0)
    numbers = [
        row(
            "share",
            [Number(s, float(np.sqrt(max(s * photons, 0.0)) / photons)) for s in both],
            fate=FATE_MEANING[Fate[str(name).upper()]],
        )
        for name, both in zip(table.index, table.to_numpy(), strict=True)
        if max(both) > 0.0
    ]
    data = dataset({"fate_weight": table.to_numpy().T}, form=FORMS, fate=table.index)
    return FigureOutput(picture, data, numbers, {"wind": ROUGH[1], "radius": RADIUS})


def coverage_half_angle(setting: Setting, **effort: Any) -> FigureOutput:
    """Draw coverage maps for three half angles."""
    return _maps("half_angle_deg", (10.0, 20.0, 30.0), "half angle {:g}°", setting, **effort)


def coverage_depth(setting: Setting, **effort: Any) -> FigureOutput:
    """Draw coverage maps for three depths."""
    return _maps("depth", (15.0, 30.0, 40.0), "depth {:g} m", setting, **effort)


def _maps(
    name: str, values: Sequence[float], title: str, setting: Setting,
    photons: int, times: int, step: float,
) -> FigureOutput:  # fmt: skip
    options: Any = {"extent": EXTENT, "step": step, "photons": photons, **setting.run}
    options["times"] = [2.0 * i for i in range(times)]
    cases = list(itertools.product(FORMS, ROUGH))
    picture, axes = panels(len(cases), len(values), width=4.0, height=3.3)
    made = {}
    for i, (form, wind) in enumerate(cases):
        for j, value in enumerate(values):
            link = scenario(wind, form, transmitter={name: value}, run={"estimator": "analog"})
            found = mt.coverage_map(link.link, link.surface, **options)
            made[form, wind, value] = found
            _draw(axes[i, j], found)
            text = f"{FORM_NAMES[form]}, {wind_name(wind)}, {title.format(value)}"
            axes[i, j].set_title(text, fontsize=9.5)
    words = {"inner": RING[0], "outer": RING[1], "centre": CENTRE}
    numbers = []
    for wind, value in itertools.product(ROUGH, values):
        case = {"wind": wind_name(wind), "case": title.format(value), **words}
        numbers.append(row("fall", [_fall(made[form, wind, value]) for form in FORMS], **case))
    shape = (len(FORMS), len(ROUGH), len(values), len(found.x), len(found.y))
    columns = {
        key: np.reshape([getattr(m, key) for m in made.values()], shape)
        for key in ("gain", "gain_stderr")
    }
    coords = {"form": FORMS, "wind_speed": ROUGH, name: values, "x": found.x, "y": found.y}
    return FigureOutput(picture, dataset(columns, **coords), numbers)


def _draw(ax: Any, found: mt.CoverageMap) -> None:
    """Draw a map in decibels relative to its centre, with the circle of the aperture."""
    centre = _mean(found, 0.0, CENTRE)
    with np.errstate(divide="ignore"):
        level = np.maximum(10.0 * np.log10(found.gain / centre.value), -DEPTH)
    label = f"relative gain [dB]\n0 dB is {decibel(centre).value:.1f} dB"
    draw_map(ax, found.x, found.y, level, label, vmin=-DEPTH, vmax=1.0)
    angle = np.linspace(0.0, 2.0 * np.pi, 60)
    radius = mt.Receiver().radius
    ax.plot(radius * np.cos(angle), radius * np.sin(angle), color="#00e676", lw=1.5)


def _mean(found: mt.CoverageMap, inner: float, outer: float) -> Number:
    """Return the mean gain of the cells between two distances from the axis [m]."""
    x, y = np.meshgrid(found.x, found.y, indexing="ij")
    distance = np.hypot(x, y)
    inside = (distance >= inner) & (distance < outer)
    error = np.sqrt(np.sum(found.gain_stderr[inside] ** 2)) / inside.sum()
    return Number(float(found.gain[inside].mean()), float(error))


def _fall(found: mt.CoverageMap) -> Number:
    """Return the gain in the ring over that of the centre [dB]."""
    return decibel(ratio(_mean(found, *RING), _mean(found, 0.0, CENTRE)))
