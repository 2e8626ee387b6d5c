"""Seas from measured or forecast directional spectra in files of the wavespectra kind."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshtrace.stored import read_dataset

from .seas import MeasuredSea

if TYPE_CHECKING:
    import xarray


def from_wavespectra(
    source: str | PathLike[str] | xarray.Dataset,
    seed: int = 0,
    depth: float | None = None,
) -> MeasuredSea:
    """Make a random sea of a directional spectrum in the conventions of wavespectra.

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
    ValueError
        If a variable is missing, has further dimensions longer than one (select a time and a
        site first), or the directions are not equally spaced round the circle.

    Notes
    -----
    The width of a frequency bin is half the distance of its neighbours, at the ends the distance
    of the only neighbour, as wavespectra counts it, so that Hs agrees with its `hs()`.
    """
    dataset = read_dataset(source) if isinstance(source, str | PathLike) else source
    missing = [name for name in ("efth", "freq", "dir") if name not in dataset.variables]
    if missing:
        raise ValueError(f"source: without {missing}, allowed efth over freq [Hz] and dir [deg]")
    efth = dataset["efth"].squeeze(drop=True)
    if set(efth.dims) != {"freq", "dir"} or not efth.size:
        raise ValueError(
            f"efth: dimensions {efth.dims}, allowed (freq, dir); select one time and site first"
        )
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


def _direction_width(direction: NDArray[np.float64]) -> float:
    width = 360.0 / len(direction)
    turn = np.diff(direction, append=direction[0] + 360.0)
    if not np.allclose(turn, width, atol=1e-3 * width):
        raise ValueError(
            f"dir: steps of {turn.min():g} to {turn.max():g} deg, allowed equal steps in a circle"
        )
    return width
