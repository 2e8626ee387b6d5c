"""Cells of tables in text, arrays and data frames, with their headings and comments."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshtrace.errors import (
    Described,
    Refused,
    reads_as_number,
    reason_of,
    require_array,
    show,
    warn_of_input,
)

_LARGEST = 16 * 2**20  # bytes of a text file
_MOST_COMMENTS = 10_000  # of a text: each is tried as a heading, which takes time
TEXT = "a text file of columns of numbers"
SEPARATORS = (";", "\t", ",", " ")
_COMMENTS = ("#", "%", "!", "//")
_MISSING = frozenset(("", "nan", "na", "n/a", "<na>", "nat", "null", "none", "-", "--", "---"))
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
_FORTRAN = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))[dD]([+-]?\d+)")

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Cells:
    """Cells of a table by columns, and the texts above them.

    A column is a sequence of words, or an array with nan for missing numbers. `places` are the
    line numbers in a file, or the row numbers in an array, from 1 on; `place` says which, for error
    messages. `heads` are the heading lines above the columns, `remarks` the comments before the
    first row, `labels` the names of the columns of a data frame or a structured array.
    """

    name: str
    columns: Sequence[Any]
    places: Sequence[int]
    heads: Sequence[str] = ()
    remarks: Sequence[str] = ()
    labels: Sequence[str] = ()
    place: str = "line"
    separator: str = " "
    decimal_comma: bool = False
    # what was converted or left out, told in one warning at the end
    notes: list[str] = field(default_factory=list)

    def numbers(self, index: int, text: str = "") -> Floats:
        """Return a column as numbers, nan where missing; errors name its heading, `text`."""
        column = self.columns[index]
        if isinstance(column, np.ndarray):
            return column
        try:
            # the slow way by words: numpy accepts 1_000, which is refused here, and refuses 1,5
            if self.decimal_comma or any("_" in word for word in column):
                raise ValueError
            return np.array(column, dtype=np.float64)
        except ValueError:
            return np.array([self._number(row, index, text) for row in range(len(column))])

    def _number(self, row: int, index: int, text: str) -> float:
        """Parse a number; return nan for the marker of a missing value."""
        word = self.columns[index][row].strip()
        if word.lower() in _MISSING:
            return np.nan
        # Fortran writes double precision as 1.0d-3
        number = _FORTRAN.sub(r"\1e\2", word)
        if self.decimal_comma:
            if "." in word:
                raise self.refused(row, index, text, show(word), "with decimal commas alone")
            number = number.replace(",", ".", 1)
        if "_" in number or not reads_as_number(number):
            raise self.refused(row, index, text, show(word), "all finite")
        return float(number)

    def finite(self, index: int, text: str = "") -> Floats:
        """Return a column as numbers; refuse missing and non-finite values."""
        values = self.numbers(index, text)
        if wrong := np.flatnonzero(~np.isfinite(values)).tolist():
            problem = "missing" if np.isnan(values[wrong[0]]) else str(values[wrong[0]])
            raise self.refused(wrong[0], index, text, problem, "all finite")
        return values

    def refused(self, row: int, index: int, text: str, problem: str, allowed: str) -> Refused:
        """Return the refusal of a cell, with its place, for the caller to raise."""
        where = f"{self.place} {self.places[row]}, column {text or index + 1}"
        kind = TEXT if self.place == "line" else "columns of numbers"
        return Refused(self.name, Described(f"{where}: {problem}"), f"{kind}, {allowed}")

    def counts(self, index: int) -> bool:
        """Return whether a column only numbers the rows, from 0 or 1 on."""
        try:
            values = self.numbers(index)
        except Refused:
            return False
        first = values[0] if len(values) else np.nan
        return first in (0.0, 1.0) and np.array_equal(values, first + np.arange(len(values)))

    def warn(self) -> None:
        """Warn of all conversions and omissions."""
        if self.notes:
            warn_of_input(f"{self.name}: {'; '.join(self.notes)}")


def _reads(word: str, comma: bool = True) -> bool:
    """Return whether a word is a number, also of Fortran or, with `comma`, with a decimal comma."""
    plain = _FORTRAN.sub(r"\1e\2", word)
    return reads_as_number(plain) or (comma and bool(_DECIMAL_COMMA.fullmatch(plain)))


def cells_of(
    source: Any, name: str, delimiter: str | None = None, heads: int | None = None
) -> Cells:
    """Return the cells of a text file, an array, a structured array or a data frame.

    Parameters
    ----------
    source, name, delimiter
        As in `tables.read_columns`; masked entries of arrays are missing.
    heads : int, optional
        Number of heading lines in a text; by default those without numbers at the top.
    """
    if isinstance(source, str | PathLike):
        return cells_of_text(text_of(source), str(source), delimiter, heads)
    if hasattr(source, "columns") and hasattr(source, "iloc"):
        return _cells_of_frame(source, name)
    # of xarray, pint and astropy: units and coordinates would be lost
    if hasattr(source, "dims") or hasattr(source, "units") or hasattr(source, "unit"):
        problem = Described(f"{type(source).__name__} with attributes")
        raise Refused(name, problem, "a path, a plain array or a data frame")
    return _cells_of_array(source, name)


def text_of(path: str | PathLike[str], errors: str = "strict") -> str:
    """Return the text of a file in UTF-8, or refuse it; `errors` as in `bytes.decode`."""
    file = Path(path)
    try:
        if not file.is_file():
            raise Refused(str(path), Described("no such file"), TEXT)
        if file.stat().st_size > _LARGEST:
            raise Refused(str(path), Described("above 16 MB"), TEXT)
        text = file.read_bytes().decode("utf-8-sig", errors)
    except UnicodeDecodeError as error:
        raise Refused(str(path), Described("no text in UTF-8"), TEXT) from error
    except (OSError, ValueError) as error:
        if isinstance(error, Refused):
            raise
        raise Refused(str(path), Described(reason_of(error)), TEXT) from error
    if "\0" in text:
        raise Refused(str(path), Described("no text"), TEXT)
    return text


def cells_of_text(
    text: str, name: str, delimiter: str | None = None, heads: int | None = None, first: int = 1
) -> Cells:
    """Return the cells of a text; `first` is the number of its first line in its file."""
    # (line number, line without comment)
    lines, comments = list[tuple[int, str]](), list[tuple[int, str]]()
    for number, line in enumerate(re.split(r"\r\n|\r|\n", text), first):
        if line.lstrip(" \t").startswith(_COMMENTS):
            comments.append((number, re.sub(r"^\s*(?:[#%!]|//)+", "", line).strip()))
        elif (words := line.partition("#")[0].strip(" ")).strip():
            lines.append((number, words))
    if not lines:
        raise Refused(name, Described("no rows"), TEXT)
    if len(comments) > _MOST_COMMENTS:
        problem = Described(f"{len(comments)} comments")
        raise Refused(name, problem, f"{TEXT}, of {_MOST_COMMENTS} comments at most")
    # judged by the last line, which is least likely to be a heading
    separator = delimiter or _separator(lines[-1][1])
    lines_of_words = [split(line, separator) for _, line in lines]
    above = _heads(lines_of_words) if heads is None else heads
    body, places = lines_of_words[above:], [number for number, _ in lines[above:]]
    if not body:
        raise Refused(name, Described(f"no numbers below {lines[-1][1]}"), TEXT)
    # a separator at the end of every line does not begin a further column
    if all(len(row) > 1 and row[-1] == "" for row in body):
        body = [row[:-1] for row in body]
    return Cells(
        name,
        list(zip(*_even(body, places, name), strict=True)),
        places,
        [line for _, line in lines[:above]],
        [line for number, line in comments if number < places[0] and line],
        separator=separator,
        # between other separators a comma separates words
        decimal_comma=separator in (";", "\t")
        and any(_DECIMAL_COMMA.fullmatch(word) for row in body for word in row),
    )


def _even(lines_of_words: list[list[str]], places: Sequence[int], name: str) -> list[list[str]]:
    """Cut words after the last column; refuse rows of unequal length."""
    width = min(map(len, lines_of_words))
    for place, row in zip(places, lines_of_words, strict=True):
        if not all(word[:1].isalpha() and not reads_as_number(word) for word in row[width:]):
            shortest = places[[len(row) for row in lines_of_words].index(width)]
            problem = Described(f"line {shortest}: {width} columns, line {place}: {len(row)}")
            raise Refused(name, problem, f"{TEXT}, as many in each line")
    return [row[:width] for row in lines_of_words]


def split(line: str, separator: str) -> list[str]:
    """Split a line into stripped words; quoted words may contain the separator."""
    if '"' in line and len(separator) == 1:
        text = " ".join(line.split()) if separator == " " else line
        try:
            words = next(csv.reader([text], delimiter=separator, skipinitialspace=True))
        except csv.Error:  # a field above the limit of the csv module
            words = line.split(separator)
    else:
        words = line.split(None if separator == " " else separator)
    return [word.strip() for word in words]


def _separator(line: str) -> str:
    """Return the separator that gives the most numbers."""

    def count(separator: str) -> int:
        words = split(line, separator)
        numbers = [_reads(word, separator in (";", "\t")) for word in words]
        return sum(numbers) if len(words) > 1 else 0

    return max(SEPARATORS, key=count)


def _heads(lines_of_words: list[list[str]]) -> int:
    """Count the heading lines, which have words in the columns of numbers."""
    of_numbers = [i for i, word in enumerate(lines_of_words[-1]) if _reads(word)]
    # at most two: names and units
    for above, row in enumerate(lines_of_words[:3]):
        words = [row[i] for i in of_numbers if i < len(row)]
        if words and all(_reads(w) or w.lower() in _MISSING for w in words):
            return above
    # a wrong word in the last line or in the first rows: down to the first line with a number
    return next(
        (i for i, row in enumerate(lines_of_words) if any(map(_reads, row))), len(lines_of_words)
    )


def _cells_of_frame(frame: Any, name: str) -> Cells:
    """Return the cells of a data frame; its index is a column if it has a name or holds times."""
    import pandas as pd

    if isinstance(frame.columns, pd.MultiIndex) or isinstance(frame.index, pd.MultiIndex):
        raise Refused(name, Described("labels of several levels"), "labels of one level")
    if "units" in frame.attrs or "unit" in frame.attrs:
        allowed = "units in the names of the columns, as in eta [mm]"
        raise Refused(name, Described("units in attributes"), allowed)
    columns = [(str(label), frame.iloc[:, i]) for i, label in enumerate(frame.columns)]
    # such an index holds data, in contrast to the default of pandas
    if frame.index.name is not None or frame.index.dtype.kind in "mM":
        columns.insert(0, (str(frame.index.name or "time"), frame.index.to_series()))
    elif frame.index.dtype.kind == "f":
        problem = Described("an index without name")
        raise Refused(name, problem, "an index with the name of a column")
    # pandas labels columns 0, 1, ... if none are given: no names
    has_names = len(columns) > frame.shape[1] or not isinstance(frame.columns, pd.RangeIndex)
    cells = Cells(
        name,
        [_of_series(series) for _, series in columns],
        range(1, len(frame) + 1),
        labels=[label for label, _ in columns] if has_names else (),
        place="row",
    )
    if any(series.dtype.kind in "mM" for _, series in columns):
        cells.notes.append("times counted in seconds from the first")
    return cells


def _of_series(series: Any) -> Any:
    """Return a column of a data frame as numbers, times as seconds, anything else as words."""
    import pandas as pd

    if series.dtype.kind in "mM":
        return ((series - series.iloc[0]) / pd.Timedelta("1s")).to_numpy(np.float64)
    if pd.api.types.is_numeric_dtype(series) and series.dtype.kind in "iuf":
        return series.to_numpy(np.float64, na_value=np.nan)
    return tuple(map(str, series))


def _cells_of_array(source: Any, name: str) -> Cells:
    """Return the cells of an array of numbers; masked entries are missing."""
    labels = getattr(getattr(source, "dtype", None), "names", None) or ()
    if labels:
        source = np.ma.stack([np.ma.asarray(source[label]) for label in labels], axis=-1)
    allowed = "(rows, columns) of numbers"
    # False: nothing is masked
    mask = np.ma.getmaskarray(source) if isinstance(source, np.ma.MaskedArray) else False
    array = require_array(np.ma.getdata(source) if labels or mask is not False else source,
                          name, allowed)  # fmt: skip
    if array.ndim != 2 or not array.size:
        raise Refused(name, Described(f"shape {array.shape}"), allowed)
    columns = list(np.where(mask, np.nan, array).T)
    return Cells(name, columns, range(1, len(array) + 1), labels=labels, place="row")
