"""Figures of the mean gain over a parameter of the link."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.paper.canvas import WIND_COLORS, dataset, form_panels, mark_printed, wind_name
from meshtrace.paper.links import FORMS, ROUGH, WINDS, Form, Mean, decibel, mean_gain, ratio
from meshtrace.paper.registry import PRINTED, Entry, FigureOutput, Number, Setting, row
from meshtrace.viz import plot_sweep

Gains = dict[tuple[Form, float], list[Mean]]


class Sweep(NamedTuple):
    """Mean gains over the values of a parameter, by form and wind."""

    name: str
    values: Sequence[float]
    gains: Gains

    def means(self, wind: float, value: float) -> list[Mean]:
        """Return the means of both forms at one value."""
        return [self.gains[form, wind][self.values.index(value)] for form in FORMS]

    def at(self, wind: float, value: float) -> list[Number]:
        """Return the gains of both forms at one value."""
        return [mean.number for mean in self.means(wind, value)]

    def loss(self, wind: float, before: float, after: float) -> list[Number]:
        """Return the losses [dB] from one value to another, of both forms."""
        quotients = map(Mean.over, self.means(wind, before), self.means(wind, after))
        return list(map(decibel, quotients))

    def column(self, form: Form, wind: float, i: int) -> NDArray[np.float64]:
        """Return the gains (0) or their standard errors (1)."""
        return np.array([mean.number[i] for mean in self.gains[form, wind]])

    def output(
        self, numbers: list[Entry], printed: Sequence[tuple[float, str]] = ()
    ) -> FigureOutput:
        """Return the figure: correct physics beside the forms as published."""
        coords = {"form": FORMS, "wind_speed": WINDS, self.name: self.values}
        columns = {
            key: [[self.column(f, u, i) for u in WINDS] for f in FORMS]
            for i, key in enumerate(("gain", "gain_stderr"))
        }
        data = dataset(columns, **coords)
        named = data.assign_coords(wind_speed=[wind_name(u) for u in WINDS])
        picture, axes = form_panels(sharey=True)
        for form, ax in axes.items():
            ax.set_prop_cycle(color=[WIND_COLORS[u] for u in WINDS])
            plot_sweep(named.sel(form=form), ax=ax)
            if printed:
                mark_printed(ax, [p[0] for p in printed], [PRINTED[p[1]].value for p in printed])
            ax.legend()
        axes["paper"].set_ylabel("")
        return FigureOutput(picture, data, numbers)


def _sources(key: str, values: Sequence[float], setting: Setting, **effort: int) -> Sweep:
    """Return gains of one source at a time, for each value of a key of the LED."""

    def gains(form: Form, wind: float) -> list[Mean]:
        tables: Any = [{"transmitter": {key: value}} for value in values]
        return [mean_gain(wind, form, setting, **effort, **table)[0] for table in tables]

    return Sweep(key, values, {(form, wind): gains(form, wind) for form in FORMS for wind in WINDS})


def _receivers(
    name: str, receivers: dict[float, dict[str, Any]], setting: Setting, **effort: int
) -> Sweep:
    """Return gains of one receiver for each value, all over the same seas."""
    tables: Any = {**effort, "receiver": list(receivers.values())}
    gains = {(f, u): mean_gain(u, f, setting, **tables) for f in FORMS for u in WINDS}
    return Sweep(name, tuple(receivers), gains)


def gain_half_angle(setting: Setting, **effort: int) -> FigureOutput:
    """Draw the mean gain over the LED's half angle."""
    sweep = _sources("half_angle_deg", (5.0, 10.0, 20.0, 30.0, 45.0, 60.0), setting, **effort)
    printed = [(5.0, "gain-half-angle-5"), (10.0, "gain-5"), (60.0, "gain-half-angle-60")]
    numbers = [row("gain", sweep.at(5.0, angle), angle=angle, key=key) for angle, key in printed]
    numbers.append(row("loss", sweep.loss(5.0, 5.0, 60.0)))
    return sweep.output(numbers, printed)


def gain_depth(setting: Setting, **effort: int) -> FigureOutput:
    """Draw the mean gain over the LED's depth."""
    sweep = _sources("depth", (10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0), setting, **effort)
    numbers = [row("first", sweep.at(u, 10.0), wind=wind_name(u), u=u) for u in ROUGH]
    numbers += [
        row("gain", sweep.at(u, depth), wind=wind_name(u), depth=depth)
        for depth in (20.0, 40.0)
        for u in ROUGH
    ]
    return sweep.output(numbers, [(10.0, "gain-5"), (10.0, "gain-13")])


def gain_height(setting: Setting, **effort: int) -> FigureOutput:
    """Draw the mean gain over the height of the receiver."""
    heights = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
    sweep = _receivers("height", {h: {"height": h} for h in heights}, setting, **effort)
    numbers = [
        row("ratio", map(ratio, sweep.at(0.0, height), sweep.at(u, height)), u=u, height=height)
        for height in (5.0, 10.0)
        for u in ROUGH
    ]
    numbers += [
        row("fluctuation", [m.fluctuation for m in sweep.means(u, height)], u=u, height=height)
        for height in (2.0, 10.0)
        for u in ROUGH
    ]
    return sweep.output(numbers, [(5.0, "gain-5"), (5.0, "gain-13")])


def gain_radius(setting: Setting, **effort: int) -> FigureOutput:
    """Draw the mean gain over the radius of the aperture."""
    radii = (0.01, 0.02, 0.03, 0.05, 0.07, 0.1)
    sweep = _receivers("radius", {r: {"radius": r} for r in radii}, setting, **effort)
    numbers = []
    for u in WINDS:
        logs = [np.log(sweep.column(form, u, 0)) for form in FORMS]
        slopes = [float(np.polyfit(np.log(radii), g, 1)[0]) for g in logs]
        numbers.append(row("power", slopes, wind=wind_name(u)))
    return sweep.output(numbers, [(0.05, "gain-5"), (0.05, "gain-13")])


def gain_offset(setting: Setting, **effort: int) -> FigureOutput:
    """Draw the mean gain over the horizontal offset of the receiver, down-wind."""
    offsets = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0)
    sweep = _receivers("offset", {x: {"position": [x, 0.0]} for x in offsets}, setting, **effort)
    losses = {u: sweep.loss(u, 0.0, 0.5) for u in ROUGH}
    return sweep.output([row("loss", g, wind=wind_name(u), u=u) for u, g in losses.items()])
