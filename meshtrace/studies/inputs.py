"""Inputs of studies of neighbouring links: a link and a sea, or a Scenario, and their meshes."""

from __future__ import annotations

from typing import Any

from meshtrace.errors import Refused
from meshtrace.kernels.random import realization_seed
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, SurfaceModel, TriangleMesh
from meshtrace.scenario import Scenario
from meshtrace.transport.case import Case, resolve
from meshtrace.transport.forced_link import crossing_reach
from meshtrace.transport.meshing import (
    GAIN_SPACING,
    mesh_lines,
    require_cover,
)
from meshtrace.transport.options import Forced, Meshing
from meshtrace.uav.wind import Dryden

_WIDER = 1.2  # reach of meshes over that of a link: its neighbours lie within


class CommonLines:
    """Meshes of a surface and of its neighbours on common grid lines.

    Parameters
    ----------
    link : Link
        The link that all meshes cover.
    surface : MeshSource or TriangleMesh
        Its surface; a mesh is taken as it is.
    meshing : Meshing
        Time and resolution.
    seed : int, optional
        Seed of the realizations; None takes a surface with its own phases.
    per_wave : float
        Spacing over 1 / k of the shortest wave, see `mesh_for`.
    """

    def __init__(
        self,
        link: Link,
        surface: Any,
        meshing: Meshing,
        seed: int | None = None,
        per_wave: float = GAIN_SPACING,
    ) -> None:
        self._link, self._surface, self._time, self._seed = link, surface, meshing.time, seed
        self._lines: dict[str, Any] = {}
        if isinstance(surface, SurfaceModel):
            reach = _WIDER * crossing_reach(link)
            self._lines = mesh_lines(link, surface, meshing, reach, per_wave)

    def mesh(self, i: int = 0, surface: Any = None) -> TriangleMesh:
        """Return realization i of the surface, or of a neighbour of it."""
        mesh = self._surface if surface is None else surface
        if not isinstance(mesh, TriangleMesh):
            if self._seed is not None:
                mesh = mesh.with_seed(realization_seed(self._seed, i))
            mesh = mesh.mesh(self._time, **self._lines)
        require_cover(self._link, mesh)
        return mesh


def wind_over(sea: Any, link: Link, name: str) -> Dryden:
    """Return the wind over a sea at the end in the air; `name` is that of the argument."""
    speed = getattr(getattr(sea, "spectrum", sea), "wind_speed", None)
    if speed is None:
        raise Refused(name, None, "a wind, over a sea without wind speed")
    return Dryden(wind_speed=speed, height=link.air_end[1].height)


def forced_case(
    link: Link | Scenario,
    surface: MeshSource | TriangleMesh | None,
    options: dict[str, Any],
    allowed: str = "forced",
    fading: bool = False,
) -> Case:
    """Return the case of a link or a scenario with options; refuse analog photons.

    With `fading` a sea whose band was left open has all waves that make light fade.
    """
    case = resolve(link, surface, fading, **options)
    if not isinstance(case.run.estimator, Forced):
        raise Refused("run.estimator", "analog", allowed)
    return case
