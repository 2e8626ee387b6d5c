"""CPU seconds of a frame of a trace, the default link at 5 m/s over all waves that make it fade.

Run with `pytest tests/benchmarks/test_traces_benchmark.py --benchmark-only -o addopts=`, or as a
script, which prints a table and the shares by part.
"""

from __future__ import annotations

import cProfile
import pstats
from time import process_time
from typing import Any

import pytest
from clocks import timed

import meshtrace as mt
from meshtrace.surfaces import sea_in_wind

DAY = mt.Daylight.clear_sky(30.0)
FLIGHT = mt.Flight(mt.Uav(), mt.Dryden(wind_speed=5.0))
UP: dict[str, Any] = {"down": None}
KINDS: dict[str, dict[str, Any]] = {
    "one direction": UP,
    "both directions": {},
    "one direction, flight": {**UP, "flight": FLIGHT},
    "both directions, flight": {"flight": FLIGHT},
    "one direction, background once a second": {**UP, "daylight": DAY, "background_rate": 1.0},
}
RATE, FEW, MANY = 50.0, 10, 60  # frames per second; frames of both traces
PARTS = {"sums of waves": "execute", "unscattered light": "direct_gains", "chains": "aim"}


def seconds_of(frames: int, options: dict[str, Any]) -> float:
    """Return the CPU seconds of a trace."""
    given = {"hours": frames / RATE / 3600.0, "rate": RATE, "threads": 1, **options}
    return timed(lambda: mt.channel_trace(mt.Link(), sea_in_wind(5.0), **given))[1]


def per_frame(options: dict[str, Any]) -> float:
    """Return the CPU seconds of a frame, without those of the start."""
    seconds_of(2, options)
    few = seconds_of(FEW, options)
    return (seconds_of(MANY, options) - few) / (MANY - FEW)


@pytest.mark.parametrize("kind", KINDS)
def test_a_frame(benchmark, kind):
    found = benchmark.pedantic(per_frame, (KINDS[kind],), rounds=1)
    benchmark.extra_info["cpu_seconds"] = found
    if kind == "one direction":
        assert found < 0.02


def main() -> None:
    """Print CPU seconds by kind, and the shares of the parts of one direction."""
    for kind, options in KINDS.items():
        print(f"{kind:40s} {1e3 * per_frame(options):6.1f} ms a frame", flush=True)
    profile = cProfile.Profile(process_time)
    profile.runcall(seconds_of, MANY, UP)
    rows = pstats.Stats(profile).stats.items()  # type: ignore[attr-defined]
    for part, name in PARTS.items():
        spent = sum(row[3] for (_, _, function), row in rows if function == name)
        print(f"  {part:38s} {1e3 * spent / MANY:6.1f} ms")


if __name__ == "__main__":
    main()
