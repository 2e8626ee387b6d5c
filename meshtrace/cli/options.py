"""Options that several commands share, and the files and pictures of their results."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from meshtrace.cli.console import extra
from meshtrace.errors import Refused, require_writable
from meshtrace.files import atomic

if TYPE_CHECKING:
    from meshtrace.scenario import Scenario
    from meshtrace.stored import Stored

_LINK = "Link file; default: the link of the paper."
LinkFile = Annotated[Path | None, typer.Argument(metavar="[LINK.TOML]", help=_LINK)]

_KEYS = {"wind": "wind_speed", "seed": "run.seed", "threads": "run.threads"}


@dataclass(frozen=True, kw_only=True)
class Changes:
    """Options that change a link file.

    Parameters
    ----------
    set_ : KEY=VALUE
        Replace a value of the link file, such as transmitter.depth=20; repeatable.
    trust
        Run the modules that the link file names, as in module:Class.
    """

    set_: list[str] | None = None
    trust: bool = False

    def scenario(self, link: Path | None, more: Mapping[str, Any] | None = None) -> Scenario:
        """Return the scenario of a link file with these changes and further ones by key."""
        from meshtrace.scenario import Scenario, parse_setting

        own = {key: getattr(self, name, None) for name, key in _KEYS.items()}
        given = (f"{k}={v}" for k, v in {**own, **(more or {})}.items() if v is not None)
        changes = dict(parse_setting(setting) for setting in (*(self.set_ or []), *given))
        if link is None:
            return Scenario.from_toml("", changes=changes, trust=self.trust)
        return Scenario.load(link, changes, trust=self.trust)


@dataclass(frozen=True, kw_only=True)
class WindChanges(Changes):
    """Options that change a link file and its wind.

    Parameters
    ----------
    wind : U
        Wind speed at 10 m [m/s].
    """

    wind: str | None = None


@dataclass(frozen=True, kw_only=True)
class RunChanges(Changes):
    """Options that change a link file and its run.

    Parameters
    ----------
    seed : N
        Seed of the random numbers.
    threads : N
        Number of threads; default: all cores.
    """

    seed: str | None = None
    threads: str | None = None


@dataclass(frozen=True, kw_only=True)
class AllChanges(RunChanges, WindChanges):
    """Options that change a link file, its wind and its run."""


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
    """Yield every text of a link file as a possible path; its files are among them."""
    from meshtrace.scenario.files import parse_toml, read_text

    def texts(part: Any) -> Iterator[str]:
        if isinstance(part, str):
            yield part
        elif isinstance(part, dict | list):
            for item in part.values() if isinstance(part, dict) else part:
                yield from texts(item)

    with suppress(Refused):  # no link file
        yield from (link.parent / text for text in texts(parse_toml(read_text(link))))


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


@dataclass(frozen=True, kw_only=True)
class FileOptions:
    """File of a result.

    Parameters
    ----------
    output
        Write the result as netCDF.
    """

    output: Path | None = None

    def check(self, *inputs: Path | None) -> None:
        """Check before the work that the files can be written."""
        check_output(self.output, *inputs)

    def save(self, result: Stored, quiet: bool = False) -> None:
        """Write a result to the file, after the text on the console."""
        if self.output is not None:
            result.save(self.output)
            if not quiet:
                typer.echo(f"\nwritten to {self.output}")


@dataclass(frozen=True, kw_only=True)
class PrintOptions(FileOptions):
    """File of a result, and the format on the console.

    Parameters
    ----------
    json_
        Print the result as JSON, without progress bar.
    """

    json_: bool = False


@dataclass(frozen=True, kw_only=True)
class PlotOptions(FileOptions):
    """File and picture of a result.

    Parameters
    ----------
    plot : A.PNG
        Draw the result.
    """

    plot: Path | None = None

    def check(self, *inputs: Path | None) -> None:
        """Check before the work that both can be written."""
        super().check(*inputs)
        check_plot(self.plot, *inputs, self.output)

    def write(self, result: Stored) -> None:
        """Print a result and write it."""
        typer.echo(result.summary())
        self.save(result)
        draw(result, self.plot)
