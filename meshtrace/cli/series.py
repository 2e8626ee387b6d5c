"""`meshtrace series` and `meshtrace ensemble`: gains over many seas."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import typer
from typer import Option

from meshtrace.cli.app import app
from meshtrace.cli.console import numbers, over_seas
from meshtrace.cli.options import SERIES_CHAINS, Case, Chains, LinkFile, Output, grouped
from meshtrace.cli.outputs import check_output, save

if TYPE_CHECKING:
    from meshtrace.results.series import GainSeries


@app.command()
@grouped
def series(
    *,
    link: LinkFile = None,
    times: str = Option(
        "0:10:0.05", metavar="START:STOP:STEP", help="Times [s], or a list such as 0,1,2."
    ),
    output: Output = None,
    photons: Chains = SERIES_CHAINS,
    case: Case,
) -> None:
    """Compute the channel gain over a moving sea and print its fading statistics."""
    from meshtrace.studies.series import time_series

    at = numbers("--times", times)
    scenario = case.scenario(link, photons=photons)
    _report(link, len(at), output, lambda step: time_series(scenario, times=at, progress=step))


@app.command("ensemble")
@grouped
def ensemble_command(
    *,
    link: LinkFile = None,
    n: int = Option(200, "-n", "--realizations", min=2, max=10**7, help="Independent seas."),
    output: Output = None,
    photons: Chains = SERIES_CHAINS,
    case: Case,
) -> None:
    """Compute the channel gain over random seas and print its distribution and fading."""
    from meshtrace.studies.series import ensemble

    scenario = case.scenario(link, photons=photons)
    _report(link, n, output, lambda step: ensemble(scenario, n, progress=step))


def _report(
    link: Path | None,
    seas: int,
    output: Path | None,
    evaluate: Callable[[Callable[[int], None]], GainSeries],
) -> None:
    """Compute gains over many seas, print their fading, and write them."""
    check_output(output, link)
    with over_seas(seas) as step:
        gains = evaluate(step)
    typer.echo(gains.summary())
    save(gains, output)
