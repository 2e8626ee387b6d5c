"""`meshtrace validate`: the engine against closed forms and published tables."""

from __future__ import annotations

import json
from itertools import count

import typer
from typer import Option

from meshtrace.cli.app import app
from meshtrace.cli.console import finite, progress
from meshtrace.cli.options import AsJson


@app.command()
def validate(
    quick: bool = Option(
        False, "--quick", help="Use a twentieth of the photons: less than a minute."
    ),
    as_json: AsJson = False,
) -> None:
    """Check the engine against closed forms, published tables and its other estimator.

    Without a standard error, z is the deviation divided by the stated tolerance. The exit code is
    1 if any |z| exceeds 4.
    """
    from meshtrace.validation import LIMIT, SUITE, format_table
    from meshtrace.validation import validate as run_checks

    with progress(len(SUITE), as_json, "checking", "forced", "analog") as (say, advance):
        done = count()

        def step(name: str) -> None:
            if next(done):
                advance(1)
            say(name)

        checks = run_checks(quick, step)
    failed = sum(not check.passed for check in checks)
    if as_json:
        rows = [finite(check.as_data()) for check in checks]
        typer.echo(json.dumps({"limit": LIMIT, "failed": failed, "checks": rows}, allow_nan=False))
    else:
        typer.echo(
            f"{format_table(checks)}\n\n{len(checks)} checks, {failed} beyond |z| = {LIMIT:g}. "
            "z = (got - expected) / hypot(std. error, tolerance);\nchecks without a standard error "
            "are deterministic, and z is relative to the tolerance alone."
        )
    if failed:
        raise typer.Exit(1)
