"""One table of a link file to its model, and back to plain data.

Every problem that pydantic or the run finds is put into the words of link files here.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeVar, get_args

import pydantic

from meshtrace.errors import (
    Refused,
    ScenarioError,
    join_path,
    one_line,
    refuse_unknown,
    refuse_unlisted,
    refuse_words,
    show,
    with_colon,
)
from meshtrace.link import Aperture, Source
from meshtrace.registry import Family
from meshtrace.transport.options import Run, Sampling

Model = TypeVar("Model", bound=pydantic.BaseModel)
Table = dict[str, Any]


def as_table(value: Any, path: str) -> Table:
    """Return a copy of a table, refusing what is none."""
    if not isinstance(value, Mapping):
        raise ScenarioError(f"{path}: {show(value)}, allowed: a table")
    return dict(value)


def validated(
    model: type[Model], value: Any, path: str, keys: tuple[str, ...] | None = None
) -> Model:
    """Return the model that a table describes, with all errors in the words of link files."""
    table = as_table(value, path)
    refuse_unknown(table, keys or _keys(model), path)
    refuse_words(model, table, path)
    try:
        return model.model_validate(table)
    except pydantic.ValidationError as error:
        raise ScenarioError(_problem(error, path)) from error
    except ArithmeticError as error:
        raise ScenarioError(
            f"{path}: {show(table)}, allowed: numbers that do not overflow ({error})"
        ) from error


def of_kind(union: Any, value: Any, path: str, key: str, default: str) -> Any:
    """Return the model of a table, or of a bare word, that says its kind under `key`."""
    table = {key: value} if isinstance(value, str) else as_table(value, path)
    models = kinds(union)
    word = key if key in table else "kind"
    kind = table.pop(word, default)
    if isinstance(kind, str) and ":" in kind and isinstance(union, type):
        model = imported(union, kind, f"{path}.{word}")
    else:
        refuse_unlisted(kind, tuple(models), f"{path}.{word}")
        model = models[kind]
    keys = (key, *(name for name in _keys(model) if name != "kind"))
    return validated(model, table, path, keys)


def imported(family: type[Family], kind: str, path: str) -> type[pydantic.BaseModel]:
    """Return the model of a family at an import path "module:Class"."""
    try:
        return family.member(kind)
    except Refused as error:
        raise ScenarioError(f"{path}: {show(kind)}, allowed: {error.allowed}") from error


def kinds(union: Any) -> dict[str, type[pydantic.BaseModel]]:
    """Return the models of a family, or of a union, by `kind`."""
    if isinstance(union, type) and issubclass(union, Family):
        return union.registered
    return {m.model_fields["kind"].default: m for m in get_args(get_args(union)[0])}


def _keys(model: type[pydantic.BaseModel]) -> tuple[str, ...]:
    aliases = (f.alias for f in model.model_fields.values() if f.alias)
    return (*model.model_fields, *aliases)


def plain(part: Any) -> Any:
    """Return a model, or a tuple of them, as plain data."""
    if isinstance(part, tuple):
        return [plain(item) for item in part]
    return part.model_dump(mode="json", exclude_none=True)


def without_shared_wind(table: Table, wind_speed: float) -> Table:
    """Return the table without a wind speed that is that of the scenario."""
    same = table.get("wind_speed") == wind_speed
    return {k: v for k, v in table.items() if not (same and k == "wind_speed")}


@contextmanager
def named_as_in_files() -> Iterator[None]:
    """Turn an error about a field into a ScenarioError that names it as link files do."""
    try:
        yield
    except ScenarioError:
        raise
    except ArithmeticError as error:
        raise ScenarioError(f"link: {error}, allowed: numbers that do not overflow") from error
    except ValueError as error:
        text = one_line(str(error))
        name, colon, _ = text.partition(": ")
        if not colon or ", allowed" not in text:
            raise
        path = ""
        if name in Sampling.model_fields:
            path = "sea"
        elif name in Run.model_fields:
            path = "run"
        raise ScenarioError(with_colon(_named(text, path))) from error


def _problem(error: pydantic.ValidationError, path: str) -> str:
    """Return the first error of pydantic as one line: field, value, what is allowed."""
    first = error.errors(include_url=False)[0]
    where, value = join_path(path, *first["loc"]), show(first["input"])
    text = first["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    if first["type"] == "missing":
        return f"{where}: missing, allowed: a value"
    name, colon, _ = text.partition(": ")
    if colon and ", allowed" in text:  # our own, which name field and value themselves
        parent = first["loc"][:-1] if first["loc"][-1:] == (name,) else first["loc"]
        return with_colon(_named(text, path, parent))
    allowed = re.sub("(?i)tuple", "list", text.removeprefix("allowed").lstrip(": "))
    return one_line(f"{where}: {value}, allowed: {allowed}")


def _named(text: str, path: str, parent: tuple[int | str, ...] = ()) -> str:
    """Put a message that begins with its field into the words of link files."""
    name, _, rest = text.partition(": ")
    head, dot, tail = name.partition(".")
    if head in kinds(Source):
        return f"transmitter{dot}{tail}: {rest}"
    if head in kinds(Aperture):
        return f"receiver{dot}{tail}: {rest}"
    return f"{join_path(path, *parent, name)}: {rest}"
