"""Measure the estimators of the scattered light on the 24 links of `estimator_links`.

`python docs/scripts/measure_estimators.py` measures what is missing in `estimators.json` and
writes the table of estimators.md; `--links` and `--estimators` take parts of names, `--again`
repeats what is there, `--jobs 2` runs two links at a time. All runs are of one thread, compiled
before; times are CPU seconds of their process.
"""

from __future__ import annotations

import argparse
import json
import math
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any, NamedTuple

import numpy as np
from estimator_links import LINKS, Case, mesh_of
from places import GENERATED, write_table

import meshtrace as mt
from meshtrace.engine.choice import chain_pilot
from meshtrace.engine.forced import ForcedDetection, TypicalSea
from meshtrace.engine.photons.joined import JoinedPhotons
from meshtrace.errors import Refused
from meshtrace.stored import SHIFTS

KEPT = GENERATED / "estimators.json"
KILL = mt.Physics(reflected="kill")
UNSCATTERED_CHAINS, WIDE_SEEDS, ANALOG_SHARE = 16_384, 8, 32
LEAST, MOST = 256, 2**20
_FEWEST = 8  # runs for a chi-square


class Parts(NamedTuple):
    """Gains of some parts, their standard errors and upper bounds, by receiver."""

    gain: dict[str, np.ndarray]
    error: dict[str, np.ndarray]
    method: str = ""
    bound: np.ndarray | None = None


def _forced(scattered: str) -> Callable[..., Parts]:
    """Return a run of chains alone."""

    def run(link: mt.Link, mesh: mt.TriangleMesh, photons: int, seed: int) -> Parts:
        sea = TypicalSea.of_meshes([mesh])
        forced = ForcedDetection(link, photons, seed, sea=sea, scattered=scattered)
        found = forced.evaluate(mesh).scattered
        error = found.std(axis=1, ddof=1) / math.sqrt(SHIFTS)
        return Parts({"scattered": found.mean(axis=1)}, {"scattered": error})

    return run


def _joined(link: mt.Link, mesh: mt.TriangleMesh, photons: int, seed: int) -> Parts:
    """Follow joined photons; unscattered light is not theirs."""
    found = JoinedPhotons(link, photons, seed).evaluate(mesh)
    groups = {"scattered": found.groups[1], "reflected": found.groups[2]}
    groups["both"] = found.groups[1] + found.groups[2]
    error = {k: g.std(axis=1, ddof=1) / math.sqrt(SHIFTS) for k, g in groups.items()}
    return Parts({k: g.mean(axis=1) for k, g in groups.items()}, error)


def _simulate(link: mt.Link, mesh: mt.TriangleMesh, photons: int, seed: int) -> Parts:
    """Run the product with its own choice of estimator."""
    found = mt.simulate(link, mesh, photons=photons, seed=seed, threads=1)
    zero = np.zeros_like(found.gains)
    reflected = zero if found.gain_reflected is None else np.atleast_1d(found.gain_reflected)
    gain = {
        "all": found.gains,
        "unscattered": np.atleast_1d(found.gain_ballistic),
        "scattered": np.atleast_1d(found.gain_scattered),
        "reflected": reflected,
    }
    error = {"all": found.stderrs}
    bound = np.broadcast_to(np.nan if found.gain_bound is None else found.gain_bound, zero.shape)
    return Parts(gain, error, ", ".join(s.estimator for s in found.scattered), bound)


def _unscattered(link: mt.Link, mesh: mt.TriangleMesh, photons: int, seed: int) -> Parts:
    """Return unscattered light: without an error but for extended lamps and narrow beams."""
    try:
        clear = link.replace(water=_without_bottom(link.water))
        found = ForcedDetection(clear, photons, seed, scattered="chains").evaluate(mesh).direct
    except Refused:
        found = ForcedDetection(link, photons, seed).evaluate(mesh).direct
    error = found.std(axis=1, ddof=1) / math.sqrt(SHIFTS)
    return Parts({"unscattered": found.mean(axis=1)}, {"unscattered": error})


def _without_bottom(water: mt.Water) -> mt.Water:
    """Return water that unscattered light crosses like the given one."""
    return water.replace(bottom_depth=None, bottom_albedo=0.0)


def _analog(reflected: str) -> Callable[..., Parts]:
    """Return a run of analog photons whose reflected light is followed or ended."""

    def run(link: mt.Link, mesh: mt.TriangleMesh, photons: int, seed: int) -> Parts:
        if reflected == "kill":
            link = link.replace(physics=KILL)
        found = mt.simulate(link, mesh, "analog", photons=photons, seed=seed, threads=1)
        return Parts({"all": found.gains}, {"all": found.stderrs})

    return run


RUNS: dict[str, Callable[..., Parts]] = {
    "unscattered": _unscattered,
    "chains": _forced("chains"),
    "joined": _joined,
    "analog": _analog("trace"),
    "analog, killed": _analog("kill"),
    "simulate": _simulate,
}


def measure(name: str, estimator: str, seeds: int, seconds: float) -> dict[str, Any]:
    """Return the figures of an estimator on a link, on its own and with a widened aperture."""
    warnings.simplefilter("ignore")
    case = LINKS[name]
    run = RUNS[estimator]
    try:
        if estimator == "unscattered":
            return _unscattered_of(case)
        if estimator.startswith("analog"):
            link = case.widened()
            return _repeated(run, link, mesh_of(link, case.surface), 1, ANALOG_SHARE * seconds)
        mesh = mesh_of(case.link, case.surface)
        if estimator == "simulate":
            return _repeated(run, case.link, mesh, seeds, seconds, 10_000)
        found = _repeated(run, case.link, mesh, seeds, seconds)
        if estimator == "chains":
            found["pilot"] = _pilot_variance(case.link)
        if case.wide is not None:
            link = case.widened()
            mesh = mesh_of(link, case.surface)
            found["wide"] = _repeated(run, link, mesh, WIDE_SEEDS, seconds)
    except Refused as refused:
        return {"refused": str(refused)}
    return found


def _unscattered_of(case: Case) -> dict[str, Any]:
    """Return the unscattered gain of a case and of its widened link."""
    found = {}
    for key, link in (("link", case.link), ("wide", case.widened())):
        parts = _unscattered(link, mesh_of(link, case.surface), UNSCATTERED_CHAINS, 1)
        found[key] = {
            "mean": _short(parts.gain["unscattered"]),
            "stderr": _short(parts.error["unscattered"]),
        }
    return found


def _repeated(
    run: Callable[..., Parts],
    link: mt.Link,
    mesh: mt.TriangleMesh,
    seeds: int,
    seconds: float,
    photons: int | None = None,
) -> dict[str, Any]:
    """Return the figures of runs of as many photons as take some CPU seconds.

    The fixed time is that of a run of so few photons that they hardly count.
    """
    clock = time.process_time
    run(link, mesh, LEAST, 0)  # compiles, or loads what is compiled
    run(link, mesh, LEAST if photons is None else photons, 0)
    fixed = math.inf
    for _ in range(2):
        start = clock()
        run(link, mesh, SHIFTS, 0)
        fixed = min(fixed, clock() - start)
    photons = photons or _photons_in(lambda n: run(link, mesh, n, 0), seconds, fixed)
    start = clock()
    runs = [run(link, mesh, photons, seed) for seed in range(1, seeds + 1)]
    spent = (clock() - start) / seeds
    found: dict[str, Any] = {"photons": photons, "seeds": seeds}
    found |= {"fixed": round(fixed, 4), "cpu": round(max(spent - fixed, 1e-6), 4)}
    if runs[0].method:
        found["method"] = sorted({r.method for r in runs})
    for part in runs[0].gain:
        gain = np.array([r.gain[part] for r in runs])
        figures = {"mean": gain.mean(axis=0)}
        if seeds > 1:
            figures["scatter"] = gain.std(axis=0, ddof=1)
        if part in runs[0].error:
            error = np.array([r.error[part] for r in runs])
            figures["stated"] = np.sqrt(np.square(error).mean(axis=0))
            if seeds > 1:
                figures["chi2"] = _chi_square(gain, error)
        found[part] = {key: _short(row) for key, row in figures.items()}
    if runs[0].bound is not None:
        found["bounds"] = _bounds(runs)
    return found


def _bounds(runs: list[Parts]) -> dict[str, list[float]]:
    """Return, by receiver, the runs with a bound, those it holds for, and chi2 of the others."""
    bound = np.array([r.bound for r in runs], float)
    gain = np.array([r.gain["all"] for r in runs])
    mean, bounded = gain.mean(axis=0), bound > 0.0
    z = (gain - mean) / np.array([r.error["all"] for r in runs])
    alone = np.maximum((~bounded).sum(axis=0), 1)
    square = np.where(bounded, 0.0, z**2).sum(axis=0) * len(runs) / alone
    counts = bounded.sum(axis=0), (bound >= mean).sum(axis=0), square
    return dict(zip(("runs", "held", "chi2"), map(_short, counts), strict=True))


def _photons_in(run: Callable[[int], Any], seconds: float, fixed: float) -> int:
    """Return the power of two of photons that take about some CPU seconds beyond the fixed ones."""
    n = 4 * LEAST
    while n < MOST:
        start = time.process_time()
        run(n)
        spent = max(time.process_time() - start - fixed, 1e-4)
        if spent > 0.2 * seconds:
            n = int(n * 2.0 ** round(math.log2(seconds / spent)))
            break
        n *= 4
    return max(min(n, MOST if seconds < 1.0 else 2**26), LEAST)


def _chi_square(gain: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Return the sum of ((gain - mean) / error)^2 over the seeds, by receiver."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return (np.square((gain - gain.mean(axis=0)) / error)).sum(axis=0)


def _pilot_variance(link: mt.Link) -> list[float]:
    """Return the relative variance of one chain over still water, by receiver, of four pilots."""
    rows = []
    for seed in range(4):
        forced = ForcedDetection(link, SHIFTS, seed, scattered="chains")
        orders = [forced.drawer.last_order(s) for s in range(len(forced.arrays.emitters))]
        found = chain_pilot(forced.planner.pilots([forced.drawer], orders)[0][0], forced.arrays)
        rows.append(found.variance / np.maximum(found.mean**2, 1e-300))
    return _short(np.median(rows, axis=0))


def _short(values: np.ndarray) -> list[float]:
    """Return values with five digits."""
    return [float(f"{float(x):.5g}") for x in np.atleast_1d(values)]


# %% tables


def cost(entry: dict[str, Any], part: str = "scattered") -> np.ndarray:
    """Return the CPU seconds to 1 % of a part, by receiver."""
    gain, scatter = (np.array(entry[part][key]) for key in ("mean", "scatter"))
    with np.errstate(divide="ignore", invalid="ignore"):
        return entry["cpu"] * np.square(scatter / gain / 0.01)


def variance(entry: dict[str, Any], part: str = "scattered") -> np.ndarray:
    """Return the relative variance of one sample, by receiver."""
    gain, scatter = (np.array(entry[part][key]) for key in ("mean", "scatter"))
    with np.errstate(divide="ignore", invalid="ignore"):
        return entry["photons"] * np.square(scatter / gain)


def bracket(value: float, error: float) -> str:
    """Return a value with the standard error of its last digits, as 1.439(3)e-05."""
    if not value or not math.isfinite(value):
        return "0"
    power = math.floor(math.log10(abs(value)))
    if not error > 0.0:
        return f"{value:.3e}"
    if error >= abs(value):
        return f"{value:.0e} ± {error:.0e}"
    digits = max(power - math.floor(math.log10(error)), 0)
    if error / 10.0 ** (power - digits) < 2.0:  # two digits of an error that begins with 1
        digits += 1
    return f"{value / 10**power:.{digits}f}({error / 10.0 ** (power - digits):.0f})e{power:+03d}"


def number(value: float) -> str:
    """Return a value with two digits."""
    if not math.isfinite(value):
        return "–"
    return f"{value:.2g}" if abs(value) < 99.5 else f"{float(f'{value:.2g}'):,.0f}"


def cell(texts: Any) -> str:
    """Return the values of the receivers as one cell."""
    return "; ".join(texts) or "–"


def light(entry: dict[str, Any] | None, part: str) -> str:
    """Return the mean of a part and its standard error by the scatter of the seeds."""
    if not entry or part not in entry:
        return "–"
    figures = entry[part]
    errors = np.array(figures.get("scatter", figures.get("stated"))) / math.sqrt(entry["seeds"])
    return cell(bracket(*row) for row in zip(figures["mean"], errors, strict=True))


def trust(entry: dict[str, Any]) -> tuple[str, str]:
    """Return chi-square of runs without a bound, and how many of those with one it holds for."""
    seeds = entry["seeds"]
    bounds = entry.get(
        "bounds", {key: [0.0] * len(entry["all"]["chi2"]) for key in ("runs", "held")}
    )
    squares, counts = [], []
    rows = zip(
        bounds.get("chi2", entry["all"]["chi2"]), bounds["runs"], bounds["held"], strict=True
    )
    for square, runs, held in rows:
        alone = seeds - runs
        if alone < _FEWEST:
            squares.append("–")
        else:
            square, off = square * 64.0 / seeds, 24.0 * math.sqrt(64.0 / alone)
            squares.append(f"{square:.0f}" if abs(square - 66.0) <= off else f"**{square:.0f}**")
        known = "bounds" in entry
        counts.append(f"{runs:.0f}: {held:.0f}" if runs else "0" if known else "–")
    return cell(squares), cell(counts)


def analog_cost(found: dict[str, Any]) -> str:
    """Return the time of analog photons to 1 % of all light, scaled to the link's own aperture.

    The relative variance of photons that are hardly ever received is the inverse of the gain.
    """
    analog, own = found.get("analog"), best(found)
    if not analog or "refused" in analog or own is None:
        return "–"
    gain, error = (np.array(analog["all"][key]) for key in ("mean", "stated"))
    gain_here = np.array(found["unscattered"]["link"]["mean"]) + own
    with np.errstate(divide="ignore", invalid="ignore"):
        return cell(map(number, analog["cpu"] * (error / gain / 0.01) ** 2 * gain / gain_here))


def best(found: dict[str, Any]) -> np.ndarray | None:
    """Return the gain but unscattered light by joined photons, or else by the other estimators."""
    for name, part in (("joined", "both"), ("chains", "scattered")):
        if part in found.get(name, {}):
            return np.array(found[name][part]["mean"])
    return None


def z_value(found: dict[str, Any], estimator: str, part: str, analog: str) -> str:
    """Return the difference from analog photons in standard errors, over widened apertures.

    A dash where no analog photon arrives.
    """
    entry, other = found.get(estimator, {}), found.get(analog)
    entry = entry.get("wide", entry)
    if part not in entry or not other or "all" not in other:
        return "–"
    unscattered = found["unscattered"]["wide"]
    own = np.array(entry[part]["mean"]) + np.array(unscattered["mean"])
    error = np.array(entry[part]["scatter"]) / math.sqrt(entry["seeds"])
    errors = error, np.array(unscattered["stderr"]), np.array(other["all"]["stated"])
    z = (own - np.array(other["all"]["mean"])) / np.sqrt(sum(np.square(e) for e in errors))
    texts = [f"{x:+.1f}" if abs(x) <= 3.0 else f"**{x:+.1f}**" for x in z]
    hit = np.array(other["all"]["mean"]) > 0.0
    return cell(t if h else "–" for t, h in zip(texts, hit, strict=True))


def table(head: list[str], rows: list[list[str]]) -> str:
    """Return a table of Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def link_table(found: dict[str, dict[str, Any]]) -> str:
    """Return the light of each link, its agreement, the time of each estimator, and its errors."""
    head = ["link", "scattered light", "z", "chains [s]", "joined [s]", "analog [s]", "taken"]
    rows = []
    for name, row in found.items():
        joined, chains = row.get("joined", {}), row.get("chains", {})
        times = [cell(map(number, cost(e))) if "scattered" in e else "–" for e in (chains, joined)]
        product = row.get("simulate")
        own = ["–"] * 3
        if product and "all" in product:
            own = [", ".join(product["method"]), *trust(product)]
        z = z_value(row, "joined", "both", "analog")
        rows.append([name, light(joined, "scattered"), z, *times, analog_cost(row), *own])
    return table([*head, "chi2", "bounds: hold"], rows)


def write_tables() -> None:
    """Write the table of the page."""
    write_table("estimators", link_table(load()))


def load() -> dict[str, dict[str, Any]]:
    """Return what has been measured, by link and estimator."""
    return json.loads(KEPT.read_text()) if KEPT.exists() else {}


def save(found: dict[str, dict[str, Any]]) -> None:
    """Write what has been measured, links in the order of their list."""
    rows = []
    for name in (n for n in LINKS if n in found):
        inner = [f"  {json.dumps(k)}: {json.dumps(row)}" for k, row in sorted(found[name].items())]
        rows.append(f" {json.dumps(name)}: {{\n" + ",\n".join(inner) + "\n }")
    KEPT.write_text("{\n" + ",\n".join(rows) + "\n}\n")


def chosen(wanted: list[str] | None, known: Any) -> list[str]:
    """Return the names that hold one of the wanted texts, or all."""
    return [name for name in known if wanted is None or any(text in name for text in wanted)]


def jobs_of(options: argparse.Namespace) -> Iterator[tuple[str, str]]:
    """Return the pairs of a link and an estimator that are to be measured."""
    found = load()
    estimators = options.estimators or [e for e in RUNS if e != "simulate"]
    for estimator in estimators:
        for name in chosen(options.links, LINKS):
            known = found.get(name, {}).get(estimator, {"refused": ""})
            if options.again or "refused" in known:  # a later version may follow it
                yield name, estimator


def main() -> None:
    """Measure, and write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--links", nargs="+", help="parts of the names of links")
    parser.add_argument("--estimators", nargs="+", choices=RUNS)
    parser.add_argument("--seeds", type=int, default=64)
    parser.add_argument("--seconds", type=float, default=0.25, help="CPU time of a run")
    parser.add_argument("--jobs", type=int, default=1, help="processes of one thread")
    parser.add_argument("--again", action="store_true", help="repeat what has been measured")
    options = parser.parse_args()
    with ProcessPoolExecutor(options.jobs, get_context("spawn")) as pool:
        jobs = {
            pool.submit(measure, *job, options.seeds, options.seconds): job
            for job in jobs_of(options)
        }
        for done in as_completed(jobs):
            name, estimator = jobs[done]
            found = load()
            found.setdefault(name, {})[estimator] = done.result()
            save(found)
            print(f"{name}: {estimator}: {json.dumps(done.result())}", flush=True)
    write_tables()


if __name__ == "__main__":
    main()
