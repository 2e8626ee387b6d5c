"""The error for invalid input: field, value, allowed values.

`Refused` is raised alike by functions, models, link files and the command line. The `require_`
functions are checks without pydantic; the others write paths and values for error texts.
"""

from __future__ import annotations

import difflib
import itertools
import math
import operator
import os
import re
import stat
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, get_args

if TYPE_CHECKING:
    from numpy.typing import NDArray

_WRITABLE = "a file in an existing folder, both writable"
_COMPARED = {"<": operator.lt, "<=": operator.le}

LARGEST = 1e30
"""Largest magnitude of a number of the user (tuned: its powers do not overflow on the way)."""

SMALLEST = 1.0 / LARGEST
"""Smallest number where any number > 0 is allowed: formulas divide by it."""


class Described(str):
    """Value described in words ("no such file"), without quotes in an error."""

    __slots__ = ()

    def __repr__(self) -> str:
        """Return the words themselves."""
        return str(self)


MISSING = Described("missing")
"""Sentinel for a missing value."""

# inside `hinting_at`
_OTHER_TABLES = ContextVar[Callable[[], Iterable[str]] | None]("other_tables", default=None)


class Refused(ValueError):
    """Invalid input: one line with the field, its value and the allowed values.

    Parameters
    ----------
    field : str
        Dotted path of the field, such as "receiver.height".
    value : object
        The value that was passed, or words about it as `Described`.
    allowed : str
        Allowed values or range.
    hint : str
        Text between the value and the allowed values, such as "did you mean depth?".
    source : str
        File that holds the field; the message begins with it.

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
        # parts may come from a foreign file: none may fill the screen; 640: all lists in use
        parts = (_shortened(source), _shortened(field), show(value))
        head = ": ".join(part for part in parts if part)
        # or hold line ends and control characters
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
        """Pickle as the arguments, so that workers of a sweep can send refusals back."""
        plain = isinstance(self.value, str | int | float | None)
        value = self.value if plain else Described(show(self.value))  # which may not be picklable
        return Refused, (self.field, value, self.allowed, self.hint, self.source)


@contextmanager
def within(*path: int | str) -> Iterator[None]:
    """Prefix the field of a refusal raised in a block with the path of a table or a list."""
    try:
        yield
    except Refused as error:
        raise error.inside(*path) from error.__cause__


def installing(extra: str) -> str:
    """Return the command that installs an extra of meshtrace."""
    return f'pip install "meshtrace[{extra}]"'


@contextmanager
def extra(
    name: str,
    field: str,
    value: object = None,
    allowed: str = "{}",
) -> Iterator[None]:
    """Turn a failed import of a package into an error with its installation command.

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
        missing, command = f"{error.name or 'an extra package'} is not installed", installing(name)
        if value is None:
            raise Refused(field, Described(missing), allowed.format(command)) from error
        raise Refused(field, value, allowed.format(command), f"{missing},") from error


@contextmanager
def refusing(field: str, allowed: str) -> Iterator[None]:
    """Turn any error in a block, such as a file reader's, into a refusal of a field."""
    try:
        yield
    except (Refused, Warning):
        raise
    except Exception as error:
        raise Refused(field, Described(reason_of(error)), allowed) from error


@contextmanager
def hinting_at(dotted: Callable[[], Iterable[str]]) -> Iterator[None]:
    """Let refusals of unknown keys in a block name keys of other tables, such as receiver.height.

    In nested blocks the outermost knows the whole paths, and alone is asked.
    """
    token = _OTHER_TABLES.set(_OTHER_TABLES.get() or dotted)
    try:
        yield
    finally:
        _OTHER_TABLES.reset(token)


def require_keys(table: Mapping[str, Any], keys: Iterable[str], path: str = "") -> None:
    """Require a table with no keys other than `keys`."""
    if not isinstance(table, Mapping):
        raise Refused(path, Described(type(table).__name__), "a table")
    for key, value in table.items():
        if key not in keys:
            dotted = _OTHER_TABLES.get() or tuple
            meant = did_you_mean(key, keys) or did_you_mean(key, dotted())
            hint = f"no such key, {meant}".rstrip()
            raise Refused(join_path(path, key), value, ", ".join(keys), hint)


def require_word(value: Any, words: Iterable[str], path: str) -> None:
    """Require one of `words`."""
    if not isinstance(value, str) or value not in words:
        raise Refused(path, value, ", ".join(words), did_you_mean(value, words))


def require_whole(value: Any, low: int, high: int, path: str, allowed: str = "") -> None:
    """Refuse all but integers from `low` to `high`; Python's or numpy's, but not booleans."""
    try:
        # to Python, True and False are the integers 1 and 0
        whole = None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        whole = None
    if whole is None or not low <= whole <= high:
        raise Refused(path, value, allowed or f"an integer {low} <= {path} <= {high}")


def require_kind(value: Any, kind: type | UnionType, path: str) -> None:
    """Refuse anything but an instance of `kind` (a class or union)."""
    if not isinstance(value, kind):
        name = (get_args(kind) or (kind,))[0].__name__
        raise Refused(path, Described(type(value).__name__), f"a {name}")


def require_plain(value: Any, path: str, allowed: str) -> None:
    """Refuse arrays from which numpy would drop masks, units or names of columns."""
    if value is None or isinstance(value, str | int | float | list | tuple | dict):
        return
    # recognized by their attributes: importing pandas or pint would take longer than a first gain
    labels, lost = getattr(getattr(value, "columns", None), "dtype", None), ""
    if hasattr(value, "mask") and getattr(value.mask, "any", bool)():
        lost = "masked entries"
    elif getattr(getattr(value, "dtype", None), "kind", "") == "c":
        lost = "complex numbers"
    elif hasattr(value, "m_as") or hasattr(value, "to_value"):  # of pint and astropy
        lost = "units"
    elif labels is not None and labels.kind not in "iu":  # a data frame without names numbers them
        lost = "names of columns"
    if lost:
        raise Refused(path, Described(f"an array with {lost}"), f"{allowed}; plain numbers")


def require_array(value: Any, path: str, allowed: str, dtype: Any = float) -> NDArray[Any]:
    """Return a value as an array of a type, or refuse it.

    Only numbers become an array of floats. Refused are texts, booleans, dates and complex numbers,
    which numpy would convert, and masked arrays, whose mask it would drop.
    """
    import numpy as np

    try:
        require_plain(value, path, allowed)
        if dtype is float and not _is_numeric(value):
            raise TypeError
        # nothing is lost: masks and units have been refused
        array = np.asarray(value)
        if array.dtype.kind == "O" and dtype is float:  # Decimal, Fraction, columns of pandas
            numbers = [require_real(x, path, allowed) for x in array.flat]
            array = np.array(numbers).reshape(array.shape)
        if (dtype is float and array.dtype.kind not in "iuf") or np.ma.is_masked(value):
            raise TypeError
        converted = np.asarray(array, dtype, order="C")
        # numpy rounds floats and wraps large integers: then the indices are not the user's
        if converted.dtype.kind in "iu" and not np.array_equal(converted, array):
            raise TypeError
        return converted
    except Refused:
        raise
    except Exception as error:  # foreign objects may raise any
        raise Refused(path, value, allowed) from error


def _is_numeric(value: Any) -> bool:
    """Return whether a value, or each in a nested list, may be a number: booleans are not.

    In a list with numbers, numpy would turn them into 0 and 1.
    """
    if isinstance(value, list | tuple):
        return all(map(_is_numeric, value))
    kind = getattr(getattr(value, "dtype", None), "kind", "f")
    # which texts and dates lack
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

    Brackets in `ends` say whether the bounds belong to the interval, as in "[)" for
    low <= value < high.
    """
    left, right = ("<=" if end in "[]" else "<" for end in ends)
    allowed = allowed or f"{low:g} {left} {path} {right} {high:g}"
    # most values are floats, which need no conversion
    number = value if type(value) is float else require_real(value, path, allowed)
    if not (_COMPARED[left](low, number) and _COMPARED[right](number, high)):
        raise Refused(path, value, allowed)
    return number


def require_real(value: Any, path: str, allowed: str) -> float:
    """Return a number, also an infinity or nan, as float; refuse any other value."""
    # numpy's booleans, dates and complex numbers convert to float, too
    kind = getattr(getattr(value, "dtype", None), "kind", "f")
    is_number = hasattr(value, "__float__") or hasattr(value, "__index__")
    try:
        is_array = bool(getattr(value, "ndim", 0)) or hasattr(value, "mask")
        if isinstance(value, bool) or not is_number or kind not in "iufO" or is_array:
            raise TypeError
        return float(value)
    except Exception as error:  # foreign objects may raise any
        raise Refused(path, value, allowed) from error


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
    """Refuse all but seeds of random numbers, which are keys of 64 bits."""
    require_whole(value, 0, 2**64 - 1, "seed", "an integer 0 <= seed < 2^64")


def require_range(
    value: Any, low: float, high: float, path: str, ends: str = "[]", allowed: str = ""
) -> NDArray[Any]:
    """Return numbers of an interval as an array, or refuse the first one outside.

    For `ends` see `require_between`.
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
    """Refuse booleans and texts that pydantic takes for numbers, and numbers beyond `LARGEST`."""
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
    """Refuse an output file that cannot be written, before the computation starts.

    Parameters
    ----------
    path : path
        Output file.
    inputs : iterable of path or None
        Files that the computation reads, and its other outputs; None is ignored.
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
        # a link is written where its target lies
        folder = Path(os.path.realpath(path)).parent
        read_only = not (folder.is_dir() and os.access(folder, os.W_OK))
        if status is not None:
            # without any write bit a file is read-only, although the superuser could write it
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
    # a file may have several names: links, or upper and lower case on some file systems
    if exists and os.path.exists(name):
        return os.path.samefile(name, path)
    return os.path.realpath(name) == os.path.realpath(path)


def did_you_mean(word: Any, words: Iterable[str]) -> str:
    """Return a hint at words of similar spelling, or at dotted ones that end alike, or ""."""
    # the time of the search grows faster than the square of the length
    if not isinstance(word, str) or len(word) > 100:
        return ""
    words = list(words)
    near = difflib.get_close_matches(word, words)
    if not near:
        ends = {key: key.rpartition(".")[2] for key in words if "." in key}
        alike = difflib.get_close_matches(word.rpartition(".")[2], set(ends.values()), 1)
        near = [key for key, end in ends.items() if end in alike][:3]
    return f"did you mean {' or '.join(near)}?" if near else ""


def join_path(path: str, *keys: int | str) -> str:
    """Return a path extended by keys of tables and indices of lists."""
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
    """Return the text of a value, as Python writes it, on one short line."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Described):
        return _shortened(one_line(value))
    try:
        if getattr(value, "ndim", None) == 0:  # numpy's numbers
            value = value.item()
        elif getattr(value, "size", 9) == 0 and hasattr(value, "tolist"):  # an empty array is []
            value = value.tolist()
        text = one_line(repr(value))
    except RecursionError:
        return "tables nested too deeply"
    except Exception:  # Python writes no integer of more than 4300 digits; other objects may fail
        huge = isinstance(value, int)
        return "a huge integer" if huge else f"a {type(value).__name__} without a text"
    return text if len(text) <= 60 else f"{text[:57]}..."


def _shortened(text: str, most: int = 400) -> str:
    """Return a text without its middle if it is longer than `most` characters."""
    return text if len(text) <= most else f"{text[: most // 2]}...{text[-most // 2 :]}"


def one_line(value: object) -> str:
    """Return the text of a value on one line, with single spaces."""
    return " ".join(str(value).split())


_NUMBER = re.compile(r"(?<![\w.])-?\d[\d,]*\.?\d*(?:e[-+]?\d+)?(?!\w)")


def without_numbers(text: str) -> str:
    """Return a text with # in place of each number."""
    return _NUMBER.sub("#", text)


def in_ranges(lines: Iterable[str]) -> list[str]:
    """Merge lines that differ in their numbers alone into one with the ranges of the numbers.

    Examples
    --------
    >>> in_ranges(["5 m: 0.1 A", "10 m: 0.1 A", "15 m: 0.1 A"])
    ['5 to 15 m: 0.1 A']
    """
    alike: dict[str, list[str]] = {}
    for line in lines:
        alike.setdefault(without_numbers(line), []).append(line)
    merged = []
    for group in alike.values():
        columns = zip(*map(_NUMBER.findall, group), strict=True)
        ends = (sorted(set(c), key=lambda word: float(word.replace(",", ""))) for c in columns)
        numbers = (f"{c[0]} to {c[-1]}" if len(c) > 1 else c[0] for c in ends)
        parts = _NUMBER.split(group[0])
        merged.append(
            "".join(itertools.chain(*itertools.zip_longest(parts, numbers, fillvalue="")))
        )
    return merged


def warn(text: str, category: type[Warning] = UserWarning) -> None:
    """Warn at the line of the user's code that calls the package."""
    level, frame = 2, sys._getframe(1)
    # parts are built inside of pydantic, and blocks end inside of contextlib
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in (
        "meshtrace", "pydantic", "contextlib"
    ):  # fmt: skip
        level, frame = level + 1, frame.f_back
    warnings.warn(text, category, stacklevel=level)


def reason_of(error: Exception) -> str:
    """Return the text of an error as one line, or the name of its type if it has none."""
    return one_line(error) or type(error).__name__


class InputWarning(UserWarning):
    """Input was converted (units, formats), or some of its columns or rows were left out."""


def warn_of_input(text: str) -> None:
    """Warn in one line of a conversion of input."""
    warn(one_line(text), InputWarning)


class DomainWarning(UserWarning):
    """The gain is in doubt: light left the mesh or was neglected, or the mesh is too coarse."""
