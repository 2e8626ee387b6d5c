"""`meshtrace sensitivity`: derivatives of a link's gain, error rate, outage, range or margin."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from typer import Option

from meshtrace.cli.app import app
from meshtrace.cli.console import progress
from meshtrace.cli.options import Case, LinkFile, grouped
from meshtrace.cli.outputs import Written


@app.command("sensitivity")
@grouped
def sensitivity_command(
    *,
    link: LinkFile = None,
    wrt: list[str] | None = Option(
        None, "--wrt", metavar="KEY", help="Parameter, such as water.a; repeatable; default: all."
    ),
    of: str = Option("gain", metavar="WORD", help="gain, ber, outage, range or margin."),
    realizations: int = Option(1, "-n", "--realizations", min=1, help="Independent seas."),
    limit: float = Option(1e-3, metavar="BER", help="Largest bit error rate of a working link."),
    step: float | None = Option(None, metavar="S", help="Step of the differences, relative."),
    resume: Path | None = Option(
        None, metavar="FOLDER", help="Keep finished parameters here, to resume a stopped run."
    ),
    written: Written,
    photons: str = Option("8192", metavar="N", help="Chains, common to all evaluations."),
    case: Case,
) -> None:
    """Print the sensitivity of a link to its parameters, with standard errors.

    An elasticity is the change in per cent for 1 % more of the parameter. All evaluations share
    their chains and seas.
    """
    from meshtrace.studies.sensitivity import sensitivities

    scenario = case.scenario(link, photons=photons)
    written.check(link)
    asked: Any = {"of": of, "realizations": realizations, "limit": limit, "step": step}
    with progress(len(wrt or []) or None, False, "parameters", "forced") as (_, advance):
        found = sensitivities(scenario, wrt=wrt, resume=resume, progress=advance, **asked)
    written.write(found)
