"""Directional spectra over a regular grid: units, conventions, Fourier coefficients of buoys."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshtrace.errors import LARGEST, Described, Refused, warn_of_input
from meshtrace.netcdf import convention_of, valid_values
from meshtrace.units import convert, unit_of

from .parameters import Floats

if TYPE_CHECKING:
    import xarray

FOURIER = ("alpha1", "alpha2", "r1", "r2")
"""Mean and principal direction, and lengths of the two Fourier coefficients of a buoy."""

_DENSITY = "m2 Hz-1 deg-1"
_ROUNDED = 1e-6  # of the highest density: packed files round zeros to either sign
_SHARPEST, _NEAREST = 0.99, 0.95  # of maximum entropy: |c1|, and its limit of c2
_MOST_RATIO = 1.1  # of Fourier coefficients, which noise lifts above 1
_POINTS = 400  # within a bin of 10 degrees
_DIRECTIONS = 36  # of buoys that measure two Fourier coefficients
_ANGLE = re.compile(r"(rad|deg|°)\w*\s*[\^*{(]*\s*-?(\d?)", re.IGNORECASE)


GriddedSpectrum = tuple[Floats, Floats, Floats]
"""Frequencies [Hz], directions that waves come from [deg], and densities [m2 Hz-1 deg-1]."""


def on_grid(data: xarray.Dataset) -> GriddedSpectrum:
    """Return the spectrum of one record in common units and conventions."""
    efth = data["efth"]
    is_fourier = all(name in data.variables for name in FOURIER)
    axes = ("freq",) if is_fourier else ("freq", "dir")
    efth = efth.squeeze([d for d in efth.dims if d not in axes and efth.sizes[d] == 1], drop=True)
    if not is_fourier and efth.sizes.get("dir", 1) == 1 and set(efth.dims) <= {"freq", "dir"}:
        allowed = 'directions, or spectrum = "tabulated" with a spreading'
        raise Refused("efth", Described("no directions"), allowed)
    if not is_fourier and "dir" not in data.variables:
        raise Refused("dir", Described("missing"), "directions [deg]")
    if set(efth.dims) != set(axes) or not efth.size:
        raise Refused("efth", efth.dims, f"dimensions {axes}; select one time and site first")
    unit = unit_of(efth)
    freq = _frequencies(data["freq"], unit)
    values, order = valid_values(efth.transpose(*axes)), np.argsort(freq, kind="stable")
    if is_fourier:
        values = convert(values, unit, "m2 Hz-1", "efth") if unit else values
        coefficients = [_coefficient(data[name], name) for name in FOURIER]
        direction = np.arange(_DIRECTIONS) * 360.0 / _DIRECTIONS
        density = _from_fourier(values, direction, *coefficients)
        return _checked(freq[order], direction, density[order])
    is_angular = unit_of(data["dir"]).lower().startswith("rad")
    if (unit or is_angular) and not _ANGLE.search(unit):
        problem = Described(f"in {unit}" if unit else "without units over radians")
        raise Refused("efth", problem, f"units that name the angle, such as {_DENSITY}")
    if unit:
        per_degree = convert(values, unit, _DENSITY, "efth")
        if not np.array_equal(per_degree, values, equal_nan=True):
            warn_of_input(f"efth: {unit} converted to {_DENSITY}")
        values = per_degree
    direction = _directions(data, values)
    return _checked(freq[order], *_round_the_circle(direction, values[order]))


def _frequencies(variable: xarray.DataArray, density_unit: str) -> Floats:
    """Return frequencies [Hz]; refuse angular ones if the density may be over either kind."""
    unit, freq = unit_of(variable), valid_values(variable)
    if not unit:
        return freq
    if _ANGLE.search(unit) and "hz" not in density_unit.lower():
        # m2 s rad-1 may be a density per Hz and radian, or per rad/s
        powers = sum(int(power or 1) for _, power in _ANGLE.findall(density_unit))
        if powers < 2:
            problem = Described(f"in {density_unit or 'no unit'} over {unit}")
            allowed = f"units with Hz-1 or s rad-1, such as {_DENSITY} or m2 s rad-2"
            raise Refused("efth", problem, allowed)
    return convert(freq, unit, "Hz", "freq")


def _coefficient(variable: xarray.DataArray, name: str) -> Floats:
    """Return a direction [rad] or a ratio of the Fourier coefficients of a buoy."""
    values, unit = np.ravel(valid_values(variable.squeeze(drop=True))), unit_of(variable)
    if name.startswith("alpha"):
        bearing = convert(values, unit, "deg", name) if unit else values
        return np.radians(coming_from(bearing, convention_of(variable, {}) or "from"))
    return convert(values, unit, "1", name) if unit else values


def _directions(data: xarray.Dataset, values: Floats) -> Floats:
    """Return the bearing [deg] that waves come from."""
    variable = data["dir"]
    direction, unit = np.asarray(variable.values, np.float64), unit_of(variable)
    if unit:
        direction = convert(direction, unit, "deg", "dir")
    convention = convention_of(variable, data.attrs) or "from"
    if convention != "from":
        warn_of_input(f"dir: {convention} converted to the bearing that waves come from")
    return coming_from(direction, convention)


def coming_from(direction: Floats, convention: str) -> Floats:
    """Return the nautical direction of origin [deg] of a direction in another convention."""
    turned = {
        "from": direction,
        "to": direction + 180.0,
        "cartesian": 270.0 - direction,  # travel, counter-clockwise from east
        "cartesian from": 90.0 - direction,
    }[convention]
    return np.mod(turned, 360.0)


def _round_the_circle(direction: Floats, density: Floats) -> tuple[Floats, Floats]:
    """Return densities over sorted directions in equal steps round the circle, 0 <= dir < 360."""
    if not np.isfinite(direction).all():
        raise Refused("dir", Described("not finite"), "finite directions [deg]")
    # conversions leave 360 less a last bit, which is 0
    direction = np.mod(np.round(np.mod(direction, 360.0), 9), 360.0)
    order = np.argsort(direction, kind="stable")
    direction, density = direction[order], density[:, order]
    is_double = np.diff(direction, append=np.inf) < 1e-3
    if direction[0] + 360.0 - direction[-1] < 1e-3 and len(direction) > 1:  # 359.9999 and 0
        is_double[-1] = True
    for i in np.flatnonzero(is_double):  # 0 and 360, as buoys write a closed circle
        if not np.allclose(
            density[:, i], density[:, (i + 1) % len(direction)], rtol=1e-4, equal_nan=True
        ):
            twice = Described(f"{direction[i]:g} deg twice")
            raise Refused("dir", twice, "one density a direction")
    direction, density = direction[~is_double], density[:, ~is_double]
    n = len(direction)
    width = 360.0 / n
    offset = direction - width * np.arange(n)
    # radians of three digits are wrong by 0.29 deg, whole degrees by 0.5
    rounding = 0.5 if (direction == np.round(direction)).all() else 0.3
    if n < 2 or np.ptp(offset) > 2.0 * min(max(rounding, 1e-3 * width), 0.25 * width):
        turn = np.diff(direction, append=direction[0] + 360.0)
        problem = Described(f"steps of {turn.min():g} to {turn.max():g} deg")
        raise Refused("dir", problem, "equal steps round the circle; radians need units = radian")
    if np.ptp(offset) > 1e-3 * width:
        direction = offset.mean() + width * np.arange(n)
    return direction, density


def _checked(freq: Floats, direction: Floats, density: Floats) -> GriddedSpectrum:
    """Return a checked spectrum: frequencies > 0, densities finite, >= 0 and not all 0."""
    is_zero = (freq == 0.0) & ~(np.nan_to_num(density) > 0.0).any(axis=1)  # the mean level
    freq, density = freq[~is_zero], density[~is_zero]
    measured = np.flatnonzero(~np.isnan(density).all(axis=1))
    if 0 < len(measured) and measured[-1] - measured[0] + 1 < len(freq):  # of another buoy's band
        freq = freq[measured[0] : measured[-1] + 1]
        density = density[measured[0] : measured[-1] + 1]
        warn_of_input(f"efth: values from {freq[0]:.3g} to {freq[-1]:.3g} Hz alone")
    if len(freq) < 2 or not (np.isfinite(freq) & (freq > 0.0)).all():
        raise Refused("freq", Described("not positive"), "two or more finite numbers > 0 [Hz]")
    if not (np.diff(freq) > 0.0).all():
        allowed = "one spectrum of different frequencies"
        raise Refused("freq", Described("a frequency twice"), allowed)
    missing = int((~np.isfinite(density) | (np.abs(density) > LARGEST)).sum())
    if missing:
        problem = Described(f"{missing} of {density.size} values missing or not finite")
        raise Refused("efth", problem, "finite variance densities >= 0")
    most = float(density.max())
    if most <= 0.0 and float(density.min()) == 0.0:
        raise Refused("efth", Described("zero everywhere"), "a record with waves")
    if float(density.min()) < -_ROUNDED * most:
        raise Refused("efth", Described("negative"), "finite variance densities >= 0")
    return freq, direction, np.maximum(density, 0.0)


def _from_fourier(
    spectrum: Floats, direction: Floats, alpha1: Floats, alpha2: Floats, r1: Floats, r2: Floats
) -> Floats:
    """Return the density over directions of a buoy's first two Fourier coefficients.

    The truncated series S (1/2 + r1 cos(theta - alpha1) + r2 cos 2 (theta - alpha2)) / pi is
    negative in places. The maximum entropy form has these coefficients and is positive.
    """
    calm = (spectrum == 0.0) | np.isnan(spectrum)
    lacking = np.isnan(alpha1 + alpha2 + r1 + r2) & ~calm
    if lacking.any():
        problem = Described(
            f"no directions at {lacking.sum()} of {len(spectrum)} frequencies with waves"
        )
        raise Refused("efth", problem, "directions at all frequencies with waves")
    for name, ratio in (("r1", r1), ("r2", r2)):
        beyond = ~calm & ~((ratio >= 0.0) & (ratio <= _MOST_RATIO))
        if beyond.any():
            raise Refused(name, float(ratio[beyond][0]), f"0 <= {name} <= 1")
    # the coefficients are the means of exp(i theta) and exp(2 i theta)
    c1 = np.where(calm, 0.0, r1 * np.exp(1j * alpha1))
    c2 = np.where(calm, 0.0, r2 * np.exp(2j * alpha2))
    shares = maximum_entropy(c1, c2, np.radians(direction))
    warn_of_input("efth: directions by the maximum entropy form of the buoy's Fourier coefficients")
    return spectrum[:, None] * shares * len(direction) / 360.0


def maximum_entropy(c1: NDArray[Any], c2: NDArray[Any], theta: Floats) -> Floats:
    """Return the energy fractions in direction bins by the maximum entropy method.

    D = (1 - phi1 c1* - phi2 c2*) / (2 pi |1 - phi1 exp(-i theta) - phi2 exp(-2 i theta)|^2),
    phi1 = (c1 - c2 c1*) / (1 - |c1|^2), phi2 = c2 - c1 phi1; Lygre and Krogstad (1986),
    doi:10.1175/1520-0485(1986)016<2052:MEEOTD>2.0.CO;2, eqs. 12 and 13.

    Parameters
    ----------
    c1, c2 : ndarray of complex, shape (m,)
        First and second Fourier coefficient, the means of exp(i theta) and exp(2 i theta).
    theta : ndarray, shape (n,)
        Centres of bins in equal steps round the circle [rad].

    Returns
    -------
    ndarray, shape (m, n)
    """
    # noise makes coefficients that no density has: the nearest possible ones keep the mean
    # direction. At the limit the density is a line, which points within a bin would miss
    c1 = c1 * np.minimum(1.0, _SHARPEST / np.maximum(np.abs(c1), 1e-12))
    apart, most = c2 - c1**2, _NEAREST * (1.0 - np.abs(c1) ** 2)
    c2 = c1**2 + apart * np.minimum(1.0, most / np.maximum(np.abs(apart), 1e-12))
    phi1 = (c1 - c2 * c1.conj()) / (1.0 - np.abs(c1) ** 2)
    phi2 = c2 - c1 * phi1
    width = 2.0 * math.pi / len(theta)
    inside = width * ((np.arange(_POINTS) + 0.5) / _POINTS - 0.5)
    z = np.exp(-1j * (theta[:, None] + inside))[..., None]
    density = np.mean(np.abs(1.0 - phi1 * z - phi2 * z**2) ** -2, axis=1).T
    return density / density.sum(axis=1, keepdims=True)
