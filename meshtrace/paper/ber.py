"""Figure of the bit error rate over depth."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

import meshtrace as mt
from meshtrace.paper.canvas import WIND_COLORS, panels, wind_name
from meshtrace.paper.links import WINDS
from meshtrace.paper.registry import PRINTED, Entry, FigureOutput, Number, Setting, row
from meshtrace.viz import plot_ber

RATES = (1e6, 5e6, 1e7)
PRESETS = ("physical", "paper-ranges")
LIMIT = 1e-3
"""Bit error rate of the published ranges."""

_PRINTED = {1e6: ("range-13-1", 13.0), 5e6: ("range-0-5", 0.0), 1e7: ("range-0-10", 0.0)}
"""Published range and its wind, for each bit rate."""


def ber_depth(setting: Setting, realizations: int, photons: int, step: float) -> FigureOutput:
    """Draw the average bit error rate over depth for bit rates and winds."""
    depths = np.arange(20.0, 75.0, step).tolist()
    options: Any = {"bit_rate": RATES, "wind_speeds": WINDS, "realizations": realizations}
    options |= {"photons": photons, **setting.run}
    sweeps = {name: mt.depth_sweep(mt.Link(), depths, ook=name, **options) for name in PRESETS}
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
    return FigureOutput(picture, whole, _numbers(ranges), {"status": status})


def _numbers(ranges: list[Any]) -> list[Entry]:
    """Return ranges and their losses; ranges (winds, rates, 3) with limits."""

    def number(found: Any, wind: float, rate: float) -> Number:
        value, low, high = found[WINDS.index(wind), RATES.index(rate)]
        return Number(float(value), float((high - low) / (2.0 * 1.96)))

    def pair(wind: float, rate: float) -> list[Number]:
        return [number(found, wind, rate) for found in ranges]

    def lost(before: float, after: float, rate: float) -> list[Number]:
        both = zip(pair(before, rate), pair(after, rate), strict=True)
        return [Number(a.value - b.value, float(np.hypot(a.stderr, b.stderr))) for a, b in both]

    flat = "a flat sea to 5 m/s"
    return [
        row("range", pair(0.0, 5e6), case="flat sea, 5 Mbit/s", key="range-0-5"),
        row("range", pair(0.0, 1e7), case="flat sea, 10 Mbit/s", key="range-0-10"),
        row("range", pair(13.0, 1e6), case="13 m/s, 1 Mbit/s", key="range-13-1"),
        row("lost", lost(0.0, 5.0, 5e6), case=f"{flat}, 5 Mbit/s", key="loss-of-range-5-5"),
        row("lost", lost(0.0, 5.0, 1e7), case=f"{flat}, 10 Mbit/s", key="loss-of-range-5-10"),
        row("lost", lost(5.0, 13.0, 5e6), case="5 to 13 m/s, 5 Mbit/s", key="loss-of-range-13"),
    ]
