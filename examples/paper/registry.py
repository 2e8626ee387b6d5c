"""Registry of the figures of the paper: descriptions in rows.toml, tables of numbers."""

from __future__ import annotations

import importlib
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.errors import Refused

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

_TABLE = tomllib.loads((Path(__file__).parent / "rows.toml").read_text(encoding="utf-8"))

FIGURES = tuple(_TABLE["figures"])
"""Names of all figures, in the order of the paper."""


class Printed(NamedTuple):
    """A published number, its unit and its place in the paper."""

    value: float
    unit: str
    place: str


PRINTED = {
    key: Printed(entry["value"], entry["unit"], _TABLE["places"][entry["place"]])
    for key, entry in _TABLE["printed"].items()
}
"""The numbers of the paper, by key."""


class Number(NamedTuple):
    """Simulated number with its standard error; 0 for exact numbers."""

    value: float
    stderr: float = 0.0

    @property
    def relative(self) -> float:
        """Standard error over the value."""
        return self.stderr / self.value


class TableRow(NamedTuple):
    """One line of a figure's table.

    Attributes
    ----------
    quantity, unit : str
        Name and unit of the quantity.
    printed : float or None
        Published number, None if there is none.
    place : str
        Place in the paper.
    default, paper : Number or None
        Numbers of correct physics and of the forms as published.
    difference : str
        A sentence on the difference.
    """

    quantity: str
    unit: str
    printed: float | None
    place: str
    default: Number | None
    paper: Number | None
    difference: str


class Entry(NamedTuple):
    """Numbers of a row of rows.toml, and the values of the words in braces."""

    key: str
    default: Number | None
    paper: Number | None
    words: dict[str, Any]


def row(key: str, numbers: Iterable[Number | float | None], /, **words: Any) -> Entry:
    """Return the numbers of a row of rows.toml.

    Parameters
    ----------
    key : str
        Name of the row in the figure's table `rows`.
    numbers : iterable of two Number, float or None
        Numbers of correct physics and of the forms as published; a bare float has no error.
    **words
        Values of the words in braces.
    """
    default, paper = (Number(float(n)) if isinstance(n, float | int) else n for n in numbers)
    return Entry(key, default, paper, words)


class FigureOutput(NamedTuple):
    """Output of a figure function.

    Attributes
    ----------
    picture : matplotlib Figure or viz.ScenePlotter
        The picture; a scene is closed once it is written.
    data : xarray.Dataset
        Data of the picture.
    numbers : list of Entry
        Numbers of the table.
    words : dict
        Values of the words in braces of the caption.
    """

    picture: Any
    data: xr.Dataset
    numbers: list[Entry]
    words: Mapping[str, Any] = {}


@dataclass(frozen=True)
class Setting:
    """Options common to all figures of a run.

    Parameters
    ----------
    seed : int
        Seed of phases, chains, gusts.
    threads : int, optional
        Threads, all cores by default; no result depends on them.
    profiles : tuple of Path
        Files of temperature and salinity.
    """

    seed: int = 1
    threads: int | None = None
    profiles: tuple[Path, ...] = ()

    @property
    def run(self) -> dict[str, Any]:
        """Options of every simulation: seed and threads."""
        return {"seed": self.seed, "threads": self.threads}


@dataclass(frozen=True)
class Figure:
    """A figure of the paper.

    Attributes
    ----------
    name : str
        Name, which files carry.
    make : callable
        Figure function: takes the `Setting`, and the effort as keywords.
    number, title, caption : str
        Number in the paper, one line, and text with words in braces.
    rows : dict
        Unit or printed number, wording and reason of each row of the table.
    quick, full : mapping of str to value
        Effort of both modes, such as numbers of photons and of seas.
    reads_profiles : bool
        True if it depends on the files of temperature and salinity.
    revision : int
        Increased with every change of the code that changes the figure, which is then redrawn.
    """

    name: str
    make: Callable[..., FigureOutput]
    number: str
    title: str
    caption: str
    rows: Mapping[str, Mapping[str, str]]
    quick: Mapping[str, Any] = field(default_factory=dict)
    full: Mapping[str, Any] = field(default_factory=dict)
    reads_profiles: bool = False
    revision: int = 1

    def effort(self, quick: bool) -> dict[str, Any]:
        """Return the keywords of `make` in a mode."""
        return dict(self.quick if quick else self.full)

    def table(self, output: FigureOutput) -> list[TableRow]:
        """Return the rows of the table, with the numbers filled in."""
        return [self._row(entry) for entry in output.numbers]

    def _row(self, entry: Entry) -> TableRow:
        described = self.rows[entry.key]
        printed: tuple[float | None, str, str] = None, described.get("unit", "1"), ""
        if "printed" in described:
            printed = PRINTED[described["printed"].format(**entry.words)]
        value, unit, place = printed
        quantity = described["quantity"].format(**entry.words)
        why = _TABLE["whys"].get(described["why"], described["why"])
        return TableRow(quantity, unit, value, place, entry.default, entry.paper, why)

    def text(self, output: FigureOutput) -> str:
        """Return the caption."""
        return self.caption.format(**{"bubbles": _TABLE["whys"]["bubbles"], **output.words})


def load(name: str) -> Figure:
    """Return a figure; its function has underscores in place of hyphens.

    Raises
    ------
    Refused
        If there is no such figure.
    ImportError
        If the viz extra is missing.
    """
    if name not in FIGURES:
        raise Refused("--only", name, ", ".join(FIGURES))
    entry = dict(_TABLE["figures"][name])
    module = importlib.import_module(f"{__package__}.{entry.pop('module')}")
    return Figure(name, getattr(module, name.replace("-", "_")), **entry)
