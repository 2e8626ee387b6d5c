"""Compute the ranges, gains and tilt losses of the link and write the tables of paper.md.

Names of blocks as arguments recompute those alone.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np
from places import write_table

import meshtrace as mt
from meshtrace.comms.budget import required_gain
from meshtrace.scenario import Scenario
from meshtrace.surfaces import FlatSea
from meshtrace.uav import h_alpha

RATES = (1e6, 5e6, 1e7)
DEPTHS = tuple(range(25, 65, 5))
PRINTED = {0.0: ("-", "43", "36"), 5.0: ("-", "39", "31"), 13.0: ("47", "36.5", "28.5")}
REALIZATIONS = 50


def ranges() -> Iterator[str]:
    """Yield the ranges of both presets beside the printed ones."""
    yield "| sea | Mbit/s | printed | `physical` | `paper-ranges` |"
    yield "|---|---|---|---|---|"
    sweeps = [
        mt.depth_sweep(
            mt.Link(),
            DEPTHS,
            wind_speeds=tuple(PRINTED),
            bit_rate=RATES,
            realizations=REALIZATIONS,
            mesh=mt.Meshing(waves="paper"),
            ook=name,
        ).range_at_ber()
        for name in ("physical", "paper-ranges")
    ]
    for i, (wind, printed) in enumerate(PRINTED.items()):
        sea = "flat" if wind == 0.0 else f"{wind:g} m/s"
        for j, rate in enumerate(RATES):
            ours = [f"{s[i, j, 0]:.1f} ({s[i, j, 1]:.1f} to {s[i, j, 2]:.1f})" for s in sweeps]
            yield f"| {sea} | {rate / 1e6:g} | {printed[j]} | {ours[0]} | {ours[1]} |"


def wind() -> Iterator[str]:
    """Yield gains over a flat sea with foam and bubbles, relative to none."""
    yield "| forms | 5 m/s | 13 m/s | 13 over 5 m/s |"
    yield "|---|---|---|---|"
    still = mt.simulate(mt.Link(), FlatSea(), photons=20_000)
    for forms in ("physical", "paper"):
        gains = []
        for speed in (5.0, 13.0):
            given = Scenario.from_config({"wind_speed": speed, "physics": forms}).link
            foam = {"whitecaps": given.whitecaps, "bubbles": given.bubbles}
            gains.append(mt.simulate(mt.Link().model_copy(update=foam), FlatSea(), photons=20_000))
        shares = [f"{g.gain / still.gain:.3f}" for g in gains]
        ratio, error = (
            gains[1].gain / gains[0].gain,
            np.hypot(*(g.gain_stderr / g.gain for g in gains)),
        )
        yield f"| {forms} | {shares[0]} | {shares[1]} | {ratio:.3f} +- {ratio * error:.3f} |"


def tilt() -> Iterator[str]:
    """Yield the gain of a tilted receiver beside the paper's factor."""
    angles = (5.0, 15.0, 25.0, 28.0, 32.0, 40.0)
    yield "| tilt [deg] | " + " | ".join(f"{angle:g}" for angle in angles) + " |"
    yield "|---" * (len(angles) + 1) + "|"
    factors = h_alpha(np.radians(angles), np.radians(60.0))
    yield "| factor h_alpha | " + " | ".join(f"{f:.3f}" for f in factors) + " |"
    for depth in (10.0, 40.0):
        lamp = mt.Led(depth=depth)
        level = mt.simulate(mt.Link(transmitter=lamp), FlatSea(), photons=20_000).gain
        found = []
        for angle in angles:
            link = mt.Link(transmitter=lamp, receiver=mt.Receiver(tilt_deg=angle))
            result = mt.simulate(link, FlatSea(), photons=20_000)
            found.append(f"{result.gain / level:.4f} +- {result.gain_stderr / level:.4f}")
        yield f"| traced, {depth:g} m | " + " | ".join(found) + " |"


def excess() -> Iterator[str]:
    """Yield by how much the stated channel is too bright for the printed ranges."""
    yield "| printed range | Mbit/s | sea | channel gain | needed (loss-free, PC) | too bright by |"
    yield "|---|---|---|---|---|---|"
    for depth, rate, speed in ((47.0, 1e6, 13.0), (43.0, 5e6, 0.0), (36.0, 1e7, 0.0)):
        link = mt.Link(transmitter=mt.Led(depth=depth)).in_wind(speed)
        gain = mt.simulate(link, FlatSea(), photons=20_000)
        needed = required_gain(mt.OokLink.preset("paper", bit_rate=rate), 1e-3)
        decibel = 10.0 * np.log10(gain.gain / needed)
        error = 10.0 / np.log(10.0) * gain.gain_stderr / gain.gain
        foam = "foam of 13 m/s" if speed else "flat"
        yield (
            f"| {depth:g} m | {rate / 1e6:g} | {foam} | {gain.gain:.3e} | {needed:.3e} | "
            f"{decibel:.1f} +- {error:.2f} dB optical |"
        )


def flight() -> Iterator[str]:
    """Yield what the tilt of a UAV does to a link in strong wind."""
    yield "| receiver | tilt beyond 30 deg | mean gain | average BER, 1 Mbit/s | outage at 1e-3 |"
    yield "|---|---|---|---|---|"
    link, gusts = (
        mt.Link(transmitter=mt.Led(depth=40.0)).in_wind(13.0),
        mt.Dryden(wind_speed=13.0),
    )
    frames, step = 100, 5.0
    tilt = mt.Uav().tilt(gusts.simulate_wind(step * np.arange(frames), seed=1))
    coupled_share = float(np.mean(tilt.angle > np.radians(30.0)))
    cases = {
        "on a gimbal": mt.Flight(mt.Uav(gimbal=True)),
        "fixed, factor h_alpha": mt.Flight(),
        "fixed, coupled": mt.Flight(coupled=True, time_step=step),
    }
    for name, flight in cases.items():
        done = mt.link_performance(link, bit_rate=1e6, realizations=frames, seed=1, flight=flight)
        f, coupled = done.at(), flight.coupled
        share = coupled_share if coupled else done.fades[0].tilt.outage
        yield (
            f"| {name} | {100.0 * share:.2f} % | {f.gain.value:.3e} | {f.ber.value:.1e} "
            f"({f.ber.low:.1e} to {f.ber.high:.1e}) | {f.outage.value:.4f} ({f.outage.low:.4f} to "
            f"{f.outage.high:.4f}) |"
        )
    share = mt.Uav().tilt_law(gusts).outage(np.radians(60.0))
    yield f"| exact law of the tilt | {100.0 * share:.2f} % | | | |"


if __name__ == "__main__":
    for make in (excess, wind, tilt, flight, ranges):
        if sys.argv[1:] and make.__name__ not in sys.argv[1:]:
            continue
        rows = []
        for row in make():
            print(row, flush=True)
            rows.append(row)
        write_table(f"link_{make.__name__}", "\n".join(rows))
