"""Extra tallies of a run: arrivals, irradiance planes, map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray

from meshtrace.fields import attrs
from meshtrace.kernels.tally import BODY, BOTTOM, DIRECT, MIRRORED, SCATTERED
from meshtrace.models import Floats
from meshtrace.stored import SHIFTS, Variable, Variables, described, variables_of

ONE_SIDE_PARTS = {
    "straight": DIRECT,
    "mirrored": MIRRORED,
    "scattered": SCATTERED,
    "bottom": BOTTOM,
    "bodies": BODY,
}
"""Names of the parts of light between ends on one side, and their numbers in `ArrivalTally`."""

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


def standard_error(total: Any, squares: Any, n: int) -> Any:
    """Return the standard error of the mean score of n photons, from sum and sum of squares.

    s = [(mean of squares - square of mean) / (n - 1)]^(1/2), nan for a single photon.
    """
    if n < 2:
        return np.full_like(np.asarray(total, float), math.nan)
    mean = np.asarray(total) / n
    # rounding may turn the variance of equal scores negative
    return np.sqrt(np.maximum(np.asarray(squares) / n - mean**2, 0.0) / (n - 1))


def error_of_groups(samples: Floats, axis: int = 0) -> Floats:
    """Return the standard error of the mean of independent samples, along an axis."""
    # ddof = 1: the mean is estimated from the same samples
    return np.asarray(samples.std(axis=axis, ddof=1) / math.sqrt(samples.shape[axis]))


def sums_by_group(
    group: NDArray[np.int64], weight: Floats, cell: Any = 0, cells: int = 1
) -> Floats:
    """Return the estimates of each group for the sums of weights in cells, shape (SHIFTS, cells).

    `group`, `weight` and `cell` are those of arrivals. A group has about 1 / SHIFTS of the light:
    its sums are multiplied by SHIFTS, so that the mean over the groups is the sum of all arrivals.
    Arrivals of group -1 have no Monte Carlo error, and count in full in every group.
    """
    random, cell = group >= 0, np.broadcast_to(cell, group.shape)
    index = group[random] * cells + cell[random]
    sums: Any = np.bincount(index, weight[random], SHIFTS * cells)
    return SHIFTS * sums.reshape(SHIFTS, cells) + np.bincount(cell[~random], weight[~random], cells)


def merged_mean(
    means: Sequence[Floats], errors: Sequence[Floats], n: NDArray[np.int64]
) -> tuple[Floats, Floats]:
    """Merge means and standard errors of runs of n[i] photons."""
    total = int(n.sum())
    # weighted by photons k: the mean of all however they are split into runs, whereas weights by
    # the standard errors, which are correlated with the means, would be biased
    mean = np.asarray(sum(k / total * m for m, k in zip(means, n, strict=True)))
    # a run with mean m and standard error s has the mean square s^2 (k - 1) + m^2, see
    # `standard_error`; the error of a single photon is nan
    square = sum(
        k / total * (m * m + (0.0 if k < 2 else s * s * (k - 1)))
        for m, s, k in zip(means, errors, n, strict=True)
    )
    return mean, np.sqrt(np.maximum(square - mean * mean, 0.0) / max(total - 1, 1))


SPEED_OF_LIGHT = 299_792_458.0
"""Speed of light in vacuum [m s-1] (exact by definition of the metre)."""


def travel_time(water: Floats, air: Floats, n_water: float, n_air: float) -> Floats:
    """Return travel times [s] along paths [m] in water and air, at the phase velocities."""
    return (n_water * water + n_air * air) / SPEED_OF_LIGHT


def merged_means(runs: Sequence[Any], n: NDArray[np.int64]) -> dict[str, Any]:
    """Return the fields that have a standard error, and the errors, for the photons of all runs.

    Run i has n[i] photons; a field "x" has its error in the field "x_stderr".
    """
    means: dict[str, Any] = {}
    for name in described(type(runs[0])):
        values, stderr = [getattr(run, name) for run in runs], f"{name}_stderr"
        if hasattr(runs[0], stderr) and values[0] is not None:
            pair = merged_mean(values, [getattr(run, stderr) for run in runs], n)
            # fields that are numbers remain numbers
            means[name], means[stderr] = (v if v.ndim else v.item() for v in pair)
    return means


class Tally:
    """Base of the results of a run other than its gains; subclasses are dataclasses of arrays."""

    def __repr__(self) -> str:
        shapes = (f"{name} {array.shape}" for name, (_, array) in variables_of(self).items())
        return f"<{type(self).__name__}: {', '.join(shapes)}>"

    @classmethod
    def merged(cls, tallies: Sequence[Any], n: NDArray[np.int64]) -> Self:
        """Return the tally of all photons of runs of n[i] photons, with the same axes."""
        return replace(tallies[0], **merged_means(tallies, n))


@dataclass(frozen=True, eq=False, repr=False)
class ArrivalTally(Tally):
    """Arrivals of light at the receivers: contributions of chains, photons or facets.

    Attributes
    ----------
    receiver : ndarray, shape (arrivals,)
        Index of the receiver.
    weight : ndarray, shape (arrivals,)
        Contributions to the gain [1]; those of a receiver add up to it.
    water_path, air_path : ndarray, shape (arrivals,)
        Path lengths in water and air [m]; unscattered light without random slopes is taken to
        cross the surface at the centroid of a facet.
    time : ndarray, shape (arrivals,)
        Time from emission to arrival [s], by the phase velocities.
    angle : ndarray, shape (arrivals,)
        Angle of arrival to the axis of the receiver [rad].
    azimuth : ndarray, shape (arrivals,)
        Azimuth of the side that the light comes from about the line of sight [rad], see
        `Receiver.azimuths_of`.
    group : ndarray, shape (arrivals,)
        Index of the independent group of samples, 0 to 31, that an arrival belongs to; each group
        has an equal share of the samples. -1: no Monte Carlo error, part of every group.
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
    azimuth: Annotated[Floats, Variable("arrival", name="arrival_azimuth")]
    group: Annotated[NDArray[np.int64], Variable("arrival", name="arrival_group")]
    sample: Annotated[NDArray[np.int64], Variable("arrival", name="arrival_sample")]
    part: Annotated[NDArray[np.int64], Variable("arrival", name="arrival_part")]
    order: Annotated[NDArray[np.int64], Variable("arrival", name="arrival_order")]

    def to_dataset(self) -> xr.Dataset:
        """Return the arrivals as a Dataset, with one variable and its unit for each column."""
        import xarray as xr

        names = described(type(self))
        return xr.Dataset(
            {name: ("arrival", getattr(self, name), attrs(f"arrival_{name}")) for name in names}
        )

    def to_dataframe(self) -> pd.DataFrame:
        """Return the arrivals as a pandas DataFrame, in the units of `to_dataset`.

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
        """Return the arrivals with weights scaled to add up to the given gain of each receiver."""
        sums = np.bincount(self.receiver, self.weight, len(gains))
        # a receiver without arrivals has nothing to scale
        factor = np.divide(gains, sums, out=np.ones(len(gains)), where=sums > 0.0)
        return replace(self, weight=factor[self.receiver] * self.weight)

    def moved(self, receivers: Sequence[int], samples: int) -> ArrivalTally:
        """Renumber receiver i to `receivers[i]`, and samples to follow earlier ones.

        `samples` is the number of samples that come before: joined photons of a part of the
        receivers are numbered after the chains, which count from 0.
        """
        receiver = np.array(receivers, np.int64)[self.receiver]
        return replace(self, receiver=receiver, sample=self.sample + samples)

    @classmethod
    def concatenated(cls, tables: Sequence[ArrivalTally]) -> Self:
        """Return the arrivals of several tables as one."""
        columns = ([getattr(table, name) for table in tables] for name in described(cls))
        return cls(*map(np.concatenate, columns))

    @classmethod
    def merged(cls, tallies: Sequence[ArrivalTally], n: NDArray[np.int64]) -> Self:
        """Return the arrivals of runs of n[i] photons, with weights per photon of all runs."""
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
        Edges of the bins of the direction in which light travels: cosine mu of its zenith angle,
        from 1 (straight up) to -1, and azimuth phi from +x counter-clockwise [rad].

    Notes
    -----
    The planes are infinite. With a source in the water, all values are integrals over the plane,

    .. math:: \bar L_{ij} = \frac{1}{P} \int \mathrm dA\, L
        = \frac{F_{ij}}{P \int_{ij} |\mu| \,\mathrm d\mu \,\mathrm d\varphi},

    for the flux F of a bin and the emitted power P: the mean over the bin with weight \|mu\|. With
    the sun or a sky, whose illuminated square stands for an infinitely wide one, they are values
    at a point per irradiance just above the sea: W m-2 per W m-2 and W m-2 sr-1 per W m-2.
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
        """Return the centres of the bins of radiance as coordinates of a dataset."""
        bins = {"cosine": self.cosine_edges, "azimuth": self.azimuth_edges}
        return {
            name: ((name,), 0.5 * (edges[1:] + edges[:-1]))
            for name, edges in bins.items()
            if edges is not None
        }

    @staticmethod
    def radiance_of(flux: Floats, stderr: Floats) -> dict[str, Floats]:
        """Return the fields of the radiance from the flux in bins (planes, cosines, azimuths)."""
        n_cosines, n_azimuths = flux.shape[1:]
        cosine = np.linspace(1.0, -1.0, n_cosines + 1)
        azimuth = np.linspace(0.0, 2.0 * math.pi, n_azimuths + 1)
        # int |mu| dmu = mu |mu| / 2, also where mu changes sign: in the middle one of an odd number
        # of bins
        projected = np.abs(np.diff(0.5 * cosine * np.abs(cosine)))[:, None] * np.diff(azimuth)
        return {
            "radiance": flux / projected,
            "radiance_stderr": stderr / projected,
            "cosine_edges": cosine,
            "azimuth_edges": azimuth,
        }


_AXES = "map_axis_x", "map_axis_y"  # dimensions x and y of a dataset are those of `CoverageMap`


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
