"""Pictures of results, written by commands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from meshtrace.cli.console import extra
from meshtrace.cli.options import Output, Plot
from meshtrace.cli.outputs import check_output, save
from meshtrace.errors import Refused
from meshtrace.files import atomic


def check_plot(path: Path | None, *inputs: Path | None, option: str = "--plot") -> None:
    """Refuse a picture that could not be written, before anything is computed."""
    if path is None:
        return
    check_output(path, *inputs, option=option)
    with extra(option, "viz"):
        from matplotlib.figure import Figure
    kinds = Figure().canvas.get_supported_filetypes()
    if path.suffix[1:].lower() not in kinds:
        raise Refused(option, str(path), f"a file .{', .'.join(sorted(kinds))}")


def draw(result: Any, path: Path | None) -> None:
    """Write the plot of a result, if a file is given."""
    if path is None:
        return
    with extra("plot", "viz"):
        import matplotlib

        matplotlib.use("agg")
        import matplotlib.pyplot as plt

        from meshtrace.viz import plot, use_style
    use_style()
    plot(result)
    with atomic(path) as temporary:
        plt.savefig(temporary)
    plt.close()
    typer.echo(f"\nwritten to {path}")


@dataclass(frozen=True)
class Written:
    """File and picture of a result."""

    output: Output = None
    plot: Plot = None

    def check(self, link: Path | None) -> None:
        """Check before the work that both can be written."""
        check_output(self.output, link)
        check_plot(self.plot, link, self.output)

    def write(self, result: Any) -> None:
        """Print a result and write it."""
        typer.echo(result.summary())
        save(result, self.output)
        draw(result, self.plot)
