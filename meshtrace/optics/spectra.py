"""Spectra of a and b of waters, and the tables of known types."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, field_validator

from meshtrace.checks import Number, RangedArray, check_call
from meshtrace.errors import Described, Refused, did_you_mean, require_array, require_range
from meshtrace.models import Family, Floats, NumberRows
from meshtrace.optics.phase import FournierForand, Petzold, PhaseFunction, Rayleigh
from meshtrace.optics.pure_water import (
    interpolate,
    pure_water_absorption,
    read_table,
    sea_water_scattering,
)
from meshtrace.tables import PLAUSIBLE_NM, Column, read_columns

_JERLOV = ("I", "IA", "IB", "II", "III", "1C", "3C", "5C", "7C", "9C")
PETZOLD = {"clear": (0.114, 0.037), "coastal": (0.179, 0.219), "harbour": (0.366, 1.824)}
"""a and b [m-1] of the waters that Petzold measured."""

PETZOLD_NM = 514.0
"""Centre of the response of Petzold's instruments [nm]."""

_PETZOLD_WIDTH_NM = 75.0  # its full width at half maximum
_SOURCES = {
    "petzold": f"measured at {PETZOLD_NM:g} nm, Petzold 1972",
    "pure": "Pope and Fry 1997, Morel 1974",
    "jerlov": "Solonenko and Mobley 2015",
}

WATER_TYPES = (
    "pure-sea",
    *(f"petzold-{name}" for name in PETZOLD),
    *(f"jerlov-{name}" for name in _JERLOV),
)
"""Types of water of `Water.from_type`."""


_CLOSED = "other spectra as a table"


class WaterSpectrum(Family, frozen=True, default="type", closed=_CLOSED):
    """Base of the spectra of waters: a subclass defines `properties` alone."""

    @property
    def source(self) -> str:
        """Name of the water and where its coefficients come from."""
        return self.kind

    @property
    @abstractmethod
    def limits_nm(self) -> tuple[float, float]:
        """Shortest and longest wavelength of the spectrum [nm]."""

    @abstractmethod
    def properties(self, wavelength_nm: Number) -> dict[str, Any]:
        """Return fields of `Water` at a wavelength in vacuum [nm].

        Returns
        -------
        dict
            a and b [m-1], or layers of them; the phase function and n if the spectrum has them.

        Raises
        ------
        Refused
            If the spectrum has no values at the wavelength.
        """


def _water_type(name: Any) -> str:
    """Return the type of a name, ignoring case, hyphens and a leading family."""
    word = "-".join(str(name).lower().replace("_", " ").replace("-", " ").split())
    for known in WATER_TYPES:
        if word in (known.lower(), known.lower().partition("-")[2]):
            return known
    raise Refused("type", name, ", ".join(WATER_TYPES), did_you_mean(name, WATER_TYPES))


class WaterType(WaterSpectrum, frozen=True):
    """Spectrum of a type of water in the tables of `coefficients`.

    Parameters
    ----------
    type : str
        One of `WATER_TYPES`, in any spelling: "jerlov-II", "Jerlov II" or "ii".

    Notes
    -----
    The phase function is that of pure sea water for "pure-sea", Petzold's measured one for his
    waters, and that of the average particle (Fournier-Forand) for the Jerlov types.
    """

    kind: Literal["type"] = "type"
    type: Annotated[str, BeforeValidator(_water_type)]

    @property
    def source(self) -> str:
        """Type and publication of its tables."""
        return f"{self.type} ({_SOURCES[self.type.partition('-')[0]]})"

    @property
    def limits_nm(self) -> tuple[float, float]:
        """Shortest and longest wavelength of the tables [nm]."""
        family, _, name = self.type.partition("-")
        if family == "petzold":
            # nothing was measured beyond the response of the instruments
            half = 0.5 * _PETZOLD_WIDTH_NM
            return PETZOLD_NM - half, PETZOLD_NM + half
        nodes = (
            _nodes(name)[0] if family == "jerlov" else read_table("pure_water_absorption.csv").T[0]
        )
        return float(nodes[0]), float(nodes[-1])

    @property
    def phase(self) -> PhaseFunction:
        """Phase function of the type, the same at all wavelengths."""
        family, _, name = self.type.partition("-")
        if family == "petzold":
            return Petzold.model_validate({"water": name})
        # the Jerlov types have no measured phase function: that of the average particle
        return Rayleigh.sea_water() if family == "pure" else FournierForand()

    def properties(self, wavelength_nm: Number) -> dict[str, Any]:
        """Return a and b [m-1] at a wavelength in vacuum [nm], and the phase function."""
        a, b = coefficients(self.type, wavelength_nm)
        return {"a": float(a), "b": float(b), "phase": self.phase}


TABLE_COLUMNS = (
    Column("depth", "m", ("z", "depth below surface"), required=False),
    Column(
        "wavelength",
        "nm",
        ("lambda", "wl", "wave", "wavelengths"),
        plausible=PLAUSIBLE_NM,
    ),
    Column("a", "m-1", ("absorption", "absorption coefficient", "a_total")),
    Column("b", "m-1", ("scattering", "scattering coefficient", "b_total")),
)


class SpectralTable(WaterSpectrum, frozen=True):
    """Spectrum of measured a and b, linear between the wavelengths of a table.

    Parameters
    ----------
    table : sequence of (depth, wavelength, a, b)
        Rows of depth [m], wavelength in vacuum [nm], absorption and scattering coefficient [m-1],
        in any order, with the same wavelengths at all depths; rows of (wavelength, a, b) for
        uniform water.

    Raises
    ------
    Refused
        If rows are missing, or values are negative or not finite; in `properties`, if the
        wavelength lies outside the table.

    Notes
    -----
    Linear between wavelengths; the first depth counts as the surface. Phase function and n are the
    defaults of `Water`.

    Examples
    --------
    >>> SpectralTable(table=[(450.0, 0.02, 0.1), (550.0, 0.08, 0.08)]).properties(500.0)
    {'a': 0.05, 'b': 0.09}
    """

    kind: Literal["table"] = "table"
    table: NumberRows

    @field_validator("table", mode="before")
    @classmethod
    def _full(cls, value: Any) -> Any:
        allowed = "rows of [depth, wavelength, a, b], all finite and >= 0"
        if hasattr(value, "columns"):  # of a data frame
            value = [s.values for s in read_columns(value, TABLE_COLUMNS, "table").values()]
            value = np.column_stack(value)
        table = np.atleast_2d(require_array(value, "", allowed))
        # without depths the water is uniform
        if table.ndim == 2 and table.shape[1] == 3:
            table = np.column_stack([np.zeros(len(table)), table])
        good = np.isfinite(table) & (table >= 0.0)
        if table.ndim != 2 or table.shape[1] != 4 or not table.size or not good.all():
            raise Refused("", value, allowed)
        depths, wavelengths = np.unique(table[:, 0]), np.unique(table[:, 1])
        # every depth has every wavelength, and once
        different = len(np.unique(table[:, :2], axis=0))
        if not different == len(table) == len(depths) * len(wavelengths):
            count = Described(f"{len(table)} rows")
            raise Refused("", count, f"{len(wavelengths)} wavelengths at {len(depths)} depths")
        return tuple(map(tuple, table[np.lexsort((table[:, 1], table[:, 0]))].tolist()))

    @property
    def source(self) -> str:
        """Numbers of wavelengths and depths."""
        depths, wavelengths = (len({row[i] for row in self.table}) for i in (0, 1))
        return f"table of {wavelengths} wavelengths at {depths} depths"

    @property
    def limits_nm(self) -> tuple[float, float]:
        """Shortest and longest wavelength of the table [nm]."""
        wavelengths = [row[1] for row in self.table]
        return min(wavelengths), max(wavelengths)

    def properties(self, wavelength_nm: Number) -> dict[str, Any]:
        """Return a and b [m-1], or their layers, at a wavelength in vacuum [nm]."""
        table = np.array(self.table)
        depth = np.unique(table[:, 0])
        # sorted by depth, then wavelength: a block of wavelengths for each depth
        blocks = table.reshape(len(depth), -1, 4).transpose(0, 2, 1)
        a, b = (
            np.array([interpolate(wavelength_nm, at, values[i]) for _, at, *values in blocks])
            for i in (0, 1)
        )
        return uniform_or_layers(np.append(0.0, depth[1:]), a, b)


def uniform_or_layers(depth: Floats, a: Floats, b: Floats) -> dict[str, Any]:
    """Return a and b of one depth, or else the layers of several."""
    if len(depth) == 1:
        return {"a": float(a[0]), "b": float(b[0])}
    return {"layers": tuple(map(tuple, np.column_stack([depth, a, b]).tolist()))}


@check_call
def coefficients(type: str, wavelength_nm: RangedArray) -> tuple[Floats, Floats]:
    """Return the absorption and scattering coefficients of a type of water.

    Parameters
    ----------
    type : str
        One of `WATER_TYPES`, in any spelling: "jerlov-II", "Jerlov II" or "ii".
    wavelength_nm : array_like
        Wavelength in vacuum [nm].

    Returns
    -------
    a, b : ndarray
        Absorption and scattering coefficients [m-1], of the shape of wavelength_nm.

    Raises
    ------
    Refused
        If the type is not known or not tabulated at a wavelength.

    Notes
    -----
    jerlov-*: 300 to 700 nm, linear between 17 wavelengths. a and b were not measured but derived
    from Jerlov's diffuse attenuation through a bio-optical model; their small-particle scattering
    uses 1.513 m2/g where Haltrin (1999) has 1.151302. The published table repeats rows for 3C (675
    and 700 nm) and 5C (600 to 700 nm): these types end at 650 and 575 nm here.
    petzold-*: one wavelength, 514 nm; refused beyond the response of the instruments, 75 nm wide at
    half maximum: 476.5 to 551.5 nm. No rule carries the values further: published models of the
    spectra need chlorophyll, dissolved matter and minerals, which were not measured.
    pure-sea: 380 to 727.5 nm; absorption of pure water, scattering of sea water.

    References
    ----------
    Solonenko and Mobley 2015, Appl. Opt. 54:5392, doi:10.1364/AO.54.005392;
    Petzold 1972, SIO Ref. 72-78; Mobley, Ocean Optics Web Book, "Petzold's measurements" (response
    and width of the instruments); Pope and Fry 1997, Appl. Opt. 36:8710,
    doi:10.1364/AO.36.008710.

    Examples
    --------
    >>> a, b = coefficients("petzold-harbour", 514.0)
    >>> float(a), float(b)
    (0.366, 1.824)
    """
    name = _water_type(type)
    family, _, water = name.partition("-")
    if family == "petzold":
        a, b = PETZOLD[water]
        allowed = (
            f"476.5 to 551.5 nm for {name}, measured at {PETZOLD_NM:g} nm; to keep these values at "
            f"another wavelength set a = {a:g} and b = {b:g}; jerlov-* have 300 to 700 nm"
        )
        limits = WaterType(type=name).limits_nm
        wavelength = require_range(wavelength_nm, *limits, "wavelength_nm", allowed=allowed)
        return np.full_like(wavelength, a), np.full_like(wavelength, b)
    if family == "pure":
        return pure_water_absorption(wavelength_nm), sea_water_scattering(wavelength_nm)
    nodes, a, b = _nodes(water)
    return interpolate(wavelength_nm, nodes, a), interpolate(wavelength_nm, nodes, b)


def _nodes(jerlov: str) -> Floats:
    """Return wavelengths, a and b of a Jerlov type."""
    table = read_table("jerlov_iop.csv", str)
    return table[table[:, 0] == jerlov, 1:].astype(np.float64).T
