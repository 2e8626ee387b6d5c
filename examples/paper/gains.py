"""Figures of the gain: fates of photons, maps, time and seas, parameters of a link, bit errors."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from scipy.ndimage import gaussian_filter

import meshtrace as mt
from meshtrace import viz
from meshtrace.fields import attrs
from meshtrace.results.gain import FATE_MEANING
from meshtrace.uav import h_alpha
from paper.links import (
    FORM_NAMES,
    FORMS,
    RADIUS,
    ROUGH,
    UAV,
    WIND_COLORS,
    WINDS,
    Form,
    Mean,
    bubble_factor,
    decibel,
    difference,
    forced,
    form_panels,
    gusts,
    mean_gain,
    panels,
    ratio,
    scenario,
    wind_lines,
    wind_name,
    wind_rows,
)
from paper.registry import PRINTED, Entry, FigureOutput, Floats, Number, Setting, row

EXTENT = 5.0
"""Half-width of the maps [m]."""

DEPTH = 15.0
"""Range of the colours below 0 dB [dB]."""

CENTRE = 1.0
"""Radius of the central disk [m]."""

_SMOOTH = 0.5  # width of the blur of the contours [m], against the noise of the cells

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
    data = viz.marks.dataset(
        {"fate_weight": table.to_numpy().T}, {"form": FORMS, "fate": table.index}
    )
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
    shared: Any = {"sharex": True, "sharey": True}
    picture, axes = panels(len(cases), len(values), width=3.0, height=2.9, **shared)
    made = {}
    for i, (form, wind) in enumerate(cases):
        for j, value in enumerate(values):
            link = scenario(wind, form, transmitter={name: value}, run={"estimator": "analog"})
            found = mt.coverage_map(link.link, link.surface, **options)
            made[form, wind, value] = found
            image = _draw(axes[i, j], found)
            text = f"{title.format(value)}\n" if i == 0 else ""
            centre = viz.style.number(_centre(found), ".1f")
            axes[i, j].set_title(f"{text}0 dB: gain of {centre} dB", fontsize=9.5)
        axes[i, 0].set_ylabel(f"{FORM_NAMES[form]}, {wind_name(wind)}\n$y$ [m]")
    for ax in axes[-1]:
        ax.set_xlabel("$x$ [m]")
    look: Any = {"label": "gain over that within 1 m of the axis [dB]", "extend": "min"}
    picture.colorbar(image, ax=axes, shrink=0.6, aspect=36, **look)
    words = {"inner": RING[0], "outer": RING[1], "centre": CENTRE}
    numbers = []
    for wind, value in itertools.product(ROUGH, values):
        case = {"wind": wind_name(wind), "case": title.format(value), **words}
        maps = [made[form, wind, value] for form in FORMS]
        falls = [decibel(ratio(_mean(one, *RING), _mean(one, 0.0, CENTRE))) for one in maps]
        numbers.append(row("fall", falls, **case))
    shape = (len(FORMS), len(ROUGH), len(values), len(found.x), len(found.y))
    columns = {
        key: np.reshape([getattr(m, key) for m in made.values()], shape)
        for key in ("gain", "gain_stderr")
    }
    coords = {"form": FORMS, "wind_speed": ROUGH, name: values, "x": found.x, "y": found.y}
    return FigureOutput(picture, viz.marks.dataset(columns, coords), numbers)


def _centre(found: mt.CoverageMap) -> float:
    """Return the mean gain of the central disk [dB]."""
    return decibel(_mean(found, 0.0, CENTRE)).value


def _draw(ax: Any, found: mt.CoverageMap) -> Any:
    """Draw a map in decibels relative to its centre, with contours; return the image."""
    with np.errstate(divide="ignore"):
        level = np.maximum(10.0 * np.log10(found.gain) - _centre(found), -DEPTH)
    image = viz.marks.heat_map(ax, found.x, found.y, level, "", vmin=-DEPTH, vmax=0.0)
    ax.set(xlabel="", ylabel="")
    smooth = gaussian_filter(level, _SMOOTH / (found.x[1] - found.x[0]), mode="nearest")
    look: Any = {"colors": "white", "linewidths": 0.9, "linestyles": "-"}
    lines = ax.contour(found.x, found.y, smooth.T, [-10.0, -6.0, -3.0], **look)
    ax.clabel(lines, fmt=viz.style.number, fontsize=8)
    return image


def _mean(found: mt.CoverageMap, inner: float, outer: float) -> Number:
    """Return the mean gain of the cells between two distances from the axis [m]."""
    x, y = np.meshgrid(found.x, found.y, indexing="ij")
    distance = np.hypot(x, y)
    inside = (distance >= inner) & (distance < outer)
    error = np.sqrt(np.sum(found.gain_stderr[inside] ** 2)) / inside.sum()
    return Number(float(found.gain[inside].mean()), float(error))


DURATION = 10.0
COMMON_CUT_OFF = 4.0
"""Highest wave frequency of a common band [rad s-1], from the paper's band at 5 m/s."""


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
            tilt = UAV.tilt(gusts(wind, form).simulate_wind(at, setting.seed))
            bubbles = _bubbles(wind, form, setting, analog)
            factor = bubbles.value * _factor(tilt.angle)
            mean = series.gain * factor
            error = factor * np.hypot(series.gain_stderr, series.gain * bubbles.relative)
            gains[form, wind] = mean, error
            spreads[form, wind] = series.gain.std(ddof=1) / series.gain.mean()
    columns = np.moveaxis(np.array([[gains[f, u] for u in ROUGH] for f in FORMS]), 2, 0)
    coords = {"form": FORMS, "wind_speed": ROUGH, "time": at}
    found = dict(zip(("gain", "gain_stderr"), columns, strict=True))
    data = viz.marks.dataset(found, coords)
    for form, ax in zip(FORMS, axes[:, 0], strict=True):
        wind_lines(ax, data.sel(form=form), "gain")
        ax.set_title(FORM_NAMES[form])
        ax.legend(ncols=2)
    axes[0, 0].set_xlabel("")
    return FigureOutput(picture, data, wind_rows("spread", spreads))


def gain_distribution(
    setting: Setting, realizations: int, paper_realizations: int, photons: int, analog: int
) -> FigureOutput:
    """Draw densities of the gain over independent seas, with tilts."""
    counts = {"physical": realizations, "paper": paper_realizations}
    means, indices, variables, factors = {}, {}, {}, {}
    for form in FORMS:
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
            variables[f"gain_{form}_{wind:g}"] = f"realization_{form}", gain, attrs("gain")

    def common(form: Form, wind: float) -> Number:
        made = forced(wind, form, sea={"omega_max": COMMON_CUT_OFF})
        return _index(_ensemble(made, max(counts[form] // 10, 40), photons, setting))

    ratios = [ratio(means[form, ROUGH[1]], means[form, ROUGH[0]]) for form in FORMS]
    numbers = [*wind_rows("mean", means), row("ratio", ratios), *wind_rows("index", indices)]
    numbers += wind_rows("common", {pair: common(*pair) for pair in means})
    effects = [bubble_factor(ROUGH[1], "physical", setting, analog), factors["paper", ROUGH[1]]]
    numbers.append(row("bubbles", effects, radius=RADIUS))
    data = xr.Dataset(variables)
    return FigureOutput(_densities(data), data, numbers)


def _densities(data: xr.Dataset) -> Any:
    """Return the picture of densities; light lost by a tilt is in the legend alone."""
    picture, axes = form_panels()
    x, y = viz.axis_label("gain"), viz.axis_label("gain_pdf")
    for form, ax in axes.items():
        for wind in ROUGH:
            gain, color = data[f"gain_{form}_{wind:g}"].to_numpy(), WIND_COLORS[wind]
            dark = float(np.mean(gain == 0.0))
            lit = mt.fading.gain_pdf(gain[gain > 0.0])
            name = wind_name(wind) + (f", {100.0 * dark:.2g} % dark" if dark else "")
            ax.stairs((1.0 - dark) * lit.density, lit.edges, color=color, label=name)
            ax.axvline(gain.mean(), color=color, lw=1.0, ls="--")
        viz.marks.finished(ax, ylim=(0.0, None), xlabel=x, ylabel=y)
    return picture


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


Gains = dict[tuple[Form, float], list[Mean]]


class SweptGains(NamedTuple):
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
        data = viz.marks.dataset(columns, coords)
        picture, axes = form_panels(sharey=True)
        for form, ax in axes.items():
            wind_lines(ax, data.sel(form=form), "gain", "o-")
            ax.set_yscale("log")
            if printed:
                look: Any = {"color": viz.style.PALETTE["orange"], "mec": viz.style.INK, "ms": 13}
                stars = np.transpose([(x, PRINTED[key].value) for x, key in printed])
                ax.plot(*stars, "*", zorder=5, label="printed", **look)
            ax.legend()
        axes["paper"].set_ylabel("")
        return FigureOutput(picture, data, numbers)


def _sources(key: str, values: Sequence[float], setting: Setting, **effort: int) -> SweptGains:
    """Return gains of one source at a time, for each value of a key of the LED."""

    def gains(form: Form, wind: float) -> list[Mean]:
        tables: Any = [{"transmitter": {key: value}} for value in values]
        return [mean_gain(wind, form, setting, **effort, **table)[0] for table in tables]

    return SweptGains(
        key, values, {(form, wind): gains(form, wind) for form in FORMS for wind in WINDS}
    )


def _receivers(
    name: str, receivers: dict[float, dict[str, Any]], setting: Setting, **effort: int
) -> SweptGains:
    """Return gains of one receiver for each value, all over the same seas."""
    tables: Any = {**effort, "receiver": list(receivers.values())}
    gains = {(f, u): mean_gain(u, f, setting, **tables) for f in FORMS for u in WINDS}
    return SweptGains(name, tuple(receivers), gains)


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
PRESETS: tuple[Literal["physical", "paper-ranges"], ...] = ("physical", "paper-ranges")
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
    options |= {"wind_speeds": WINDS, "mesh": mt.Meshing(waves="paper"), **setting.run}
    sweeps = {name: mt.depth_sweep(mt.Link(), depths, ook=name, **options) for name in PRESETS}
    picture, axes = panels(len(PRESETS), len(RATES), width=4.2, height=3.4, sharey=True)
    names = [wind_name(u) for u in WINDS]
    for i, (name, sweep) in enumerate(sweeps.items()):
        data = sweep.to_dataset()[["ber", "ber_low", "ber_high"]].assign_coords(wind_speed=names)
        for j, rate in enumerate(RATES):
            axes[i, j].set_prop_cycle(color=[WIND_COLORS[u] for u in WINDS])
            shown = data.sel(bit_rate=rate).transpose("wind_speed", "depth")
            ax = viz.plot_ber(shown, ax=axes[i, j])
            key, wind = _PRINTED[rate]
            look: Any = {"color": WIND_COLORS[wind], "ms": 13, "zorder": 5, "label": "published"}
            ax.plot(PRINTED[key].value, LIMIT, "*", **look)
            ax.set_xlim(depths[0], depths[-1])
            viz.marks.finished(ax, title=f"{name}, {rate / 1e6:g} Mbit/s")
            if (legend := ax.get_legend()) and i + j:  # the first is that of all
                legend.remove()
    ranges = [sweep.range_at_ber() for sweep in sweeps.values()]
    parts = [sweep.to_dataset() for sweep in sweeps.values()]
    presets = xr.Variable("preset", list(PRESETS))
    whole = xr.concat(parts, presets, data_vars="all", join="exact", combine_attrs="drop")
    status = sweeps["paper-ranges"].performances[0].status
    numbers = _numbers(ranges) + signal_to_noise(setting, realizations, photons, analog)
    return FigureOutput(picture, whole, numbers, {"status": status})


def signal_to_noise(setting: Setting, realizations: int, photons: int, analog: int) -> list[Entry]:
    """Return the ratios of received power to noise power of the paper's example, in decibels.

    Parameters
    ----------
    setting : Setting
        Seed and threads.
    realizations, photons, analog : int
        Effort, as in `paper.links.mean_gain`.

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
