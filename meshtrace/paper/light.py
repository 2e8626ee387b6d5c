"""Figures of photons one by one, and of the gain over a plane, in time and over seas."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

import meshtrace as mt
from meshtrace import viz
from meshtrace.fields import attrs
from meshtrace.paper.links import (
    FORM_NAMES,
    FORMS,
    RADIUS,
    ROUGH,
    UAV,
    WIND_COLORS,
    Form,
    bubble_factor,
    decibel,
    forced,
    form_panels,
    gusts,
    panels,
    ratio,
    scenario,
    wind_lines,
    wind_name,
    wind_rows,
)
from meshtrace.paper.registry import FigureOutput, Number, Setting, row
from meshtrace.results.gain import FATE_MEANING
from meshtrace.uav.tilt import h_alpha

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
        viz.plot_fates(result, ax=ax)
        shares[form] = {name: tally.weight for name, tally in result.fates.items()}
    table = pd.DataFrame(shares).fillna(0.0)
    numbers = [
        row(
            "share",
            [Number(s, float(np.sqrt(max(s * photons, 0.0)) / photons)) for s in both],
            fate=FATE_MEANING[mt.Fate[str(name).upper()]],
        )
        for name, both in zip(table.index, table.to_numpy(), strict=True)
        if max(both) > 0.0
    ]
    data = viz.marks.dataset({"fate_weight": table.to_numpy().T}, form=FORMS, fate=table.index)
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
    return FigureOutput(picture, viz.marks.dataset(columns, **coords), numbers)


def _draw(ax: Any, found: mt.CoverageMap) -> None:
    """Draw a map in decibels relative to its centre, with the circle of the aperture."""
    centre = _mean(found, 0.0, CENTRE)
    with np.errstate(divide="ignore"):
        level = np.maximum(10.0 * np.log10(found.gain / centre.value), -DEPTH)
    label = f"relative gain [dB]\n0 dB is {decibel(centre).value:.1f} dB"
    viz.marks.heat_map(ax, found.x, found.y, level, label, vmin=-DEPTH, vmax=1.0)
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


DURATION = 10.0
COMMON_CUT_OFF = 4.0
"""Highest frequency of waves in a common band [rad s-1], that of the paper at 5 m/s."""


def _factor(angle: Any) -> Any:
    return h_alpha(angle, float(np.radians(mt.Receiver().fov_deg)))


def gain_series(setting: Setting, times: int, photons: int, analog: int) -> FigureOutput:
    """Draw the gain over a moving sea with the tilt of a flying UAV."""
    at = np.linspace(0.0, DURATION, times)
    picture, axes = panels(2, 1, width=8.0, height=2.9, sharex=True)
    gains, spreads = {}, {}
    for form in FORMS:
        for wind in ROUGH:
            made = forced(wind, form)
            series = mt.time_series(made.link, made.surface, at, photons=photons, **setting.run)
            flight = UAV.simulate_flight(gusts(wind, form), at, setting.seed)
            bubbles = _bubbles(wind, form, setting, analog)
            factor = bubbles.value * _factor(flight.tilt.angle)
            mean = series.gain * factor
            error = factor * np.hypot(series.gain_stderr, series.gain * bubbles.relative)
            gains[form, wind] = mean, error
            spreads[form, wind] = series.gain.std(ddof=1) / series.gain.mean()
    columns = np.moveaxis(np.array([[gains[f, u] for u in ROUGH] for f in FORMS]), 2, 0)
    coords = {"form": FORMS, "wind_speed": ROUGH, "time": at}
    found = dict(zip(("gain", "gain_stderr"), columns, strict=True))
    data = viz.marks.dataset(found, **coords)
    for form, ax in zip(FORMS, axes[:, 0], strict=True):
        wind_lines(ax, data.sel(form=form), "gain")
        ax.set(title=FORM_NAMES[form], ylim=(0.0, None))
        ax.legend(ncols=2)
    axes[0, 0].set_xlabel("")
    return FigureOutput(picture, data, wind_rows("spread", spreads))


def gain_distribution(
    setting: Setting, realizations: int, paper_realizations: int, photons: int, analog: int
) -> FigureOutput:
    """Draw densities of the gain over independent seas, with tilts."""
    counts = {"physical": realizations, "paper": paper_realizations}
    picture, axes = form_panels()
    means, indices, variables, factors = {}, {}, {}, {}
    for form, ax in axes.items():
        for wind in ROUGH:
            made = forced(wind, form)
            series = _ensemble(made, counts[form], photons, setting)
            winds = gusts(wind, form).sample_wind(counts[form], setting.seed)
            bubbles = factors[form, wind] = _bubbles(wind, form, setting, analog)
            gain = bubbles.value * series.gain * _factor(UAV.tilt(winds).angle)
            spread = gain.std(ddof=1) / np.sqrt(len(gain))
            chains = bubbles.value * series.mean_stderr
            error = float(np.hypot(np.hypot(spread, chains), gain.mean() * bubbles.relative))
            means[form, wind] = Number(float(gain.mean()), error)
            indices[form, wind] = _index(series)
            histogram, color = mt.fading.gain_pdf(gain), WIND_COLORS[wind]
            ax.stairs(histogram.density, histogram.edges, color=color, label=wind_name(wind))
            ax.axvline(gain.mean(), color=color, lw=1.0, ls="--")
            variables[f"gain_{form}_{wind:g}"] = f"realization_{form}", gain, attrs("gain")
        x, y = viz.axis_label("gain"), viz.axis_label("gain_pdf")
        viz.marks.finished(ax, xlim=(0.0, None), xlabel=x, ylabel=y)

    def common(form: Form, wind: float) -> Number:
        made = forced(wind, form, sea={"omega_max": COMMON_CUT_OFF})
        return _index(_ensemble(made, max(counts[form] // 10, 40), photons, setting))

    ratios = [ratio(means[form, ROUGH[1]], means[form, ROUGH[0]]) for form in FORMS]
    numbers = [*wind_rows("mean", means), row("ratio", ratios), *wind_rows("index", indices)]
    numbers += wind_rows("common", {pair: common(*pair) for pair in means})
    effects = [bubble_factor(ROUGH[1], "physical", setting, analog), factors["paper", ROUGH[1]]]
    numbers.append(row("bubbles", effects, radius=RADIUS))
    return FigureOutput(picture, xr.Dataset(variables), numbers)


def _ensemble(
    made: mt.Scenario, realizations: int, photons: int, setting: Setting
) -> mt.GainSeries:
    return mt.ensemble(made.link, realizations, made.surface, photons=photons, **setting.run)


def _index(series: mt.GainSeries) -> Number:
    """Return the scintillation index; its 95 % interval as a standard error."""
    found = series.fading(test_resamples=0, seed=0).scintillation_index
    return Number(found.value, (found.high - found.low) / (2.0 * 1.96))


def _bubbles(wind: float, form: Form, setting: Setting, analog: int) -> Number:
    """Return the factor for the bubbles that forced detection leaves out."""
    return bubble_factor(wind, form, setting, analog) if form == "paper" else Number(1.0)
