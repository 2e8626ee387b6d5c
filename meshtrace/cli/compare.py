"""`meshtrace compare`: the gains of several link files and their differences."""

from __future__ import annotations

from pathlib import Path

from typer import Argument, Option

from meshtrace.cli.app import app
from meshtrace.cli.console import over_seas
from meshtrace.cli.options import SERIES_CHAINS, Case, Chains, grouped
from meshtrace.cli.outputs import Written
from meshtrace.errors import Refused


@app.command("compare")
@grouped
def compare_command(
    *,
    links: list[Path] = Argument(metavar="A.TOML B.TOML ...", help="Two link files or more."),
    realizations: int = Option(
        1, "-n", "--realizations", min=1, max=10**7, help="Independent seas."
    ),
    written: Written,
    photons: Chains = SERIES_CHAINS,
    case: Case,
) -> None:
    """Compare the gains of links over common seas with common chains.

    The error of a difference is smaller than those of the gains: their common noise cancels.
    """
    from meshtrace.studies.comparison import compare

    scenarios = {path.stem: case.scenario(path, photons=photons) for path in links}
    if len(scenarios) < len(links):
        raise Refused("links", ", ".join(map(str, links)), "files of different names")
    written.check(*links)
    with over_seas(realizations * len(links)) as step:
        found = compare(scenarios, realizations=realizations, progress=step)
    written.write(found)
