"""What a figure is, and the list of all of them in the order of the paper."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from meshtrace.errors import Refused
from meshtrace.paper.printed import PRINTED

if TYPE_CHECKING:
    import xarray as xr


class Number(NamedTuple):
    """A number of the run with its standard error, 0 where it has none."""

    value: float
    stderr: float = 0.0


class Row(NamedTuple):
    """One line of a figure's table.

    Attributes
    ----------
    quantity, unit : str
        What is compared, and its unit.
    printed : float or None
        What the paper prints, None where it prints no number.
    place : str
        Where the paper prints it.
    default, paper : Number or None
        What right physics and the printed forms give.
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


def compared(
    quantity: str,
    numbers: Iterable[Number | None],
    why: str,
    *,
    unit: str = "1",
    printed: str | None = None,
) -> Row:
    """Return a line of a table.

    Parameters
    ----------
    quantity : str
        What is compared.
    numbers : iterable of two Number or None
        What right physics and the printed forms give.
    why : str
        A sentence on the difference.
    unit : str
        Unit.
    printed : str, optional
        Key of what the paper prints, in `printed.PRINTED`.
    """
    default, paper = numbers
    if printed is None:
        return Row(quantity, unit, None, "", default, paper, why)
    found = PRINTED[printed]
    return Row(quantity, found.unit, found.value, found.place, default, paper, why)


class Drawing(NamedTuple):
    """What a figure function returns.

    Attributes
    ----------
    picture : matplotlib Figure or ndarray of uint8, shape (height, width, 3)
        The picture.
    data : xarray.Dataset
        All that is drawn.
    rows : list of Row
        The table.
    caption : str
        What is shown, how it was made, and what it does not show.
    """

    picture: Any
    data: xr.Dataset
    rows: list[Row]
    caption: str


@dataclass(frozen=True)
class Setting:
    """What all figures of a run share.

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


Make = Callable[..., Drawing]


@dataclass(frozen=True)
class Figure:
    """A figure of the paper and how it is made.

    Attributes
    ----------
    name : str
        Its name, which files carry.
    number : str
        Its number in the paper.
    title : str
        One line.
    make : callable
        Takes the `Setting` and the effort as keywords, returns the `Drawing`.
    quick, full : mapping of str to value
        Effort of both modes, such as numbers of photons and of seas.
    reads_profiles : bool
        Whether it depends on the files of temperature and salinity.
    """

    name: str
    number: str
    title: str
    make: Make
    quick: Mapping[str, Any] = field(default_factory=dict)
    full: Mapping[str, Any] = field(default_factory=dict)
    reads_profiles: bool = False

    def effort(self, quick: bool) -> dict[str, Any]:
        """Return the keywords of `make` in a mode."""
        return dict(self.quick if quick else self.full)


class _Entry(NamedTuple):
    """A figure before its module is loaded: modules need the viz extra."""

    name: str
    module: str


_ORDER = (
    _Entry("link", "sketches"),
    _Entry("ff-cdf", "optics"),
    _Entry("uav-axes", "sketches"),
    _Entry("snell", "optics"),
    _Entry("fates", "fates"),
    _Entry("tilt", "uav"),
    _Entry("h-alpha", "uav"),
    _Entry("surfaces", "sea"),
    _Entry("bubble-density", "optics"),
    _Entry("bubble-scattering", "optics"),
    _Entry("gain-series", "fading"),
    _Entry("gain-distribution", "fading"),
    _Entry("gain-half-angle", "sweeps"),
    _Entry("coverage-half-angle", "coverage"),
    _Entry("gain-depth", "sweeps"),
    _Entry("coverage-depth", "coverage"),
    _Entry("gain-height", "sweeps"),
    _Entry("gain-radius", "sweeps"),
    _Entry("offset", "sketches"),
    _Entry("gain-offset", "sweeps"),
    _Entry("ber-depth", "ber"),
    _Entry("stations", "water"),
    _Entry("temperature-salinity", "water"),
    _Entry("wind", "uav"),
)

FIGURES = tuple(entry.name for entry in _ORDER)
"""Names of all figures, in the order of the paper."""

_FOUND: dict[str, Figure] = {}


def figure(
    name: str,
    number: str,
    title: str,
    *,
    quick: Mapping[str, Any] | None = None,
    full: Mapping[str, Any] | None = None,
    reads_profiles: bool = False,
) -> Callable[[Make], Make]:
    """Register a function as a figure of the paper; arguments as `Figure`."""

    def register(make: Make) -> Make:
        _FOUND[name] = Figure(name, number, title, make, quick or {}, full or {}, reads_profiles)
        return make

    return register


def load(name: str) -> Figure:
    """Return a figure, loading its module.

    Raises
    ------
    Refused
        If there is no such figure.
    """
    modules = dict(_ORDER)
    if name not in modules:
        raise Refused("--only", name, ", ".join(FIGURES))
    importlib.import_module(f"{__package__}.{modules[name]}")
    return _FOUND[name]
