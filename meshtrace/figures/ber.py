"""Figure of the bit error rate over depth."""

from __future__ import annotations

from typing import Any

import numpy as np

import meshtrace as mt
from meshtrace.viz import plot_ber

from .canvas import panels, wind_name
from .links import WINDS
from .registry import Drawing, Number, Row, Setting, compared, figure

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


@figure(
    "ber-depth",
    "20",
    "bit error rate over depth",
    quick={"realizations": 8, "photons": 512, "step": 10.0},
    full={"realizations": 50, "photons": 2048, "step": 5.0},
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
            curves = {
                wind_name(u): data.ber.sel(wind_speed=u, bit_rate=rate).to_numpy() for u in WINDS
            }
            ax = plot_ber(depths, curves, along="depth", ax=axes[i, j])
            ax.set_title(f"{name}, {rate / 1e6:g} Mbit/s")
    ranges = [sweep.range_at_ber() for sweep in sweeps.values()]
    both = sweeps["physical"].to_dataset().drop_attrs(deep=False)
    other = sweeps["paper-ranges"].to_dataset().drop_attrs(deep=False)
    data = both.expand_dims(preset=[PRESETS[0]]).merge(
        other.expand_dims(preset=[PRESETS[1]]), join="outer"
    )
    caption = (
        "Bit error rate averaged over seas, without tilt; dashed: 1e-3. Top: physical receiver. "
        "Bottom: paper-ranges, an empirical calibration. "
        + sweeps["paper-ranges"].performances[0].status
    )
    return Drawing(picture, data, _rows(ranges), caption)


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
