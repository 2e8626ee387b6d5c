"""Files and pictures of results: checks before the work, and writing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from meshtrace.cli.console import extra
from meshtrace.cli.options import Output, Plot
from meshtrace.errors import Refused, require_writable
from meshtrace.files import atomic

if TYPE_CHECKING:
    from meshtrace.stored import Stored


def check_output(output: Path | None, *inputs: Path | None, option: str = "--output") -> None:
    """Check before the work that an optional output file can be written.

    It replaces no link file, nor a mesh or spectrum that a link file names.
    """
    if output is None:
        return
    named = (file for link in inputs if link is not None for file in _named_files(link))
    require_writable(output, [*inputs, *named], option)
    if output.suffix.lower() == ".toml":
        raise Refused(option, str(output), "no name of a link file")


def _named_files(link: Path) -> Iterator[Path]:
    """Yield a path for each text in a link file; those of its files are among them."""
    from meshtrace.scenario.files import parse_toml, read_text

    def texts(part: Any) -> Iterator[str]:
        if isinstance(part, str):
            yield part
        elif isinstance(part, dict | list):
            for item in part.values() if isinstance(part, dict) else part:
                yield from texts(item)

    with suppress(Refused):  # no link file
        yield from (link.parent / text for text in texts(parse_toml(read_text(link))))


def save(result: Stored, output: Path | None, quiet: bool = False) -> None:
    """Write a result to a file, after the text on the console."""
    if output is not None:
        result.save(output)
        if not quiet:
            typer.echo(f"\nwritten to {output}")


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

    def check(self, *inputs: Path | None) -> None:
        """Check before the work that both can be written."""
        check_output(self.output, *inputs)
        check_plot(self.plot, *inputs, self.output)

    def write(self, result: Stored) -> None:
        """Print a result and write it."""
        typer.echo(result.summary())
        save(result, self.output)
        draw(result, self.plot)
