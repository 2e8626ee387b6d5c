"""`meshtrace validate`: the engine against closed forms and published tables."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from meshtrace.cli.app import app
from meshtrace.cli.console import COMPILING, finite, kernels_are_compiled, progress
from meshtrace.cli.options import AsJson


@app.command()
def validate(
    quick: Annotated[
        bool, typer.Option("--quick", help="A twentieth of the photons: under a minute.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Check the engine against closed forms, published tables and its other estimator.

    Where there is no standard error, z is the deviation over the stated tolerance. The exit code
    is 1 if any |z| is above 4.
    """
    from meshtrace.validation import LIMIT, SUITE, format_table
    from meshtrace.validation import validate as run_checks

    with progress(len(SUITE), as_json, "checking") as (say, advance):
        if not all(kernels_are_compiled(name) for name in ("forced", "analog")):
            say(COMPILING)
        started: list[str] = []

        def step(name: str) -> None:
            if started:
                advance(1)
            started.append(name)
            say(name)

        checks = run_checks(quick, step)
    failed = sum(not check.passed for check in checks)
    if as_json:
        rows = [
            {key: finite(v) if isinstance(v, float) else v for key, v in check.as_data().items()}
            for check in checks
        ]
        typer.echo(json.dumps({"limit": LIMIT, "failed": failed, "checks": rows}, allow_nan=False))
    else:
        typer.echo(format_table(checks))
        typer.echo(
            f"\n{len(checks)} checks, {failed} beyond |z| = {LIMIT:g}. z = (got - expected) / "
            "hypot(std. error, tolerance);\nwithout a standard error nothing was drawn at random, "
            "and the tolerance alone is the scale."
        )
    if failed:
        raise typer.Exit(1)
