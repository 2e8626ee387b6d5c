"""Seas from measured or forecast directional spectra."""

from __future__ import annotations

import math
import warnings
from os import PathLike
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from meshtrace.errors import Described, DomainWarning, Refused, did_you_mean, extra, reason_of
from meshtrace.stored import read_dataset
from meshtrace.tables import read_columns

from .parameters import Floats, Mss
from .seas import MeasuredSea
from .spectra import Elfouhaily, ElfouhailySpreading, sea_state
from .statistics import components_slope_variance, cox_munk

if TYPE_CHECKING:
    import xarray

TAIL_OMEGA_MAX = 24.0
"""Highest frequency of a tail [rad s-1]: shorter waves blur light and add no fading."""

_TAIL_PER_OCTAVE = 16


class _Table(NamedTuple):
    """Variance [m2] over frequency [Hz] and direction of travel [rad from +x]."""

    freq: Floats
    theta: Floats
    variance: Floats

    def sea(self, **options: Any) -> MeasuredSea:
        """Return a sea with these waves."""
        return MeasuredSea(
            omega=tuple(2.0 * np.pi * self.freq),
            theta=tuple(self.theta),
            variance=tuple(map(tuple, self.variance)),
            **options,
        )


def from_wavespectra(
    source: str | PathLike[str] | xarray.Dataset,
    seed: int = 0,
    depth: float | None = None,
    *,
    reader: str | None = None,
    time: Any = None,
    site: int | tuple[float, float] | None = None,
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
    source : path or xarray.Dataset
        netCDF file or dataset with `efth` [m2 Hz-1 deg-1] over `freq` [Hz] and `dir` [deg], the
        nautical direction the waves come from, clockwise from north; or, with `reader`, a file;
        or a text file (.csv, .txt) whose header holds the directions and whose first column the
        frequencies, see `meshtrace.tables.read_columns`.
    seed : int
        Seed of the random phases.
    depth : float, optional
        Water depth [m]; None is deep water.
    reader : str, optional
        Format of the file, such as "ndbc", "era5", "ww3", "ncswan", "swan", "spotter" or
        "datawell": the function `read_<reader>` of wavespectra (`pip install
        "meshtrace[measured]"`).
    time : optional
        Time of the spectrum, in any form that numpy reads as a date; the nearest one within half a
        step of the record is taken.
    site : int or (float, float), optional
        Number of a station, or longitude and latitude [deg]; the nearest one within 1 deg is taken.
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
        If a variable is missing, time or site is outside of the record or has to be selected, the
        directions are not equally spaced round the circle, or wavespectra is missing.

    Warns
    -----
    DomainWarning
        If there is neither `tail` nor `mss`: slopes are missing.

    Notes
    -----
    The width of a frequency bin is half the distance of its neighbours, at the ends the distance
    of the only neighbour, as wavespectra counts it, so that Hs agrees with its `hs()`.
    Buoys end at 0.5 to 1 Hz and models at 0.4 to 0.6 Hz, where hardly any light fades yet.
    """
    if tail is not None and tail != "elfouhaily":
        raise Refused("tail", tail, "elfouhaily")
    if tail is not None and wind_speed is None:
        raise Refused("wind_speed", None, "a wind speed [m/s] for the tail")
    table, record = _read(source, reader, time, site, x_axis_deg)
    wind_direction = math.degrees(_mean_direction(table))
    if tail is not None and wind_speed is not None:
        table = _with_tail(table, wind_speed)
    elif mss is None:
        _warn_of_missing_slopes(table, wind_speed, depth)
    return table.sea(
        seed=seed,
        depth=depth,
        current=current,
        waves=waves,
        mss=mss or ("band" if tail is None else "elfouhaily"),
        wind_speed=wind_speed,
        wind_direction_deg=0.0 if wind_speed is None else wind_direction,
        record=record,
    )


def _read(
    source: Any, reader: str | None, time: Any, site: Any, x_axis_deg: float
) -> tuple[_Table, str | None]:
    if reader is not None:
        read = _reader(reader)
        try:
            dataset = read(source)
        except Exception as error:  # the readers raise any exception
            found = Described(reason_of(error))
            raise Refused(str(source), found, f"a file that read_{reader} reads") from error
    elif isinstance(source, str | PathLike):
        is_text = str(source).lower().endswith((".csv", ".txt"))
        dataset = _text_table(source) if is_text else read_dataset(source)
    elif not hasattr(source, "variables"):
        raise Refused("source", source, "a path or an xarray.Dataset")
    else:
        dataset = source
    missing = [name for name in ("efth", "freq", "dir") if name not in dataset.variables]
    if missing:
        raise Refused(
            "source", Described(f"without {missing}"), "efth over freq [Hz] and dir [deg]"
        )
    efth, record = dataset["efth"], []
    if time is not None:
        efth = _at_time(efth, time)
    if site is not None:
        efth = _at_site(dataset, efth, site)
    for name in ("time", "site", "lon", "lat"):
        if name in efth.coords and efth[name].size == 1 and (time is not None or site is not None):
            record.append(f"{name} {np.atleast_1d(efth[name].values)[0]}")
    efth = efth.squeeze(drop=True)
    if set(efth.dims) != {"freq", "dir"} or not efth.size:
        raise Refused("efth", efth.dims, "dimensions (freq, dir); select one time and site first")
    efth = efth.transpose("freq", "dir").sortby("freq").sortby("dir")
    freq, direction = (np.asarray(efth[name], dtype=np.float64) for name in ("freq", "dir"))
    variance = efth.values * np.gradient(freq)[:, None] * _direction_width(direction)
    if not (np.isfinite(freq) & (freq > 0.0)).all():
        raise Refused("freq", Described("not positive"), "finite numbers > 0 [Hz]")
    if not (np.isfinite(variance) & (variance >= 0.0)).all():
        raise Refused("efth", Described("negative or not finite"), "finite variance densities >= 0")
    theta = np.radians(180.0 + x_axis_deg - direction)
    return _Table(freq, theta, variance), ", ".join(record) or None


def _text_table(path: str | PathLike[str]) -> xarray.Dataset:
    """Return the dataset of a text file with directions in its header."""
    import xarray as xr

    header, values = read_columns(path)
    try:
        directions = [float(word) for word in header[1:]]
    except ValueError:
        directions = []
    if len(directions) != values.shape[1] - 1:
        found = Described(" ".join(header) or "no header")
        raise Refused(str(path), found, "a header with a direction [deg] for each column but one")
    coords = {"freq": values[:, 0], "dir": directions}
    return xr.Dataset({"efth": (("freq", "dir"), values[:, 1:])}, coords)


def _reader(name: str) -> Any:
    with extra("measured", "reader", name, "formats of wavespectra: {}"):
        import wavespectra
    names = sorted(n.removeprefix("read_") for n in dir(wavespectra) if n.startswith("read_"))
    if name not in names:
        raise Refused("reader", name, ", ".join(names), did_you_mean(name, names))
    return getattr(wavespectra, f"read_{name}")


def _at_time(efth: xarray.DataArray, time: Any) -> xarray.DataArray:
    if "time" not in efth.coords:
        raise Refused("time", time, "a record with times")
    times = np.atleast_1d(efth["time"].values)
    first, last = times.min(), times.max()
    try:
        wanted = np.datetime64(time, "ns")
    except ValueError as error:
        raise Refused("time", time, f"a date from {first} to {last}") from error
    distance = np.abs(times - wanted)
    step = np.diff(np.sort(times)).max() if len(times) > 1 else np.timedelta64(0, "ns")
    if distance.min() > step / 2:
        raise Refused("time", time, f"within half a step of {first} to {last}")
    return efth.isel(time=int(distance.argmin())) if "time" in efth.dims else efth


def _at_site(
    dataset: xarray.Dataset, efth: xarray.DataArray, site: int | tuple[float, float]
) -> xarray.DataArray:
    if isinstance(site, int):
        stations = dataset.sizes.get("site", 0)
        if not 0 <= site < stations:
            raise Refused("site", site, f"0 to {stations - 1}, of {stations} stations")
        return efth.isel(site=site)
    if "lon" not in dataset.variables or "lat" not in dataset.variables:
        raise Refused("site", site, "a record with lon and lat")
    lon, lat = site
    off_lon, off_lat = dataset["lon"] - lon, dataset["lat"] - lat
    # longitudes of 0 to 360 and of -180 to 180 deg name the same meridians
    distance: Any = np.hypot((off_lon + 180.0) % 360.0 - 180.0, off_lat)
    if "time" in distance.dims:
        distance = distance.isel(time=0)
    if float(distance.min()) > 1.0:
        raise Refused("site", site, "within 1 deg of a station or grid point")
    return efth.isel(distance.argmin(dim=...))


def _mean_direction(table: _Table) -> float:
    """Return the mean direction of the last frequency with waves [rad]."""
    row = table.variance[np.flatnonzero(table.variance.sum(axis=1))[-1:]].sum(axis=0)
    return float(np.arctan2(row @ np.sin(table.theta), row @ np.cos(table.theta)))


def _with_tail(table: _Table, wind_speed: float) -> _Table:
    """Return the table continued with the spectrum of Elfouhaily et al."""
    spectrum = Elfouhaily(wind_speed=wind_speed)
    omega = 2.0 * np.pi * table.freq
    width = np.gradient(omega)[-1]
    start = omega[-1] + 0.5 * width
    if start >= TAIL_OMEGA_MAX:
        return table
    bins = math.ceil(_TAIL_PER_OCTAVE * math.log2(TAIL_OMEGA_MAX / start))
    edges = np.geomspace(start, TAIL_OMEGA_MAX, bins + 1)
    centers = np.sqrt(edges[1:] * edges[:-1])
    ratio = float(table.variance[-1].sum() / width / spectrum(omega[-1]))
    octaves = np.clip(np.log2(centers / omega[-1]), 0.0, 1.0)
    density = spectrum(centers) * (ratio + (1.0 - ratio) * octaves)
    turned = np.remainder(table.theta - _mean_direction(table) + np.pi, 2.0 * np.pi) - np.pi
    spread = ElfouhailySpreading().density(centers[:, None], turned, **sea_state(spectrum))
    shares = spread / spread.sum(axis=1, keepdims=True)
    rows = (density * np.diff(edges))[:, None] * shares
    freq = np.concatenate([table.freq, centers / (2.0 * np.pi)])
    return _Table(freq, table.theta, np.concatenate([table.variance, rows]))


def _warn_of_missing_slopes(table: _Table, wind_speed: float | None, depth: float | None) -> None:
    end = f"the spectrum ends at {table.freq[-1]:.3g} Hz"
    advice = 'give wind_speed with tail="elfouhaily" or with mss="cox-munk"'
    if wind_speed is None:
        text = f"source: {end}, without any shorter waves: {advice}"
    else:
        resolved = sum(components_slope_variance(table.sea(depth=depth).components))
        missing = 100.0 * max(0.0, 1.0 - resolved / sum(cox_munk(wind_speed)))
        text = f"source: {end}, beyond which {missing:.0f} % of the slope variance lies: {advice}"
    warnings.warn(text, DomainWarning, stacklevel=3)


def _direction_width(direction: Floats) -> float:
    width = 360.0 / len(direction)
    turn = np.diff(direction, append=direction[0] + 360.0)
    if not np.allclose(turn, width, atol=1e-3 * width):
        found = Described(f"steps of {turn.min():g} to {turn.max():g} deg")
        raise Refused("dir", found, "equal steps round the circle")
    return width
