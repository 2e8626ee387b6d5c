"""Seas from measured or forecast directional spectra in files of the wavespectra kind."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from meshtrace.errors import Described, Refused

from .parameters import Floats
from .random_seas import MeasuredSea

if TYPE_CHECKING:
    import xarray


def from_wavespectra(
    source: str | PathLike[str] | xarray.Dataset,
    seed: int = 0,
    depth: float | None = None,
) -> MeasuredSea:
    """Return a random sea of a directional spectrum in the conventions of wavespectra.

    variance_ij = efth_ij df_i ddir, omega = 2 pi freq, theta = 270 deg - dir

    Parameters
    ----------
    source : path or xarray.Dataset
        netCDF file or dataset with `efth` [m2 Hz-1 deg-1] over `freq` [Hz] and `dir` [deg], the
        nautical direction the waves come from, clockwise from north.
    seed : int
        Seed of the random phases.
    depth : float, optional
        Water depth [m]; None is deep water.

    Returns
    -------
    MeasuredSea
        With x to the east and y to the north.

    Raises
    ------
    Refused
        If a variable is missing, has further dimensions longer than one (select a time and a
        site first), or the directions are not equally spaced round the circle.

    Notes
    -----
    The width of a frequency bin is half the distance of its neighbours, at the ends the distance
    of the only neighbour, as wavespectra counts it, so that Hs agrees with its `hs()`.
    """
    dataset = _loaded(source)
    missing = [name for name in ("efth", "freq", "dir") if name not in dataset.variables]
    if missing:
        raise Refused(
            "source", Described(f"without {missing}"), "efth over freq [Hz] and dir [deg]"
        )
    efth = dataset["efth"].squeeze(drop=True)
    if set(efth.dims) != {"freq", "dir"}:
        raise Refused("efth", efth.dims, "dimensions (freq, dir); select one time and site first")
    efth = efth.transpose("freq", "dir").sortby("freq").sortby("dir")
    freq, direction = (np.asarray(efth[name], dtype=np.float64) for name in ("freq", "dir"))
    variance = efth.values * np.gradient(freq)[:, None] * _direction_width(direction)
    return MeasuredSea(
        omega=tuple(2.0 * np.pi * freq),
        theta=tuple(np.radians(270.0 - direction)),
        variance=tuple(map(tuple, variance)),
        seed=seed,
        depth=depth,
    )


def _loaded(source: str | PathLike[str] | xarray.Dataset) -> xarray.Dataset:
    if not isinstance(source, str | PathLike):
        return source
    import xarray

    with xarray.open_dataset(source) as dataset:
        return dataset.load()


def _direction_width(direction: Floats) -> float:
    width = 360.0 / len(direction)
    turn = np.diff(direction, append=direction[0] + 360.0)
    if not np.allclose(turn, width, atol=1e-3 * width):
        found = Described(f"steps of {turn.min():g} to {turn.max():g} deg")
        raise Refused("dir", found, "equal steps round the circle")
    return width
