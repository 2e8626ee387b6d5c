"""The sea of a scenario: the table [sea] read as a surface model or a `MeshFile`, and written back.

`meshtrace.surfaces` is imported only inside the functions that need it.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

from meshtrace.errors import (
    MISSING,
    Described,
    Refused,
    did_you_mean,
    is_number,
    reason_of,
    require_keys,
    within,
)
from meshtrace.link import Link
from meshtrace.mesh import MeshSource, SurfaceModel, TriangleMesh
from meshtrace.models import Family, Model
from meshtrace.scenario.files import Table, as_table, split, unshared, validated
from meshtrace.scenario.parts import follows_wind, in_wind

# keys of [sea] beside those of the sea's model, for errors that list the allowed ones
_SEA_KEYS: tuple[str, ...] = ("spectrum", "mesh", "meshes", "time", "extent", "spacing")


class MeshFile(Model, frozen=True):
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
        Refused
            If it cannot be read, is not a surface under air, or does not cover the square.
        """
        from meshtrace.surfaces import from_trimesh

        try:
            return from_trimesh(self.file, extent=extent, overhangs=True)
        except Refused as error:
            if error.field == self.file:  # the file itself is refused, not what is in it
                problem = Described(f"{self.file!r}: {error.value}")
                raise Refused("sea.mesh", problem, error.allowed) from None
            raise error.in_file(self.file).inside("sea", "mesh") from None
        except Exception as error:  # the readers behind trimesh raise any exception
            problem = Described(f"{self.file!r}: {reason_of(error)}")
            raise Refused("sea.mesh", problem, "a surface in an STL, PLY or OBJ file") from error


def sampling_keys(sea: Table) -> list[str]:
    """Return the keys of [sea] for the fields of `Meshing`."""
    keys, waves = ["extent", "spacing"], sea.get("waves")
    # `time` is a number of seconds for any sea that moves; a text is the date of a spectrum in a
    # record, an option of its reader
    if not isinstance(sea.get("time"), str) or not _is_record(sea):
        keys.append("time")
    # "fading", a number, or anything beside [[sea.part]] is for the mesh; other names are a field
    # of the sea
    if waves == "fading" or is_number(waves) or "part" in sea:
        keys.append("waves")
    return [key for key in keys if key in sea]


def _is_record(sea: Table) -> bool:
    """Return whether [sea] names a file with a measured spectrum or records of wave gauges."""
    kind = sea.get("spectrum")
    return kind == "gauge" or (kind == "measured" and "file" in sea)


def read_surface(
    sea: Table, sampling: Iterable[str], wind_speed: float, folder: Path, printed: bool
) -> Any:
    """Return the surface that [sea] describes without its keys `sampling`, which are for the mesh.

    With `printed`, a sea of a spectrum has the equally spaced waves of the paper unless the table
    names others. Paths of meshes are relative to `folder`.
    """
    if "mesh" in sea:
        return _mesh_file(sea, folder)
    table = {key: value for key, value in sea.items() if key not in sampling}
    if "meshes" in table:
        return _mesh_sequence(table, folder)
    if _is_record(table):
        return _measured(table, wind_speed)
    if "part" in table:
        return _sum(table, wind_speed, folder, printed)
    from meshtrace.surfaces import FlatSea, Surface
    from meshtrace.surfaces.bands import paper_waves

    # the word of a sea, or of a spectrum; a table under "spectrum" describes a spectrum
    word = table.pop("spectrum", table.pop("kind", "jonswap"))
    if isinstance(word, Mapping) or not issubclass(model := _named(word), Surface):
        surface, calm = _spectral(word, table, wind_speed)
    else:
        surface, calm = in_wind(model, table, {"wind_speed": wind_speed}, _SEA_KEYS)
    # "": surfaces without a field `waves` have no waves to choose
    if printed and getattr(surface, "waves", "") is None:
        surface = surface.replace(waves=paper_waves(surface.spectrum))
    return FlatSea() if calm else surface


def _spectral(word: Any, table: Table, wind_speed: float) -> tuple[Any, bool]:
    """Return the sea of a spectrum, and whether its wind speed is 0.

    `word` is a table of the spectrum's kind and parameters, or its kind alone: then the parameters
    are among the keys of `table`, beside those of the sea.
    """
    from meshtrace.surfaces import SpectralSea, Spectrum

    if isinstance(word, Mapping):
        inside, kind, keys = ["spectrum"], word.get("kind", "jonswap"), []
        parameters = {key: value for key, value in word.items() if key != "kind"}
    else:
        inside, kind = [], word
        keys = [*Spectrum.member(word).model_fields, *(["file"] if word == "tabulated" else [])]
        parameters, table = split(table, keys)
    with within(*inside):
        model = Spectrum.member(kind)
        spectrum, calm = in_wind(model, parameters, {"wind_speed": wind_speed})
    sea = validated(SpectralSea, table | {"spectrum": spectrum}, "", [*_SEA_KEYS, *keys])
    return sea, calm


def _measured(table: Table, wind_speed: float) -> Any:
    """Return the sea of a measured spectrum or of gauges in a file; other keys are the reader's."""
    from meshtrace.surfaces import from_gauge, from_wavespectra, gauge_spectrum

    gauge = table["spectrum"] == "gauge"
    # `from_gauge` passes its options on to `gauge_spectrum`: both name the allowed keys
    readers: list[Any] = [from_gauge, gauge_spectrum] if gauge else [from_wavespectra]
    source, options = split(table, ["spectrum", "file"])
    if not isinstance(source.get("file"), str):
        raise Refused("file", source.get("file", MISSING), "a path")
    names = dict.fromkeys(key for f in readers for key in inspect.signature(f).parameters)
    require_keys(options, [*(k for k in names if k not in ("source", "gauge")), "file", *_SEA_KEYS])
    # what instruments do not measure, short waves and directions, follows the wind of the file
    if {"tail", "mss", "spreading"} & options.keys():
        options.setdefault("wind_speed", wind_speed)
    return readers[0](source["file"], **options)


def _sum(table: Table, wind_speed: float, folder: Path, printed: bool) -> Any:
    """Return the sum of the seas of [[sea.part]]."""
    from meshtrace.surfaces import SumSea

    parts = table.pop("part")
    if not isinstance(parts, list) or not parts:
        raise Refused("part", parts, "tables [[sea.part]]")
    seas = []
    # time and mesh belong to the whole sea: a part has no keys of `Meshing`, hence `sampling` ()
    for i, part in enumerate(parts):
        with within("part", i):
            seas.append(read_surface(as_table(part, ""), (), wind_speed, folder, printed))
    return validated(SumSea, table | {"parts": tuple(seas)}, "", ("part", *_SEA_KEYS))


def _named(word: Any) -> type[Family]:
    """Return the class of surface that a word names, or else the class of spectrum."""
    from meshtrace.surfaces import Spectrum, Surface

    for family in (Surface, Spectrum):
        try:
            return family.member(word)
        except Refused as error:
            refused = error
    # for an import path the error tells what is wrong with it, not the list of words
    if isinstance(word, str) and ":" in word:
        raise Refused("spectrum", word, refused.allowed, refused.hint)
    # "spectral" is not a word of link files: those of spectra stand for it
    seas = (kind for kind in Surface.registered if kind != "spectral")
    # "gauge" is neither: `_measured` reads it
    words = list(dict.fromkeys([*seas, "gauge", *Spectrum.registered]))
    raise Refused("spectrum", word, ", ".join(words), did_you_mean(word, words))


def _mesh_file(sea: Table, folder: Path) -> MeshFile:
    """Return the mesh file that [sea] names, relative to the folder of the link file."""
    for key, value in sea.items():
        if key not in ("mesh", "extent"):
            raise Refused(key, value, "beside mesh only extent")
    name = sea["mesh"]
    if not isinstance(name, str) or not os.path.isfile(folder / name):
        raise Refused("mesh", name, "an STL, PLY or OBJ file")
    return MeshFile(file=str((folder / name).resolve()))


def _mesh_sequence(table: Table, folder: Path) -> Any:
    """Return the sequence of meshes that [sea] names, relative to the folder of the link file."""
    from meshtrace.surfaces import MeshSequence

    source = table["meshes"]
    names = source if isinstance(source, list) else [source]
    if not names or not all(isinstance(name, str) for name in names):
        raise Refused("meshes", source, "a folder, a pattern or a file")
    paths: Any = [str(folder.resolve() / name) for name in names]
    keys = [key for key in MeshSequence.model_fields if key not in ("kind", "source")]
    require_keys(table, ["meshes", *keys, "time"])
    table = split(table, ["meshes"])[1]
    table["source"] = paths if isinstance(source, list) else paths[0]
    try:
        return MeshSequence.model_validate(table)
    except Refused as error:
        field = "meshes" if error.field == "source" else error.field
        raise Refused(field, error.value, error.allowed, error.hint) from error.__cause__


def surface_from_provenance(provenance: Mapping[str, Any]) -> MeshSource | MeshFile:
    """Return the surface of a result from its provenance."""
    from meshtrace.surfaces import sea_from_config

    if "mesh_file" in provenance:
        return MeshFile(file=provenance["mesh_file"])
    config = as_table(provenance.get("surface", MISSING), "surface")
    if config.get("kind") == "mesh":
        raise Refused("surface", "mesh", "a sea of meshtrace.surfaces or a mesh from a file")
    with within("surface"):
        return sea_from_config(config)


def wind_of(link: Link, surface: Any) -> float:
    """Return the wind speed of a sea [m s-1], of a sum the highest.

    A surface without a spectrum has that of the bubbles or whitecaps of the link, or else 0.
    """
    if parts := getattr(surface, "parts", ()):
        return max(wind_of(link, part) for part in parts)
    spectrum = getattr(surface, "spectrum", None)
    return (link.wind_speed or 0.0) if spectrum is None else spectrum.wind_speed


def surface_config(surface: MeshSource | MeshFile, wind_speed: float) -> Table:
    """Return the table [sea] of a surface, without a wind speed that equals the file's."""
    if isinstance(surface, MeshFile):
        return {"mesh": surface.file}
    from meshtrace.surfaces import SumSea

    shared = {"wind_speed": wind_speed}
    config = dict(surface.to_config())
    kind = config.pop("kind")
    if kind == "meshes":
        return {"meshes": config.pop("source")} | config
    if isinstance(surface, SumSea):
        del config["parts"]
        return config | {"part": [surface_config(part, wind_speed) for part in surface.parts]}
    if kind == "spectral":
        config["spectrum"] = unshared(config["spectrum"], shared)
        return config
    # a model that follows the wind of the file is written without it; a measured one keeps its own
    model: Any = type(surface)
    return {"spectrum": kind} | (unshared(config, shared) if follows_wind(model) else config)


def may_overhang(surface: MeshSource | MeshFile) -> bool:
    """Return whether meshes of a surface may overhang, so that heights z(x, y) are not unique."""
    return not (isinstance(surface, SurfaceModel) and getattr(surface, "single_valued", True))
