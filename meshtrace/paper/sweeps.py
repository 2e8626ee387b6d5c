"""Figures of the mean gain over a parameter of the link."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshtrace.paper.canvas import WIND_COLORS, dataset, mark_printed, panels, wind_name
from meshtrace.paper.links import (
    FORM_NAMES,
    FORMS,
    WINDS,
    Form,
    Mean,
    decibel,
    mean_gain,
    ratio,
)
from meshtrace.paper.registry import PRINTED, Entry, FigureOutput, Number, Setting, row
from meshtrace.viz import plot_sweep

Gains = dict[tuple[Form, float], list[Mean]]


def _one_by_one(key: str, table: str, values: Sequence[float], **options: Any) -> Gains:
    """Return gains with one value at a time in a table of the link."""
    setting = options.pop("setting")
    return {
        (form, wind): [
            mean_gain(wind, form, setting, **{**options, table: {key: value}})[0]
            for value in values
        ]
        for form in FORMS
        for wind in WINDS
    }


def _receivers(
    make: Callable[[float], dict[str, Any]], values: Sequence[float], **options: Any
) -> Gains:
    """Return gains of one receiver for each value, all over the same seas."""
    setting = options.pop("setting")
    receivers = [make(value) for value in values]
    return {
        (form, wind): mean_gain(wind, form, setting, **options, receiver=receivers)
        for form in FORMS
        for wind in WINDS
    }


def _output(
    name: str,
    values: Sequence[float],
    gains: Gains,
    numbers: list[Entry],
    printed: Sequence[tuple[float, str]] = (),
) -> FigureOutput:
    """Return the picture of a sweep: right physics beside the forms as published."""
    data = dataset(
        ("form", "wind_speed", name),
        {
            key: [[_column(gains[f, u], i) for u in WINDS] for f in FORMS]
            for i, key in enumerate(("gain", "gain_stderr"))
        },
        form=FORMS,
        wind_speed=WINDS,
        **{name: values},
    )
    named = data.assign_coords(wind_speed=[wind_name(u) for u in WINDS])
    picture, axes = panels(1, 2, sharey=True)
    for ax, form in zip(axes[0], FORMS, strict=True):
        ax.set_prop_cycle(color=[WIND_COLORS[u] for u in WINDS])
        plot_sweep(named.sel(form=form), ax=ax)
        if printed:
            mark_printed(ax, [p[0] for p in printed], [PRINTED[p[1]].value for p in printed])
        ax.set_title(FORM_NAMES[form])
        ax.legend()
    axes[0, 1].set_ylabel("")
    return FigureOutput(picture, data, numbers)


def _column(means: list[Mean], i: int) -> NDArray[np.float64]:
    """Return the values (0) or their standard errors (1)."""
    return np.array([mean.number[i] for mean in means])


def _means(gains: Gains, values: Sequence[float], wind: float, value: float) -> list[Mean]:
    """Return the means of both forms at one value."""
    i = int(np.argmin(np.abs(np.asarray(values) - value)))
    return [gains[form, wind][i] for form in FORMS]


def _at(gains: Gains, values: Sequence[float], wind: float, value: float) -> list[Number]:
    """Return the gains of both forms at one value."""
    return [mean.number for mean in _means(gains, values, wind, value)]


def _loss(reference: list[Mean], other: list[Mean]) -> list[Number]:
    """Return the losses [dB] from a reference, of both forms."""
    return [decibel(a.over(b)) for a, b in zip(reference, other, strict=True)]


def gain_half_angle(setting: Setting, **effort: int) -> FigureOutput:
    """Draw the mean gain over the LED's half angle."""
    values = (5.0, 10.0, 20.0, 30.0, 45.0, 60.0)
    gains = _one_by_one("half_angle_deg", "transmitter", values, setting=setting, **effort)
    narrow, wide = (_means(gains, values, 5.0, angle) for angle in (5.0, 60.0))
    at_10 = _at(gains, values, 5.0, 10.0)
    numbers = [
        row("gain", [m.number for m in narrow], angle=5.0, key="gain-half-angle-5"),
        row("gain", at_10, angle=10.0, key="gain-5"),
        row("gain", [m.number for m in wide], angle=60.0, key="gain-half-angle-60"),
        row("loss", _loss(narrow, wide)),
    ]
    printed = [(5.0, "gain-half-angle-5"), (10.0, "gain-5"), (60.0, "gain-half-angle-60")]
    return _output("half_angle_deg", values, gains, numbers, printed)


def gain_depth(setting: Setting, **effort: int) -> FigureOutput:
    """Draw the mean gain over the LED's depth."""
    values = (10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0)
    gains = _one_by_one("depth", "transmitter", values, setting=setting, **effort)
    numbers = [
        row("first", _at(gains, values, u, 10.0), wind=wind_name(u), u=u) for u in (5.0, 13.0)
    ]
    numbers += [
        row("gain", _at(gains, values, u, depth), wind=wind_name(u), depth=depth)
        for depth in (20.0, 40.0)
        for u in (5.0, 13.0)
    ]
    return _output("depth", values, gains, numbers, [(10.0, "gain-5"), (10.0, "gain-13")])


def gain_height(setting: Setting, **effort: int) -> FigureOutput:
    """Draw the mean gain over the height of the receiver."""
    values = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
    gains = _receivers(lambda height: {"height": height}, values, setting=setting, **effort)
    numbers = []
    for height in (5.0, 10.0):
        for u in (5.0, 13.0):
            pair = zip(_at(gains, values, 0.0, height), _at(gains, values, u, height), strict=True)
            numbers.append(row("ratio", [ratio(a, b) for a, b in pair], u=u, height=height))
    return _output("height", values, gains, numbers, [(5.0, "gain-5"), (5.0, "gain-13")])


def gain_radius(setting: Setting, **effort: int) -> FigureOutput:
    """Draw the mean gain over the radius of the aperture."""
    values = (0.01, 0.02, 0.03, 0.05, 0.07, 0.1)
    gains = _receivers(lambda radius: {"radius": radius}, values, setting=setting, **effort)
    numbers = []
    for u in WINDS:
        columns = [np.log(_column(gains[form, u], 0)) for form in FORMS]
        slopes = [float(np.polyfit(np.log(values), g, 1)[0]) for g in columns]
        numbers.append(row("power", slopes, wind=wind_name(u)))
    return _output("radius", values, gains, numbers, [(0.05, "gain-5"), (0.05, "gain-13")])


def gain_offset(setting: Setting, **effort: int) -> FigureOutput:
    """Draw the mean gain over the horizontal offset of the receiver, down-wind."""
    values = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0)
    gains = _receivers(lambda x: {"position": [x, 0.0]}, values, setting=setting, **effort)
    numbers = []
    for u in (5.0, 13.0):
        losses = _loss(_means(gains, values, u, 0.0), _means(gains, values, u, 0.5))
        numbers.append(row("loss", losses, wind=wind_name(u), u=u))
    return _output("offset", values, gains, numbers)
