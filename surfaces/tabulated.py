"""Wave spectra from tables: files and arrays of frequencies and densities."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cached_property
from os import PathLike
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import model_validator

from meshtrace.errors import MISSING, Described, Refused
from meshtrace.models import NonNegative
from meshtrace.tables import Column, Heading, read_columns, with_file
from meshtrace.units import convert, cycles

from .parameters import Floats, Positive, finite_array
from .spectra import Spectrum

# Names of headings that stand for a frequency [Hz] rather than an angular one.
_IN_HZ = ("f", "freq", "frequency", "frequencies", "fr", "f_p")
# "relative" leaves the density in its unit: what to convert depends on the other column.
_COLUMNS = (
    Column(
        "omega",
        "rad s-1",
        ("w", "om", "angular frequency", "angular freq", "radian frequency"),
        dict.fromkeys(_IN_HZ, "Hz"),
    ),
    Column(
        "density",
        "m2 s rad-1",
        ("S", "E", "S(f)", "psd", "spectral density", "variance density", "energy density",
         "energy", "spectrum", "ef", "sf", "wave spectrum", "energy spectrum", "varden"),
        relative=True,
    ),
)  # fmt: skip


def _unit_of_density(path: str, frequency: Heading | None, density: Heading | None) -> str:
    """Return the unit of densities by the headings of both columns; refuse contradictions.

    The unit of the frequency decides, or else its name. If name, unit and the argument of a
    density as in "S(f)" disagree, the density has to state a unit with Hz or rad.
    """
    if frequency is None:
        return "m2 s rad-1"
    by_name, by_unit = frequency.name in _IN_HZ, cycles(frequency.unit)
    in_hz = by_name if by_unit is None else bool(by_unit)
    argument = re.search(r"\((f|w|omega)\)$", density.name) if density else None
    unclear = in_hz != by_name if frequency.name else False
    unclear |= argument is not None and (argument[1] == "f") != in_hz
    if unclear and (density is None or cycles(density.unit) is None):
        reason = Described(f"{density.text if density else 2} over {frequency.text}")
        raise Refused(path, reason, "a unit with Hz or rad in the heading, [m2/Hz] or [m2 s/rad]")
    return "m2 Hz-1" if in_hz else "m2 s rad-1"


class TabulatedSpectrum(Spectrum, frozen=True):
    """Frequency spectrum given by a table, linear between its rows and zero beyond them.

    Parameters
    ----------
    omega : sequence of float, length n
        Angular frequencies [rad s-1], increasing, n >= 2.
    density : sequence of float, length n
        S(omega) [m2 s rad-1], >= 0, not all zero.
    wind_speed : float
        Wind speed at 10 m [m s-1], for the slopes of the short waves only.
    file : path, optional
        Text file of both columns in place of them, see `from_file`.

    Raises
    ------
    Refused
        If the table is not of this form.

    Examples
    --------
    >>> spectrum = TabulatedSpectrum(omega=[1.0, 2.0, 3.0], density=[0.0, 1.0, 0.0])
    >>> spectrum.omega_p, float(spectrum(1.5))
    (2.0, 0.5)
    """

    kind: Literal["tabulated"] = "tabulated"
    omega: tuple[Positive, ...]
    density: tuple[NonNegative, ...]

    @model_validator(mode="before")
    @classmethod
    def _from_table(cls, data: Any) -> Any:
        if isinstance(data, Mapping) and not {"omega", "file"} & data.keys():
            raise Refused("omega", MISSING, "frequencies [rad s-1] beside density, or file")
        columns = {"omega", "density"}
        return with_file(data, lambda path: cls.from_file(path).model_dump(include=columns))

    @model_validator(mode="after")
    def _check(self) -> Self:
        if len(self.omega) != len(self.density) or len(self.omega) < 2:
            sizes = Described(f"{len(self.omega)} and {len(self.density)} numbers")
            raise Refused("omega, density", sizes, "as many of each, two or more")
        if np.any(np.diff(self.omega) <= 0.0):
            raise Refused("omega", self.omega, "increasing frequencies")
        if not any(self.density):
            raise Refused("density", Described("all zero"), "a density > 0")
        return self

    @classmethod
    def from_file(cls, path: str | PathLike[str]) -> Self:
        """Read a text file of two columns, frequency and density, see `tables.read_columns`.

        Columns are omega [rad s-1] and S(omega) [m2 s rad-1], or f [Hz] and S(f) = 2 pi S(omega)
        [m2 Hz-1], as the headings say by their units or, without units, by names such as "omega"
        and "f".
        """
        table = read_columns(path, _COLUMNS)
        density, heading = table["density"]
        usual = _unit_of_density(str(path), table["omega"].heading, heading)
        stated = usual if heading is None or heading.unit is None else heading.unit
        where = f"{path}: column {heading.text if heading else 2}"
        # first in the unit of its own frequency, then over omega: S(omega) = S(f) / (2 pi)
        values = convert(convert(density, stated, usual, where), usual, "m2 s rad-1", where)
        return cls(omega=tuple(table["omega"].values), density=tuple(values))

    @cached_property
    def omega_p(self) -> float:
        """Frequency of the highest density [rad s-1]."""
        return self.omega[int(np.argmax(self.density))]

    @property
    def lowest_peak(self) -> float:
        """Frequency of the first row, below which the density is 0 [rad s-1]."""
        return self.omega[0]

    def __call__(self, omega: ArrayLike) -> Floats:
        """Return S(omega) [m2 s rad-1] at angular frequencies >= 0 [rad s-1]."""
        frequencies = finite_array("omega", omega, 0.0)
        return np.interp(frequencies, self.omega, self.density, left=0.0, right=0.0)
