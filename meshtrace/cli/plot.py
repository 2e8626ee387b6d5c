"""`meshtrace plot`: the picture of a result file."""

from __future__ import annotations

from pathlib import Path

from typer import Argument, Option

from meshtrace.cli.app import app
from meshtrace.cli.console import extra
from meshtrace.cli.outputs import check_plot, draw


@app.command("plot")
def plot_command(
    file: Path = Argument(
        metavar="RESULT", help="Result of any command (.nc), or the store of a sweep (.zarr)."
    ),
    output: Path | None = Option(
        None, "--output", "-o", metavar="A.PNG", help="Picture; default: RESULT.png."
    ),
) -> None:
    """Draw a result file."""
    path = file.with_suffix(".png") if output is None else output
    check_plot(path, file, option="--output")
    draw(_content(file), path)


def _content(file: Path) -> object:
    """Return a result, or the dataset of a sweep."""
    from meshtrace.stored import load, read_dataset

    if file.is_dir():
        with extra("plot", "batch"):
            from meshtrace.studies.sweep.store import read_store

            return read_store(file)
    data = read_dataset(file)
    return data if data.attrs.get("kind") == "sweep" else load(file)
