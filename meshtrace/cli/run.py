"""`meshtrace run`: one link, its gain, and what became of the light."""

from __future__ import annotations

import json
import math
import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from meshtrace.cli.app import app
from meshtrace.cli.console import (
    COMPILING,
    finite,
    kernels_are_compiled,
    progress,
    refuse_unwritable,
    scenario_of,
    warnings_as_lines,
)
from meshtrace.cli.options import AsJson, LinkFile, Output, Seed, Settings, Threads

if TYPE_CHECKING:
    from meshtrace.results.gain import GainResult
    from meshtrace.scenario import Scenario

CHAIN_MEANING = {
    "chains": "scattering chains drawn",
    "solved": "aimed at the aperture",
    "no_flat": "without a crossing of the flat sea",
    "enumerated": "searched through all facets",
    "extra_roots": "further crossings found",
    "blocked": "blocked by a wave",
}


@app.command()
def run(
    link: LinkFile = None,
    output: Output = None,
    as_json: AsJson = False,
    photons: Annotated[
        str | None, typer.Option(metavar="N", help="Chains (forced) or photons (analog).")
    ] = None,
    rtol: Annotated[
        str | None, typer.Option(metavar="R", help="Relative standard error to reach, as in 0.01.")
    ] = None,
    seed: Seed = None,
    estimator: Annotated[str | None, typer.Option(metavar="NAME", help="forced or analog.")] = None,
    threads: Threads = None,
    settings: Settings = None,
) -> None:
    """Simulate one link and print its channel gain."""
    # words as yet, for the link file's own checks
    options = {
        "photons": photons,
        "rtol": rtol,
        "seed": seed,
        "estimator": estimator,
        "threads": threads,
    }
    scenario = scenario_of(link, settings or [], options)
    if output is not None:
        refuse_unwritable(output)
    with warnings_as_lines():
        result, wall_time = _simulate(scenario, quiet=as_json)
    if output is not None:
        result.save(output)
    if as_json:
        typer.echo(json.dumps(_as_data(result, wall_time), allow_nan=False))
    else:
        typer.echo(_summary(scenario, result, wall_time, output))


def _simulate(scenario: Scenario, quiet: bool) -> tuple[GainResult, float]:
    """Return the result of a scenario and its wall time [s], compiling beforehand if need be."""
    known = scenario.run.photons if scenario.run.rtol is None else None
    with progress(known, quiet) as (say, advance):
        if not kernels_are_compiled(scenario.run.estimator):
            scenario.mesh()  # so that a wrong link is told without waiting for the compiler
            say(COMPILING)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                single = scenario.run.model_copy(update={"photons": 1, "rtol": None})
                scenario.model_copy(update={"run": single}).simulate()
        start = time.perf_counter()
        result = scenario.simulate(advance)
        return result, time.perf_counter() - start


def _as_data(result: GainResult, wall_time: float) -> dict[str, Any]:
    """Return a result as plain data for JSON, with null for what is not finite."""
    return {
        "gain": finite(result.gain),
        "gain_stderr": finite(result.gain_stderr),
        "gain_db": finite(result.gain_db),
        "gain_ballistic": finite(result.gain_ballistic),
        "gain_scattered": finite(result.gain_scattered),
        "photons": result.photons,
        "photons_per_second": result.photons / wall_time,
        "wall_time": wall_time,
        "fates": {name: tally._asdict() for name, tally in result.fates.items()},
        "chains": result.chains,
        "misses": {"cast_again": result.misses[0], "given_up": result.misses[1]},
        "provenance": result.provenance,
    }


def _summary(scenario: Scenario, result: GainResult, wall_time: float, output: Path | None) -> str:
    """Return a result as text."""
    sea, forced = result.provenance["surface"]["kind"], scenario.run.estimator == "forced"
    rate = result.photons / wall_time
    lines = [
        f"{scenario.run.estimator} estimator, {sea} sea, wind {scenario.wind_speed:g} m/s",
        "",
        *_gain_lines(result),
        _line(
            "chains" if forced else "photons",
            f"{result.photons:,} in {wall_time:.2f} s, {rate:,.0f} per second",
        ),
    ]
    if result.fates:
        cast, lost = result.misses
        lines.append(_line("misses", f"{cast:,} rays cast again, {lost:,} given up"))
        lines += ["", *_fate_lines(result)]
    if result.chains:
        lines += ["", *_chain_lines(result)]
    if output is not None:
        lines += ["", f"written to {output}"]
    return "\n".join(lines)


def _line(name: str, text: str) -> str:
    return f"{name:<18}{text}"


def _gain_lines(result: GainResult) -> list[str]:
    """Return gain and standard error of each receiver."""
    import numpy as np

    gains, errors = np.atleast_1d(result.gain), np.atleast_1d(result.gain_stderr)
    direct = None if result.gain_ballistic is None else np.atleast_1d(result.gain_ballistic)
    lines = []
    for i, (gain, stderr) in enumerate(zip(gains, errors, strict=True)):
        name = "channel gain" if np.ndim(result.gain) == 0 else f"channel gain [{i}]"
        if not gain > 0.0:
            # 3 / n: what is seen in none of n trials has, at 95 %, at most this probability
            bound = f", below {3.0 / result.photons:.2g} at 95 % confidence" if result.fates else ""
            lines.append(_line(name, f"0: no light received{bound}"))
            continue
        decibel = 10.0 / math.log(10.0) * stderr / gain
        percent = 100.0 * stderr / gain
        lines.append(_line(name, f"{gain:.4e}  ({10.0 * math.log10(gain):.3f} dB optical)"))
        lines.append(_line("standard error", f"{stderr:.1e}  ({percent:.2g} %, {decibel:.2g} dB)"))
        if direct is not None:
            scattered = 100.0 * (1.0 - direct[i] / gain)
            lines.append(_line("", f"{direct[i]:.4e} unscattered; scattered {scattered:.1f} %"))
    return lines


def _fate_lines(result: GainResult) -> list[str]:
    """Return what became of the photons, as a table."""
    from meshtrace.results.gain import FATE_MEANING, Fate

    lines = [f"{'fate':<12}{'photons':>15}{'weight %':>12}  meaning"]
    for name, tally in result.fates.items():
        meaning = FATE_MEANING[Fate[name.upper()]]
        lines.append(f"{name:<12}{tally.photons:>15,}{100.0 * tally.weight:>12.4g}  {meaning}")
    return lines


def _chain_lines(result: GainResult) -> list[str]:
    """Return what became of the scattering chains, as a table."""
    lines = [f"{'chains':<12}{'number':>15}  meaning"]
    for name, number in result.chains.items():
        lines.append(f"{name:<12}{number:>15,}  {CHAIN_MEANING.get(name, name)}")
    return lines
