"""Spectral irradiance of the clear sky and position of the sun, by pvlib (extra `daylight`)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from meshtrace.errors import Described, Refused, require_between

# zenith angle [deg], direct normal and diffuse horizontal irradiance at 470 nm [W m-2 nm-1] of
# `clear_irradiance` with its defaults, pvlib 0.16.1
_TABLE = (
    (0, 1.48813947, 0.309690989),
    (10, 1.48136548, 0.308144685),
    (20, 1.46012145, 0.303396329),
    (30, 1.42148152, 0.295017935),
    (40, 1.3594451, 0.282171414),
    (50, 1.26246321, 0.263351564),
    (60, 1.10752009, 0.235805161),
    (70, 0.845562803, 0.194022912),
    (75, 0.645445611, 0.164323154),
    (80, 0.381423226, 0.125073112),
    (82.5, 0.231746455, 0.100411878),
    (85, 0.0942745455, 0.0713391658),
    (87, 0.0225533009, 0.0443104814),
    (89, 0.000840088917, 0.014413627),
)
_TABLE_NM = 470.0

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
    """Return the package pvlib, or refuse."""
    try:
        import pvlib
    except ImportError as error:
        missing = Described("pvlib is not installed")
        allowed = "the extra daylight, pip install meshtrace[daylight], or direct and diffuse"
        raise Refused("daylight", missing, allowed) from error
    return pvlib


def clear_irradiance(
    sun_zenith_deg: float,
    wavelength_nm: float = 470.0,
    *,
    width_nm: float = 0.0,
    aerosol: float = 0.10,
    ozone: float = 0.30,
    water_vapour: float = 2.0,
    pressure: float = 101325.0,
    ground_albedo: float = 0.06,
    day_of_year: int = 80,
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
        If pvlib is not installed.

    Notes
    -----
    The aerosol of SPECTRL2 is rural; over oceans Gregg and Carder (1990) is the usual model. Air
    mass of Kasten and Young (1989).

    References
    ----------
    Bird and Riordan (1986), J. Clim. Appl. Meteorol. 25, 87.
    """
    pvlib = _pvlib()
    air_mass = pvlib.atmosphere.get_relative_airmass(sun_zenith_deg, model="kastenyoung1989")
    found = pvlib.spectrum.spectrl2(
        apparent_zenith=sun_zenith_deg,
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
    nodes = np.ravel(found["wavelength"])
    at = wavelength_nm + 0.5 * width_nm * (np.linspace(-1.0, 1.0, 101) if width_nm else np.zeros(1))
    direct, diffuse = (float(np.interp(at, nodes, np.ravel(found[k])).mean())
                       for k in ("dni", "dhi"))  # fmt: skip
    return Irradiance(direct, diffuse)


def default_irradiance(zenith_deg: float, wavelength_nm: float) -> Irradiance:
    """Return `clear_irradiance` with its defaults; at 470 nm from a table, without pvlib."""
    if wavelength_nm != _TABLE_NM:
        return clear_irradiance(zenith_deg, wavelength_nm)
    from scipy.interpolate import CubicSpline

    zenith, *values = np.array(_TABLE).T
    found = CubicSpline(zenith, np.array(values).T)(zenith_deg)
    return Irradiance(*(float(v) for v in found))


def sun_position(time: Any, latitude: float, longitude: float) -> SunPosition:
    """Return the position of the sun.

    Parameters
    ----------
    time : str or datetime
        Time with its zone, such as "2026-06-21T10:00Z".
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
    for name, value, most in (("latitude", latitude, 90.0), ("longitude", longitude, 180.0)):
        require_between(value, -most, most, name, "[]", f"{-most:g} <= {name} <= {most:g} deg")
    pvlib = _pvlib()
    import pandas as pd

    try:
        stamp = pd.Timestamp(time)
    except (TypeError, ValueError) as error:
        raise Refused("time", time, "a time such as 2026-06-21T10:00Z") from error
    if stamp is pd.NaT or stamp.tzinfo is None:
        raise Refused("time", time, "a time with its zone, such as 2026-06-21T10:00Z")
    row = pvlib.solarposition.get_solarposition(pd.DatetimeIndex([stamp]), latitude, longitude)
    zenith, azimuth = float(row["apparent_zenith"].iloc[0]), float(row["azimuth"].iloc[0])
    return SunPosition(zenith, (90.0 - azimuth) % 360.0, stamp.day_of_year)
