"""Compare models of a trace with the half of it that they have not seen: the table of traces.md.

python docs/make_traces_table.py [trace.nc]; without a file a series of 240 s over a resolved sea
of 5 m/s is computed first, some 15 minutes of processor time.
"""

from __future__ import annotations

import math
import re
import sys
from pathlib import Path

import numpy as np
import xarray as xr

import meshtrace as mt
from meshtrace import fading
from meshtrace.comms import OokLink
from meshtrace.comms.budget import ber_of_gains
from meshtrace.comms.capacity import hard_information
from meshtrace.surfaces import resolved_sea

PAGE = Path(__file__).with_name("traces.md")
STEP, SAMPLES, RATE, MARGIN_DB = 0.02, 500_000, 0.8, 3.0
DEPTHS = (0.02, 0.2, 0.5, 1.0)


def series() -> np.ndarray:
    """Return the gains of 240 s."""
    sea = resolved_sea(5.0, fetch=30e3, seed=7)
    times = STEP * np.arange(12_000)
    return np.asarray(mt.time_series(mt.Link(), sea, times, photons=256, seed=1).gain)


def outages(gain: np.ndarray, mean: float) -> list[tuple[float, float]]:
    """Return share and standard error of words that carry less than RATE, by their duration."""
    link = OokLink()
    needed = link.required_power(0.0311) / float(link.received_power(1.0))  # capacity 0.8
    weak = needed * 10.0 ** (0.1 * MARGIN_DB) * gain / mean
    bits = hard_information(ber_of_gains(link, weak))
    found = []
    for depth in DEPTHS:
        steps = round(depth / STEP)
        lost = np.convolve(bits, np.ones(steps) / steps, "valid") < RATE
        n = fading.effective_samples(lost.astype(float)) if lost.any() else lost.size
        found.append((float(lost.mean()), float(lost.std()) / math.sqrt(n)))
    return found


def row(name: str, gain: np.ndarray, mean: float, errors: bool) -> str:
    """Return a row of the table: crossings, fades and outages."""
    time, cells = STEP * np.arange(gain.size), []
    for threshold in (0.5, 0.7):
        below = {"relative_to": "absolute", "resamples": 400, "confidence": 0.68}
        rate = fading.level_crossing_rate(time, gain, threshold * mean, **below)
        cells.append((rate.value, 0.5 * (rate.high - rate.low)))
    fades = fading.fade_durations(time, gain, 0.7 * mean, relative_to="absolute")
    spread = float(fades.std() / fades.mean())
    cells.append((float(fades.mean()), float(fades.std()) / math.sqrt(fades.size)))
    cells.append((spread, spread / math.sqrt(2 * fades.size)))
    rho = fading.TransformedGaussian.fit(gain[:6000], STEP, "empirical")
    cells.append((rho.autocorrelation[15], rho.autocorrelation_stderr[15]))
    cells += outages(gain, mean)
    texts = [f"{v:.3g} ± {e:.1g}" if errors else f"{v:.3g}" for v, e in cells]
    return f"| {name} | " + " | ".join(texts) + " |"


def main(argv: list[str]) -> None:
    """Write the table."""
    if argv:
        with xr.open_dataset(argv[0], engine="h5netcdf") as trace:
            gain = trace["gain"].values
    else:
        gain = series()
    first, second = np.split(gain, [gain.size // 2])
    models = {
        "two states": fading.MarkovChannel.fit(first, STEP, (0.7,)),
        "eight states": fading.MarkovChannel.fit(first, STEP, 8),
        "32 states": fading.MarkovChannel.fit(first, STEP, 32),
        "gamma-gamma": fading.TransformedGaussian.fit(first, STEP),
        "empirical law": fading.TransformedGaussian.fit(first, STEP, "empirical"),
    }
    mean = float(first.mean())
    head = "| series | fades below 0.5 [s-1] | below 0.7 [s-1] | they last [s] | "
    head += "spread over mean | correlation at 0.3 s | "
    head += " | ".join(f"outage, {d:g} s" for d in DEPTHS) + " |"
    rows = [head, "|---" * 10 + "|"]
    rows += [row("first half", first, mean, True), row("second half", second, mean, True)]
    rows += [row(name, model.sample(SAMPLES), mean, False) for name, model in models.items()]
    block = "<!-- table -->\n" + "\n".join(rows) + "\n<!-- end -->"
    page = PAGE.read_text(encoding="utf-8")
    page = re.sub(r"<!-- table -->.*<!-- end -->", lambda _: block, page, flags=re.DOTALL)
    PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
