"""Seas from measured or forecast directional spectra."""

from __future__ import annotations

import math
from os import PathLike
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from meshtrace.checks import check_call
from meshtrace.errors import DomainWarning, Refused, warn

from .parameters import Floats, Mss
from .seas import MeasuredSea
from .spectra import Elfouhaily
from .spectra_files import read_spectrum
from .spreadings import ElfouhailySpreading
from .statistics import components_slope_variance, cox_munk

if TYPE_CHECKING:
    import xarray

TAIL_OMEGA_MAX = 24.0
"""Highest frequency of a tail [rad s-1]: shorter waves blur light and add no fading."""

_TAIL_PER_OCTAVE = 16


@check_call
def from_wavespectra(
    source: str | PathLike[str] | xarray.Dataset,
    seed: int = 0,
    depth: float | None = None,
    *,
    reader: str | None = None,
    time: Any = None,
    site: int | str | tuple[float, float] | None = None,
    tail: Literal["elfouhaily"] | None = None,
    wind_speed: float | None = None,
    mss: Mss | None = None,
    current: tuple[float, float] | None = None,
    x_axis_deg: float = 90.0,
    waves: Literal["table", "drawn"] = "table",
) -> MeasuredSea:
    """Return a random sea of a directional spectrum in the conventions of wavespectra.

    variance_ij = efth_ij df_i ddir, omega = 2 pi freq, theta = x_axis_deg + 180 deg - dir

    Parameters
    ----------
    source : path, list of path or xarray.Dataset
        netCDF file or dataset with `efth` [m2 Hz-1 deg-1] over `freq` [Hz] and `dir` [deg], the
        nautical direction the waves come from, clockwise from north; or, with `reader`, a file,
        with "ndbc_ascii" the five files of a buoy: densities, swdir, swdir2, swr1 and swr2;
        or a text file (.csv, .txt) whose header holds the directions and whose first column the
        frequencies, see `meshtrace.tables.read_columns`. Attributes of other units and conventions
        are heeded: `units`, `standard_name`, `long_name`, `_FillValue`, `scale_factor`,
        `valid_max`, `Directional_convention`.
    seed : int
        Seed of the random phases.
    depth : float, optional
        Water depth [m]; None is deep water.
    reader : str, optional
        Format of the file, such as "ndbc", "era5", "ww3", "ncswan", "swan", "spotter" or
        "datawell": the function `read_<reader>` of wavespectra (`pip install
        "meshtrace[measured]"`).
    time : optional
        Date of the spectrum in ISO 8601, without an offset in universal time, or of datetime, numpy
        or pandas; the nearest one within half a usual step of the record is taken.
    site : int, str or (float, float), optional
        Label of a station, its number from 0 in a record without labels, or longitude and latitude
        [deg]; the nearest one within 1 deg of a great circle is taken.
    tail : "elfouhaily", optional
        Continue the spectrum from its last frequency to `TAIL_OMEGA_MAX` with the spectrum and
        spreading of Elfouhaily et al. for `wind_speed`, about the mean direction of the last
        frequency: scaled to meet the density there, and unscaled from one octave on.
    wind_speed : float, optional
        Wind speed at 10 m [m s-1], for `tail` and `mss`.
    mss : {"cox-munk", "elfouhaily", "band"}, optional
        Slope variance of the real sea; "elfouhaily" with `tail`, otherwise "band".
    current : (float, float), optional
        Uniform current along x and y [m s-1]; the spectrum is that of a fixed point.
    x_axis_deg : float
        Compass bearing of +x [deg]; 90 is the east.
    waves : {"table", "drawn"}
        Waves of the sea, see `MeasuredSea`.

    Returns
    -------
    MeasuredSea
        With the time and the site in `record`.

    Raises
    ------
    Refused
        If a variable is missing or in units of another kind, directions are missing, contradict
        each other or are not equally spaced round the circle, values are missing or negative, time
        or site is outside of the record or has to be selected, the calendar is not the standard
        one, the file states arrays that it cannot hold, or wavespectra is missing.

    Warns
    -----
    DomainWarning
        If there is neither `tail` nor `mss`: slopes are missing.
    InputWarning
        If units or directions were converted.

    Notes
    -----
    The width of a frequency bin is half the distance of its neighbours, at the ends the distance
    of the only neighbour, as wavespectra counts it, so that Hs agrees with its `hs()`.
    Buoys end at 0.5 to 1 Hz and models at 0.4 to 0.6 Hz, where hardly any light fades yet.

    Buoys of NDBC measure two Fourier coefficients of the directions. Their truncated series, which
    wavespectra sums, is negative in places; here directions have the maximum entropy form of these
    coefficients [1]_, with the same density over frequency and the same mean direction.
    Coefficients that no distribution has are reduced to the nearest possible ones.

    References
    ----------
    .. [1] Lygre, A., Krogstad, H. E. (1986), J. Phys. Oceanogr. 16, 2052-2060,
       doi:10.1175/1520-0485(1986)016<2052:MEEOTD>2.0.CO;2.
    """
    if tail is not None and tail != "elfouhaily":
        raise Refused("tail", tail, "elfouhaily")
    if tail is not None and wind_speed is None:
        raise Refused("wind_speed", None, "a wind speed [m/s] for the tail")
    (freq, direction, density), record = read_spectrum(source, reader, time, site)
    theta = np.radians(180.0 + x_axis_deg - direction)
    # widths as wavespectra counts them, so that Hs agrees with its `hs()`
    variance = density * np.gradient(freq)[:, None] * (360.0 / len(direction))
    wind_direction = math.degrees(_mean_direction(theta, variance))
    if tail is not None and wind_speed is not None:
        freq, variance = _with_tail(freq, theta, variance, wind_speed)
    sea = MeasuredSea(
        omega=tuple(2.0 * np.pi * freq),
        theta=tuple(theta),
        variance=tuple(map(tuple, variance)),
        seed=seed,
        depth=depth,
        current=current,
        waves=waves,
        mss=mss or ("band" if tail is None else "elfouhaily"),
        wind_speed=wind_speed,
        wind_direction_deg=0.0 if wind_speed is None else wind_direction,
        record=record,
    )
    if tail is None and mss is None:
        _warn_of_missing_slopes(sea)
    return sea


def _mean_direction(theta: Floats, variance: Floats) -> float:
    """Return the mean direction of the last frequency with waves [rad]."""
    # the shortest waves follow the wind
    row = variance[np.flatnonzero(variance.sum(axis=1))[-1:]].sum(axis=0)
    return float(np.arctan2(row @ np.sin(theta), row @ np.cos(theta)))


def _with_tail(
    freq: Floats, theta: Floats, variance: Floats, wind_speed: float
) -> tuple[Floats, Floats]:
    """Continue frequencies and variances (freq, theta) with the spectrum of Elfouhaily et al."""
    spectrum = Elfouhaily(wind_speed=wind_speed)
    omega = 2.0 * np.pi * freq
    width = np.gradient(omega)[-1]
    # the last bin of the table reaches half a width beyond its frequency
    start = omega[-1] + 0.5 * width
    if start >= TAIL_OMEGA_MAX:
        return freq, variance
    bins = math.ceil(_TAIL_PER_OCTAVE * math.log2(TAIL_OMEGA_MAX / start))
    edges = np.geomspace(start, TAIL_OMEGA_MAX, bins + 1)
    centers = np.sqrt(edges[1:] * edges[:-1])
    ratio = float(variance[-1].sum() / width / spectrum(omega[-1]))
    octaves = np.clip(np.log2(centers / omega[-1]), 0.0, 1.0)
    density = spectrum(centers) * (ratio + (1.0 - ratio) * octaves)
    # the spreading takes angles from -pi to pi off the mean direction
    turned = np.remainder(theta - _mean_direction(theta, variance) + np.pi, 2.0 * np.pi) - np.pi
    spread = ElfouhailySpreading().density(
        centers[:, None], turned, omega_p=spectrum.omega_p, wind_speed=spectrum.wind_speed
    )
    shares = spread / spread.sum(axis=1, keepdims=True)
    energy = (density * np.diff(edges))[:, None] * shares
    continued = np.concatenate([freq, centers / (2.0 * np.pi)])
    return continued, np.concatenate([variance, energy])


def _warn_of_missing_slopes(sea: MeasuredSea) -> None:
    end = f"the spectrum ends at {sea.omega[-1] / (2.0 * math.pi):.3g} Hz"
    advice = 'give wind_speed with tail="elfouhaily" or with mss="cox-munk"'
    if sea.wind_speed is None:
        text = f"source: {end}, without any shorter waves: {advice}"
    else:
        resolved = sum(components_slope_variance(sea.components))
        missing = 100.0 * max(0.0, 1.0 - resolved / sum(cox_munk(sea.wind_speed)))
        text = f"source: {end}, beyond which {missing:.0f} % of the slope variance lies: {advice}"
    warn(text, DomainWarning)
