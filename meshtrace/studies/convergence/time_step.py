"""How the mean gain over a moving sea depends on the time step."""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from meshtrace.results.provenance import provenance
from meshtrace.studies.convergence.checks import (
    Floats,
    Normals,
    Progress,
    falling,
    kinds_of,
    positive,
    whole,
)
from meshtrace.studies.convergence.measure import CommonChains, Measured, mapped, stacked
from meshtrace.studies.convergence.meshes import crest_of
from meshtrace.studies.convergence.study import ConvergenceStudy, Costs
from meshtrace.transport.meshing import mesh_for
from meshtrace.transport.options import Meshing

if TYPE_CHECKING:
    from meshtrace.link import Link
    from meshtrace.mesh import SurfaceModel


def time_step_study(
    link: Link,
    sea: SurfaceModel,
    steps: Sequence[float],
    *,
    duration: float,
    start: float = 0.0,
    normals: Sequence[Normals] = ("vertex",),
    photons: int = 2048,
    seed: int = 1,
    spacing: float | None = None,
    tolerance: float = 1e-2,
    receiver: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> ConvergenceStudy:
    """Return how the mean gain over a moving sea depends on the time step.

    Parameters
    ----------
    link : Link
        The link.
    sea : SurfaceModel
        The sea.
    steps : sequence of float
        At least four time steps [s], all multiples of the shortest.
    duration : float
        Length of the series [s], a multiple of every step.
    start : float
        Its beginning [s].
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
    values, kinds = falling("steps", steps), kinds_of(normals)
    finest = 0.5 * values[-1]
    strides = [whole("steps", value / finest) for value in values]
    n = whole("duration", positive("duration", duration) / finest)
    for value, stride in zip(values, strides, strict=True):
        if n % stride:
            raise ValueError(f"duration: {duration!r}, allowed multiples of the step {value:g} s")
    chains = CommonChains(link, photons, seed, kinds, receiver, crest_of(link, sea, start))

    def measure(i: int) -> Measured:
        began = clock.perf_counter()
        mesh = mesh_for(
            chains.link, sea, Meshing(time=start + i * finest, spacing=spacing), chains.reach
        )[0]
        return chains.measure(mesh, clock.perf_counter() - began)

    frames, ballistic, slopes, reflected, costs = stacked(
        mapped(measure, range(n + 1), threads, progress), 1
    )
    by_shift = frames[:, 0]  # (kinds, frames, shifts)
    each = by_shift.mean(axis=2)
    shape = len(kinds), len(values)
    run = {
        "estimator": "forced", "photons": photons, "seed": seed, "start": start,
        "duration": duration, "steps": list(values), "spacing": spacing, "normals": list(kinds),
        "receiver": receiver,
    }  # fmt: skip
    return ConvergenceStudy(
        parameter="time_step",
        values=np.array(values),
        normals=kinds,
        samples=np.stack([_time_mean(by_shift, s) for s in strides], axis=1)[:, :, None],
        ballistic=np.stack([_time_mean(ballistic[:, 0], s) for s in strides], axis=1)[:, :, None],
        scatter=np.stack([_interpolation_error(each, s) for s in strides], axis=1),
        slope_variance=np.broadcast_to(slopes.mean(axis=2), shape),
        total_reflection=np.broadcast_to(reflected.mean(axis=2), shape),
        costs=Costs(*(np.broadcast_to(seconds, shape) for seconds in costs)),
        tolerance=positive("tolerance", tolerance),
        provenance=provenance(link, sea.to_config(), run),
    )


def _time_mean(frames: Floats, stride: int) -> Floats:
    """Return the mean over the times, axis 1, by the trapezoidal rule on every stride-th."""
    return np.trapezoid(frames[:, ::stride], dx=stride, axis=1) / (frames.shape[1] - 1)


def _interpolation_error(frames: Floats, stride: int) -> Floats:
    """Return the rms error of linear interpolation between every stride-th of (kinds, times)."""
    times = np.arange(frames.shape[1])
    guess = np.stack([np.interp(times, times[::stride], row[::stride]) for row in frames])
    between = times % stride != 0
    return np.sqrt(np.mean((frames - guess)[:, between] ** 2, axis=1))
