"""Links over many surfaces: one loop for all studies, on threads or a cluster, with a store."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from functools import partial
from typing import Any, Literal, NamedTuple, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.correlated import FrozenForced, SpectralDetection
from meshtrace.engine.forced import MANY_SEAS, ForcedDetection, TypicalSea
from meshtrace.engine.photons.analog import run_analog
from meshtrace.engine.setup.ends import resolved_reach
from meshtrace.engine.setup.meshing import (
    FADING_SPACING,
    mesh_lines,
    require_cover,
    surface_config,
)
from meshtrace.engine.setup.options import (
    Analog,
    Meshing,
    Run,
    StudyOptions,
    require_options,
    resolve,
)
from meshtrace.engine.setup.tinting import clearest
from meshtrace.errors import Described, Refused, require_whole
from meshtrace.kernels.random import realization_seed
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, SeededSurface, SurfaceModel, TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import default_threads, held, ordered_map, paced, trim_memory
from meshtrace.results.provenance import provenance
from meshtrace.results.series import checked_wavelengths
from meshtrace.scenario import MeshFile, Scenario
from meshtrace.stored import SHIFTS
from meshtrace.studies.cluster import Cluster
from meshtrace.studies.store import Store, digest_of
from meshtrace.uav import Dryden, Flight, TiltFactors

Setup = Callable[[], Callable[[Any], Any]]
"""Returns the function that gives the numbers of a step; called in the process that evaluates."""

ShapeOf = Callable[[Any], tuple[int | None, ...]]

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
    links : sequence of tuple of Link, optional
        The links over each surface alone, of a campaign whose links move.
    """

    along: Literal["time", "realization"]
    labels: NDArray[Any]
    surface: Callable[[int], tuple[Any, float]]
    links: Sequence[tuple[Link, ...]] | None = None

    def identity(self) -> dict[str, Any]:
        """Return the configuration that identifies the surfaces, as plain data."""
        labels = self.labels.tolist()
        identity = {"along": self.along, "number": len(labels), "labels": digest_of(labels)}
        if self.links is not None:
            links_of_steps = [
                [link.model_dump(mode="json") for link in links] for links in self.links
            ]
            identity["links"] = digest_of(links_of_steps)
        return identity


class Campaign(NamedTuple):
    """Links over one sea: by time or by realization, with common chains and common meshes.

    Parameters
    ----------
    links : mapping of str to Link
        Links by name, all with as many receivers; the chains of all have the same numbers.
    surface : MeshSource or TriangleMesh
        The sea; a single mesh where one surface is enough.
    run : Run
        Chains of each link, seed and threads.
    meshing : Meshing
        Time and resolution of the sea. A mesh is fine where the light of any link crosses.
    scenario : Scenario, optional
        The scenario from which they follow.
    cluster : Cluster, optional
        Processes that evaluate the surfaces; threads of this one by default.
    store : Store
        File that keeps finished surfaces.
    progress : callable, optional
        Called with 1 after each step.
    spectral : bool
        Whether the links are one at several wavelengths, with common paths where possible.
    lit : float
        Half-width of the fine part of the meshes, over that of `Link.lit_patch`.
    """

    links: Mapping[str, Link]
    surface: MeshSource | TriangleMesh
    run: Run
    meshing: Meshing
    scenario: Scenario | None = None
    cluster: Cluster | None = None
    store: Store = Store()
    progress: Callable[[int], None] | None = None
    spectral: bool = False
    lit: float = 1.0

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

    def workers(self) -> AbstractContextManager[None]:
        """Return a context in which all loops have the same workers."""
        return nullcontext() if self.cluster is None else self.cluster.keep_workers()

    def of(self, link: Link, name: str = "link") -> Campaign:
        """Return the campaign of another link; names in one store have to differ."""
        return self._replace(links={name: link})

    def identity(self) -> dict[str, Any]:
        """Return the configuration that the numbers of a step depend on, as plain data."""
        return {
            "links": {name: link.model_dump(mode="json") for name, link in self.links.items()},
            "spectral": self.spectral,
            "surface": surface_config(self.surface),
            **self._estimate(),
            "meshing": self.meshing.model_dump(mode="json"),
        }

    def _estimate(self) -> dict[str, Any]:
        """Return estimator, photons and seed as plain data; threads do not matter."""
        options = self.run.estimator.model_dump(mode="json")
        kind = options.pop("kind")
        return {"estimator": kind, "photons": self.run.photons, "seed": self.run.seed, **options}

    def provenance(self, link: Link | None = None, **more: Any) -> dict[str, Any]:
        """Return the provenance of a link, by default the first."""
        run = self._estimate() | self.meshing.model_dump()
        return provenance(link or self.link, surface_config(self.surface), run | more)

    def wind_of(self, flight: Flight) -> Dryden:
        """Return the wind at an aircraft, by default that over the sea."""
        if flight.wind is not None:
            return flight.wind
        surface = self.scenario or self.surface
        speed = getattr(getattr(surface, "spectrum", surface), "wind_speed", None)
        if speed is None:
            raise Refused("flight.wind", None, "a wind, over a sea without wind speed")
        return Dryden(wind_speed=speed, height=self.link.air_end[1].height)

    def flight(self, given: Flight | None) -> Flight | None:
        """Return the aircraft of a study, by default the one in its scenario, checked."""
        uav = getattr(self.scenario, "uav", None)
        in_air = Flight(uav) if given is None and uav is not None else given
        return in_air and in_air.checked()

    def tilt_factors(self, flight: Flight, fov_deg: float) -> TiltFactors:
        """Return the law of the tilt factor h_alpha of an aircraft in independent gusts."""
        return flight.uav.tilt_factors(self.wind_of(flight), math.radians(fov_deg))

    def of_flight(self, flight: Flight) -> dict[str, Any]:
        """Return the aircraft and its wind as plain data."""
        parts = {"uav": flight.uav, "wind": self.wind_of(flight)}
        return {name: part.model_dump(mode="json") for name, part in parts.items()}

    def in_time(self, times: Floats, links: Sequence[tuple[Link, ...]] | None = None) -> Steps:
        """Return the sea at times (n,) [s], and the links at each if they move."""
        sea = self.surface
        return Steps("time", times, lambda i: (sea, float(times[i])), links)

    def realizations(self, n: int) -> Steps:
        """Return n realizations of the sea.

        Raises
        ------
        Refused
            If the sea has no random phases.
        """
        sea, time = self.surface, self.meshing.time
        if not isinstance(sea, SeededSurface):
            raise Refused("surface", Described(type(sea).__name__), "a sea with random phases")
        # seeds of their own, so that a realization does not depend on how many there are
        seeds = np.array([realization_seed(self.run.seed, i) for i in range(n)], np.int64)
        return Steps("realization", seeds, lambda i: (sea.with_seed(int(seeds[i])), time))

    def surfaces(self, n: int) -> Steps:
        """Return n realizations, or the one surface of a sea without random phases."""
        if isinstance(self.surface, SeededSurface):
            return self.realizations(n)
        return self.in_time(np.array([self.meshing.time]))

    def lines(self, links: Sequence[Link], surface: MeshSource) -> dict[str, Any]:
        """Return the arguments of a mesh as far as light can cross to any receiver, at any time."""
        if self.spectral:  # the ends of all are the same
            links = [clearest(links)]
        joint = links[0]
        if len(links) > 1:  # in the clearest water
            ends = {
                "transmitter": tuple(source for one in links for source in one.transmitters),
                "receiver": tuple(receiver for one in links for receiver in one.receivers),
            }
            # light reaches farthest there
            joint = min(links, key=lambda link: link.water.a).replace(**ends)
        estimator = self.run.estimator
        reach = max(
            resolved_reach(link, estimator) + math.dist(link.origin, joint.origin) for link in links
        )
        return mesh_lines(joint, surface, self.meshing, reach, FADING_SPACING, self.lit)

    def mesh(
        self,
        links: Sequence[Link],
        surface: MeshSource | TriangleMesh,
        time: float,
        lines: dict[str, Any] | None = None,
    ) -> TriangleMesh:
        """Return the mesh of a surface at a time; `lines` are those common to several."""
        made = surface
        if not isinstance(made, TriangleMesh):
            made = made.mesh(time, **(lines or self.lines(links, made)))
        for link in links:
            require_cover(link, made)
        return made

    def over(
        self,
        setup: Setup,
        steps: Sequence[Any],
        name: str,
        identity: Mapping[str, Any],
        shape: ShapeOf,
        work: str = "seas",
    ) -> Iterator[Floats]:
        """Yield the numbers of each step in order, from the store where available.

        A work of minutes is announced.

        Parameters
        ----------
        setup : callable
            Returns the function of a step. On a cluster every worker calls it once.
        steps : sequence
            Steps as plain data, all different: numbers of surfaces, or tuples.
        name : str
            Name of the loop in the store.
        identity : mapping
            What the numbers depend on besides `identity` of the campaign.
        shape : callable
            Returns the shape of the numbers of a step; None is any size.
        work : str
            Name of the steps, for the announcement.

        Raises
        ------
        Refused
            If numbers in the store have another shape.
        """
        with self.store.loop(name, {**self.identity(), **identity}) as stored:
            # all stored shapes are checked before any new work starts
            waiting = [step for step in steps if step not in stored]
            for step in steps:
                if step in stored:
                    self.store.require_shape(stored[step].numbers, shape(step))
            computed = self._computed(setup, waiting) if waiting else iter(())
            # a cluster finishes steps in any order; they are handed on in order
            ready: dict[Any, Floats] = {}
            with closing(paced(computed, len(waiting), f"{len(waiting):,} {work}")) as results:
                for step in steps:
                    while step not in ready and step not in stored:
                        i, numbers = next(results)
                        ready[waiting[i]] = stored.keep(waiting[i], numbers).numbers
                        if i % _TRIM_EVERY == 0:
                            trim_memory()
                    yield ready.pop(step) if step in ready else stored[step].numbers
                    self.advance()

    def advance(self) -> None:
        """Report a finished step."""
        if self.progress is not None:
            self.progress(1)

    def _computed(self, setup: Setup, steps: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Yield the number of each step and its numbers, on a cluster as they finish."""
        if self.cluster is None:
            # setup and step both hold BLAS to one thread: digits do not depend on the cores
            yield from enumerate(ordered_map(held(held(setup)()), steps, self.threads))
            return
        with closing(self.cluster.map(setup, steps)) as results:
            for i, numbers in results:
                if isinstance(numbers, Exception):
                    # workers send exceptions back as values
                    raise numbers
                yield i, numbers

    @property
    def alone(self) -> Campaign:
        """The campaign without store, cluster and progress; one thread for a worker."""
        run = self.run if self.cluster is None else self.run.replace(threads=1)
        return self._replace(run=run, scenario=None, cluster=None, store=Store(), progress=None)

    def each(self, steps: Steps, probed: int = _PROBED) -> Iterator[Floats]:
        """Yield the gains over each surface, and their unscattered parts, as they are computed.

        Parameters
        ----------
        steps : Steps
            The surfaces.
        probed : int
            Surfaces whose crests the chains expect; the first one under links that move.

        Yields
        ------
        ndarray, shape (2, links, receivers, shifts)
        """
        setup = partial(gains_over, self.alone, steps, probed)
        name = f"gains of {', '.join(self.links)}"
        identity = {"steps": steps.identity(), "probed": probed}
        shape = 2, len(self.links), len(self.link.receivers), SHIFTS
        return self.over(setup, range(len(steps.labels)), name, identity, lambda step: shape)

    def gains(self, steps: Steps, probed: int = _PROBED) -> Floats:
        """Return the gains over all surfaces, and their unscattered parts.

        Parameters
        ----------
        steps, probed
            As in `each`.

        Returns
        -------
        ndarray, shape (2, links, surfaces, receivers, shifts)
            Shifts are the 32 randomizations of the chains: independent estimates, the same ones
            over all surfaces and for all links.
        """
        n, receivers = len(steps.labels), len(self.link.receivers)
        gains = np.empty((2, len(self.links), n, receivers, SHIFTS))
        for i, numbers in enumerate(self.each(steps, probed)):
            gains[:, :, i] = numbers
        return gains


def gains_over(campaign: Campaign, steps: Steps, probed: int = _PROBED) -> Callable[[int], Floats]:
    """Return the function that gives the gains over a surface, see `Campaign.each`.

    Each mesh is made in the thread that evaluates it.
    """
    run, normals, links = campaign.run, campaign.meshing.normals, list(campaign.links.values())
    moving, n, source = steps.links is not None, len(steps.labels), campaign.surface
    widest = _widest(steps, links)
    lines = campaign.lines(widest, source) if widest and isinstance(source, MeshSource) else None

    def links_at(i: int) -> Sequence[Link]:
        return links if steps.links is None else steps.links[i]

    def mesh(i: int) -> TriangleMesh:
        return campaign.mesh(links_at(i), *steps.surface(i), lines)

    if isinstance(run.estimator, Analog):
        return lambda i: _analog_gains(campaign, links_at(i), mesh(i))
    first = {i: mesh(i) for i in range(min(1 if steps.links else probed, n))}
    typical = TypicalSea.of_meshes(first.values(), MANY_SEAS)

    def chains(link: Link) -> ForcedDetection:
        return ForcedDetection(link, run.photons, run.seed, normals, sea=typical)

    def spectral(links_there: Sequence[Link]) -> SpectralDetection:
        return SpectralDetection(links_there, run.photons, run.seed, normals, sea=typical)

    alone, tilted = campaign.spectral or (moving and not widest), []
    shared = [] if alone else [chains(link) for link in links]
    paths = spectral(links) if campaign.spectral and not moving else None
    if moving and shared and all(chain_set.serves_neighbours for chain_set in shared):
        tilted = [
            FrozenForced(link, run.photons, run.seed, typical, normals, "usual") for link in links
        ]
    elif moving:
        shared = []

    def evaluate(i: int) -> Floats:
        made = first.pop(i) if i in first else mesh(i)
        if tilted:
            pairs = zip(tilted, links_at(i), strict=True)
            return np.stack([chain_set.parts(link, made) for chain_set, link in pairs], axis=1)
        if campaign.spectral:
            parts = (paths or spectral(links_at(i))).at_wavelengths(made)
        else:
            parts = [chain_set.evaluate(made) for chain_set in shared or map(chains, links_at(i))]
        return np.array(
            [[chain_set.shifts for chain_set in parts], [chain_set.direct for chain_set in parts]]
        )

    return evaluate


def _analog_gains(campaign: Campaign, links: Sequence[Link], mesh: TriangleMesh) -> Floats:
    """Return the gains over a mesh by individual photons; unscattered parts are not known.

    A shift is a range of photon ids, the same over all surfaces: common random numbers, as those
    of the chains.
    """
    run, intersector = campaign.run, EmbreeIntersector(mesh)
    assert isinstance(run.estimator, Analog)
    photons = run.photons // SHIFTS
    gains = np.empty((len(links), len(links[0].receivers), SHIFTS))
    for i, link in enumerate(links):
        for shift in range(SHIFTS):
            first = run.estimator.first_photon + shift * photons
            sums = run_analog(
                link,
                intersector,
                run.estimator.replace(first_photon=first),
                photons=photons,
                seed=run.seed,
                normals=campaign.meshing.normals,
            )
            gains[i, :, shift] = sums.score[: len(link.receivers)] / photons
    return np.array([gains, np.full_like(gains, np.nan)])


def _widest(steps: Steps, links: list[Link]) -> Sequence[Link] | None:
    """Return the links with the widest mesh, one for all times; None if each surface has its own.

    Ends that tilt have one mesh, ends that move aside have others.
    """
    if steps.along != "time":
        return None
    if steps.links is None:
        return links
    ends = [row[0].air_end[1] for row in steps.links]
    if any(end.center != ends[0].center for end in ends):
        return None
    return steps.links[int(np.argmax([end.tilt_deg for end in ends]))]


def campaign_of(
    link: Link | Scenario,
    surface: MeshSource | TriangleMesh | None = None,
    study: str = "",
    fading: bool = False,
    *,
    several: bool = True,
    analog: bool = False,
    chains: int = DEFAULT_CHAINS,
    wavelengths_nm: ArrayLike | None = None,
    **run: Unpack[StudyOptions],
) -> Campaign:
    """Return the campaign of a link over a sea, checked.

    Parameters
    ----------
    link : Link or Scenario
        A link, or a scenario from which all that is not given follows.
    surface : MeshSource or TriangleMesh, optional
        The sea; by default that of the scenario, or that of the link's wind.
    study : str
        Name in a store.
    fading : bool
        Whether the answer of the study is about fading: unless `waves` of the meshing or of the sea
        say otherwise, the sea has all waves that make the light of the link fade.
    several : bool
        Whether the study needs a sea, and a single mesh is refused.
    analog : bool
        Whether the gains of the study may be those of individual photons.
    chains : int
        Chains of a link that are not given.
    wavelengths_nm : array_like, optional
        Wavelengths [nm] at which the link is taken, named by them; by default its own.
    **run
        See `StudyOptions`.

    Raises
    ------
    Refused
        If an option is unknown or out of range, or the surface is no sea.
    """
    options, loop = split_options(run, study)
    scenario = link if isinstance(link, Scenario) else None
    if scenario is None:
        options = {"photons": chains, **options}
    elif several and surface is None and isinstance(scenario.surface, MeshFile):
        raise Refused("sea.mesh", scenario.surface.file, "a sea model")
    case = resolve(link, surface, fading, **options)
    if isinstance(case.run.estimator, Analog):
        if not analog or wavelengths_nm is not None:
            raise Refused(
                "run.estimator", "analog", f"forced{', over many seas' if several else ''}"
            )
        require_whole(case.run.photons, SHIFTS, 2**53, "run.photons")
    if several and not isinstance(case.surface, MeshSource):
        raise Refused("surface", Described(type(case.surface).__name__), "a sea (MeshSource)")
    links = {"link": case.link}
    if wavelengths_nm is not None:
        at = checked_wavelengths(wavelengths_nm)
        links = {f"{nm!r} nm": case.link.at_wavelength(nm) for nm in at}
    return Campaign(
        links, case.surface, case.run, case.meshing, scenario, **loop,
        spectral=wavelengths_nm is not None,
    )  # fmt: skip


def split_options(given: Mapping[str, Any], study: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the options of a case, and cluster, store and progress of its campaign, checked."""
    require_options(given, StudyOptions)
    options = {name: value for name, value in given.items() if value is not None}
    workers, progress = options.pop("workers", None), options.pop("progress", None)
    cluster = None if workers is None else Cluster(workers).checked()
    store = Store(options.pop("store", None), study)
    return options, {"cluster": cluster, "store": store, "progress": progress}
