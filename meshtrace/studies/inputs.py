"""Inputs that all studies share: a link and a sea, or a Scenario, and the options of the chains."""

from __future__ import annotations

from typing import Any, NamedTuple

from meshtrace.errors import Described, Refused, require_whole, require_word
from meshtrace.link import Link
from meshtrace.mesh import SurfaceModel, TriangleMesh
from meshtrace.parallel import default_threads
from meshtrace.results.provenance import provenance
from meshtrace.scenario import DEFAULT_WIND_SPEED, MeshFile, Scenario
from meshtrace.scenario.seas import require_modest
from meshtrace.transport.forced_link import crossing_reach
from meshtrace.transport.meshing import mesh_for
from meshtrace.transport.options import Forced, Meshing
from meshtrace.uav.airframe import Flight
from meshtrace.uav.wind import Dryden

DEFAULT_CHAINS = 2048
"""Chains of a study over many surfaces, common to all of them."""


class Inputs(NamedTuple):
    """Link, sea and options of a study over many surfaces."""

    link: Link
    surface: SurfaceModel
    run: dict[str, Any]  # options of the chains and of the mesh
    threads: int
    scenario: Scenario | None

    def mesh(self, link: Link, surface: SurfaceModel, time: float) -> TriangleMesh:
        """Return the mesh of a surface at a time, as far as light can cross to a receiver."""
        meshing = Meshing(time=time, extent=self.run["extent"], spacing=self.run["spacing"])
        return mesh_for(link, surface, meshing, crossing_reach(link))[0]

    def provenance(self, **run: Any) -> dict[str, Any]:
        """Return the provenance of the study."""
        return provenance(
            self.link, self.surface.to_config(), {"estimator": "forced", **self.run, **run}
        )

    def wind_of(self, flight: Flight) -> Dryden:
        """Return the wind at an aircraft, by default that over the sea."""
        if flight.wind is not None:
            return flight.wind
        speed = getattr(self.scenario or self.surface, "wind_speed", None)
        if speed is None:
            raise Refused("flight.wind", None, "a wind, over a sea without wind speed")
        return Dryden(wind_speed=speed, height=self.link.only_receiver.height)


def resolve(
    link: Link | Scenario, surface: SurfaceModel | None = None, **options: Any
) -> tuple[Link, Any, Scenario | None, dict[str, Any]]:
    """Return link, surface, scenario and options; those that are None follow the scenario."""
    given = {name: value for name, value in options.items() if value is not None}
    if not isinstance(link, Scenario):
        if surface is None:
            surface = default_sea(link.wind_speed or DEFAULT_WIND_SPEED)
        return link, surface, None, given
    run = link.run.model_dump(include={"photons", "seed", "threads"}, exclude_none=True)
    sampling = link.meshing.model_dump(exclude_none=True)
    known = {name: value for name, value in {**run, **sampling}.items() if name in options}
    return link.link, link.surface if surface is None else surface, link, {**known, **given}


def resolve_chains(
    link: Link | Scenario, surface: SurfaceModel | None = None, **options: Any
) -> Inputs:
    """Return the checked inputs of a study over many surfaces by forced detection.

    Parameters
    ----------
    link : Link or Scenario
        A link, or a scenario from which everything that is None follows.
    surface : SurfaceModel, optional
        The sea; by default that of the scenario, or a JONSWAP sea of the link's wind.
    **options
        photons, seed, normals, extent, spacing, threads; time of an ensemble.

    Raises
    ------
    Refused
        If an option is out of range, or the surface is no sea.
    """
    link, sea, scenario, given = resolve(link, surface, **options)
    if scenario is not None and not isinstance(scenario.run.estimator, Forced):
        raise Refused("run.estimator", scenario.run.estimator.kind, "forced, over many seas")
    if isinstance(sea, MeshFile) or not isinstance(sea, SurfaceModel):
        raise Refused("surface", Described(type(sea).__name__), "a sea (SurfaceModel)")
    defaults = {"photons": DEFAULT_CHAINS, "seed": 1, "normals": "vertex", "time": 0.0}
    run = {**{name: defaults.get(name) for name in options}, **given}
    threads = run.pop("threads", None)
    require_whole(run["photons"], 1, 2**53, "photons")
    require_whole(run["seed"], 0, 2**64 - 1, "seed")
    require_word(run["normals"], ("vertex", "facet"), "normals")
    if scenario is not None:
        require_modest(sea, link.footprint(), scenario.meshing)
    return Inputs(link, sea, run, default_threads(threads), scenario)


def default_sea(wind_speed: float) -> SurfaceModel:
    """Return the JONSWAP sea of a wind [m s-1], flat in a calm."""
    return Scenario.from_config({"wind_speed": wind_speed}).surface
