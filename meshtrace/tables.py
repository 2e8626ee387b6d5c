"""Tables of text, arrays and data frames are read by their headings; aligned rows are written.

A subject declares its columns (`Column`); `read_columns` finds them by name and unit, converts
their units, and refuses what it does not understand by file, row and column. Without any heading
columns are read by place.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from io import StringIO
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

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
from meshtrace.units import convert, is_convertible, is_same, is_unit

_LARGEST = 16 * 2**20  # bytes
_TEXT = "a text file of columns of numbers"
_SEPARATORS = (";", "\t", ",", " ")
_COMMENTS = ("#", "%", "!", "//")
_MISSING = frozenset(("", "nan", "na", "n/a", "<na>", "nat", "null", "none", "-", "--", "---"))
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
_FORTRAN = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))[dD]([+-]?\d+)")
_GREEK = str.maketrans({"θ": "theta", "λ": "lambda", "ω": "omega", "η": "eta", "ζ": "zeta",
                        "β": "beta", "ψ": "psi"})  # fmt: skip
_ARGUMENTS = frozenset(("f", "w", "omega", "lambda", "theta", "psi", "t", "x,t", "x"))
"""Symbols in round brackets that are arguments, as in S(f), and no units."""

_IN_REMARKS = re.compile(
    r"\b(?:rad(?:ians?)?|deg(?:rees?)?|hz|hertz|mm|cm|ft|feet|inch(?:es)?|um|microns?|nm|"
    r"k?h?pa|d?m?bar|psi|ms)(?![^\W\d])|[µμ]m|%|\bper\s*cent",
    re.IGNORECASE,
)
"""Units that would change a column; other words of a remark are read as words."""

Floats = NDArray[np.float64]


class Column(NamedTuple):
    """Column that a subject needs.

    Parameters
    ----------
    name : str
        Name in the result, and the first name of a heading.
    unit : str
        Wanted unit.
    aliases : tuple of str
        Other names of headings.
    units : mapping of str to str
        Units of names that stand for another unit than the wanted one, where none is stated:
        ``{"f": "Hz"}`` of a column of angular frequencies.
    required : bool
        Whether the table has to have the column.
    relative : bool
        Whether the scale of the values is without meaning: their unit is not converted, and they
        may have any name if no other column is left.
    """

    name: str
    unit: str
    aliases: tuple[str, ...] = ()
    units: Mapping[str, str] = {}
    required: bool = True
    relative: bool = False

    def is_named(self, name: str) -> bool:
        """Return whether the name of a heading is that of this column."""
        return re.sub(r"_?\(.*\)$", "", name) in map(
            normal, (self.name, *self.aliases, *self.units)
        )

    def __str__(self) -> str:
        """Return name and unit as a heading has them."""
        unit = "" if self.relative or self.unit == "1" else f" [{self.unit}]"
        return f"{self.name}{unit}{'' if self.required else ' (if any)'}"


class Heading(NamedTuple):
    """Text of a heading, the name in it in lower case, and its unit if it states one."""

    text: str
    name: str
    unit: str | None = None


class Series(NamedTuple):
    """Values of a column in its wanted unit, and the heading that they had, if any."""

    values: Floats
    heading: Heading | None


@dataclass(frozen=True)
class Cells:
    """Cells of a table by columns, and the texts above them.

    Columns are sequences of words, or arrays with nan for missing numbers. `places` are the lines
    of a file, or the rows of an array from 1 on. `heads` are lines of words above the columns,
    `remarks` the comments before them, `labels` the names of the columns of a data frame.
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
    notes: list[str] = field(default_factory=list)

    def numbers(self, index: int, text: str = "") -> Floats:
        """Return a column as numbers, nan where they are missing."""
        column = self.columns[index]
        if isinstance(column, np.ndarray):
            return column
        try:
            if self.decimal_comma or any("_" in word for word in column):
                raise ValueError
            return np.array(column, dtype=np.float64)
        except ValueError:
            return np.array([self._number(row, index, text) for row in range(len(column))])

    def _number(self, row: int, index: int, text: str) -> float:
        word = self.columns[index][row].strip()
        if word.lower() in _MISSING:
            return np.nan
        number = _FORTRAN.sub(r"\1e\2", word)
        if self.decimal_comma:
            if "." in word:
                raise self.refused(row, index, text, show(word), "with decimal commas alone")
            number = number.replace(",", ".", 1)
        if "_" in number or not reads_as_number(number):
            raise self.refused(row, index, text, show(word), "all finite")
        return float(number)

    def finite(self, index: int, text: str = "") -> Floats:
        """Return a column of finite numbers; refuse the first that is none."""
        values = self.numbers(index, text)
        if wrong := np.flatnonzero(~np.isfinite(values)).tolist():
            found = "missing" if np.isnan(values[wrong[0]]) else str(values[wrong[0]])
            raise self.refused(wrong[0], index, text, found, "all finite")
        return values

    def refused(self, row: int, index: int, text: str, found: str, allowed: str) -> Refused:
        """Return the refusal of a cell."""
        where = f"{self.place} {self.places[row]}, column {text or index + 1}"
        kind = _TEXT if self.place == "line" else "columns of numbers"
        return Refused(self.name, Described(f"{where}: {found}"), f"{kind}, {allowed}")

    def counts(self, index: int) -> bool:
        """Return whether a column counts the rows, from 0 or 1 on."""
        try:
            values = self.numbers(index)
        except Refused:
            return False
        first = values[0] if len(values) else np.nan
        return first in (0.0, 1.0) and np.array_equal(values, first + np.arange(len(values)))

    def tell(self) -> None:
        """Say in one line what was made of the table."""
        if self.notes:
            warn_of_input(f"{self.name}: {'; '.join(self.notes)}")


def read_columns(
    source: Any, columns: Sequence[Column], name: str = "source", delimiter: str | None = None
) -> dict[str, Series]:
    """Read columns of numbers from a text file, an array or a data frame.

    Parameters
    ----------
    source : path, array_like of shape (rows, columns), or pandas.DataFrame
        Text: columns separated by commas, semicolons or tabs (numbers may then have decimal
        commas) or spaces. A first line of words, labels of a data frame or names of a structured
        array are headings, and so is a comment (``#``) with a name for each column, as
        `numpy.savetxt` writes it. A heading is a name with or without unit: "a [1/m]", "a (1/m)",
        "a_1/m", "a 1/m"; a second line may hold the units.
    columns : sequence of Column
        Wanted columns; without headings they are read by place, in this order.
    name : str
        Name of the argument, for errors about arrays.
    delimiter : str, optional
        Separator of the columns of a text, by default the one in use.

    Returns
    -------
    dict of str to Series
        By the names of the columns, those that are not there left out.

    Raises
    ------
    Refused
        If the table cannot be read, a heading is not understood, a column is missing or there
        twice, a unit is of another kind, or a number is missing or not finite.

    Warns
    -----
    InputWarning
        If a unit was converted or a column left out.
    """
    cells = cells_of(source, name, delimiter)
    headings = headings_of(cells, columns)
    table = dict[str, Series]()
    match = _matched(cells, headings, columns)
    for column in columns:
        if (index := match.get(column.name)) is None:
            continue
        heading = headings[index] if headings else None
        values = cells.finite(index, heading.text if heading else "")
        table[column.name] = Series(_converted(values, column, heading, cells), heading)
    cells.tell()
    return table


def _converted(values: Floats, column: Column, heading: Heading | None, cells: Cells) -> Floats:
    """Return values in the wanted unit of their column."""
    if column.relative or heading is None:
        return values
    usual = {normal(name): unit for name, unit in column.units.items()}.get(
        re.sub(r"_?\(.*\)$", "", heading.name), column.unit
    )
    unit = usual if heading.unit is None else heading.unit
    where = f"{cells.name}: column {heading.text}"
    usual_values = convert(values, unit, usual, where)
    if not is_convertible(usual, column.unit):
        return usual_values
    wanted = convert(usual_values, usual, column.unit, where)
    if not np.array_equal(wanted, values):
        cells.notes.append(f"{column.name} in {unit} converted to {column.unit}")
    return wanted


def _matched(
    cells: Cells, headings: Sequence[Heading], columns: Sequence[Column]
) -> dict[str, int]:
    """Return the places of the columns by their names."""
    wanted = f"columns {', '.join(map(str, columns))}"
    if not headings:
        width, needed = len(cells.columns), [c for c in columns if c.required]
        if width == len(columns):
            needed = list(columns)
        if width != len(needed):
            found = Described(f"{width} columns without headings")
            allowed = f"{_TEXT}: {wanted} in this order, or headings"
            raise Refused(cells.name, found, allowed)
        return {column.name: index for index, column in enumerate(needed)}
    match = dict[str, int]()
    for index, heading in enumerate(headings):
        for column in columns:
            if heading.name and column.is_named(heading.name):
                if column.name in match:
                    twice = f"{headings[match[column.name]].text} and {heading.text}"
                    raise Refused(cells.name, Described(twice), f"one column {column}")
                match[column.name] = index
    left = [i for i in range(len(headings)) if i not in match.values() and headings[i].name != "#"]
    for column in columns:
        if column.name in match:
            continue
        alike = [c for c in columns if not c.relative and is_convertible(c.unit, column.unit)]
        by_unit = [i for i in left if len(alike) == 1 and _is_of(headings[i], column)]
        if column.relative and len(left) == 1:
            by_unit = left
        if len(by_unit) == 1 and (column.required or headings[by_unit[0]].name == ""):
            match[column.name] = by_unit[0]
            left = [i for i in left if i != by_unit[0]]
        elif column.required or by_unit or any(_is_like(headings[i], column) for i in left):
            texts = Described(", ".join(h.text or "(none)" for h in headings))
            raise Refused(cells.name, texts, wanted)
    return match


def _is_of(heading: Heading, column: Column) -> bool:
    """Return whether a heading states the unit of a column; any unit of its kind if required."""
    if column.relative or column.unit == "1" or heading.unit is None:
        return False
    kind = is_convertible if column.required else is_same
    return kind(heading.unit, column.unit)


def _is_like(heading: Heading, column: Column) -> bool:
    """Return whether the name of a heading contains one of a column that may be left out."""
    names = (normal(name) for name in (column.name, *column.aliases))
    return heading.name == "" or any(len(n) > 3 and n in heading.name for n in names)


# ------------------------------------------------------------------------------------- headings


def _reads(word: str, comma: bool = True) -> bool:
    """Return whether a word is a number, of Fortran or with a decimal comma included."""
    plain = _FORTRAN.sub(r"\1e\2", word)
    return reads_as_number(plain) or (comma and bool(_DECIMAL_COMMA.fullmatch(plain)))


def normal(name: str) -> str:
    """Return a name in lower case, with underscores for spaces and points."""
    text = name.translate(_GREEK).strip(" \t\"'$\\").replace("\\", "")
    return re.sub(r"[\s_.:\-]+", "_", text.lower()).strip("_")


def headings_of(cells: Cells, columns: Sequence[Column]) -> list[Heading]:
    """Return a heading for each column of a table, or none.

    A column that only counts rows has the name "#".

    Raises
    ------
    Refused
        If the headings are not as many as the columns, or a comment may be a heading but is not
        understood.
    """
    if cells.labels:
        return [heading_of(label, columns) for label in cells.labels]
    allowed = "a heading with name and unit for each column: " + ", ".join(map(str, columns))
    width = len(cells.columns)
    if cells.heads:
        words = headings_in(cells.heads[0], cells)
        if len(words) == width - 1 and cells.counts(0):
            words.insert(0, "")
        if len(words) != width or len(cells.heads) > 2:
            found = " / ".join(cells.heads)
            raise Refused(cells.name, Described(f"{found} over {width} columns"), allowed)
        return _with_units(cells, words, cells.heads[1:], columns)
    best, known = list[Heading](), 0
    for number, remark in enumerate(cells.remarks):
        words = headings_in(remark, cells)
        following = cells.remarks[number + 1 : number + 2]
        if len(words) == width == len(list(filter(None, words))):
            headings = _with_units(cells, words, following, columns)
            count = sum(any(c.is_named(h.name) for c in columns) or bool(h.unit) for h in headings)
            if count >= max(known, 1):
                best, known = headings, count
    for remark in () if best else cells.remarks:
        words = headings_in(remark, cells)
        separated = len(words) == width > 1 and not any(map(reads_as_number, words))
        if (separated and remark == cells.remarks[-1]) or tells(remark, columns):
            raise Refused(cells.name, Described(f"# {remark}"), allowed)
    return best


def tells(remark: str, columns: Sequence[Column]) -> bool:
    """Return whether a remark names a unit, and none of the columns has it."""
    for unit in _IN_REMARKS.findall(remark):
        if unit == "%" or unit.lower().startswith("per"):
            if any(column.unit == "1" for column in columns):
                return True
            continue
        forms = (f"{unit}2 s rad-1", unit, f"1/{unit}", f"1/{unit} sr-1")
        factors = [
            float(convert(1.0, form, column.unit, ""))
            for column in columns
            for form in (forms[:1] if column.relative else forms)
            if is_convertible(form, column.unit)
        ]
        lengths = any(column.unit == "m" for column in columns)
        if (factors and 1.0 not in factors) or (lengths and is_convertible(unit, "Pa")):
            return True
    return False


def _with_units(
    cells: Cells, words: Sequence[str], below: Sequence[str], columns: Sequence[Column]
) -> list[Heading]:
    """Return the headings of words, with the units of the line below if it has some."""
    headings = [heading_of(word, columns) for word in words]
    for line in below:
        units = [u.strip("[](){} ") for u in headings_in(line, cells)]
        known = [is_unit(unit) for unit in units]
        if len(units) == len(words) and (all(known) or (line in cells.heads and any(known))):
            for index, unit in enumerate(units):
                stated = headings[index].unit
                if unit and stated not in (None, unit):
                    found = Described(f"{headings[index].text} in {unit}")
                    raise Refused(cells.name, found, "one unit for each column")
                headings[index] = headings[index]._replace(unit=unit or stated)
        elif line in cells.heads:
            raise Refused(cells.name, Described(line), f"a unit for each of {', '.join(words)}")
    for index, heading in enumerate(headings):
        if heading.name in ("", "unnamed_0", "index") and heading.unit is None:
            if cells.counts(index):
                headings[index] = heading._replace(name="#")
                cells.notes.append(f"column {index + 1}, which counts the rows, left out")
            elif not heading.name:
                found = Described(f"column {index + 1} without heading")
                raise Refused(cells.name, found, ", ".join(map(str, columns)))
    return headings


def heading_of(text: str, columns: Sequence[Column]) -> Heading:
    """Return a heading: a name with a unit in brackets or behind the name, or one of both."""
    plain = text.strip(" \t\"'")
    if match := re.fullmatch(r"(.*?)[\s_/:,;]*[\[{<](.*)[\]}>]", plain):
        return Heading(text, normal(match[1]), match[2].strip())
    match = re.fullmatch(r"(.*?)[\s_/:,;]*\(((?:[^()]|\([^()]*\))*)\)", plain)
    if match and match[2].translate(_GREEK).strip() not in _ARGUMENTS:
        return Heading(text, normal(match[1]), re.sub(r"^in\s+", "", match[2].strip()))
    if any(column.is_named(normal(plain)) for column in columns):
        return Heading(text, normal(plain))
    for cut in re.finditer(r"[\s_/,:.]+(?:in\s+)?", plain):
        name, unit = normal(plain[: cut.start()]), plain[cut.end() :]
        # underscores of names stand for products or quotients: omega_rad_s
        for spelled in (unit.replace("_", " "), unit.replace("_", "/")):
            if any(c.is_named(name) and _is_unit(spelled, c) for c in columns):
                return Heading(text, name, spelled)
    if any(_is_unit(plain, c) for c in columns if not c.relative or plain in ("%", "percent")):
        return Heading(text, "", plain)
    return Heading(text, normal(plain))


def _is_unit(text: str, column: Column) -> bool:
    """Return whether a text is a unit of a column."""
    if not re.search(r"[^\W\d_]|%", text):
        return False
    if column.relative:
        return is_unit(text)
    return any(is_convertible(text, unit) for unit in (column.unit, *column.units.values()))


def headings_in(line: str, cells: Cells) -> list[str]:
    """Return the words of a line, by the separator that gives as many as there are columns."""
    width = len(cells.columns)
    usual = [cells.separator] if cells.separator != " " else []
    ways = [_bracketed(line, way) for way in dict.fromkeys((*usual, *_SEPARATORS))]
    ways.append([word.strip() for word in re.split(r"\s{2,}|\t", line.strip())])
    for words in ways:
        if len(words) == width + 1 and not words[-1]:
            words.pop()
        if len(words) == width:
            return words
    return next((words for words in ways if len(words) > 1), ways[0])


def _bracketed(line: str, separator: str) -> list[str]:
    """Return the words of a line, each with the unit in brackets that follows it."""
    if separator != " " or '"' in line:
        return _split(line, separator)
    word, unit = r"[^\s\[\](){}]+(?:\([^()\s]*\))?", r"\[[^\[\]]*\]|\((?:[^()]|\([^()]*\))*\)"
    return re.findall(rf"{word}\s*(?:{unit})|{word}|\S+", line)


# ---------------------------------------------------------------------------------------- cells


def cells_of(
    source: Any, name: str, delimiter: str | None = None, heads: int | None = None
) -> Cells:
    """Return the cells of a text file, an array, a structured array or a data frame.

    Parameters
    ----------
    source, name, delimiter
        As in `read_columns`; masked entries of arrays are missing.
    heads : int, optional
        Number of lines of headings in a text, by default those without numbers.
    """
    if isinstance(source, str | PathLike):
        return cells_of_text(text_of(source), str(source), delimiter, heads)
    if hasattr(source, "columns") and hasattr(source, "iloc"):
        return _cells_of_frame(source, name)
    if hasattr(source, "dims") or hasattr(source, "units") or hasattr(source, "unit"):
        found = Described(f"{type(source).__name__} with attributes")
        raise Refused(name, found, "a path, a plain array or a data frame")
    return _cells_of_array(source, name)


def text_of(path: str | PathLike[str]) -> str:
    """Return the text of a file, or refuse it."""
    file = Path(path)
    try:
        if not file.is_file():
            raise Refused(str(path), Described("no such file"), _TEXT)
        if file.stat().st_size > _LARGEST:
            raise Refused(str(path), Described("above 16 MB"), _TEXT)
        text = file.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise Refused(str(path), Described("no text in UTF-8"), _TEXT) from error
    except (OSError, ValueError) as error:
        if isinstance(error, Refused):
            raise
        raise Refused(str(path), Described(reason_of(error)), _TEXT) from error
    if "\0" in text:
        raise Refused(str(path), Described("no text"), _TEXT)
    return text


def cells_of_text(
    text: str, name: str, delimiter: str | None = None, heads: int | None = None, first: int = 1
) -> Cells:
    """Return the cells of a text whose first line has the number `first`."""
    lines, comments = list[tuple[int, str]](), list[tuple[int, str]]()
    for number, line in enumerate(re.split(r"\r\n|\r|\n", text), first):
        if line.lstrip(" \t").startswith(_COMMENTS):
            comments.append((number, re.sub(r"^\s*(?:[#%!]|//)+", "", line).strip()))
        elif (words := line.partition("#")[0].strip(" ")).strip():
            lines.append((number, words))
    if not lines:
        raise Refused(name, Described("no rows"), _TEXT)
    separator = delimiter or _separator(lines[-1][1])
    rows = [_split(line, separator) for _, line in lines]
    above = _heads(rows) if heads is None else heads
    body, places = rows[above:], [number for number, _ in lines[above:]]
    if not body:
        raise Refused(name, Described(f"no numbers below {lines[-1][1]}"), _TEXT)
    if all(len(row) > 1 and row[-1] == "" for row in body):  # rows that end with the separator
        body = [row[:-1] for row in body]
    return Cells(
        name,
        list(zip(*_even(body, places, name), strict=True)),
        places,
        [line for _, line in lines[:above]],
        [line for number, line in comments if number < places[0] and line],
        separator=separator,
        decimal_comma=separator in (";", "\t")
        and any(_DECIMAL_COMMA.fullmatch(word) for row in body for word in row),
    )


def _even(rows: list[list[str]], places: Sequence[int], name: str) -> list[list[str]]:
    """Return rows of as many columns, without the words that follow some; refuse others."""
    width = min(map(len, rows))
    for place, row in zip(places, rows, strict=True):
        if not all(word[:1].isalpha() and not reads_as_number(word) for word in row[width:]):
            short = places[[len(row) for row in rows].index(width)]
            found = Described(f"line {short}: {width} columns, line {place}: {len(row)}")
            raise Refused(name, found, f"{_TEXT}, as many in each line")
    return [row[:width] for row in rows]


def _split(line: str, separator: str) -> list[str]:
    """Return the stripped words of a line; those in quotes may hold the separator."""
    if '"' in line and len(separator) == 1:
        text = " ".join(line.split()) if separator == " " else line
        try:
            words = next(csv.reader([text], delimiter=separator, skipinitialspace=True))
        except csv.Error:  # longer than it reads
            words = line.split(separator)
    else:
        words = line.split(None if separator == " " else separator)
    return [word.strip() for word in words]


def _separator(line: str) -> str:
    """Return the separator that gives the most numbers."""

    def count(separator: str) -> int:
        words = _split(line, separator)
        numbers = [_reads(word, separator in (";", "\t")) for word in words]
        return sum(numbers) if len(words) > 1 else 0

    return max(_SEPARATORS, key=count)


def _heads(rows: list[list[str]]) -> int:
    """Return the number of rows above the numbers: of words where the last row has numbers."""
    of_numbers = [i for i, word in enumerate(rows[-1]) if _reads(word)]
    for above, row in enumerate(rows[:3]):
        words = [row[i] for i in of_numbers if i < len(row)]
        if words and all(_reads(w) or w.lower() in _MISSING for w in words):
            return above
    # the last row has a wrong word, or the first ones
    return next((i for i, row in enumerate(rows) if any(map(_reads, row))), len(rows))


def _cells_of_frame(frame: Any, name: str) -> Cells:
    """Return the cells of a data frame; an index with a name or of times is a column as well."""
    import pandas as pd

    if isinstance(frame.columns, pd.MultiIndex) or isinstance(frame.index, pd.MultiIndex):
        raise Refused(name, Described("labels of several levels"), "labels of one level")
    named = isinstance(frame.columns, pd.RangeIndex)
    columns = [(str(label), frame.iloc[:, i]) for i, label in enumerate(frame.columns)]
    if frame.index.name is not None or frame.index.dtype.kind in "mM":
        columns.insert(0, (str(frame.index.name or "time"), frame.index.to_series()))
    elif frame.index.dtype.kind == "f":
        raise Refused(
            name, Described("an index without name"), "an index with the name of a column"
        )
    cells = Cells(
        name,
        [_of_series(series) for _, series in columns],
        range(1, len(frame) + 1),
        labels=()
        if named and len(columns) == len(frame.columns)
        else [label for label, _ in columns],
        place="row",
    )
    if any(series.dtype.kind in "mM" for _, series in columns):
        cells.notes.append("times counted in seconds from the first")
    return cells


def _of_series(series: Any) -> Any:
    """Return a column of a data frame as numbers, or else as words."""
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
    mask = np.ma.getmaskarray(source) if isinstance(source, np.ma.MaskedArray) else False
    array = require_array(np.ma.getdata(source) if labels or mask is not False else source,
                          name, allowed)  # fmt: skip
    if array.ndim != 2 or not array.size:
        raise Refused(name, Described(f"shape {array.shape}"), allowed)
    columns = list(np.where(mask, np.nan, array).T)
    return Cells(name, columns, range(1, len(array) + 1), labels=labels, place="row")


def text_table(rows: Iterable[Sequence[str]], headings: Sequence[str] = ()) -> str:
    """Return rows as an aligned table of text, under headings if there are any.

    Examples
    --------
    >>> print(text_table([("gain", "1e-5"), ("chains", "64")], ("quantity", "value")))
    quantity   value
    ────────────────
    gain       1e-5
    chains     64
    """
    from rich.box import Box
    from rich.console import Console
    from rich.table import Table

    # columns two spaces apart; a rule below the headings
    box = Box("    \n    \n ── \n    \n    \n    \n    \n    \n") if headings else None
    table = Table(*headings, box=box, show_header=bool(headings), padding=(0, 2, 0, 0))
    table.pad_edge, table.show_edge = False, False
    for row in rows:
        table.add_row(*row)
    console = Console(file=StringIO(), width=1000, markup=False, highlight=False, emoji=False)
    console.print(table)
    text: str = console.file.getvalue()  # type: ignore[attr-defined]
    return "\n".join(line.rstrip() for line in text.splitlines())
