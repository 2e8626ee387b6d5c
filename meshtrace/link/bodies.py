"""Bodies in the water or the air: triangle meshes that block and reflect light."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BeforeValidator, Field, model_validator

from meshtrace.errors import MISSING, Described, Refused, is_number, reason_of
from meshtrace.mesh import FARTHEST, READABLE, MeshOrFile, TriangleMesh
from meshtrace.models import Finite, Floats, Model, Positive
from meshtrace.tables import PLAUSIBLE_NM, Column, read_columns

__all__ = ["Body"]

_COLUMNS = (
    Column("wavelength", "nm", ("lambda", "wl", "wave", "wavelengths"), plausible=PLAUSIBLE_NM),
    Column("albedo", "1", ("reflectance", "rho", "R"), relative=True),
)


def _facets_of(mesh: str | TriangleMesh) -> tuple[Floats, NDArray[np.int32], str]:
    """Return the vertices (n, 3) in the unit of the mesh, the faces (m, 3) and their SHA-256.

    Refuse a file that cannot be read or has no facets.
    """
    if isinstance(mesh, TriangleMesh):
        return mesh.vertices, mesh.faces, mesh.sha256
    try:
        state = Path(mesh).stat()
    except OSError as error:
        raise Refused("mesh", Described(f"{mesh!r}: {error.strerror}"), READABLE) from error
    # a link is validated many times, the file read once while it stays as it is
    return _read(mesh, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=8)
def _read(file: str, modified: int, size: int) -> tuple[Floats, NDArray[np.int32], str]:
    """Return the facets of a file, cached by its time of modification and size."""
    from meshtrace.surfaces.triangulate import read_mesh

    try:
        digest = hashlib.sha256(Path(file).read_bytes()).hexdigest()
        vertices, faces = read_mesh(file)
    except Refused as error:
        raise Refused("mesh", Described(f"{file!r}: {error.value}"), READABLE) from error
    except Exception as error:  # the readers behind trimesh raise any exception
        raise Refused("mesh", Described(f"{file!r}: {reason_of(error)}"), READABLE) from error
    if not np.isfinite(vertices[faces]).all():
        other = Described(f"{file!r}: coordinates that are not finite")
        raise Refused("mesh", other, "a mesh of finite coordinates")
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    # modelling programs leave facets without area, which no ray meets
    solid = np.cross(b - a, c - a).any(axis=1)
    if not solid.any():
        raise Refused("mesh", Described(f"{file!r}: no facets with an area"), READABLE)
    return vertices, faces[solid].astype(np.int32), digest


def _albedo(value: Any) -> Any:
    """Return an albedo, or a table of albedos, as a number or as rows (wavelength, albedo)."""
    if isinstance(value, Mapping) and value.keys() == {"file"}:
        value = value["file"]
    if is_number(value):
        return value
    table = read_columns(value, _COLUMNS, "albedo")
    wavelengths, albedos = table["wavelength"].values, table["albedo"].values
    if len(wavelengths) < 2 or (np.diff(wavelengths) <= 0.0).any():
        count = Described(f"{len(wavelengths)} wavelengths")
        raise Refused("albedo", count, "two or more wavelengths, rising [nm]")
    return tuple(zip(wavelengths.tolist(), albedos.tolist(), strict=True))


_Share = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False)]


class Body(Model, frozen=True):
    """A body of triangles in the water, in the air, or in both.

    Parameters
    ----------
    mesh : path or TriangleMesh
        File that trimesh reads (OBJ, PLY, STL, ...), z up; facets without area are left out. Files
        do not tell their unit: `scale` does.
    albedo : float, or table of wavelength
        Share of the light that is reflected, 0 ... 1; or rows of wavelength [nm] and albedo, an
        array or the path of a table (.csv, .txt), linear between its rows.
    reflection : {"lambert", "mirror", "black"}
        Reflect light as a Lambertian surface or as a mirror, both times the albedo, or absorb it.
    scale : float
        Metres per unit of the mesh [m], > 0.
    position : tuple of float
        Where the origin of the mesh lies, (x, y, z) [m], z up from still water.
    rotation_deg : tuple of float
        Turns of the mesh about its origin [deg]: about x, then y, then z, axes that stay fixed.
    sha256 : str, optional
        Digest of the file, or of the arrays of the mesh; follows from them.

    Raises
    ------
    Refused
        If the mesh cannot be read, has no facets or coordinates that are not finite, or is no
        longer that of `sha256`.

    Notes
    -----
    Both sides of a facet reflect, whatever its winding. A body is opaque: it has no inside, and a
    lamp within a closed one lights its walls. Bodies may cross the surface of the sea and each
    other: light meets the nearest facet, and the sea goes on inside a body, where no light comes.

    Both estimators follow bodies. `forced` joins light from Lambertian facets to the receiver; that
    of mirrors counts where photons hit the receiver. It refuses bodies that reflect above the
    lowest trough, and mirrors in a downlink over smooth waves. Studies by chains refuse bodies.

    Examples
    --------
    >>> from meshtrace.mesh import TriangleMesh
    >>> plate = TriangleMesh([(-1, -1, 0), (1, -1, 0), (0, 1, 0)], [(0, 1, 2)])
    >>> body = Body(plate, albedo=[(400, 0.1), (500, 0.3)], position=(0, 0, -4))
    >>> round(body.albedo_at(450.0), 6), float(body.triangles()[0][0, 2])
    (0.2, -4.0)
    """

    mesh: MeshOrFile
    albedo: Annotated[_Share | tuple[tuple[Positive, _Share], ...], BeforeValidator(_albedo)] = 0.2
    reflection: Literal["lambert", "mirror", "black"] = "lambert"
    scale: Positive = 1.0
    position: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    rotation_deg: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    sha256: str | None = None

    if TYPE_CHECKING:

        def __init__(
            self,
            mesh: str | PathLike[str] | TriangleMesh,
            *,
            albedo: float | str | ArrayLike | Mapping[str, Any] = 0.2,
            reflection: Literal["lambert", "mirror", "black"] = "lambert",
            scale: float = 1.0,
            position: tuple[float, float, float] = (0.0, 0.0, 0.0),
            rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0),
            sha256: str | None = None,
        ) -> None: ...

    else:

        def __init__(self, mesh=MISSING, /, **data):
            super().__init__(**data if mesh is MISSING else {"mesh": mesh} | data)

        __init__.__pydantic_base_init__ = True

    @model_validator(mode="after")
    def _same_mesh(self) -> Self:
        if self.mesh is None:
            raise Refused("mesh", None, READABLE)
        *_, digest = _facets_of(self.mesh)
        if self.sha256 not in (None, digest):
            other = Described(f"one with the SHA-256 {digest}")
            raise Refused("mesh", other, f"the mesh with the SHA-256 {self.sha256}")
        largest = float(np.abs(self.triangles()[0]).max())
        if not largest <= FARTHEST:
            far = Described(f"coordinates up to {largest:g} m")
            raise Refused("mesh", far, f"coordinates within {FARTHEST:g} m")
        # frozen: the digest follows from the mesh, and identifies the body in every result
        object.__setattr__(self, "sha256", digest)
        return self

    @property
    def n_facets(self) -> int:
        """Number of facets."""
        _, faces, _ = _facets_of(self.mesh)
        return len(faces)

    def triangles(self) -> tuple[Floats, NDArray[np.int32]]:
        """Return the vertices (n, 3) [m] of the placed body, and its faces (m, 3)."""
        vertices, faces, _ = _facets_of(self.mesh)
        if any(self.rotation_deg):
            from scipy.spatial.transform import Rotation

            turns = Rotation.from_euler("xyz", self.rotation_deg, degrees=True)
            vertices = vertices @ turns.as_matrix().T
        return self.scale * vertices + np.array(self.position), faces

    def albedo_at(self, wavelength_nm: float) -> float:
        """Return the albedo at a wavelength [nm]; 0 for a black body.

        Raises
        ------
        Refused
            If the table of albedos does not reach the wavelength.
        """
        if self.reflection == "black":
            return 0.0
        if not isinstance(self.albedo, tuple):
            return self.albedo
        wavelengths, albedos = zip(*self.albedo, strict=True)
        if not wavelengths[0] <= wavelength_nm <= wavelengths[-1]:
            allowed = f"a table that reaches {wavelength_nm:g} nm"
            span = Described(f"{wavelengths[0]:g} ... {wavelengths[-1]:g} nm")
            raise Refused("albedo", span, allowed)
        return float(np.interp(wavelength_nm, wavelengths, albedos))
