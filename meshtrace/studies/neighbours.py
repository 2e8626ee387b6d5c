"""Links near one link over common seas: common chains, meshes on common grid lines, jackknives."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.common import FrozenForced
from meshtrace.engine.forced import MANY_SEAS, TypicalSea
from meshtrace.engine.parts import Light
from meshtrace.engine.setup.ends import crossing_reach
from meshtrace.engine.setup.meshing import FADING_SPACING, GAIN_SPACING, mesh_lines, require_cover
from meshtrace.kernels.random import realization_seed
from meshtrace.link import Link
from meshtrace.mesh import SurfaceModel, TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import ordered_map
from meshtrace.stored import SHIFTS
from meshtrace.studies.campaign import Campaign
from meshtrace.studies.cluster import Restored

Result = TypeVar("Result")

_WIDER = 1.2  # reach of meshes over that of a link: its neighbours lie within
_FEW, _MANY = 8, 32  # surfaces of which facets and Embree scenes are kept, some 50 MiB each


@dataclass(eq=False)
class Neighbours(Restored):
    """Gains and light of links near one link over the same surfaces.

    Parameters
    ----------
    campaign : Campaign
        The base link, its surface and options; a surface that is a mesh is taken as it is.
        Progress is left to the study.
    seas : int
        Surfaces.
    phases : bool
        Whether each surface has phases of its own.
    fading : bool
        Whether meshes and chains are those of an ensemble.
    kept : int
        Meshes of the first surfaces that stay in memory.
    around : Link, optional
        The link that all meshes cover, by default the base link.
    """

    campaign: Campaign
    seas: int = 1
    phases: bool = False
    fading: bool = False
    kept: int = 1
    around: Link | None = None

    def __post_init__(self) -> None:
        self.campaign = campaign = self.campaign._replace(progress=None)
        given = self.seas, self.phases, self.fading, self.kept, self.around
        self.inputs = (campaign.alone, *given)
        self._around = self.around or campaign.link
        self._lines: dict[str, Any] = {}
        if isinstance(campaign.surface, SurfaceModel):
            inputs = self._around, campaign.surface, campaign.meshing
            spacing = FADING_SPACING if self.fading else GAIN_SPACING
            self._lines = mesh_lines(*inputs, _WIDER * crossing_reach(self._around), spacing)
        first = range(min(self.seas, self.kept))
        self._meshes = [self._meshed(campaign.surface, i) for i in first]

    @cached_property
    def frozen(self) -> FrozenForced:
        """Chains of the base link."""
        campaign = self.campaign
        return FrozenForced(
            campaign.link,
            campaign.run.photons,
            campaign.run.seed,
            TypicalSea.of(self._meshes, MANY_SEAS if self.fading else 1.0),
            campaign.meshing.normals,
            # of more, in turn, none of the last is met again
            kept=max(self.kept, _FEW) if self.kept <= _MANY else _FEW,
        )

    def _meshed(self, surface: Any, i: int) -> TriangleMesh:
        """Return the mesh of a surface with the phases of realization i."""
        campaign, mesh = self.campaign, surface
        if not isinstance(mesh, TriangleMesh):
            if self.phases:
                mesh = mesh.with_seed(realization_seed(campaign.run.seed, i))
            mesh = mesh.mesh(campaign.meshing.time, **self._lines)
        require_cover(self._around, mesh)
        return mesh

    def mesh(self, i: int, surface: Any = None) -> TriangleMesh:
        """Return realization i of the base surface, or of a neighbour of it."""
        if surface is not None:
            return self._meshed(surface, i)
        return self._meshes[i] if i < len(self._meshes) else self._meshed(self.campaign.surface, i)

    def gains(self, link: Link, i: int, surface: Any = None) -> Floats:
        """Return the gain of each receiver over realization i, shape (receivers, shifts)."""
        return self.frozen.gains(link, self.mesh(i, surface))

    def unscattered(
        self, link: Link, i: int, facets: Sequence[NDArray[np.int64]] | None = None
    ) -> Floats:
        """Return the unscattered gain of each receiver over realization i, without noise.

        Through all facets, or through some for each receiver.
        """
        return self.frozen.unscattered(link, self.mesh(i), facets)

    def light(self, link: Link, i: int, surface: Any = None) -> list[Light]:
        """Return the light that arrives at each receiver over realization i."""
        return self.frozen.light(link, self.mesh(i, surface))

    def map(self, evaluate: Callable[[int], Result], most: int) -> list[Result]:
        """Return the results of the first seas in order, computed by threads of this process."""
        n = min(most, self.seas)
        return list(ordered_map(evaluate, range(n), self.campaign.threads))

    def over(
        self, evaluate: Callable[[int], Floats], steps: int, name: str, **identity: Any
    ) -> Floats:
        """Return the numbers of steps of a loop, stacked; see `Campaign.over`."""
        known = {"seas": self.seas, **identity}
        found = self.campaign.over(lambda: evaluate, range(steps), name, known)
        return np.array(list(found))


def has_moments(link: Link) -> bool:
    """Return whether a and b enter the weights alone, as powers of b and exp(-(a + b) L)."""
    plain = link.bubbles is None and link.water.layers is None
    return plain and link.physics.absorption != "paper"


def moments(link: Link, light: Light) -> dict[str, Floats]:
    """Return dh / d ln a and dh / d ln b by shift.

    dw / da = -L w, dw / db = (K / b - L) w
    """
    way = light.by_shift(light.water)
    scatterings = light.by_shift(light.order.astype(float))
    return {"water.a": -link.water.a * way, "water.b": scatterings - link.water.b * way}


def without_each(gains: Floats) -> Iterator[Floats]:
    """Yield the gains (seas, shifts): all, without each shift, and without each of several seas."""
    yield gains
    for i in range(SHIFTS):
        yield np.delete(gains, i, axis=1)
    if len(gains) > 1:
        for i in range(len(gains)):
            yield np.delete(gains, i, axis=0)


def error_of(values: Floats) -> float:
    """Return the standard error of the first of values (1 + groups,), see `without_each`."""
    return math.sqrt(covariance_of(values[None])[0, 0])


def covariance_of(values: Floats) -> Floats:
    """Return the covariance (n, n) of the first of values (n, 1 + groups), see `without_each`.

    var = (m - 1) / m sum_i (v_i - mean v)^2 over the m shifts, and the same over the seas
    """
    total = np.zeros((len(values), len(values)))
    for groups in (values[:, 1 : 1 + SHIFTS], values[:, 1 + SHIFTS :]):
        m = groups.shape[1]
        if m > 1:
            off = groups - groups.mean(axis=1, keepdims=True)
            total += (m - 1) / m * off @ off.T
    return total
