"""Figure of the bit error rate over depth."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

import meshtrace as mt
from meshtrace.paper.canvas import WIND_COLORS, panels, wind_name
from meshtrace.paper.links import WINDS
from meshtrace.paper.printed import PRINTED
from meshtrace.paper.registry import Drawing, Number, Row, Setting, compared, figure
from meshtrace.viz import plot_ber

RATES = (1e6, 5e6, 1e7)
PRESETS = ("physical", "paper-ranges")
_LEVEL = (
    "The default is a receiver that optics allow; the column of the paper is an empirical "
    "calibration that counts absorption twice, not physics."
)
_WAVES = (
    "Waves of the paper's bands, foam and bubbles together change the range by far less than "
    "printed; nothing was tuned towards it."
)


LIMIT = 1e-3
"""Bit error rate of the ranges that the paper prints."""

_PRINTED = {
    1e6: {"range-13-1": 13.0},
    5e6: {"range-0-5": 0.0},
    1e7: {"range-0-10": 0.0},
}
"""Printed ranges with their winds, for each bit rate."""


@figure(
    "ber-depth",
    "20",
    "bit error rate over depth",
    quick={"realizations": 5, "photons": 512, "step": 5.0},
    full={"realizations": 40, "photons": 2048, "step": 2.5},
)
def ber_depth(setting: Setting, realizations: int, photons: int, step: float) -> Drawing:
    """Draw the average bit error rate over depth for bit rates and winds."""
    depths = [float(d) for d in np.arange(20.0, 75.0, step)]
    options: Any = {"photons": photons, "seed": setting.seed, "threads": setting.threads}
    sweeps = {
        name: mt.depth_sweep(
            mt.Link(),
            depths,
            bit_rate=RATES,
            wind_speeds=WINDS,
            realizations=realizations,
            ook=name,
            **options,
        )
        for name in PRESETS
    }
    picture, axes = panels(len(PRESETS), len(RATES), width=4.2, height=3.4, sharey=True)
    for i, (name, sweep) in enumerate(sweeps.items()):
        data = sweep.to_dataset()
        for j, rate in enumerate(RATES):
            curves = {wind_name(u): data.ber.sel(wind_speed=u, bit_rate=rate) for u in WINDS}
            bands = {
                wind_name(u): (
                    data.ber_low.sel(wind_speed=u, bit_rate=rate),
                    data.ber_high.sel(wind_speed=u, bit_rate=rate),
                )
                for u in WINDS
            }
            axes[i, j].set_prop_cycle(color=[WIND_COLORS[u] for u in WINDS])
            ax = plot_ber(depths, curves, bands=bands, along="depth", ax=axes[i, j])
            for key, wind in _PRINTED.get(rate, {}).items():
                color = WIND_COLORS[wind]
                ax.plot(PRINTED[key].value, LIMIT, "*", color=color, markersize=13, zorder=5)
            ax.set_xlim(depths[0], depths[-1])
            ax.set_title(f"{name}, {rate / 1e6:g} Mbit/s")
    ranges = [sweep.range_at_ber() for sweep in sweeps.values()]
    presets = xr.Variable("preset", list(PRESETS))
    parts = [sweep.to_dataset() for sweep in sweeps.values()]
    whole = xr.concat(parts, presets, data_vars="all", join="exact", combine_attrs="drop")
    caption = (
        "Bit error rate averaged over seas, without tilt, with 95 % bands; dashed: 1e-3; stars: "
        "printed ranges, in the colour of their wind. Top: physical, bottom: paper-ranges. "
        + sweeps["paper-ranges"].performances[0].status
    )
    return Drawing(picture, whole, _rows(ranges), caption)


def _rows(ranges: list[Any]) -> list[Row]:
    """Return ranges and their losses; ranges (winds, rates, 3) with limits."""

    def number(found: Any, wind: float, rate: float) -> Number:
        value, low, high = found[WINDS.index(wind), RATES.index(rate)]
        return Number(float(value), float((high - low) / (2.0 * 1.96)))

    def pair(wind: float, rate: float) -> list[Number]:
        return [number(found, wind, rate) for found in ranges]

    def lost(before: float, after: float, rate: float) -> list[Number]:
        both = zip(pair(before, rate), pair(after, rate), strict=True)
        return [Number(a.value - b.value, float(np.hypot(a.stderr, b.stderr))) for a, b in both]

    name = "range at a bit error rate of 1e-3"
    return [
        compared(f"{name}, flat sea, 5 Mbit/s", pair(0.0, 5e6), _LEVEL, printed="range-0-5"),
        compared(f"{name}, flat sea, 10 Mbit/s", pair(0.0, 1e7), _LEVEL, printed="range-0-10"),
        compared(f"{name}, 13 m/s, 1 Mbit/s", pair(13.0, 1e6), _LEVEL, printed="range-13-1"),
        compared(
            "range lost from a flat sea to 5 m/s, 5 Mbit/s",
            lost(0.0, 5.0, 5e6),
            _WAVES,
            printed="loss-of-range-5-5",
        ),
        compared(
            "range lost from a flat sea to 5 m/s, 10 Mbit/s",
            lost(0.0, 5.0, 1e7),
            _WAVES,
            printed="loss-of-range-5-10",
        ),
        compared(
            "range lost from 5 to 13 m/s, 5 Mbit/s",
            lost(5.0, 13.0, 5e6),
            _WAVES,
            printed="loss-of-range-13",
        ),
    ]
