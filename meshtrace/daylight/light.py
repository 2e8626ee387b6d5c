"""Daylight above the sea: spectra of the clear sky (by pvlib), position of the sun, irradiances."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime
from functools import lru_cache
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from meshtrace.checks import Shape, check_call
from meshtrace.errors import MISSING, Described, Refused, extra, require_word
from meshtrace.kernels.sources import Sky
from meshtrace.kernels.sources import land_sunlight as land_sunlight
from meshtrace.models import Finite, Floats, Model, NonNegative
from meshtrace.optics.fresnel import fresnel_reflectance, unit_vector
from meshtrace.optics.pure_water import read_table

from .patterns import PATTERNS, sky

_TABLE_NM = 470.0  # wavelength of clear_irradiance.csv

SPECTRUM_FROM_NM = 300.0
"""Shortest wavelength of SPECTRL2 [nm]."""


class Irradiance(NamedTuple):
    """Spectral irradiance above the sea [W m-2 nm-1]: direct normal, diffuse horizontal."""

    direct: float
    diffuse: float


class SunPosition(NamedTuple):
    """Apparent zenith angle and azimuth of the sun [deg], counter-clockwise from east, and day."""

    zenith_deg: float
    azimuth_deg: float
    day_of_year: int


def _pvlib() -> Any:
    """Import pvlib; refuse if it is not installed."""
    missing = Described("pvlib is not installed")
    with extra("daylight", "daylight", missing, "the extra daylight, {}, or direct and diffuse"):
        import pvlib
    return pvlib


@check_call
def clear_irradiance(
    sun_zenith_deg: Annotated[float, Field(ge=0.0, le=89.0)],
    wavelength_nm: Annotated[float, Field(ge=300.0, le=1100.0)] = 470.0,
    *,
    width_nm: Annotated[float, Field(ge=0.0, le=400.0)] = 0.0,
    aerosol: Annotated[float, Field(ge=0.0, le=5.0)] = 0.10,
    ozone: Annotated[float, Field(ge=0.0, le=2.0)] = 0.30,
    water_vapour: Annotated[float, Field(ge=0.0, le=20.0)] = 2.0,
    pressure: Annotated[float, Field(ge=0.0, le=2e5)] = 101325.0,
    ground_albedo: Annotated[float, Field(ge=0.0, le=1.0)] = 0.06,
    day_of_year: Annotated[int, Field(ge=1, le=366)] = 80,
) -> Irradiance:
    """Return the irradiance of sun and clear sky by SPECTRL2, linear between its wavelengths.

    Parameters
    ----------
    sun_zenith_deg : float
        Apparent zenith angle of the sun [deg], 0 ... 89.
    wavelength_nm : float
        Middle of the band [nm], 300 ... 1100.
    width_nm : float
        Width of the band that is averaged [nm]; 0 for a single wavelength.
    aerosol : float
        Optical depth of the aerosol at 500 nm.
    ozone, water_vapour : float
        Columns [cm].
    pressure : float
        Pressure at the surface [Pa].
    ground_albedo : float
        Albedo of the surface.
    day_of_year : int
        Day, for the distance of the sun.

    Returns
    -------
    Irradiance

    Raises
    ------
    Refused
        If a value is out of range, or pvlib is not installed.

    Notes
    -----
    The aerosol of SPECTRL2 is rural; over oceans Gregg and Carder (1990) is the usual model. Air
    mass of Kasten and Young (1989).

    References
    ----------
    Bird and Riordan (1986), J. Clim. Appl. Meteorol. 25, 87.
    """
    least = wavelength_nm - 0.5 * width_nm
    # longer wavelengths than SPECTRL2 has (4000 nm) cannot be asked for
    if least < SPECTRUM_FROM_NM:
        allowed = f"a band from {SPECTRUM_FROM_NM:g} nm"
        raise Refused("width_nm", width_nm, allowed, f"from {least:g} nm,")
    nodes_nm, *spectra = _clear_spectra(
        sun_zenith_deg, aerosol, ozone, water_vapour, pressure, day_of_year, ground_albedo
    )
    # the mean over a band is that of 101 wavelengths at equal steps
    nm = wavelength_nm + 0.5 * width_nm * (np.linspace(-1.0, 1.0, 101) if width_nm else np.zeros(1))
    direct, diffuse = (float(np.interp(nm, nodes_nm, values).mean()) for values in spectra)
    return Irradiance(direct, diffuse)


@lru_cache(maxsize=64)
def _clear_spectra(
    sun_zenith_deg: float, aerosol: float, ozone: float, water_vapour: float, pressure: float,
    day_of_year: int, ground_albedo: float = 0.06,
) -> tuple[Floats, Floats, Floats]:  # fmt: skip
    """Return wavelengths [nm], direct normal and diffuse horizontal irradiance of SPECTRL2."""
    pvlib = _pvlib()
    air_mass = pvlib.atmosphere.get_relative_airmass(sun_zenith_deg, model="kastenyoung1989")
    spectrum = pvlib.spectrum.spectrl2(
        apparent_zenith=sun_zenith_deg,
        # on a horizontal plane the angle of incidence is the zenith angle
        aoi=sun_zenith_deg,
        surface_tilt=0.0,
        ground_albedo=ground_albedo,
        surface_pressure=pressure,
        relative_airmass=air_mass,
        precipitable_water=water_vapour,
        ozone=ozone,
        aerosol_turbidity_500nm=aerosol,
        dayofyear=day_of_year,
    )
    nodes, direct, diffuse = (np.ravel(spectrum[name]) for name in ("wavelength", "dni", "dhi"))
    return nodes, direct, diffuse


@check_call
def default_irradiance(zenith_deg: float, wavelength_nm: float) -> Irradiance:
    """Return `clear_irradiance` with its defaults; at 470 nm from a table, without pvlib."""
    if wavelength_nm != _TABLE_NM:
        return clear_irradiance(zenith_deg, wavelength_nm)
    from scipy.interpolate import CubicSpline

    table = read_table("clear_irradiance.csv")
    irradiances = CubicSpline(table[:, 0], table[:, 1:])(zenith_deg)
    return Irradiance(*(float(v) for v in irradiances))


@check_call
def sun_position(
    time: Any,
    latitude: Annotated[float, Field(ge=-90.0, le=90.0)],
    longitude: Annotated[float, Field(ge=-180.0, le=180.0)],
) -> SunPosition:
    """Return the position of the sun.

    Parameters
    ----------
    time : str or datetime
        Time of ISO 8601 with its zone, such as "2026-06-21T10:00Z".
    latitude, longitude : float
        Place [deg], north and east positive.

    Raises
    ------
    Refused
        If the time has no zone or cannot be read, a coordinate is out of range, or pvlib is not
        installed.

    Notes
    -----
    x points east and y north: the azimuth from north is turned into one from +x.
    """
    pvlib = _pvlib()
    import pandas as pd

    stamp = pd.Timestamp(_time_with_zone(time))
    row = pvlib.solarposition.get_solarposition(pd.DatetimeIndex([stamp]), latitude, longitude)
    zenith, azimuth = float(row["apparent_zenith"].iloc[0]), float(row["azimuth"].iloc[0])
    return SunPosition(zenith, (90.0 - azimuth) % 360.0, stamp.day_of_year)


def _time_with_zone(time: Any) -> datetime:
    """Return a time of ISO 8601 with its zone, or refuse it."""
    allowed = "a time of ISO 8601 with its zone, such as 2026-06-21T10:00Z"
    try:
        # in other forms, such as 05/06/2026, day and month depend on the country
        moment = datetime.fromisoformat(time) if isinstance(time, str) else time
    except ValueError as error:
        raise Refused("time", time, allowed) from error
    has_zone = isinstance(moment, datetime) and moment.tzinfo is not None
    # `fromisoformat` takes any character between date and time: only T and the blank are allowed
    if not has_zone or (isinstance(time, str) and not re.match(r"[\dW-]{7,10}[T ]", time)):
        raise Refused("time", time, allowed)
    return moment


WaterLight = Literal["quasi-single", "walk", "none"]
"""Models of the light that leaves the water, see `Daylight.water`."""

MOON_OVER_SUN = 2.512e-6
"""Irradiance of the full moon over that of the sun: 14.0 magnitudes."""

NIGHT_RADIANCE = 2.3e-9
"""Radiance of the moonless sky at 470 nm [W m-2 sr-1 nm-1], see `Daylight.night`."""

OVERCAST_TRANSMITTANCE = 0.25
"""Global irradiance under a closed cloud cover over that of the clear sky, see `overcast`."""

SUN_RADIUS_DEG = 0.2665
"""Angular radius of sun and moon [deg]."""

_HORIZON = "0 <= sun_zenith_deg <= 89 (below the horizon: use night)"

SUN = ("sun_zenith_deg", "sun_azimuth_deg")
"""Fields for the position of the sun, or of the moon."""

_ATMOSPHERE = ("aerosol", "ozone", "water_vapour", "pressure", "day_of_year")


MODELS = {
    "clear": {"light": "clear sky"},
    "overcast": {"light": "overcast sky", "pattern": "cie-1"},
    "uniform": {"light": "uniform sky", "pattern": "uniform"},
    "moon": {"light": "moonlight"},
    "night": {"light": "moonless night", "pattern": "uniform"},
}
"""Fields that each model of natural light sets, by its name in link files.

"uniform" needs its irradiance, the others compute theirs.
"""

MODEL_KEYS: Mapping[str, tuple[str, ...]] = dict.fromkeys(MODELS, ()) | {
    "clear": ("time", "latitude", "longitude", *_ATMOSPHERE, "width_nm"),
    "overcast": ("transmittance",),
    "moon": ("phase_deg",),
}
"""Keys of each model in link files, beside the fields of `Daylight`."""


class Daylight(Model, frozen=True):
    """Light of sun and sky, or of moon and night, above the sea at one wavelength.

    Parameters
    ----------
    direct : float
        Irradiance of sun or moon across its own direction [W m-2 nm-1], >= 0.
    diffuse : float
        Horizontal irradiance of the sky [W m-2 nm-1], >= 0; not both 0.
    sun_zenith_deg : float
        Zenith angle of sun or moon [deg], 0 ... 89.
    sun_azimuth_deg : float
        Azimuth at which it stands, counter-clockwise from +x [deg]; its light travels to the
        opposite azimuth.
    wavelength_nm : float
        Wavelength [nm], 300 ... 1100.
    pattern : str
        Pattern of the sky: "cie-12" (clear), any other of "cie-1" ... "cie-15", "uniform",
        "overcast" or "harrison-coombes".
    water : {"quasi-single", "walk", "none"}
        Light that leaves the water towards a receiver in the air: closed form of single
        scattering, photons traced backwards, or none. Light under water is always traced.
    foam_reflectance : float
        Effective reflectance of whitecaps [1], 0 ... 1.
    light : str
        Name of the light in results.
    recipe : mapping of str to number
        Options, other than the defaults, of the model that gave the irradiances, such as
        `aerosol` of `clear_sky`; link files keep them. No result depends on it.

    Raises
    ------
    Refused
        If a value is out of range.

    Notes
    -----
    Foam: 0.22 in the visible, Koepke (1984), Appl. Opt. 23, 1816, as tabulated in 6S.

    Examples
    --------
    >>> day = Daylight(direct=1.42, diffuse=0.295)
    >>> round(day.irradiance, 4)
    1.5248
    """

    direct: NonNegative
    diffuse: NonNegative
    sun_zenith_deg: float = Field(default=30.0, allow_inf_nan=False)
    sun_azimuth_deg: Finite = 0.0
    wavelength_nm: float = Field(default=470.0, ge=300.0, le=1100.0, allow_inf_nan=False)
    pattern: str = "cie-12"
    water: WaterLight = "quasi-single"
    foam_reflectance: float = Field(default=0.22, ge=0.0, le=1.0, allow_inf_nan=False)
    light: str = "daylight"
    recipe: dict[str, int | float] = Field(default_factory=dict)

    @field_validator("sun_zenith_deg")
    @classmethod
    def _above_horizon(cls, zenith: float) -> float:
        if not 0.0 <= zenith <= 89.0:
            raise Refused("sun_zenith_deg", zenith, _HORIZON)
        return zenith

    @field_validator("pattern")
    @classmethod
    def _known_pattern(cls, pattern: str) -> str:
        require_word(pattern, PATTERNS, "pattern")
        return pattern

    @model_validator(mode="after")
    def _some_light(self) -> Self:
        if self.direct == 0.0 and self.diffuse == 0.0:
            raise Refused("direct, diffuse", (0.0, 0.0), "some light: direct or diffuse > 0")
        return self

    @property
    def irradiance(self) -> float:
        """Irradiance of the horizontal sea, direct cos z + diffuse [W m-2 nm-1]."""
        return self.direct * math.cos(math.radians(self.sun_zenith_deg)) + self.diffuse

    @property
    def sun(self) -> tuple[float, float, float]:
        """Unit vector to the sun or moon."""
        return unit_vector(self.sun_zenith_deg, self.sun_azimuth_deg)

    @property
    def sky(self) -> Sky:
        """Radiance of the sky, without the disk of the sun."""
        return sky(self.pattern, self.diffuse, self.sun_zenith_deg, self.sun_azimuth_deg)

    def spectrum(self, wavelength_nm: Annotated[Floats, Shape("n")]) -> Floats:
        """Return the horizontal irradiance at wavelengths (n,) [nm], over that at `wavelength_nm`.

        Parameters
        ----------
        wavelength_nm : ndarray, shape (n,)
            Wavelengths [nm].

        Raises
        ------
        Refused
            If pvlib (extra `daylight`) is not installed.

        Notes
        -----
        That of sun and clear sky by SPECTRL2 at this zenith angle and atmosphere, with a step of
        some 10 nm, so that Fraunhofer lines are smoothed; overcast skies and the moon have it too.
        Flat for the moonless night and for a uniform sky.
        """
        if self.pattern == "uniform":
            return np.ones_like(wavelength_nm)
        fields: dict[str, Any] = defaults_of("clear") | self.recipe
        # `_ATMOSPHERE` has the order of the arguments of `_clear_spectra`
        atmosphere = (fields[name] for name in _ATMOSPHERE)
        nodes_nm, direct, diffuse = _clear_spectra(self.sun_zenith_deg, *atmosphere)
        horizontal = math.cos(math.radians(self.sun_zenith_deg)) * direct + diffuse
        values = np.interp([self.wavelength_nm, *wavelength_nm], nodes_nm, horizontal)
        return np.asarray(values[1:] / values[0])

    @classmethod
    def clear_sky(
        cls,
        sun_zenith_deg: float = 30.0,
        sun_azimuth_deg: float = 0.0,
        wavelength_nm: float = 470.0,
        pattern: str = "cie-12",
        *,
        width_nm: float = 0.0,
        aerosol: float = 0.10,
        ozone: float = 0.30,
        water_vapour: float = 2.0,
        pressure: float = 101325.0,
        day_of_year: int = 80,
        **fields: Any,
    ) -> Self:
        """Return the light of sun and clear sky by the model SPECTRL2 (`clear_irradiance`).

        Parameters
        ----------
        sun_zenith_deg, sun_azimuth_deg, wavelength_nm, pattern
            As for the class.
        width_nm : float
            Width of the band that is averaged [nm].
        aerosol, ozone, water_vapour, pressure, day_of_year
            Atmosphere, see `clear_irradiance`.
        **fields
            Other fields of the class.

        Raises
        ------
        Refused
            If a value is out of range, or pvlib (extra `daylight`) is not installed.
        """
        options: dict[str, Any] = {
            "width_nm": width_nm, "aerosol": aerosol, "ozone": ozone,
            "water_vapour": water_vapour, "pressure": pressure, "day_of_year": day_of_year,
        }  # fmt: skip

        def by_spectrl2(checked: Self) -> Irradiance:
            return clear_irradiance(checked.sun_zenith_deg, checked.wavelength_nm, **options)

        fields |= {
            "sun_zenith_deg": sun_zenith_deg, "sun_azimuth_deg": sun_azimuth_deg,
            "wavelength_nm": wavelength_nm, "pattern": pattern,
        }  # fmt: skip
        return cls._modelled("clear", by_spectrl2, options, fields)

    @classmethod
    def at(
        cls, time: Any, latitude: float, longitude: float, wavelength_nm: float = 470.0,
        pattern: str = "cie-12", **options: Any,
    ) -> Self:  # fmt: skip
        """Return the light of sun and clear sky at a time and place.

        Parameters
        ----------
        time : str or datetime
            Time with its zone, such as "2026-06-21T10:00Z".
        latitude, longitude : float
            Place [deg], north and east positive.
        wavelength_nm, pattern, **options
            As for `clear_sky`.

        Raises
        ------
        Refused
            If the time has no zone, the sun is below 89 degrees of zenith angle, or pvlib (extra
            `daylight`) is not installed.

        Notes
        -----
        +x points east, +y north.
        """
        _require_absent(options, SUN)
        sun = sun_position(time, latitude, longitude)
        options.setdefault("day_of_year", sun.day_of_year)
        return cls.clear_sky(sun.zenith_deg, sun.azimuth_deg, wavelength_nm, pattern, **options)

    @classmethod
    def overcast(
        cls, sun_zenith_deg: float = 30.0, wavelength_nm: float = 470.0,
        transmittance: Annotated[float, Field(gt=0.0, le=1.0)] = OVERCAST_TRANSMITTANCE,
        **fields: Any,
    ) -> Self:  # fmt: skip
        """Return the light under closed clouds: a "cie-1" sky with a share of the clear irradiance.

        Parameters
        ----------
        sun_zenith_deg : float
            Zenith angle of the hidden sun [deg].
        wavelength_nm : float
            Wavelength [nm]; other than 470 nm needs pvlib.
        transmittance : float
            Fraction of the global irradiance of the clear sky, 0 < t <= 1.
        **fields
            Other fields of the class.

        Notes
        -----
        Kasten and Czeplak (1980), Solar Energy 24, 177: 1 - 0.75 (N / 8)^3.4 at N oktas of cloud,
        0.25 at N = 8, as coded in several models of the weather. It is a mean over the solar
        spectrum and over types of cloud; that it holds at one wavelength is an assumption.
        """

        def through_clouds(checked: Self) -> Irradiance:
            clear = default_irradiance(checked.sun_zenith_deg, checked.wavelength_nm)
            above_clouds = checked.replace(direct=clear.direct, diffuse=clear.diffuse)
            return Irradiance(0.0, transmittance * above_clouds.irradiance)

        fields |= {"sun_zenith_deg": sun_zenith_deg, "wavelength_nm": wavelength_nm}
        return cls._modelled("overcast", through_clouds, {"transmittance": transmittance}, fields)

    @classmethod
    def moon(
        cls, phase_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = 0.0,
        zenith_deg: float = 30.0, azimuth_deg: float = 0.0,
        wavelength_nm: float = 470.0, **fields: Any,
    ) -> Self:  # fmt: skip
        """Return moonlight, direct and scattered by the sky.

        E = E_sun 2.512e-6 10^(-0.4 (0.026 |alpha| + 4e-9 alpha^4))

        Parameters
        ----------
        phase_deg : float
            Phase angle alpha [deg], 0 for the full moon, -180 ... 180.
        zenith_deg, azimuth_deg : float
            Position of the moon [deg].
        wavelength_nm : float
            Wavelength [nm]; other than 470 nm needs pvlib.
        **fields
            Other fields of the class.

        Notes
        -----
        Phase law of Krisciunas and Schaefer (1991), PASP 103, 1033, for the V band. The spectrum
        is that of the sun. The moon is redder: by the reflectances of Kieffer and Stone (2005),
        Astron. J. 129, 2887, it has 15 % less light at 470 nm at full moon, 18 % at 90 degrees.
        """
        _require_absent(fields, SUN)

        def by_moon(checked: Self) -> Irradiance:
            sun = default_irradiance(checked.sun_zenith_deg, checked.wavelength_nm)
            # the sky scatters moonlight as it scatters sunlight
            moon_over_sun = MOON_OVER_SUN * moon_phase_factor(phase_deg)
            return Irradiance(moon_over_sun * sun.direct, moon_over_sun * sun.diffuse)

        fields |= {"sun_zenith_deg": zenith_deg, "sun_azimuth_deg": azimuth_deg}
        fields["wavelength_nm"] = wavelength_nm
        return cls._modelled("moon", by_moon, {"phase_deg": phase_deg}, fields)

    @classmethod
    def night(cls, **fields: Any) -> Self:
        """Return the light of a moonless night: a uniform sky of 2.3e-9 W m-2 sr-1 nm-1.

        Notes
        -----
        Between the B and V bands of dark sites: 22.7 and 21.9 magnitudes per square arcsecond at
        La Palma at the minimum of solar activity (Benn and Ellison 1998, La Palma technical note
        115), 22.6 and 21.6 at Paranal at its maximum (Patat 2003, Astron. Astrophys. 400, 1183),
        2.4e-9 and 2.8e-9 at 470 nm. The same value is taken at every wavelength.
        """
        dark = Irradiance(0.0, math.pi * NIGHT_RADIANCE)
        return cls._modelled("night", lambda _: dark, {}, fields)

    @classmethod
    def _modelled(
        cls,
        model: str,
        irradiance: Callable[[Self], Irradiance],
        options: Mapping[str, Any],
        fields: dict[str, Any],
    ) -> Self:
        """Build the daylight of a model; its recipe has the options that differ from defaults."""
        _require_absent(fields, ("direct", "diffuse", "recipe"))
        fields = MODELS[model] | fields
        # the model gets checked fields; the irradiances of 1 are placeholders
        checked = cls.model_validate(fields | {"direct": 1.0, "diffuse": 1.0})
        direct, diffuse = irradiance(checked)
        defaults = defaults_of(model)
        recipe = {name: value for name, value in options.items() if value != defaults[name]}
        return checked.replace(direct=direct, diffuse=diffuse, recipe=recipe)

    def at_wavelength(self, wavelength_nm: float) -> Self:
        """Return the light of the same model at another wavelength.

        Parameters
        ----------
        wavelength_nm : float
            Wavelength [nm]; other than 470 nm most models need pvlib.

        Raises
        ------
        Refused
            If the irradiances are not those of a model.

        Examples
        --------
        >>> Daylight.night().at_wavelength(520.0).wavelength_nm
        520.0
        """
        if wavelength_nm == self.wavelength_nm:
            return self
        fields = self.model_dump(exclude={"direct", "diffuse", "wavelength_nm", "recipe"})
        # "uniform" computes no irradiance
        models = {m["light"]: name for name, m in MODELS.items() if name != "uniform"}
        table = fields | self.recipe
        model = models.get(self.light)
        # irradiances that were set by hand follow from no model
        if model is None or light_of(model, self.wavelength_nm, table) != self:
            reason = Described(f"irradiances at {self.wavelength_nm:g} nm")
            raise Refused("day", reason, f"a model of {', '.join(models)}, for other wavelengths")
        return light_of(model, wavelength_nm, table)


class UnavailableDaylight:
    """Placeholder for daylight whose model needs a missing package; refused on use.

    A gain needs no daylight: a link file with a table [daylight] runs without the package.

    Parameters
    ----------
    table : dict
        The table [daylight] of the link file.
    refusal : Refused
        The error that names the package.
    """

    def __init__(self, table: dict[str, Any], refusal: Refused) -> None:
        self.table, self.refusal = table, refusal

    def __getattr__(self, name: str) -> Any:
        # copy, pickle and numpy look for special methods: they must get the usual error
        if name.startswith("__") or name not in {*Daylight.model_fields, *vars(Daylight)}:
            raise AttributeError(name)
        raise self.refusal


def light_of(model: str, wavelength_nm: float, table: Mapping[str, Any]) -> Any:
    """Return the `Daylight` of a model at a wavelength [nm], with the keys of a link file."""
    table = {"wavelength_nm": wavelength_nm} | dict(table)
    if "direct" in table or "diffuse" in table:
        _require_absent(table, MODEL_KEYS[model], "without direct and diffuse")
        irradiance = {"direct": 0.0, "diffuse": 0.0}
        return Daylight.model_validate(irradiance | MODELS[model] | table)
    if model == "uniform":
        raise Refused("diffuse", MISSING, "the irradiance of the uniform sky [W m-2 nm-1]")
    if "time" in table:
        _require_absent(table, SUN, "without time, which gives the sun")
        # `at` refuses a missing coordinate by its name
        model, table = "at", {"latitude": None, "longitude": None} | table
    if model == "moon":
        # link files give the position of the moon by the keys of the sun
        table = {key.removeprefix("sun_"): value for key, value in table.items()}
    return _maker(model)(**table)


def _maker(model: str) -> Callable[..., Daylight]:
    """Return the constructor of a model that computes irradiances."""
    maker: Callable[..., Daylight] = getattr(Daylight, {"clear": "clear_sky"}.get(model, model))
    return maker


@lru_cache(maxsize=8)
def defaults_of(model: str) -> dict[str, Any]:
    """Return the default values of the arguments of a model."""
    parameters = inspect.signature(_maker(model)).parameters
    return {name: parameter.default for name, parameter in parameters.items()}


_FOLLOWS = "none: it follows from the other arguments"


def _require_absent(
    fields: Mapping[str, Any], names: Iterable[str], allowed: str = _FOLLOWS
) -> None:
    """Refuse fields that follow from the other arguments."""
    for name in names:
        if name in fields:
            raise Refused(name, fields[name], allowed)


@check_call
def moon_phase_factor(phase_deg: Annotated[float, Field(ge=-180.0, le=180.0)]) -> float:
    """Return the irradiance of the moon at a phase angle [deg], relative to the full moon.

    Examples
    --------
    >>> round(moon_phase_factor(90.0), 4)
    0.091
    """
    # Krisciunas and Schaefer (1991)
    alpha = abs(phase_deg)
    return float(10.0 ** (-0.4 * (0.026 * alpha + 4e-9 * alpha**4)))


def refracted_sun(day: Daylight, n: float) -> tuple[Floats, float]:
    """Return the direction to the sun as seen under still water, and its irradiance there.

    Parameters
    ----------
    day : Daylight
        Light above the sea.
    n : float
        Refractive index of the water over that of the air, n >= 1.

    Returns
    -------
    direction : ndarray, shape (3,)
        Unit vector to the sun in the water, by Snell's law.
    irradiance : float
        Irradiance across the refracted light [W m-2 nm-1], behind the reflectance of Fresnel.
    """
    sun = np.array(day.sun)
    # Snell's law: the index divides the horizontal components
    inside = sun / n
    inside[2] = math.sqrt(1.0 - inside[0] ** 2 - inside[1] ** 2)
    transmittance = 1.0 - float(fresnel_reflectance(sun[2], 1.0, n))
    # a beam is wider in the water than in the air, by the ratio of its cosines there
    return inside, day.direct * transmittance * float(sun[2] / inside[2])
