"""Extra tallies of a run: arrivals, irradiance planes, map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray

from meshtrace.fields import attrs
from meshtrace.models import Floats
from meshtrace.stored import SHIFTS, Variable, Variables, described, variables_of

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


def standard_error(total: Any, squares: Any, n: int) -> Any:
    """Return the standard error of the mean of n photons, from sum and sum of squares."""
    if n < 2:
        return np.full_like(np.asarray(total, float), math.nan)
    mean = np.asarray(total) / n
    # rounding may turn the variance of equal scores negative
    return np.sqrt(np.maximum(np.asarray(squares) / n - mean**2, 0.0) / (n - 1))


def error_of_groups(samples: Floats, axis: int = 0) -> Floats:
    """Return the standard error of the mean of independent samples, along an axis."""
    # ddof = 1: the mean is that of the same samples
    return np.asarray(samples.std(axis=axis, ddof=1) / math.sqrt(samples.shape[axis]))


def sums_by_group(
    group: NDArray[np.int64], weight: Floats, cell: Any = 0, cells: int = 1
) -> Floats:
    """Return the sum of the weights of rows in each cell by each group, shape (SHIFTS, cells).

    The mean over the groups is the sum of all rows: those of a group, a share of the light, count
    times the number of groups; those without error by chance, of group -1, are part of every group.
    """
    chance, cell = group >= 0, np.broadcast_to(cell, group.shape)
    place = group[chance] * cells + cell[chance]
    sums: Any = np.bincount(place, weight[chance], SHIFTS * cells)
    return SHIFTS * sums.reshape(SHIFTS, cells) + np.bincount(cell[~chance], weight[~chance], cells)


def merged_mean(
    means: Sequence[Floats], errors: Sequence[Floats], n: NDArray[np.int64]
) -> tuple[Floats, Floats]:
    """Return mean and standard error of all photons; a run of one photon has no error."""
    total = int(n.sum())
    # exact for any split of the photons, unlike weights by the standard errors
    mean = np.asarray(sum(k / total * m for m, k in zip(means, n, strict=True)))
    # s^2 (k - 1) + m^2 is the mean square of a run: those of runs add by their photons
    square = sum(
        k / total * (m * m + (0.0 if k < 2 else s * s * (k - 1)))
        for m, s, k in zip(means, errors, n, strict=True)
    )
    return mean, np.sqrt(np.maximum(square - mean * mean, 0.0) / max(total - 1, 1))


SPEED_OF_LIGHT = 299_792_458.0
"""Speed of light in vacuum [m s-1] (exact by definition of the metre)."""


def travel_time(water: Floats, air: Floats, n_water: float, n_air: float) -> Floats:
    """Return the times [s] of paths [m] in water and air, by the phase velocities."""
    return (n_water * water + n_air * air) / SPEED_OF_LIGHT


def merged_means(runs: Sequence[Any], n: NDArray[np.int64]) -> dict[str, Any]:
    """Return the fields with a standard error, and the errors, for all photons of runs of n."""
    means: dict[str, Any] = {}
    for name in described(type(runs[0])):
        values, stderr = [getattr(run, name) for run in runs], f"{name}_stderr"
        if hasattr(runs[0], stderr) and values[0] is not None:
            pair = merged_mean(values, [getattr(run, stderr) for run in runs], n)
            means[name], means[stderr] = (v if v.ndim else v.item() for v in pair)
    return means


class Tally:
    """Arrays of a run in addition to its gains; subclasses are dataclasses of them."""

    def __repr__(self) -> str:
        shapes = (f"{name} {array.shape}" for name, (_, array) in variables_of(self).items())
        return f"<{type(self).__name__}: {', '.join(shapes)}>"

    @classmethod
    def merged(cls, tallies: Sequence[Any], n: NDArray[np.int64]) -> Self:
        """Return the tally of all photons of several runs of n photons on the same axes."""
        return replace(tallies[0], **merged_means(tallies, n))


@dataclass(frozen=True, eq=False, repr=False)
class ArrivalTally(Tally):
    """Light at the receivers, a row for each contribution of a sample, a chain or a photon.

    Attributes
    ----------
    receiver : ndarray, shape (arrivals,)
        Index of the receiver.
    weight : ndarray, shape (arrivals,)
        Contributions to the gain [1]; those of a receiver add up to it.
    water_path, air_path : ndarray, shape (arrivals,)
        Path lengths in water and air [m]; unscattered light without random slopes crosses at the
        centroid of a facet.
    time : ndarray, shape (arrivals,)
        Time from emission to arrival [s], by the phase velocities.
    angle : ndarray, shape (arrivals,)
        Angle of arrival to the axis of the receiver [rad]; nan where it is not known, that is for
        joined photons of a downlink.
    group : ndarray, shape (arrivals,)
        Independent estimate, 0 to 31, that an arrival belongs to; the groups share the gain
        equally. -1 has no Monte Carlo error: it is part of every group.
    sample : ndarray, shape (arrivals,)
        Number of the chain or photon, which may bring several arrivals; -1 for unscattered light
        without random slopes.
    part : ndarray, shape (arrivals,)
        0 for unscattered light, 1 for scattered light, 2 for light that the surface reflected
        first. Of links whose ends lie on one side 0 is straight, 3 unscattered and mirrored by the
        surface; of the rest the last event was in the water (1), at the bottom (4) or at a body
        (5).
    order : ndarray, shape (arrivals,)
        Number of scatterings, and of reflections by the bottom.
    """

    receiver: Annotated[NDArray[np.int64], Variable("arrival", name="arrival_receiver")]
    weight: Annotated[Floats, Variable("arrival", name="arrival_weight")]
    water_path: Annotated[Floats, Variable("arrival", name="arrival_water_path")]
    air_path: Annotated[Floats, Variable("arrival", name="arrival_air_path")]
    time: Annotated[Floats, Variable("arrival", name="arrival_time")]
    angle: Annotated[Floats, Variable("arrival", name="arrival_angle")]
    group: Annotated[NDArray[np.int64], Variable("arrival", name="arrival_group")]
    sample: Annotated[NDArray[np.int64], Variable("arrival", name="arrival_sample")]
    part: Annotated[NDArray[np.int64], Variable("arrival", name="arrival_part")]
    order: Annotated[NDArray[np.int64], Variable("arrival", name="arrival_order")]

    def to_dataset(self) -> xr.Dataset:
        """Return the rows as a Dataset, a variable with its unit for each column."""
        import xarray as xr

        names = described(type(self))
        return xr.Dataset(
            {name: ("arrival", getattr(self, name), attrs(f"arrival_{name}")) for name in names}
        )

    def to_dataframe(self) -> pd.DataFrame:
        """Return the rows as a pandas DataFrame, in the units of `to_dataset`.

        Examples
        --------
        >>> import meshtrace as mt
        >>> from meshtrace.surfaces import FlatSea
        >>> r = mt.simulate(mt.Link(), FlatSea(), photons=4096, seed=1, record=[mt.Arrivals()])
        >>> rows = r.arrivals.to_dataframe()
        >>> bool(abs(rows.weight.sum() / r.gain - 1.0) < 1e-12)
        True
        """
        return self.to_dataset().to_dataframe()

    def with_gains(self, gains: Floats) -> ArrivalTally:
        """Return the arrivals with weights that add up to the gain of each receiver."""
        known = np.bincount(self.receiver, self.weight, len(gains))
        # a receiver without arrivals has nothing to scale
        factor = np.divide(gains, known, out=np.ones(len(gains)), where=known > 0.0)
        return replace(self, weight=factor[self.receiver] * self.weight)

    def moved(self, receivers: Sequence[int], samples: int) -> ArrivalTally:
        """Return the arrivals at other receivers, their samples counted after some others."""
        # joined photons of some receivers stand behind the chains of all, which count from 0
        receiver = np.array(receivers, np.int64)[self.receiver]
        return replace(self, receiver=receiver, sample=self.sample + samples)

    @classmethod
    def concatenated(cls, tables: Sequence[ArrivalTally]) -> Self:
        """Return the arrivals of several tables."""
        columns = ([getattr(table, name) for table in tables] for name in described(cls))
        return cls(*map(np.concatenate, columns))

    @classmethod
    def merged(cls, tallies: Sequence[ArrivalTally], n: NDArray[np.int64]) -> Self:
        """Return the arrivals of several runs of n photons."""
        shares = zip(tallies, n / n.sum(), strict=True)
        return cls.concatenated([replace(run, weight=k * run.weight) for run, k in shares])


@dataclass(frozen=True, eq=False, repr=False)
class Planes(Tally):
    r"""Irradiances and radiance on horizontal planes in the water.

    Attributes
    ----------
    depth : ndarray, shape (planes,)
        Depths [m].
    e_d, e_u : ndarray, shape (planes,)
        Downward and upward plane irradiance, integrated over the plane, per emitted power [1].
    e_od, e_ou : ndarray, shape (planes,)
        Downward and upward scalar irradiance, likewise [1].
    e_d_stderr, e_u_stderr, e_od_stderr, e_ou_stderr : ndarray, shape (planes,)
        Standard errors.
    radiance, radiance_stderr : ndarray, shape (planes, cosines, azimuths), or None
        Radiance, integrated over the plane, per emitted power [sr-1], and its standard error from
        32 groups of photons (nan for fewer than 64 photons); None without bins.
    cosine_edges, azimuth_edges : ndarray, shape (cosines + 1,), (azimuths + 1,), or None
        Edges of the bins: cosine of the zenith angle of the light's travel, from 1 (straight up)
        to -1, and azimuth of the travel from +x counter-clockwise [rad].

    Notes
    -----
    The planes are infinite. With a source in the water, all values are integrals over the plane,

    .. math:: \bar L_{ij} = \frac{1}{P} \int \mathrm dA\, L
        = \frac{F_{ij}}{P \int_{ij} |\mu| \,\mathrm d\mu \,\mathrm d\varphi},

    for the flux F of a bin: the mean over the bin with weight \|mu\|. With the sun or a sky, whose
    square stands for an infinitely wide source, they are values at a point per irradiance
    just above the sea: W m-2 per W m-2 and W m-2 sr-1 per W m-2.
    """

    depth: Annotated[Floats, Variable("plane", name="plane_depth")]
    e_d: Annotated[Floats, Variable("plane")]
    e_u: Annotated[Floats, Variable("plane")]
    e_od: Annotated[Floats, Variable("plane")]
    e_ou: Annotated[Floats, Variable("plane")]
    e_d_stderr: Annotated[Floats, Variable("plane")]
    e_u_stderr: Annotated[Floats, Variable("plane")]
    e_od_stderr: Annotated[Floats, Variable("plane")]
    e_ou_stderr: Annotated[Floats, Variable("plane")]
    radiance: Annotated[Floats | None, Variable("plane", "cosine", "azimuth")] = None
    radiance_stderr: Annotated[Floats | None, Variable("plane", "cosine", "azimuth")] = None
    cosine_edges: Annotated[Floats | None, Variable("cosine_edge")] = None
    azimuth_edges: Annotated[Floats | None, Variable("azimuth_edge")] = None

    def _derived(self) -> Variables:
        """Return the centres of the bins in radiance."""
        bins = {"cosine": self.cosine_edges, "azimuth": self.azimuth_edges}
        return {
            name: ((name,), 0.5 * (edges[1:] + edges[:-1]))
            for name, edges in bins.items()
            if edges is not None
        }

    @staticmethod
    def radiance_of(flux: Floats, stderr: Floats) -> dict[str, Floats]:
        """Return radiance, its error and the bins from the flux in each bin."""
        n_cosines, n_azimuths = flux.shape[1:]
        cosine = np.linspace(1.0, -1.0, n_cosines + 1)
        azimuth = np.linspace(0.0, 2.0 * math.pi, n_azimuths + 1)
        # integral of |mu|, for an odd number of bins over one with both signs, too
        projected = np.abs(np.diff(0.5 * cosine * np.abs(cosine)))[:, None] * np.diff(azimuth)
        return {
            "radiance": flux / projected,
            "radiance_stderr": stderr / projected,
            "cosine_edges": cosine,
            "azimuth_edges": azimuth,
        }


_AXES = "map_axis_x", "map_axis_y"  # in a dataset x and y are the cells of other maps


@dataclass(frozen=True, eq=False, repr=False)
class MapTally(Tally):
    """Irradiance on a horizontal plane in the air.

    Attributes
    ----------
    x, y : ndarray, shape (nx,), (ny,)
        Centres of the cells [m].
    irradiance, irradiance_stderr : ndarray, shape (nx, ny)
        Irradiance within the field of view per emitted power [m-2], and its standard error.
    """

    x: Annotated[Floats, Variable("map_axis_x", name="map_x")]
    y: Annotated[Floats, Variable("map_axis_y", name="map_y")]
    irradiance: Annotated[Floats, Variable(*_AXES, name="map_irradiance")]
    irradiance_stderr: Annotated[Floats, Variable(*_AXES, name="map_irradiance_stderr")]
