"""Inputs that all studies share: a link and a sea, or a Scenario, and the options of the chains."""

from __future__ import annotations

from typing import Any, NamedTuple

from meshtrace.errors import Described, Refused
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, SurfaceModel, TriangleMesh
from meshtrace.parallel import default_threads
from meshtrace.results.provenance import provenance
from meshtrace.scenario import MeshFile, Scenario
from meshtrace.transport.case import resolve
from meshtrace.transport.forced_link import crossing_reach
from meshtrace.transport.meshing import FADING_SPACING, mesh_for
from meshtrace.transport.options import Forced, Meshing, Run
from meshtrace.uav.airframe import Flight
from meshtrace.uav.wind import Dryden

DEFAULT_CHAINS = 2048
"""Chains of a study over many surfaces, common to all of them."""


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
        speed = getattr(self.scenario or self.surface, "wind_speed", None)
        if speed is None:
            raise Refused("flight.wind", None, "a wind, over a sea without wind speed")
        return Dryden(wind_speed=speed, height=self.link.air_end[1].height)


def resolve_chains(
    link: Link | Scenario, surface: MeshSource | None = None, **options: Any
) -> Inputs:
    """Return the checked inputs of a study over many surfaces by forced detection.

    Parameters
    ----------
    link : Link or Scenario
        A link, or a scenario from which everything that is None follows.
    surface : MeshSource, optional
        The sea; by default that of the scenario, or a JONSWAP sea of the link's wind.
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
    case = resolve(link, surface).with_options(**given)
    if not isinstance(case.run.estimator, Forced):
        raise Refused("run.estimator", "analog", "forced, over many seas")
    if not isinstance(case.surface, MeshSource):
        raise Refused("surface", Described(type(case.surface).__name__), "a sea (MeshSource)")
    return Inputs(case.link, case.surface, case.run, case.meshing, scenario)
