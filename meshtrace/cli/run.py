"""`meshtrace run`: the gain of one link and the fates of its light."""

from __future__ import annotations

import json
import time
import warnings
from typing import TYPE_CHECKING, Any

import typer
from typer import Option

from meshtrace.cli.app import app
from meshtrace.cli.console import COMPILING, finite, kernels_are_compiled, progress
from meshtrace.cli.made import grouped
from meshtrace.cli.options import AsJson, Case, LinkFile, Output
from meshtrace.cli.outputs import check_output, save

if TYPE_CHECKING:
    from meshtrace.results.gain import GainResult
    from meshtrace.scenario import Scenario


@app.command()
@grouped
def run(
    *,
    link: LinkFile = None,
    output: Output = None,
    as_json: AsJson = False,
    photons: str | None = Option(None, metavar="N", help="Chains (forced) or photons (analog)."),
    rtol: str | None = Option(
        None, metavar="R", help="Target for the relative standard error, such as 0.01."
    ),
    estimator: str | None = Option(None, metavar="NAME", help="forced or analog."),
    case: Case,
    verbose: bool = Option(False, "--verbose", "-v", help="Print samples and chains, too."),
) -> None:
    """Simulate one link and print its channel gain."""
    # words as yet, for the link file's own checks
    options = {"run.photons": photons, "run.rtol": rtol, "run.estimator": estimator}
    scenario = case.scenario(link, options)
    check_output(output, link)
    result, wall_time = _simulate(scenario, quiet=as_json)
    data = _plain(result, wall_time) if as_json else None
    text = result.summary(wall_time, verbose) if data is None else json.dumps(data, allow_nan=False)
    typer.echo(text)
    save(result, output, as_json)


def _simulate(scenario: Scenario, quiet: bool) -> tuple[GainResult, float]:
    """Return the result of a scenario and its wall time [s], compiling beforehand if need be."""
    known = scenario.run.photons if scenario.run.rtol is None else None
    with progress(known, quiet, "following photons") as (say, advance):
        if not kernels_are_compiled(scenario.run.estimator.kind):
            scenario.mesh()  # reports a wrong link before the kernels compile
            from meshtrace.cli.ahead import compiling_ahead

            say(COMPILING)
            with warnings.catch_warnings(), compiling_ahead(scenario):
                warnings.simplefilter("ignore")
                # in this thread: others end their compilation before Ctrl-C ends them
                few = {"photons": min(scenario.run.photons, 64), "rtol": None, "threads": 1}
                short = scenario.run.model_copy(update=few)
                scenario.model_copy(update={"run": short}).simulate()
        start = time.perf_counter()
        result = scenario.simulate(advance)
        return result, time.perf_counter() - start


_GAINS = (
    *("gain", "gain_stderr", "gain_db", "gain_bound", "gain_ballistic", "gain_scattered"),
    "mesh_error",
)


def _plain(result: GainResult, wall_time: float) -> dict[str, Any]:
    """Return a result as plain data for JSON, with null for non-finite values."""
    return {
        **{name: finite(getattr(result, name)) for name in _GAINS},
        "photons": result.photons,
        "photons_per_second": result.photons / wall_time,
        "wall_time": wall_time,
        "fates": {name: tally._asdict() for name, tally in result.fates.items()},
        "chains": result.chains,
        "scattered": [row._asdict() for row in result.scattered],
        "misses": {"cast_again": result.misses[0], "given_up": result.misses[1]},
        "provenance": result.provenance,
    }
