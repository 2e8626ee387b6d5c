"""Figures of the gain in time and of its distribution over seas."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

import meshtrace as mt
from meshtrace.fading import gain_pdf
from meshtrace.fields import attrs
from meshtrace.paper.canvas import WIND_COLORS, dataset, form_panels, panels, wind_name
from meshtrace.paper.links import (
    FORM_NAMES,
    FORMS,
    RADIUS,
    Form,
    bubble_factor,
    forced,
    gusts,
    ratio,
)
from meshtrace.paper.registry import FigureOutput, Number, Setting, row
from meshtrace.scenario import Scenario
from meshtrace.uav.airframe import UAVS
from meshtrace.uav.tilt import h_alpha
from meshtrace.viz import axis_label

WINDS = (5.0, 13.0)
DURATION = 10.0
COMMON_CUT_OFF = 4.0
"""Highest frequency of waves in a common band [rad s-1], that of the paper at 5 m/s."""

_UAV = UAVS["dji-m300-rtk"]


def _factor(angle: Any) -> Any:
    return h_alpha(angle, float(np.radians(mt.Receiver().fov_deg)))


def gain_series(setting: Setting, times: int, photons: int, analog: int) -> FigureOutput:
    """Draw the gain over a moving sea with the tilt of a flying UAV."""
    at = np.linspace(0.0, DURATION, times)
    picture, axes = panels(2, 1, width=8.0, height=2.9, sharex=True)
    gains, numbers = {}, []
    for ax, form in zip(axes[:, 0], FORMS, strict=True):
        for wind in WINDS:
            made = forced(wind, form)
            series = mt.time_series(made.link, made.surface, at, photons=photons, **setting.run)
            flight = _UAV.simulate_flight(gusts(wind, form), at, setting.seed)
            bubbles = _bubbles(wind, form, setting, analog)
            factor = bubbles.value * _factor(flight.tilt.angle)
            error = factor * np.hypot(series.gain_stderr, series.gain * bubbles.relative)
            gains[form, wind] = series, series.gain * factor, error
            mean, band = gains[form, wind][1], 2.0 * gains[form, wind][2]
            ax.plot(at, mean, color=WIND_COLORS[wind], label=wind_name(wind))
            look: Any = {"color": WIND_COLORS[wind], "alpha": 0.25, "lw": 0}
            ax.fill_between(at, mean - band, mean + band, **look)
        ax.set(ylabel=axis_label("gain"), title=FORM_NAMES[form])
        ax.set_ylim(bottom=0.0)
        ax.legend(ncols=2)
    axes[1, 0].set(xlabel=axis_label("time"))
    for wind in WINDS:
        pair = [gains[form, wind][0].gain for form in FORMS]
        numbers.append(
            row("spread", [g.std(ddof=1) / g.mean() for g in pair], wind=wind_name(wind))
        )
    columns = {
        name: [[gains[form, wind][i] for wind in WINDS] for form in FORMS]
        for i, name in ((1, "gain"), (2, "gain_stderr"))
    }
    coords = {"form": FORMS, "wind_speed": WINDS, "time": at}
    return FigureOutput(picture, dataset(tuple(coords), columns, **coords), numbers)


def gain_distribution(
    setting: Setting, realizations: int, paper_realizations: int, photons: int, analog: int
) -> FigureOutput:
    """Draw densities of the gain over independent seas, with tilts."""
    counts = {"physical": realizations, "paper": paper_realizations}
    picture, axes = form_panels()
    means, indices, variables, factors = {}, {}, {}, {}
    for form, ax in axes.items():
        for wind in WINDS:
            made = forced(wind, form)
            series = _ensemble(made, counts[form], photons, setting)
            winds = gusts(wind, form).sample_wind(counts[form], setting.seed)
            bubbles = factors[form, wind] = _bubbles(wind, form, setting, analog)
            gain = bubbles.value * series.gain * _factor(_UAV.tilt(winds).angle)
            spread = gain.std(ddof=1) / np.sqrt(len(gain))
            chains = bubbles.value * series.mean_stderr
            error = float(np.hypot(np.hypot(spread, chains), gain.mean() * bubbles.relative))
            means[form, wind] = Number(float(gain.mean()), error)
            indices[form, wind] = _index(series)
            histogram, color = gain_pdf(gain), WIND_COLORS[wind]
            ax.stairs(histogram.density, histogram.edges, color=color, label=wind_name(wind))
            ax.axvline(gain.mean(), color=color, lw=1.0, ls="--")
            variables[f"gain_{form}_{wind:g}"] = f"realization_{form}", gain, attrs("gain")
        ax.set(xlabel=axis_label("gain"), ylabel=axis_label("gain_pdf"))
        ax.set_xlim(left=0.0)
        ax.legend()
    numbers = []
    for wind in WINDS:
        words = {"wind": wind_name(wind), "u": wind}
        numbers.append(row("mean", [means[form, wind] for form in FORMS], **words))
    ratios = [ratio(means[form, WINDS[1]], means[form, WINDS[0]]) for form in FORMS]
    numbers.append(row("ratio", ratios))
    for wind in WINDS:
        pair = [indices[form, wind] for form in FORMS]
        numbers.append(row("index", pair, wind=wind_name(wind)))
    for wind in WINDS:
        pair = []
        for form in FORMS:
            made = forced(wind, form, sea={"omega_max": COMMON_CUT_OFF})
            few = max(counts[form] // 10, 40)
            pair.append(_index(_ensemble(made, few, photons, setting)))
        numbers.append(row("common", pair, wind=wind_name(wind)))
    effects = [bubble_factor(WINDS[1], "physical", setting, analog), factors["paper", WINDS[1]]]
    numbers.append(row("bubbles", effects, radius=RADIUS))
    return FigureOutput(picture, xr.Dataset(variables), numbers)


def _ensemble(made: Scenario, realizations: int, photons: int, setting: Setting) -> mt.GainSeries:
    return mt.ensemble(made.link, realizations, made.surface, photons=photons, **setting.run)


def _index(series: mt.GainSeries) -> Number:
    """Return the scintillation index; its 95 % interval as a standard error."""
    found = series.fading(test_resamples=0, seed=0).scintillation_index
    return Number(found.value, (found.high - found.low) / (2.0 * 1.96))


def _bubbles(wind: float, form: Form, setting: Setting, analog: int) -> Number:
    """Return the factor for the bubbles that forced detection leaves out."""
    return bubble_factor(wind, form, setting, analog) if form == "paper" else Number(1.0)
