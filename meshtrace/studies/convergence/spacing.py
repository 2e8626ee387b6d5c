"""How a gain depends on the spacing of the mesh."""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from itertools import product
from typing import TYPE_CHECKING, Literal

import numpy as np

from meshtrace.results.provenance import provenance
from meshtrace.studies.convergence.checks import (
    Floats,
    Normals,
    Progress,
    Unresolved,
    falling,
    kinds_of,
    positive,
    unresolved_in,
)
from meshtrace.studies.convergence.exact import wave_sum
from meshtrace.studies.convergence.measure import (
    ANALOG_PHOTONS,
    CommonChains,
    Measured,
    mapped,
    spread,
    stacked,
)
from meshtrace.studies.convergence.meshes import crest_of, nested_mesh, placement_shifts
from meshtrace.studies.convergence.study import ConvergenceStudy

if TYPE_CHECKING:
    from meshtrace.link import Link
    from meshtrace.mesh import SurfaceModel


DEFAULT_SPACINGS = (2.0, 1.0, 0.5, 0.25, 0.125, 0.0625)
"""Mesh spacings [m] of a study: each halves the one before, so that the grid lines nest."""

PLACEMENTS = 34
"""Meshes of each spacing: a Fibonacci number, whose lattice fills a cell most evenly."""


def convergence_study(
    link: Link,
    sea: SurfaceModel,
    spacings: Sequence[float] = DEFAULT_SPACINGS,
    normals: Sequence[Normals] = ("vertex", "facet"),
    *,
    photons: int = 2048,
    seed: int = 1,
    time: float = 0.0,
    placements: int = PLACEMENTS,
    reference: Literal["analytic"] | None = "analytic",
    tolerance: float = 1e-3,
    receiver: int = 0,
    unresolved: Unresolved = "none",
    threads: int | None = None,
    progress: Progress | None = None,
) -> ConvergenceStudy:
    """Return how the gain over a sea depends on the spacing of its mesh.

    Parameters
    ----------
    link : Link
        The link.
    sea : SurfaceModel
        The sea, triangulated uniformly over all that light can cross to the receiver.
    spacings : sequence of float
        At least four mesh spacings [m].
    normals : sequence of {"vertex", "facet"}
        Normals of the mesh.
    photons : int
        Scattering chains, common to all meshes.
    seed : int
        Key of the random numbers.
    time : float
        Time of the sea [s].
    placements : int
        Meshes of each spacing, moved against the sea by parts of a cell; 1 keeps one mesh, whose
        lines go through the origin.
    reference : "analytic" or None
        Whether to find the gain over the exact sum of waves too.
    tolerance : float
        Relative error that the recommended spacing is about.
    receiver : int
        Index of the receiver.
    unresolved : {"none", "tilt"}
        Whether normals tilt at random by the slopes that each mesh leaves out
        (`Physics.unresolved`): "none" studies the mesh itself, "tilt" whether the mean gain is
        free of it.
    threads : int, optional
        Threads, all cores by default; the result does not depend on them.
    progress : callable, optional
        Called with 1 after each mesh.

    Returns
    -------
    ConvergenceStudy

    Raises
    ------
    ValueError
        If an option is out of range, or the exact surface is asked for and the sea is not a
        sum of waves.

    Notes
    -----
    The aperture sees the unscattered light through a patch of a few centimetres, mostly on one
    facet. There the curvature of a mesh is wrong by O(h), up or down by chance of where the
    facet lies. The mean over placements is free of it and converges as h^2; what one
    placement errs by is `scatter`.

    Examples
    --------
    >>> import meshtrace as mt
    >>> from meshtrace.surfaces import SinusoidalSea
    >>> wave = SinusoidalSea(amplitude=0.05, wavelength=4.0)
    >>> study = convergence_study(
    ...     mt.Link(), wave, (1.0, 0.5, 0.25, 0.125), ("vertex",), photons=256
    ... )
    >>> 1.6 < study.fits["vertex"].order.value < 2.2
    True
    """
    values = falling("spacings", spacings)
    kinds = kinds_of(normals)
    positive("tolerance", tolerance)
    if placements < 1:
        raise ValueError(f"placements: {placements!r}, allowed placements >= 1")
    if reference not in ("analytic", None):
        raise ValueError(f"reference: {reference!r}, allowed 'analytic' or None")
    if unresolved_in(unresolved) == "tilt" and reference:
        raise ValueError("reference: 'analytic', allowed None beside random slopes")
    exact = wave_sum(sea) if reference else None
    crest = crest_of(link, sea, time)
    chains = CommonChains(link, photons, seed, kinds, receiver, crest, unresolved)
    shifts = placement_shifts(placements)

    def measure(job: tuple[float, Floats]) -> Measured:
        spacing, shift = job
        start = clock.perf_counter()
        mesh = nested_mesh(link, sea, time, spacing, shift)
        return chains.measure(mesh, clock.perf_counter() - start, photons=ANALOG_PHOTONS)

    jobs = list(product(values, shifts))
    rows = mapped(measure, jobs, threads, progress)
    samples, ballistic, slopes, reflected, costs = stacked(rows, len(values))
    run = {
        "estimator": "forced", "photons": photons, "seed": seed, "time": time,
        "spacings": list(values), "normals": list(kinds), "placements": placements,
        "receiver": receiver, "unresolved": unresolved,
    }  # fmt: skip
    return ConvergenceStudy(
        parameter="spacing",
        values=np.array(values),
        normals=kinds,
        samples=samples,
        ballistic=ballistic,
        scatter=spread(samples.mean(axis=3)),
        slope_variance=slopes.mean(axis=2),
        total_reflection=reflected.mean(axis=2),
        costs=costs,
        reference=chains.exact(exact, time, values[-1]) if exact else None,
        tolerance=tolerance,
        provenance=provenance(link, sea.to_config(), run),
    )
