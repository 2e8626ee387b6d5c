"""Links over many surfaces: one loop for all studies by forced detection, one array of gains."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from meshtrace.errors import Described, Refused
from meshtrace.kernels.random import realization_seed
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, RandomSea, SurfaceModel, TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import default_threads, ordered_map, paced, trim_memory
from meshtrace.results.provenance import provenance
from meshtrace.scenario import MeshFile, Scenario
from meshtrace.stored import SHIFTS
from meshtrace.studies.inputs import forced_case, wind_over
from meshtrace.transport.forced import MANY_SEAS, ForcedDetection, TypicalSea
from meshtrace.transport.forced_link import crossing_reach
from meshtrace.transport.meshing import FADING_SPACING, mesh_for
from meshtrace.transport.options import Meshing, Run
from meshtrace.transport.parts import Parts
from meshtrace.uav.airframe import Flight
from meshtrace.uav.wind import Dryden

if TYPE_CHECKING:
    import xarray as xr

Result = TypeVar("Result")

DEFAULT_CHAINS = 2048
"""Chains of a study over many surfaces, common to all of them."""

_PROBED = 4  # surfaces whose crests the chains expect
_TRIM_EVERY = 16  # surfaces, after which free memory returns to the system


class Steps(NamedTuple):
    """Surfaces of a campaign in order.

    Parameters
    ----------
    along : {"time", "realization"}
        Difference between the surfaces.
    labels : ndarray, shape (n,)
        Times [s], or seeds of the realizations.
    surface : callable
        Surface and time [s] of a step by its number, made where it is needed.
    links : sequence of Link, optional
        The link over each surface alone, of a campaign whose only link moves.
    """

    along: Literal["time", "realization"]
    labels: NDArray[Any]
    surface: Callable[[int], tuple[MeshSource, float]]
    links: Sequence[Link] | None = None


class Campaign(NamedTuple):
    """Links over one sea: by time or by realization, with common chains and common meshes.

    Parameters
    ----------
    links : mapping of str to Link
        Links by name, all with as many receivers; the chains of all have the same numbers.
    surface : MeshSource
        The sea.
    run : Run
        Chains of each link, seed and threads.
    meshing : Meshing
        Time and resolution of the sea. A mesh is fine where the light of any link crosses.
    scenario : Scenario, optional
        The scenario from which they follow.
    """

    links: Mapping[str, Link]
    surface: MeshSource
    run: Run
    meshing: Meshing
    scenario: Scenario | None = None

    @property
    def link(self) -> Link:
        """The first link."""
        return next(iter(self.links.values()))

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

    def of(self, link: Link) -> Campaign:
        """Return the campaign of another link."""
        return self._replace(links={"link": link})

    def provenance(self, link: Link | None = None, **more: Any) -> dict[str, Any]:
        """Return the provenance of a link, by default the first."""
        run = {"estimator": "forced", "photons": self.run.photons, "seed": self.run.seed}
        run |= self.meshing.model_dump()
        return provenance(link or self.link, self.surface.to_config(), run | more)

    def wind_of(self, flight: Flight) -> Dryden:
        """Return the wind at an aircraft, by default that over the sea."""
        if flight.wind is not None:
            return flight.wind
        return wind_over(self.scenario or self.surface, self.link, "flight.wind")

    def of_flight(self, flight: Flight) -> dict[str, Any]:
        """Return the aircraft and its wind as plain data."""
        parts = {"uav": flight.uav, "wind": self.wind_of(flight)}
        return {name: part.model_dump(mode="json") for name, part in parts.items()}

    def in_time(self, times: Floats, links: Sequence[Link] | None = None) -> Steps:
        """Return the sea at times (n,) [s], and the link at each if it moves."""
        return Steps("time", times, lambda i: (self.surface, float(times[i])), links)

    def realizations(self, n: int, name: str = "surface") -> Steps:
        """Return n realizations of the sea.

        Raises
        ------
        Refused
            If the sea has no random phases; `name` is that of the argument.
        """
        sea, time = self.surface, self.meshing.time
        if not isinstance(sea, RandomSea):
            raise Refused(name, Described(type(sea).__name__), "a sea with random phases")
        seeds = np.array([realization_seed(self.run.seed, i) for i in range(n)], np.int64)
        return Steps("realization", seeds, lambda i: (sea.with_seed(int(seeds[i])), time))

    def mesh(self, links: Sequence[Link], surface: MeshSource, time: float) -> TriangleMesh:
        """Return the mesh of a surface at a time, as far as light can cross to any receiver."""
        meshing, joint = self.meshing.replace(time=time), with_all_ends(links)
        reach = max(crossing_reach(link) + math.dist(link.origin, joint.origin) for link in links)
        return mesh_for(joint, surface, meshing, reach, FADING_SPACING)[0]

    def parts(
        self,
        steps: Steps,
        progress: Callable[[int], None] | None = None,
        probed: int = _PROBED,
    ) -> Iterator[list[Parts]]:
        """Return the gains in parts over each surface, one for each link, as they are computed.

        Each mesh is made in the thread that evaluates it. The chains expect crests somewhat above
        those of the first `probed` surfaces, or of the first one under a link that moves.
        """
        run, normals, links = self.run, self.meshing.normals, list(self.links.values())

        def over(i: int) -> list[Link]:
            return links if steps.links is None else [steps.links[i]]

        def mesh(i: int) -> TriangleMesh:
            return self.mesh(over(i), *steps.surface(i))

        def chains(link: Link) -> ForcedDetection:
            return ForcedDetection(link, run.photons, run.seed, normals, sea=typical)

        def evaluate(i: int) -> list[Parts]:
            made = first.pop(i) if i in first else mesh(i)
            forced = common or [chains(link) for link in over(i)]
            return [one.evaluate(made) for one in forced]

        n = len(steps.labels)
        first = {i: mesh(i) for i in range(min(1 if steps.links else probed, n))}
        typical = TypicalSea.of(first.values(), MANY_SEAS)
        common = [] if steps.links else [chains(link) for link in links]
        return over_surfaces(evaluate, n, self.threads, progress)

    def gains(
        self,
        steps: Steps,
        progress: Callable[[int], None] | None = None,
        probed: int = _PROBED,
    ) -> xr.Dataset:
        """Return the gains over all surfaces.

        Parameters
        ----------
        steps : Steps
            The surfaces.
        progress : callable, optional
            Called with 1 after each surface.
        probed : int
            See `parts`.

        Returns
        -------
        xarray.Dataset
            `gain` and `gain_ballistic`, its unscattered part, by link, time or realization,
            receiver and shift, one of 32 randomizations of the chains: independent estimates, the
            same ones over all surfaces and for all links. `stderr` gives their standard error.
        """
        import xarray as xr

        n, receivers = len(steps.labels), len(self.link.receivers)
        gain, ballistic = np.empty((2, len(self.links), n, receivers, SHIFTS))
        for i, parts in enumerate(self.parts(steps, progress, probed)):
            gain[:, i] = [one.shifts for one in parts]
            ballistic[:, i] = [one.direct for one in parts]
        dims = ("link", steps.along, "receiver", "shift")
        return xr.Dataset(
            {"gain": (dims, gain), "gain_ballistic": (dims, ballistic)},
            {"link": list(self.links), steps.along: steps.labels},
            {"provenance": {name: self.provenance(link) for name, link in self.links.items()}},
        )


def over_surfaces(
    evaluate: Callable[[int], Result],
    n: int,
    threads: int,
    progress: Callable[[int], None] | None = None,
    work: str = "seas",
) -> Iterator[Result]:
    """Yield `evaluate(i)` of n surfaces in order, by several threads.

    A work of minutes is announced; `progress` is called with 1 after each surface.
    """
    found = ordered_map(evaluate, range(n), threads)
    for i, result in enumerate(paced(found, n, f"{n:,} {work}")):
        yield result
        if i % _TRIM_EVERY == 0:
            trim_memory()
        if progress is not None:
            progress(1)


def mean(samples: xr.DataArray, over: str) -> xr.DataArray:
    """Return the mean over a dimension."""
    return samples.mean(over, skipna=False)


def stderr(samples: xr.DataArray, over: str) -> xr.DataArray:
    """Return the standard error of the mean over a dimension of independent samples.

    Over `shift` it is the Monte Carlo error, over realizations the spread of the sea.
    """
    return samples.std(over, ddof=1, skipna=False) / math.sqrt(samples.sizes[over])


def with_all_ends(links: Sequence[Link]) -> Link:
    """Return the link in the clearest water with the sources and receivers of all."""
    if len(links) == 1:
        return links[0]
    ends = {
        "transmitter": tuple(source for one in links for source in one.transmitters),
        "receiver": tuple(receiver for one in links for receiver in one.receivers),
    }
    return min(links, key=lambda link: link.water.a).replace(**ends)


def campaign_of(
    link: Link | Scenario,
    surface: MeshSource | None = None,
    fading: bool = False,
    **options: Any,
) -> Campaign:
    """Return the campaign of a link over a sea, checked.

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
    return Campaign({"link": case.link}, case.surface, case.run, case.meshing, scenario)
