"""`meshtrace plot`: the picture of a result file."""

from __future__ import annotations

from pathlib import Path

from typer import Argument, Option

from meshtrace.cli.app import app
from meshtrace.cli.outputs import check_plot, draw


@app.command("plot")
def plot_command(
    file: Path = Argument(metavar="RESULT.NC", help="Result of any command."),
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

    data = read_dataset(file)
    is_sweep = data.attrs.get("kind") is None and {"gain", "seconds"} <= set(data.data_vars)
    return data if is_sweep else load(file)
