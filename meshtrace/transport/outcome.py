"""Results of the sums that the estimators return."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshtrace.link import Link
from meshtrace.results.gain import Fate, FateTally, GainResult, bound_where_dark
from meshtrace.results.tallies import Arrivals, IrradianceMap, Planes, standard_error
from meshtrace.stored import SHIFTS
from meshtrace.transport.analog import MapGrid, Sums

LEFT_DOMAIN_WARNING = 1e-4


class DomainWarning(UserWarning):
    """Light escaped through the sides of the mesh or leaked through a hole in it."""


def per_receiver(link: Link, array: NDArray[np.float64]) -> Any:
    """Return values of the receivers as an array, or as a number for a single receiver."""
    return array if isinstance(link.receiver, tuple) else float(array[0])


def analog_result(
    link: Link, sums: Sums, origin: dict[str, Any], grid: MapGrid | None, keep_arrivals: bool
) -> GainResult:
    """Return the result of analog photons, warning of light that left the mesh."""
    n, n_rx = sums.photons, len(link.receivers)
    mean = sums.score / n
    stderr = standard_error(sums.score, sums.score_squared, n)
    weights = sums.ledger.value() / n
    gain = per_receiver(link, mean[:n_rx])
    result = GainResult(
        gain=gain,
        gain_stderr=per_receiver(link, stderr[:n_rx]),
        gain_bound=bound_where_dark(gain, n),
        photons=n,
        fates={
            fate.name.lower(): FateTally(int(sums.count[fate]), float(weights[fate]))
            for fate in Fate
        },
        provenance=origin,
        misses=(int(sums.misses[0]), int(sums.misses[1])),
        arrivals=_arrivals(sums) if keep_arrivals else None,
        planes=_planes(link, sums, mean[n_rx:], stderr[n_rx:]),
        map=_map(grid, sums) if grid else None,
    )
    _warn(result)
    return result


def _arrivals(sums: Sums) -> Arrivals:
    rows = np.concatenate([np.zeros((0, 5)), *sums.arrivals])
    rows[:, 2] /= sums.photons
    return Arrivals.of_rows(np.column_stack([rows[:, 1:], rows[:, 0] % SHIFTS]))


def _planes(
    link: Link, sums: Sums, mean: NDArray[np.float64], stderr: NDArray[np.float64]
) -> Planes | None:
    if not link.planes:
        return None
    columns = [values[i::4] for values in (mean, stderr) for i in range(4)]
    radiance = {}
    if link.planes.n_cosines:
        flux, photons = sums.radiance.value(), np.full(SHIFTS, sums.photons // SHIFTS)
        photons[: sums.photons % SHIFTS] += 1
        error = np.full(flux.shape[1:], np.nan)
        if sums.photons >= 2 * SHIFTS:
            groups = flux / photons[:, None, None, None]
            error = groups.std(axis=0, ddof=1) / np.sqrt(SHIFTS)
        radiance = Planes.radiance_of(flux.sum(axis=0) / sums.photons, error)
    return Planes(np.array(link.planes.depths), *columns, **radiance)


def _map(grid: MapGrid, sums: Sums) -> IrradianceMap:
    area = grid.step**2
    axis = np.asarray(-grid.extent + grid.step * (np.arange(grid.n) + 0.5), np.float64)
    total, squares = sums.map.value(), sums.map_squared.value()
    cell = total / sums.photons
    error = np.sqrt(np.maximum(squares / sums.photons - cell**2, 0.0) / max(sums.photons - 1, 1))
    return IrradianceMap(axis, axis, cell / area, error / area)


def _warn(result: GainResult) -> None:
    left = result.fates["left_domain"].weight
    if left > LEFT_DOMAIN_WARNING:
        warnings.warn(
            f"{left:.2g} of the launched weight left the meshed surface sideways (more than "
            f"{LEFT_DOMAIN_WARNING:g}): enlarge extent",
            DomainWarning,
            stacklevel=4,
        )
    if result.misses[1]:
        warnings.warn(
            f"{result.misses[1]} photons missed the surface inside the mesh after being cast "
            "again: the mesh may have holes",
            DomainWarning,
            stacklevel=4,
        )
