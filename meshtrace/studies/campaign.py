"""Links over many surfaces: one loop for all studies, on threads or a cluster, with a store."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from functools import partial
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.engine.correlated import FrozenForced, SpectralDetection
from meshtrace.engine.forced import MANY_SEAS, ForcedDetection, TypicalSea
from meshtrace.engine.gains import pixel_groups, table_of
from meshtrace.engine.outcome import groups_by_lamp
from meshtrace.engine.photons.analog import run_analog
from meshtrace.engine.setup.ends import resolved_reach
from meshtrace.engine.setup.meshing import FADING_SPACING, mesh_lines, require_cover, surface_config
from meshtrace.engine.setup.options import (
    Analog,
    Arrivals,
    Case,
    Meshing,
    Run,
    RunOptions,
    StudyOptions,
    resolve,
)
from meshtrace.engine.setup.tinting import clearest
from meshtrace.errors import Described, Refused, require_keys, require_whole
from meshtrace.kernels.random import realization_seed
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, SeededSurface, SurfaceModel, TriangleMesh
from meshtrace.models import Floats
from meshtrace.parallel import default_threads, held, ordered_map, paced, trim_memory
from meshtrace.results.provenance import provenance
from meshtrace.results.series import checked_wavelengths
from meshtrace.scenario import MeshFile, Scenario
from meshtrace.stored import SHIFTS
from meshtrace.studies.cluster import Cluster, Setup
from meshtrace.studies.store import Item, Kept, Store, digest_of
from meshtrace.uav import Dryden, Flight, TiltFactors

# the shape of the numbers of a step, one turn of a study's loop; None along an axis of any size
ShapeOf = Callable[[Any], tuple[int | None, ...]]

DEFAULT_CHAINS = 2048
"""Chains of a study over many surfaces, common to all of them."""

# First surfaces, whose crests stand for those of all when chains are drawn: chains end below a
# ceiling, and a higher sea needs others. `MANY_SEAS` allows for seas higher than these.
_PROBED = 4
_TRIM_EVERY = 16  # surfaces after which free memory goes back to the system; tuned: memory, time


class Steps(NamedTuple):
    """Surfaces of a campaign, in order.

    Parameters
    ----------
    along : {"time", "realization"}
        Difference between the surfaces.
    labels : ndarray, shape (n,)
        Times [s], or seeds of the realizations.
    surface : callable
        Returns surface and time [s] of a step by its number, called where they are needed.
    links : sequence of tuple of Link, optional
        Links over each surface, of a campaign whose links move; by default those of the campaign.
    """

    along: Literal["time", "realization"]
    labels: NDArray[Any]
    surface: Callable[[int], tuple[Any, float]]
    links: Sequence[tuple[Link, ...]] | None = None

    def identity(self) -> dict[str, Any]:
        """Return the configuration that identifies the surfaces, as plain data."""
        labels = self.labels.tolist()
        # a digest: a million labels would take megabytes in one line of the store
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
        The sea; a mesh for studies that need only a single surface.
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
    fine_patch : float
        Half-width of the finely meshed part of the surface, over that of `Link.lit_patch`.
    per_lamp : bool
        Whether gains by pair of lamp and receiver, lamp after lamp, follow those of the receivers.
    per_pixel : bool
        Whether gains by pixel, receiver after receiver, follow as the last.
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
    fine_patch: float = 1.0
    per_lamp: bool = False
    per_pixel: bool = False

    @property
    def pixels(self) -> int:
        """Number of pixels whose gains are asked for, along a side; 1 for none."""
        return self.link.pixels if self.per_pixel else 1

    @property
    def link(self) -> Link:
        """The first link."""
        return next(iter(self.links.values()))

    @property
    def columns(self) -> int:
        """Number of gains of a link over a surface: receivers, pairs if `per_lamp`, and pixels."""
        pairs = len(self.link.transmitters) if self.per_lamp else 0
        pixels = self.pixels**2 if self.pixels > 1 else 0
        return (1 + pairs + pixels) * len(self.link.receivers)

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
            If the surface is a mesh or a series of meshes.
        """
        if not isinstance(self.surface, SurfaceModel):
            kind = Described(type(self.surface).__name__)
            raise Refused("surface", kind, "a sea (SurfaceModel), of any spacing")
        return self.surface

    def with_loop(self, run: RunOptions | StudyOptions, study: str) -> Campaign:
        """Return the campaign with the workers, the store and the progress of a study's options."""
        workers = run.get("workers")
        cluster = None if workers is None else Cluster(workers)
        store = Store(run.get("store"), study)
        return self._replace(cluster=cluster, store=store, progress=run.get("progress"))

    def workers(self) -> AbstractContextManager[None]:
        """Return a context in which all loops share their workers."""
        return nullcontext() if self.cluster is None else self.cluster.keep_workers()

    def for_link(self, link: Link, name: str = "link") -> Campaign:
        """Return the campaign of another link, under a name unique within the store."""
        return self._replace(links={name: link})

    def identity(self) -> dict[str, Any]:
        """Return the configuration that the numbers of a step depend on, as plain data."""
        identity = {
            # `per_pixel` needs no key: the links name their pixels
            "links": {name: link.model_dump(mode="json") for name, link in self.links.items()},
            "spectral": self.spectral,
            "surface": surface_config(self.surface),
            "meshing": self.meshing.model_dump(mode="json"),
        } | self._estimate()
        return identity | {"per_lamp": True} if self.per_lamp else identity

    def _estimate(self) -> dict[str, Any]:
        """Return estimator, photons and seed as plain data; threads do not matter."""
        options = self.run.estimator.model_dump(mode="json")
        kind = options.pop("kind")
        return {"estimator": kind, "photons": self.run.photons, "seed": self.run.seed} | options

    def provenance(
        self, link: Link | None = None, of_study: Mapping[str, Any] = MappingProxyType({})
    ) -> dict[str, Any]:
        """Return the provenance of a link, by default the first, with the options of a study."""
        run = self._estimate() | self.meshing.model_dump() | dict(of_study)
        return provenance(link or self.link, surface_config(self.surface), run)

    def wind_of(self, flight: Flight) -> Dryden:
        """Return the wind at an aircraft, by default that over the sea."""
        if flight.wind is not None:
            return flight.wind
        owner = self.scenario or self.surface
        # the wind of a scenario, of the spectrum of a sea, of a sea itself, or the highest of a sum
        seas = [getattr(sea, "spectrum", sea) for sea in getattr(owner, "parts", (owner,))]
        speeds = [speed for sea in seas if (speed := getattr(sea, "wind_speed", None)) is not None]
        if not speeds:
            raise Refused("flight.wind", None, "a wind, over a sea without wind speed")
        return Dryden(wind_speed=max(speeds), height=with_first(self.link).air_end[1].height)

    def flight(self, flight: Flight | None) -> Flight | None:
        """Return the checked aircraft of a study, by default that of its scenario."""
        uav = getattr(self.scenario, "uav", None)
        if flight is None and uav is not None:
            flight = Flight(uav)
        return flight and flight.checked()

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
        """Return the grid lines of a mesh that covers all crossings to any receiver.

        They are keyword arguments of `MeshSource.mesh`.
        """
        if self.spectral:  # one link at several wavelengths: its ends are in the same places
            links = [clearest(links)]
        joint = links[0]
        if len(links) > 1:
            # one link with the ends of all, in the clearest water: light reaches farthest there
            joint = min(links, key=lambda link: link.water.a).replace(
                transmitter=tuple(source for link in links for source in link.transmitters),
                receiver=tuple(receiver for link in links for receiver in link.receivers),
            )
        estimator = self.run.estimator
        # each link reaches so far about its own origin: seen from that of the joint one, farther
        reach = max(
            resolved_reach(link, estimator) + math.dist(link.origin, joint.origin) for link in links
        )
        return mesh_lines(joint, surface, self.meshing, reach, FADING_SPACING, self.fine_patch)

    def require_chains(self) -> None:
        """Refuse links that forced detection cannot follow."""
        for link in self.links.values():
            link.require_chains()

    def mesh(
        self,
        links: Sequence[Link],
        surface: MeshSource | TriangleMesh,
        time: float,
        lines: dict[str, Any] | None = None,
    ) -> TriangleMesh:
        """Return the mesh of a surface at a time, by default with lines for these links alone."""
        # a mesh of the user is taken as it is
        mesh = surface
        if not isinstance(mesh, TriangleMesh):
            mesh = mesh.mesh(time, **(lines or self.lines(links, mesh)))
        for link in links:
            require_cover(link, mesh)
        return mesh

    def detections(
        self, links: Sequence[Link], sea: TypicalSea, threads: int = 1
    ) -> list[ForcedDetection] | list[SpectralDetection]:
        """Return chains for links over any surface: one set for all wavelengths, or one a link."""
        run, normals = self.run, self.meshing.normals
        if self.spectral:
            return [SpectralDetection(links, run.photons, run.seed, normals, threads, sea)]
        return [
            ForcedDetection(link, run.photons, run.seed, normals, threads, sea) for link in links
        ]

    def evaluate(
        self,
        setup: Setup,
        steps: Sequence[Any],
        name: str,
        identity: Mapping[str, Any],
        shape: ShapeOf,
        work: str = "seas",
    ) -> Iterator[Floats]:
        """Yield the numbers of each step in order, from the store where available.

        Parameters
        ----------
        setup, steps, shape, work
            As in `finished`.
        name : str
            Name of the loop in the store.
        identity : mapping
            What the numbers depend on besides `identity` of the campaign.
        """
        run_map = partial(_on_threads, self.threads) if self.cluster is None else self.cluster.map
        # a cluster finishes steps in any order; they are handed on in order
        ready: dict[Any, Floats] = {}
        with (
            self.store.loop(name, self.identity() | dict(identity)) as stored,
            closing(finished(stored, run_map, setup, steps, shape, work)) as items,
        ):
            for step in steps:
                while step not in ready:
                    done, item = next(items)
                    if isinstance(item, Exception):
                        # workers send exceptions back as values
                        raise item
                    ready[done], _ = item
                yield ready.pop(step)
                self.advance()

    def advance(self) -> None:
        """Report a finished step."""
        if self.progress is not None:
            self.progress(1)

    @property
    def alone(self) -> Campaign:
        """Copy for workers, without scenario, store, cluster and progress."""
        # a worker has one core: more threads would take those of other workers
        run = self.run if self.cluster is None else self.run.replace(threads=1)
        return self._replace(run=run, scenario=None, cluster=None, store=Store(), progress=None)

    def each(self, steps: Steps, probed: int = _PROBED) -> Iterator[Floats]:
        """Yield the gains over each surface, and their unscattered parts, as they are computed.

        Parameters
        ----------
        steps : Steps
            The surfaces.
        probed : int
            First surfaces, whose crests stand for those of all when chains are drawn. Under links
            that move it is the very first alone.

        Yields
        ------
        ndarray, shape (2, links, columns, shifts)
            Columns are those of `Campaign.columns`, shifts as in `gains`.
        """
        setup = partial(gains_over, self.alone, steps, probed)
        name = f"gains of {', '.join(self.links)}"
        identity = {"steps": steps.identity(), "probed": probed}
        shape = 2, len(self.links), self.columns, SHIFTS
        return self.evaluate(setup, range(len(steps.labels)), name, identity, lambda step: shape)

    def gains(self, steps: Steps, probed: int = _PROBED) -> Floats:
        """Return the gains over all surfaces, and their unscattered parts.

        Parameters
        ----------
        steps, probed
            As in `each`.

        Returns
        -------
        ndarray, shape (2, links, surfaces, columns, shifts)
            Columns are those of `Campaign.columns`. Shifts are the 32 randomizations of the chains:
            independent estimates, the same ones over all surfaces and for all links.
        """
        # filled as they come: a list would hold the gains of a million surfaces twice
        gains = np.empty((2, len(self.links), len(steps.labels), self.columns, SHIFTS))
        for i, numbers in enumerate(self.each(steps, probed)):
            gains[:, :, i] = numbers
        return gains


def with_first(link: Link) -> Link:
    """Return a link with only its first receiver."""
    return link if len(link.receivers) == 1 else link.replace("receiver", link.receivers[0])


def finished(
    stored: Kept,
    mapped: Callable[[Setup, Sequence[Any]], Generator[tuple[int, Any], None, None]],
    setup: Setup,
    steps: Sequence[Any],
    shape: ShapeOf,
    work: str,
) -> Generator[tuple[Any, Item | Exception], None, None]:
    """Yield each step with its item, stored steps first, then new ones as they finish.

    Work of minutes is announced. A step that failed is not stored: the next call tries it again.

    Parameters
    ----------
    stored : Kept
        Finished steps of the loop, to which the others are added.
    mapped : callable
        Evaluates steps, on threads or on a cluster (`Cluster.map`), and yields the number of each
        in the sequence with its result or exception.
    setup : callable
        Returns the function from a step to its numbers, or to numbers and a text. On a cluster
        every worker calls it once.
    steps : sequence
        Steps as plain data, all different: numbers of surfaces, or tuples.
    shape : callable
        Returns the shape of the numbers of a step; None is any size.
    work : str
        Name of the steps, for the announcement.

    Raises
    ------
    Refused
        If stored numbers have another shape.
    """
    # all stored shapes are checked before any new work starts
    restored = [(step, stored.of_shape(step, shape(step))) for step in steps if step in stored]
    waiting = [step for step in steps if step not in stored]
    yield from restored
    if not waiting:  # saves the setup, which may take as long as many steps
        return
    with closing(mapped(setup, waiting)) as results:
        for i, result in paced(results, len(waiting), f"{len(waiting):,} {work}"):
            if isinstance(result, Exception):
                yield waiting[i], result
                continue
            item = result if isinstance(result, tuple) else (result,)  # numbers and, perhaps, text
            yield waiting[i], stored.keep(waiting[i], *item)
            if (i + 1) % _TRIM_EVERY == 0:
                trim_memory()


def _on_threads(
    threads: int, setup: Setup, steps: Sequence[Any]
) -> Generator[tuple[int, Any], None, None]:
    """Evaluate steps on threads; yield the index of each and its numbers, in order."""
    # both the setup and the steps run with BLAS held to one thread: it splits sums by its threads,
    # and the digits would depend on the cores
    yield from enumerate(ordered_map(held(held(setup)()), steps, threads))


def gains_over(campaign: Campaign, steps: Steps, probed: int = _PROBED) -> Callable[[int], Floats]:
    """Return a function that computes the gains over surface i.

    Gains have the shape of those of `Campaign.each`; each mesh is made in the thread that
    evaluates it. Chains are drawn once for all surfaces where the links do not move.
    """
    run, normals, links = campaign.run, campaign.meshing.normals, list(campaign.links.values())
    widest, source = _widest(steps, links), campaign.surface
    lines = campaign.lines(widest, source) if widest and isinstance(source, MeshSource) else None

    def links_at(i: int) -> Sequence[Link]:
        return links if steps.links is None else steps.links[i]

    def make_mesh(i: int) -> TriangleMesh:
        return campaign.mesh(links_at(i), *steps.surface(i), lines)

    if isinstance(run.estimator, Analog):
        return lambda i: _analog_gains(campaign, links_at(i), make_mesh(i))
    pixels = campaign.pixels > 1
    n_probed = min(1 if steps.links else probed, len(steps.labels))
    # probed meshes serve the loop, too: each once, so that memory is freed as the loop goes on
    probed_meshes = {i: make_mesh(i) for i in range(n_probed)}
    typical = TypicalSea.of_meshes(probed_meshes.values(), MANY_SEAS)

    def mesh(i: int) -> TriangleMesh:
        return probed_meshes.pop(i) if i in probed_meshes else make_mesh(i)

    def gains(links: Sequence[Link]) -> Callable[[TriangleMesh], Floats]:
        detections = campaign.detections(links, typical)

        # shape (2, links, columns, shifts): gains and their unscattered parts
        def over_mesh(mesh: TriangleMesh) -> Floats:
            # one detection for each link, or one with all wavelengths: in both cases link by link
            gains_of_links = [
                gains_of_link
                for detection in detections
                for gains_of_link in detection.at_wavelengths(
                    mesh, record=pixels, per_lamp=campaign.per_lamp
                )
            ]
            pairs = zip(gains_of_links, links, strict=True)
            return np.moveaxis(np.array([_columns(*pair, pixels) for pair in pairs]), 1, 0)

        return over_mesh

    if steps.links is None:
        over_mesh = gains(links)
        return lambda i: over_mesh(mesh(i))
    # ends that only tilt share one mesh and, where chains serve neighbours, one set of chains
    may_share = widest and not campaign.spectral and not campaign.per_lamp and not pixels
    if not may_share or not all(
        isinstance(chains, ForcedDetection) and chains.serves_neighbours
        for chains in campaign.detections(links, typical)
    ):
        return lambda i: gains(links_at(i))(mesh(i))
    # "usual" searches, as single gains have: unbiased, at a part of the time of "thorough" ones
    frozen = [
        FrozenForced(link, run.photons, run.seed, typical, normals, "usual") for link in links
    ]

    def tilted_gains(i: int) -> Floats:
        surface_mesh, pairs = mesh(i), zip(frozen, links_at(i), strict=True)
        return np.stack([chains.parts(link, surface_mesh) for chains, link in pairs], axis=1)

    return tilted_gains


def _columns(gains: Any, link: Link, pixels: bool) -> list[Floats]:
    """Return gains of receivers, lamps and pixels by shift, and their unscattered parts."""
    columns = [(part.shifts, part.direct) for part in gains.with_lamps]
    if pixels:
        # the table of arrivals of the only wavelength; it does not tell their unscattered part
        by_pixel = pixel_groups(gains.table[0], link).reshape(-1, SHIFTS)
        columns.append((by_pixel, np.full_like(by_pixel, np.nan)))
    return [np.concatenate(kind) for kind in zip(*columns, strict=True)]


def _analog_gains(campaign: Campaign, links: Sequence[Link], mesh: TriangleMesh) -> Floats:
    """Return the gains over a mesh by individual photons, with nan for unscattered parts.

    A shift is a range of photon ids, the same over all surfaces: common random numbers, as those
    of the chains.
    """
    run, intersector = campaign.run, EmbreeIntersector(mesh)
    assert isinstance(run.estimator, Analog)
    photons = run.photons // SHIFTS
    # 32 disjoint ranges of photons give the error, as the 32 shifts of chains do
    record = [Arrivals()] if campaign.per_lamp or campaign.pixels > 1 else []
    gains = np.empty((len(links), campaign.columns, SHIFTS))
    for i, link in enumerate(links):
        for shift in range(SHIFTS):
            first = run.estimator.first_photon + shift * photons
            options = run.estimator.replace(first_photon=first)
            sums = run_analog(link, intersector, options, photons=photons, seed=run.seed,
                              normals=campaign.meshing.normals, record=record)  # fmt: skip
            total = sums.score[: len(link.receivers)] / photons
            columns = [total]
            if campaign.per_lamp:
                columns.append(groups_by_lamp(sums, run.seed, link).mean(axis=-1).ravel())
            if campaign.pixels > 1:
                hits = sums.all_arrivals
                table = table_of(hits, hits["weight"] / photons, 1.0, link)  # paths in metres
                columns.append(pixel_groups(table, link).mean(axis=-1).ravel())
            gains[i, :, shift] = np.concatenate(columns)
    return np.array([gains, np.full_like(gains, np.nan)])


def _widest(steps: Steps, links: list[Link]) -> Sequence[Link] | None:
    """Return the links whose mesh covers all times; None if each surface needs a new mesh.

    Ends that only tilt share one mesh, ends that move aside do not.
    """
    if steps.along != "time":
        return None
    if steps.links is None:
        return links
    # all links of a campaign move alike: the first stands for them
    ends = [[end for _, end in links_of_step[0].items()] for links_of_step in steps.links]
    # an end that moves needs a mesh for each place, fine where its light crosses
    places = [[end.center for end in of_step] for of_step in ends]
    if any(place != places[0] for place in places):
        return None
    # the most tilted view sees the sea farthest off; ends without a tilt, such as sources in the
    # water, count as level
    tilts = [sum(getattr(end, "tilt_deg", 0.0) for end in of_step) for of_step in ends]
    return steps.links[int(np.argmax(tilts))]


def campaign_of(
    link: Link | Scenario,
    surface: MeshSource | TriangleMesh | None = None,
    study: str = "",
    run: RunOptions | StudyOptions = RunOptions(),  # noqa: B008 - not changed
    *,
    fading: bool = False,
    several: bool = True,
    analog: bool = False,
    chains: int = DEFAULT_CHAINS,
    wavelengths_nm: ArrayLike | None = None,
) -> Campaign:
    """Check the inputs of a study, and return the campaign of its link over a sea.

    Parameters
    ----------
    link : Link or Scenario
        A link, or a scenario from which all that is not given follows.
    surface : MeshSource or TriangleMesh, optional
        The sea; by default that of the scenario, or that of the link's wind.
    study : str
        Name in a store.
    run : RunOptions or StudyOptions
        Options of the run by their names.
    fading : bool
        Whether the study is about fading: unless `waves` of the meshing or of the sea say
        otherwise, the sea has all waves that make the light of the link fade.
    several : bool
        Whether the study needs several surfaces, and a single mesh is refused.
    analog : bool
        Whether the gains of the study may be those of individual photons.
    chains : int
        Number of chains of a link, unless `photons` of the run says otherwise.
    wavelengths_nm : array_like, optional
        Wavelengths [nm] at which the link is taken, named by them; by default its own.

    Raises
    ------
    Refused
        If an option is unknown or out of range, or the surface is no sea.
    """
    scenario = link if isinstance(link, Scenario) else None
    if (
        scenario is not None
        and several
        and surface is None
        and isinstance(scenario.surface, MeshFile)
    ):
        raise Refused("sea.mesh", scenario.surface.file, "a sea model")
    case = case_of(link, surface, run, fading, chains)
    if isinstance(case.run.estimator, Analog):
        if not analog or wavelengths_nm is not None:
            raise Refused(
                "run.estimator", "analog", f"forced{', over many seas' if several else ''}"
            )
        # the error is that of 32 ranges of photons, none of which may be empty; doubles count whole
        # numbers up to 2^53
        require_whole(case.run.photons, SHIFTS, 2**53, "run.photons")
    if several and not isinstance(case.surface, MeshSource):
        raise Refused("surface", Described(type(case.surface).__name__), "a sea (MeshSource)")
    links = {"link": case.link}
    if wavelengths_nm is not None:
        at = checked_wavelengths(wavelengths_nm)
        links = {f"{nm!r} nm": case.link.at_wavelength(nm) for nm in at}
    campaign = Campaign(links, case.surface, case.run, case.meshing, scenario)
    return campaign.with_loop(run, study)._replace(spectral=wavelengths_nm is not None)


def case_of(
    link: Link | Scenario,
    surface: MeshSource | TriangleMesh | None,
    run: RunOptions | StudyOptions,
    fading: bool = False,
    chains: int | None = None,
) -> Case:
    """Return link, surface and run from the options of a study, see `campaign_of`."""
    options = case_options(run)
    # a scenario says its number of chains itself
    if chains is not None and not isinstance(link, Scenario):
        options.setdefault("photons", chains)
    return resolve(link, surface, fading, **options)


def case_options(run: RunOptions | StudyOptions) -> dict[str, Any]:
    """Return the options of a single run among those of a study; refuse unknown ones."""
    require_keys(run, [*StudyOptions.__annotations__, *Meshing.model_fields])
    return {
        name: value
        for name, value in run.items()
        if value is not None and name not in ("workers", "store", "progress")
    }
