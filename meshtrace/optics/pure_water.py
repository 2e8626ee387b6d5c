"""Absorption, scattering and refractive index of pure sea water."""

from __future__ import annotations

from functools import lru_cache
from importlib import resources
from typing import Annotated, Any

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from meshtrace.checks import RangedArray, check_call
from meshtrace.errors import Described, Refused, require_range
from meshtrace.models import Floats

ScatteringWavelength = Annotated[ArrayLike, Field(ge=350.0, le=800.0)]
"""Wavelength in vacuum at which water is known to scatter [nm]."""

Temperature = Annotated[ArrayLike, Field(ge=0.0, le=30.0)]
"""Temperature of the fits [degree Celsius]."""


@check_call
def pure_water_absorption(wavelength_nm: RangedArray) -> Floats:
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
    return interpolate(wavelength_nm, *read_table("pure_water_absorption.csv").T)


@check_call
def sea_water_scattering(wavelength_nm: ScatteringWavelength) -> Floats:
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
    return 16.06 * 4.72e-4 * (400.0 / np.asarray(wavelength_nm)) ** 4.32


@check_call
def zhang_hu_he(
    wavelength_nm: ScatteringWavelength,
    temperature_c: Temperature = 20.0,
    salinity: Annotated[ArrayLike, Field(ge=0.0, le=40.0)] = 35.0,
) -> Floats:
    r"""Return the scattering coefficient of sea water from fluctuations of density and salinity.

    .. math::
        b = \frac{8 \pi}{3} \frac{2 + d}{1 + d} \frac{6 + 6 d}{6 - 7 d} \frac{\pi^2}{\lambda^4}
        \left[ \frac{k T \beta_T}{2} \left(\rho \frac{\partial n^2}{\partial \rho}\right)^2
        + \frac{2 n^2 M S}{N_A \rho} \left(\frac{\partial n}{\partial S}\right)^2
        \left(-\frac{\partial \ln a_w}{\partial S}\right)^{-1} \right]

    Parameters
    ----------
    wavelength_nm : array_like
        Wavelength in vacuum [nm], 350 ... 800.
    temperature_c : array_like
        Temperature [degree Celsius], 0 ... 30.
    salinity : array_like
        Salinity [g/kg], 0 ... 40.

    Returns
    -------
    ndarray
        Scattering coefficient [m-1].

    Raises
    ------
    Refused
        If an argument lies outside its range.

    Notes
    -----
    Depolarisation ratio d = 0.039; compressibility beta_T of Millero and others (1980), density of
    UNESCO (1981), activity a_w of Millero and Leung (1976), density derivative of Proutiere and
    others (1992), index of Quan and Fry with the air of Ciddor (1996), as in the authors' program
    betasw_ZHH2009.m (doi:10.17882/42916). It is 12 % below `sea_water_scattering` at 470 nm.

    References
    ----------
    Zhang, Hu and He 2009, Opt. Express 17:5698, doi:10.1364/OE.17.005698.

    Examples
    --------
    >>> round(float(zhang_hu_he(470.0)), 6)
    0.003309
    """
    w, t, s = _of_one_shape(wavelength_nm, temperature_c, salinity)
    inverse = 1e6 / w**2  # [um-2]
    # Ciddor (1996): `sea_water_index` is relative to air, Zhang, Hu and He need the index to vacuum
    air = 1.0 + (5792105.0 / (238.0185 - inverse) + 167917.0 / (57.362 - inverse)) * 1e-8
    n = sea_water_index(w, t, s) * air
    # the derivative of `sea_water_index` by S
    by_salt = (1.779e-4 - 1.05e-6 * t + 1.6e-8 * t**2 + 0.01155 / w) * air
    # rho d(n^2)/d(rho) of Proutiere and others (1992)
    by_density = (n**2 - 1.0) * (1.0 + 2.0 / 3.0 * (n**2 + 2.0) * ((n - 1.0 / n) / 3.0) ** 2)
    density = 0.5 * _BOLTZMANN * (t + 273.15) / _bulk_modulus(t, s) * by_density**2
    salt = 2.0 * n**2 * s * _WATER_MOLE * by_salt**2 / (_density(t, s) * _AVOGADRO)
    factor = 8.0 * np.pi / 3.0 * (2.0 + DEPOLARISATION) / (1.0 + DEPOLARISATION)
    factor *= (6.0 + 6.0 * DEPOLARISATION) / (6.0 - 7.0 * DEPOLARISATION)
    # water is less active the more salt it has: the slope is negative
    return factor * np.pi**2 / (w * 1e-9) ** 4 * (density - salt / _activity_slope(t, s))


DEPOLARISATION = 0.039
"""Depolarisation ratio of `zhang_hu_he`, Farinato and Rowell (1976)."""

# as in betasw_ZHH2009.m
_BOLTZMANN, _AVOGADRO, _WATER_MOLE = 1.3806503e-23, 6.0221417930e23, 18e-3


def _bulk_modulus(t: Floats, s: Floats) -> Floats:
    """Return the isothermal bulk modulus of sea water [Pa], Millero and others (1980)."""
    pure = polyval(t, (19652.21, 148.4206, -2.327105, 1.360477e-2, -5.155288e-5))
    first = polyval(t, (54.6746, -0.603459, 1.09987e-2, -6.167e-5))
    return 1e5 * (pure + first * s + polyval(t, (7.944e-2, 1.6483e-2, -5.3009e-4)) * s**1.5)


def _density(t: Floats, s: Floats) -> Floats:
    """Return the density of sea water [kg m-3], UNESCO (1981)."""
    pure = (999.842594, 6.793952e-2, -9.09529e-3, 1.001685e-4, -1.120083e-6, 6.536332e-9)
    first = polyval(t, (8.24493e-1, -4.0899e-3, 7.6438e-5, -8.2467e-7, 5.3875e-9))
    second = polyval(t, (-5.72466e-3, 1.0227e-4, -1.6546e-6))
    return polyval(t, pure) + first * s + second * s**1.5 + 4.8314e-4 * s**2


def _activity_slope(t: Floats, s: Floats) -> Floats:
    """Return d ln(activity of water) / d(salinity), Millero and Leung (1976)."""
    first = polyval(t, (-5.58651e-4, 2.40452e-7, -3.12165e-9, 2.40808e-11))
    second = polyval(t, (1.79613e-5, -9.9422e-8, 2.08919e-9, -1.39872e-11))
    third = polyval(t, (-2.31065e-6, -1.37674e-9, -1.93316e-11))
    return first + 1.5 * second * s**0.5 + 2.0 * third * s


@check_call
def quan_fry(
    wavelength_nm: Annotated[ArrayLike, Field(ge=400.0, le=700.0)],
    temperature_c: Temperature = 20.0,
    salinity: Annotated[ArrayLike, Field(ge=0.0, le=35.0)] = 35.0,
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
    return sea_water_index(*_of_one_shape(wavelength_nm, temperature_c, salinity))


def sea_water_index(w: Floats, t: Floats, s: Floats) -> Floats:
    """Return the refractive index of `quan_fry` without its limits."""
    salt = (1.779e-4 - 1.05e-6 * t + 1.6e-8 * t**2) * s
    dispersion = (15.868 + 0.01155 * s - 0.00423 * t) / w - 4382.0 / w**2 + 1.1455e6 / w**3
    return 1.31405 + salt - 2.02e-6 * t**2 + dispersion


def _of_one_shape(w: ArrayLike, t: ArrayLike, s: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Return wavelength, temperature and salinity as arrays of one shape."""
    try:
        wavelength, temperature, salinity = np.broadcast_arrays(w, t, s)
    except ValueError as error:
        shapes = Described(f"shapes {[np.shape(values) for values in (w, t, s)]}")
        raise Refused("wavelength_nm", shapes, "shapes that fit") from error
    return wavelength, temperature, salinity


def interpolate(wavelength_nm: RangedArray, nodes: Floats, values: Floats) -> Floats:
    """Return values at wavelengths, linear between nodes; refuse wavelengths outside."""
    at = check_range("wavelength_nm", wavelength_nm, nodes[0], nodes[-1], "nm")
    return np.interp(at, nodes, values)


def check_range(name: str, value: ArrayLike, low: float, high: float, unit: str) -> Floats:
    """Return values as an array; refuse any outside the range."""
    return require_range(value, low, high, name, allowed=f"{low:g} <= {name} <= {high:g} {unit}")


@lru_cache(maxsize=8)
def read_table(file: str, dtype: type = float) -> NDArray[Any]:
    """Read a table that comes with the package."""
    text = (resources.files("meshtrace.optics") / "data" / file).read_text(encoding="utf-8")
    data_lines = (line for line in text.splitlines() if not line.startswith("#"))
    return np.loadtxt(data_lines, delimiter=",", dtype=dtype)
