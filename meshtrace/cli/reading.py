"""Values of options from their texts, by the annotation of a parameter."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args, get_origin

from meshtrace.errors import Refused, require_word


class Reader(NamedTuple):
    """Reader of the text of an option, or of the texts of one that may be repeated."""

    metavar: str
    read: Callable[[str, Any], Any]
    kind: Any = str | None
    note: str = ""


def numbers(option: str, text: str) -> list[float]:
    """Return the numbers of a list "1,2,3" or a range "start:stop:step", its end included."""
    wrong = Refused(option, text, "numbers as in 1,2,3, or start:stop:step")
    try:
        if ":" not in text:
            found = [float(word) for word in text.split(",")]
        else:
            start, stop, step = (float(word) for word in text.split(":"))
            count = math.floor((stop - start) / step + 1e-9) + 1
            if not (step > 0.0 and 1 <= count <= 10**7):
                raise wrong
            found = [start + step * i for i in range(count)]
    except (ValueError, ZeroDivisionError, OverflowError) as error:
        raise wrong from error
    if not all(math.isfinite(value) for value in found):
        raise wrong
    return found


def _real(option: str, text: str) -> float:
    with suppress(ValueError):
        return float(text)
    raise Refused(option, text, "a number")


def _whole(option: str, text: str) -> int:
    """Return an integer, also of a text such as 1e6."""
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
    found = numbers(option, text)
    if len(found) != 2:
        raise Refused(option, text, "two numbers, as in 1,2")
    return found[0], found[1]


def _intervals(option: str, texts: list[str]) -> dict[str, tuple[float, float]]:
    """Return the bounds of each key of texts "key=low,high"."""
    found = {}
    for text in texts:
        key, _, bounds = text.partition("=")
        try:
            found[key] = _pair(option, bounds)
        except Refused as error:
            allowed = "KEY=LOW,HIGH, as in receiver.fov_deg=6,90"
            raise Refused(option, text, allowed) from error
    return found


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
    "Mapping[str, tuple[float, float]]": Reader(
        "KEY=LOW,HIGH", _intervals, list[str] | None, "; repeatable"
    ),
}


def reader_of(annotation: str, names: dict[str, Any]) -> tuple[Reader, tuple[str, ...]]:
    """Return the reader of an annotation, and the words of one that has literals.

    `names` are those of the module of the annotation.
    """
    reader = _READERS.get(annotation.removesuffix(" | None"))
    if reader is not None:
        return reader, ()
    words = _words(eval(annotation, names))

    def word(option: str, text: str) -> str:
        require_word(text, words, option)
        return text

    def several(option: str, text: str) -> list[str]:
        return [word(option, one) for one in text.split(",")]

    return Reader("WORD", several if annotation.startswith("Sequence[") else word), words


def _words(annotation: Any) -> tuple[str, ...]:
    """Return the words of all literals in an annotation."""
    parts = get_args(annotation)
    if get_origin(annotation) is Literal:
        return parts
    return tuple(word for part in parts for word in _words(part))
