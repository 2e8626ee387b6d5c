"""`meshtrace validate`: the engine against closed forms and published tables."""

from __future__ import annotations

import json
from itertools import count

import typer
from typer import Option

from meshtrace.cli.app import app
from meshtrace.cli.console import finite, progress
from meshtrace.cli.options import AsJson
from meshtrace.errors import require_word


@app.command()
def validate(
    quick: bool = Option(
        False, "--quick", help="Use a twentieth of the photons: less than a minute."
    ),
    case: str | None = Option(
        None, metavar="NAME", help="Run one reference case instead of the suite: w2a1."
    ),
    as_json: AsJson = False,
) -> None:
    """Check the engine against closed forms, published tables and its other estimator.

    Without a standard error, z is the deviation divided by the stated tolerance. The exit code is
    1 if any |z| exceeds 4.
    """
    from meshtrace.validation import LIMIT, SUITE, format_table, w2a1
    from meshtrace.validation import validate as run_checks

    if case is not None:
        require_word(case, ("w2a1",), "--case")
    with progress(
        len(SUITE) if case is None else w2a1.STEPS, as_json, "checking", "forced", "analog"
    ) as (say, advance):
        done = count()

        def step(name: str) -> None:
            if next(done):
                advance(1)
            say(name)

        checks = run_checks(quick, step) if case is None else tuple(w2a1.checks(quick, step))
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
        if case is not None:
            typer.echo(f"Score by the rules of the case: {w2a1.score(checks)} of {len(checks)}.")
    if failed:
        raise typer.Exit(1)
