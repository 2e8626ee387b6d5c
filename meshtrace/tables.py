"""Read tables (text, arrays, data frames) by their headings; write aligned tables of text.

A reader declares the columns that it needs (`Column`); `read_columns` identifies them by name and
unit, converts units, and refuses what it does not understand with file, row and column. Columns
without headings are read in the declared order.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from io import StringIO
from os import PathLike
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.cells import SEPARATORS, TEXT, Cells, cells_of, split
from meshtrace.errors import Described, Refused, reads_as_number
from meshtrace.units import convert, is_convertible, is_same, is_unit

_GREEK = str.maketrans({"θ": "theta", "λ": "lambda", "ω": "omega", "η": "eta", "ζ": "zeta",
                        "β": "beta", "ψ": "psi"})  # fmt: skip
_ARGUMENTS = frozenset(("f", "w", "omega", "lambda", "theta", "psi", "t", "x,t", "x"))
"""Symbols that are arguments when they stand in round brackets, as in S(f), not units."""

_LONGEST = 200  # characters of a heading; longer ones are cut and not searched for a unit

_IN_REMARKS = re.compile(
    r"\b(?:rad(?:ians?)?|deg(?:rees?)?|hz|hertz|mm|cm|ft|feet|inch(?:es)?|um|microns?|nm|"
    r"k?h?pa|d?m?bar|psi|ms)(?![^\W\d])|[µμ]m|%|\bper\s*cent",
    re.IGNORECASE,
)
"""Units in a remark (a comment) that readers look for; all others count as ordinary words."""

PLAUSIBLE_NM = (100.0, 2e4)
"""Range of numbers that may be wavelengths of light in nm; those in um or m are below it."""

Floats = NDArray[np.float64]


class Column(NamedTuple):
    """Column that a reader needs.

    Parameters
    ----------
    name : str
        Name in the result, also accepted in headings.
    unit : str
        Wanted unit.
    aliases : tuple of str
        Other names accepted in headings.
    units : mapping of str to str
        Units assumed for names that imply another unit than the wanted one, where a heading states
        none: ``{"f": "Hz"}`` for a column of angular frequencies.
    required : bool
        Whether the table must have the column.
    plausible : (float, float)
        Smallest and largest value accepted where no unit is stated: values outside are probably in
        another unit.
    numbered : bool
        Whether numbers or a letter may follow the name, as in "wg_1" and "wg_a".
    relative : bool
        Whether only ratios of the values matter, as in a phase function: their unit is not
        converted, and a single column left over is taken under any name.
    """

    name: str
    unit: str
    aliases: tuple[str, ...] = ()
    units: Mapping[str, str] = {}
    required: bool = True
    plausible: tuple[float, float] = (-np.inf, np.inf)
    numbered: bool = False
    relative: bool = False

    def is_named(self, name: str) -> bool:
        """Return whether the name of a heading, as `normal` writes it, means this column."""
        plain = re.sub(r"_?\(.*\)$", "", name)  # "s" of "s(f)"
        names = {plain, re.sub(r"(_?\d+|_[a-h])+$", "", plain)} if self.numbered else {plain}
        return not names.isdisjoint(map(normal, (self.name, *self.aliases, *self.units)))

    def __str__(self) -> str:
        """Return name and unit as a heading would state them."""
        unit = "" if self.relative or self.unit == "1" else f" [{self.unit}]"
        return f"{self.name}{unit}{'' if self.required else ' (if any)'}"


class Heading(NamedTuple):
    """Text of a heading, the name in it as `normal` writes it, and its unit if it states one.

    The name is "" if the heading is a unit alone, and "#" if the column only counts rows.
    """

    text: str
    name: str
    unit: str | None = None


class Series(NamedTuple):
    """Values of a column in the wanted unit, and its heading, None without headings."""

    values: Floats
    heading: Heading | None


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
        By the names of the columns, without optional ones that the table lacks.

    Raises
    ------
    Refused
        If the table cannot be read, a heading is not understood, a column is missing or occurs
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
    cells.warn()
    return table


def _converted(values: Floats, column: Column, heading: Heading | None, cells: Cells) -> Floats:
    """Return values in the wanted unit of their column."""
    least, most = column.plausible
    ends = float(values.min()), float(values.max())
    # numbers without unit that cannot be in the wanted one are in an unknown one
    if (heading is None or heading.unit is None) and not (least <= ends[0] and ends[1] <= most):
        problem = Described(f"{column.name} {ends[0]:g} ... {ends[1]:g} without unit")
        raise Refused(cells.name, problem, f"a heading with its unit, such as {column.name} [m]")
    if column.relative or heading is None:
        return values
    assumed = {normal(name): unit for name, unit in column.units.items()}.get(
        re.sub(r"_?\(.*\)$", "", heading.name), column.unit
    )
    unit = assumed if heading.unit is None else heading.unit
    where = f"{cells.name}: column {heading.text}"
    intermediate = convert(values, unit, assumed, where)
    # the assumed unit may be of another kind, as of a spectrum over frequency in place of angular
    # frequency: its reader converts it together with the other column
    if not is_convertible(assumed, column.unit):
        return intermediate
    wanted = convert(intermediate, assumed, column.unit, where)
    if not np.array_equal(wanted, values):
        cells.notes.append(f"{column.name} in {unit} converted to {column.unit}")
    return wanted


def _matched(
    cells: Cells, headings: Sequence[Heading], columns: Sequence[Column]
) -> dict[str, int]:
    """Return the index of each column in the table, by its name."""
    wanted = f"columns {', '.join(map(str, columns))}"
    if not headings:
        # all declared columns, or only the required ones, in the declared order
        width, needed = len(cells.columns), [c for c in columns if c.required]
        if width == len(columns):
            needed = list(columns)
        if width != len(needed):
            problem = Described(f"{width} columns without headings")
            allowed = f"{TEXT}: {wanted} in this order, or headings"
            raise Refused(cells.name, problem, allowed)
        return {column.name: index for index, column in enumerate(needed)}
    match = dict[str, int]()
    for index, heading in enumerate(headings):
        for column in columns:
            if heading.name and column.is_named(heading.name):
                if column.name in match:
                    twice = f"{headings[match[column.name]].text} and {heading.text}"
                    raise Refused(cells.name, Described(twice), f"one column {column}")
                match[column.name] = index
    # names first, then units: a unit alone may be that of any column
    free = [i for i in range(len(headings)) if i not in match.values() and headings[i].name != "#"]
    for column in columns:
        if column.name in match:
            continue
        # by its unit alone only where no other column could have it
        same_kind = [c for c in columns if not c.relative and is_convertible(c.unit, column.unit)]
        by_unit = [i for i in free if len(same_kind) == 1 and _is_of(headings[i], column)]
        if column.relative and len(free) == 1:
            by_unit = free
        if len(by_unit) == 1 and (column.required or headings[by_unit[0]].name == ""):
            match[column.name] = by_unit[0]
            free = [i for i in free if i != by_unit[0]]
        elif column.required or by_unit or any(_is_like(headings[i], column) for i in free):
            texts = Described(", ".join(h.text or "(none)" for h in headings))
            raise Refused(cells.name, texts, wanted)
    return match


def _is_of(heading: Heading, column: Column) -> bool:
    """Return whether the unit of a heading means a column, an optional one only by its own unit."""
    if column.relative or column.unit == "1" or heading.unit is None:
        return False
    matches = is_convertible if column.required else is_same
    return matches(heading.unit, column.unit)


def _is_like(heading: Heading, column: Column) -> bool:
    """Return whether a heading may mean an optional column: it contains one of its long names.

    Such a table is refused, rather than read without the column.
    """
    names = (normal(name) for name in (column.name, *column.aliases))
    return heading.name == "" or any(len(n) > 3 and n in heading.name for n in names)


def normal(name: str) -> str:
    """Return a name in lower case and Latin letters, with underscores for all separators."""
    text = name.translate(_GREEK).strip(" \t\"'$\\").replace("\\", "")
    return re.sub(r"[\s_.:\-]+", "_", text.lower()).strip("_")


def headings_of(cells: Cells, columns: Sequence[Column]) -> list[Heading]:
    """Return a heading for each column of a table, or an empty list if it has none.

    Raises
    ------
    Refused
        If there are not as many headings as columns, or a comment may be a heading but is not
        understood.
    """
    if cells.labels:
        return [heading_of(label, columns) for label in cells.labels]
    allowed = "a heading with name and unit for each column: " + ", ".join(map(str, columns))
    width = len(cells.columns)
    if cells.heads:
        words = headings_in(cells.heads[0], cells)
        # R writes a column of row numbers without a heading
        if len(words) == width - 1 and cells.counts(0):
            words.insert(0, "")
        if len(words) != width or len(cells.heads) > 2:
            problem = " / ".join(cells.heads)
            raise Refused(cells.name, Described(f"{problem} over {width} columns"), allowed)
        return _with_units(cells, words, cells.heads[1:], columns)
    best, most_names = list[Heading](), 0
    # of several comments, the one with the most names and units of columns holds the headings
    for number, remark in enumerate(cells.remarks):
        words = headings_in(remark, cells)
        following = cells.remarks[number + 1 : number + 2]
        if len(words) == width == len(list(filter(None, words))):
            headings = _with_units(cells, words, following, columns)
            names = sum(any(c.is_named(h.name) for c in columns) + bool(h.unit) for h in headings)
            if names > most_names:
                best, most_names = headings, names
    # otherwise refuse remarks that may have been meant as headings, or that state another unit
    for remark in () if best else cells.remarks:
        words = headings_in(remark, cells)
        separated = len(words) == width > 1 and not any(map(reads_as_number, words))
        if (separated and remark == cells.remarks[-1]) or has_other_unit(remark, columns):
            raise Refused(cells.name, Described(f"# {remark}"), allowed)
    return best


def has_other_unit(remark: str, columns: Sequence[Column]) -> bool:
    """Return whether a remark names a unit in which the values of a column would differ."""
    for unit in _IN_REMARKS.findall(remark):
        if unit == "%" or unit.lower().startswith("per"):
            if any(column.unit == "1" for column in columns):
                return True
            continue
        # as unit of an elevation spectrum, a quantity, a coefficient, a scattering function
        forms = (f"{unit}2 s rad-1", unit, f"1/{unit}", f"1/{unit} sr-1")
        factors = [
            float(convert(1.0, form, column.unit, ""))
            for column in columns
            for form in (forms[:1] if column.relative else forms)
            if is_convertible(form, column.unit)
        ]
        has_lengths = any(column.unit == "m" for column in columns)
        # pressure may have been recorded in place of a water level
        if (factors and 1.0 not in factors) or (has_lengths and is_convertible(unit, "Pa")):
            return True
    return False


def _with_units(
    cells: Cells, words: Sequence[str], lines_below: Sequence[str], columns: Sequence[Column]
) -> list[Heading]:
    """Return the headings of words, with units from the line below if it holds units.

    A column that only counts rows gets the name "#".
    """
    headings = [heading_of(word, columns) for word in words]
    for line in lines_below:
        units = [u.strip("[](){} ") for u in headings_in(line, cells)]
        valid = [is_unit(unit) for unit in units]
        if len(units) == len(words) and (all(valid) or (line in cells.heads and any(valid))):
            for index, unit in enumerate(units):
                stated = headings[index].unit
                if unit and stated not in (None, unit):
                    problem = Described(f"{headings[index].text} in {unit}")
                    raise Refused(cells.name, problem, "one unit for each column")
                headings[index] = headings[index]._replace(unit=unit or stated)
        elif line in cells.heads:
            raise Refused(cells.name, Described(line), f"a unit for each of {', '.join(words)}")
    for index, heading in enumerate(headings):
        if heading.name in ("", "unnamed_0", "index") and heading.unit is None:  # as of pandas
            if cells.counts(index):
                headings[index] = heading._replace(name="#")
                cells.notes.append(f"column {index + 1}, which counts the rows, left out")
            elif not heading.name:
                problem = Described(f"column {index + 1} without heading")
                raise Refused(cells.name, problem, ", ".join(map(str, columns)))
    return headings


def heading_of(text: str, columns: Sequence[Column]) -> Heading:
    """Return the heading that a text states: a name, a unit, or both ("a [1/m]", "a 1/m")."""
    plain = text.strip(" \t\"'")
    if len(plain) > _LONGEST:
        return Heading(text, plain[:_LONGEST])
    if match := re.fullmatch(r"(.*?)[\s_/:,;]*[\[{<](.*)[\]}>]", plain):
        return Heading(text, normal(match[1]), match[2].strip())
    match = re.fullmatch(r"(.*?)[\s_/:,;]*\(((?:[^()]|\([^()]*\))*)\)", plain)
    if match and match[2].translate(_GREEK).strip() not in _ARGUMENTS:
        return Heading(text, normal(match[1]), re.sub(r"^in\s+", "", match[2].strip()))
    # the whole text is a known name: "a_total" is not "a" in units of "total"
    if any(column.is_named(normal(plain)) for column in columns):
        return Heading(text, normal(plain))
    for cut in re.finditer(r"[\s_/,:.]+(?:in\s+)?", plain):
        name, unit = normal(plain[: cut.start()]), plain[cut.end() :]
        # an underscore in a unit stands for a product or a quotient: "rad/s" in omega_rad_s
        for spelling in (unit.replace("_", " "), unit.replace("_", "/")):
            if any(c.is_named(name) and _is_unit(spelling, c) for c in columns):
                return Heading(text, name, spelling)
    is_ratio = bool(re.search(r"[/%]|^percent$", plain))
    if any(_is_unit(plain, column) for column in columns if is_ratio or not column.relative):
        return Heading(text, "", plain)
    # an unknown name, followed by what cannot be anything but a unit
    match = re.fullmatch(r"(.*?)(?:\s+in\s+|/|[\s_]+(?=\S*[/%]|per\s?cent))(.+)", plain)
    if match and is_unit(match[2]) and re.search(r"[^\W\d_]|[%°]", match[2]):
        return Heading(text, normal(match[1]), match[2])
    return Heading(text, normal(plain))


def _is_unit(text: str, column: Column) -> bool:
    """Return whether a text is a unit that a column may have."""
    if not re.match(r"1\s*/|[^\W\d_]|[%°]", text.strip()):
        return False
    if column.relative:
        return is_unit(text)
    return any(is_convertible(text, unit) for unit in (column.unit, *column.units.values()))


def headings_in(line: str, cells: Cells) -> list[str]:
    """Return the headings in a line, split by the separator of the columns or another one."""
    width = len(cells.columns)
    tries = dict.fromkeys((cells.separator, *SEPARATORS)) if cells.separator != " " else SEPARATORS
    words = next((w for sep in tries if len(w := _bracketed(line, sep)) > 1), [line.strip()])
    if len(words) == width + 1 and not words[-1]:
        words.pop()
    apart = re.split(r"\s{2,}|\t", line.strip())  # headings of several words, two spaces apart
    return apart if len(words) != width == len(apart) else words


def _bracketed(line: str, separator: str) -> list[str]:
    """Return the words of a line, each joined with the unit in brackets that follows it."""
    if separator != " " or '"' in line:
        return split(line, separator)
    word, unit = r"[^\s\[\](){}]+(?:\([^()\s]*\))?", r"\[[^\[\]]*\]|\((?:[^()]|\([^()]*\))*\)"
    return re.findall(rf"{word}\s*(?:{unit})|{word}|\S+", line)


def with_file(data: Any, read: Callable[[Any], dict[str, Any]]) -> Any:
    """Replace the key `file` in the plain data of a model by the contents that `read` returns."""
    if not (isinstance(data, Mapping) and "file" in data):
        return data
    fields = dict(data)
    path = fields.pop("file")
    if not isinstance(path, str | PathLike):
        raise Refused("file", path, "the path of a text file")
    return read(path) | fields


def text_table(lines: Iterable[Sequence[str]], headings: Sequence[str] = ()) -> str:
    """Return lines of words as an aligned table of text, with headings if there are any.

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

    # a rule below the headings (rich draws it from the third of eight lines), and no other lines
    box = Box("    \n    \n ── \n    \n    \n    \n    \n    \n") if headings else None
    table = Table(*headings, box=box, show_header=bool(headings), padding=(0, 2, 0, 0))
    table.pad_edge, table.show_edge = False, False
    for line in lines:
        table.add_row(*line)
    console = Console(file=StringIO(), width=1000, markup=False, highlight=False, emoji=False)
    console.print(table)
    text: str = console.file.getvalue()  # type: ignore[attr-defined]
    return "\n".join(line.rstrip() for line in text.splitlines())
