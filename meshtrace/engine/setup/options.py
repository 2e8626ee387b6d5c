"""Inputs of a run: link, surface and options, from a link or a scenario.

The models of the options are the keys of [run] and [sea] in link files and the provenance of
results: estimator, mesh and records.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    NamedTuple,
    Protocol,
    Self,
    TypedDict,
    runtime_checkable,
)

import numpy as np
from pydantic import Field, model_validator

from meshtrace.checks import Inside
from meshtrace.errors import Described, Refused, require_keys
from meshtrace.fading.spectral import resolve_band
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, TriangleMesh, require_surface
from meshtrace.models import Family, FamilyField, Finite, Floats, Model, converted
from meshtrace.parallel import default_threads
from meshtrace.stored import SHIFTS
from meshtrace.surfaces.bands import Band, MeshWaves

__all__ = [
    "Analog",
    "Arrivals",
    "Forced",
    "IrradianceMap",
    "Meshing",
    "Run",
    "RunOptions",
    "StudyOptions",
]

BLOCK = 4096
"""Photons of a partial sum of scores: fixed, so that rounding does not depend on the chunks."""

# up to 2^53 a float64 holds every integer
_Count = Annotated[int, Field(ge=0, le=2**53)]


class Meshing(Model, frozen=True):
    """Time and resolution at which a sea is triangulated.

    Parameters
    ----------
    time : float
        Time of the sea [s].
    extent : float, optional
        Half-width of the mesh [m], > 0; by default that of `Link.footprint`.
    spacing : float, optional
        Spacing of the mesh [m], > 0; by default 0.1 m near the light, less where
        waves are short or curvature changes within it, and coarser outside.
    normals : {"vertex", "facet"}
        Normals interpolated from the exact slopes at the corners, or those of the facets.
    waves : {"mean", "fading", "paper", "scaled"}, float or Band, optional
        Waves that the mesh of a sea holds; the slopes of shorter ones are random. "mean": those
        about the peak, enough for mean gains. "fading": all that make the light of the link fade
        (`fading.resolve_band`). "paper", "scaled": equally spaced ones (`bands.named_band`). A
        number: those up to a frequency [rad s-1]. By default those of the sea, or else "fading"
        in studies of fading and "mean" in others.
    """

    time: Finite = 0.0
    extent: float | None = Field(default=None, gt=0.0, allow_inf_nan=False)
    spacing: float | None = Field(default=None, gt=0.0, allow_inf_nan=False)
    normals: Literal["vertex", "facet"] = "vertex"
    waves: MeshWaves = None


class Estimator(
    Family, frozen=True, default="forced", closed="estimators are closed: the engine runs these"
):
    """Base of the estimators' options."""

    default_photons: ClassVar[int]
    least_photons: ClassVar[int] = 1
    most_photons: ClassVar[int]  # upper limit of the number chosen for a relative tolerance


class Forced(Estimator, frozen=True):
    """Forced detection: scattering chains aimed at the receivers.

    It is some 10^5 times more efficient than individual photons. Light that the surface first
    reflects into the water is added by photons joined to the receivers where it matters; studies
    over many seas omit it: below 1e-4 of the gain in clear sea water, 0.5 to 1 % where clear water
    scatters backwards and the view is wide, and 10 % in turbid water.
    """

    kind: Literal["forced"] = "forced"

    default_photons: ClassVar[int] = 10_000
    least_photons: ClassVar[int] = SHIFTS  # one for each group of the standard error
    most_photons: ClassVar[int] = 2**20


class Analog(Estimator, frozen=True):
    """Analog estimator: individual photons, with all orders of scattering and reflection.

    Parameters
    ----------
    batch_size : int
        Photons of a chunk, a multiple of 4096 up to 2^18; no effect on the result.
    first_photon : int
        Id of the first photon, 0 to 2^53; runs of disjoint ids are independent and `merge`.
    max_surface_events, max_events : int
        Crossings and collisions after which a photon is ended, 1 to 2^31.
    roulette : float, optional
        Weight below which Russian roulette is played, 0 (never) to 1; by default half of the
        weight that absorption leaves on the straight way up (1e-3 with light from the air).
    """

    kind: Literal["analog"] = "analog"
    batch_size: int = Field(default=2**17, ge=BLOCK, le=2**18, multiple_of=BLOCK)
    first_photon: _Count = 0
    max_surface_events: int = Field(default=10, ge=1, le=2**31)
    max_events: int = Field(default=100_000, ge=1, le=2**31)
    roulette: float | None = Field(default=None, ge=0.0, le=1.0, allow_inf_nan=False)

    default_photons: ClassVar[int] = 1_000_000
    most_photons: ClassVar[int] = 10**9


class Record(Family, frozen=True, closed="records are closed: the kernels tally these alone"):
    """Base of the records, extra tallies of a run."""


class Arrivals(Record, frozen=True):
    """Record of each arrival at an aperture: `arrivals` of a result, an `ArrivalTally`."""

    kind: Literal["arrivals"] = "arrivals"


class IrradianceMap(Record, frozen=True):
    """Record of the irradiance on square cells of a horizontal plane (analog).

    Parameters
    ----------
    height : float
        Height of the plane [m], in the water if negative; not 0.
    extent : float
        The map covers |x|, |y| <= extent [m], > 0.
    step : float
        Edge of a cell [m], 0 < step <= 2 extent.
    axis : tuple of float
        Axis of the aperture that the map stands for, as in `Receiver.axis`.
    fov_deg : float
        Full angle of its field of view [deg], 0 < fov_deg <= 180.
    """

    kind: Literal["irradiance-map"] = "irradiance-map"
    height: Finite
    extent: float = Field(gt=0.0, allow_inf_nan=False)
    step: float = Field(gt=0.0, allow_inf_nan=False)
    axis: tuple[Finite, Finite, Finite] = (0.0, 0.0, 1.0)
    fov_deg: float = Field(default=180.0, gt=0.0, le=180.0, allow_inf_nan=False)

    @model_validator(mode="after")
    def _check_plane(self) -> Self:
        # a plane at still water lies in the air at one place and in the water at another
        if self.height == 0.0:
            raise Refused("height", self.height, "> 0 in the air, < 0 in the water")
        if not self.step <= 2.0 * self.extent <= 10_000 * self.step:
            allowed = f"1 to 10000 cells along 2 extent = {2.0 * self.extent:g} m"
            raise Refused("step", self.step, allowed)
        return self

    @property
    def n(self) -> int:
        """Cells along each axis."""
        # 1e-9: no further cell where 2 extent / step exceeds a whole number by rounding alone
        return math.ceil(2.0 * self.extent / self.step - 1e-9)

    @property
    def axes(self) -> Floats:
        """Centres of the cells [m], (n,), the same along x and along y."""
        return np.asarray(-self.extent + self.step * (np.arange(self.n) + 0.5), np.float64)


# `Inside`: `simulate` passes the value on unchecked, and the model with the field checks it
class Shortcuts(TypedDict, total=False):
    """Keywords of `simulate` for the fields of `Meshing` and estimators, which check them."""

    time: Annotated[float, Inside()]
    extent: Annotated[float | None, Inside()]
    spacing: Annotated[float | None, Inside()]
    normals: Annotated[Literal["vertex", "facet"], Inside()]
    waves: Annotated[str | float | Band | None, Inside()]
    batch_size: Annotated[int, Inside()]
    first_photon: Annotated[int, Inside()]
    max_surface_events: Annotated[int, Inside()]
    max_events: Annotated[int, Inside()]
    roulette: Annotated[float | None, Inside()]


class BackgroundOptions(Shortcuts, total=False):
    """Options of `background`, for type checkers."""

    photons: int
    seed: int
    water: str | None
    mesh: Meshing | None
    threads: int | None


class SimulateOptions(Shortcuts, total=False):
    """Options of `simulate`, for type checkers."""

    photons: int | None
    rtol: float | None
    seed: int | None
    mesh: Meshing | None
    threads: int | None
    record: Iterable[Record]
    progress: Callable[[int], None] | None
    per_lamp: bool


class RunOptions(TypedDict, total=False):
    """Options of a run as keywords of a study: `StudyOptions` without chains."""

    seed: int | None
    mesh: Meshing | None
    time: float
    spacing: float | None
    waves: str | float | Band | None
    threads: int | None
    workers: int | str | None
    store: str | Path | None
    progress: Callable[[int], None] | None


class StudyOptions(RunOptions, total=False):
    """Options of a run as keywords of a study of many surfaces.

    Options that are left out come from the scenario, or else have the defaults below.

    Parameters
    ----------
    photons : int, optional
        Chains, common to all surfaces; 2048 by default.
    seed : int, optional
        Seed of the random numbers; 1 by default. Realization i of a sea has the phases of
        `numpy.random.SeedSequence([seed, i])`.
    mesh : Meshing, optional
        Time, resolution and waves of the surface.
    time, spacing, waves
        Fields of `Meshing`, as every other field of it that is no parameter of the study.
    threads : int, optional
        Threads, all cores by default; the result does not depend on them.
    store : path, optional
        File that keeps finished steps: a second call with the same arguments resumes the first.
    workers : int or str, optional
        Processes in place of threads, of which this is one, or the address or file of a running
        dask scheduler.
    progress : callable, optional
        Called with 1 after each step.
    """

    photons: int | None


class Run(Model, frozen=True):
    """Estimator, number of photons, seed and threads of a run.

    Parameters
    ----------
    estimator : Forced or Analog, or "forced" or "analog"
        Estimator with its options; by default forced, and analog over a surface that overhangs.
    photons : int
        Chains (forced, 10 000 by default, >= 32) or photons (analog, 1 000 000), up to 2^53.
    rtol : float, optional
        Relative standard error to reach in every gain, 1e-6 to 1; `photons` is then the
        first guess.
    seed : int
        Key of the random numbers, 0 <= seed < 2^64.
    threads : int, optional
        Threads, 1 to 1024, all cores by default; the result does not depend on them.

    Notes
    -----
    As plain data the options of the estimator stand beside the others, as in [run].
    """

    estimator: FamilyField[Estimator] = converted(default=Forced())
    # never None in a model: `_default_photons` fills it in
    photons: int = Field(default=None, ge=1, le=2**53)  # type: ignore[assignment]
    rtol: float | None = Field(default=None, ge=1e-6, le=1.0, allow_inf_nan=False)
    seed: int = Field(default=1, ge=0, lt=2**64)
    threads: int | None = Field(default=None, ge=1, le=1024)

    @model_validator(mode="before")
    @classmethod
    def _gather(cls, data: Any) -> Any:
        """Move estimator options from the top level into the estimator."""
        # options nested in a table of the estimator are in their place already
        if not isinstance(data, Mapping) or isinstance(data.get("estimator"), Mapping):
            return data
        rest = dict(data)
        chosen = "estimator" in rest
        # raised again with the key of the field: the refusal by `read` does not know it
        try:
            estimator = Estimator.read(rest.pop("estimator", Forced()))
        except Refused as error:
            raise Refused("estimator", error.value, error.allowed, error.hint) from None
        chosen_options = {key: rest.pop(key) for key in type(estimator).model_fields if key in rest}
        for other in Estimator.registered.values():
            for key in other.model_fields.keys() & rest.keys():
                # A file with all options also has those of the other estimator: defaults pass,
                # but another value, which would silently have no effect, is refused.
                if rest.pop(key) != other.model_fields[key].default:
                    kind = other.model_fields["kind"].default
                    raise Refused(key, data[key], f'only with estimator = "{kind}"')
        require_keys(rest, run_keys())
        # left unset, so that a surface with overhangs can still choose the analog estimator
        if not chosen and not chosen_options:
            return rest
        return rest | {"estimator": estimator.replace(**chosen_options)}

    @model_validator(mode="after")
    def _default_photons(self) -> Self:
        # the default depends on the estimator, which the surface may still change
        if self.photons is None:
            # around pydantic: the field counts as unset, so that another estimator renews it
            self.__dict__["photons"] = self.estimator.default_photons
        least = self.estimator.least_photons
        if self.photons < least:
            kind = self.estimator.kind
            raise Refused("photons", self.photons, f"an integer >= {least} for {kind} detection")
        return self

    def to_config(self) -> dict[str, Any]:
        """Return the options as plain data, options of the estimator at the top level."""
        rest = self.model_dump(mode="json", exclude={"estimator"})
        options = self.estimator.model_dump(mode="json")
        return {"estimator": options.pop("kind")} | rest | options


def run_keys() -> list[str]:
    """Return the keys of [run]: fields of `Run` and of the estimators, and `normals`."""
    options = (key for e in Estimator.registered.values() for key in e.model_fields)
    return [key for key in dict.fromkeys([*Run.model_fields, "normals", *options]) if key != "kind"]


def read_records(record: Iterable[Any], estimator: Estimator) -> dict[str, Record]:
    """Return the records of a run by kind.

    Raises
    ------
    Refused
        If there are two of a kind, or a map with the forced estimator.
    """
    records: dict[str, Record] = {}
    # one record, or its name, counts as a list of one; list() would split a name into letters
    try:
        items = [record] if isinstance(record, Record | str) else list(record)
    except TypeError as error:
        raise Refused("record", record, "a list of records") from error
    for i, item in enumerate(items):
        try:
            read = Record.read(item)
        except Refused as error:
            raise error.inside("record", i) from None
        kind = read.model_dump()["kind"]
        # a result has one field for each kind of record
        if kind in records:
            raise Refused(f"record[{i}]", kind, "one record of a kind")
        if isinstance(read, IrradianceMap) and not isinstance(estimator, Analog):
            raise Refused(f"record[{i}]", kind, 'arrivals, or estimator="analog"')
        records[kind] = read
    return records


DEFAULT_WIND_SPEED = 5.0
"""Wind speed of the default sea [m s-1], over a link that names none."""


class Case(NamedTuple):
    """A link over a surface, the options of its run, and further provenance."""

    link: Link
    surface: MeshSource | TriangleMesh
    run: Run = Run()
    meshing: Meshing = Meshing()
    origin: Mapping[str, Any] = MappingProxyType({})  # added to the provenance of results

    def with_options(self, mesh: Meshing | None = None, **options: Any) -> Case:
        """Return the case with fields of `Run`, of its estimator and of `Meshing` replaced."""
        # checked against all names first, so that the hint at a misspelt one covers every model
        require_keys(options, list(dict.fromkeys([*Meshing.model_fields, *run_keys()])))
        fields = {key: options.pop(key) for key in Meshing.model_fields if key in options}
        meshing = (self.meshing if mesh is None else mesh).replace(**fields)
        return self._replace(run=self.run.replace(**options), meshing=meshing)

    def with_waves(self, fading: bool = False) -> Case:
        """Return the case with `meshing.waves` moved into its sea, as the band that a mesh holds.

        `fading` tells `resolve_band` whether the study is about fading.
        """
        # fixed in the sea, so that links derived from this one use the same waves
        surface = resolve_band(self.link, self.surface, self.meshing.waves, fading)
        return self._replace(surface=surface, meshing=self.meshing.replace(waves=None))

    @property
    def threads(self) -> int:
        """Threads of the run, all cores by default."""
        return default_threads(self.run.threads)


@runtime_checkable
class HasCase(Protocol):
    """Protocol of objects with a link, surface and options, such as a `Scenario`."""

    def case(
        self,
        surface: MeshSource | TriangleMesh | None = None,
        fading: bool = False,
        mesh: Meshing | None = None,
        **options: Any,
    ) -> Case:
        """Return the inputs of the run, with replacements; see `resolve`."""
        ...


def resolve(
    link: Link | HasCase,
    surface: MeshSource | TriangleMesh | None = None,
    fading: bool = False,
    mesh: Meshing | None = None,
    **options: Any,
) -> Case:
    """Return the case of a link and a surface, or of a scenario.

    Parameters
    ----------
    link : Link or Scenario
        A scenario includes its surface and options.
    surface : MeshSource or TriangleMesh, optional
        By default that of the scenario; over a link the JONSWAP sea of the wind of its bubbles
        and whitecaps, or of 5 m/s.
    fading : bool
        Whether the answer of the study is about fading: a sea whose waves were left open then has
        all that make the light of the link fade (`fading.resolve_band`).
    mesh : Meshing, optional
        Time, resolution and waves of the surface.
    **options
        Fields of `Run`, of its estimator and of `Meshing`.

    Returns
    -------
    Case
        With the waves of the mesh in its surface: those of `meshing` are None.

    Raises
    ------
    Refused
        If one of them is something else, or the sea has no such waves.
    """
    if isinstance(link, HasCase):
        return link.case(surface, fading, mesh, **options)
    if not isinstance(link, Link):
        raise Refused("link", Described(type(link).__name__), "a Link or a Scenario")
    if surface is None:
        from meshtrace.surfaces import sea_in_wind

        # bubbles and foam are those of a wind, which makes the sea as well
        wind_speed = DEFAULT_WIND_SPEED if link.wind_speed is None else link.wind_speed
        surface = sea_in_wind(wind_speed)
    require_surface(surface)
    # options first: `waves` is one of them
    return Case(link, surface).with_options(mesh, **options).with_waves(fading)
