"""`meshtrace series` and `meshtrace ensemble`: gains over many seas."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from meshtrace.cli.app import app
from meshtrace.cli.console import (
    numbers,
    over_seas,
    scenario_of,
    warnings_as_lines,
)
from meshtrace.cli.options import SERIES_CHAINS, Chains, LinkFile, Output, Seed, Settings, Threads
from meshtrace.files import check_writable

if TYPE_CHECKING:
    from meshtrace.results.series import GainSeries


@app.command()
def series(
    link: LinkFile = None,
    times: Annotated[
        str, typer.Option(metavar="START:STOP:STEP", help="Times [s], or a list as in 0,1,2.")
    ] = "0:30:0.5",
    output: Output = None,
    photons: Chains = SERIES_CHAINS,
    seed: Seed = None,
    threads: Threads = None,
    settings: Settings = None,
) -> None:
    """Follow the channel gain over a moving sea and print its fading."""
    seconds = numbers("--times", times)
    options = {"photons": photons, "seed": seed, "threads": threads}
    scenario = scenario_of(link, settings or [], options)
    _print_series(link, len(seconds), output, lambda step: scenario.time_series(seconds, step))


@app.command()
def ensemble(
    link: LinkFile = None,
    realizations: Annotated[
        int, typer.Option("--realizations", "-n", min=2, max=10**7, help="Independent seas.")
    ] = 200,
    output: Output = None,
    photons: Chains = SERIES_CHAINS,
    seed: Seed = None,
    threads: Threads = None,
    settings: Settings = None,
) -> None:
    """Print the distribution of the channel gain over random seas, and its fading."""
    options = {"photons": photons, "seed": seed, "threads": threads}
    scenario = scenario_of(link, settings or [], options)
    _print_series(link, realizations, output, lambda step: scenario.ensemble(realizations, step))


def _print_series(
    link: Path | None,
    seas: int,
    output: Path | None,
    evaluate: Callable[[Callable[[int], None]], GainSeries],
) -> None:
    """Compute gains over many seas, print their fading, and write them."""
    if output is not None:
        check_writable(output, [link])
    with warnings_as_lines(), over_seas(seas, quiet=False) as step:
        gains = evaluate(step)
    typer.echo(gains.summary())
    if output is not None:
        gains.save(output)
        typer.echo(f"\nwritten to {output}")
