"""Write the tables of traces.md: closed forms, models against records that they have not seen.

python docs/scripts/make_traces_table.py FOLDER keeps its traces in a folder: an hour of processor
time, most of it for the records; a stopped run goes on there.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
from places import write_table

import meshtrace as mt
from meshtrace import apps, fading
from meshtrace.comms import OokLink
from meshtrace.comms.budget import ber_of_gains
from meshtrace.comms.capacity import hard_information
from meshtrace.surfaces import sea_in_wind

FITTED, HELD_OUT = (21,), (22,)  # seeds of the seas of records
MINUTES, STEP, SAMPLES, RATE, MARGIN_DB = 60.0, 0.05, 400_000, 0.8, 3.0
DEPTHS = (0.05, 0.2, 0.5, 1.0)
LEVEL = 0.7  # of the mean: fades of two states, and of the generator
CASES = [(u, d, h) for u in (5.0, 13.0) for d, h in ((10.0, 5.0), (10.0, 2.0), (20.0, 5.0))]
LAGS, BURSTS, APART, SEEDS, BLOCKS = (0.0, 0.05, 0.1, 0.2, 0.3), 80, 3.0, (1, 2, 3), 24


def record(folder: Path, seed: int) -> np.ndarray:
    """Return the gains of a record over a sea of its own."""
    path = folder / f"h{seed}.nc"
    if not path.exists():
        sea = sea_in_wind(5.0).with_seed(seed)
        options = {"photons": 128, "down": None, "store": folder / f"h{seed}.store"}
        mt.channel_trace(mt.Link(), sea, hours=MINUTES / 60.0, rate=1.0 / STEP, **options).save(
            path
        )
    return mt.ChannelTrace.load(path).gain


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
    for threshold in (0.5, 0.7, 1.5):
        below = {"relative_to": "absolute", "resamples": 200, "confidence": 0.68}
        rate = fading.level_crossing_rate(time, gain, threshold * mean, **below)
        cells.append((rate.value, 0.5 * (rate.high - rate.low)))
    fades = fading.fade_durations(time, gain, LEVEL * mean, relative_to="absolute")
    spread = float(fades.std() / fades.mean())
    cells.append((float(fades.mean()), float(fades.std()) / math.sqrt(fades.size)))
    cells.append((spread, spread / math.sqrt(2 * fades.size)))
    rho = apps.TransformedGaussian.fit(gain[:12_000], STEP, "empirical")
    cells.append((rho.autocorrelation[6], rho.autocorrelation_stderr[6]))
    cells += outages(gain, mean)
    texts = [f"{v:.3g} ± {e:.1g}" if errors else f"{v:.3g}" for v, e in cells]
    return f"| {name} | " + " | ".join(texts) + " |"


def held_out(folder: Path) -> list[str]:
    """Return the rows of models of some records, and of records that they have not seen."""
    first, other = (
        np.concatenate([record(folder, seed) for seed in seeds]) for seeds in (FITTED, HELD_OUT)
    )
    generator = apps.TransformedGaussian.fit
    models = {
        "two states": apps.MarkovChannel.fit(first, STEP, (LEVEL,)),
        "eight states": apps.MarkovChannel.fit(first, STEP, 8),
        "32 states": apps.MarkovChannel.fit(first, STEP, 32),
        "gamma-gamma": generator(first, STEP),
        "empirical law": generator(first, STEP, "empirical"),
        "gamma-gamma, threshold 0.7": generator(first, STEP, threshold=LEVEL),
        "empirical law, threshold 0.7": generator(first, STEP, "empirical", threshold=LEVEL),
    }
    mean = float(first.mean())
    head = "| series | fades below 0.5 [s-1] | below 0.7 [s-1] | below 1.5 [s-1] | "
    head += "below 0.7 they last [s] | spread over mean | correlation at 0.3 s | "
    head += " | ".join(f"outage, {d:g} s" for d in DEPTHS) + " |"
    rows = [head, "|---" * 11 + "|"]
    rows += [row("fitted", first, mean, True), row("not seen", other, mean, True)]
    return rows + [row(name, model.sample(SAMPLES), mean, False) for name, model in models.items()]


def bursts(folder: Path, wind: float, depth: float, height: float) -> np.ndarray:
    """Return unscattered gains (bursts, lags) of a case, of independent seas and times."""
    path = folder / f"si_{wind:g}_{depth:g}_{height:g}.npy"
    if not path.exists():
        link = case_link(depth, height)
        times = (APART * np.arange(BURSTS)[:, None] + np.array(LAGS)).ravel()
        runs = [
            mt.time_series(link, sea_in_wind(wind).with_seed(s), times, photons=32) for s in SEEDS
        ]
        np.save(path, np.concatenate([r.gain_ballistic.reshape(BURSTS, -1) for r in runs]))
    return np.load(path)


def case_link(depth: float, height: float) -> mt.Link:
    """Return the link of a case."""
    return mt.Link().at_depth(depth).replace("receiver.height", height)


def covariances(gain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return covariances of the gain over its squared mean by lag, with errors of a jackknife."""

    def of(g: np.ndarray) -> np.ndarray:
        off = g / g.mean() - 1.0
        return np.array([np.mean(off**2), *np.mean(off[:, :1] * off[:, 1:], axis=0)])

    blocks = np.array_split(gain, BLOCKS)
    left = [of(np.concatenate(blocks[:i] + blocks[i + 1 :])) for i in range(BLOCKS)]
    return of(gain), math.sqrt(BLOCKS - 1.0) * np.std(left, axis=0)


def closed_forms(folder: Path) -> list[str]:
    """Return the rows of scintillation index and autocorrelation of the cases."""
    lags = " | ".join(f"at {lag:g} s" for lag in LAGS[1:])
    rows = [f"| wind, depth, height | scintillation index | {lags} |", "|---" * 6 + "|"]
    for wind, depth, height in CASES:
        link = case_link(depth, height)
        sea = fading.resolve_band(link, sea_in_wind(wind), "fading")
        wanted = fading.gain_autocovariance(link, sea, LAGS, heights=True)
        found, error = covariances(bursts(folder, wind, depth, height))
        texts = [f"{f:.3f}±{e:.3f} ({w:.3f})" for f, e, w in zip(found, error, wanted, strict=True)]
        rows.append(f"| {wind:g} m/s, {depth:g} m, {height:g} m | " + " | ".join(texts) + " |")
    return rows


def main(folder: Path) -> None:
    """Write the tables."""
    folder.mkdir(parents=True, exist_ok=True)
    write_table("traces_closed_forms", "\n".join(closed_forms(folder)))
    write_table("traces_models", "\n".join(held_out(folder)))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
