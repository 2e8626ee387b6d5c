"""`meshtrace figures`: every figure of the paper, redrawn."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from meshtrace.cli.app import app
from meshtrace.cli.console import warnings_as_lines
from meshtrace.errors import Described, Refused


@app.command()
def figures(
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FOLDER", help="Where the figures go.")
    ] = Path("figures"),
    only: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="This figure alone; may be repeated. See --list."),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer photons and seas: all figures in minutes.")
    ] = False,
    profiles: Annotated[
        list[Path] | None,
        typer.Option(metavar="A.NC", help="Temperature and salinity (AODN, Argo); may repeat."),
    ] = None,
    names: Annotated[bool, typer.Option("--list", help="List the names of the figures.")] = False,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Key of the random numbers.")] = 1,
    threads: Annotated[
        int | None, typer.Option(metavar="N", min=1, max=1024, help="Threads; all cores if none.")
    ] = None,
) -> None:
    """Redraw the paper's figures, with data, tables and one page to read through.

    Figures that are there already are kept; an interrupted run goes on where it was.
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
        with warnings_as_lines():
            made = make_figures(output, only, quick=quick, setting=setting, on_figure=_tell)
    except ImportError as error:  # the viz extra is not there
        allowed = 'pip install "meshtrace[viz]"'
        raise Refused("viz", Described("extra packages are missing"), allowed) from error
    except OSError as error:
        raise Refused("--output", error, "a folder to write to") from error
    kept = sum(record["kept"] for record in made)
    typer.echo(f"{len(made) - kept} drawn, {kept} kept; read {output / INDEX}")


def _tell(name: str, record: dict[str, Any] | None) -> None:
    """Report the progress on stderr."""
    if record is None:
        typer.echo(f"{name} ...", err=True)
    elif record["kept"]:
        typer.echo(f"{name}: kept", err=True)
    else:
        typer.echo(f"{name}: {record['wall_s']:.1f} s", err=True)
