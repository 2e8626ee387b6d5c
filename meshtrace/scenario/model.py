"""Scenarios: the complete description of a run, with its files and its run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Self

from pydantic import field_validator

from meshtrace.comms.ook import OokLink
from meshtrace.daylight.light import Daylight
from meshtrace.errors import Described, Refused, require_keys, require_kind
from meshtrace.fading.resolving import resolve_band
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, TriangleMesh
from meshtrace.models import Model
from meshtrace.results.gain import GainResult
from meshtrace.scenario import parts, seas
from meshtrace.scenario.daylight import daylight_config, read_daylight
from meshtrace.scenario.files import KEYS, located, parse_toml, read_text, set_value, with_notes
from meshtrace.scenario.seas import MeshFile
from meshtrace.scenario.tables import Table, as_table, plain, validated
from meshtrace.transport.case import Case
from meshtrace.transport.forced_link import crossing_reach
from meshtrace.transport.meshing import mesh_for
from meshtrace.transport.options import Analog, Estimator, Meshing, Run, run_keys
from meshtrace.transport.simulate import simulate
from meshtrace.uav.airframe import Uav


class Scenario(Model, frozen=True):
    """Complete description of a run, as in a link file.

    Parameters
    ----------
    wind_speed : float
        Wind speed at 10 m [m s-1]; the sea, bubbles and whitecaps of a link file follow it.
    link : Link
        The link.
    surface : MeshSource or MeshFile
        The sea: a model, meshes in time, or one mesh.
    meshing : Meshing
        Time and resolution at which the sea is triangulated.
    run : Run
        Options of the run.
    detector : OokLink, optional
        Electronics and modulation; power, wavelength, aperture and field of view are the link's.
    uav : Uav, optional
        Airframe that carries the receiver.
    daylight : Daylight, optional
        Light of sun, sky or moon behind bit error rates.

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
    meshing: Meshing = Meshing()
    run: Run = Run()
    detector: OokLink | None = None
    uav: Uav | None = None
    daylight: Daylight | None = None

    @field_validator("surface")
    @classmethod
    def _known_surface(cls, surface: Any) -> Any:
        if not isinstance(surface, MeshSource | MeshFile):
            kind = Described(type(surface).__name__)
            raise Refused("surface", kind, "a sea (MeshSource) or a MeshFile")
        return surface

    @classmethod
    def load(cls, path: str | Path, changes: Mapping[str, Any] | None = None) -> Self:
        """Read a link file.

        Parameters
        ----------
        path : path
            TOML file; paths of mesh files are relative to its folder.
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
            Folder of mesh files.
        changes : mapping of str to value, optional
            See `load`.

        Raises
        ------
        Refused
            If the text is not TOML or a value is not allowed.
        """
        require_kind(changes, Mapping | None, "changes")
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
        `physics="paper"` also sets the published forms that lie outside `Physics`, where they are
        not given: `cdf_coef` of a Fournier-Forand phase function; psi, q and depth of the
        bubbles; whitecaps "paper_0255"; equally spaced bands of the sea. The estimator is "forced"
        unless given, or "analog" for a link or a surface that forced detection cannot follow.

        `fading = true` in [run] stands for `omega_max = "fading"` in [sea], and that for the
        spectrum, spreading and slope variance of Elfouhaily unless the table names others.
        """
        require_keys(config, KEYS)
        config = located(config, folder)
        wind_speed = parts.read_wind_speed(config)
        sea = as_table(config.get("sea", {}), "sea")
        run = as_table(config.get("run", {}), "run")
        seas.read_fading(run, sea)
        meshing: Table = {key: sea.pop(key) for key in ("time", "extent", "spacing") if key in sea}
        printed = config.get("physics") == "paper"
        surface = seas.read_surface(sea, wind_speed, meshing, Path(folder), printed)
        link = parts.read_link(config, wind_speed)
        normals = {"normals": run.pop("normals")} if "normals" in run else {}
        run = {**parts.default_estimator(link), **run}
        checked = validated(Meshing, normals, "run")
        return cls(
            wind_speed=wind_speed,
            link=link,
            surface=surface,
            meshing=validated(Meshing, {**checked.model_dump(), **meshing}, "sea"),
            run=validated(Run, run, "run", (*run_keys(), "fading")),
            detector=parts.read_detector(config["detector"]) if "detector" in config else None,
            uav=parts.read_uav(config["uav"]) if "uav" in config else None,
            daylight=read_daylight(config["daylight"], link) if "daylight" in config else None,
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
        if not isinstance(provenance, Mapping) or not {"run", "link"} <= provenance.keys():
            raise Refused("provenance", provenance, "a table with run, link and surface")
        options: Table = provenance["run"]
        link = Link.model_validate(provenance["link"])
        surface = seas.surface_from_provenance(provenance)
        estimator = Estimator.member(options["estimator"])
        mine = {*Run.model_fields, *estimator.model_fields} - {"threads"}
        return cls(
            wind_speed=seas.wind_of(link, surface),
            link=link,
            surface=surface,
            meshing=Meshing(**{k: v for k, v in options.items() if k in Meshing.model_fields}),
            run=Run(**{k: v for k, v in options.items() if k in mine}),
        )

    def to_config(self) -> Table:
        """Return the full configuration as plain data, in the keys of a link file.

        Keys that follow `wind_speed`, the water or the transmitter are left out.
        """
        link, still = self.link, isinstance(self.surface, MeshFile)
        run = {**self.run.to_config(), "normals": self.meshing.normals}
        if "estimator" not in self.run.model_fields_set and seas.may_overhang(self.surface):
            run = {k: v for k, v in run.items() if k in self.run.model_fields_set | {"normals"}}
        still_too = {"normals", "time"} if still else {"normals"}
        sampling = self.meshing.model_dump(exclude_none=True, exclude=still_too)
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
            **({"daylight": daylight_config(self.daylight)} if self.daylight else {}),
            "run": {key: value for key, value in run.items() if value is not None},
        }

    def to_toml(self, notes: bool = False) -> str:
        """Return the full configuration as the text of a link file.

        Parameters
        ----------
        notes : bool
            Describe the keys in comments.
        """
        import tomli_w

        text = tomli_w.dumps(self.to_config())
        return with_notes(text, self._parts()) if notes else text

    def _parts(self) -> dict[str, tuple[Any, ...]]:
        """Return the models behind each table of a link file."""
        link, run = self.link, self.run
        return {
            "": (self, link),
            "sea": (self.surface, self.meshing),
            "water": (link.water,),
            "bubbles": (link.bubbles,),
            "transmitter": (link.transmitter,),
            "receiver": (link.receiver,),
            "detector": (self.detector,),
            "uav": (self.uav,),
            "run": (run, run.estimator, self.meshing),
        }

    def case(self, surface: MeshSource | TriangleMesh | None = None) -> Case:
        """Return link, surface and options of the run, over another surface if one is given.

        Raises
        ------
        Refused
            If a mesh file cannot be read or does not cover the link.
        """
        origin = {}
        if surface is not None:
            surface = resolve_band(self.link, surface)
        elif isinstance(self.surface, MeshFile):
            footprint = self.link.footprint()
            needed = footprint.fine_extent + max(map(abs, footprint.center))
            surface = self.surface.load(self.meshing.extent or needed)
            origin = {"mesh_file": self.surface.file}
        else:
            surface = resolve_band(self.link, self.surface)
        return Case(self.link, surface, self.run, self.meshing, origin)

    def mesh(self) -> TriangleMesh:
        """Return the surface as the run needs it.

        Raises
        ------
        Refused
            If it does not cover the link, or reaches a source or a receiver, or the estimator
            cannot follow the link.
        """
        reach = None if isinstance(self.run.estimator, Analog) else crossing_reach(self.link)
        case = self.case()
        return mesh_for(case.link, case.surface, case.meshing, reach)[0]

    def simulate(self, progress: Callable[[int], None] | None = None) -> GainResult:
        """Run the scenario, see `meshtrace.simulate`; its provenance loads back."""
        return simulate(self, progress=progress)
