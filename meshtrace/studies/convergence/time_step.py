"""Dependence of the mean gain over a moving sea on the time step."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from meshtrace.errors import Refused
from meshtrace.studies.convergence.checks import (
    Costs,
    Floats,
    Normals,
    Progress,
    descending,
    multiple_of,
    normal_kinds,
    positive,
)
from meshtrace.studies.convergence.measure import CommonChains, over_cases
from meshtrace.studies.convergence.meshes import crest_of
from meshtrace.studies.convergence.study import ConvergenceStudy
from meshtrace.studies.inputs import resolve_chains
from meshtrace.transport.meshing import mesh_for
from meshtrace.transport.options import Meshing

if TYPE_CHECKING:
    from meshtrace.link import Link
    from meshtrace.mesh import SurfaceModel, TriangleMesh
    from meshtrace.scenario import Scenario


def time_step_study(
    link: Link | Scenario,
    surface: SurfaceModel | None = None,
    steps: Sequence[float] = (),
    *,
    duration: float,
    start: float | None = None,
    normals: Sequence[Normals] = ("vertex",),
    photons: int = 2048,
    seed: int | None = None,
    spacing: float | None = None,
    tolerance: float = 1e-2,
    receiver: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> ConvergenceStudy:
    """Study the dependence of the mean gain over a moving sea on the time step.

    Parameters
    ----------
    link : Link or Scenario
        The link, or a scenario that also gives sea, seed, start, spacing and threads.
    surface : SurfaceModel, optional
        The sea.
    steps : sequence of float
        At least four time steps [s], all multiples of the shortest.
    duration : float
        Length of the series [s], a multiple of every step.
    start : float, optional
        Its beginning [s], by default 0 or the time of the scenario.
    spacing : float, optional
        Spacing of the mesh [m], by default that of `Link.footprint`.
    normals, photons, seed, tolerance, receiver, threads, progress
        As in `convergence_study`.

    Returns
    -------
    ConvergenceStudy
        `gain` is the mean over the series (trapezoidal rule), `scatter` the rms error of
        linear interpolation between its times.
    """
    values, kinds = descending("steps", steps), normal_kinds(normals)
    finest = 0.5 * values[-1]
    strides = [multiple_of("steps", value / finest) for value in values]
    n = multiple_of("duration", positive("duration", duration) / finest)
    for value, stride in zip(values, strides, strict=True):
        if n % stride:
            raise Refused("duration", duration, f"multiples of the step {value:g} s")
    inputs = resolve_chains(
        link, surface, photons=photons, seed=seed, time=start, spacing=spacing, threads=threads
    )
    link, sea, seed = inputs.link, inputs.sea, inputs.run.seed
    begin, step = inputs.meshing.time, inputs.meshing.spacing
    chains = CommonChains(link, photons, seed, kinds, receiver, crest_of(link, sea, begin))

    def mesh(i: int) -> TriangleMesh:
        return mesh_for(
            chains.link, sea, Meshing(time=begin + i * finest, spacing=step), chains.reach
        )[0]

    cases = [partial(mesh, i) for i in range(n + 1)]
    found = over_cases(chains, cases, 1, inputs.threads, progress, photons=0)
    frames, ballistic = found.samples, found.ballistic
    by_shift = frames[:, 0]  # (kinds, frames, shifts)
    each = by_shift.mean(axis=2)
    shape = len(kinds), len(values)
    return ConvergenceStudy(
        parameter="time_step",
        values=np.array(values),
        normals=kinds,
        samples=np.stack([_time_mean(by_shift, s) for s in strides], axis=1)[:, :, None],
        ballistic=np.stack([_time_mean(ballistic[:, 0], s) for s in strides], axis=1)[:, :, None],
        scatter=np.stack([_interpolation_error(each, s) for s in strides], axis=1),
        slope_variance=np.broadcast_to(found.slope_variance, shape),
        total_reflection=np.broadcast_to(found.total_reflection, shape),
        costs=Costs(*(np.broadcast_to(seconds, shape) for seconds in found.costs)),
        tolerance=positive("tolerance", tolerance),
        provenance=inputs.provenance(
            start=begin, duration=duration, steps=list(values), normals=list(kinds),
            receiver=receiver,
        ),
    )  # fmt: skip


def _time_mean(frames: Floats, stride: int) -> Floats:
    """Return the mean over the times, axis 1, by the trapezoidal rule on every stride-th."""
    return np.trapezoid(frames[:, ::stride], dx=stride, axis=1) / (frames.shape[1] - 1)


def _interpolation_error(frames: Floats, stride: int) -> Floats:
    """Return the rms error of linear interpolation between every stride-th of (kinds, times)."""
    times = np.arange(frames.shape[1])
    guess = np.stack([np.interp(times, times[::stride], row[::stride]) for row in frames])
    between = times % stride != 0
    return np.sqrt(np.mean((frames - guess)[:, between] ** 2, axis=1))
