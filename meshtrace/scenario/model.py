"""The scenario itself: everything that one run depends on, read, written and run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from pydantic import field_validator

from meshtrace.comms.ook import OokLink
from meshtrace.errors import Described, Refused, require_keys
from meshtrace.link import Link
from meshtrace.mesh import SurfaceModel, TriangleMesh
from meshtrace.models import Model
from meshtrace.results.gain import GainResult
from meshtrace.scenario import parts, seas
from meshtrace.scenario.files import KEYS, parse_toml, read_text, set_value
from meshtrace.scenario.seas import MeshFile
from meshtrace.scenario.tables import Table, as_table, plain, validated
from meshtrace.transport.forced_link import crossing_reach
from meshtrace.transport.options import Run, Sampling
from meshtrace.transport.simulate import mesh_for, simulate
from meshtrace.uav.airframe import Uav

if TYPE_CHECKING:
    from meshtrace.results.series import GainSeries
    from meshtrace.studies.performance.tables import LinkPerformance


class Scenario(Model, frozen=True):
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
            kind = Described(type(surface).__name__)
            raise Refused("surface", kind, "a sea (SurfaceModel) or a MeshFile")
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
        Refused
            If the file cannot be read or a value is not allowed.
        """
        text = read_text(path)
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
        Refused
            If the text is not TOML or a value is not allowed.
        """
        try:
            config = parse_toml(text)
            for key, value in (changes or {}).items():
                set_value(config, key, value)
            return cls.from_config(config, folder=folder)
        except RecursionError as error:
            nested = Described("nested too deeply")
            raise Refused("", nested, "tables of a link file", source=source or "") from error
        except Refused as error:
            raise error.of(source or "") from error.__cause__

    @classmethod
    def from_config(cls, config: Mapping[str, Any], *, folder: str | Path = ".") -> Self:
        """Build the scenario that plain data describes, in the keys of a link file.

        Raises
        ------
        Refused
            If a key is unknown or a value is not allowed.

        Notes
        -----
        `physics="paper"` also sets the printed forms that lie outside `Physics`, where they are
        not given: `cdf_coef` of a Fournier-Forand phase function; psi, q and depth of the
        bubbles; whitecaps "paper_0255". The estimator is "forced" unless given, or "analog" for
        a link that forced detection cannot follow.
        """
        require_keys(config, KEYS)
        wind_speed = parts.read_wind_speed(config)
        sea = as_table(config.get("sea", {}), "sea")
        sampling = {key: sea.pop(key) for key in Sampling.model_fields if key in sea}
        surface = seas.read_surface(sea, wind_speed, sampling, Path(folder))
        link = parts.read_link(config, wind_speed)
        run = {"estimator": parts.default_estimator(link), **as_table(config.get("run", {}), "run")}
        return cls(
            wind_speed=wind_speed,
            link=link,
            surface=surface,
            sampling=validated(Sampling, sampling, "sea"),
            run=validated(Run, run, "run"),
            detector=parts.read_detector(config["detector"]) if "detector" in config else None,
            uav=parts.read_uav(config["uav"]) if "uav" in config else None,
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
        Refused
            If the surface was a mesh that came from no file, or a model of the user's own.

        Notes
        -----
        The number of threads, on which no result depends, is not taken over.
        """
        run = {k: v for k, v in provenance["run"].items() if k != "threads"}
        link = Link.model_validate(provenance["link"])
        surface = seas.surface_from_provenance(provenance)
        return cls(
            wind_speed=seas.wind_of(link, surface),
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
            "physics": parts.physics_config(link.physics),
            "whitecaps": parts.whitecaps_config(link, self.wind_speed),
            "n_air": link.n_air,
            "sea": {**seas.surface_config(self.surface, self.wind_speed), **sampling},
            "water": link.water.model_dump(mode="json", exclude_none=True),
            "bubbles": parts.bubbles_config(link, self.wind_speed),
            "transmitter": plain(link.transmitter),
            "receiver": plain(link.receiver),
            **({"planes": plain(link.planes)} if link.planes else {}),
            **({"detector": plain(self.detector)} if self.detector else {}),
            **({"uav": plain(self.uav)} if self.uav else {}),
            "run": plain(self.run),
        }

    def to_toml(self) -> str:
        """Return the full configuration as the text of a link file, which loads back."""
        import tomli_w

        return tomli_w.dumps(self.to_config())

    def mesh(self) -> TriangleMesh:
        """Return the surface as the run needs it.

        Raises
        ------
        Refused
            If it does not cover the link, or reaches a source or a receiver, or the estimator
            cannot follow the link.
        """
        sampling = self.sampling.model_dump()
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
        Refused
            If the surface does not suit the link.
        """
        options: Any = {**self.sampling.model_dump(), **self.run.model_dump()}
        try:
            result = simulate(self.link, self._runnable(), progress=progress, **options)
        except ArithmeticError as error:
            raise Refused("link", Described(f"{error}"), "numbers that do not overflow") from error
        if not np.isfinite(result.gain).all():
            gain = Described(f"a gain of {result.gain}")
            raise Refused("link", gain, "numbers that do not overflow")
        if isinstance(self.surface, MeshFile):
            return replace(result, provenance={**result.provenance, "mesh_file": self.surface.file})
        return result

    def time_series(
        self, times: Sequence[float], progress: Callable[[int], None] | None = None
    ) -> GainSeries:
        """Return the gain over the moving sea at times [s], see `meshtrace.time_series`.

        Raises
        ------
        Refused
            If the surface does not move, or the link needs the analog estimator.
        """
        from meshtrace.studies.series import time_series

        options: Any = self._series_options(moving=True)
        return time_series(self.link, self.surface, times, progress=progress, **options)

    def ensemble(
        self, n_realizations: int, progress: Callable[[int], None] | None = None
    ) -> GainSeries:
        """Return the gains over realizations of the sea, see `meshtrace.ensemble`.

        Raises
        ------
        Refused
            If the sea has no random phases, or the link needs the analog estimator.
        """
        from meshtrace.studies.series import ensemble

        options: Any = {**self._series_options(), "time": self.sampling.time}
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
        Refused
            If an option is out of range, or the link needs the analog estimator.
        """
        from meshtrace.studies.performance.link_performance import link_performance

        run = self._series_options()
        shared: Any = {key: run[key] for key in ("photons", "seed", "spacing", "threads")}
        mine = {"ook": self.detector or "physical", "uav": self.uav}
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
            raise Refused("run.estimator", self.run.estimator, "forced, over many seas")
        if isinstance(self.surface, MeshFile):
            raise Refused("sea.mesh", self.surface.file, "a sea model")
        if moving and self.sampling.time != 0.0:
            raise Refused("sea.time", self.sampling.time, "0 with times")
        seas.refuse_huge(self.surface, self.link.footprint(), self.sampling)
        run = self.run.model_dump(include={"photons", "seed", "normals", "threads"})
        return {**run, **self.sampling.model_dump(include={"extent", "spacing"})}

    def _runnable(self) -> SurfaceModel | TriangleMesh:
        footprint = self.link.footprint()
        if isinstance(self.surface, MeshFile):
            return self.surface.load(self.sampling.extent or footprint.fine_extent)
        seas.refuse_huge(self.surface, footprint, self.sampling)
        return self.surface
