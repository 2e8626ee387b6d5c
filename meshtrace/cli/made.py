"""Commands made from functions: options by signature, help by docstring, values by annotation."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, is_dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin

import typer
from typer.core import TyperCommand

from meshtrace.cli.console import progress
from meshtrace.errors import MISSING, Refused, require_word
from meshtrace.fields import docstring, entries


class Reader(NamedTuple):
    """Parser of the text of an option, or of the texts of a repeatable option."""

    metavar: str
    read: Callable[[str, Any], Any]
    kind: Any = str | None
    note: str = ""


def numbers(option: str, text: str) -> list[float]:
    """Return the numbers of a list "1,2,3" or a range "start:stop:step", its end included."""
    wrong = Refused(option, text, "numbers as in 1,2,3, or start:stop:step")
    try:
        if ":" not in text:
            values = [float(word) for word in text.split(",")]
        else:
            start, stop, step = (float(word) for word in text.split(":"))
            # rounding of the quotient must not lose the end: 0:0.3:0.1 has four numbers
            count = math.floor((stop - start) / step + 1e-9) + 1
            if not (step > 0.0 and 1 <= count <= 10**7):
                raise wrong
            values = [start + step * i for i in range(count)]
    except (ValueError, ZeroDivisionError, OverflowError) as error:
        raise wrong from error
    if not all(math.isfinite(value) for value in values):
        raise wrong
    return values


def _real(option: str, text: str) -> float:
    with suppress(ValueError):
        return float(text)
    raise Refused(option, text, "a number")


def _whole(option: str, text: str) -> int:
    """Return an integer; the text may be in scientific notation, such as 1e6."""
    with suppress(ValueError):
        return int(text)
    with suppress(ValueError):
        if float(text).is_integer():
            return int(float(text))
    raise Refused(option, text, "an integer")


def _whole_or_text(option: str, text: str) -> int | str:
    """Return an integer, or a text such as the address of a scheduler."""
    return int(text) if text.lstrip("-").isdecimal() else text


def _pair(option: str, text: str) -> tuple[float, float]:
    values = numbers(option, text)
    if len(values) != 2:
        raise Refused(option, text, "two numbers, as in 1,2")
    return values[0], values[1]


def _intervals(option: str, texts: list[str]) -> dict[str, tuple[float, float]]:
    """Return the bounds of each key of texts "key=low,high"."""
    intervals = {}
    for text in texts:
        key, _, bounds = text.partition("=")
        try:
            intervals[key] = _pair(option, bounds)
        except Refused as error:
            allowed = "KEY=LOW,HIGH, as in receiver.fov_deg=6,90"
            raise Refused(option, text, allowed) from error
    return intervals


_NUMBERS = Reader("LIST", numbers, note="; as 1,2,3 or start:stop:step")
_READERS = {
    "int": Reader("N", _whole),
    "float": Reader("X", _real),
    "str": Reader("NAME", lambda _, text: text),
    "int | str": Reader("N", _whole_or_text),
    "str | Path": Reader("PATH", lambda _, path: path, Path | None),
    "tuple[float, float]": Reader("X,Y", _pair),
    **dict.fromkeys(("ArrayLike", "Sequence[float]", "float | Sequence[float]"), _NUMBERS),
    "Sequence[str]": Reader("NAME", lambda _, texts: texts, list[str] | None, "; repeatable"),
    "Bounds": Reader("KEY=LOW,HIGH", _intervals, list[str] | None, "; repeatable"),
}


def reader_of(annotation: str, names: dict[str, Any]) -> tuple[Reader, tuple[str, ...]]:
    """Return the reader of an annotation, and the words of a literal type.

    `names` are those of the module of the annotation.
    """
    plain = annotation.removesuffix(" | None")
    kind = None if plain in _READERS else eval(plain, names)
    if get_origin(kind) is Annotated:  # a number between bounds
        plain = get_args(kind)[0].__name__
    if plain in _READERS:
        return _READERS[plain], ()
    words = _literals(kind)
    assert words, f"no reader of options of type {annotation}"

    def word(option: str, text: str) -> str:
        require_word(text, words, option)
        return text

    def several(option: str, text: str) -> list[str]:
        return [word(option, part) for part in text.split(",")]

    return Reader("WORD", several if annotation.startswith("Sequence[") else word), words


def _literals(annotation: Any) -> tuple[str, ...]:
    """Return the words of all literals in an annotation."""
    parts = get_args(annotation)
    if get_origin(annotation) is Literal:
        return parts
    return tuple(word for part in parts for word in _literals(part))


_KEYWORD = inspect.Parameter.KEYWORD_ONLY
_SHORT = {"output": ["-o"], "realizations": ["-n"], "verbose": ["-v"]}


@dataclass
class StudyRow:
    """A study as a command: a row of commands.toml."""

    help: str
    study: str
    options: dict[str, str]
    steps: str = ""
    least: int = 0
    doing: str = "over the seas"
    kernels: str = "forced"

    @cached_property
    def functions(self) -> list[Callable[..., Any]]:
        """The function, and further functions of its module that share the options."""
        module, _, names = self.study.partition(":")
        return [getattr(import_module(module), name) for name in names.split()]

    def run(
        self, function: Callable[..., Any], of: Any, total: int | None, asked: dict[str, Any]
    ) -> Any:
        """Return the result of a study of something, behind a progress bar if it has steps."""
        with progress(total, total == 0, self.doing, self.kernels) as (_, advance):
            return function(of, progress=advance, **asked)


class StudyCommand(TyperCommand):
    """A command whose study is imported when its options are needed."""

    def __init__(self, name: str, study: StudyRow, work: Callable[..., None]) -> None:
        super().__init__(name, help=study.help, rich_markup_mode=None)
        self._study, self._work = study, work

    @cached_property
    def _made(self) -> Any:
        study, application = self._study, typer.Typer(add_completion=False, rich_markup_mode=None)
        options = {name: _option(study, name) for name in study.options}

        def read(**texts: Any) -> dict[str, Any]:
            given = {name: text for name, text in texts.items() if text is not None}
            return {name: options[name][0].read(name, text) for name, text in given.items()}

        asked = Group([parameter for _, parameter in options.values()], read)
        application.command()(described(self._work, study=Group([], lambda: study), asked=asked))
        return typer.main.get_command(application)

    def get_params(self, context: Any) -> Any:
        """Return arguments and options."""
        return self._made.get_params(context)

    def invoke(self, context: Any) -> Any:
        """Run the study."""
        return self._made.invoke(context)


class Span(NamedTuple):
    """Smallest and largest value of an option."""

    low: float
    high: float | None = None


class Group(NamedTuple):
    """Options of which a command takes one value."""

    options: Iterable[inspect.Parameter]
    value: Callable[..., Any]


def described(command: Callable[..., None], **groups: Group) -> Callable[..., None]:
    """Return a command with the arguments and options that signature and docstring describe.

    Keyword-only parameters are options, and dataclasses groups of options. Refusals of a value
    name its option.
    """
    declared = inspect.signature(command, eval_str=True).parameters
    for name, p in declared.items():
        if name not in groups and is_dataclass(p.annotation):
            kind: Any = p.annotation
            fields = inspect.signature(kind, eval_str=True).parameters.values()
            groups[name] = Group([_declared(kind, field) for field in fields], kind)

    parameters = [
        option
        for name, p in declared.items()
        for option in (groups[name].options if name in groups else [_declared(command, p)])
    ]

    def call(**values: Any) -> None:
        try:
            for name, (options, value) in groups.items():
                values[name] = value(**{p.name: values.pop(p.name) for p in options})
            command(**values)
        except Refused as error:
            option = next(
                (_option_name(p) for p in parameters if p.name.rstrip("_") == error.field), ""
            )
            if error.source or not option:
                raise
            refused = MISSING if error.value is None else error.value
            raise Refused(option, refused, error.allowed, error.hint) from error

    call.__name__ = command.__name__
    call.__doc__ = docstring(command).partition("\n\nParameters\n")[0]
    call.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return call


def _option_name(p: inspect.Parameter) -> str:
    """Return the longest name of the option of a declared parameter, "" for an argument."""
    declared = get_args(p.annotation)[1]
    # typer keeps the first name as a default
    names = (declared.default, *(declared.param_decls or ()))
    return max((name for name in names if isinstance(name, str)), key=len, default="")


def _declared(owner: Any, p: inspect.Parameter) -> inspect.Parameter:
    """Return a parameter of a command, or of a group, as an argument or an option.

    The type in the docstring is the metavariable; typer's own declarations are kept.
    """
    kind, *about = (
        get_args(p.annotation) if get_origin(p.annotation) is Annotated else [p.annotation]
    )
    if about and not isinstance(about[0], Span):
        return p.replace(kind=_KEYWORD)
    low, high = about[0] if about else (None, None)
    # without docstrings and source the names of options speak for themselves
    metavar, text = entries(owner).get(p.name, ("", None))
    told: dict[str, Any] = {"metavar": metavar or None, "help": text, "min": low, "max": high}
    word = p.name.rstrip("_").replace("_", "-")
    names = [f"--{word}/--no-{word}" if p.default is True else f"--{word}", *_SHORT.get(p.name, ())]
    declared: Any = typer.Option(*names, **told) if p.kind is _KEYWORD else typer.Argument(**told)
    return p.replace(kind=_KEYWORD, annotation=Annotated[kind, declared])


def _words(study: StudyRow, name: str) -> tuple[list[str], str, str | None]:
    """Return the names of the option of a parameter, the longest last, metavariable and default."""
    words = study.options[name].split()
    names = [word for word in words if word.startswith("-")] or [f"--{name.replace('_', '-')}"]
    metavar = next((word for word in words if word[0] not in "-="), "")
    return names, metavar, next((word[1:] for word in words if word.startswith("=")), None)


def _option(study: StudyRow, name: str) -> tuple[Reader, inspect.Parameter]:
    """Return reader and option of a parameter, described by the first function that has it."""
    functions = [f for f in study.functions if name in parameters_of(f)]
    annotation = parameters_of(functions[0])[name].annotation
    reader, choices = reader_of(annotation, inspect.unwrap(functions[0]).__globals__)
    names, metavar, default = _words(study, name)
    text = sentences(functions[0]).get(name, "").rstrip(".")
    if default is not None:  # in place of that of the function
        text = re.sub(r"[,;] (\S+ by default|by default .*)$", "", text)
    options = {key: _words(study, key)[0][-1] for key in study.options}
    text = re.sub(r"`([\w.]+)`", lambda code: options.get(code[1], code[1]), text)
    text += f": {', '.join(choices[:-1])} or {choices[-1]}" if choices else ""
    text += f"{reader.note}."
    typed = list(filter(None, dict.fromkeys(_typed(defaults(f)[name]) for f in functions)))
    if default is None and typed and "default" not in text:
        text += f"  [default: {' or '.join(typed)}]"
    unit = re.search(r"\[(\w)\]", text) if reader.metavar == "X" else None
    metavar = metavar or (unit[1].upper() if unit else reader.metavar)
    declared: Any = typer.Option(*names, metavar=metavar, help=text)
    kind = Annotated[reader.kind, declared]  # type: ignore[name-defined]
    return reader, inspect.Parameter(name, _KEYWORD, default=default, annotation=kind)


def _typed(value: Any) -> str:
    """Return a default as typed on the command line; empty without a default."""
    if value is None or value is inspect.Parameter.empty:
        return ""
    if isinstance(value, list | tuple):
        return ",".join(map(_typed, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def sentences(function: Callable[..., Any]) -> dict[str, str]:
    """Return the first sentence about each parameter, and each option of the run, in docstrings."""
    from meshtrace.engine.setup.options import StudyOptions

    of_run = entries(StudyOptions) if "run" in inspect.signature(function).parameters else {}
    texts = {name: text for name, (_, text) in {**of_run, **entries(function)}.items()}
    return {name: re.split(r"(?<=\.) ", text, maxsplit=1)[0] for name, text in texts.items()}


def parameters_of(function: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """Return the parameters of a function, and its options `**run` as parameters."""
    parameters = dict(inspect.signature(function).parameters)
    if run := parameters.pop("run", None):
        (kind,) = get_args(eval(run.annotation, inspect.unwrap(function).__globals__))
        for name, hint in kind.__annotations__.items():
            text = hint.__forward_arg__
            parameters[name] = inspect.Parameter(name, _KEYWORD, default=None, annotation=text)
    return parameters


def defaults(function: Callable[..., Any]) -> dict[str, Any]:
    """Return the default values of a function and of its options of the run."""
    return {name: p.default for name, p in parameters_of(function).items()}
