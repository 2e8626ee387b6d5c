"""The sea of a scenario: table [sea] to a surface model or a `MeshFile`, and limits on its size.

Here the core meets `meshtrace.surfaces`, by late imports.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Mapping
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
from meshtrace.scenario.files import Table, as_table, unshared, validated

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
            if error.field == self.file:  # of the reader
                problem = Described(f"{self.file!r}: {error.value}")
                raise Refused("sea.mesh", problem, error.allowed) from None
            raise error.of(self.file).inside("sea", "mesh") from None
        except Exception as error:  # the readers behind trimesh raise any exception
            problem = Described(f"{self.file!r}: {reason_of(error)}")
            allowed = "a surface in an STL, PLY or OBJ file"
            raise Refused("sea.mesh", problem, allowed) from error


def read_sampling(sea: Table) -> Table:
    """Move the keys of `Meshing` out of [sea], without the names of waves that a sea holds."""
    keys = ["time", "extent", "spacing"]
    waves = sea.get("waves")
    if waves == "fading" or is_number(waves) or "part" in sea:
        keys.append("waves")
    return {key: sea.pop(key) for key in keys if key in sea}


def read_surface(
    table: Table, wind_speed: float, sampling: Mapping[str, Any], folder: Path, printed: bool
) -> Any:
    """Return the surface of [sea] without its `sampling` keys.

    `printed` has the equally spaced waves of the paper unless the table names others.
    """
    if "mesh" in table:
        return _mesh_file(table, sampling, folder)
    if "meshes" in table:
        return _mesh_sequence(table, folder)
    from meshtrace.surfaces import FlatSea, Surface
    from meshtrace.surfaces.bands import paper_waves

    if table.get("spectrum") == "gauge" or (
        table.get("spectrum") == "measured" and "file" in table
    ):
        return _measured(table, wind_speed)
    if "part" in table:
        return _sum(table, wind_speed, folder, printed)
    word = table.pop("spectrum", table.pop("kind", "jonswap"))
    model = Surface.member("spectral") if isinstance(word, Mapping) else _named(word)
    keys, calm = _SEA_KEYS, False
    if not issubclass(model, Surface) or isinstance(word, Mapping):
        table, keys, calm = _with_spectrum(word, table, wind_speed)
        model = Surface.member("spectral")
    elif _follows_wind(model):
        table, calm = _driven(table, wind_speed)
    surface: Any = validated(model, table, "", keys)
    if printed and "waves" in model.model_fields and surface.waves is None:
        surface = surface.replace(waves=paper_waves(surface.spectrum))
    return FlatSea() if calm else surface


def _measured(table: Table, wind_speed: float) -> Any:
    """Return the sea of a spectrum or of gauges in a file, with the options of its reader."""
    from meshtrace.surfaces import from_gauge, from_wavespectra, gauge_spectrum

    gauge = table["spectrum"] == "gauge"
    reader = from_gauge if gauge else from_wavespectra
    if not isinstance(table.get("file"), str):
        raise Refused("file", table.get("file", MISSING), "a path")
    options = {key: value for key, value in table.items() if key not in ("spectrum", "file")}
    functions = [reader, gauge_spectrum] if gauge else [reader]
    known = dict.fromkeys(key for f in functions for key in inspect.signature(f).parameters)
    require_keys(options, [*(k for k in known if k not in ("source", "gauge")), "file", *_SEA_KEYS])
    # what the instrument leaves open, short waves and directions, follows the wind
    if {"tail", "mss", "spreading"} & options.keys():
        options.setdefault("wind_speed", wind_speed)
    return reader(table["file"], **options)


def _sum(table: Table, wind_speed: float, folder: Path, printed: bool) -> Any:
    """Return the sum of the seas of [[sea.part]]."""
    from meshtrace.surfaces import SumSea

    parts = table.pop("part")
    if not isinstance(parts, list) or not parts:
        raise Refused("part", parts, "tables [[sea.part]]")
    seas = []
    for i, part in enumerate(parts):
        with within("part", i):
            seas.append(read_surface(as_table(part, ""), wind_speed, {}, folder, printed))
    return validated(SumSea, {**table, "parts": tuple(seas)}, "", ("part", *_SEA_KEYS))


def _follows_wind(model: Any) -> bool:
    """Return whether the waves of a sea follow the wind; measured waves do not."""
    field = model.model_fields.get("wind_speed")
    return field is not None and field.default is not None


def _named(word: Any) -> type[Family]:
    """Return the class of a sea, or else of a spectrum, that a word names."""
    from meshtrace.surfaces import Spectrum, Surface

    for family in (Surface, Spectrum):
        try:
            return family.member(word)
        except Refused as error:
            refused = error
    if isinstance(word, str) and ":" in word:
        raise Refused("spectrum", word, refused.allowed, refused.hint)
    seas = (kind for kind in Surface.registered if kind != "spectral")
    # "gauge" is a word of files alone
    words = list(dict.fromkeys([*seas, "gauge", *Spectrum.registered]))
    raise Refused("spectrum", word, ", ".join(words), did_you_mean(word, words))


def _with_spectrum(
    word: Any, table: Table, wind_speed: float
) -> tuple[Table, tuple[str, ...], bool]:
    """Return the table of a spectral sea, all keys of [sea], and a flag for no wind.

    The spectrum is a separate table, or a word with its parameters beside the sea's.
    """
    from meshtrace.surfaces import Spectrum

    if isinstance(word, Mapping):
        path: tuple[str, ...] = ("spectrum",)
        keys, spectrum = _SEA_KEYS, {"kind": "jonswap", **word}
    else:
        fields = list(Spectrum.member(word).model_fields)
        fields += ["file"] if word == "tabulated" else []
        path, keys = (), (*_SEA_KEYS, *fields)
        spectrum = {"kind": word, **{key: table.pop(key) for key in fields if key in table}}
    spectrum, calm = _driven(spectrum, wind_speed)
    with within(*path):
        return {**table, "spectrum": Spectrum.read(spectrum)}, keys, calm


def _driven(table: Table, wind_speed: float) -> tuple[Table, bool]:
    """Return a table with its wind speed, and whether it is calm.

    Spectra refuse a wind speed of 0; a calm sea is validated at 5 m/s, so that its other keys are
    still checked, and `read_surface` returns a flat sea in its place.
    """
    speed = table.get("wind_speed", wind_speed)
    calm = speed == 0.0 and not isinstance(speed, bool)
    return {**table, "wind_speed": 5.0 if calm else speed}, calm


def _mesh_file(table: Table, sampling: Mapping[str, Any], folder: Path) -> MeshFile:
    for key, value in {**table, **sampling}.items():
        if key not in ("mesh", "extent"):
            raise Refused(key, value, "beside mesh only extent")
    name = table["mesh"]
    if not isinstance(name, str) or not os.path.isfile(folder / name):
        raise Refused("mesh", name, "an STL, PLY or OBJ file")
    return MeshFile(file=str((folder / name).resolve()))


def _mesh_sequence(table: Table, folder: Path) -> Any:
    """Return the meshes in time of a folder or a pattern, relative to the link file."""
    from meshtrace.surfaces import MeshSequence

    source = table.pop("meshes")
    names = source if isinstance(source, list) else [source]
    if not names or not all(isinstance(name, str) for name in names):
        raise Refused("meshes", source, "a folder, a pattern or a file")
    whole = [str(folder.resolve() / name) for name in names]
    keys = [key for key in MeshSequence.model_fields if key not in ("kind", "source")]
    require_keys(table, ["meshes", *keys, "time"])
    try:
        return MeshSequence(whole if isinstance(source, list) else whole[0], **table)
    except Refused as error:
        field = "meshes" if error.field == "source" else error.field
        raise Refused(field, error.value, error.allowed, error.hint) from error.__cause__


def surface_from_provenance(provenance: Mapping[str, Any]) -> MeshSource | MeshFile:
    """Return the surface of a result."""
    from meshtrace.surfaces import sea_from_config

    if "mesh_file" in provenance:
        return MeshFile(file=provenance["mesh_file"])
    config = as_table(provenance.get("surface", MISSING), "surface")
    if config.get("kind") == "mesh":
        raise Refused("surface", "mesh", "a sea of meshtrace.surfaces or a mesh from a file")
    with within("surface"):
        return sea_from_config(config)


def wind_of(link: Link, surface: Any) -> float:
    """Return the wind speed of the first part that has one, 0 for a calm sea."""
    parts = getattr(surface, "parts", ())
    if parts:
        return max(wind_of(link, part) for part in parts)
    spectrum = getattr(surface, "spectrum", None)
    return (link.wind_speed or 0.0) if spectrum is None else spectrum.wind_speed


def surface_config(surface: MeshSource | MeshFile, wind_speed: float) -> Table:
    """Return [sea] of a surface, without the wind speed that it shares."""
    if isinstance(surface, MeshFile):
        return {"mesh": surface.file}
    from meshtrace.surfaces import SumSea

    config = dict(surface.to_config())
    kind = config.pop("kind")
    if kind == "meshes":
        return {"meshes": config.pop("source"), **config}
    if isinstance(surface, SumSea):
        parts = [surface_config(part, wind_speed) for part in surface.parts]
        del config["parts"]
        return {**config, "part": parts}
    if kind == "spectral":
        config["spectrum"] = unshared(config["spectrum"], wind_speed=wind_speed)
        return config
    # the wind of the file's other tables need not be written twice
    if _follows_wind(type(surface)):
        config = unshared(config, wind_speed=wind_speed)
    return {"spectrum": kind, **config}


def may_overhang(surface: MeshSource | MeshFile) -> bool:
    """Return whether the meshes of a surface may overhang."""
    return not (isinstance(surface, SurfaceModel) and getattr(surface, "single_valued", True))
