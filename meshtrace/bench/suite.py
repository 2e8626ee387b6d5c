"""All measurements on one link, and how they read."""

from __future__ import annotations

import os
import resource
import sys
from importlib.util import find_spec
from typing import Any

from meshtrace.bench.engine import analog_rate, figure_of_merit, new_sea
from meshtrace.bench.scaling import thread_scaling, worker_scaling
from meshtrace.results.provenance import environment
from meshtrace.scenario import Scenario, ScenarioError
from meshtrace.transport.forced import crossing_reach
from meshtrace.transport.simulate import mesh_for


def bench(scenario: Scenario, *, quick: bool = False) -> dict[str, Any]:
    """Return all measurements on a link over a random sea, with the environment they are of.

    Parameters
    ----------
    scenario : Scenario
        Link and sea.
    quick : bool
        A quarter of the photons.

    Returns
    -------
    dict
        Plain data: `environment`, `cores`; `analog` and `analog_tilted` of `analog_rate`, without
        and with tilts for unresolved slopes; `merit` of `figure_of_merit`; `new_sea`;
        `peak_memory_mib` of this process; `thread_scaling`, `worker_scaling`, the latter None
        where dask is not installed.

    Raises
    ------
    ScenarioError
        If the sea is not a random one, or forced detection refuses the link.
    """
    link, sea = scenario.link, scenario.surface
    if not hasattr(sea, "with_seed"):
        raise ScenarioError(f"sea: {type(sea).__name__}, allowed: a random sea, made anew by seeds")
    mesh, _ = mesh_for(link, sea)
    near, _ = mesh_for(link, sea, reach=crossing_reach(link))
    scale = 4 if quick else 1
    photons, chains = 4_000_000 // scale, 20_000 // scale
    physics = link.physics.model_copy(update={"unresolved": "none"})
    bare = link.model_copy(update={"physics": physics})
    dask = find_spec("distributed") and find_spec("zarr")
    return {
        "environment": environment(),
        "cores": os.cpu_count(),
        "analog": analog_rate(bare, mesh, photons),
        "analog_tilted": analog_rate(link, mesh, photons),
        "merit": figure_of_merit(link, near, chains, photons),
        "new_sea": new_sea(link, sea),
        "peak_memory_mib": _peak_memory(),
        "thread_scaling": thread_scaling(link, mesh, near, photons, chains),
        "worker_scaling": worker_scaling(scenario, 128 // scale) if dask else None,
    }


def report(result: dict[str, Any]) -> str:
    """Return the measurements of `bench` as lines for the eye."""
    analog, merit, sea = result["analog"], result["merit"], result["new_sea"]
    return "\n".join(
        [
            f"analog photons      {analog['photons_per_s']:.3g} per s, {analog['threads']} threads",
            f"raw Embree rays     {analog['rays_per_s']:.3g} per s, same rays and mesh "
            f"({analog['facets']} facets)",
            f"photons per ray     {analog['ratio']:.3f}; "
            f"{result['analog_tilted']['ratio']:.3f} with tilts for the slopes that the mesh lacks",
            f"figure of merit     {merit['ratio']:.3g} +- {merit['ratio_stderr']:.1g}, "
            "1 / (variance x time) of forced over analog",
            f"  forced            {merit['forced_variance'] ** 0.5:.2e} relative in "
            f"{merit['forced_seconds']:.3f} s ({merit['chains']} chains; made in "
            f"{merit['setup_seconds']:.3f} s)",
            f"  analog            {merit['analog_variance'] ** 0.5:.2e} relative in "
            f"{merit['analog_seconds']:.3f} s ({merit['photons']} photons)",
            f"new sea to {sea['rtol']:.2%}    {sea['seconds']:.3f} s with mesh "
            f"({sea['mesh_seconds']:.3f} s) and chains; BVH {sea['bvh_seconds']:.3f} s",
            f"peak memory         {result['peak_memory_mib']:.0f} MiB",
            *_scaling(result["thread_scaling"], result["worker_scaling"]),
        ]
    )


def _scaling(threads: dict[str, Any], workers: dict[str, Any] | None) -> list[str]:
    """Return speeds relative to one thread or worker, a line each."""
    lines = [
        f"threads             {_times(threads['threads'], threads['analog_speedup'])} (analog), "
        f"{_times(threads['threads'], threads['forced_speedup'])} (forced)"
    ]
    if workers is None:
        return [*lines, 'workers             not measured: pip install "meshtrace[batch]"']
    speeds = _times(workers["workers"], workers["speedup"])
    return [
        *lines,
        f"workers             {speeds} ({workers['realizations']} seas, start included; "
        f"{workers['realizations_per_s'][0]:.3g} per s on one)",
    ]


def _times(counts: list[int], speedups: list[float]) -> str:
    """Return how often one all of them are, as in "2: 1.95x"."""
    rows = list(zip(counts, speedups, strict=True))
    return ", ".join(f"{n}: {speed:.2f}x" for n, speed in (rows[1:] or rows))


def _peak_memory() -> float:
    """Return the peak resident memory of this process [MiB]."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)
