"""`meshtrace compare`: the gains of several link files and their differences."""

from __future__ import annotations

from pathlib import Path

import typer
from typer import Argument, Option

from meshtrace.cli.app import app
from meshtrace.cli.console import over_seas, scenario_of
from meshtrace.cli.drawing import check_plot, draw
from meshtrace.cli.options import SERIES_CHAINS, Chains, Output, Plot, Seed, Settings, Threads, Wind
from meshtrace.cli.outputs import check_output, save
from meshtrace.errors import Refused


@app.command("compare")
def compare_command(
    links: list[Path] = Argument(metavar="A.TOML B.TOML ...", help="Two link files or more."),
    realizations: int = Option(
        1, "-n", "--realizations", min=1, max=10**7, help="Independent seas."
    ),
    output: Output = None,
    plot: Plot = None,
    photons: Chains = SERIES_CHAINS,
    seed: Seed = None,
    threads: Threads = None,
    wind: Wind = None,
    settings: Settings = None,
) -> None:
    """Compare the gains of links over common seas with common chains.

    The error of a difference is smaller than those of the gains: their common noise cancels.
    """
    from meshtrace.studies.comparison import compare

    run = {"photons": photons, "seed": seed, "threads": threads}
    scenarios = {path.stem: scenario_of(path, settings, wind, **run) for path in links}
    if len(scenarios) < len(links):
        raise Refused("links", ", ".join(map(str, links)), "files of different names")
    check_output(output, *links)
    check_plot(plot, *links, output)
    with over_seas(realizations * len(links)) as step:
        found = compare(scenarios, realizations=realizations, progress=step)
    typer.echo(found.summary())
    save(found, output)
    draw(found, plot)
