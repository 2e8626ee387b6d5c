"""The analog engine against the plain tracer, and its memory.

Engine and peer take turns, and the best of several rounds counts for both, so that a busy
machine slows both alike.
"""

from __future__ import annotations

import subprocess
import sys
from typing import Any

from clocks import best_of, peak_mib
from plain_loop import plain_loop
from plain_tracer import plain_gain

import meshtrace as mt
from meshtrace.engine.photons import analog
from meshtrace.engine.setup import meshing
from meshtrace.surfaces import FlatSea, JonswapSea

SMOOTH = mt.Link(physics=mt.Physics(unresolved="none"))


def default_mesh(link: mt.Link) -> mt.TriangleMesh:
    """Return the 13 m/s sea over the footprint of a link."""
    return meshing.mesh_for(link, JonswapSea(wind_speed=13.0, seed=7, waves="paper"))[0]


def measure_against_plain(
    photons: int = 1_000_000, plain_photons: int = 100_000, rounds: int = 2
) -> dict[str, Any]:
    """Return photons per CPU second of engine and plain tracer on the default link, and the ratio."""
    link, mesh = SMOOTH, default_mesh(SMOOTH)
    intersector = mt.EmbreeIntersector(mesh, 1)
    analog.run_analog(link, intersector, photons=4096, seed=1)
    times = best_of(
        rounds,
        lambda: analog.run_analog(link, intersector, photons=photons, seed=1, threads=1),
        lambda: plain_gain(link, mesh, plain_photons, seed=1),
    )
    rates = photons / times[0], plain_photons / times[1]
    return {
        "photons_per_s": rates[0],
        "plain_photons_per_s": rates[1],
        "speedup": rates[0] / rates[1],
        "seconds": times,
    }


def measure_against_loop(b: float, photons: int, rounds: int = 3) -> dict[str, Any]:
    """Return ns of a photon of `simulate` and of the plain loop below still water, and the ratio.

    `events` are the collisions of a photon, to which its time is related in turbid water.
    """
    water = mt.Water(a=0.1, b=b, phase=mt.optics.HenyeyGreenstein(g=0.924))
    link, options = mt.Link(water=water), {"estimator": "analog", "threads": 1}
    mt.simulate(link, FlatSea(), photons=4096, **options)
    _, _, events = plain_loop(link, photons, 1)
    seconds = best_of(
        rounds,
        lambda: mt.simulate(link, FlatSea(), photons=photons, **options),
        lambda: plain_loop(link, photons, 1),
    )
    ns, plain_ns = (1e9 * s / photons for s in seconds)
    return {"ns": ns, "plain_ns": plain_ns, "ratio": ns / plain_ns, "events": events}


def peak_memory(photons: int, estimator: str = "analog") -> int:
    """Return the peak resident memory [bytes] of a fresh process that follows photons or chains."""
    command = [sys.executable, __file__, str(photons), estimator]
    return int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def _follow(photons: int, estimator: str) -> int:
    mt.simulate(mt.Link(), FlatSea(), estimator=estimator, photons=photons, seed=1)
    return round(peak_mib() * 2**20)


if __name__ == "__main__":
    print(_follow(int(sys.argv[1]), sys.argv[2]))
