"""Checks of arguments by the annotations of a function."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable, Mapping, Sequence
from functools import cache, wraps
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, Unpack, cast

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.errors import LARGEST, Described, Refused, require_keys

Function = TypeVar("Function", bound=Callable[..., Any])

_PLAIN = (str, bytes, Real, NoneType, Sequence, Mapping)
_WORDS = {float: "a finite number", int: "an integer", bool: "true or false", str: "a text"}


def checked(function: Function) -> Function:
    """Decorate a function to refuse arguments that do not match its annotations.

    matplotlib and VTK would raise errors of their own, long after the call.

    Examples
    --------
    >>> @checked
    ... def draw(width: float, color: str | None = None) -> None: ...
    >>> draw("x")
    Traceback (most recent call last):
    meshtrace.errors.Refused: width: 'x', allowed: a finite number
    """
    signature, kinds = inspect.signature(function), cache(lambda: _kinds(function))

    @wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        hints = kinds()
        require_keys(options, hints)
        given = signature.bind(*args, **options)
        for name, value in {**given.arguments, **options}.items():
            if name in hints and not _matches(value, hints[name]):
                shown = value if isinstance(value, _PLAIN) else Described(type(value).__name__)
                raise Refused(name, shown, " or ".join(_words(hints[name])))
        return function(*args, **options)

    return cast(Function, call)


def _kinds(function: Callable[..., Any]) -> dict[str, Any]:
    """Return the annotations of a function by name, an unpacked TypedDict included."""
    found = typing.get_type_hints(function)
    found.pop("return", None)
    unpacked = [name for name, hint in found.items() if typing.get_origin(hint) is Unpack]
    for name in unpacked:
        found |= typing.get_type_hints(*typing.get_args(found.pop(name)))
    return found


def _matches(value: Any, hint: Any) -> bool:
    """Return whether a value is of the kind of an annotation."""
    kind, parts = typing.get_origin(hint) or hint, typing.get_args(hint)
    if hint is ArrayLike or kind is Any:
        return True  # the function converts and checks it
    if kind in (Union, UnionType):
        return any(_matches(value, part) for part in parts)
    if kind is Literal:
        return isinstance(value, str) and value in parts
    if kind is float:
        return _is_number(value, Real) and -LARGEST <= value <= LARGEST
    if kind is int:
        return _is_number(value, Integral)
    if kind is bool:
        return isinstance(value, bool | np.bool_)
    if kind is tuple and ... not in parts:
        several = isinstance(value, Sequence) and not isinstance(value, str)
        return several and len(value) == len(parts) and all(map(_matches, value, parts))
    if kind in (Sequence, list):
        several = isinstance(value, kind) and not isinstance(value, str)
        return several and all(_matches(item, parts[0]) for item in value)
    if kind is Mapping:
        return isinstance(value, Mapping) and all(_matches(v, parts[1]) for v in value.values())
    return isinstance(value, kind)


def _is_number(value: Any, kind: type) -> bool:
    return isinstance(value, kind) and not isinstance(value, bool)


def _words(hint: Any) -> list[str]:
    """Return the allowed kinds in words."""
    kind, parts = typing.get_origin(hint) or hint, typing.get_args(hint)
    if kind in (Union, UnionType):
        return [word for part in parts if part is not NoneType for word in _words(part)]
    if kind is Literal:
        return [str(part) for part in parts]
    if kind in (Sequence, list, tuple, Mapping):
        inner = " or ".join(_words(parts[-1]))
        return [f"a {'mapping to' if kind is Mapping else 'list of'} {inner}"]
    return [_WORDS.get(kind, kind.__name__)]
