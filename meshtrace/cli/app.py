"""The command-line application: name, version and reporting of failures."""

from __future__ import annotations

import errno
import os
import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from meshtrace.cli.commands import study_commands
from meshtrace.cli.console import warnings_as_lines
from meshtrace.errors import Refused

INTERRUPTED = 130


class _Commands(TyperGroup):
    """Command group: failures are one line on stderr, with exit code 2, or 130 after Ctrl-C."""

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self.commands = dict(sorted([*self.commands.items(), *study_commands().items()]))

    def main(self, *args: Any, **extra: Any) -> Any:
        standalone = extra.get("standalone_mode", True)
        try:
            with warnings_as_lines():
                code = super().main(*args, **{**extra, "standalone_mode": False}) or 0
            if sys.stdout is not None:
                sys.stdout.flush()
        except typer.Abort:
            code = INTERRUPTED
        except Exception as error:
            message = _message(error)
            if message is None:
                raise
            typer.echo(f"error: {message}", err=True)
            code = 2
        if code == INTERRUPTED:
            typer.echo("interrupted", err=True)
        if standalone:
            sys.exit(code)
        return code

    def format_commands(self, context: Any, formatter: Any) -> None:
        """Write the first sentence of each command, in several lines if it is long."""
        commands = {name: self.get_command(context, name) for name in self.list_commands(context)}
        rows = [(name, one.get_short_help_str(limit=1000)) for name, one in commands.items() if one]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


app = typer.Typer(
    cls=_Commands,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _message(error: Exception) -> str | None:
    """Return the message for the user, None for an internal error."""
    if hasattr(error, "format_message"):  # typer's error for invalid arguments
        return _refusal(error) or str(error.format_message())
    if isinstance(error, Refused):
        return str(error)
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        # the interpreter flushes again at its end, and would print a traceback
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.__stdout__.fileno())  # type: ignore[union-attr]
        return f"standard output: {error.strerror}"
    return None


def _refusal(error: Any) -> str:
    """Return the refusal of an option's value, or "" for any other invalid argument."""
    import pydantic

    from meshtrace.models import allowed_by

    cause = error.__cause__
    if not isinstance(cause, pydantic.ValidationError):
        return ""
    first = cause.errors(include_url=False)[0]
    return str(Refused(max(error.param.opts, key=len), first["input"], allowed_by(first)))


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"meshtrace {version('meshtrace')}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Monte Carlo ray tracing of light that crosses a wavy sea."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
