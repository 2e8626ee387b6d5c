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
    refuse_unwritable,
    scenario_of,
    warnings_as_lines,
)
from meshtrace.cli.options import SERIES_CHAINS, Chains, LinkFile, Output, Seed, Settings, Threads

if TYPE_CHECKING:
    from meshtrace.scenario import Scenario
    from meshtrace.studies.series import GainSeries

_FEW = 50  # gains that are printed where no statistics can be


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
    _fading_of(scenario, len(seconds), output, lambda step: scenario.time_series(seconds, step))


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
    _fading_of(scenario, realizations, output, lambda step: scenario.ensemble(realizations, step))


def _fading_of(
    scenario: Scenario,
    seas: int,
    output: Path | None,
    evaluate: Callable[[Callable[[int], None]], GainSeries],
) -> None:
    """Compute gains over many seas, write them, and print their fading."""
    import numpy as np

    if output is not None:
        refuse_unwritable(output)
    with warnings_as_lines(), over_seas(seas, quiet=False) as step:
        gains = evaluate(step)
    if output is not None:
        gains.save(output)
    for receiver, gain in enumerate(np.atleast_2d(gains.gain.T)):
        if gains.gain.ndim == 2:
            typer.echo(f"receiver {receiver}")
        if gains.along == "realization":
            shares = (1, 5, 25, 50, 75, 95, 99)
            quantiles = np.percentile(gain, shares)
            typer.echo("".join(f"{f'{share} %':>12}" for share in shares))
            typer.echo("".join(f"{value:>12.4e}" for value in quantiles) + "\n")
        typer.echo(_statistics(gains, receiver))
        if gain.any():
            error = np.atleast_1d(gains.mean_stderr)[receiver] / gain.mean()
            typer.echo(f"  chains               mean gain +- {100.0 * error:.2g} %")
    if output is not None:
        typer.echo(f"\nwritten to {output}")


def _statistics(gains: GainSeries, receiver: int) -> str:
    """Return the fading of a receiver as text, or the few gains that have no such statistics."""
    try:
        return gains.fading(receiver).summary()
    except ValueError as error:
        lines = []
        if gains.along == "time":
            gain = gains.gain.reshape(len(gains.gain), -1)[:_FEW, receiver]
            lines = [f"  {t:>12g} s {g:.4e}" for t, g in zip(gains.time, gain, strict=False)]
        return "\n".join([*lines, f"no fading statistics: {error}"])
