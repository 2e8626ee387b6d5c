"""Gains over all surfaces of a study with one set of chains."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from meshtrace.bvh import EmbreeIntersector
from meshtrace.errors import Described, Refused, require_whole
from meshtrace.models import Floats
from meshtrace.results.gain import Fate
from meshtrace.stored import SHIFTS
from meshtrace.studies.campaign import Campaign
from meshtrace.studies.convergence.exact import Reference, over_waves
from meshtrace.studies.convergence.meshes import Costs, Normals, Unresolved, probes
from meshtrace.transport.analog import run_analog
from meshtrace.transport.forced import ForcedDetection, TypicalSea
from meshtrace.transport.forced_link import crossing_reach

if TYPE_CHECKING:
    from meshtrace.link import Link
    from meshtrace.mesh import TriangleMesh, WaveSum

Case = Callable[[], "TriangleMesh"]
"""Makes a mesh of a study."""

ANALOG_PHOTONS = 16_384  # of the share of total reflection


class Stacked(NamedTuple):
    """Gains over all meshes of a study, by kind of normals, step and repeat."""

    samples: Floats  # (kinds, steps, repeats, shifts)
    ballistic: Floats  # (kinds, steps, repeats)
    slope_variance: Floats  # (kinds, steps)
    total_reflection: Floats  # (kinds, steps)
    costs: Costs


class CommonChains:
    """Set of chains that all surfaces of a study share."""

    def __init__(
        self,
        link: Link,
        photons: int,
        seed: int,
        kinds: tuple[Normals, ...],
        receiver: int,
        crest: float,
        unresolved: Unresolved = "none",
    ) -> None:
        require_whole(receiver, 0, len(link.receivers) - 1, "receiver")
        physics = link.physics.model_copy(update={"unresolved": unresolved})
        one = {"receiver": link.receivers[receiver], "physics": physics}
        self._inputs = link, photons, seed, kinds, receiver, crest, unresolved
        self.link = link.model_copy(update=one)
        self.reach = crossing_reach(self.link)
        self.kinds, self.receiver = kinds, receiver
        self._key = photons, seed
        self._crest = crest
        self._forced = {kind: self._chains(kind) for kind in kinds}

    def __reduce__(self) -> Any:
        """Return the inputs: a worker makes the chains again."""
        return CommonChains, self._inputs

    def _chains(self, kind: Normals) -> ForcedDetection:
        """Return the chains over surfaces with one kind of normals."""
        sea = TypicalSea(self._crest)
        return ForcedDetection(
            self.link, *self._key, kind, sea=sea, search="thorough", scattered="chains"
        )

    def measure(self, case: Case, photons: int = 0) -> Floats:
        """Return the numbers of a mesh in a row for each kind of normals.

        Gain by shift, unscattered gain, mean square slope, share of total reflection, and the
        seconds that mesh, BVH and gain took; `photons` are for the share of total reflection.
        """
        began = clock.perf_counter()
        mesh = case()
        made = clock.perf_counter()
        intersector = EmbreeIntersector(mesh, 1)
        times = made - began, clock.perf_counter() - made
        rows = []
        for kind, forced in self._forced.items():
            start = clock.perf_counter()
            parts = forced.evaluate(mesh, intersector)
            seconds = *times, clock.perf_counter() - start
            slopes = _slope_variance(intersector, kind, self.reach)
            reflected = _total_reflection(self.link, intersector, kind, photons, self._key[1])
            rows.append([*parts.shifts[0], parts.ballistic[0], slopes, reflected, *seconds])
        return np.array(rows)

    def exact(self, sea: WaveSum, time: float, spacing: float) -> Reference:
        """Return the gain over the sum of waves, see `over_waves`."""
        return over_waves(self._chains("vertex"), sea, time, spacing)

    def over(
        self,
        campaign: Campaign,
        cases: Iterable[Case],
        steps: int,
        recorded: dict[str, Any],
        photons: int = ANALOG_PHOTONS,
    ) -> Stacked:
        """Return the gains over the meshes of a study: as many repeats of each step, in order.

        `photons` are those of the share of total reflection, 0 for none; `recorded` are the
        options that identify the meshes.

        Raises
        ------
        Refused
            If no light is received at a step: its gain has no relative error.
        """
        jobs = list(cases)
        chosen = {"kinds": list(self.kinds), "receiver": self.receiver}
        identity = {**recorded, **chosen, "physics": self.link.physics.model_dump(mode="json")}
        setup = partial(_measuring, self, jobs, photons)
        rows = campaign.over(setup, range(len(jobs)), "meshes", identity, "meshes")
        by_case = np.stack(list(rows), axis=1)  # (kinds, cases, numbers)
        found = by_case.reshape(len(by_case), steps, -1, by_case.shape[-1])
        samples, (ballistic, *means) = found[..., :SHIFTS], np.moveaxis(found[..., SHIFTS:], -1, 0)
        if not samples.mean(axis=(2, 3)).all():
            raise Refused("gain", Described("no light received"), "light at every step")
        slopes, reflected, *seconds = (column.mean(axis=2) for column in means)
        return Stacked(samples, ballistic, slopes, reflected, Costs(*seconds))


def _measuring(chains: CommonChains, jobs: list[Case], photons: int) -> Callable[[int], Floats]:
    """Return the function that measures a mesh by its number."""
    return lambda i: chains.measure(jobs[i], photons)


def _slope_variance(intersector: EmbreeIntersector, kind: Normals, reach: float) -> float:
    """Return the mean square slope of the normals that light meets, along plus across."""
    x, y = probes(reach)
    mesh = intersector.mesh
    top = np.full(len(x), mesh.bounds[1, 2] + 1.0)
    down = np.broadcast_to((0.0, 0.0, -1.0), (len(x), 3))
    hits = intersector.intersect(np.stack([x, y, top], axis=1), down)
    seen = hits.facet >= 0
    facet, u, v = hits.facet[seen], hits.u[seen, None], hits.v[seen, None]
    if kind == "facet":
        normal = mesh.face_normals[facet]
    else:
        a, b, c = (mesh.vertex_normals[mesh.faces[facet, i]] for i in range(3))
        normal = (1.0 - u - v) * a + u * b + v * c
    return float(np.mean((normal[:, 0] ** 2 + normal[:, 1] ** 2) / normal[:, 2] ** 2))


def _total_reflection(
    link: Link, intersector: EmbreeIntersector, kind: Normals, photons: int, seed: int
) -> float:
    """Return the share of the photons coming from below that are totally reflected."""
    if photons == 0:
        return math.nan
    once = {"reflected": "kill", "second_hit": "ignore", "absorption": "analog"}
    link = link.model_copy(update={"physics": link.physics.model_copy(update=once)})
    sums = run_analog(link, intersector, photons=photons, seed=seed, normals=kind)
    # a photon counts as landed if any of its light leaves: a reflected one left none
    reflected = int(sums.count[Fate.REFLECTED])
    met = reflected + int(sums.count[Fate.LANDED]) + int(sums.count[Fate.RECEIVED])
    return reflected / met if met else math.nan


def spread(gain: Floats) -> Floats:
    """Return the standard deviation over the repeats, the last axis; nan for a single one."""
    if gain.shape[-1] == 1:
        return np.full(gain.shape[:-1], math.nan)
    return gain.std(axis=-1, ddof=1)
