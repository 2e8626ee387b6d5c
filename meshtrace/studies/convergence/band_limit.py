"""Dependence of the mean gain over a random sea on its shortest waves."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from meshtrace.errors import Described, Refused, require_whole
from meshtrace.kernels.random import realization_seed
from meshtrace.studies.convergence.checks import (
    Normals,
    Progress,
    Unresolved,
    descending,
    known_unresolved,
    normal_kinds,
    positive,
)
from meshtrace.studies.convergence.measure import CommonChains, over_cases, spread
from meshtrace.studies.convergence.meshes import crest_of, nested_mesh
from meshtrace.studies.convergence.study import ConvergenceStudy
from meshtrace.studies.inputs import resolve_chains

if TYPE_CHECKING:
    from meshtrace.link import Link
    from meshtrace.mesh import SurfaceModel, TriangleMesh
    from meshtrace.scenario import Scenario

REALIZATIONS = 16
"""Seas of each band."""


def band_limit_study(
    link: Link | Scenario,
    surface: SurfaceModel | None = None,
    omega_max: Sequence[float] = (),
    *,
    realizations: int = REALIZATIONS,
    normals: Sequence[Normals] = ("vertex",),
    photons: int = 2048,
    seed: int | None = None,
    time: float | None = None,
    spacing: float | None = None,
    tolerance: float = 1e-2,
    receiver: int = 0,
    unresolved: Unresolved = "none",
    threads: int | None = None,
    progress: Progress | None = None,
) -> ConvergenceStudy:
    """Study the dependence of the mean gain over a random sea on its shortest waves.

    Parameters
    ----------
    link : Link or Scenario
        The link, or a scenario that also gives sea, seed, time, spacing and threads.
    surface : SurfaceModel, optional
        A sea with `omega_max` and random phases.
    omega_max : sequence of float
        At least four band limits [rad s-1].
    realizations : int
        Realizations of the phases, common to all limits: a wider band adds waves to those of a
        narrower one.
    spacing : float, optional
        Spacing of the mesh [m], 0.1 by default; a few to the shortest wave.
    normals, photons, seed, time, tolerance, receiver, unresolved, threads, progress
        As in `convergence_study`.

    Returns
    -------
    ConvergenceStudy
        Its step is 1 / omega_max.

    Notes
    -----
    The mean square slope of a spectrum with an omega^-5 tail grows as log omega_max: without
    random slopes for the waves left out (`unresolved="tilt"`) this study has no limit.
    """
    values, kinds = descending("omega_max", omega_max)[::-1], normal_kinds(normals)
    require_whole(realizations, 1, 100_000, "realizations")
    inputs = resolve_chains(
        link, surface, photons=photons, seed=seed, time=time, spacing=spacing, threads=threads
    )
    link, sea, seed = inputs.link, inputs.surface, inputs.run.seed
    copy, fields = getattr(sea, "model_copy", None), getattr(type(sea), "model_fields", {})
    if copy is None or not {"omega_max", "seed"} <= set(fields):
        raise Refused("surface", Described(type(sea).__name__), "a random sea with omega_max")
    at, step = inputs.meshing.time, positive("spacing", inputs.meshing.spacing or 0.1)
    crest = crest_of(link, copy(update={"omega_max": values[-1]}), at)
    word = known_unresolved(unresolved)
    chains = CommonChains(link, photons, seed, kinds, receiver, crest, word)
    seeds = [realization_seed(seed, i) for i in range(realizations)]

    def mesh(limit: float, phases: int) -> TriangleMesh:
        wide = copy(update={"omega_max": limit, "seed": phases})
        return nested_mesh(link, wide, at, step, np.zeros(2))

    cases = [partial(mesh, limit, phases) for limit, phases in product(values, seeds)]
    found = over_cases(chains, cases, len(values), inputs.threads, progress)
    gain = found.samples.mean(axis=3)
    return ConvergenceStudy(
        parameter="omega_max",
        values=np.array(values),
        normals=kinds,
        **found._asdict(),
        scatter=spread(gain - gain[:, -1:]),
        tolerance=positive("tolerance", tolerance),
        provenance=inputs.provenance(
            omega_max=list(values), realizations=realizations, spacing=step,
            normals=list(kinds), receiver=receiver, unresolved=unresolved,
        ),
    )  # fmt: skip
