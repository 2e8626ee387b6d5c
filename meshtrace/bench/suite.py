"""All measurements on one link, and their report."""

from __future__ import annotations

import math
import os
import resource
import sys
from importlib.util import find_spec
from typing import Any

from meshtrace.bench.engine import analog_rate, figure_of_merit, new_sea, resolved_sea
from meshtrace.bench.maps import coverage_cost
from meshtrace.bench.scaling import thread_scaling, worker_scaling
from meshtrace.errors import Described, Refused
from meshtrace.link import Link
from meshtrace.results.provenance import environment
from meshtrace.scenario import Scenario
from meshtrace.surfaces import Elfouhaily, SpectralSea
from meshtrace.tables import text_table
from meshtrace.transport.forced_link import crossing_reach
from meshtrace.transport.meshing import mesh_for


def bench(scenario: Scenario, *, quick: bool = False) -> dict[str, Any]:
    """Return all measurements on a link over a random sea, with the environment.

    Parameters
    ----------
    scenario : Scenario
        Link and sea.
    quick : bool
        Use a quarter of the photons.

    Returns
    -------
    dict
        Plain data: `environment`, `cores`; `analog` and `analog_tilted` of `analog_rate`, without
        and with tilts for unresolved slopes; `merit` of `figure_of_merit`; `new_sea`;
        `resolved_sea`; `downlink`, `new_sea` of the mirrored link to 1 %, None without one;
        `coverage` of `coverage_cost`; `peak_memory_mib` of this process; `thread_scaling`,
        `worker_scaling`, the latter None where dask is not installed.

    Raises
    ------
    Refused
        If the sea is not a random one, or forced detection refuses the link.
    """
    link, sea = scenario.link, scenario.case().surface
    if not hasattr(sea, "with_seed"):
        raise Refused("sea", Described(type(sea).__name__), "a random sea")
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
        "resolved_sea": resolved_sea(link, _resolved(sea)),
        "downlink": _downlink(link, sea),
        "coverage": coverage_cost(link, sea, extent=5.0 / scale),
        "peak_memory_mib": _peak_memory(),
        "thread_scaling": thread_scaling(link, mesh, near, photons, chains),
        "worker_scaling": worker_scaling(scenario, 128 // scale) if dask else None,
    }


def _downlink(link: Link, sea: Any) -> dict[str, Any] | None:
    """Return the cost of a gain to 1 % in the air-to-water direction, None without one."""
    try:
        down = link if link.direction == "down" else link.mirrored()
        return new_sea(down, sea, rtol=0.01)
    except Refused:
        return None


def _resolved(sea: Any) -> SpectralSea:
    """Return a sea of the same wind with waves up to 24 rad/s and tilts beyond."""
    spectrum = Elfouhaily(wind_speed=getattr(sea, "wind_speed", 5.0), fetch=30e3)
    return SpectralSea(
        spectrum=spectrum,
        spreading="elfouhaily",
        mss="elfouhaily",
        omega_max=24.0,
        d_omega=0.3,
        d_theta=math.pi / 18.0,
    )


def report(result: dict[str, Any]) -> str:
    """Return the measurements of `bench` as a table of text."""
    analog, merit, sea = result["analog"], result["merit"], result["new_sea"]
    fine = result["resolved_sea"]
    tilted = result["analog_tilted"]["ratio"]
    rows = {
        "analog photons": f"{analog['photons_per_s']:.3g} per s, {analog['threads']} threads",
        "raw Embree rays": f"{analog['rays_per_s']:.3g} per s, same rays and mesh "
        f"({analog['facets']} facets)",
        "photons per ray": f"{analog['ratio']:.3f}; {tilted:.3f} with tilts for unresolved slopes",
        "figure of merit": f"{merit['ratio']:.3g} +- {merit['ratio_stderr']:.1g}, "
        "1 / (variance x time) of forced over analog, chains made included; "
        f"{merit['ratio_kept']:.3g} with chains that are kept",
        "  forced": f"{merit['forced_variance'] ** 0.5:.2e} relative in "
        f"{merit['forced_seconds']:.3f} s ({merit['chains']} chains; made in "
        f"{merit['setup_seconds']:.3f} s); scatter over stated error "
        f"{merit['scatter_over_error']:.2f}",
        "  analog": f"{merit['analog_variance'] ** 0.5:.2e} relative in "
        f"{merit['analog_seconds']:.3f} s ({merit['photons']} photons)",
        f"new sea to {sea['rtol']:.2%}": f"{sea['seconds']:.3f} s with mesh "
        f"({sea['mesh_seconds']:.3f} s) and chains; BVH {sea['bvh_seconds']:.3f} s",
        f"resolved sea to {fine['gain']['rtol']:.2%}": f"{fine['gain']['seconds']:.3f} s "
        f"({fine['gain']['facets']} facets); {fine['seconds_per_realization']:.3f} s each in an "
        f"ensemble ({fine['facets']} facets), unscattered light {fine['direct_seconds']:.4f} s",
        **_down(result["downlink"]),
        "coverage map to 1 %": f"{result['coverage']['cpu_seconds']:.3g} CPU s, "
        f"{result['coverage']['cells']} places",
        "peak memory": f"{result['peak_memory_mib']:.0f} MiB",
        **_scaling(result["thread_scaling"], result["worker_scaling"]),
    }
    return text_table(rows.items())


def _down(cost: dict[str, Any] | None) -> dict[str, str]:
    """Return the time of a downlink as text."""
    if cost is None:
        return {}
    text = f"{cost['seconds']:.3f} s with mesh ({cost['mesh_seconds']:.3f} s) and chains"
    return {f"downlink to {cost['rtol']:.2%}": text}


def _scaling(threads: dict[str, Any], workers: dict[str, Any] | None) -> dict[str, str]:
    """Return speeds relative to one thread or worker."""
    counts = threads["threads"]
    rows = {
        "threads": f"{_times(counts, threads['analog_speedup'])} (analog), "
        f"{_times(counts, threads['forced_speedup'])} (forced)",
        "workers": 'not measured: pip install "meshtrace[batch]"',
    }
    if workers is not None:
        speeds = _times(workers["workers"], workers["speedup"])
        rows["workers"] = (
            f"{speeds} ({workers['realizations']} seas, start included; "
            f"{workers['realizations_per_s'][0]:.3g} per s on one)"
        )
    return rows


def _times(counts: list[int], speedups: list[float]) -> str:
    """Return the speedups as text, as in "2: 1.95x"."""
    rows = list(zip(counts, speedups, strict=True))
    return ", ".join(f"{n}: {speed:.2f}x" for n, speed in (rows[1:] or rows))


def _peak_memory() -> float:
    """Return the peak resident memory of this process [MiB]."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)
