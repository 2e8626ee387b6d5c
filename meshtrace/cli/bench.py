"""`meshtrace bench`: the speed of the engine."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from meshtrace.cli.app import app
from meshtrace.cli.console import scenario_of
from meshtrace.files import atomic, check_writable


@app.command()
def bench(
    link: Annotated[
        Path | None,
        typer.Argument(
            metavar="[LINK.TOML]", help="Link file; the paper's link at 13 m/s if none."
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write the measurements as JSON.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the measurements as JSON.")
    ] = False,
    quick: Annotated[bool, typer.Option("--quick", help="A quarter of the photons.")] = False,
) -> None:
    """Measure the speed of the engine, as ratios within one run."""
    from meshtrace.bench import bench as measure
    from meshtrace.bench import report

    if output is not None:
        check_writable(output, [link])
    scenario = scenario_of(link, ["wind_speed=13", "bubbles=none"] if link is None else [], {})
    result = measure(scenario, quick=quick)
    text = json.dumps(result, indent=1)
    typer.echo(text if as_json else report(result))
    if output is not None:
        with atomic(output) as temporary:
            temporary.write_text(text + "\n", encoding="utf-8")
