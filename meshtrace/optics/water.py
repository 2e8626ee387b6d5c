"""Inherent optical properties of the water of a link."""

from __future__ import annotations

from functools import lru_cache
from os import PathLike
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import pydantic
from numpy.typing import ArrayLike
from pydantic import Field

from meshtrace.errors import MISSING, Described, Refused, require_array
from meshtrace.fields import attrs
from meshtrace.mesh import MeshOrFile
from meshtrace.models import FamilyField, Floats, Model, NonNegative, converted
from meshtrace.optics.phase import FournierForand, PhaseFunction
from meshtrace.optics.spectra import PETZOLD, PETZOLD_NM, WaterSpectrum, WaterType
from meshtrace.optics.water_files import read_spectrum

if TYPE_CHECKING:
    import xarray as xr


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
    bottom : path, TriangleMesh or None
        Mesh of the sea floor, z up from still water [m]: a `Body` with the albedo `bottom_albedo`.
    layers : sequence of (depth, a, b), or None
        Profile [m, m-1, m-1] from depth 0 downwards: linear between its nodes, constant below the
        last. `a` and `b` are then those of the first node and may be left out.
    spectrum : WaterSpectrum or None
        What a and b at any wavelength follow from; None for a water of one wavelength.
    wavelength_nm : float or None
        Wavelength in vacuum of a spectrum [nm], 200 ... 1200; None without one.

    Raises
    ------
    Refused
        If a value lies outside its range, a and b contradict the layers, or the spectrum has no
        values at the wavelength.

    Notes
    -----
    The defaults are the paper's: a and b of Petzold's clear water, which he measured at 514 nm (the
    paper's LED has 470 nm, as `described` says), with the phase function of his average particle.
    b includes scattering by the water itself; see `MixturePhase` for the sum of the two.

    A spectrum gives a, b or layers, and the phase function and n if it has them; given values take
    precedence. With a, b or layers other than those of the spectrum, the water has none.

    Examples
    --------
    >>> water = Water(a=0.114, b=0.037)
    >>> round(water.c, 3), round(water.albedo, 6)
    (0.151, 0.245033)
    """

    a: NonNegative = 0.114
    b: NonNegative = 0.037
    n: float = Field(default=1.33, gt=1.0, le=2.0, allow_inf_nan=False)
    phase: FamilyField[PhaseFunction] = converted(default=FournierForand())
    bottom_depth: float | None = Field(default=None, gt=0.0, allow_inf_nan=False)
    bottom_albedo: float = Field(default=0.0, ge=0.0, le=1.0, allow_inf_nan=False)
    bottom: MeshOrFile = None
    layers: tuple[tuple[float, float, float], ...] | None = None
    spectrum: FamilyField[WaterSpectrum | None] = converted(default=None)
    wavelength_nm: float | None = Field(default=None, ge=200.0, le=1200.0, allow_inf_nan=False)

    @pydantic.model_validator(mode="before")
    @classmethod
    def _fill_from_layers(cls, data: Any) -> Any:
        """Take a and b from the first layer unless given."""
        if isinstance(data, dict) and data.get("layers") is not None:
            allowed = "rows of [depth, a, b]"
            layers = np.atleast_2d(require_array(data["layers"], "layers", allowed))
            if layers.ndim != 2 or layers.shape[1] != 3 or not layers.size:
                raise Refused("layers", data["layers"], allowed)
            first = {"a": float(layers[0, 1]), "b": float(layers[0, 2])}
            return first | data | {"layers": [tuple(row) for row in layers.tolist()]}
        return data

    @pydantic.model_validator(mode="after")
    def _fill_from_spectrum(self) -> Self:
        """Take values that were not set from the spectrum; remember which were set."""
        if self.spectrum is None or self.wavelength_nm is None:
            if self.spectrum is not None:
                raise Refused("wavelength_nm", MISSING, "the wavelength beside the spectrum [nm]")
            if self.wavelength_nm is not None:
                raise Refused("wavelength_nm", self.wavelength_nm, "nothing, or with a spectrum")
            return self
        fields_set = self.model_fields_set
        for name, value in _derived(self.spectrum, self.wavelength_nm).items():
            # A value that agrees with the spectrum counts as derived from it: a stored water has
            # both, and `at_wavelength` must change it.
            if name not in fields_set or _same(getattr(self, name), value):
                object.__setattr__(self, name, value)
                fields_set.discard(name)
        if fields_set & {"a", "b", "layers"}:
            # With other coefficients the spectrum no longer says what the water is at other
            # wavelengths: drop it, and hold every value as given.
            fields_set |= {"a", "b", "layers", "n", "phase"}
            object.__setattr__(self, "spectrum", None)
            object.__setattr__(self, "wavelength_nm", None)
        return self

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
        # a and b of layered water are those at the surface
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
        """Return a and b at depths.

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
        nodes, a, b = np.array(self.layers or [(0.0, self.a, self.b)]).T
        depths = np.asarray(depth, float)
        return np.interp(depths, nodes, a), np.interp(depths, nodes, b)

    def at_wavelength(self, wavelength_nm: float) -> Self:
        """Return the water at another wavelength, with given values other than a and b unchanged.

        Parameters
        ----------
        wavelength_nm : float
            Wavelength in vacuum [nm].

        Returns
        -------
        Water

        Raises
        ------
        Refused
            If the water has no spectrum, or its spectrum no values at the wavelength.

        Examples
        --------
        >>> Water.from_type("jerlov-IB", 475.0).at_wavelength(550.0).c
        0.1159
        """
        self._with_spectrum()
        return self.replace(wavelength_nm=wavelength_nm)

    def spectra(self, wavelengths_nm: ArrayLike | None = None) -> xr.Dataset:
        """Return a, b, c and n over wavelength, of layered water at the surface.

        Parameters
        ----------
        wavelengths_nm : array_like, optional
            Wavelengths in vacuum [nm]; by default 400 to 700 in steps of 20, as far as the
            spectrum goes.

        Returns
        -------
        xarray.Dataset
            `a`, `b`, `c` [m-1] and `n` over `wavelength_nm`, with the attribute `source`.

        Raises
        ------
        Refused
            If the water has no spectrum, or its spectrum no values at a wavelength.

        Examples
        --------
        >>> spectra = Water.from_type("jerlov-IB").spectra([450.0, 550.0])
        >>> spectra.c.values.round(4)
        array([0.0915, 0.1159])
        """
        import xarray as xr

        spectrum = self._with_spectrum()
        if wavelengths_nm is None:
            low, high = spectrum.limits_nm
            steps = np.arange(400.0, 701.0, 20.0)
            wavelengths_nm = steps[(steps >= low) & (steps <= high)]
        wavelengths = np.ravel(np.asarray(wavelengths_nm, float))
        waters = [self.at_wavelength(w) for w in wavelengths.tolist()]
        data = xr.Dataset(attrs={"source": spectrum.source})
        for name in "abcn":
            values = [getattr(water, name) for water in waters]
            data[name] = ("wavelength_nm", values, attrs(name))
        data.coords["wavelength_nm"] = ("wavelength_nm", wavelengths, attrs("wavelength_nm"))
        return data

    def _with_spectrum(self) -> WaterSpectrum:
        """Return the spectrum; refuse a water without one."""
        if self.spectrum is None:
            coefficients = Described(f"a {self.a:g}, b {self.b:g} m-1 of one wavelength")
            allowed = 'a water with a spectrum, such as Water.from_type("jerlov-II")'
            raise Refused("water", coefficients, f"{allowed} or type of [water] in a link file")
        return self.spectrum

    def __str__(self) -> str:
        return self.described()

    def described(self, wavelength_nm: float | None = None) -> str:
        """Return a and b with their wavelength and their source, as a line of text.

        Parameters
        ----------
        wavelength_nm : float, optional
            Wavelength in vacuum at which the water is used [nm], by default that of its spectrum.

        Returns
        -------
        str
            The source is that of the spectrum, the water with Petzold's a and b, or "as given"; the
            text of `print(water)`, too.

        Examples
        --------
        >>> Water().described(470.0)
        'a 0.114, b 0.037 m-1 at 470 nm: petzold-clear (measured at 514 nm, Petzold 1972)'
        >>> Water(a=0.1, b=0.2).described(450.0)
        'a 0.1, b 0.2 m-1 at 450 nm: as given'
        """
        surface = ", at the surface of layers" if self.layers else ""
        spectrum, used = self.spectrum, wavelength_nm or self.wavelength_nm
        values = f"a {self.a:.4g}, b {self.b:.4g} m-1{f' at {used:g} nm' if used else ''}{surface}"
        if spectrum is None:
            # Petzold's waters are recognised by a and b: the defaults are those of his clear water
            names = (name for name, known in PETZOLD.items() if known == (self.a, self.b))
            spectrum = next((WaterType(type=f"petzold-{name}") for name in names), None)
        elif self.wavelength_nm != used:
            # used at a wavelength for which its values were not computed
            return f"{values}: {spectrum.source}, for {self.wavelength_nm:g} nm"
        return f"{values}: {spectrum.source if spectrum else 'as given'}"

    @classmethod
    def from_type(cls, type: str, wavelength_nm: float | None = None, **parameters: Any) -> Self:
        """Return the water of a type in the tables of `spectra.coefficients`.

        Parameters
        ----------
        type : str
            One of `spectra.WATER_TYPES`, in any spelling: "jerlov-II", "Jerlov II" or "ii".
        wavelength_nm : float, optional
            Wavelength in vacuum [nm], by default 470, for Petzold's waters 514.
        **parameters
            Other parameters of `Water`; they take precedence. With a and b, or layers, the type
            gives the phase function alone, at any wavelength.

        Returns
        -------
        Water
            With the type as its spectrum, and the phase function of `spectra.WaterType`.

        Raises
        ------
        Refused
            If the type is not known or not tabulated at the wavelength.

        Examples
        --------
        >>> Water.from_type("jerlov-IB", wavelength_nm=475).b
        0.0635
        >>> print(Water.from_type("coastal"))
        a 0.179, b 0.219 m-1 at 514 nm: petzold-coastal (measured at 514 nm, Petzold 1972)
        """
        spectrum = WaterType(type=type)
        if wavelength_nm is None:
            wavelength_nm = PETZOLD_NM if spectrum.type.startswith("petzold") else 470.0
        if {"a", "b"} <= parameters.keys() or parameters.get("layers") is not None:
            return cls.model_validate({"phase": spectrum.phase} | parameters)
        return cls(**parameters, spectrum=spectrum, wavelength_nm=wavelength_nm)

    @classmethod
    def from_file(
        cls, path: str | PathLike[str], wavelength_nm: float = 470.0, **parameters: Any
    ) -> Self:
        """Return the water of a file: SeaBASS, a BGC-Argo profile or a text table.

        Parameters
        ----------
        path : path
            See `water_files.read_spectrum`.
        wavelength_nm : float
            Wavelength in vacuum [nm].
        **parameters
            Other parameters of `Water`; they take precedence.

        Returns
        -------
        Water
            With the table, or the constituents, of the file as its spectrum.

        Raises
        ------
        Refused
            If the file cannot be read, or has no values at the wavelength.
        """
        return cls(**parameters, spectrum=read_spectrum(path), wavelength_nm=wavelength_nm)


@lru_cache(maxsize=1024)
def _derived(spectrum: WaterSpectrum, wavelength_nm: float) -> dict[str, Any]:
    """Return the fields of a water that follow from its spectrum, with defaults for the others."""
    fields = {name: Water.model_fields[name].default for name in ("n", "phase", "layers")}
    fields |= spectrum.properties(wavelength_nm)
    if fields["layers"] is not None:
        _, fields["a"], fields["b"] = fields["layers"][0]
    return fields


def _same(value: Any, derived: Any) -> bool:
    """Return whether a value is the derived one, up to rounding on other machines."""
    numbers = isinstance(value, float | tuple) and isinstance(derived, float | tuple)
    if not numbers or np.shape(value) != np.shape(derived):
        return bool(value == derived)
    return bool(np.allclose(value, derived, rtol=1e-9, atol=0.0))
