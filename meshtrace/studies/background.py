"""Background light over many seas and over time."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from meshtrace.daylight.light import Daylight
from meshtrace.errors import Refused, require_finite, require_kind, require_whole
from meshtrace.kernels.random import realization_seed
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, RandomSea
from meshtrace.results.background import Background, BackgroundSeries
from meshtrace.scenario import Scenario
from meshtrace.stored import SHIFTS
from meshtrace.studies.inputs import Inputs, resolve_chains
from meshtrace.transport.backward import background_over
from meshtrace.transport.meshing import mesh_for

_MOST_SEAS = 16  # of the mean background of an ensemble
_RAYS = 2048  # over each of them


def background_series(
    link: Link | Scenario,
    surface: MeshSource | None = None,
    day: Daylight | None = None,
    times: ArrayLike | None = None,
    *,
    photons: int = 1024,
    seed: int | None = None,
    spacing: float | None = None,
    extent: float | None = None,
    threads: int | None = None,
) -> BackgroundSeries:
    """Return the background of a receiver over a moving sea: glint flickers.

    Parameters
    ----------
    link : Link or Scenario
        The link, with one receiver.
    surface : MeshSource, optional
        The sea, as in `time_series`.
    day : Daylight, optional
        Light above the sea; by default that of a scenario.
    times : array_like, shape (n,)
        Times [s].
    photons : int
        Rays from the receiver, the same at all times, 32 ... 10 000 000.
    seed, spacing, extent, threads
        As in `time_series`.

    Returns
    -------
    BackgroundSeries

    Raises
    ------
    Refused
        If an option is out of range.

    Notes
    -----
    Slopes that the mesh leaves out count by their density: glint keeps its mean but is smoother
    than in nature. A fine mesh over a wide band (`omega_max`) resolves its flicker.
    """
    require_whole(photons, SHIFTS, 10_000_000, "photons")
    given = {"seed": seed, "spacing": spacing, "extent": extent, "threads": threads}
    inputs = resolve_chains(link, surface, **given)
    day = getattr(inputs.scenario, "daylight", None) if day is None else day
    day = checked_daylight(day, inputs.link)
    if day is None:
        raise Refused("day", None, "a Daylight")
    at = require_finite(() if times is None else times, "times", "at least one time [s]")
    origin = {**inputs.provenance(), "daylight": day.model_dump(mode="json")}
    found = [_over(inputs, inputs.link, inputs.surface, day, photons, float(t)) for t in at]
    return BackgroundSeries(
        np.asarray(at, float),
        np.array([f.part_radiance for f in found]),
        np.array([f.part_radiance_stderr for f in found]),
        origin,
    )


def checked_daylight(day: Daylight | None, link: Link) -> Daylight | None:
    """Return daylight at the wavelength of a link, or None; refuse any other."""
    require_kind(day, Daylight | None, "daylight")
    wavelength = link.transmitters[0].wavelength_nm
    if day is not None and day.wavelength_nm != wavelength:
        allowed = f"{wavelength:g}, that of the transmitter"
        raise Refused("daylight.wavelength_nm", day.wavelength_nm, allowed)
    return day


def background_over_seas(inputs: Inputs, link: Link, day: Daylight, seas: int) -> Background:
    """Return the mean background over the first seas of an ensemble, up to 16.

    Its standard errors hold the spread of the seas, and that of the rays they have in common.
    """
    sea, time = inputs.surface, inputs.meshing.time
    many: list[MeshSource] = [sea]
    if isinstance(sea, RandomSea):
        seeds = [realization_seed(inputs.run.seed, i) for i in range(min(seas, _MOST_SEAS))]
        many = [sea.with_seed(seed) for seed in seeds]
    found = [_over(inputs, link, one, day, _RAYS, time) for one in many]
    if len(found) == 1:
        return found[0]
    parts = np.array([f.part_radiance for f in found])
    rays = np.mean([f.part_radiance_stderr for f in found], axis=0)
    total, n = parts.sum(axis=1), math.sqrt(len(found))
    return replace(
        found[0],
        part_radiance=parts.mean(axis=0),
        part_radiance_stderr=np.hypot(parts.std(axis=0, ddof=1) / n, rays),
        radiance=float(total.mean()),
        radiance_stderr=math.hypot(
            float(total.std(ddof=1)) / n, float(np.mean([f.radiance_stderr for f in found]))
        ),
    )


def _over(
    inputs: Inputs, link: Link, sea: MeshSource, day: Daylight, photons: int, time: float
) -> Background:
    """Return the background over one surface at a time."""
    meshing = inputs.meshing.replace(time=time)
    mesh, _ = mesh_for(link, sea, meshing)
    origin: dict[str, Any] = {"daylight": day.model_dump(mode="json")}
    rest = day, photons, inputs.run.seed, meshing.normals, inputs.threads, origin
    return background_over(link, mesh, *rest)
