"""Seas from records of wave gauges."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.cells import Cells, cells_of
from meshtrace.checks import Inside, Probability, check_call
from meshtrace.errors import (
    Described,
    Refused,
    extra,
    require_array,
    require_between,
    require_whole,
)
from meshtrace.tables import Column, Heading, headings_of
from meshtrace.units import convert, is_convertible, is_same

from .directional import from_wavespectra
from .parameters import Depth, Floats, Mss
from .seas import MeasuredSea
from .spreadings import Spreading
from .waves import wavenumber

if TYPE_CHECKING:
    import xarray

_LENGTHS = "one of m, cm, mm, ft, ...; pressures as elevations by linear wave theory"
_HIGHEST = 50.0  # m; beyond it the unit is another one
_TIME = Column("time", "s", ("t", "elapsed time", "seconds", "time_since_start", "elapsed"))
_ELEVATION = Column(
    "eta",
    "m",
    ("elevation", "surface elevation", "wave elevation", "water elevation", "free surface", "z",
     "surface", "zeta", "h", "height", "level", "water level", "wl", "ssh", "sea_surface_height",
     "heave", "displacement", "wg", "gauge", "gage", "wave gauge", "wave gage", "wave", "probe",
     "wp", "wave probe", "surface height"),
    numbered=True,
)  # fmt: skip
_DIRECTIONS = 72
_FEWEST = 16  # samples of a segment
_DEEP = 1e4  # m; deep water for diwasp, which has no such option


@check_call
def gauge_spectrum(
    source: Annotated[str | PathLike[str] | ArrayLike, Inside()],
    depth: Depth | None = None,
    *,
    spreading: Spreading | str | dict[str, Any] | None = None,
    direction_deg: float = 0.0,
    wind_speed: float | None = None,
    positions: Sequence[tuple[float, float]] | None = None,
    unit: str | None = None,
    segments: int = 16,
    f_min: float | None = None,
    f_max: float | None = None,
    confidence: Probability = 0.95,
) -> xarray.Dataset:
    r"""Return the directional spectrum of a record of wave gauges.

    .. math:: E(f, \theta) = \hat S(f) D(f, \theta), \quad
              \nu \hat S / \chi^2_{\nu, 1 - \alpha/2} < S < \nu \hat S / \chi^2_{\nu, \alpha/2},
              \quad \nu = 2 K / (1 + (K - 1) / (18 K))

    Parameters
    ----------
    source : path or array_like, shape (n, 1 + gauges)
        Time [s] at equal steps, then the elevation of each gauge; or a text file of these columns,
        see `meshtrace.tables.read_columns`, an array or a data frame. A heading such as "eta [mm]"
        or "eta_mm" states the unit. Masked and missing rows at the ends are left out.
    depth : float, optional
        Water depth [m]; None is deep water. Only the directions of an array depend on it.
    spreading : Spreading or str or dict, optional
        Directional spreading D of a single gauge, which does not see directions: "ittc",
        "cos2s" or a table with `kind`.
    direction_deg : float
        Mean direction the waves of a single gauge travel to, counter-clockwise from +x [deg].
    wind_speed : float, optional
        Wind speed at 10 m [m s-1] of spreadings that depend on it.
    positions : sequence of (float, float), optional
        Positions (x, y) [m] of three or more gauges that are not on a line.
    unit : str, optional
        Unit of the elevations, such as "mm", by default that of the heading, or m.
    segments : int
        Lengths of a segment within the record. More segments have smaller errors; the resolution
        is segments / duration.
    f_min, f_max : float, optional
        Lowest and highest frequency that are kept [Hz], by default two resolutions, and four
        times the peak but at most 0.8 of the Nyquist frequency.
    confidence : float
        Level of the limits [1].

    Returns
    -------
    xarray.Dataset
        `efth` [m2 Hz-1 deg-1] in the conventions of wavespectra with +x to the east, the
        frequency spectrum `spectrum` [m2 Hz-1] with its limits `spectrum_low`, `spectrum_high`;
        attributes `degrees_of_freedom`, `hs` [m] and `tp` [s].

    Raises
    ------
    Refused
        If the record is not of this form, holds pressures, does not vary or is too short, a
        single gauge has no spreading, the positions do not fit, or an array finds no diwasp
        (`pip install "meshtrace[measured]"`).

    Notes
    -----
    Each column is detrended, cut into K = 2 `segments` - 1 segments that overlap by half, detrended
    again and tapered by a Hann window. The degrees of freedom nu count the overlap (Welch 1967);
    an array averages its spectra over the gauges, and nu is that of one of them. A few large
    resolutions under the peak are needed: the taper widens peaks by 1.5 of them.

    Directions of an array: the iterated maximum likelihood method of diwasp. Beyond the frequency
    at which half a wave is shorter than the least distance of two gauges directions are ambiguous:
    those of that frequency are kept. Waves reflected by the walls of a tank are phase-locked to the
    incident ones, which the method does not allow for.

    References
    ----------
    Welch, P. D. (1967), doi:10.1109/TAU.1967.1161901. Pawka, S. S. (1983),
    doi:10.1029/JC088iC04p02579. Johnson, D. (2002), DIWASP, WP-1601-DJ, Univ. of Western Australia.
    """
    import xarray as xr
    from scipy import signal, stats

    name, elevation, step = _read_gauges(source, unit)
    n, gauges = elevation.shape
    require_whole(segments, 2, max(2, n // _FEWEST), "segments")
    length = n // segments
    freq, each = signal.welch(
        signal.detrend(elevation, axis=0), 1.0 / step, nperseg=length,
        noverlap=length // 2, detrend="linear", axis=0,
    )  # fmt: skip
    inside = _band(step, freq, each.mean(axis=1), f_min, f_max)
    freq, spectrum = freq[inside], each.mean(axis=1)[inside]
    peak = float(freq[np.argmax(spectrum)])
    theta = np.radians(np.arange(_DIRECTIONS) * 360.0 / _DIRECTIONS)
    if gauges == 1:
        shares = _stated(spreading, freq, theta - math.radians(direction_deg), peak, wind_speed)
    else:
        shares = _of_array(elevation, step, positions, length, freq, theta, depth)
    count = (n - length // 2) // (length - length // 2)
    # Welch (1967): segments that overlap by half are not independent
    freedom = 2.0 * count / (1.0 + (count - 1.0) / (18.0 * count))
    low, high = freedom / stats.chi2.ppf([0.5 + 0.5 * confidence, 0.5 - 0.5 * confidence], freedom)
    variance = float((spectrum * np.gradient(freq)).sum())
    return xr.Dataset(
        {
            "efth": (("freq", "dir"), spectrum[:, None] * shares * _DIRECTIONS / 360.0),
            "spectrum": ("freq", spectrum),
            "spectrum_low": ("freq", low * spectrum),
            "spectrum_high": ("freq", high * spectrum),
        },
        # +x is the east, and directions are those the waves come from
        coords={"freq": freq, "dir": np.mod(270.0 - np.degrees(theta), 360.0)},
        attrs={
            "record": f"{name}, {n * step:g} s of {gauges} gauge{'s' * (gauges > 1)}",
            "degrees_of_freedom": freedom,
            "hs": 4.0 * math.sqrt(variance),
            "tp": 1.0 / peak,
        },
    )


@check_call
def from_gauge(
    source: Annotated[str | PathLike[str] | ArrayLike, Inside()],
    seed: int = 0,
    depth: float | None = None,
    *,
    tail: Literal["elfouhaily"] | None = None,
    wind_speed: float | None = None,
    mss: Mss | None = None,
    current: tuple[float, float] | None = None,
    waves: Literal["table", "drawn"] = "drawn",
    **gauge: Any,
) -> MeasuredSea:
    """Return a random sea with the spectrum of a record of wave gauges.

    Parameters
    ----------
    source : path or array_like, shape (n, 1 + gauges)
        Time [s] and the elevation of each gauge, see `gauge_spectrum`.
    seed : int
        Seed of the random phases.
    depth : float, optional
        Water depth [m], as that of a tank, in the dispersion; None is deep water.
    tail, wind_speed, mss, current, waves
        As in `from_wavespectra`. A tail for `wind_speed` continues the spectrum beyond `f_max`; in
        a tank without wind `mss` = "band" has no waves beyond it.
    **gauge
        Options of `gauge_spectrum`, such as `spreading`, `positions` and `f_max`.

    Returns
    -------
    MeasuredSea
        With the file, the duration and the number of gauges in `record`.

    Raises
    ------
    Refused
        As `gauge_spectrum` and `from_wavespectra`.

    Warns
    -----
    DomainWarning
        If there is neither `tail` nor `mss`: slopes are missing.

    Examples
    --------
    >>> t = np.arange(0.0, 600.0, 0.1)
    >>> z = 0.03 * np.cos(5.0 * t) + 0.02 * np.cos(6.0 * t)
    >>> sea = from_gauge(np.column_stack([t, z]), depth=1.2, spreading="cos2s", mss="band")
    >>> round(4.0 * float(np.sqrt(0.5 * np.sum(sea.components.amplitude**2))), 3)  # Hs
    0.102
    """
    spectrum = gauge_spectrum(source, depth, wind_speed=wind_speed, **gauge)
    sea = from_wavespectra(
        spectrum,
        seed,
        depth,
        tail=tail,
        wind_speed=wind_speed,
        mss=mss,
        current=current,
        waves=waves,
    )
    return sea.model_copy(update={"record": spectrum.attrs["record"]})


def _read_gauges(source: Any, unit: str | None) -> tuple[str, Floats, float]:
    """Return the name of a record, its elevations (n, gauges) [m] and their time step [s]."""
    if unit is not None and not is_convertible(unit, "m"):
        raise Refused("unit", Described(str(unit)), _LENGTHS)
    name = Path(source).name if isinstance(source, str | PathLike) else "source"
    cells = cells_of(source, "source")
    if len(cells.columns) < 2:
        count = Described(f"{len(cells.columns)} column")
        raise Refused(name, count, "(n, 1 + gauges) finite numbers: time [s], elevations")
    headings = headings_of(cells, (_TIME, _ELEVATION))
    at, gauges = _columns_of_gauges(name, headings, len(cells.columns))
    stated = _unit(name, [headings[i] for i in gauges] if headings else [], unit)
    texts = [heading.text for heading in headings] or [""] * len(cells.columns)
    cells = _without_missing_ends(cells, {index: texts[index] for index in (at, *gauges)})
    time, *each = (cells.finite(index, texts[index]) for index in (at, *gauges))
    elevation = convert(np.column_stack(each), stated, "m", name)
    if not is_same(stated, "m"):
        cells.notes.append(f"elevations in {stated} converted to m")
    if not (np.ptp(elevation, axis=0) > 0.0).all():
        raise Refused(name, Described("a gauge that does not vary"), "elevations of waves")
    if np.abs(elevation - np.median(elevation, axis=0)).max() > _HIGHEST:
        count = Described(f"elevations over {np.ptp(elevation, axis=0).max():.3g} m")
        allowed = f"within {_HIGHEST:g} m of their median: a heading with the unit"
        raise Refused(name, count, allowed)
    # a column that only rises is a time or a count, not waves
    if not headings and (np.diff(elevation, axis=0) > 0.0).all(axis=0).any():
        raise Refused(name, Described("a gauge that rises in all rows"), "headings of the columns")
    cells.warn()
    return name, elevation, _step(name, time)


def _columns_of_gauges(name: str, headings: Sequence[Heading], width: int) -> tuple[int, list[int]]:
    """Return the indices of the columns of the time and of the elevations."""
    if not headings:
        return 0, list(range(1, width))
    named = [i for i, h in enumerate(headings) if _TIME.is_named(h.name)]
    by_unit = [i for i, h in enumerate(headings) if h.unit and is_convertible(h.unit, "s")]
    times = named or by_unit
    texts = Described(", ".join(heading.text for heading in headings))
    if len(times) != 1:
        raise Refused(name, texts, "one column time [s]")
    unit = headings[times[0]].unit
    if unit is not None and not is_same(unit, "s"):
        raise Refused(name, Described(f"time in {unit}"), "time [s]")
    gauges = [i for i, h in enumerate(headings) if i != times[0] and h.name != "#"]
    names = [headings[i].name for i in gauges if headings[i].name]
    if len(set(names)) < len(names):
        raise Refused(name, texts, "different headings")
    for i in gauges:
        if headings[i].unit is None and not _ELEVATION.is_named(headings[i].name):
            allowed = f"headings such as eta or eta [mm]; {_LENGTHS}"
            raise Refused(name, Described(f"a column {headings[i].text}"), allowed)
    return times[0], gauges


def _without_missing_ends(cells: Cells, columns: dict[int, str]) -> Cells:
    """Return the cells from the first to the last complete row."""
    values = {index: cells.numbers(index, text) for index, text in columns.items()}
    complete = np.flatnonzero(~np.any([np.isnan(column) for column in values.values()], axis=0))
    if len(complete) in (0, len(cells.places)):
        return cells
    complete_rows = slice(int(complete[0]), int(complete[-1]) + 1)
    left_out = len(cells.places) - (complete_rows.stop - complete_rows.start)
    if left_out:
        cells.notes.append(f"{left_out} rows without values at the ends left out")
    columns_of = [
        values[i][complete_rows] if i in values else () for i in range(len(cells.columns))
    ]
    return dataclasses.replace(cells, columns=columns_of, places=cells.places[complete_rows])


def _unit(name: str, headings: Sequence[Heading], unit: str | None) -> str:
    """Return the common unit of the elevations of all gauges."""
    units = {str(heading.unit) for heading in headings if heading.unit is not None}
    wrong = sorted(unit for unit in units if not is_convertible(unit, "m"))
    units |= set() if unit is None else {unit}
    if wrong or len(units) > 1:
        raise Refused("unit", Described(", ".join(wrong or sorted(units))), _LENGTHS)
    return units.pop() if units else "m"


def _step(name: str, time: Floats) -> float:
    """Return the time step; times may be rounded by a tenth of it."""
    n = len(time)
    step = float(time[-1] - time[0]) / max(n - 1, 1)
    # against an even grid, since the differences of rounded times are uneven
    even = time[0] + step * np.arange(n)
    if not step > 0.0 or np.abs(time - even).max() > 0.1 * step:
        raise Refused(name, Described("unequal steps in time"), "equal steps > 0 s, without gaps")
    return step


def _band(
    step: float, freq: Floats, spectrum: Floats, f_min: float | None, f_max: float | None
) -> Any:
    """Return the mask of frequencies within the band of the sea."""
    nyquist = 0.5 / step
    low = require_between(2.0 * freq[1] if f_min is None else f_min, 0.0, nyquist, "f_min")
    above = np.flatnonzero(freq >= low * (1.0 - 1e-9))
    peak = float(freq[above[np.argmax(spectrum[above])]])
    high = require_between(
        min(4.0 * peak, 0.8 * nyquist) if f_max is None else f_max, low, nyquist, "f_max", "(]"
    )
    inside = (freq >= low * (1.0 - 1e-9)) & (freq <= high * (1.0 + 1e-9))
    if inside.sum() < 3 or not freq[inside][0] < peak:
        reason = Described(f"{peak:.3g} Hz, the highest of the spectrum")
        allowed = f"above f_min, {low:.3g} Hz: fewer segments or a longer record resolve it"
        raise Refused("peak", reason, allowed)
    return inside


def _stated(
    spreading: Any, freq: Floats, theta: Floats, peak: float, wind_speed: float | None
) -> Floats:
    """Return the shares of energy by direction at each frequency, from a spreading."""
    if spreading is None:
        raise Refused("spreading", None, "a spreading: one gauge does not see directions")
    # spreadings take angles from -pi to pi
    turned = np.remainder(theta + math.pi, 2.0 * math.pi) - math.pi
    kind, omega = Spreading.read(spreading), 2.0 * math.pi * freq[:, None]

    def shares(speed: float) -> Floats:
        density = kind.density(omega, turned, omega_p=2.0 * math.pi * peak, wind_speed=speed)
        return density / density.sum(axis=1, keepdims=True)

    # a spreading that is the same at 5 and 10 m/s does not depend on the wind
    directional = shares(5.0 if wind_speed is None else wind_speed)
    if wind_speed is None and not np.array_equal(directional, shares(10.0)):
        raise Refused("wind_speed", None, f"a wind speed [m/s] for the spreading {kind.kind}")
    return directional


def _of_array(
    elevation: Floats, step: float, positions: Any, length: int,
    freq: Floats, theta: Floats, depth: float | None,
) -> Floats:  # fmt: skip
    """Return the shares of energy by direction at each frequency, from an array of gauges."""
    n = elevation.shape[1]
    allowed = f"{n} pairs (x, y) [m], one for each gauge, three or more not on a line"
    at = require_array(() if positions is None else positions, "positions", allowed)
    # gauges on a line do not tell its two sides apart
    if at.shape != (n, 2) or n < 3 or np.linalg.matrix_rank(at - at.mean(axis=0), 1e-6) < 2:
        raise Refused("positions", Described(f"shape {at.shape}"), allowed)
    with extra("measured", "positions", Described(f"{n} gauges"), "one gauge, or diwasp: {}"):
        from diwasp import EstimationMethod, EstimationParameters, InstrumentData, dirspec
        from diwasp.types import SensorType
    apart = np.hypot(*(at[:, None] - at).transpose(2, 0, 1))[~np.eye(n, dtype=bool)].min()
    # beyond it half a wave is shorter than the least distance: directions are ambiguous
    last = int(np.searchsorted(wavenumber(2.0 * np.pi * freq, depth), math.pi / apart))
    if last == 0:
        reason = Described(f"{apart:.3g} m at least between gauges")
        raise Refused("positions", reason, "less than half of the longest wave")
    deep = _DEEP if depth is None else depth
    instrument = InstrumentData(
        data=elevation,
        layout=np.vstack([at.T, np.full(n, deep)]),
        datatypes=[SensorType.ELEV] * n,
        depth=deep,
        fs=1.0 / step,
    )
    method = EstimationParameters(EstimationMethod.IMLM, nfft=length, dres=len(theta), smooth=False)
    with np.errstate(over="ignore"):
        # its directions are those the waves come from
        reason, _ = dirspec(instrument, method, freq[:last], np.degrees(theta) + 180.0, verbose=0)
    shares = reason.S / reason.S.sum(axis=1, keepdims=True)
    return np.concatenate([shares, np.repeat(shares[-1:], len(freq) - last, axis=0)])
