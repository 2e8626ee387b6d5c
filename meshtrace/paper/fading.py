"""Figures of the gain in time and of its distribution over seas."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

import meshtrace as mt
from meshtrace.fading import gain_pdf
from meshtrace.fields import attrs
from meshtrace.paper.canvas import WIND_COLORS, dataset, form_panels, panels, wind_name, wind_rows
from meshtrace.paper.links import (
    FORM_NAMES,
    FORMS,
    RADIUS,
    ROUGH,
    UAV,
    Form,
    bubble_factor,
    forced,
    gusts,
    ratio,
)
from meshtrace.paper.registry import FigureOutput, Number, Setting, row
from meshtrace.scenario import Scenario
from meshtrace.uav.tilt import h_alpha
from meshtrace.viz.style import axis_label, finished

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
    for ax, form in zip(axes[:, 0], FORMS, strict=True):
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
            (line,) = ax.plot(at, mean, color=WIND_COLORS[wind], label=wind_name(wind))
            band: Any = {"color": line.get_color(), "alpha": 0.25, "lw": 0}
            ax.fill_between(at, mean - 2.0 * error, mean + 2.0 * error, **band)
        ax.set(ylabel=axis_label("gain"), title=FORM_NAMES[form], ylim=(0.0, None))
        ax.legend(ncols=2)
    axes[1, 0].set(xlabel=axis_label("time"))
    columns = {
        name: [[gains[form, wind][i] for wind in ROUGH] for form in FORMS]
        for i, name in enumerate(("gain", "gain_stderr"))
    }
    coords = {"form": FORMS, "wind_speed": ROUGH, "time": at}
    return FigureOutput(picture, dataset(columns, **coords), wind_rows("spread", spreads))


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
            histogram, color = gain_pdf(gain), WIND_COLORS[wind]
            ax.stairs(histogram.density, histogram.edges, color=color, label=wind_name(wind))
            ax.axvline(gain.mean(), color=color, lw=1.0, ls="--")
            variables[f"gain_{form}_{wind:g}"] = f"realization_{form}", gain, attrs("gain")
        x, y = axis_label("gain"), axis_label("gain_pdf")
        finished(ax, xlim=(0.0, None), xlabel=x, ylabel=y)

    def common(form: Form, wind: float) -> Number:
        made = forced(wind, form, sea={"omega_max": COMMON_CUT_OFF})
        return _index(_ensemble(made, max(counts[form] // 10, 40), photons, setting))

    ratios = [ratio(means[form, ROUGH[1]], means[form, ROUGH[0]]) for form in FORMS]
    numbers = [*wind_rows("mean", means), row("ratio", ratios), *wind_rows("index", indices)]
    numbers += wind_rows("common", {pair: common(*pair) for pair in means})
    effects = [bubble_factor(ROUGH[1], "physical", setting, analog), factors["paper", ROUGH[1]]]
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
