"""Figures of the gain in time and of its distribution over seas."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

import meshtrace as mt
from meshtrace.fading import gain_pdf
from meshtrace.fields import attrs
from meshtrace.paper.canvas import WIND_COLORS, dataset, panels, wind_name
from meshtrace.paper.fates import RADIUS
from meshtrace.paper.links import (
    FORM_NAMES,
    FORMS,
    Form,
    Scenario,
    forced,
    gusts,
    ratio,
    scenario,
)
from meshtrace.paper.registry import Entry, FigureOutput, Number, Setting, row
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


def gain_series(setting: Setting, times: int, photons: int) -> FigureOutput:
    """Draw the gain over a moving sea with the tilt of a flying UAV."""
    at = np.linspace(0.0, DURATION, times)
    picture, axes = panels(2, 1, width=8.0, height=2.9, sharex=True)
    gains, errors, spreads = {}, {}, {}
    for ax, form in zip(axes[:, 0], FORMS, strict=True):
        for wind in WINDS:
            made = forced(wind, form)
            options: Any = {"photons": photons, "seed": setting.seed, "threads": setting.threads}
            series = mt.time_series(made.link, made.surface, at, **options)
            flight = _UAV.simulate_flight(gusts(wind, form), at, setting.seed)
            factor = _factor(flight.tilt.angle)
            gains[form, wind] = series.gain * factor
            errors[form, wind] = series.gain_stderr * factor
            spreads[form, wind] = float(series.gain.std(ddof=1) / series.gain.mean())
            color, band = WIND_COLORS[wind], 2.0 * errors[form, wind]
            ax.plot(at, gains[form, wind], color=color, label=wind_name(wind))
            low, high = gains[form, wind] - band, gains[form, wind] + band
            ax.fill_between(at, low, high, color=color, alpha=0.25, lw=0)
        ax.set(ylabel=axis_label("gain"), title=FORM_NAMES[form])
        ax.set_ylim(bottom=0.0)
        ax.legend(ncols=2)
    axes[1, 0].set(xlabel=axis_label("time"))
    numbers = [row("spread", [spreads[f, u] for f in FORMS], wind=wind_name(u)) for u in WINDS]
    columns = {"gain": gains, "gain_stderr": errors}
    data = dataset(
        ("form", "wind_speed", "time"),
        {name: [[found[f, u] for u in WINDS] for f in FORMS] for name, found in columns.items()},
        form=FORMS,
        wind_speed=WINDS,
        time=at,
    )
    return FigureOutput(picture, data, numbers)


def gain_distribution(
    setting: Setting, realizations: int, paper_realizations: int, photons: int, analog: int
) -> FigureOutput:
    """Draw densities of the gain over independent seas, with tilts."""
    counts = {"physical": realizations, "paper": paper_realizations}
    picture, axes = panels(1, 2)
    means: dict[tuple[Form, float], Number] = {}
    indices: dict[tuple[Form, float], Number] = {}
    variables: dict[str, Any] = {}
    for ax, form in zip(axes[0], FORMS, strict=True):
        for wind in WINDS:
            made = forced(wind, form)
            series = _ensemble(made, counts[form], photons, setting)
            winds = gusts(wind, form).sample_wind(counts[form], setting.seed)
            gain = series.gain * _factor(_UAV.tilt(winds).angle)
            spread = gain.std(ddof=1) / np.sqrt(len(gain))
            error = float(np.hypot(spread, series.mean_stderr))
            means[form, wind] = Number(float(gain.mean()), error)
            indices[form, wind] = _index(series)
            histogram = gain_pdf(gain)
            ax.stairs(
                histogram.density, histogram.edges, color=WIND_COLORS[wind], label=wind_name(wind)
            )
            ax.axvline(gain.mean(), color=WIND_COLORS[wind], lw=1.0, ls="--")
            dims = f"realization_{form}"
            variables[f"gain_{form}_{wind:g}"] = (dims, gain, attrs("gain"))
        ax.set(xlabel=axis_label("gain"), ylabel=axis_label("gain_pdf"), title=FORM_NAMES[form])
        ax.set_xlim(left=0.0)
        ax.legend()
    numbers = _mean_numbers(means) + _index_numbers(indices, setting, counts, photons)
    numbers.append(_bubble_numbers(setting, analog))
    return FigureOutput(picture, xr.Dataset(variables), numbers)


def _ensemble(made: Scenario, realizations: int, photons: int, setting: Setting) -> mt.GainSeries:
    options: Any = {"photons": photons, "seed": setting.seed, "threads": setting.threads}
    return mt.ensemble(made.link, realizations, made.surface, **options)


def _index(series: mt.GainSeries) -> Number:
    """Return the scintillation index; its 95 % interval as a standard error."""
    found = series.fading(test_resamples=0, seed=0).scintillation_index
    return Number(found.value, (found.high - found.low) / (2.0 * 1.96))


def _mean_numbers(means: dict[tuple[Form, float], Number]) -> list[Entry]:
    numbers = [row("mean", [means[f, u] for f in FORMS], wind=wind_name(u), u=u) for u in WINDS]
    ratios = [ratio(means[form, WINDS[1]], means[form, WINDS[0]]) for form in FORMS]
    return [*numbers, row("ratio", ratios)]


def _index_numbers(
    indices: dict[tuple[Form, float], Number],
    setting: Setting,
    counts: dict[str, int],
    photons: int,
) -> list[Entry]:
    numbers = [row("index", [indices[f, u] for f in FORMS], wind=wind_name(u)) for u in WINDS]
    for u in WINDS:
        pair = []
        for form in FORMS:
            made = forced(u, form, sea={"omega_max": COMMON_CUT_OFF})
            pair.append(_index(_ensemble(made, max(counts[form] // 10, 40), photons, setting)))
        numbers.append(row("common", pair, wind=wind_name(u)))
    return numbers


def _bubble_numbers(setting: Setting, photons: int) -> Entry:
    """Return the effect of bubbles in the paper preset, by photons followed one by one."""
    wide: Any = {"receiver": {"radius": RADIUS}, "run": {"estimator": "analog"}}
    found = []
    for form in FORMS:
        numbers = []
        for extra in ({}, {"bubbles": {"model": "none"}}):
            made = scenario(WINDS[1], form, **wide, **extra)
            options: Any = {"photons": photons, "seed": setting.seed, "threads": setting.threads}
            r = mt.simulate(made.link, made.surface, estimator="analog", **options)
            numbers.append(Number(float(r.gain), float(r.gain_stderr)))
        found.append(ratio(*numbers))
    return row("bubbles", found, radius=RADIUS)
