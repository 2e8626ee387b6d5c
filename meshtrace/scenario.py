"""Link files: TOML to a link, a sea and run options, and back.

A scenario is everything that one run depends on. This is the only module that joins the core
with `meshtrace.surfaces`, by late imports.
"""

from __future__ import annotations

import difflib
import math
import os
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, TypeVar, get_args

import pydantic
from pydantic import Field, field_validator, model_validator

from meshtrace.detector import OokLink
from meshtrace.link import (
    Aperture,
    Footprint,
    IrradiancePlanes,
    Link,
    Physics,
    Source,
    Whitecaps,
)
from meshtrace.mesh import SurfaceModel, TriangleMesh
from meshtrace.optics.bubbles import HallNovarini
from meshtrace.optics.phase import AnyPhase, FournierForand
from meshtrace.optics.water import WATER_TYPES, Water
from meshtrace.result import GainResult
from meshtrace.simulate import DEFAULT_PHOTONS, mesh_for, simulate
from meshtrace.sipm import LedDriver, OpticalFrontEnd, SiPM, Tia
from meshtrace.transport.forced import crossing_reach
from meshtrace.uav import UAVS, Uav

if TYPE_CHECKING:
    from meshtrace.performance import LinkPerformance
    from meshtrace.series import GainSeries

KEYS = (
    "wind_speed",
    "physics",
    "whitecaps",
    "n_air",
    "sea",
    "water",
    "bubbles",
    "transmitter",
    "receiver",
    "planes",
    "detector",
    "uav",
    "run",
)
"""Keys at the top of a link file."""

DEFAULT_WIND_SPEED = 5.0

MOST_VERTICES = 10_000_000
"""Vertices of a mesh, at some 0.5 kB each, beyond which a run is refused."""

MOST_FACTORS = 50_000_000
"""Waves times grid lines, at some 50 B each, beyond which a run is refused."""

LARGEST = 1e30
"""Magnitude of a number beyond which its square may overflow on the way to a gain."""

_PRESETS = {"physical": Physics(), "paper": Physics.paper()}
_DETECTOR_PRESETS = ("physical", "paper", "paper-ranges")
_DETECTOR_PARTS: dict[str, type[pydantic.BaseModel]] = {
    "led": LedDriver,
    "sipm": SiPM,
    "tia": Tia,
    "optics": OpticalFrontEnd,
}
_SEA_ALIASES = {"sinusoidal": "sinusoid", "tilted-plane": "plane"}

Model = TypeVar("Model", bound=pydantic.BaseModel)
Table = dict[str, Any]


class ScenarioError(ValueError):
    """One line that names the field, its value, and what is allowed."""

    def __init__(self, text: str) -> None:
        # keys of a file may hold line ends and control characters
        shown = (c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
        super().__init__("".join(shown))


class Sampling(pydantic.BaseModel, frozen=True, extra="forbid"):
    """When the sea is triangulated, and how finely.

    Parameters
    ----------
    time : float
        Time of the sea [s].
    extent, spacing : float, optional
        Half-width and spacing of the mesh [m]; by default those of `Link.footprint`.
    """

    time: float = Field(0.0, allow_inf_nan=False)
    extent: float | None = Field(None, gt=0.0, allow_inf_nan=False)
    spacing: float | None = Field(None, gt=0.0, allow_inf_nan=False)


class Run(pydantic.BaseModel, frozen=True, extra="forbid"):
    """Options of `meshtrace.simulate`, under the same names.

    Parameters
    ----------
    estimator : {"forced", "analog"}
        How the gain is estimated.
    photons : int
        Chains (forced) or photons (analog); the default is that of `simulate`.
    rtol : float, optional
        Relative standard error to reach.
    seed : int
        Key of the random numbers.
    normals : {"vertex", "facet"}
        Normals of the surface.
    threads : int, optional
        Threads, all cores by default.
    reflected_photons, batch_size, first_photon, max_surface_events, max_events, roulette
        See `meshtrace.simulate`.
    """

    estimator: str = next(iter(DEFAULT_PHOTONS))
    photons: int = Field(ge=1, le=2**53)
    rtol: float | None = Field(None, ge=1e-6, le=1.0, allow_inf_nan=False)
    seed: int = Field(1, ge=0, lt=2**64)
    normals: Literal["vertex", "facet"] = "vertex"
    threads: int | None = Field(None, ge=1, le=1024)
    reflected_photons: int = Field(0, ge=0, le=2**53)
    batch_size: int = Field(2**17, ge=4096, le=2**18, multiple_of=4096)
    first_photon: int = Field(0, ge=0, le=2**53)
    max_surface_events: int = Field(10, ge=1, le=2**31)
    max_events: int = Field(100_000, ge=1, le=2**31)
    roulette: float | None = Field(None, ge=0.0, le=1.0, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _default_photons(cls, data: Any) -> Any:
        estimator = data.get("estimator", next(iter(DEFAULT_PHOTONS)))
        return {"photons": DEFAULT_PHOTONS.get(str(estimator), 1), **data}

    @field_validator("estimator")
    @classmethod
    def _known_estimator(cls, estimator: str) -> str:
        if estimator not in DEFAULT_PHOTONS:
            raise ValueError(f"estimator: {estimator!r}, allowed {' or '.join(DEFAULT_PHOTONS)}")
        return estimator


_SEA_KEYS = ("spectrum", "mesh", *Sampling.model_fields)


class MeshFile(pydantic.BaseModel, frozen=True, extra="forbid"):
    """A surface made elsewhere, in a file that `meshtrace.surfaces.from_trimesh` reads.

    Parameters
    ----------
    file : str
        Path of an STL, PLY or OBJ file.
    """

    kind: Literal["mesh"] = "mesh"
    file: str

    def load(self, extent: float | None = None) -> TriangleMesh:
        """Return the mesh.

        Parameters
        ----------
        extent : float, optional
            Half-length of the square |x|, |y| <= extent that it has to cover [m].

        Raises
        ------
        ScenarioError
            If it cannot be read, is not a surface facing up, or does not cover the square.
        """
        from meshtrace.surfaces import from_trimesh

        try:
            return from_trimesh(self.file, extent=extent)
        except Exception as error:  # the readers behind trimesh raise whatever they stumble over
            problem = _one_line(str(error)) or type(error).__name__
            if ", allowed" not in problem:
                problem += ", allowed: a surface in an STL, PLY or OBJ file"
            raise ScenarioError(f"sea.mesh: {self.file!r}: {_colon(problem)}") from error


class Scenario(pydantic.BaseModel, frozen=True, extra="forbid"):
    """Everything that one run depends on; what a link file says.

    Parameters
    ----------
    wind_speed : float
        Wind speed at 10 m [m s-1]; the sea, bubbles and whitecaps of a link file follow it.
    link : Link
        The link.
    surface : SurfaceModel or MeshFile
        The sea.
    sampling : Sampling
        When the sea is triangulated, and how finely.
    run : Run
        Options of the run.
    detector : OokLink, optional
        Electronics and modulation; power, wavelength, aperture and field of view are the link's.
    uav : Uav, optional
        Airframe that carries the receiver.

    Notes
    -----
    Scenarios come from link files (`load`, `from_toml`), plain data (`from_config`) or results
    (`from_provenance`), and go back by `to_toml` or `to_config`.

    Examples
    --------
    >>> scenario = Scenario.from_toml("wind_speed = 13.0")
    >>> scenario.surface.wind_speed, scenario.link.bubbles.wind_speed
    (13.0, 13.0)
    >>> Scenario.from_toml(scenario.to_toml()) == scenario
    True
    """

    wind_speed: float
    link: Link
    surface: Any
    sampling: Sampling
    run: Run
    detector: OokLink | None = None
    uav: Uav | None = None

    @field_validator("surface")
    @classmethod
    def _known_surface(cls, surface: Any) -> Any:
        if not isinstance(surface, SurfaceModel | MeshFile):
            raise ValueError(
                f"surface: {type(surface).__name__}, allowed a sea (SurfaceModel) or a MeshFile"
            )
        return surface

    @classmethod
    def load(cls, path: str | Path, changes: Mapping[str, Any] | None = None) -> Self:
        """Read a link file.

        Parameters
        ----------
        path : path
            TOML file; a mesh file that it names is looked for beside it.
        changes : mapping of str to value, optional
            Values that replace those of the file, by dotted key such as "transmitter.depth".

        Raises
        ------
        ScenarioError
            If the file cannot be read or a value is not allowed.
        """
        try:
            text = Path(path).read_text(encoding="utf-8")
        except OSError as error:
            raise ScenarioError(f"{path}: {error.strerror}, allowed: a TOML file") from error
        except UnicodeDecodeError as error:
            raise ScenarioError(f"{path}: {error}, allowed: a TOML file in UTF-8") from error
        return cls.from_toml(text, source=str(path), folder=Path(path).parent, changes=changes)

    @classmethod
    def from_toml(
        cls,
        text: str,
        *,
        source: str | None = None,
        folder: str | Path = ".",
        changes: Mapping[str, Any] | None = None,
    ) -> Self:
        """Read the text of a link file.

        Parameters
        ----------
        text : str
            TOML.
        source : str, optional
            Name that errors begin with.
        folder : path
            Where a mesh file is looked for.
        changes : mapping of str to value, optional
            See `load`.

        Raises
        ------
        ScenarioError
            If the text is not TOML or a value is not allowed.
        """
        try:
            config = _parse_toml(text)
            for key, value in (changes or {}).items():
                _set(config, key, value)
            return cls.from_config(config, folder=folder)
        except ScenarioError as error:
            raise ScenarioError(f"{source}: {error}" if source else str(error)) from error

    @classmethod
    def from_config(cls, config: Mapping[str, Any], *, folder: str | Path = ".") -> Self:
        """Build the scenario that plain data describes, in the keys of a link file.

        Raises
        ------
        ScenarioError
            If a key is unknown or a value is not allowed.

        Notes
        -----
        `physics="paper"` also sets the printed forms that lie outside `Physics`, where they are
        not given: `cdf_coef` of a Fournier-Forand phase function; psi, q and depth of the
        bubbles; whitecaps "paper_0255". The estimator is "forced" unless given, or "analog" for
        a link that forced detection cannot follow.
        """
        _refuse_numbers(config)
        _refuse_unknown(config, KEYS, "")
        wind_speed = config.get("wind_speed", DEFAULT_WIND_SPEED)
        if not _is_number(wind_speed) or not 0.0 <= wind_speed <= 60.0:
            raise ScenarioError(
                f"wind_speed: {_show(wind_speed)}, allowed: 0 <= wind_speed <= 60 m/s"
            )
        sea = _table(config.get("sea", {}), "sea")
        sampling = {key: sea.pop(key) for key in Sampling.model_fields if key in sea}
        surface = _surface(sea, wind_speed, sampling, Path(folder))
        link = _link(config, wind_speed)
        run = {"estimator": _default_estimator(link), **_table(config.get("run", {}), "run")}
        return cls(
            wind_speed=wind_speed,
            link=link,
            surface=surface,
            sampling=_validated(Sampling, sampling, "sea"),
            run=_validated(Run, run, "run"),
            detector=_detector(config["detector"]) if "detector" in config else None,
            uav=_uav(config["uav"]) if "uav" in config else None,
        )

    @classmethod
    def from_provenance(cls, provenance: Mapping[str, Any]) -> Self:
        """Return the scenario of a result.

        Parameters
        ----------
        provenance : mapping
            `GainResult.provenance`.

        Raises
        ------
        ScenarioError
            If the surface was a mesh that came from no file, or a model of the user's own.

        Notes
        -----
        The number of threads, on which no result depends, is not taken over.
        """
        run = {k: v for k, v in provenance["run"].items() if k != "threads"}
        link = Link.model_validate(provenance["link"])
        surface = _surface_from_provenance(provenance)
        return cls(
            wind_speed=_wind_of(link, surface),
            link=link,
            surface=surface,
            sampling=Sampling(**{k: v for k, v in run.items() if k in Sampling.model_fields}),
            run=Run(**{k: v for k, v in run.items() if k in Run.model_fields}),
        )

    def to_config(self) -> Table:
        """Return the full configuration as plain data, in the keys of a link file.

        What follows `wind_speed`, the water or the transmitter is left to follow it.
        """
        link, still = self.link, isinstance(self.surface, MeshFile)
        sampling = self.sampling.model_dump(exclude_none=True, exclude={"time"} if still else None)
        return {
            "wind_speed": self.wind_speed,
            "physics": _physics_config(link.physics),
            "whitecaps": self._whitecaps_config(),
            "n_air": link.n_air,
            "sea": {**self._surface_config(), **sampling},
            "water": link.water.model_dump(mode="json", exclude_none=True),
            "bubbles": self._bubbles_config(),
            "transmitter": _plain(link.transmitter),
            "receiver": _plain(link.receiver),
            **({"planes": _plain(link.planes)} if link.planes else {}),
            **({"detector": _plain(self.detector)} if self.detector else {}),
            **({"uav": _plain(self.uav)} if self.uav else {}),
            "run": _plain(self.run),
        }

    def to_toml(self) -> str:
        """Return the full configuration as the text of a link file, which loads back."""
        import tomli_w

        return tomli_w.dumps(self.to_config())

    def _surface_config(self) -> Table:
        if isinstance(self.surface, MeshFile):
            return {"mesh": self.surface.file}
        config = dict(self.surface.to_config())
        kind = config.pop("kind")
        if kind == "spectral":
            config["spectrum"] = self._followed(config["spectrum"])
            return config
        return {"spectrum": kind, **self._followed(config)}

    def _bubbles_config(self) -> Table:
        bubbles, link = self.link.bubbles, self.link
        if bubbles is None:
            return {"model": "none"}
        config = self._followed(bubbles.model_dump(mode="json"))
        for key, value in _bubble_defaults(link.water, link.transmitters[0]).items():
            if config[key] == value:
                del config[key]
        return {"model": config.pop("kind"), **config}

    def _whitecaps_config(self) -> Any:
        if self.link.whitecaps is None:
            return "none"
        config = self._followed(self.link.whitecaps.model_dump())
        return config if "wind_speed" in config else config["model"]

    def _followed(self, config: Table) -> Table:
        """Return the table without a wind speed that is that of the scenario."""
        same = config.get("wind_speed") == self.wind_speed
        return {k: v for k, v in config.items() if not (same and k == "wind_speed")}

    def mesh(self) -> TriangleMesh:
        """Return the surface as the run needs it.

        Raises
        ------
        ScenarioError
            If it does not cover the link, or reaches a source or a receiver, or the estimator
            cannot follow the link.
        """
        sampling = self.sampling.model_dump()
        with _named_as_in_files():
            reach = None if self.run.estimator == "analog" else crossing_reach(self.link)
            return mesh_for(self.link, self._runnable(), **sampling, reach=reach)[0]

    def simulate(self, progress: Callable[[int], None] | None = None) -> GainResult:
        """Run the scenario.

        Parameters
        ----------
        progress : callable, optional
            Called with the number of photons done since its last call.

        Returns
        -------
        GainResult
            Its provenance loads back by `from_provenance`.

        Raises
        ------
        ScenarioError
            If the surface does not suit the link.
        """
        options: Any = {**self.sampling.model_dump(), **self.run.model_dump()}
        with _named_as_in_files():
            result = simulate(self.link, self._runnable(), progress=progress, **options)
            _refuse_overflow(result)
        if isinstance(self.surface, MeshFile):
            return replace(result, provenance={**result.provenance, "mesh_file": self.surface.file})
        return result

    def time_series(
        self, times: Sequence[float], progress: Callable[[int], None] | None = None
    ) -> GainSeries:
        """Return the gain over the moving sea at times [s], see `meshtrace.time_series`.

        Raises
        ------
        ScenarioError
            If the surface does not move, or the link needs the analog estimator.
        """
        from meshtrace.series import time_series

        options: Any = self._series_options(moving=True)
        with _named_as_in_files():
            return time_series(self.link, self.surface, times, progress=progress, **options)

    def ensemble(
        self, n_realizations: int, progress: Callable[[int], None] | None = None
    ) -> GainSeries:
        """Return the gains over realizations of the sea, see `meshtrace.ensemble`.

        Raises
        ------
        ScenarioError
            If the sea has no random phases, or the link needs the analog estimator.
        """
        from meshtrace.series import ensemble

        options: Any = {**self._series_options(), "time": self.sampling.time}
        with _named_as_in_files():
            return ensemble(self.link, n_realizations, self.surface, progress=progress, **options)

    def performance(
        self, progress: Callable[[int], None] | None = None, **options: Any
    ) -> LinkPerformance:
        """Return error rate, outage and capacity, see `meshtrace.link_performance`.

        Parameters
        ----------
        progress : callable, optional
            Called with 1 after each sea.
        **options
            Those of `link_performance`; `ook` and `uav` are by default those of the scenario.

        Raises
        ------
        ScenarioError
            If an option is out of range, or the link needs the analog estimator.
        """
        from meshtrace.performance import link_performance

        run = self._series_options()
        shared: Any = {key: run[key] for key in ("photons", "seed", "spacing", "threads")}
        mine = {"ook": self.detector or "physical", "uav": self.uav}
        with _named_as_in_files():
            return link_performance(
                self.link,
                self.surface,
                wind_speed=self.wind_speed,
                progress=progress,
                **{**shared, **mine, **options},
            )

    def _series_options(self, moving: bool = False) -> dict[str, Any]:
        """Return what `series` takes of the run, refusing what only single runs follow."""
        if self.run.estimator != "forced":
            raise ScenarioError(
                f"run.estimator: {_show(self.run.estimator)}, allowed: forced, over many seas"
            )
        if isinstance(self.surface, MeshFile):
            raise ScenarioError(f"sea.mesh: {_show(self.surface.file)}, allowed: a sea model")
        if moving and self.sampling.time != 0.0:
            raise ScenarioError(f"sea.time: {self.sampling.time:g}, allowed: 0 with times")
        _refuse_huge(self.surface, self.link.footprint(), self.sampling)
        run = self.run.model_dump(include={"photons", "seed", "normals", "threads"})
        return {**run, **self.sampling.model_dump(include={"extent", "spacing"})}

    def _runnable(self) -> SurfaceModel | TriangleMesh:
        footprint = self.link.footprint()
        if isinstance(self.surface, MeshFile):
            return self.surface.load(self.sampling.extent or footprint.fine_extent)
        _refuse_huge(self.surface, footprint, self.sampling)
        return self.surface


def _parse_toml(text: str) -> Table:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(f"{_one_line(str(error))}, allowed: TOML") from error
    except RecursionError as error:
        raise ScenarioError("nested too deeply, allowed: tables of a link file") from error


def parse_setting(setting: str) -> tuple[str, Any]:
    """Split "key=value" into the dotted key and its value, read as TOML or else as a word.

    Raises
    ------
    ScenarioError
        If there is no "=" or no key.

    Examples
    --------
    >>> parse_setting("transmitter.depth=20.0")
    ('transmitter.depth', 20.0)
    >>> parse_setting("sea.spectrum=flat")
    ('sea.spectrum', 'flat')
    """
    key, equals, value = setting.partition("=")
    if not equals or not key.strip():
        raise ScenarioError(f"{setting!r}, allowed: key=value, as in transmitter.depth=20.0")
    try:
        return key.strip(), tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return key.strip(), value.strip()


def _set(config: Table, key: str, value: Any) -> None:
    """Set the value at a dotted key of nested tables."""
    *parents, last = key.split(".")
    table: Any = config
    for name in parents:
        table = table.setdefault(name, {})
        if not isinstance(table, dict):
            raise ScenarioError(f"{key}: {_show(value)}, allowed: a key in a table")
    table[last] = value


def _link(config: Mapping[str, Any], wind_speed: float) -> Link:
    choice = config.get("physics", "physical")
    printed = choice == "paper"
    sources = _one_or_more(Source, config.get("transmitter", {}), "transmitter", "led")
    first = sources[0] if isinstance(sources, tuple) and sources else sources
    if not first:
        raise ScenarioError("transmitter: [], allowed: at least one source")
    water = _water(config.get("water", {}), first.wavelength_nm, printed)
    parts: Table = {
        "physics": _physics(choice),
        "transmitter": sources,
        "receiver": _one_or_more(Aperture, config.get("receiver", {}), "receiver", "receiver"),
        "water": water,
        "bubbles": _bubbles(
            config.get("bubbles", {}), wind_speed, _bubble_defaults(water, first), printed
        ),
        "whitecaps": _whitecaps(config.get("whitecaps", {}), wind_speed, printed),
    }
    if "planes" in config:
        parts["planes"] = _validated(IrradiancePlanes, config["planes"], "planes")
    if "n_air" in config:
        parts["n_air"] = config["n_air"]
    return _validated(Link, parts, "")


def _default_estimator(link: Link) -> str:
    try:
        crossing_reach(link)
    except ValueError:
        return "analog"
    return "forced"


def _physics(choice: Any) -> Physics:
    if not isinstance(choice, str):
        return _validated(Physics, choice, "physics")
    _refuse_unlisted(choice, tuple(_PRESETS), "physics")
    return _PRESETS[choice]


def _one_or_more(union: Any, value: Any, path: str, default: str) -> Any:
    """Return the model of a table, or the tuple of those of a list of tables."""
    if isinstance(value, list | tuple):
        return tuple(
            _of_kind(union, item, f"{path}[{i}]", "kind", default) for i, item in enumerate(value)
        )
    return _of_kind(union, value, path, "kind", default)


def _water(value: Any, wavelength_nm: float, printed: bool) -> Water:
    table = _table(value, "water")
    if "phase" in table:
        table["phase"] = _phase(table["phase"], "water.phase")
    if "layers" in table:
        _refuse_ragged(table["layers"], "water.layers")
    if "type" in table:
        table = {**_typed_water(table.pop("type"), wavelength_nm, "layers" in table), **table}
    water = _validated(Water, table, "water", ("type", *Water.model_fields))
    phase = water.phase
    if printed and isinstance(phase, FournierForand) and "cdf_coef" not in phase.model_fields_set:
        phase = phase.model_copy(update={"cdf_coef": "paper"})
    return water.model_copy(update={"phase": phase})


def _typed_water(type: Any, wavelength_nm: float, layered: bool) -> Table:
    _refuse_unlisted(type, WATER_TYPES, "water.type")
    try:
        water = Water.from_type(type, wavelength_nm)
    except ValueError as error:
        raise ScenarioError(f"transmitter.{_colon(str(error))} for water {type}") from error
    return {"phase": water.phase, **({} if layered else {"a": water.a, "b": water.b})}


def _phase(value: Any, path: str) -> Any:
    table: Table = {"model": value} if isinstance(value, str) else _table(value, path)
    parts = table.get("components")
    if isinstance(parts, list | tuple):
        table["components"] = tuple(
            _phase(item, f"{path}.components[{i}]") for i, item in enumerate(parts)
        )
    return _of_kind(AnyPhase, table, path, "model", "fournier-forand")


def _bubble_defaults(water: Water, source: Any) -> Table:
    """Return what bubbles share with their surroundings."""
    return {"n_water": water.n, "wavelength_nm": source.wavelength_nm}


def _bubbles(value: Any, wind_speed: float, shared: Table, printed: bool) -> HallNovarini | None:
    table = {"model": value} if isinstance(value, str) else _table(value, "bubbles")
    model = table.pop("model", table.pop("kind", "hall-novarini"))
    _refuse_unlisted(model, ("hall-novarini", "none"), "bubbles.model")
    keys = ("model", *(key for key in HallNovarini.model_fields if key != "kind"))
    _refuse_unknown(table, keys, "bubbles")
    paper = {"psi": "paper", "q": 2.0, "depth": "mean_level"} if printed else {}
    table = {"wind_speed": wind_speed, **shared, **paper, **table}
    if model == "none" or table["wind_speed"] == 0.0:
        return None
    return _validated(HallNovarini, table, "bubbles")


def _whitecaps(value: Any, wind_speed: float, printed: bool) -> Whitecaps | None:
    table = {"model": value} if isinstance(value, str) else _table(value, "whitecaps")
    table = {
        "wind_speed": wind_speed,
        "model": "paper_0255" if printed else "w_0225",
        **table,
    }
    models = get_args(Whitecaps.model_fields["model"].annotation)
    _refuse_unlisted(table["model"], (*models, "none"), "whitecaps.model")
    _refuse_unknown(table, tuple(Whitecaps.model_fields), "whitecaps")
    if table["model"] == "none" or table["wind_speed"] == 0.0:
        return None
    return _validated(Whitecaps, table, "whitecaps")


def _detector(value: Any) -> OokLink:
    """Return the transmission of [detector]: fields that replace those of a preset."""
    table: Table = {"preset": value} if isinstance(value, str) else _table(value, "detector")
    preset: Any = table.pop("preset", "physical")
    _refuse_unlisted(preset, _DETECTOR_PRESETS, "detector.preset")
    base = OokLink.preset(preset)
    for name, model in _DETECTOR_PARTS.items():
        if name in table:
            part = {**dict(getattr(base, name)), **_table(table[name], f"detector.{name}")}
            table[name] = _validated(model, part, f"detector.{name}")
    keys = ("preset", *OokLink.model_fields)
    return _validated(OokLink, {**dict(base), **table}, "detector", keys)


def _uav(value: Any) -> Uav:
    """Return the airframe of [uav]: fields that replace those of a known one."""
    table = {"preset": value} if isinstance(value, str) else _table(value, "uav")
    preset = table.pop("preset", next(iter(UAVS)))
    _refuse_unlisted(preset, tuple(UAVS), "uav.preset")
    base = UAVS[preset].model_dump()
    return _validated(Uav, {**base, **table}, "uav", ("preset", *Uav.model_fields))


def _surface(table: Table, wind_speed: float, sampling: Mapping[str, Any], folder: Path) -> Any:
    """Return the surface of [sea], of which `sampling` has been taken out."""
    if "mesh" in table:
        return _mesh_file(table, sampling, folder)
    from meshtrace.surfaces.seas import FlatSea, Sea
    from meshtrace.surfaces.spectra import Spectrum
    from meshtrace.surfaces.spreading import Spreading

    seas, spectra = _kinds(Sea), _kinds(Spectrum)
    word = table.pop("spectrum", table.pop("kind", "jonswap"))
    own = isinstance(word, Mapping)
    if not own:
        _refuse_unlisted(word, _sea_words(seas, spectra), "sea.spectrum")
    kind, table = _sea_kind(word, table, seas, spectra)
    inline = spectra[word].model_fields if kind == "spectral" and not own else ()
    keys = tuple(dict.fromkeys([*_SEA_KEYS, *inline, *seas[kind].model_fields]))
    driven = {"jonswap": table, "spectral": table.get("spectrum")}.get(kind)
    if driven is not None and driven.setdefault("wind_speed", wind_speed) == 0.0:
        _refuse_unknown(table, keys, "sea")
        return FlatSea()
    if kind == "spectral":
        path = "sea.spectrum" if own else "sea"
        table["spectrum"] = _of_kind(Spectrum, table["spectrum"], path, "kind", "jonswap")
    if "spreading" in table:
        table["spreading"] = _of_kind(
            Spreading, table["spreading"], "sea.spreading", "kind", "ittc"
        )
    return _validated(seas[kind], table, "sea", keys)


def _sea_words(seas: Iterable[str], spectra: Iterable[str]) -> tuple[str, ...]:
    """Return what `spectrum` may be in [sea]: kinds of sea, and spectra of a spectral sea."""
    words = dict.fromkeys([*seas, *_SEA_ALIASES, *spectra])
    return tuple(word for word in words if word != "spectral")


def _sea_kind(
    word: Any, table: Table, seas: Iterable[str], spectra: Mapping[str, type[pydantic.BaseModel]]
) -> tuple[str, Table]:
    """Return the kind of sea, and its table with the keys of a spectrum in a table of their own."""
    if isinstance(word, Mapping):
        return "spectral", {**table, "spectrum": dict(word)}
    if word in seas or word in _SEA_ALIASES:
        return _SEA_ALIASES.get(word, word), table
    fields = spectra[word].model_fields
    spectrum = {key: value for key, value in table.items() if key in fields}
    rest = {key: value for key, value in table.items() if key not in fields}
    return "spectral", {**rest, "spectrum": {**spectrum, "kind": word}}


def _mesh_file(table: Table, sampling: Mapping[str, Any], folder: Path) -> MeshFile:
    for key, value in {**table, **sampling}.items():
        if key not in ("mesh", "extent"):
            raise ScenarioError(f"sea.{key}: {_show(value)}, allowed: beside mesh only extent")
    name = table["mesh"]
    if not isinstance(name, str) or not os.path.isfile(folder / name):
        raise ScenarioError(f"sea.mesh: {_show(name)}, allowed: an STL, PLY or OBJ file")
    return MeshFile(file=str((folder / name).resolve()))


def _surface_from_provenance(provenance: Mapping[str, Any]) -> SurfaceModel | MeshFile:
    from meshtrace.surfaces import sea_from_config

    config = provenance["surface"]
    if "mesh_file" in provenance:
        return MeshFile(file=provenance["mesh_file"])
    try:
        return sea_from_config(config)
    except pydantic.ValidationError as error:
        kind = config.get("kind")
        raise ScenarioError(
            f"surface: {_show(kind)}, allowed: a sea of meshtrace.surfaces or a mesh from a file"
        ) from error


def _wind_of(link: Link, surface: Any) -> float:
    """Return the wind speed of the first part that has one, 0 for a calm sea."""
    parts = (getattr(surface, "spectrum", None), link.bubbles, link.whitecaps)
    return next((part.wind_speed for part in parts if part is not None), 0.0)


def _refuse_huge(surface: SurfaceModel, footprint: Footprint, sampling: Sampling) -> None:
    """Refuse meshes and wave sums that would fill the memory."""
    from meshtrace.surfaces.gridding import grid_axis

    spacing = sampling.spacing or footprint.spacing
    if sampling.extent is None:
        coarse = max(footprint.coarse_spacing, spacing)
        lines = len(grid_axis(0.0, footprint.extent, spacing, footprint.fine_extent, coarse))
    else:
        lines = len(grid_axis(0.0, sampling.extent, spacing))
    if lines**2 > MOST_VERTICES:
        raise ScenarioError(
            f"sea.spacing: {spacing:g} m makes {lines**2} vertices, allowed: at most "
            f"{MOST_VERTICES} vertices"
        )
    waves = len(surface.components.amplitude) if hasattr(surface, "components") else 0
    if waves * lines > MOST_FACTORS:
        raise ScenarioError(
            f"sea.d_omega: {waves} waves on {lines} grid lines, allowed: a product of at most "
            f"{MOST_FACTORS}"
        )


def _physics_config(physics: Physics) -> Any:
    names = (name for name, preset in _PRESETS.items() if preset == physics)
    return next(names, physics.model_dump())


def _plain(part: Any) -> Any:
    """Return a model, or a tuple of them, as plain data."""
    if isinstance(part, tuple):
        return [_plain(item) for item in part]
    return part.model_dump(mode="json", exclude_none=True)


def _kinds(union: Any) -> dict[str, type[pydantic.BaseModel]]:
    """Return the models of a union that is told apart by `kind`."""
    return {m.model_fields["kind"].default: m for m in get_args(get_args(union)[0])}


def _of_kind(union: Any, value: Any, path: str, key: str, default: str) -> Any:
    """Return the model of a table, or of a bare word, that says its kind under `key`."""
    table = {key: value} if isinstance(value, str) else _table(value, path)
    models = _kinds(union)
    word = key if key in table else "kind"
    kind = table.pop(word, default)
    _refuse_unlisted(kind, tuple(models), f"{path}.{word}")
    model = models[kind]
    keys = (key, *(name for name in _keys(model) if name != "kind"))
    return _validated(model, table, path, keys)


def _keys(model: type[pydantic.BaseModel]) -> tuple[str, ...]:
    aliases = (f.alias for f in model.model_fields.values() if f.alias)
    return (*model.model_fields, *aliases)


def _table(value: Any, path: str) -> Table:
    """Return a copy of a table, refusing what is none."""
    if not isinstance(value, Mapping):
        raise ScenarioError(f"{path}: {_show(value)}, allowed: a table")
    return dict(value)


def _validated(
    model: type[Model], value: Any, path: str, keys: tuple[str, ...] | None = None
) -> Model:
    """Return the model that a table describes, with all errors in the words of link files."""
    table = _table(value, path)
    _refuse_unknown(table, keys or _keys(model), path)
    _refuse_words(model, table, path)
    try:
        return model.model_validate(table)
    except pydantic.ValidationError as error:
        raise ScenarioError(_problem(error, path)) from error
    except ArithmeticError as error:
        raise ScenarioError(
            f"{path}: {_show(table)}, allowed: numbers that do not overflow ({error})"
        ) from error


def _problem(error: pydantic.ValidationError, path: str) -> str:
    """Return the first error of pydantic as one line: field, value, what is allowed."""
    first = error.errors(include_url=False)[0]
    where, value = _join(path, *first["loc"]), _show(first["input"])
    text = first["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    if first["type"] == "missing":
        return f"{where}: missing, allowed: a value"
    name, colon, _ = text.partition(": ")
    if colon and ", allowed" in text:  # our own, which name field and value themselves
        parent = first["loc"][:-1] if first["loc"][-1:] == (name,) else first["loc"]
        return _colon(_named(text, path, parent))
    allowed = re.sub("(?i)tuple", "list", text.removeprefix("allowed").lstrip(": "))
    return _one_line(f"{where}: {value}, allowed: {allowed}")


def _named(text: str, path: str, parent: tuple[int | str, ...] = ()) -> str:
    """Put a message that begins with its field into the words of link files."""
    name, _, rest = text.partition(": ")
    head, dot, tail = name.partition(".")
    if head in _kinds(Source):
        return f"transmitter{dot}{tail}: {rest}"
    if head in _kinds(Aperture):
        return f"receiver{dot}{tail}: {rest}"
    return f"{_join(path, *parent, name)}: {rest}"


@contextmanager
def _named_as_in_files() -> Iterator[None]:
    """Turn an error about a field into a ScenarioError that names it as link files do."""
    try:
        yield
    except ScenarioError:
        raise
    except ArithmeticError as error:
        raise ScenarioError(f"link: {error}, allowed: numbers that do not overflow") from error
    except ValueError as error:
        text = _one_line(str(error))
        name, colon, _ = text.partition(": ")
        if not colon or ", allowed" not in text:
            raise
        path = ""
        if name in Sampling.model_fields:
            path = "sea"
        elif name in Run.model_fields:
            path = "run"
        raise ScenarioError(_colon(_named(text, path))) from error


def _refuse_overflow(result: GainResult) -> None:
    """Refuse a gain that is no number, which only numbers far from any link give."""
    gains = [result.gain] if isinstance(result.gain, float) else result.gain.tolist()
    for gain in gains:
        if not math.isfinite(gain):
            raise ScenarioError(f"link: a gain of {gain}, allowed: numbers that do not overflow")


def _refuse_numbers(config: Mapping[str, Any]) -> None:
    """Refuse numbers that no key takes: not finite, or integers of more than 64 bits."""
    for path, value in _leaves(config):
        if isinstance(value, float) and not math.isfinite(value):
            raise ScenarioError(f"{path}: {value}, allowed: finite numbers")
        if isinstance(value, float) and abs(value) > LARGEST:
            raise ScenarioError(f"{path}: {value:g}, allowed: at most {LARGEST:g} in magnitude")
        if isinstance(value, int) and abs(value) >= 2**64:
            raise ScenarioError(f"{path}: {_show(value)}, allowed: integers of 64 bits")


def _refuse_words(model: type[pydantic.BaseModel], table: Table, path: str) -> None:
    """Refuse true, false and quoted numbers where pydantic would take them for numbers."""
    flags = {name for name, field in model.model_fields.items() if field.annotation is bool}
    for where, value in _leaves(table, path):
        name = where.removeprefix(f"{path}.")
        if isinstance(value, bool) and name not in flags:
            raise ScenarioError(f"{where}: {_show(value)}, allowed: neither true nor false")
        if isinstance(value, str) and _reads_as_number(value):
            raise ScenarioError(f"{where}: {_show(value)}, allowed: numbers without quotes")


def _refuse_unknown(table: Mapping[str, Any], keys: tuple[str, ...], path: str) -> None:
    for key, value in table.items():
        if key not in keys:
            raise ScenarioError(
                f"{_join(path, key)}: {_show(value)}, no such key,{_hint(key, keys)} allowed: "
                f"{', '.join(keys)}"
            )


def _refuse_ragged(rows: Any, path: str) -> None:
    """Refuse what is not a list of triples of numbers."""
    right = isinstance(rows, list | tuple) and len(rows) > 0
    for row in rows if right else ():
        right = right and isinstance(row, list | tuple) and len(row) == 3
        right = right and all(_is_number(item) for item in row)
    if not right:
        raise ScenarioError(f"{path}: {_show(rows)}, allowed: rows of [depth, a, b]")


def _refuse_unlisted(value: Any, names: tuple[str, ...], path: str) -> None:
    """Refuse all but certain words."""
    if not isinstance(value, str) or value not in names:
        raise ScenarioError(
            f"{path}: {_show(value)},{_hint(value, names)} allowed: {', '.join(names)}"
        )


def _hint(word: Any, names: tuple[str, ...]) -> str:
    near = difflib.get_close_matches(str(word), names)
    return f" did you mean {' or '.join(near)}?" if near else ""


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield what is no table or list, with its path."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _leaves(item, _join(path, key))
    elif isinstance(value, list | tuple):
        for i, item in enumerate(value):
            yield from _leaves(item, _join(path, i))
    else:
        yield path, value


def _join(path: str, *keys: int | str) -> str:
    """Return the path of a key in a table or of an item in a list."""
    for key in keys:
        if isinstance(key, int):
            path += f"[{key}]"
        else:
            name = key if re.fullmatch(r"[\w ,-]+", key) else _show(key)
            path = f"{path}.{name}" if path else name
    return path


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _reads_as_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _show(value: Any) -> str:
    """Return a value as one short line."""
    if isinstance(value, bool):
        return str(value).lower()
    text = _one_line(repr(value))
    return text if len(text) <= 60 else f"{text[:57]}..."


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _colon(text: str) -> str:
    return re.sub(r", allowed:? ", ", allowed: ", text, count=1)
