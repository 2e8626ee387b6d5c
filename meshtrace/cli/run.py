"""`meshtrace run`: the gain of one link and the fates of its light."""

from __future__ import annotations

import json
import time
import warnings
from typing import TYPE_CHECKING, Annotated, Any

import typer

from meshtrace.cli.app import app
from meshtrace.cli.console import (
    COMPILING,
    finite,
    kernels_are_compiled,
    progress,
    scenario_of,
    warnings_as_lines,
)
from meshtrace.cli.options import AsJson, LinkFile, Output, Seed, Settings, Threads
from meshtrace.files import check_writable

if TYPE_CHECKING:
    from meshtrace.results.gain import GainResult
    from meshtrace.scenario import Scenario


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
        check_writable(output, [link])
    with warnings_as_lines():
        result, wall_time = _simulate(scenario, quiet=as_json)
    if as_json:
        typer.echo(json.dumps(_as_data(result, wall_time), allow_nan=False))
    else:
        typer.echo(result.summary(wall_time))
    if output is not None:  # after the text, which must not be lost with a full disk
        result.save(output)
        if not as_json:
            typer.echo(f"\nwritten to {output}")


def _simulate(scenario: Scenario, quiet: bool) -> tuple[GainResult, float]:
    """Return the result of a scenario and its wall time [s], compiling beforehand if need be."""
    known = scenario.run.photons if scenario.run.rtol is None else None
    with progress(known, quiet) as (say, advance):
        if not kernels_are_compiled(scenario.run.estimator.kind):
            scenario.mesh()  # so that a wrong link is told without waiting for the compiler
            say(COMPILING)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                few = scenario.run.estimator.least_photons
                scenario.replace(run=scenario.run.replace(photons=few, rtol=None)).simulate()
        start = time.perf_counter()
        result = scenario.simulate(advance)
        return result, time.perf_counter() - start


def _as_data(result: GainResult, wall_time: float) -> dict[str, Any]:
    """Return a result as plain data for JSON, with null for what is not finite."""
    return {
        "gain": finite(result.gain),
        "gain_stderr": finite(result.gain_stderr),
        "gain_db": finite(result.gain_db),
        "gain_bound": finite(result.gain_bound),
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
