"""`meshtrace bench`: the speed of the engine."""

from __future__ import annotations

import json
from pathlib import Path

import typer
from typer import Argument, Option

from meshtrace.cli.app import app
from meshtrace.cli.console import scenario_of
from meshtrace.cli.options import Trust
from meshtrace.cli.outputs import check_output
from meshtrace.files import atomic


@app.command()
def bench(
    link: Path | None = Argument(
        None, metavar="[LINK.TOML]", help="Link file; default: the link of the paper at 13 m/s."
    ),
    output: Path | None = Option(None, "--output", "-o", help="Write the measurements as JSON."),
    as_json: bool = Option(False, "--json", help="Print the measurements as JSON."),
    quick: bool = Option(False, "--quick", help="Use a quarter of the photons."),
    cold: bool = Option(False, "--cold", help="Also measure a first run, which compiles."),
    trust: Trust = False,
) -> None:
    """Measure the speed of the engine, as ratios within one run."""
    from meshtrace.bench import bench as measure
    from meshtrace.bench import report

    check_output(output, link)
    changes = ["wind_speed=13", "bubbles=none"] if link is None else []
    scenario = scenario_of(link, changes, trust=trust)
    result = measure(scenario, quick=quick, cold=cold)
    text = json.dumps(result, indent=1)
    typer.echo(text if as_json else report(result))
    if output is not None:
        with atomic(output) as temporary:
            temporary.write_text(text + "\n", encoding="utf-8")
