"""Inherent optical properties of sea water: one water, and tables of known waters."""

from __future__ import annotations

from functools import lru_cache
from importlib import resources
from typing import Any, Self

import numpy as np
import pydantic
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from meshtrace.errors import Described, Refused, did_you_mean, require_all, require_array
from meshtrace.models import Floats, Model, NonNegative
from meshtrace.optics.phase import AnyPhase, FournierForand, Petzold, Rayleigh

_JERLOV = ("I", "IA", "IB", "II", "III", "1C", "3C", "5C", "7C", "9C")
_PETZOLD = {"clear": (0.114, 0.037), "coastal": (0.179, 0.219), "harbour": (0.366, 1.824)}
_PETZOLD_NM = 514.0  # centre of the response of Petzold's instruments
_PETZOLD_WIDTH_NM = 75.0  # its full width at half maximum
_SOURCES = {
    "petzold": f"measured at {_PETZOLD_NM:g} nm, Petzold 1972",
    "pure": "Pope and Fry 1997, Morel 1974",
    "jerlov": "Solonenko and Mobley 2015",
}

WATER_TYPES = (
    "pure-sea",
    *(f"petzold-{name}" for name in _PETZOLD),
    *(f"jerlov-{name}" for name in _JERLOV),
)
"""Types of water of `Water.from_type`."""


class Water(Model, frozen=True):
    """Sea water below the surface, homogeneous or layered.

    Parameters
    ----------
    a : float
        Absorption coefficient [m-1], >= 0.
    b : float
        Scattering coefficient [m-1], >= 0.
    n : float
        Refractive index, 1 < n <= 2.
    phase : PhaseFunction
        Scattering phase function.
    bottom_depth : float or None
        Depth of the sea floor [m], > 0; None for infinitely deep water.
    bottom_albedo : float
        Lambertian albedo of the sea floor, 0 ... 1.
    layers : sequence of (depth, a, b), or None
        Profile [m, m-1, m-1] from depth 0 downwards: linear between its nodes, constant below the
        last. `a` and `b` are then those of the first node and may be left out.

    Raises
    ------
    Refused
        If a value lies outside its range, or a and b contradict the layers.

    Notes
    -----
    The defaults are the paper's: a and b of Petzold's clear water, which he measured at 514 nm (the
    paper's LED has 470 nm, as `described` says), with the phase function of his average particle.
    b includes scattering by the water itself; see `MixturePhase` for the sum of the two.

    Examples
    --------
    >>> water = Water(a=0.114, b=0.037)
    >>> round(water.c, 3), round(water.albedo, 6)
    (0.151, 0.245033)
    """

    a: NonNegative = 0.114
    b: NonNegative = 0.037
    n: float = Field(default=1.33, gt=1.0, le=2.0, allow_inf_nan=False)
    phase: AnyPhase = FournierForand()
    bottom_depth: float | None = Field(default=None, gt=0.0, allow_inf_nan=False)
    bottom_albedo: float = Field(default=0.0, ge=0.0, le=1.0, allow_inf_nan=False)
    layers: tuple[tuple[float, float, float], ...] | None = None

    @pydantic.model_validator(mode="before")
    @classmethod
    def _surface_values(cls, data: Any) -> Any:
        """Take a and b from the first layer unless given."""
        if isinstance(data, dict) and data.get("layers") is not None:
            allowed = "rows of [depth, a, b]"
            layers = np.atleast_2d(require_array(data["layers"], "layers", allowed))
            if layers.ndim != 2 or layers.shape[1] != 3 or not layers.size:
                raise Refused("layers", data["layers"], allowed)
            first = {"a": float(layers[0, 1]), "b": float(layers[0, 2])}
            return {**first, **data, "layers": [tuple(row) for row in layers.tolist()]}
        return data

    @pydantic.model_validator(mode="after")
    def _check_layers(self) -> Self:
        if self.layers is None:
            return self
        layers = np.array(self.layers)
        depth = layers[:, 0]
        if not np.all(np.isfinite(layers)) or layers.min() < 0.0:
            raise Refused("layers", layers.min(), "finite numbers >= 0")
        if depth[0] != 0.0 or np.any(np.diff(depth) <= 0.0):
            raise Refused("layers", Described(f"depths {depth}"), "increasing from 0")
        if (self.a, self.b) != self.layers[0][1:]:
            first = f"{self.layers[0][1]} and {self.layers[0][2]}"
            allowed = f"with layers: nothing, or those of the first node, {first}"
            raise Refused("a, b", Described(f"{self.a}, {self.b}"), allowed)
        return self

    @property
    def c(self) -> float:
        """Attenuation coefficient a + b [m-1] (of layered water: at the surface)."""
        return self.a + self.b

    @property
    def albedo(self) -> float:
        """Single-scattering albedo b / c (of layered water: at the surface); 0 for c = 0."""
        return self.b / self.c if self.c > 0.0 else 0.0

    def profile(self, depth: ArrayLike) -> tuple[Floats, Floats]:
        """Return a and b at given depths.

        Parameters
        ----------
        depth : array_like
            Depth below the surface [m].

        Returns
        -------
        a, b : ndarray
            Absorption and scattering coefficients [m-1], of the shape of depth.

        Examples
        --------
        >>> water = Water(layers=[(0.0, 0.1, 0.2), (10.0, 0.1, 0.4)])
        >>> [float(x) for x in water.profile(5.0)]
        [0.1, 0.30000000000000004]
        """
        depth = require_array(depth, "depth", "depths [m]")
        nodes, a, b = np.array(self.layers or [(0.0, self.a, self.b)]).T
        return np.interp(depth, nodes, a), np.interp(depth, nodes, b)

    def described(self, wavelength_nm: float) -> str:
        """Return a and b with their wavelength and their source as a line of text.

        Parameters
        ----------
        wavelength_nm : float
            Wavelength in vacuum at which the water is used [nm].

        Returns
        -------
        str
            The source is the type of water whose tables hold the same a and b, or "as given".

        Examples
        --------
        >>> Water().described(470.0)
        'a 0.114, b 0.037 m-1 at 470 nm: petzold-clear (measured at 514 nm, Petzold 1972)'
        >>> Water(a=0.1, b=0.2).described(450.0)
        'a 0.1, b 0.2 m-1 at 450 nm: as given'
        """
        surface = ", at the surface of layers" if self.layers else ""
        values = f"a {self.a:.4g}, b {self.b:.4g} m-1 at {wavelength_nm:g} nm{surface}"
        for name in WATER_TYPES:
            try:
                a, b = _tabulated(name, np.asarray(wavelength_nm, np.float64))
            except Refused:
                continue
            if (self.a, self.b) == (float(a), float(b)):
                return f"{values}: {name} ({_SOURCES[name.partition('-')[0]]})"
        return f"{values}: as given"

    @classmethod
    def from_type(cls, type: str, wavelength_nm: float = 470.0, **parameters: Any) -> Self:
        """Return the water of a type in the tables of `coefficients`.

        Parameters
        ----------
        type : str
            One of `WATER_TYPES`, in any spelling: "jerlov-II", "Jerlov II" or "ii".
        wavelength_nm : float
            Wavelength in vacuum [nm].
        **parameters
            Other parameters of `Water`; they take precedence. With a and b, or layers, the type
            gives the phase function alone, at any wavelength.

        Returns
        -------
        Water
            With the phase function of pure sea water for "pure-sea", Petzold's measured one for
            his waters, and that of the average particle (Fournier-Forand) for the Jerlov types.

        Raises
        ------
        Refused
            If the type is not known or not tabulated at the wavelength.

        Examples
        --------
        >>> Water.from_type("jerlov-IB", wavelength_nm=475).b
        0.0635
        """
        family, _, name = _water_type(type).partition("-")
        if not {"a", "b"} <= parameters.keys() and parameters.get("layers") is None:
            a, b = coefficients(type, wavelength_nm)
            parameters = {"a": float(a), "b": float(b), **parameters}
        phase: Any = FournierForand()
        if family == "petzold":
            phase = Petzold.model_validate({"water": name})
        elif family == "pure":
            phase = Rayleigh.sea_water()
        return cls(**{"phase": phase, **parameters})


def coefficients(type: str, wavelength_nm: ArrayLike) -> tuple[Floats, Floats]:
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
    wavelength = np.asarray(wavelength_nm, dtype=np.float64)
    family, _, water = name.partition("-")
    if family == "petzold":
        a, b = _PETZOLD[water]
        good = np.abs(wavelength - _PETZOLD_NM) <= 0.5 * _PETZOLD_WIDTH_NM
        allowed = (
            f"476.5 to 551.5 nm for {name}, measured at {_PETZOLD_NM:g} nm; for these values at "
            f"another wavelength give a = {a:g} and b = {b:g}; jerlov-* have 300 to 700 nm"
        )
        require_all(wavelength, good, "wavelength_nm", allowed)
    return _tabulated(name, wavelength)


def _tabulated(type: str, wavelength: Floats) -> tuple[Floats, Floats]:
    """Return a and b of a known type; Petzold's values are returned at any wavelength."""
    family, _, name = type.partition("-")
    if family == "petzold":
        a, b = _PETZOLD[name]
        return np.full_like(wavelength, a), np.full_like(wavelength, b)
    if family == "pure":
        return pure_water_absorption(wavelength), sea_water_scattering(wavelength)
    rows = _read("jerlov_iop.csv", str)
    nodes, a, b = rows[rows[:, 0] == name, 1:].astype(np.float64).T
    return _interpolate(wavelength, nodes, a), _interpolate(wavelength, nodes, b)


def _water_type(name: str) -> str:
    """Return the type of a name, ignoring case, hyphens and a leading family."""
    word = "-".join(str(name).lower().replace("_", " ").replace("-", " ").split())
    for known in WATER_TYPES:
        if word in (known.lower(), known.lower().partition("-")[2]):
            return known
    raise Refused("type", name, ", ".join(WATER_TYPES), did_you_mean(name, WATER_TYPES))


def pure_water_absorption(wavelength_nm: ArrayLike) -> Floats:
    """Return the absorption coefficient of pure water.

    Parameters
    ----------
    wavelength_nm : array_like
        Wavelength in vacuum [nm], 380 ... 727.5.

    Returns
    -------
    ndarray
        Absorption coefficient [m-1], linear between steps of 2.5 nm.

    Raises
    ------
    Refused
        If a wavelength lies outside the table.

    Notes
    -----
    Salt changes absorption in the visible by less than the measurement's error.

    References
    ----------
    Pope and Fry 1997, Appl. Opt. 36:8710, doi:10.1364/AO.36.008710.

    Examples
    --------
    >>> round(float(pure_water_absorption(470.0)), 4)
    0.0106
    """
    wavelength = np.asarray(wavelength_nm, dtype=np.float64)
    return _interpolate(wavelength, *_read("pure_water_absorption.csv").T)


def sea_water_scattering(wavelength_nm: ArrayLike) -> Floats:
    r"""Return the scattering coefficient of pure sea water (salinity 35 to 39).

    .. math:: b = 16.06 \cdot 4.72 \times 10^{-4} (400 / \lambda)^{4.32}

    Parameters
    ----------
    wavelength_nm : array_like
        Wavelength in vacuum [nm], 350 ... 800.

    Returns
    -------
    ndarray
        Scattering coefficient [m-1].

    Raises
    ------
    Refused
        If a wavelength lies outside 350 ... 800 nm.

    Notes
    -----
    16.06 = (8 pi / 3) (2 + d) / (1 + d) for the depolarisation ratio d = 0.09, which also gives
    `Rayleigh.sea_water`.

    References
    ----------
    Morel 1974, in Optical Aspects of Oceanography (Academic Press), 1-24; Mobley 1994, Light and
    Water (Academic Press).

    Examples
    --------
    >>> round(float(sea_water_scattering(470.0)), 6)
    0.003777
    """
    wavelength = np.asarray(wavelength_nm, dtype=np.float64)
    _check_range("wavelength_nm", wavelength, 350.0, 800.0, "nm")
    return 16.06 * 4.72e-4 * (400.0 / wavelength) ** 4.32


def quan_fry(
    wavelength_nm: ArrayLike, temperature_c: ArrayLike = 20.0, salinity: ArrayLike = 35.0
) -> Floats:
    r"""Return the refractive index of sea water at atmospheric pressure.

    .. math::
        n = n_0 + (n_1 + n_2 T + n_3 T^2) S + n_4 T^2
        + \frac{n_5 + n_6 S + n_7 T}{\lambda} + \frac{n_8}{\lambda^2} + \frac{n_9}{\lambda^3}

    Parameters
    ----------
    wavelength_nm : array_like
        Wavelength [nm], 400 ... 700.
    temperature_c : array_like
        Temperature [degree Celsius], 0 ... 30.
    salinity : array_like
        Salinity [g/kg], 0 ... 35.

    Returns
    -------
    ndarray
        Refractive index relative to air.

    Raises
    ------
    Refused
        If an argument lies outside the range of the fit.

    References
    ----------
    Quan and Fry 1995, Appl. Opt. 34:3477, doi:10.1364/AO.34.003477.

    Examples
    --------
    >>> round(float(quan_fry(470.0, temperature_c=20.0, salinity=35.0)), 4)
    1.3446
    """
    given = {"wavelength_nm": wavelength_nm, "temperature_c": temperature_c, "salinity": salinity}
    w, t, s = (require_array(value, name, "numbers") for name, value in given.items())
    shapes = [w.shape, t.shape, s.shape]
    try:
        np.broadcast_shapes(*shapes)
    except ValueError as error:
        raise Refused("wavelength_nm", Described(f"shapes {shapes}"), "shapes that fit") from error
    _check_range("wavelength_nm", w, 400.0, 700.0, "nm")
    _check_range("temperature_c", t, 0.0, 30.0, "degrees Celsius")
    _check_range("salinity", s, 0.0, 35.0, "g/kg")
    salt = (1.779e-4 - 1.05e-6 * t + 1.6e-8 * t**2) * s
    dispersion = (15.868 + 0.01155 * s - 0.00423 * t) / w - 4382.0 / w**2 + 1.1455e6 / w**3
    return 1.31405 + salt - 2.02e-6 * t**2 + dispersion


def _interpolate(wavelength: Floats, nodes: Floats, values: Floats) -> Floats:
    _check_range("wavelength_nm", wavelength, nodes[0], nodes[-1], "nm")
    return np.interp(wavelength, nodes, values)


def _check_range(name: str, value: Floats, low: float, high: float, unit: str) -> None:
    good = (value >= low) & (value <= high)
    require_all(value, good, name, f"{low:g} <= {name} <= {high:g} {unit}")


@lru_cache(maxsize=4)
def _read(file: str, dtype: type = float) -> NDArray[Any]:
    text = (resources.files("meshtrace.optics") / "data" / file).read_text(encoding="utf-8")
    rows = (line for line in text.splitlines() if not line.startswith("#"))
    return np.loadtxt(rows, delimiter=",", dtype=dtype)
