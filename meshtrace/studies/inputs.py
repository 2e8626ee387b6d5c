"""Inputs that all studies share: a link and a sea, or a Scenario, options of chains, meshes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.errors import Described, Refused
from meshtrace.kernels.random import realization_seed
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, RandomSea, SurfaceModel, TriangleMesh
from meshtrace.parallel import default_threads
from meshtrace.results.provenance import provenance
from meshtrace.scenario import MeshFile, Scenario
from meshtrace.transport.case import Case, resolve
from meshtrace.transport.forced_link import crossing_reach
from meshtrace.transport.meshing import (
    FADING_SPACING,
    GAIN_SPACING,
    mesh_for,
    mesh_lines,
    require_cover,
)
from meshtrace.transport.options import Forced, Meshing, Run
from meshtrace.uav.airframe import Flight
from meshtrace.uav.wind import Dryden

DEFAULT_CHAINS = 2048
"""Chains of a study over many surfaces, common to all of them."""

_WIDER = 1.2  # reach of meshes over that of a link: its neighbours lie within


class Inputs(NamedTuple):
    """Link, sea and options of a study over many surfaces."""

    link: Link
    surface: MeshSource
    run: Run
    meshing: Meshing
    scenario: Scenario | None

    @property
    def threads(self) -> int:
        """Number of threads, all cores by default."""
        return default_threads(self.run.threads)

    @property
    def sea(self) -> SurfaceModel:
        """The surface, of any spacing and time.

        Raises
        ------
        Refused
            If it is one of given meshes.
        """
        if not isinstance(self.surface, SurfaceModel):
            kind = Described(type(self.surface).__name__)
            raise Refused("surface", kind, "a sea (SurfaceModel), of any spacing")
        return self.surface

    def mesh(self, link: Link, surface: MeshSource, time: float) -> TriangleMesh:
        """Return the mesh of a surface at a time, as far as light can cross to a receiver."""
        meshing, reach = self.meshing.replace(time=time), crossing_reach(link)
        return mesh_for(link, surface, meshing, reach, FADING_SPACING)[0]

    def provenance(self, **more: Any) -> dict[str, Any]:
        """Return the provenance of the study."""
        run = {"estimator": "forced", "photons": self.run.photons, "seed": self.run.seed}
        run |= self.meshing.model_dump()
        return provenance(self.link, self.surface.to_config(), run | more)

    def wind_of(self, flight: Flight) -> Dryden:
        """Return the wind at an aircraft, by default that over the sea."""
        if flight.wind is not None:
            return flight.wind
        return wind_over(self.scenario or self.surface, self.link, "flight.wind")

    def of_flight(self, flight: Flight) -> dict[str, Any]:
        """Return the aircraft and its wind as plain data."""
        parts = {"uav": flight.uav, "wind": self.wind_of(flight)}
        return {name: part.model_dump(mode="json") for name, part in parts.items()}

    def realizations(
        self, n: int, name: str = "surface"
    ) -> tuple[NDArray[np.int64], Iterator[tuple[MeshSource, float]]]:
        """Return the seeds of n realizations of the sea, and each realization with its time.

        Raises
        ------
        Refused
            If the sea has no random phases; `name` is that of the argument.
        """
        sea, time = self.surface, self.meshing.time
        if not isinstance(sea, RandomSea):
            raise Refused(name, Described(type(sea).__name__), "a sea with random phases")
        seeds = np.array([realization_seed(self.run.seed, i) for i in range(n)], np.int64)
        return seeds, ((sea.with_seed(int(seed)), time) for seed in seeds)


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


def with_all_ends(link: Link, links: Iterable[Link]) -> Link:
    """Return a link with the sources and receivers of several links."""
    ends = {
        "transmitter": tuple(source for one in links for source in one.transmitters),
        "receiver": tuple(receiver for one in links for receiver in one.receivers),
    }
    return link.replace(**ends)


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
    case = resolve(link, surface, fading).with_options(**options)
    if not isinstance(case.run.estimator, Forced):
        raise Refused("run.estimator", "analog", allowed)
    return case


def resolve_chains(
    link: Link | Scenario,
    surface: MeshSource | None = None,
    fading: bool = False,
    **options: Any,
) -> Inputs:
    """Return the checked inputs of a study over many surfaces by forced detection.

    Parameters
    ----------
    link : Link or Scenario
        A link, or a scenario from which everything that is None follows.
    surface : MeshSource, optional
        The sea; by default that of the scenario, or that of the link's wind.
    fading : bool
        Whether the answer of the study is about fading: a sea whose band was left open then has
        all waves that make the light of the link fade (`fading.resolve_band`).
    **options
        Fields of `Run` and `Meshing`.

    Raises
    ------
    Refused
        If an option is out of range, or the surface is no sea.
    """
    given = {name: value for name, value in options.items() if value is not None}
    scenario = link if isinstance(link, Scenario) else None
    if scenario is None:
        given = {"photons": DEFAULT_CHAINS, **given}
    elif surface is None and isinstance(scenario.surface, MeshFile):
        raise Refused("sea.mesh", scenario.surface.file, "a sea model")
    case = forced_case(link, surface, given, "forced, over many seas", fading)
    if not isinstance(case.surface, MeshSource):
        raise Refused("surface", Described(type(case.surface).__name__), "a sea (MeshSource)")
    return Inputs(case.link, case.surface, case.run, case.meshing, scenario)
