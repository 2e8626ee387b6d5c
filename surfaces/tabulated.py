"""Frequency spectra from tables."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from os import PathLike
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import model_validator

from meshtrace.columns import read_columns
from meshtrace.errors import MISSING, Described, Refused
from meshtrace.models import NonNegative

from .parameters import Floats, Positive, finite_array
from .spectra import Spectrum


class TabulatedSpectrum(Spectrum, frozen=True):
    """Frequency spectrum given by a table, linear between its rows and zero beyond them.

    Parameters
    ----------
    omega : sequence of float, length n
        Angular frequencies [rad s-1], increasing, n >= 2.
    density : sequence of float, length n
        S(omega) [m2 s rad-1], >= 0, not all zero.
    wind_speed : float
        Wind speed at 10 m [m s-1], for the slopes of shorter waves.
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
        if isinstance(data, Mapping) and "file" in data:
            own = {key: value for key, value in data.items() if key != "file"}
            return {**cls.from_file(data["file"]).model_dump(include={"omega", "density"}), **own}
        return data

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
        """Read a text file of two columns, frequency and density, see `read_columns`.

        Columns are omega [rad s-1] and S(omega) [m2 s rad-1], or, where the header of the first
        one contains "Hz" or begins with "f", f [Hz] and S(f) = 2 pi S(omega) [m2 Hz-1].
        """
        if not isinstance(path, str | PathLike):
            raise Refused("file", path, "the path of a text file")
        header, values = read_columns(path)
        first = header[0].lower() if header else ""
        unit = 2.0 * np.pi if "hz" in first or first.startswith("f") else 1.0
        return cls(omega=tuple(values[:, 0] * unit), density=tuple(values[:, 1] / unit))

    @cached_property
    def omega_p(self) -> float:
        """Frequency of the highest density [rad s-1]."""
        return self.omega[int(np.argmax(self.density))]

    def __call__(self, omega: ArrayLike) -> Floats:
        """Return S(omega) [m2 s rad-1] at angular frequencies >= 0 [rad s-1]."""
        at = finite_array("omega", omega, 0.0)
        return np.interp(at, self.omega, self.density, left=0.0, right=0.0)
