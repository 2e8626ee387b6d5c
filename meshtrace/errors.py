"""The one error for input that is not accepted: field, value, allowed values.

`Refused` is raised alike by functions, models, link files and the command line. The `require_`
functions are the checks that need no model; the rest writes paths and values.
"""

from __future__ import annotations

import difflib
import math
import operator
import os
import re
import stat
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, get_args

if TYPE_CHECKING:
    from numpy.typing import NDArray

_WRITABLE = "a file in an existing folder, both writable"
_COMPARED = {"<": operator.lt, "<=": operator.le}

LARGEST = 1e30
SMALLEST = 1.0 / LARGEST  # of numbers > 0, which formulas divide by
"""Magnitude of a number beyond which its square may overflow on the way to a gain."""


class Described(str):
    """Value described in words ("no such file"), without quotes in an error."""

    __slots__ = ()

    def __repr__(self) -> str:
        """Return the words themselves."""
        return str(self)


MISSING = Described("missing")
"""Sentinel for a missing value."""


class Refused(ValueError):
    """Invalid input: one line with the field, its value and the allowed values.

    Parameters
    ----------
    field : str
        Dotted path of the field, such as "receiver.height".
    value : object
        The value that was given; `Described` for words about it.
    allowed : str
        Allowed values or range.
    hint : str
        Described between the value and the allowed values, such as "did you mean depth?".
    source : str
        File that holds the field; the line begins with it.

    Examples
    --------
    >>> raise Refused("photons", 0, "an integer >= 1")
    Traceback (most recent call last):
    meshtrace.errors.Refused: photons: 0, allowed: an integer >= 1
    """

    def __init__(
        self, field: str, value: object, allowed: str, hint: str = "", source: str = ""
    ) -> None:
        self.field, self.value, self.allowed = field, value, allowed
        self.hint, self.source = hint, source
        # texts come from files of strangers: no part may fill the screen
        parts = (_shortened(source), _shortened(field), show(value))
        head = ": ".join(part for part in parts if part)
        # keys of a file may hold line ends and control characters
        text = one_line(f"{head}, {f'{hint} ' if hint else ''}allowed: {_shortened(allowed, 640)}")
        shown = (c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
        super().__init__("".join(shown))

    def inside(self, *path: int | str) -> Refused:
        """Return the same refusal with the field's path inside a table or a list.

        Examples
        --------
        >>> Refused("photons", 0, ">= 1").inside("run").field
        'run.photons'
        >>> Refused("height", 0, "> 0").inside("receiver", 1).field
        'receiver[1].height'
        """
        parent = join_path("", *path)
        dot = "." if parent and self.field and not self.field.startswith("[") else ""
        field = f"{parent}{dot}{self.field}"
        return Refused(field, self.value, self.allowed, self.hint, self.source)

    def in_file(self, source: str) -> Refused:
        """Return the same refusal with the file that holds the field."""
        return Refused(self.field, self.value, self.allowed, self.hint, source)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the parts: workers of a sweep send refusals back."""
        plain = isinstance(self.value, str | int | float | None)
        value = self.value if plain else Described(show(self.value))  # others may not be pickled
        return Refused, (self.field, value, self.allowed, self.hint, self.source)


@contextmanager
def within(*path: int | str) -> Iterator[None]:
    """Raise the refusals of a block with their field's path inside a table or a list."""
    try:
        yield
    except Refused as error:
        raise error.inside(*path) from error.__cause__


@contextmanager
def extra(
    name: str,
    field: str,
    value: object = None,
    allowed: str = "{}",
) -> Iterator[None]:
    """Refuse with the way to install an extra if packages are missing in a block.

    Parameters
    ----------
    name : str
        The extra of meshtrace.
    field, value, allowed : str
        As in `Refused`; by default the value names the missing package. {} in `allowed` stands for
        the command that installs the extra.
    """
    try:
        yield
    except ImportError as error:
        command = f'pip install "meshtrace[{name}]"'
        missing = Described(f"{error.name or 'an extra package'} is not installed")
        shown = missing if value is None else value
        raise Refused(field, shown, allowed.format(command)) from error


@contextmanager
def refusing(field: str, allowed: str) -> Iterator[None]:
    """Turn all errors of a block, whose readers raise any exception, into refusals of a field."""
    try:
        yield
    except (Refused, Warning):
        raise
    except Exception as error:
        raise Refused(field, Described(reason_of(error)), allowed) from error


def require_keys(table: Mapping[str, Any], keys: Iterable[str], path: str = "") -> None:
    """Refuse a value that is no table, and keys other than `keys`."""
    if not isinstance(table, Mapping):
        raise Refused(path, Described(type(table).__name__), "a table")
    for key, value in table.items():
        if key not in keys:
            hint = f"no such key, {did_you_mean(key, keys)}".rstrip()
            raise Refused(join_path(path, key), value, ", ".join(keys), hint)


def require_word(value: Any, words: Iterable[str], path: str) -> None:
    """Refuse a value that is none of `words`."""
    if not isinstance(value, str) or value not in words:
        raise Refused(path, value, ", ".join(words), did_you_mean(value, words))


def require_whole(value: Any, low: int, high: int, path: str, allowed: str = "") -> None:
    """Refuse all but integers from `low` to `high`; numpy's count, true and false do not."""
    try:
        # Python counts true and false as 1 and 0
        whole = None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        whole = None
    if whole is None or not low <= whole <= high:
        raise Refused(path, value, allowed or f"an integer {low} <= {path} <= {high}")


def require_kind(value: Any, kind: type | UnionType, path: str) -> None:
    """Refuse all but instances of a class, or also None for `kind | None`."""
    if not isinstance(value, kind):
        name = (get_args(kind) or (kind,))[0].__name__
        raise Refused(path, Described(type(value).__name__), f"a {name}")


def require_plain(value: Any, path: str, allowed: str) -> None:
    """Refuse arrays with a part that numpy drops in silence: masks, units, names of columns."""
    if value is None or isinstance(value, str | int | float | list | tuple | dict):
        return
    # by their attributes, since importing pandas or pint here would cost more than a first gain
    labels, lost = getattr(getattr(value, "columns", None), "dtype", None), ""
    if hasattr(value, "mask") and getattr(value.mask, "any", bool)():
        lost = "masked entries"
    elif getattr(getattr(value, "dtype", None), "kind", "") == "c":
        lost = "complex numbers"
    elif hasattr(value, "m_as") or hasattr(value, "to_value"):  # of pint and astropy
        lost = "units"
    elif labels is not None and labels.kind not in "iu":
        lost = "names of columns"
    if lost:
        raise Refused(path, Described(f"an array with {lost}"), f"{allowed}; plain numbers")


def require_array(value: Any, path: str, allowed: str, dtype: Any = float) -> NDArray[Any]:
    """Return a value as an array of a type, or refuse it.

    Numbers alone become an array of floats: no texts, truths, dates or complex numbers, which
    numpy would convert, and no masked ones, whose mask it would drop.
    """
    import numpy as np

    try:
        require_plain(value, path, allowed)
        if dtype is float and not _is_numeric(value):
            raise TypeError
        # masks and units are refused by now: nothing is lost
        array = np.asarray(value)
        if array.dtype.kind == "O" and dtype is float:  # Decimal, Fraction, columns of pandas
            numbers = [require_real(x, path, allowed) for x in array.flat]
            array = np.array(numbers).reshape(array.shape)
        if (dtype is float and array.dtype.kind not in "iuf") or np.ma.is_masked(value):
            raise TypeError
        converted = np.asarray(array, dtype, order="C")
        # indices that numpy rounded or wrapped are no longer those of the user
        if converted.dtype.kind in "iu" and not np.array_equal(converted, array):
            raise TypeError
        return converted
    except Refused:
        raise
    except Exception as error:  # what a foreign object raises, too
        raise Refused(path, value, allowed) from error


def _is_numeric(value: Any) -> bool:
    """Return whether a value, or all in a list, may be numbers: numpy makes some of truths."""
    if isinstance(value, list | tuple):
        return all(map(_is_numeric, value))
    kind = getattr(getattr(value, "dtype", None), "kind", "f")
    numbers = any(hasattr(value, name) for name in ("__array__", "__float__", "__index__"))
    return kind != "b" and not isinstance(value, bool) and (numbers or isinstance(value, range))


def require_finite(value: Any, path: str, allowed: str) -> NDArray[Any]:
    """Return one or more finite numbers as an array (n,); refuse any other value."""
    array = require_array(value, path, allowed)
    if array.ndim > 1 or not array.size or not all(map(math.isfinite, array.flat)):
        raise Refused(path, value, allowed)
    return array.reshape(-1)


def require_between(
    value: Any, low: float, high: float, path: str, ends: str = "()", allowed: str = ""
) -> float:
    """Return a number of an interval; refuse any other value.

    Brackets in `ends` say whether the bounds belong to it, as in "[)" for low <= value < high.
    """
    left, right = ("<=" if end in "[]" else "<" for end in ends)
    allowed = allowed or f"{low:g} {left} {path} {right} {high:g}"
    # most values are floats, which need no further look
    number = value if type(value) is float else require_real(value, path, allowed)
    if not (_COMPARED[left](low, number) and _COMPARED[right](number, high)):
        raise Refused(path, value, allowed)
    return number


def require_real(value: Any, path: str, allowed: str) -> float:
    """Return a number as float; refuse any other value but nan."""
    kind = getattr(getattr(value, "dtype", None), "kind", "f")  # numpy's truths, dates, complex
    is_number = hasattr(value, "__float__") or hasattr(value, "__index__")
    try:
        if isinstance(value, bool) or not is_number or kind not in "iufO" or _is_array(value):
            raise TypeError
        return float(value)
    except Exception as error:  # what a foreign object raises, too
        raise Refused(path, value, allowed) from error


def _is_array(value: Any) -> bool:
    """Return whether a value has dimensions or a mask."""
    return bool(getattr(value, "ndim", 0)) or hasattr(value, "mask")


def require_pair(value: Any, path: str, allowed: str) -> tuple[float, float]:
    """Return two finite numbers; refuse any other value."""
    pair = require_finite(value, path, allowed)
    if pair.shape != (2,) or isinstance(value, str | bytes):
        raise Refused(path, value, allowed)
    return float(pair[0]), float(pair[1])


def require_names(value: Any, path: str) -> list[str]:
    """Return one name or a sequence of names as a list; refuse any other value."""
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list | tuple) or not all(isinstance(n, str) for n in names):
        raise Refused(path, value, "names")
    return list(names)


def require_seed(value: Any) -> None:
    """Refuse all but keys of random numbers."""
    require_whole(value, 0, 2**64 - 1, "seed", "an integer 0 <= seed < 2^64")


def require_range(
    value: Any, low: float, high: float, path: str, ends: str = "[]", allowed: str = ""
) -> NDArray[Any]:
    """Return numbers of an interval as an array; refuse them by the first outside.

    `ends` are those of `require_between`.
    """
    import numpy as np

    left, right = ("<=" if end in "[]" else "<" for end in ends)
    allowed = allowed or f"{low:g} {left} {path} {right} {high:g}"
    array = require_array(value, path, allowed)
    # nan compares as false and is refused, too
    good = _COMPARED[left](low, array) & _COMPARED[right](array, high)
    if not good.all():
        raise Refused(path, array[~good].flat[0], allowed)
    if np.abs(array).max(initial=0.0) > LARGEST:
        raise Refused(path, np.abs(array).max(), f"at most {LARGEST:g} in magnitude")
    return array


def require_number(value: Any, path: str) -> None:
    """Refuse words for numbers, and numbers that overflow on the way to a gain."""
    if isinstance(value, bool) or getattr(getattr(value, "dtype", None), "kind", "") == "b":
        raise Refused(path, value, "neither true nor false")
    if isinstance(value, int) and abs(value) >= 2**64:
        raise Refused(path, value, "integers of 64 bits")
    if isinstance(value, float) and LARGEST < abs(value) < math.inf:
        raise Refused(path, value, f"at most {LARGEST:g} in magnitude")
    if isinstance(value, str) and reads_as_number(value):
        raise Refused(path, value, "numbers without quotes")


def require_writable(
    path: str | Path, inputs: Iterable[str | Path | None] = (), field: str = "--output"
) -> None:
    """Refuse an output file that cannot be written, before the work.

    Parameters
    ----------
    path : path
        Output file.
    inputs : iterable of path or None
        Files that the work reads, or writes too; None is ignored.
    field : str
        Name of the argument, for the message.

    Raises
    ------
    Refused
        If the path is one of these, a folder, a device, a FIFO or a read-only file, if its name is
        too long, or if its folder does not exist or is read-only.
    """
    status = None
    try:
        with suppress(FileNotFoundError):
            status = os.stat(path)
        # of a link the folder of its target counts
        folder = Path(os.path.realpath(path)).parent
        read_only = not (folder.is_dir() and os.access(folder, os.W_OK))
        if status is not None:
            # no write bit at all: read-only even for a user whom the kernel lets write
            read_only |= not (os.access(path, os.W_OK) and status.st_mode & 0o222)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise Refused(field, str(path), f"{_WRITABLE} ({reason})") from error
    if read_only or (status is not None and not stat.S_ISREG(status.st_mode)):
        raise Refused(field, str(path), _WRITABLE)
    for name in inputs:
        if name is not None and _same(name, path, status is not None):
            raise Refused(field, str(path), "a file other than the input and other outputs")


def _same(name: str | Path, path: str | Path, exists: bool) -> bool:
    """Return whether two names refer to one file, which may not exist yet."""
    # one file may have several names: links, and letters in another case
    if exists and os.path.exists(name):
        return os.path.samefile(name, path)
    return os.path.realpath(name) == os.path.realpath(path)


def did_you_mean(word: Any, words: Iterable[str]) -> str:
    """Return a hint at words of similar spelling, or ""."""
    short = isinstance(word, str) and len(word) <= 100  # the search takes longer than its square
    near = difflib.get_close_matches(word, list(words)) if short else []
    return f"did you mean {' or '.join(near)}?" if near else ""


def join_path(path: str, *keys: int | str) -> str:
    """Return the path of a key in a table or of an item in a list."""
    for key in keys:
        if isinstance(key, int):
            path += f"[{show(key)}]"  # a key of a table may be too long to write
        else:
            plain = isinstance(key, str) and re.fullmatch(r"[\w ,-]+", key)
            name = key if plain else show(key)
            path = f"{path}.{name}" if path else name
    return path


def is_number(value: Any) -> bool:
    """Return True for int or float, but not bool."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def reads_as_number(word: str) -> bool:
    """Return whether a word is the text of a number."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def show(value: Any) -> str:
    """Return a value as one short line."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Described):
        return _shortened(one_line(value))
    try:
        if getattr(value, "ndim", None) == 0:  # numpy's numbers
            value = value.item()
        elif getattr(value, "size", 9) == 0 and hasattr(value, "tolist"):  # without a type
            value = value.tolist()
        text = one_line(repr(value))
    except RecursionError:
        return "tables nested too deeply"
    except Exception:  # Python writes no integer of more than 4300 digits, some objects nothing
        huge = isinstance(value, int)
        return "a huge integer" if huge else f"a {type(value).__name__} without a text"
    return text if len(text) <= 60 else f"{text[:57]}..."


def _shortened(text: str, most: int = 400) -> str:
    """Return a text without its middle, if it is longer than the paths and lists in use."""
    return text if len(text) <= most else f"{text[: most // 2]}...{text[-most // 2 :]}"


def one_line(value: object) -> str:
    """Return the text of a value without its line ends."""
    return " ".join(str(value).split())


def reason_of(error: Exception) -> str:
    """Return the text of an error as one line, or else its type."""
    return one_line(error) or type(error).__name__


class InputWarning(UserWarning):
    """Input was converted or chosen from: its units, left out columns and rows, other forms."""


def warn_of_input(text: str) -> None:
    """Warn in one line of a conversion of input, at the line that calls the package."""
    level, frame = 2, sys._getframe(1)
    inside = ("meshtrace", "pydantic", "contextlib")
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith(inside):
        level, frame = level + 1, frame.f_back
    warnings.warn(one_line(text), InputWarning, stacklevel=level)


class DomainWarning(UserWarning):
    """Light escaped through the sides of the mesh or a hole in it, or was left out.

    Measured spectra without their short waves warn alike: light meets too few slopes.
    """
