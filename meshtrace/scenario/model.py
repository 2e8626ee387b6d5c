"""Scenario: complete description of a run, read from link files, written to them, and run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from numpy.typing import ArrayLike
from pydantic import PlainValidator, ValidationInfo, WrapValidator, field_validator

from meshtrace.checks import Inside
from meshtrace.daylight.light import Daylight, UnavailableDaylight
from meshtrace.engine.setup.ends import resolved_reach
from meshtrace.engine.setup.meshing import mesh_for
from meshtrace.engine.setup.options import Case, Estimator, Meshing, Run
from meshtrace.engine.simulate import simulate
from meshtrace.errors import (
    Described,
    Refused,
    hinting_at,
    require_between,
    require_keys,
    within,
)
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, TriangleMesh
from meshtrace.models import Model, converted, trusting
from meshtrace.results.gain import GainResult
from meshtrace.results.series import ByWavelength
from meshtrace.scenario import files, parts, seas
from meshtrace.scenario.seas import MeshFile
from meshtrace.uav import Uav

if TYPE_CHECKING:
    from meshtrace.comms.ook import OokLink
    from meshtrace.models import Converted

    Detector = Converted[OokLink | None, OokLink | Mapping[str, Any] | None]
else:
    # as `OokLink | None`, without an import of the class where there is no detector
    Detector = Annotated[Any, PlainValidator(parts.valid_detector)]


def _or_unavailable(value: Any, validate: Callable[[Any], Any]) -> Any:
    """Return an `UnavailableDaylight` unchanged; validate any other value."""
    return value if isinstance(value, UnavailableDaylight) else validate(value)


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
        Time, resolution and waves at which the sea is triangulated.
    run : Run
        Options of the run.
    detector : OokLink, optional
        Electronics and modulation; power, wavelength, aperture, field of view and the index in
        front of it become those of the link, unless it has several receivers.
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
    detector: Detector = converted(default=None)
    uav: Uav | None = None
    # a link file whose model of light needs a missing package has an `UnavailableDaylight` here,
    # typed as a Daylight: any use of its fields raises the refusal
    daylight: Annotated[Daylight | None, WrapValidator(_or_unavailable)] = None

    @field_validator("surface")
    @classmethod
    def _known_surface(cls, surface: Any) -> Any:
        if not isinstance(surface, MeshSource | MeshFile):
            kind = Described(type(surface).__name__)
            raise Refused("surface", kind, "a sea (MeshSource) or a MeshFile")
        return surface

    @field_validator("detector")
    @classmethod
    def _detector_of_link(cls, detector: OokLink | None, info: ValidationInfo) -> OokLink | None:
        # validators also run when the link is replaced: the detector follows each link
        link = info.data.get("link")
        return detector if detector is None or link is None else parts.detector_of(detector, link)

    @classmethod
    def load(
        cls, path: str | Path, changes: Mapping[str, Any] | None = None, *, trust: bool = False
    ) -> Self:
        """Read a link file.

        Parameters
        ----------
        path : path
            TOML file; paths of mesh files are relative to its folder.
        changes : mapping of str to value, optional
            Values that replace those of the file, by dotted key such as "transmitter.depth".
        trust : bool
            Run the modules that the file names by import paths "module:Class".

        Raises
        ------
        Refused
            If the file cannot be read, a value is not allowed, or a module that is not imported
            yet is named without `trust`.
        """
        text, folder = files.read_text(path), Path(path).parent
        return cls.from_toml(text, source=str(path), folder=folder, changes=changes, trust=trust)

    @classmethod
    def from_toml(
        cls,
        text: str,
        *,
        source: str | None = None,
        folder: str | Path = ".",
        changes: Mapping[str, Any] | None = None,
        trust: bool = False,
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
        trust : bool
            See `load`.

        Raises
        ------
        Refused
            If the text is not TOML or a value is not allowed, see `load`.
        """
        try:
            config = files.parse_toml(text)
            for key, value in (changes or {}).items():
                files.set_value(config, key, value)
            return cls.from_config(config, folder=folder, trust=trust)
        except RecursionError as error:
            nested = Described("nested too deeply")
            raise Refused("", nested, "tables of a link file", source=source or "") from error
        except Refused as error:
            raise error.in_file(source or "") from error.__cause__

    @classmethod
    def from_config(
        cls,
        config: Annotated[Mapping[str, Any], Inside()],
        *,
        folder: str | Path = ".",
        trust: bool = False,
    ) -> Self:
        """Build a scenario from plain data with the keys of a link file.

        `folder` and `trust` are those of `from_toml`.

        Raises
        ------
        Refused
            If a key is unknown or a value is not allowed, see `load`.

        Notes
        -----
        `physics="paper"` also sets the published forms that lie outside `Physics`, where they are
        not given: `cdf_coef` of a Fournier-Forand phase function; psi, q and depth of the
        bubbles; whitecaps "paper_0255"; equally spaced waves of the sea. The estimator is "forced"
        unless given, or "analog" for a link or a surface that forced detection cannot follow.

        `waves` in [sea] chooses the waves of all studies, see `Meshing`.
        """
        if not isinstance(config, Mapping):
            raise Refused("config", config, "a table")
        with trusting(trust), hinting_at(cls._keys):
            require_keys(config, files.KEYS)
            # bare words (bubbles = "none") and relative paths are resolved here, in a copy: the
            # functions that read the tables see neither
            tables = files.located(config, folder)
            files.expand_words(tables)
            wind_speed = tables.get("wind_speed", parts.DEFAULT_WIND_SPEED)
            allowed = "0 <= wind_speed <= 60 m/s"
            wind_speed = require_between(wind_speed, 0.0, 60.0, "wind_speed", "[]", allowed)
            # printed: use the forms printed in the paper where the tables name no others
            sea, run, printed = tables["sea"], tables["run"], tables.get("physics") == "paper"
            sampling = seas.sampling_keys(sea)
            with within("sea"):
                surface = seas.read_surface(sea, sampling, wind_speed, Path(folder), printed)
            link = parts.read_link(tables, wind_speed, printed)
            scenario = cls(
                wind_speed=wind_speed,
                link=link,
                surface=surface,
                meshing=parts.read_meshing(sea, sampling, run),
                run=parts.read_run(run, link),
                detector=parts.read_detector(tables.get("detector")),
                uav=parts.read_uav(tables.get("uav")),
                daylight=parts.read_daylight(tables["daylight"], link),  # type: ignore[arg-type]
            )
            # after the scenario is built: its detector follows the link unless there are several
            # receivers
            parts.require_of_link(tables.get("detector", {}), scenario.detector)
            return scenario

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
            If a value is not allowed, the surface was a mesh that came from no file, or a part is
            of a class of the user's own whose module is not imported: results import nothing.

        Notes
        -----
        The number of threads, on which no result depends, is not taken over.
        """
        if not {"run", "link"} <= provenance.keys():
            raise Refused("provenance", provenance, "a table with run, link and surface")
        options = files.as_table(provenance["run"], "run")
        link = Link.model_validate(files.as_table(provenance["link"], "link"))
        surface = seas.surface_from_provenance(provenance)
        estimator = Estimator.member(options.get("estimator", "forced"), "run.estimator")
        # `options` is one flat table, which also has those of `Meshing` and further entries
        run_keys = {*Run.model_fields, *estimator.model_fields} - {"threads"}
        return cls(
            wind_speed=seas.wind_of(link, surface),
            link=link,
            surface=surface,
            meshing=Meshing.model_validate(files.split(options, Meshing.model_fields)[0]),
            run=Run.model_validate({k: v for k, v in options.items() if k in run_keys}),
        )

    @classmethod
    def _keys(cls) -> list[str]:
        """Return the dotted keys of link files."""
        unset = (f"{name}.{line.partition(' = ')[0]}" for name, lines in files.unset_keys().items()
                 for line in lines)  # fmt: skip
        # from the last, as the lamp is meant more often than sea and bubbles, which come before it
        config = cls.from_toml("").to_config()
        return [*dict.fromkeys([*reversed([*files.dotted(config)]), *unset])]

    def to_config(self) -> files.Table:
        """Return the full configuration as plain data with the keys of a link file.

        Keys that follow `wind_speed`, the water or the transmitter are left out.
        """
        link = self.link
        run = self.run.to_config() | {"normals": self.meshing.normals}
        # an estimator that was not set follows from the surface again when the text is read: only
        # what was set is written
        if "estimator" not in self.run.model_fields_set and seas.may_overhang(self.surface):
            run, _ = files.split(run, [*self.run.model_fields_set, "normals"])
        sampling = self.meshing.model_dump(exclude_none=True, exclude={"normals"})
        if isinstance(self.surface, MeshFile):  # one mesh has no time
            del sampling["time"]
        config = {
            "wind_speed": self.wind_speed,
            "physics": parts.physics_config(link.physics),
            "whitecaps": parts.whitecaps_config(link, self.wind_speed),
            "n_air": link.n_air,
            "sea": seas.surface_config(self.surface, self.wind_speed) | sampling,
            "water": parts.water_config(link),
            "bubbles": parts.bubbles_config(link, self.wind_speed),
            "transmitter": files.plain(link.transmitter),
            "receiver": files.plain(link.receiver),
            "planes": files.plain(link.planes),
            "objects": parts.objects_config(link),
            "detector": parts.detector_config(self.detector, link),
            "uav": files.plain(self.uav),
            "daylight": parts.daylight_config(self.daylight),
            "run": {key: value for key, value in run.items() if value is not None},
        }
        return {name: table for name, table in config.items() if table is not None}

    def to_toml(self, notes: bool = False) -> str:
        """Return the full configuration as the text of a link file.

        Parameters
        ----------
        notes : bool
            Describe the keys in comments, with those that the scenario does not set.
        """
        import tomli_w

        config = self.to_config()
        text = tomli_w.dumps(config)
        if not notes:
            return text
        # tables that the scenario lacks, with their defaults, to be shown as comments
        absent: files.Table = {"detector": parts.read_detector({}), "uav": parts.read_uav({})}
        absent = {name: part for name, part in absent.items() if name not in config}
        rest = tomli_w.dumps({name: files.plain(part) for name, part in absent.items()})
        models = self._parts() | {name: (part,) for name, part in absent.items()}
        return files.with_unset_keys(files.with_notes(text, models), files.with_notes(rest, models))

    def _parts(self) -> dict[str, tuple[Any, ...]]:
        """Return the models that define the keys of each table of a link file."""
        link, run = self.link, self.run
        return {
            "": (self, link),
            "sea": (self.surface, self.meshing),
            "water": (link.water, link.water.spectrum),
            "bubbles": (link.bubbles,),
            "transmitter": (link.transmitter,),
            "receiver": (link.receiver,),
            "detector": (self.detector,),
            "uav": (self.uav,),
            "run": (run, run.estimator, self.meshing),
        }

    def case(
        self,
        surface: MeshSource | TriangleMesh | None = None,
        fading: bool = False,
        mesh: Meshing | None = None,
        **options: Any,
    ) -> Case:
        """Return link, surface and options of the run, replaced where given.

        Parameters
        ----------
        surface : MeshSource or TriangleMesh, optional
            Another surface.
        fading : bool
            Whether the question is about fading, see `fading.resolve_band`: `Meshing.waves` may
            leave the choice of waves to it.
        mesh : Meshing, optional
            Another time, resolution and choice of waves.
        **options
            Fields of `Run`, of its estimator and of `Meshing`.

        Raises
        ------
        Refused
            If a mesh file cannot be read or does not cover the link, or the sea has no such waves.
        """
        origin = {}  # entries for the provenance
        if surface is None and isinstance(self.surface, MeshFile):
            footprint = self.link.footprint()
            # half-width of the square about (0, 0) that contains the fine part
            needed = footprint.fine_extent + max(map(abs, footprint.center))
            surface = self.surface.load(self.meshing.extent or needed)
            origin = {"mesh_file": self.surface.file}
        case = Case(self.link, surface or self.surface, self.run, self.meshing, origin)
        return case.with_options(mesh, **options).with_waves(fading)

    def mesh(self) -> TriangleMesh:
        """Return the mesh of the surface that the run needs.

        Raises
        ------
        Refused
            If it does not cover the link, or reaches a source or a receiver, or the estimator
            cannot follow the link.
        """
        reach = resolved_reach(self.link, self.run.estimator)
        case = self.case()
        return mesh_for(case.link, case.surface, case.meshing, reach)[0]

    def at_wavelength(self, wavelength_nm: float) -> Self:
        """Return the scenario with link and daylight at another wavelength [nm].

        Raises
        ------
        Refused
            See `Link.at_wavelength` and `Daylight.at_wavelength`.
        """
        day = self.daylight and self.daylight.at_wavelength(wavelength_nm)
        link = self.link.at_wavelength(wavelength_nm)
        return self.model_copy(update={"link": link, "daylight": day})

    def simulate(
        self,
        progress: Callable[[int], None] | None = None,
        wavelengths_nm: ArrayLike | None = None,
        per_lamp: bool = False,
    ) -> GainResult | ByWavelength[GainResult]:
        """Run the scenario, see `meshtrace.simulate`.

        `from_provenance` restores the scenario from the provenance of the result.
        """
        return simulate(self, progress=progress, wavelengths_nm=wavelengths_nm, per_lamp=per_lamp)
