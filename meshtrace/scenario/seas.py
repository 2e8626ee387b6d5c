"""The sea of a scenario: table [sea] to a surface model or a `MeshFile`, and how large it may be.

Here the core meets `meshtrace.surfaces`, by late imports.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

import pydantic

from meshtrace.errors import (
    Refused,
    ScenarioError,
    one_line,
    refuse_unknown,
    refuse_unlisted,
    show,
    with_colon,
)
from meshtrace.link import Footprint, Link
from meshtrace.mesh import SurfaceModel, TriangleMesh
from meshtrace.scenario.tables import (
    Table,
    imported,
    kinds,
    of_kind,
    validated,
    without_shared_wind,
)
from meshtrace.transport.options import Sampling

MOST_VERTICES = 10_000_000
"""Vertices of a mesh, at some 0.5 kB each, beyond which a run is refused."""

MOST_FACTORS = 50_000_000
"""Waves times grid lines, at some 50 B each, beyond which a run is refused."""

_SEA_ALIASES = {"sinusoidal": "sinusoid", "tilted-plane": "plane"}
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
            problem = one_line(str(error)) or type(error).__name__
            if ", allowed" not in problem:
                problem += ", allowed: a surface in an STL, PLY or OBJ file"
            raise ScenarioError(f"sea.mesh: {self.file!r}: {with_colon(problem)}") from error


def read_surface(table: Table, wind_speed: float, sampling: Mapping[str, Any], folder: Path) -> Any:
    """Return the surface of [sea], of which `sampling` has been taken out."""
    if "mesh" in table:
        return _mesh_file(table, sampling, folder)
    from meshtrace.surfaces import FlatSea, Spectrum, Spreading, Surface

    seas, spectra = dict(kinds(Surface)), dict(kinds(Spectrum))
    word = table.pop("spectrum", table.pop("kind", "jonswap"))
    own = isinstance(word, Mapping)
    if isinstance(word, str) and ":" in word:
        _add_own(word, seas, spectra)
    elif not own:
        refuse_unlisted(word, _sea_words(seas, spectra), "sea.spectrum")
    kind, table = _sea_kind(word, table, seas, spectra)
    inline = spectra[word].model_fields if kind == "spectral" and not own else ()
    keys = tuple(dict.fromkeys([*_SEA_KEYS, *inline, *seas[kind].model_fields]))
    driven = {"jonswap": table, "spectral": table.get("spectrum")}.get(kind)
    if driven is not None and driven.setdefault("wind_speed", wind_speed) == 0.0:
        refuse_unknown(table, keys, "sea")
        return FlatSea()
    if kind == "spectral":
        path = "sea.spectrum" if own else "sea"
        table["spectrum"] = of_kind(Spectrum, table["spectrum"], path, "kind", "jonswap")
    if "spreading" in table:
        table["spreading"] = of_kind(Spreading, table["spreading"], "sea.spreading", "kind", "ittc")
    return validated(seas[kind], table, "sea", keys)


def _add_own(word: str, seas: dict[str, Any], spectra: dict[str, Any]) -> None:
    """Add the user's surface or spectrum at an import path to the models of its family."""
    from meshtrace.surfaces import Spectrum, Surface

    try:
        seas[word] = imported(Surface, word, "sea.spectrum")
    except ScenarioError:
        spectra[word] = imported(Spectrum, word, "sea.spectrum")


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
            raise ScenarioError(f"sea.{key}: {show(value)}, allowed: beside mesh only extent")
    name = table["mesh"]
    if not isinstance(name, str) or not os.path.isfile(folder / name):
        raise ScenarioError(f"sea.mesh: {show(name)}, allowed: an STL, PLY or OBJ file")
    return MeshFile(file=str((folder / name).resolve()))


def surface_from_provenance(provenance: Mapping[str, Any]) -> SurfaceModel | MeshFile:
    """Return the surface of a result."""
    from meshtrace.surfaces import sea_from_config

    config = provenance["surface"]
    if "mesh_file" in provenance:
        return MeshFile(file=provenance["mesh_file"])
    try:
        return sea_from_config(config)
    except Refused as error:
        kind = config.get("kind")
        raise ScenarioError(
            f"surface: {show(kind)}, allowed: a sea of meshtrace.surfaces or a mesh from a file"
        ) from error


def wind_of(link: Link, surface: Any) -> float:
    """Return the wind speed of the first part that has one, 0 for a calm sea."""
    parts = (getattr(surface, "spectrum", None), link.bubbles, link.whitecaps)
    return next((part.wind_speed for part in parts if part is not None), 0.0)


def surface_config(surface: SurfaceModel | MeshFile, wind_speed: float) -> Table:
    """Return [sea] of a surface, without the wind speed that it shares."""
    if isinstance(surface, MeshFile):
        return {"mesh": surface.file}
    config = dict(surface.to_config())
    kind = config.pop("kind")
    if kind == "spectral":
        config["spectrum"] = without_shared_wind(config["spectrum"], wind_speed)
        return config
    return {"spectrum": kind, **without_shared_wind(config, wind_speed)}


def refuse_huge(surface: SurfaceModel, footprint: Footprint, sampling: Sampling) -> None:
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
