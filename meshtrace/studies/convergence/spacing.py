"""Dependence of a gain on the spacing of the mesh."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Literal

import numpy as np

from meshtrace.errors import Refused, require_whole
from meshtrace.studies.convergence.checks import (
    Normals,
    Progress,
    Unresolved,
    descending,
    known_unresolved,
    normal_kinds,
    positive,
)
from meshtrace.studies.convergence.exact import wave_sum
from meshtrace.studies.convergence.measure import CommonChains, over_cases, spread
from meshtrace.studies.convergence.meshes import crest_of, nested_mesh, placement_shifts
from meshtrace.studies.convergence.study import ConvergenceStudy
from meshtrace.studies.inputs import resolve_chains

if TYPE_CHECKING:
    from meshtrace.link import Link
    from meshtrace.mesh import SurfaceModel
    from meshtrace.scenario import Scenario

DEFAULT_SPACINGS = (2.0, 1.0, 0.5, 0.25, 0.125, 0.0625)
"""Mesh spacings [m] of a study: each halves the one before, so that the grid lines nest."""

PLACEMENTS = 34
"""Meshes of each spacing: a Fibonacci number, whose lattice fills a cell most evenly."""


def convergence_study(
    link: Link | Scenario,
    surface: SurfaceModel | None = None,
    spacings: Sequence[float] = DEFAULT_SPACINGS,
    normals: Sequence[Normals] = ("vertex", "facet"),
    *,
    photons: int = 2048,
    seed: int | None = None,
    time: float | None = None,
    placements: int = PLACEMENTS,
    reference: Literal["analytic"] | None = "analytic",
    tolerance: float = 1e-3,
    receiver: int = 0,
    unresolved: Unresolved = "none",
    threads: int | None = None,
    progress: Progress | None = None,
) -> ConvergenceStudy:
    """Study the dependence of the gain over a sea on the spacing of its mesh.

    Parameters
    ----------
    link : Link or Scenario
        The link, or a scenario that also gives sea, seed, time and threads.
    surface : SurfaceModel, optional
        The sea, triangulated uniformly over all that light can cross to the receiver.
    spacings : sequence of float
        At least four mesh spacings [m].
    normals : sequence of {"vertex", "facet"}
        Normals of the mesh.
    photons : int
        Scattering chains, common to all meshes.
    seed : int, optional
        Key of the random numbers, 1 by default.
    time : float, optional
        Time of the sea [s].
    placements : int
        Meshes of each spacing, moved against the sea by parts of a cell; 1 keeps one mesh, whose
        lines go through the origin.
    reference : "analytic" or None
        Whether to find the gain over the exact sum of waves too.
    tolerance : float
        Relative error of one surface that the recommended spacing meets.
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
        If an option is out of range, or the exact surface is requested and the sea is not a
        sum of waves.

    Notes
    -----
    The aperture receives the unscattered light through a patch of a few centimetres, mostly on one
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
    values, kinds = descending("spacings", spacings), normal_kinds(normals)
    positive("tolerance", tolerance)
    require_whole(placements, 1, 100_000, "placements")
    if reference not in ("analytic", None):
        raise Refused("reference", reference, "'analytic' or None")
    if known_unresolved(unresolved) == "tilt" and reference:
        raise Refused("reference", reference, "None beside random slopes")
    inputs = resolve_chains(link, surface, photons=photons, seed=seed, time=time, threads=threads)
    link, sea, seed = inputs.link, inputs.sea, inputs.run.seed
    exact = wave_sum(sea) if reference else None
    crest = crest_of(link, sea, inputs.meshing.time)
    chains = CommonChains(link, photons, seed, kinds, receiver, crest, unresolved)
    cases = [
        partial(nested_mesh, link, sea, inputs.meshing.time, spacing, shift)
        for spacing, shift in product(values, placement_shifts(placements))
    ]
    found = over_cases(chains, cases, len(values), inputs.threads, progress)
    return ConvergenceStudy(
        parameter="spacing",
        values=np.array(values),
        normals=kinds,
        **found._asdict(),
        scatter=spread(found.samples.mean(axis=3)),
        reference=chains.exact(exact, inputs.meshing.time, values[-1]) if exact else None,
        tolerance=tolerance,
        provenance=inputs.provenance(
            spacings=list(values), normals=list(kinds), placements=placements,
            receiver=receiver, unresolved=unresolved,
        ),
    )  # fmt: skip
