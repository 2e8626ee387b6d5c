"""Figures of the stations, their temperature and salinity over depth, and the refraction there.

Profiles come from netCDF files as the AODN portal and the Argo programme give them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from meshtrace import viz
from meshtrace.errors import Described, Refused, one_line, require_array, require_kind, require_real
from meshtrace.fields import attrs
from meshtrace.optics.pure_water import quan_fry
from meshtrace.stored import read_dataset
from paper.links import panels
from paper.registry import Entry, FigureOutput, Floats, Setting, row

STEEPEST = math.radians(80.0)
"""Largest angle from the vertical that `ray_deflection` follows."""

_GOOD = ("1", "2", "5", "8")
"""Flags of the Argo and IMOS conventions for good, probably good, changed and interpolated."""

_NAMES = {
    "temperature": ("TEMP", "TEMPERATURE", "sea_water_temperature"),
    "salinity": ("PSAL", "SALINITY", "sea_water_practical_salinity", "sea_water_salinity"),
    "depth": ("DEPTH", "depth"),
    "pressure": (
        "PRES",
        "PRES_REL",
        "sea_water_pressure",
        "sea_water_pressure_due_to_sea_water",
    ),
    "latitude": ("LATITUDE", "LAT", "latitude"),
    "longitude": ("LONGITUDE", "LON", "longitude"),
}
"""Names or CF standard names of the variables; the first one present is used."""


class Deflection(NamedTuple):
    """Effect of layers on a ray: `offset` at the surface [m] and change of `angle` there [rad]."""

    offset: float
    angle: float


@dataclass(frozen=True, eq=False)
class WaterProfile:
    """Temperature and salinity over depth at one place.

    Parameters
    ----------
    depth : ndarray, shape (n,)
        Depths [m], strictly increasing, n >= 2.
    temperature : ndarray, shape (n,)
        Temperature [degree Celsius].
    salinity : ndarray, shape (n,)
        Practical salinity [1], taken as g/kg.
    latitude, longitude : float
        Place [degrees north, east]; nan if unknown.
    name : str
        Name in legends.

    Raises
    ------
    Refused
        If the arrays do not match or are not finite, or the depths do not increase.
    """

    depth: Floats
    temperature: Floats
    salinity: Floats
    latitude: float = math.nan
    longitude: float = math.nan
    name: str = ""

    def __post_init__(self) -> None:
        names = ("depth", "temperature", "salinity")
        columns = [require_array(getattr(self, name), name, "numbers (n,)") for name in names]
        for name, values in zip(names, columns, strict=True):
            object.__setattr__(self, name, values)
        for name in ("latitude", "longitude"):
            object.__setattr__(self, name, require_real(getattr(self, name), name, "degrees"))
        shapes = [np.shape(values) for values in columns]
        if len(set(shapes)) != 1 or len(shapes[0]) != 1 or shapes[0][0] < 2:
            raise Refused("depth, temperature, salinity", shapes, "shapes (n,) of n >= 2")
        if not np.isfinite(np.array(columns)).all():
            described = Described("nan or inf")
            raise Refused("depth, temperature, salinity", described, "finite values")
        if self.depth[0] < 0.0 or not (np.diff(self.depth) > 0.0).all():
            raise Refused("depth", self.depth.tolist(), "strictly increasing depths >= 0 m")

    def n(self, depth: ArrayLike, wavelength_nm: float = 470.0) -> Floats:
        """Return the refractive index at depths, linear between the samples, even above them.

        Parameters
        ----------
        depth : array_like
            Depths [m].
        wavelength_nm : float
            Wavelength [nm], 400 ... 700.

        Returns
        -------
        ndarray
            Refractive index relative to air.

        Raises
        ------
        Refused
            If a depth lies below the profile or a temperature outside 0 ... 30 degrees Celsius.

        Notes
        -----
        Quan and Fry fitted up to 35 g/kg, coral seas have a little more: their formula, which is
        linear in the salinity, is extended.
        """
        z = require_array(depth, "depth", "numbers")
        if not ((z >= 0.0) & (z <= self.depth[-1])).all():
            raise Refused("depth", z.tolist(), f"0 <= depth <= {self.depth[-1]:g} m")
        fresh, salt = (quan_fry(wavelength_nm, self.temperature, s) for s in (0.0, 35.0))
        return np.interp(z, self.depth, fresh + self.salinity / 35.0 * (salt - fresh))


def ray_deflection(
    profile: WaterProfile, depth: float, zenith: float, wavelength_nm: float = 470.0
) -> Deflection:
    """Return the deflection of a ray on its way up through layered water.

    x = integral of tan(theta(z)) dz,  n(z) sin(theta(z)) = n(d) sin(theta(d))

    Parameters
    ----------
    profile : WaterProfile
        The layers.
    depth : float
        Depth of the start of the ray [m].
    zenith : float
        Its angle from the vertical there [rad], 0 ... 80 degrees.
    wavelength_nm : float
        Wavelength [nm].

    Returns
    -------
    Deflection
        Horizontal offset at the surface from a straight ray, and change of the angle there:
        negative for a steeper ray, positive for a flatter one.

    Raises
    ------
    Refused
        If the start lies below the profile, the angle is not allowed, or a layer reflects the
        ray.

    Notes
    -----
    The direction in the air is that without layers, since n sin(theta) is conserved: the offset at
    the receiver is that at the surface. A vertical ray is not deflected. Turbulence and horizontal
    gradients are neglected.

    Examples
    --------
    >>> import numpy as np
    >>> z = np.array([0.0, 50.0])
    >>> layers = WaterProfile(z, np.array([26.0, 22.0]), np.array([35.0, 35.0]))
    >>> bent = ray_deflection(layers, 50.0, np.radians(10.0))
    >>> f"{1e3 * bent.offset:.1f} mm"
    '1.6 mm'
    """
    require_kind(profile, WaterProfile, "profile")
    allowed = f"0 <= zenith <= {STEEPEST:.3f} rad"
    if not 0.0 <= require_real(zenith, "zenith", allowed) <= STEEPEST:
        raise Refused("zenith", zenith, allowed)
    allowed = f"0 < depth <= {profile.depth[-1]:g} m"
    if not 0.0 < require_real(depth, "depth", allowed) <= profile.depth[-1]:
        raise Refused("depth", depth, allowed)
    invariant = float(profile.n(depth, wavelength_nm)) * math.sin(zenith)
    inner = profile.depth[(profile.depth > 0.0) & (profile.depth < depth)]
    edges = np.concatenate([[0.0], inner, [depth]])
    x, weight = np.polynomial.legendre.leggauss(4)
    half = 0.5 * np.diff(edges)[:, None]
    sine = invariant / profile.n(edges[:-1, None] + half * (x + 1.0), wavelength_nm)
    at_surface = invariant / float(profile.n(0.0, wavelength_nm))
    if max(float(sine.max()), at_surface) >= 1.0:
        raise Refused("zenith", zenith, "angles without total reflection in a layer")
    slope = sine / np.sqrt(1.0 - sine**2) - math.tan(zenith)
    return Deflection(float(np.sum(half * weight * slope)), math.asin(at_surface) - zenith)


def depth_of_pressure(pressure: ArrayLike, latitude: float) -> Floats:
    """Return the depth in sea water of a pressure.

    Parameters
    ----------
    pressure : array_like
        Pressure above that of the air [dbar].
    latitude : float
        Latitude [degrees].

    Returns
    -------
    ndarray
        Depth [m].

    Raises
    ------
    Refused
        If an argument is no number, or the latitude is not one.

    References
    ----------
    Fofonoff and Millard 1983, Unesco technical papers in marine science 44, algorithm 5.

    Examples
    --------
    >>> round(float(depth_of_pressure(10000.0, 30.0)), 3)
    9712.653
    """
    p = require_array(pressure, "pressure", "numbers [dbar]")
    latitude = require_real(latitude, "latitude", "-90 <= latitude <= 90 degrees")
    if not abs(latitude) <= 90.0:
        raise Refused("latitude", latitude, "-90 <= latitude <= 90 degrees")
    x = math.sin(math.radians(latitude)) ** 2
    gravity = 9.780318 * (1.0 + (5.2788e-3 + 2.36e-5 * x) * x) + 1.092e-6 * p
    return (((-1.82e-15 * p + 2.279e-10) * p - 2.2512e-5) * p + 9.72659) * p / gravity


def load_profiles(path: str | Path) -> list[WaterProfile]:
    """Read the profiles of a netCDF file of the AODN (IMOS) or of Argo.

    Parameters
    ----------
    path : path
        The file, with TEMP and PSAL over DEPTH or PRES; several profiles over a first dimension.

    Returns
    -------
    list of WaterProfile
        Samples with a good quality flag, sorted by depth; adjusted values of Argo where present.
        Profiles with fewer than two good samples are omitted.

    Raises
    ------
    Refused
        If the file cannot be read, lacks a variable, or has no good profile.
    """
    data = read_dataset(path, decode_times=False)
    try:
        found = list(_profiles(data, str(path)))
    except (ValueError, TypeError, IndexError, KeyError) as error:
        if isinstance(error, Refused):
            raise
        described = Described(f"{type(error).__name__}: {one_line(error)}")
        raise Refused("", described, "profiles of the AODN or of Argo", source=str(path)) from error
    if not found:
        described = Described("no good samples")
        raise Refused("", described, "a profile of two or more samples", source=str(path))
    return found


def profiles_of(setting: Setting) -> list[WaterProfile]:
    """Return the profiles of the given files, or stand-ins for them.

    Raises
    ------
    Refused
        If a file cannot be read.
    """
    if not setting.profiles:
        return stand_ins()
    return [profile for path in setting.profiles for profile in load_profiles(path)]


def stand_ins() -> list[WaterProfile]:
    """Return invented profiles: the data of the paper cannot be distributed.

    A mixed layer as in the paper, and two profiles with sharper thermoclines.
    """
    z = np.linspace(0.0, 100.0, 201)
    shapes = (("stand-in, mixed", 80.0, 20.0, 2.0, 0.1), ("stand-in, weak", 40.0, 10.0, 2.0, 0.3))
    sharp = ("stand-in, sharp", 25.0, 2.0, 4.0, 0.6)
    return [
        WaterProfile(
            z,
            26.0 - 0.5 * drop * (1.0 + np.tanh((z - middle) / width)),
            35.2 + 0.5 * fresh * np.tanh((z - middle) / width),
            name=name,
        )
        for name, middle, width, drop, fresh in (*shapes, sharp)
    ]


def _profiles(data: xr.Dataset, path: str) -> Iterator[WaterProfile]:
    like = _variable(data, "temperature", path)
    depth = _optional(data, "depth")
    vertical = _variable(data, "pressure", path) if depth is None else depth
    names = [str(v.name) for v in (vertical, like, _variable(data, "salinity", path))]
    levels = [_levels(data, name, like) for name in names]
    count = len(levels[0])
    latitudes, longitudes = (_places(_optional(data, k), count) for k in ("latitude", "longitude"))
    for i, (z, *columns) in enumerate(zip(*levels, strict=True)):
        lat, lon = latitudes[i], longitudes[i]
        if depth is None:
            z = depth_of_pressure(z, lat if math.isfinite(lat) else 0.0)
        good = np.isfinite(np.array([z, *columns])).all(axis=0) & (z >= 0.0)
        rising, first = np.unique(z[good], return_index=True)
        if len(rising) >= 2:
            warm, salt = (column[good][first] for column in columns)
            name = Path(path).stem + (f" {i + 1}" if count > 1 else "")
            yield WaterProfile(rising, warm, salt, lat, lon, name)


def _optional(data: xr.Dataset, what: str) -> xr.DataArray | None:
    for name in _NAMES[what]:
        for key in data.variables:
            if key == name or data[key].attrs.get("standard_name") == name:
                return data[key]
    return None


def _variable(data: xr.Dataset, what: str, path: str) -> xr.DataArray:
    found = _optional(data, what)
    if found is None:
        raise Refused("", Described(f"no {what}"), " or ".join(_NAMES[what]), source=path)
    return found


def _levels(data: xr.Dataset, name: str, like: xr.DataArray) -> Floats:
    """Return a variable (profiles, levels), nan for values without a good flag.

    Profiles that Argo has adjusted, by their mode of data, hold the adjusted values.
    """
    found = _good(data, name, like)
    adjusted = np.isin(_texts(data.get("DATA_MODE", "")), ("A", "D")).reshape(-1, 1)
    if f"{name}_ADJUSTED" in data and adjusted.any():
        found = np.where(adjusted, _good(data, f"{name}_ADJUSTED", like), found)
    return found


def _good(data: xr.Dataset, name: str, like: xr.DataArray) -> Floats:
    """Return a variable (profiles, levels), nan for values without a good flag."""

    def table(key: str) -> NDArray[Any]:
        full = data[key].broadcast_like(like).transpose(*like.dims)
        return full.to_numpy().reshape(-1, like.shape[-1])

    values = table(name).astype(float)
    for flag in (f"{name}_QC", f"{name}_quality_control"):
        if flag in data:
            # characters (Argo) or numbers (IMOS), blank if there is none
            codes = np.char.partition(np.char.strip(_texts(table(flag))), ".")[..., 0]
            values = np.where(np.isin(codes, _GOOD), values, np.nan)
    return values


def _places(variable: xr.DataArray | None, count: int) -> list[float]:
    """Return the coordinate of each profile [degrees]; one value holds for all profiles."""
    found = np.ravel(math.nan if variable is None else variable.to_numpy()).astype(float)
    return np.resize(found, count).tolist() if len(found) < count else found.tolist()


def _texts(values: Any) -> NDArray[np.str_]:
    """Return values as text; bytes are decoded."""
    found = np.asarray(values)
    return np.char.decode(found.astype("S")) if found.dtype.kind in "SO" else found.astype(str)


STATIONS = ((165.91, -21.17), (167.33, -22.11), (165.45, -20.51))
"""Longitude and latitude [degrees east, north] of the stations, Appendix A."""

EARTH_RADIUS = 6371.0
"""Mean radius [km]."""

DEEPEST = 50.0
"""Largest depth of interest [m]."""

STAND_INS = (
    "NOT the paper's data, which cannot be distributed: invented profiles, from a mixed layer "
    "to a thermocline far sharper than the paper reports. Use --profiles for files of the AODN "
    "portal or of Argo."
)

_ALONG = {
    "temperature": "temperature $T$ [°C]",
    "salinity": "practical salinity $S$ [psu]",
    "n_water": "refractive index at 470 nm",
}

ZENITHS = np.radians(np.linspace(0.0, 40.0, 41))


def stations(setting: Setting) -> FigureOutput:
    """Draw the stations on a map without coast lines."""
    given = [p for p in profiles_of(setting) if np.isfinite([p.longitude, p.latitude]).all()]
    lon, lat = np.array(STATIONS).T
    picture, axes = panels(width=5.0, height=4.6)
    ax = axes[0, 0]
    ax.plot(lon, lat, "*", color=viz.style.PALETTE["orange"], markersize=14, label="printed")
    for i, (x, y) in enumerate(STATIONS, start=1):
        ax.annotate(f"station {i}", (x, y), (8, 6), textcoords="offset points")
    if given:
        measured = np.array([(p.longitude, p.latitude) for p in given])
        ax.plot(*measured.T, "o", color=viz.style.PALETTE["blue"], label="files of profiles")
        ax.legend()
    ax.set(xlabel="longitude [° E]", ylabel="latitude [° N]")
    ax.set_aspect(1.0 / np.cos(np.radians(lat.mean())))
    ax.margins(0.35)
    numbers = [
        row("distance", (None, _distance(STATIONS[i], STATIONS[j])), i=i + 1, j=j + 1)
        for i, j in itertools.combinations(range(len(STATIONS)), 2)
    ]
    degrees = {"units": "degrees_east"}, {"units": "degrees_north"}
    places = {"longitude": ("station", lon, degrees[0]), "latitude": ("station", lat, degrees[1])}
    data = xr.Dataset(places)
    circles = "Circles: places of the given profiles. " if given else ""
    return FigureOutput(picture, data, numbers, {"circles": circles})


def _distance(p: tuple[float, float], q: tuple[float, float]) -> float:
    """Return the great-circle distance [km] of two places (longitude, latitude) [degrees]."""
    (lon1, lat1), (lon2, lat2) = np.radians(p), np.radians(q)
    a = np.sin((lat2 - lat1) / 2) ** 2
    a += np.cos(lat1) * np.cos(lat2) * np.sin((lon2 - lon1) / 2) ** 2
    return float(2.0 * EARTH_RADIUS * np.arcsin(np.sqrt(a)))


def temperature_salinity(setting: Setting) -> FigureOutput:
    """Draw temperature, salinity and refractive index over depth, and the deflection of rays."""
    profiles = profiles_of(setting)
    data = _dataset(profiles)
    picture, axes = panels(2, 2)
    for ax, (name, label) in zip(axes.flat, _ALONG.items(), strict=False):
        ax.plot(data[name].T, data["depth"], label=data["profile"].values.tolist())
        ax.set(xlabel=label, ylim=(data["depth"][-1], 0.0))
    for ax in axes[:, 0]:
        ax.set_ylabel(viz.axis_label("depth"))
    axes[1, 0].ticklabel_format(axis="x", useOffset=False)
    axes[1, 0].locator_params(axis="x", nbins=4)
    axes[1, 1].plot(np.degrees(ZENITHS), 1e3 * data["offset"].T)
    ends = {"xlabel": "angle of the ray at the source [°]", "ylabel": "offset at the surface [mm]"}
    axes[1, 1].set(**ends)
    for ax in axes.flat:
        viz.marks.finished(ax, legend=ax is axes[0, 0])
    rows = zip(profiles, data["start_depth"].values, data["offset"].values, strict=True)
    numbers = [entry for row_of in rows for entry in _numbers(*row_of)]
    source = "Profiles of the given files." if setting.profiles else STAND_INS
    return FigureOutput(picture, data, numbers, {"source": source})


def _numbers(profile: WaterProfile, depth: float, offset: Any) -> list[Entry]:
    shown = profile.depth <= depth
    at = int(np.argmin(np.abs(ZENITHS - np.radians(10.0))))
    words = {"depth": depth, "name": profile.name, "angle": np.degrees(ZENITHS[at])}
    return [
        row("temperature", (float(np.ptp(profile.temperature[shown])), None), **words),
        row("salinity", (float(np.ptp(profile.salinity[shown])), None), **words),
        row("offset", (1e3 * float(offset[at]), 0.0), **words),
    ]


def _dataset(profiles: list[WaterProfile]) -> xr.Dataset:
    """Return the layers of all profiles on one grid, nan below them, and the offsets of rays."""
    depths = [min(DEEPEST, float(profile.depth[-1])) for profile in profiles]
    grid, dims = np.linspace(0.0, max(depths), 101), ("profile", "depth")
    offsets = [
        [ray_deflection(profile, depth, float(angle)).offset for angle in ZENITHS]
        for profile, depth in zip(profiles, depths, strict=True)
    ]

    def on_grid(values: Callable[[WaterProfile], Floats]) -> list[Floats]:
        return [np.interp(grid, p.depth, values(p), right=np.nan) for p in profiles]

    variables = {
        "temperature": (dims, on_grid(lambda p: p.temperature), {"units": "degree_Celsius"}),
        "salinity": (dims, on_grid(lambda p: p.salinity), {"units": "1"}),
        "n_water": (dims, on_grid(lambda p: p.n(p.depth)), {"units": "1"}),
        "offset": (("profile", "zenith"), offsets, {"units": "m"}),
        "start_depth": ("profile", depths, {"units": "m"}),
    }
    zenith, names = ("zenith", ZENITHS, {"units": "rad"}), [p.name for p in profiles]
    depth = ("depth", grid, attrs("depth"))
    return xr.Dataset(variables, {"profile": names, "depth": depth, "zenith": zenith})
