"""Figure of the bit error rate over depth."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

import meshtrace as mt
from meshtrace.comms.devices import SiPM
from meshtrace.paper.canvas import WIND_COLORS, panels, wind_name
from meshtrace.paper.links import (
    FORMS,
    WINDS,
    Form,
    decibel,
    difference,
    mean_gain,
    scenario,
)
from meshtrace.paper.registry import PRINTED, Entry, FigureOutput, Number, Setting, row
from meshtrace.viz import plot_ber

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
            ax = plot_ber(shown, ax=axes[i, j])
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
        noise = SiPM(pde=0.4).noise_power_paper(wavelength, bandwidth)
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
