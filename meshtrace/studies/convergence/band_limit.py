"""How the mean gain over a random sea depends on its shortest waves."""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from meshtrace.results.provenance import provenance
from meshtrace.studies.convergence.checks import (
    Normals,
    Progress,
    Unresolved,
    falling,
    kinds_of,
    positive,
    unresolved_in,
)
from meshtrace.studies.convergence.measure import (
    ANALOG_PHOTONS,
    CommonChains,
    Measured,
    mapped,
    spread,
    stacked,
)
from meshtrace.studies.convergence.meshes import crest_of, nested_mesh
from meshtrace.studies.convergence.study import ConvergenceStudy

if TYPE_CHECKING:
    from meshtrace.link import Link
    from meshtrace.mesh import SurfaceModel

REALIZATIONS = 16
"""Seas of each band."""


def band_limit_study(
    link: Link,
    sea: SurfaceModel,
    omega_max: Sequence[float],
    *,
    realizations: int = REALIZATIONS,
    normals: Sequence[Normals] = ("vertex",),
    photons: int = 2048,
    seed: int = 1,
    time: float = 0.0,
    spacing: float = 0.1,
    tolerance: float = 1e-2,
    receiver: int = 0,
    unresolved: Unresolved = "none",
    threads: int | None = None,
    progress: Progress | None = None,
) -> ConvergenceStudy:
    """Return how the mean gain over a random sea depends on its shortest waves.

    Parameters
    ----------
    link : Link
        The link.
    sea : SurfaceModel
        A sea with `omega_max` and random phases.
    omega_max : sequence of float
        At least four band limits [rad s-1].
    realizations : int
        Realizations of the phases, common to all limits: a wider band adds waves to those of a
        narrower one.
    spacing : float
        Spacing of the mesh [m]; a few to the shortest wave.
    normals, photons, seed, time, tolerance, receiver, unresolved, threads, progress
        As in `convergence_study`.

    Returns
    -------
    ConvergenceStudy
        Its step is 1 / omega_max.

    Notes
    -----
    The mean square slope of a spectrum with an omega^-5 tail grows as log omega_max: without
    random slopes for the waves left out (`unresolved="tilt"`) there is nothing that this study
    could converge to.
    """
    values = falling("omega_max", omega_max)[::-1]
    kinds = kinds_of(normals)
    if realizations < 1:
        raise ValueError(f"realizations: {realizations!r}, allowed realizations >= 1")
    copy, fields = getattr(sea, "model_copy", None), getattr(type(sea), "model_fields", {})
    if copy is None or not {"omega_max", "seed"} <= set(fields):
        raise ValueError(f"sea: {type(sea).__name__}, allowed a random sea with omega_max")
    crest = crest_of(link, copy(update={"omega_max": values[-1]}), time)
    chains = CommonChains(link, photons, seed, kinds, receiver, crest, unresolved_in(unresolved))
    nothing = np.zeros(2)

    def measure(job: tuple[float, int]) -> Measured:
        limit, i = job
        began = clock.perf_counter()
        phases = int(np.random.SeedSequence([seed, i]).generate_state(1)[0])
        wide = copy(update={"omega_max": limit, "seed": phases})
        mesh = nested_mesh(link, wide, time, positive("spacing", spacing), nothing)
        return chains.measure(mesh, clock.perf_counter() - began, photons=ANALOG_PHOTONS)

    jobs = list(product(values, range(realizations)))
    rows = mapped(measure, jobs, threads, progress)
    samples, ballistic, slopes, reflected, costs = stacked(rows, len(values))
    gain = samples.mean(axis=3)
    run = {
        "estimator": "forced", "photons": photons, "seed": seed, "time": time,
        "omega_max": list(values), "realizations": realizations, "spacing": spacing,
        "normals": list(kinds), "receiver": receiver, "unresolved": unresolved,
    }  # fmt: skip
    return ConvergenceStudy(
        parameter="omega_max",
        values=np.array(values),
        normals=kinds,
        samples=samples,
        ballistic=ballistic,
        scatter=spread(gain - gain[:, -1:]),
        slope_variance=slopes.mean(axis=2),
        total_reflection=reflected.mean(axis=2),
        costs=costs,
        tolerance=positive("tolerance", tolerance),
        provenance=provenance(link, sea.to_config(), run),
    )
