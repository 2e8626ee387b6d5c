"""Command-line application: registration of commands and reporting of errors."""

from __future__ import annotations

import errno
import inspect
import os
import sys
from collections.abc import Callable
from dataclasses import is_dataclass
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from meshtrace.cli import console
from meshtrace.errors import MISSING, Refused

INTERRUPTED = 130  # exit code of shells for 128 + SIGINT


class _Commands(TyperGroup):
    """Command group: failures are one line on stderr, with exit code 2, or 130 after Ctrl-C."""

    def main(self, *args: Any, **settings: Any) -> Any:
        standalone = settings.get("standalone_mode", True)
        try:
            with console.warnings_as_lines():
                # in its own standalone mode typer would print failures in its words and exit
                code = super().main(*args, **settings | {"standalone_mode": False}) or 0
            # a full disk shows here: at the end of Python it would be too late to say so
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
        """Write the whole first sentence of each command: typer would cut it at 45 letters."""
        commands = sorted(self.commands.items())
        listing = [(name, item.get_short_help_str(limit=1000)) for name, item in commands]
        with formatter.section("Commands"):
            formatter.write_dl(listing)


class _Command(TyperCommand):
    """Command whose refusals name the option, not the argument behind it."""

    def invoke(self, context: Any) -> Any:
        try:
            return super().invoke(context)
        except Refused as error:
            # times[3] is of --times; a study may name the option, or the parameter behind it
            field = error.field.partition("[")[0]
            options = {_longest_name(p)[2:].replace("-", "_"): p for p in self.params}
            options |= {str(p.name).rstrip("_"): p for p in self.params}
            option = options.get(field)
            # a field of a link file may have the name of an option
            if error.source or option is None:
                raise
            # None is how typer passes an option that is not given
            value = MISSING if error.value is None else error.value
            raise Refused(_longest_name(option), value, error.allowed, error.hint) from error


def _longest_name(parameter: Any) -> str:
    return str(max(parameter.opts, key=len))


app = typer.Typer(
    cls=_Commands,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def command(name: str | None = None) -> Callable[[Callable[..., None]], Any]:
    """Register a function as a command, whose help is its docstring.

    A parameter annotated by a dataclass stands for an option for each field: typer has no groups.
    It must be the class itself: no `from __future__ import annotations` in files of commands.
    """

    def register(function: Callable[..., None]) -> Callable[..., None]:
        text = function.__doc__
        # python -OO drops docstrings: they are read from the source then
        if text is None:
            from meshtrace.fields import docstring

            text = docstring(function)
        app.command(name, cls=_Command, help=text)(_with_groups(function))
        return function

    return register


def _with_groups(function: Callable[..., None]) -> Callable[..., None]:
    """Return a function whose dataclass parameters are replaced by the fields of the classes.

    A parameter of the function takes the place of a field of the same name.
    """
    parameters = dict(inspect.signature(function).parameters)
    groups: dict[str, tuple[Any, list[str]]] = {}
    for name, parameter in list(parameters.items()):
        group: Any = parameter.annotation
        if is_dataclass(parameter.annotation):
            del parameters[name]
            fields = dict(inspect.signature(group).parameters)
            groups[name] = group, [field for field in fields if field not in parameters]
            # commands declare an option that means something else to them themselves: ber --wind
            parameters |= fields | parameters

    def call(**values: Any) -> None:
        for name, (group, fields) in groups.items():
            values[name] = group(**{field: values.pop(field) for field in fields})
        function(**values)

    call.__name__ = function.__name__
    call.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [p.replace(kind=p.KEYWORD_ONLY) for p in parameters.values()]
    )
    return call


def _message(error: Exception) -> str | None:
    """Return the message for the user, None for an internal error."""
    # typer exports no class that all its errors for invalid arguments share
    if hasattr(error, "format_message"):
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

    from meshtrace.pydantic_errors import allowed_by

    cause = error.__cause__
    if not isinstance(cause, pydantic.ValidationError):
        return ""
    first = cause.errors(include_url=False)[0]
    # typer lets pydantic call the parsers of options.py, which wraps what they raise
    refused = first.get("ctx", {}).get("error")
    allowed = refused.allowed if isinstance(refused, Refused) else allowed_by(first)
    return str(Refused(_longest_name(error.param), first["input"], allowed))


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"meshtrace {version('meshtrace')}")
        raise typer.Exit


@app.callback(
    invoke_without_command=True, help="Monte Carlo ray tracing of light that crosses a wavy sea."
)
def _options(
    context: typer.Context,
    version: Annotated[bool, typer.Option(
        "--version", callback=_print_version, is_eager=True, help="Show the version.")] = False,
) -> None:  # fmt: skip
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
