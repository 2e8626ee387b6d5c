"""Files of scenes: pyvista datasets, files for other programs, and pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import singledispatch
from io import BytesIO
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyvista as pv
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageFilter
from vtkmodules import vtkIOXML

from meshtrace.engine.paths import PhotonPaths
from meshtrace.engine.photons.state import Vertex
from meshtrace.errors import Described, Refused
from meshtrace.files import atomic
from meshtrace.link import Body, Link
from meshtrace.link.receivers import Aperture
from meshtrace.mesh import TriangleMesh
from meshtrace.results.series import CoverageMap

from .stage import ScenePlotter
from .style import BODY_COLORS, FATE_COLORS, RECEIVER_COLOR, SHALLOW


@singledispatch
def to_pyvista(source: TriangleMesh | PhotonPaths | CoverageMap | Body | Aperture) -> pv.DataSet:
    """Return a surface, photon paths, a map, a body or a receiver as a pyvista dataset.

    Parameters
    ----------
    source : TriangleMesh, PhotonPaths, CoverageMap, Body or receiver
        Result to show.

    Returns
    -------
    pyvista.PolyData or pyvista.ImageData
        For a surface: triangles with elevation [m], slopes and the exact normals at the points.
        For paths: lines with weight and events at the points, and with the photon and the final
        event of each line. For a map: cells with gain and its standard error, at the height of the
        receiver. For a body: triangles where the body is; for a receiver: its aperture.

    Raises
    ------
    Refused
        If the source has another type.

    Examples
    --------
    >>> from meshtrace.surfaces import FlatSea
    >>> to_pyvista(FlatSea().mesh(extent=1.0, spacing=0.5)).n_cells
    32
    """
    assert isinstance(source, TriangleMesh)
    # a copy, since VTK uses the memory of the array and scenes move points
    data = pv.PolyData.from_regular_faces(source.vertices.copy(), source.faces.astype(int))
    nx, ny, nz = source.vertex_normals.T
    data.point_data["elevation"] = source.vertices[:, 2]
    data.point_data["slope_x"] = -nx / nz
    data.point_data["slope_y"] = -ny / nz
    data.point_data["slope"] = np.hypot(nx, ny) / nz
    data.point_data.active_normals = source.vertex_normals
    return data


@to_pyvista.register
def _(source: PhotonPaths) -> pv.PolyData:
    points, cells = source.polylines()
    data = pv.PolyData(points, lines=cells)
    is_vertex = source.what >= 0  # paths of fewer vertices are padded with -1
    data.point_data["weight"] = source.weight[is_vertex]
    data.point_data["what"] = source.what[is_vertex]
    data.cell_data["photon"] = source.photon
    data.cell_data["final"] = source.final
    data.cell_data["received"] = source.received.astype(np.uint8)
    data.field_data["what_meanings"] = [f"{v.value} {v.name.lower()}" for v in Vertex]
    return data


@to_pyvista.register
def _(source: CoverageMap) -> pv.ImageData:
    step = source.x[1] - source.x[0] if len(source.x) > 1 else 1.0
    link = source.provenance.get("link")
    receivers = Link.model_validate(link).receivers if link is not None else ()
    height = receivers[0].center[2] if receivers else 0.0
    data = pv.ImageData(
        # a value belongs to a cell; the dimensions count the points, one more along each axis
        dimensions=(len(source.x) + 1, len(source.y) + 1, 1),
        spacing=(step, step, 1.0),
        origin=(source.x[0] - step / 2.0, source.y[0] - step / 2.0, height),
    )
    # x varies fastest in VTK
    data.cell_data["gain"] = source.gain.ravel(order="F")
    data.cell_data["gain_stderr"] = source.gain_stderr.ravel(order="F")
    return data


@to_pyvista.register
def _(source: Body) -> pv.PolyData:
    vertices, faces = source.triangles()
    return pv.PolyData.from_regular_faces(vertices, faces.astype(int))


@to_pyvista.register
def _(source: Aperture) -> pv.PolyData:
    disk: Any = pv.Disc(
        center=source.center, normal=source.axis, inner=0.0, outer=source.radius, c_res=60
    )
    return disk.triangulate()


def require_suffix(path: str | Path, suffixes: Iterable[str], field: str = "path") -> Path:
    """Return a path, or refuse it if it does not end in one of the suffixes."""
    path = Path(path)
    if path.suffix not in suffixes:
        *others, last = suffixes
        allowed = f"{', '.join(others)} or {last}" if others else last
        raise Refused(field, str(path), f"a file name in {allowed}")
    return path


_XML: dict[type[pv.DataSet], Any] = {
    pv.PolyData: vtkIOXML.vtkXMLPolyDataWriter,
    pv.UnstructuredGrid: vtkIOXML.vtkXMLUnstructuredGridWriter,
    pv.ImageData: vtkIOXML.vtkXMLImageDataWriter,
}
_SUFFIXES = {pv.PolyData: (".vtp", ".vtu", ".ply", ".stl"), pv.ImageData: (".vti",)}


def save_vtk(
    source: TriangleMesh | PhotonPaths | CoverageMap | Body | Aperture, path: str | Path
) -> Path:
    """Write a surface, photon paths, a map, a body or a receiver as a file for ParaView.

    Parameters
    ----------
    source : TriangleMesh, PhotonPaths, CoverageMap, Body or receiver
        Result to write; its arrays are those of `to_pyvista`.
    path : path
        File: .vtp or .vtu for surfaces, paths, bodies and receivers (also .ply, .stl without
        paths), .vti for maps.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    Refused
        If the suffix does not match the kind of data.
    """
    data = to_pyvista(source)
    allowed = _SUFFIXES[type(data)]
    # the formats .ply and .stl have no lines, which paths consist of
    path = require_suffix(path, allowed[:2] if isinstance(source, PhotonPaths) else allowed)
    if path.suffix == ".vtu":
        data = data.cast_to_unstructured_grid()
    with atomic(path) as temporary:
        if path.suffix in (".vtp", ".vtu", ".vti"):
            # by way of a string: writing itself, VTK would not report a full disk
            writer = _XML[type(data)]()
            writer.SetInputData(data)
            writer.WriteToOutputStringOn()
            writer.Write()
            temporary.write_bytes(writer.GetOutputString().encode())
        else:
            data.save(temporary)
    return path


SCENE_SUFFIXES = (".glb", ".gltf", ".obj")
"""File name suffixes of a whole scene in one file."""


def export_scene(scene: ScenePlotter, path: str | Path) -> list[Path]:
    """Write the parts of a scene as files for ParaView, or as one for Blender.

    Parameters
    ----------
    scene : ScenePlotter
        Drawing to export.
    path : path
        Folder, created if missing, for surface.vtp, body_1.vtp, receiver_1.vtp and so on,
        paths.vtp, received.vtp and map.vti; or a file .glb, .gltf or .obj of the same parts but
        the map, with y up as these formats have it, and paths as tubes within the stage.

    Returns
    -------
    list of Path
        The files; a .obj has a second one, .mtl, with its colours.
    """
    path = Path(path)
    if path.suffix in SCENE_SUFFIXES:
        return _save_solid(scene, path)
    path.mkdir(parents=True, exist_ok=True)
    return [
        save_vtk(source, path / f"{name}{_SUFFIXES[type(to_pyvista(source))][0]}")
        for name, source in scene.shown.items()
    ]


def _save_solid(scene: ScenePlotter, path: Path) -> list[Path]:
    """Write a scene as one triangle mesh; a .obj also gets a file of its colours."""
    from trimesh import Scene
    from trimesh.exchange.gltf import export_gltf
    from trimesh.exchange.obj import export_obj

    solids = Scene()
    for name, data, color in _solids(scene):
        solids.add_geometry(_solid(data, name, color), geom_name=name, node_name=name)
    files: dict[Path, bytes] = {}
    if path.suffix == ".glb":
        files[path] = solids.export(file_type="glb")
    elif path.suffix == ".gltf":
        files[path] = export_gltf(solids, embed_buffers=True)["model.gltf"]
    else:
        colors = path.with_suffix(".mtl")
        text, textures = export_obj(solids, return_texture=True, mtl_name=colors.name)
        files = {path: text.encode(), colors: textures[colors.name]}
    for file, content in files.items():
        with atomic(file) as temporary:
            temporary.write_bytes(content)
    return list(files)


def _solids(scene: ScenePlotter) -> Iterator[tuple[str, Any, str]]:
    """Yield the parts of a scene that have triangles, by name, with their colours."""
    for name, source in scene.shown.items():
        if isinstance(source, CoverageMap):
            continue
        if not isinstance(source, PhotonPaths):
            color = SHALLOW if isinstance(source, TriangleMesh) else RECEIVER_COLOR
            color = BODY_COLORS[source.reflection] if isinstance(source, Body) else color
            yield name, to_pyvista(source), color
            continue
        landed = ~source.received & (source.final == Vertex.LANDED)
        fates = source.received, landed, ~source.received & ~landed
        for (fate, color), which in zip(FATE_COLORS.items(), fates, strict=True):
            lines: Any = to_pyvista(source).extract_cells(which)
            lines = lines.clip_box(scene.stage.bounds, invert=False).extract_surface(algorithm=None)
            if lines.n_cells:
                tubes = lines.tube(radius=_THIN * scene.stage.size, n_sides=5)
                whole = name if name == "received" else f"{name}_{fate}".replace(" ", "_")
                yield whole, tubes, color


_THIN = 5e-4  # tuned: radius of a path over the size of the stage, a pixel or two of a picture


def _solid(data: pv.PolyData, name: str, color: str) -> Any:
    """Convert a part to a mesh of trimesh, from z up to y up."""
    from trimesh import Trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    data = data.triangulate()
    x, y, z = np.asarray(data.points, float).T
    clear = name == "surface"  # water is smooth and clear, all else dull
    rgba = np.rint(255.0 * np.array(to_rgba(color, 0.8 if clear else 1.0))).astype(np.uint8)
    look = PBRMaterial(
        name=name, baseColorFactor=rgba, metallicFactor=0.0, roughnessFactor=0.05 if clear else 0.8,
        alphaMode="BLEND" if clear else "OPAQUE", doubleSided=True,
    )  # fmt: skip
    points = np.column_stack([x, z, -y])
    return Trimesh(points, data.regular_faces, process=False, visual=TextureVisuals(material=look))


def save_screenshot(scene: ScenePlotter, path: str | Path) -> Path:
    """Write the image of a scene as a PNG, without background if the scene is transparent."""
    image = Image.fromarray(scene.screenshot(return_img=True))  # type: ignore[arg-type]
    if scene.transparent:
        pixels = scene.screenshot(return_img=True, transparent_background=True)
        drawn, alpha = np.split(np.asarray(pixels, float), [3], axis=2)
        # VTK has blended the colours with the background, black
        drawn = np.minimum(255.0 * drawn / np.maximum(alpha, 1.0), 255.0)
        image = Image.fromarray(np.rint(np.concatenate([drawn, alpha], axis=2)).astype(np.uint8))
    with atomic(path) as temporary:
        image.save(temporary)
    return Path(path)


def save_picture(picture: pv.Plotter | Figure, path: str | Path, largest: int = 400_000) -> Path:
    """Write the image of a plotter or a figure as a PNG of limited size.

    Parameters
    ----------
    picture : pyvista.Plotter or matplotlib.figure.Figure
        Plotter or scene, or a figure, which is written in a palette of 256 colours.
    path : path
        File, .png.
    largest : int
        Size [byte] beyond which a picture of a plotter has a palette of 256 colours, and a figure
        one of 128 or 64.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    Refused
        If the suffix is not .png, or the plotter has not been rendered.
    """
    path = require_suffix(path, (".png",))
    if isinstance(picture, Figure):
        buffer = BytesIO()
        picture.savefig(buffer, format="png")
        drawn = Image.open(buffer).convert("RGB")
        versions = (drawn.quantize(n, dither=Image.Dither.NONE) for n in (256, 128, 64))
    else:
        try:
            pixels = np.asarray(picture.screenshot(return_img=True))
        except (AttributeError, RuntimeError) as error:  # pyvista's, of several lines
            closed = Described("not rendered, or closed")
            raise Refused("picture", closed, "a plotter in use") from error
        shot = Image.fromarray(pixels)
        versions = (make(shot) for make in (lambda full: full, _in_palette))
    with atomic(path) as temporary:
        for image in versions:
            image.save(temporary, optimize=True)
            # smaller palettes are made only as long as the file is too large
            if temporary.stat().st_size <= largest:
                break
    return path


def _in_palette(shot: Image.Image) -> Image.Image:
    """Reduce a picture to 256 colours: 160 for gradients, where steps show, 96 for the rest."""
    # 160 and 96 are tuned: banding of the sky and water against false colours of symbols
    pixels, quantize = np.asarray(shot), cast(Any, Image.Quantize)
    extremes = (
        np.asarray(shot.filter(filter_of(5)))
        for filter_of in (ImageFilter.MaxFilter, ImageFilter.MinFilter)
    )
    is_even = np.subtract(*extremes).max(axis=2) <= _EVEN
    # each shade once, so that large areas do not get more colours than small ones
    shades = np.unique(pixels[is_even], axis=0)
    levels: list[int] = []
    for colors, n, method in (
        (shades, 160, quantize.MEDIANCUT),
        (pixels[~is_even], 96, quantize.MAXCOVERAGE),
    ):
        if len(colors):
            image = Image.fromarray(colors[None]).quantize(n, method=method, kmeans=3)
            levels += (image.getpalette() or [])[: 3 * n]
    palette = Image.new("P", (1, 1))
    palette.putpalette(levels)
    return shot.quantize(palette=palette, dither=Image.Dither.NONE)


_EVEN = 6
"""Largest difference of levels (of 256) within 5 by 5 pixels that count as a gradient (tuned)."""


def surface_sampler(mesh: TriangleMesh) -> Callable[[ArrayLike], NDArray[np.float64]]:
    """Return a function from places (n, 2) [m] to elevations (n,) [m] of a mesh, 0 outside."""
    flat = to_pyvista(mesh)
    # facets and places are both moved to z = 0, where VTK locates the places
    flat.points = np.asarray(flat.points) * (1.0, 1.0, 0.0)

    def elevation(places: ArrayLike) -> NDArray[np.float64]:
        points = np.pad(np.asarray(places, dtype=float), ((0, 0), (0, 1)))
        return np.asarray(pv.PolyData(points).sample(flat).point_data["elevation"])

    return elevation
