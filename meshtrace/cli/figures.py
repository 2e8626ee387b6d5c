"""`meshtrace figures`: redraw the figures of the paper."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer
from typer import Option

from meshtrace.cli.app import app
from meshtrace.cli.console import extra
from meshtrace.errors import Refused


@app.command()
def figures(
    output: Path = Option(
        Path("figures"), "--output", "-o", metavar="FOLDER", help="Folder of the figures."
    ),
    only: list[str] | None = Option(
        None, metavar="NAME", help="Draw this figure only; repeatable. Names: see --list."
    ),
    quick: bool = Option(False, "--quick", help="Fewer photons and seas: minutes for all figures."),
    profiles: list[Path] | None = Option(
        None, metavar="A.NC", help="Temperature and salinity (AODN, Argo); repeatable."
    ),
    names: bool = Option(False, "--list", help="List the names of the figures."),
    seed: int = Option(1, metavar="N", min=0, help="Seed of the random numbers."),
    threads: int | None = Option(
        None, metavar="N", min=1, max=1024, help="Number of threads; default: all cores."
    ),
) -> None:
    """Redraw the figures of the paper, with data, tables and an index page.

    Finished figures are kept; an interrupted run resumes.
    """
    from meshtrace.paper.records import INDEX
    from meshtrace.paper.registry import FIGURES, Setting
    from meshtrace.paper.runner import make_figures

    if names:
        typer.echo("\n".join(FIGURES))
        return
    if output.exists() and not output.is_dir():
        raise Refused("--output", str(output), "a folder")
    setting = Setting(seed=seed, threads=threads, profiles=tuple(profiles or ()))
    try:
        with extra("viz", "viz"):
            made = make_figures(output, only, quick=quick, setting=setting, on_figure=_report)
    except OSError as error:
        raise Refused("--output", error, "a folder to write to") from error
    kept = sum(record["kept"] for record in made)
    typer.echo(f"{len(made) - kept} drawn, {kept} kept; read {output / INDEX}")


def _report(name: str, record: dict[str, Any] | None) -> None:
    """Report the progress on stderr."""
    state = " ..."
    if record is not None:
        state = ": kept" if record["kept"] else f": {record['wall_s']:.1f} s"
    typer.echo(f"{name}{state}", err=True)
