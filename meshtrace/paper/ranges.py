"""Figures of the mean gain over a parameter of the link, and of error rates over depth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

import meshtrace as mt
from meshtrace import viz
from meshtrace.paper.links import (
    FORMS,
    ROUGH,
    WIND_COLORS,
    WINDS,
    Form,
    Mean,
    decibel,
    difference,
    form_panels,
    mark_printed,
    mean_gain,
    panels,
    ratio,
    scenario,
    wind_lines,
    wind_name,
)
from meshtrace.paper.registry import PRINTED, Entry, FigureOutput, Floats, Number, Setting, row

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

    def column(self, form: Form, wind: float, i: int) -> Floats:
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
        data = viz.marks.dataset(columns, **coords)
        picture, axes = form_panels(sharey=True)
        for form, ax in axes.items():
            wind_lines(ax, data.sel(form=form), "gain", "o-")
            ax.set_yscale("log")
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


RATES = (1e6, 5e6, 1e7)
PRESETS = ("physical", "paper-ranges")
LIMIT = 1e-3
"""Bit error rate of the published ranges."""

_PRINTED = {1e6: ("range-13-1", 13.0), 5e6: ("range-0-5", 0.0), 1e7: ("range-0-10", 0.0)}
"""Published range and its wind, for each bit rate."""


_SNR_DEPTH, _SNR_WIND = 47.0, 13.0


def ber_depth(
    setting: Setting, realizations: int, photons: int, analog: int, step: float
) -> FigureOutput:
    """Draw the average bit error rate over depth for bit rates and winds."""
    depths = np.arange(20.0, 75.0, step).tolist()
    options: Any = {"bit_rate": RATES, "realizations": realizations, "photons": photons}
    options |= {"depths": depths, **setting.run}
    sweeps = {name: over_winds(ook=name, **options) for name in PRESETS}
    picture, axes = panels(len(PRESETS), len(RATES), width=4.2, height=3.4, sharey=True)
    names = [wind_name(u) for u in WINDS]
    for i, (name, sweep) in enumerate(sweeps.items()):
        data = sweep.to_dataset()[["ber", "ber_low", "ber_high"]].assign_coords(wind_speed=names)
        for j, rate in enumerate(RATES):
            axes[i, j].set_prop_cycle(color=[WIND_COLORS[u] for u in WINDS])
            shown = data.sel(bit_rate=rate).transpose("wind_speed", "depth")
            ax = viz.plot_ber(shown, ax=axes[i, j])
            key, wind = _PRINTED[rate]
            ax.plot(PRINTED[key].value, LIMIT, "*", color=WIND_COLORS[wind], ms=13, zorder=5)
            ax.set_xlim(depths[0], depths[-1])
            ax.set_title(f"{name}, {rate / 1e6:g} Mbit/s")
    ranges = [sweep.range_at_ber() for sweep in sweeps.values()]
    parts = [sweep.to_dataset() for sweep in sweeps.values()]
    presets = xr.Variable("preset", list(PRESETS))
    whole = xr.concat(parts, presets, data_vars="all", join="exact", combine_attrs="drop")
    status = sweeps["paper-ranges"].performances[0].status
    numbers = _numbers(ranges) + signal_to_noise(setting, realizations, photons, analog)
    return FigureOutput(picture, whole, numbers, {"status": status})


def over_winds(**options: Any) -> mt.DepthSweep:
    """Return the error rates in each wind over a sea with the band of the paper."""
    found = [
        mt.link_performance(
            mt.Link().in_wind(wind),
            scenario(wind, "physical").surface,
            wind_speed=wind,
            **options,
        )
        for wind in WINDS
    ]
    return mt.DepthSweep(WINDS, tuple(found))


def signal_to_noise(setting: Setting, realizations: int, photons: int, analog: int) -> list[Entry]:
    """Return the ratios of received power to noise power of the paper's example, in decibels.

    Parameters
    ----------
    setting : Setting
        Seed and threads.
    realizations, photons, analog : int
        Effort, as in `meshtrace.paper.links.mean_gain`.

    Returns
    -------
    list of Entry
        Over still water, averaged over seas and tilts, and their difference.

    Notes
    -----
    47 m, 1 Mbit/s: 10 log10(P_Tx G / P_n). Published: P_n = NEP sqrt(R_b / 2) with a detection
    efficiency of 0.4, and over still water the unscattered light alone without refraction,
    G = (m + 1) / 2 (r / l)^2 exp(-c d) (Ijeh et al. 2021, eq. 3). Correct: the power behind
    optics of limited etendue over that of unit ratio, `SiPM.p_min`. The difference is that of
    ratios of one definition, of light traced in both seas.
    """
    effort: Any = {"realizations": realizations, "photons": photons, "analog": analog}
    effort["transmitter"] = {"depth": _SNR_DEPTH}

    def traced(wind: float, form: Form) -> Number:
        return mean_gain(wind, form, setting, **effort)[0].number

    still = [traced(0.0, form) for form in FORMS]
    closed = [still[0], Number(straight_gain(_SNR_DEPTH))]
    rough = [traced(_SNR_WIND, form) for form in FORMS]

    def ratios(gains: list[Number]) -> list[Number]:
        powers = [(g, _power_ratio(form)) for g, form in zip(gains, FORMS, strict=True)]
        return [decibel(Number(g.value * power, g.stderr * power)) for g, power in powers]

    margins = map(difference, ratios(still), ratios(rough))
    shown = row("snr-still", ratios(closed)), row("snr-wind", ratios(rough))
    return [*shown, row("margin", margins)]


def straight_gain(depth: float) -> float:
    """Return the gain of unscattered light on the axis, with neither refraction nor reflection."""
    lamp, receiver = mt.Led(depth=depth), mt.Receiver()
    share = 0.5 * (lamp.order + 1.0) * (receiver.radius / (depth + receiver.height)) ** 2
    return float(share * np.exp(-mt.Water().c * depth))


def _power_ratio(form: Form) -> float:
    """Return the received power over the noise power at a gain of 1, 1 Mbit/s."""
    ook = mt.OokLink.preset(form)
    wavelength, bandwidth = ook.led.wavelength, 0.5 * ook.bit_rate
    if form == "paper":
        noise = mt.comms.SiPM(pde=0.4).noise_power_paper(wavelength, bandwidth)
    else:
        noise = ook.sipm.p_min(wavelength, bandwidth)
    return float(ook.received_power(1.0)) / noise


def _numbers(ranges: list[Any]) -> list[Entry]:
    """Return ranges and their losses; ranges (winds, rates, 3) with limits."""

    def number(found: Any, wind: float, rate: float) -> Number:
        value, low, high = found[WINDS.index(wind), RATES.index(rate)]
        return Number(float(value), float((high - low) / (2.0 * 1.96)))

    def pair(wind: float, rate: float) -> list[Number]:
        return [number(found, wind, rate) for found in ranges]

    def lost(before: float, after: float, rate: float) -> list[Number]:
        return list(map(difference, pair(before, rate), pair(after, rate)))

    flat = "a flat sea to 5 m/s"
    return [
        row("range", pair(0.0, 5e6), case="flat sea, 5 Mbit/s", key="range-0-5"),
        row("range", pair(0.0, 1e7), case="flat sea, 10 Mbit/s", key="range-0-10"),
        row("range", pair(13.0, 1e6), case="13 m/s, 1 Mbit/s", key="range-13-1"),
        row("lost", lost(0.0, 5.0, 5e6), case=f"{flat}, 5 Mbit/s", key="loss-of-range-5-5"),
        row("lost", lost(0.0, 5.0, 1e7), case=f"{flat}, 10 Mbit/s", key="loss-of-range-5-10"),
        row("lost", lost(5.0, 13.0, 5e6), case="5 to 13 m/s, 5 Mbit/s", key="loss-of-range-13"),
    ]
