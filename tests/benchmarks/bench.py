"""Speed of the engine, as ratios within one run.

    python tests/benchmarks/bench.py --quick
    python tests/benchmarks/bench.py LINK.TOML --cold -o bench.json

Photons and rays per second, figure of merit, cost of a new sea and of whole answers, scaling with
threads and processes. Times are CPU seconds of one thread, which other load on the machine hardly
changes, but for the scaling and the first run: wall time depends on the load, and on two sides of a
ratio not alike. Engine and reference take turns; the best round of each counts.

The measurements are functions of `works`.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from clocks import peak_mib
from works import (
    analog_rate,
    background_light,
    coverage_cost,
    figure_of_merit,
    first_run,
    new_sea,
    realization,
    resolved_sea,
    thread_scaling,
    worker_scaling,
)

from meshtrace import parallel
from meshtrace.checks import check_call
from meshtrace.engine.setup import meshing
from meshtrace.engine.setup.ends import crossing_reach
from meshtrace.errors import Described, Refused
from meshtrace.results.provenance import environment
from meshtrace.scenario import Scenario
from meshtrace.surfaces import Band, Elfouhaily, SpectralSea
from meshtrace.tables import text_table

COARSE = {"step": 0.25, "rtol": 0.02}
"""Cells [m] and relative error of the smaller one of two coverage maps."""


@check_call
def bench(scenario: Scenario, *, quick: bool = False, cold: bool = False) -> dict[str, Any]:
    """Return all measurements on a link over a random sea, with the environment.

    Parameters
    ----------
    scenario : Scenario
        Link and sea.
    quick : bool
        Use a quarter of the photons.
    cold : bool
        Also measure a first run, which compiles into an empty cache: half a minute.

    Returns
    -------
    dict
        Plain data: `environment`, `cores`; `load`, the mean number of processes that wanted a core
        in the minute before; `analog` and `analog_tilted` of `analog_rate`, without
        and with tilts for unresolved slopes; `merit` of `figure_of_merit`; `new_sea`;
        `resolved_sea`; `realization`, `background`, `coverage` (to 2 % in cells of 0.25 m),
        `fine_coverage` (to 1 % in cells of 0.1 m) and, if `cold`, `first_run` of this file;
        `downlink`, `new_sea` of the mirrored link to 1 %; each of these None where the link is
        refused; `peak_memory_mib` of this process;
        `thread_scaling`, `worker_scaling`, the latter None where dask is not installed.

    Raises
    ------
    Refused
        If the sea is not a random one, or forced detection refuses the link.
    """
    link, sea = scenario.link, scenario.case().surface
    if not hasattr(sea, "with_seed"):
        raise Refused("sea", Described(type(sea).__name__), "a random sea")
    mesh, _ = meshing.mesh_for(link, sea)
    near, _ = meshing.mesh_for(link, sea, reach=crossing_reach(link))
    scale = 4 if quick else 1
    photons, chains, extent = 4_000_000 // scale, 20_000 // scale, 5.0 / scale
    physics = link.physics.model_copy(update={"unresolved": "none"})
    bare = link.model_copy(update={"physics": physics})
    down = link if link.direction == "down" else None
    dask = find_spec("distributed")
    return {
        "environment": environment(),
        "cores": parallel.cores(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "analog": analog_rate(bare, mesh, photons),
        "analog_tilted": analog_rate(link, mesh, photons),
        "merit": figure_of_merit(link, near, chains, photons),
        "new_sea": new_sea(link, sea),
        "resolved_sea": resolved_sea(link, _resolved(sea)),
        "realization": realization(link, sea),
        "background": _if_followed(lambda: background_light(link, sea)),
        "coverage": _if_followed(lambda: coverage_cost(link, sea, extent=extent, **COARSE)),
        "fine_coverage": _if_followed(lambda: coverage_cost(link, sea, extent=extent)),
        "first_run": first_run() if cold else None,
        "downlink": _if_followed(lambda: new_sea(down or link.mirrored(), sea)),
        "peak_memory_mib": peak_mib(),
        "thread_scaling": thread_scaling(link, mesh, near, photons, 20 * chains),
        "worker_scaling": worker_scaling(scenario, 128 // scale) if dask else None,
    }


def _if_followed(measure: Callable[[], dict[str, Any]]) -> dict[str, Any] | None:
    """Return a measurement; None if the estimator refuses the link."""
    try:
        return measure()
    except Refused:
        return None


def _resolved(sea: Any) -> SpectralSea:
    """Return a sea of the same wind with waves up to 24 rad/s and tilts beyond."""
    spectrum = Elfouhaily(wind_speed=getattr(sea, "wind_speed", 5.0), fetch=30e3)
    band = Band(
        omega_min=0.6 * spectrum.omega_p, omega_max=24.0, d_omega=0.3, d_theta=math.pi / 18.0
    )
    return SpectralSea(spectrum=spectrum, spreading="elfouhaily", mss="elfouhaily", waves=band)


_ROWS = (
    ("analog", "analog photons", "{photons_per_s:.3g} per CPU s"),
    ("analog", "raw Embree rays", "{rays_per_s:.3g} per CPU s, same rays and mesh "
     "({facets} facets)"),
    ("analog", "photons per ray", "{ratio:.3f}; {tilted:.3f} with tilts for unresolved slopes"),
    ("merit", "figure of merit", "{ratio:.3g} +- {ratio_stderr:.1g}, 1 / (variance x time) of "
     "forced over analog, chains made included; {ratio_kept:.3g} with chains that are kept"),
    ("merit", "  forced", "{forced_rtol:.2e} relative in {forced_seconds:.3f} CPU s ({chains} "
     "chains; made in {setup_seconds:.3f} CPU s); scatter over stated error "
     "{scatter_over_error:.2f}"),
    ("merit", "  analog", "{analog_rtol:.2e} relative in {analog_seconds:.3f} CPU s ({photons} "
     "photons)"),
    ("new_sea", "new sea to {rtol:.2%}", "{seconds:.3f} CPU s with mesh ({mesh_seconds:.3f}) "
     "and chains, {kept_seconds:.3f} with chains that are kept; BVH {bvh_seconds:.3f}"),
    ("resolved_sea", "resolved sea to {gain[rtol]:.2%}", "{gain[seconds]:.3f} CPU s "
     "({gain[facets]} facets); {seconds_per_realization:.3f} each in an ensemble ({facets} "
     "facets), unscattered light {direct_seconds:.4f}"),
    ("realization", "realization to {rtol:.2%}", "{cpu_seconds:.4f} CPU s each of {realizations} "
     "({chains} chains)"),
    ("downlink", "downlink to {rtol:.2%}", "{seconds:.3f} CPU s with mesh ({mesh_seconds:.3f}) "
     "and chains"),
    ("background", "background to {rtol:.2%}", "{cpu_seconds:.3f} CPU s ({rays} rays, sun at 30 "
     "degrees)"),
    ("coverage", "coverage to {rtol:.2%}", "{cpu_seconds:.1f} CPU s for {cells} cells"),
    ("fine_coverage", "fine coverage to {rtol:.2%}", "{cpu_seconds:.1f} CPU s for {cells} cells"),
    ("first_run", "first run", "{seconds:.1f} s ({cpu_seconds:.1f} CPU s) with compilation, "
     "{warm_seconds:.1f} s ({warm_cpu_seconds:.1f} CPU s) afterwards"),
)  # fmt: skip
"""Measurement, and heading and text of its row in the report."""


@check_call
def report(result: dict[str, Any]) -> str:
    """Return the measurements of `bench` as a table of text."""
    merit = result["merit"]
    relative = {f"{name}_rtol": merit[f"{name}_variance"] ** 0.5 for name in ("forced", "analog")}
    tilted = {"tilted": result["analog_tilted"]["ratio"]}
    measured = {**result, "analog": {**result["analog"], **tilted}, "merit": {**merit, **relative}}
    rows = {
        heading.format(**measured[name]): text.format(**measured[name])
        for name, heading, text in _ROWS
        if measured[name] is not None
    }
    load = "not known" if result["load"] is None else f"{result['load']:.1f}"
    load += f" on {result['cores']} cores before; CPU seconds of one thread, but wall time of "
    rows = {"load": f"{load}the first run, threads and workers", **rows}
    rows["peak memory"] = f"{result['peak_memory_mib']:.0f} MiB"
    rows |= _scaling(result["thread_scaling"], result["worker_scaling"])
    return text_table(rows.items())


SLOWER = 0.15
"""Share by which a work may take longer than before."""


def compare(new: dict[str, Any], old: dict[str, Any]) -> tuple[str, list[str]]:
    """Compare two measurements of `bench` of one link, with the same options.

    CPU seconds are divided by those of a raw ray in the same run, so that the speed of the
    processor cancels; the effect of other processes on its caches does not.

    Parameters
    ----------
    new, old : dict
        Measurements.

    Returns
    -------
    table : str
        Works that both have, their times in raw rays, and the ratio of these.
    slower : list of str
        Works that take more than `SLOWER` longer.

    Raises
    ------
    Refused
        If `old` is no measurement.
    """
    try:
        before, now = _rays(old), _rays(new)
    except (KeyError, TypeError) as error:
        found, allowed = Described("no measurement"), "JSON of bench.py"
        raise Refused("compare", found, allowed) from error
    both = [name for name in now if name in before]
    ratios = {name: now[name] / before[name] for name in both}
    rows = [(n, f"{before[n]:.3g}", f"{now[n]:.3g}", f"{ratios[n]:.3f}") for n in both]
    table = text_table(rows, ("work", "rays before", "rays now", "ratio"))
    return table, [name for name in both if ratios[name] > 1.0 + SLOWER]


def _rays(result: dict[str, Any]) -> dict[str, float]:
    """Return the time of each work in raw rays of the same run, of those that were measured."""
    photons = {name: result[name]["photons_per_s"] for name in ("analog", "analog_tilted")}
    seconds = {f"{name} photon": 1.0 / rate for name, rate in photons.items()}
    for name, key in (
        *(("merit", "setup_seconds"), ("merit", "forced_seconds"), ("new_sea", "seconds")),
        *(("resolved_sea", "seconds_per_realization"), ("realization", "cpu_seconds")),
        *(("downlink", "seconds"), ("background", "cpu_seconds"), ("coverage", "cpu_seconds")),
        ("fine_coverage", "cpu_seconds"),
    ):
        if result.get(name) is not None:  # earlier measurements lack later works
            seconds[f"{name} {key}".replace("_", " ")] = result[name][key]
    return {name: value * result["analog"]["rays_per_s"] for name, value in seconds.items()}


def _scaling(threads: dict[str, Any], workers: dict[str, Any] | None) -> dict[str, str]:
    """Return speeds relative to one thread or worker."""
    counts, analog, forced = (threads[k] for k in ("threads", "analog_by_jobs", "forced_by_jobs"))
    rows = {
        "threads": f"{_times(counts, threads['analog_speedup'])} (analog), "
        f"{_times(counts, threads['forced_speedup'])} (forced)",
        "threads by job times": f"{_times(analog['threads'], analog['speedup'])} (analog), "
        f"{_times(forced['threads'], forced['speedup'])} (forced, chains made included)",
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
    """Format speedups as in "2: 1.95x"; the speedup of one thread only if no other is given."""
    rows = list(zip(counts, speedups, strict=True))
    return ", ".join(f"{n}: {speed:.2f}x" for n, speed in rows if n > 1 or len(rows) == 1)


def main(arguments: list[str] | None = None) -> None:
    """Measure a link file, or the link of the paper at 13 m/s; print and compare.

    Exits with code 1 if a work takes longer than in an earlier output, with 2 for bad input.
    """
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("link", nargs="?", help="link file; default: the paper's link at 13 m/s")
    parser.add_argument("-o", "--output", type=Path, help="write the measurements as JSON")
    parser.add_argument("--json", action="store_true", help="print the measurements as JSON")
    parser.add_argument("--quick", action="store_true", help="use a quarter of the photons")
    parser.add_argument("--cold", action="store_true", help="also measure a first run")
    parser.add_argument("--compare", type=Path, help="an earlier output on this machine")
    options = parser.parse_args(arguments)
    try:
        slower = _measure_and_print(options)
    except (Refused, OSError) as error:
        parser.exit(2, f"error: {error}\n")
    if slower:
        parser.exit(1, f"slower by more than {SLOWER:.0%}: {', '.join(slower)}\n")


def _measure_and_print(options: argparse.Namespace) -> list[str]:
    """Print the measurements, and return the works that are slower than before."""
    earlier = None if options.compare is None else _read_measurements(options.compare)
    if options.output is not None:  # an hour of work is lost where it cannot be written
        options.output.touch()
    if options.link is None:
        scenario = Scenario.from_config({"wind_speed": 13.0, "bubbles": "none"})
    else:
        scenario = Scenario.load(options.link)
    result = bench(scenario, quick=options.quick, cold=options.cold)
    text = json.dumps(result, indent=1)
    print(text if options.json else report(result))
    if options.output is not None:
        options.output.write_text(text + "\n", encoding="utf-8")
    if earlier is None:
        return []
    table, slower = compare(result, earlier)
    print(f"\n{table}", file=sys.stderr if options.json else sys.stdout)
    return slower


def _read_measurements(path: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (TypeError, ValueError) as error:
        raise Refused("--compare", str(path), "JSON of bench.py") from error


if __name__ == "__main__":
    main()
