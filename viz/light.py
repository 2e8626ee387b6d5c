"""The light of a scene: photon paths, their footprint on the surface, coverage of a plane."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pyvista as pv

from meshtrace.engine.paths import PhotonPaths
from meshtrace.engine.photons.state import Vertex
from meshtrace.errors import Refused
from meshtrace.mesh import TriangleMesh
from meshtrace.results.coverage import CoverageMap

from .export import surface_sampler, to_pyvista
from .stage import Scene
from .style import FATE_COLORS, INK, SEQUENTIAL

PathColor = Literal["fate", "weight"]


def fate_names(paths: PhotonPaths) -> np.ndarray:
    """Return the key of `FATE_COLORS` for every path."""
    received, landed, water = FATE_COLORS
    names = np.full(len(paths.what), water, dtype=object)
    names[paths.final == Vertex.LANDED] = landed
    names[paths.received] = received
    return names


def add_paths(scene: Scene, paths: PhotonPaths, *, color: PathColor = "fate") -> Scene:
    """Draw photon paths within the stage.

    Parameters
    ----------
    scene : Scene
        Scene to draw into.
    paths : PhotonPaths
        The paths.
    color : {"fate", "weight"}
        Colour by the fate of the photon, or by its weight along the path. Received light
        is drawn thicker; dots mark scattering, rings of light the crossing of the surface.

    Returns
    -------
    Scene
        The same scene.

    Raises
    ------
    Refused
        If the colour is unknown.
    """
    scene.shown["received" if paths.received.all() else "paths"] = paths
    names, size = fate_names(paths), scene.stage.size
    for name, shade in reversed(FATE_COLORS.items()):
        chosen = select_paths(paths, names == name)
        if not len(chosen.what):
            continue
        received = name == "received"
        clipped = to_pyvista(chosen).clip_box(scene.stage.bounds, invert=False)
        radius = (0.0016 if received else 0.001) * size
        tubes = clipped.extract_surface(algorithm=None).tube(radius=radius, n_sides=8)
        look: Any = {"color": shade}
        if color == "weight":
            look = {"scalars": "weight", "cmap": SEQUENTIAL, "clim": (0.0, 1.0)}
            look["scalar_bar_args"] = scene.bar("photon weight")
        scene.add_mesh(tubes, opacity=1.0 if received else 0.55, ambient=0.5, **look)
        _add_dots(scene, chosen, (Vertex.SCATTER,), 2.2 * radius, INK)
        if received:
            _add_dots(scene, chosen, _CROSSINGS, 2.2 * radius, "#FFFFFF")
        if color == "fate":
            scene.key[f"photons {name}"] = shade
    return scene


def select_paths(paths: PhotonPaths, rows: np.ndarray | slice) -> PhotonPaths:
    """Return some of the paths, chosen by index, mask or slice."""
    try:
        return PhotonPaths(
            paths.vertex[rows], paths.weight[rows], paths.what[rows], paths.photon[rows]
        )
    except (IndexError, TypeError) as error:
        raise Refused("rows", rows, f"indices, a mask or a slice of {len(paths.what)}") from error


_CROSSINGS = (Vertex.SURFACE_OUT, Vertex.SURFACE_IN)


def _add_dots(
    scene: Scene, paths: PhotonPaths, what: tuple[Vertex, ...], radius: float, color: str
) -> None:
    """Draw balls at the events within the stage."""
    points = paths.vertex[np.isin(paths.what, what)]
    low, high = np.reshape(scene.stage.bounds, (3, 2)).T
    points = points[((points >= low) & (points <= high)).all(axis=1)]
    if len(points):
        ball = pv.Sphere(radius=radius, theta_resolution=10, phi_resolution=10)
        dots = pv.PolyData(points).glyph(geom=ball, scale=False, orient=False)
        scene.add_mesh(dots, color=color, ambient=0.6)


FOOTPRINT_RANGE_DB = 20.0
"""Lower end of the colours of the footprint, below its brightest spot."""


def add_footprint(scene: Scene, mesh: TriangleMesh, received: PhotonPaths) -> Scene:
    """Draw the crossings of the received light, in decibels below the brightest spot.

    Parameters
    ----------
    scene : Scene
        Scene to draw into.
    mesh : TriangleMesh
        The surface.
    received : PhotonPaths
        Paths of received light, drawn in proportion to the light they carry.

    Returns
    -------
    Scene
        The same scene.
    """
    crossings = received.vertex[np.isin(received.what, _CROSSINGS)][:, :2]
    if not len(crossings):
        return scene
    size = scene.stage.size
    patch = _footprint(mesh, crossings, 0.008 * size)
    patch.points += np.array([0.0, 0.0, 1e-3 * size])  # or it would flicker with the surface
    lit = patch.threshold(-FOOTPRINT_RANGE_DB, scalars="footprint", all_scalars=False)
    lit = lit.clip_box(scene.stage.bounds, invert=False)
    if not lit.n_cells:
        return scene
    colors: Any = {"scalars": "footprint", "clim": (-FOOTPRINT_RANGE_DB, 0.0), "cmap": "inferno"}
    bar = scene.bar("received light crossing [dB]")
    look: Any = {"opacity": "linear", "lighting": False, "scalar_bar_args": bar}
    scene.add_mesh(lit, name="footprint", **colors, **look)
    return scene


def _footprint(mesh: TriangleMesh, crossings: np.ndarray, blur: float) -> pv.StructuredGrid:
    """Return a piece of the surface with the density of crossings, blurred [m], below its peak."""
    from scipy.ndimage import gaussian_filter

    low, high = crossings.min(axis=0) - 4.0 * blur, crossings.max(axis=0) + 4.0 * blur
    n = np.clip(np.ceil((high - low) / (0.5 * blur)).astype(int), 2, 300)
    count, edges = np.histogramdd(crossings, bins=n, range=list(zip(low, high, strict=True)))
    density = gaussian_filter(count, blur * n / (high - low), mode="constant")
    x, y = np.meshgrid(*(0.5 * (e[1:] + e[:-1]) for e in edges), indexing="ij")
    z = surface_sampler(mesh)(np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape)
    patch = pv.StructuredGrid(x, y, z)
    floor = 10.0 ** (-0.1 * FOOTPRINT_RANGE_DB - 1.0)
    level = 10.0 * np.log10(np.maximum(density / density.max(), floor))
    patch.point_data["footprint"] = level.ravel(order="F")
    return patch


def add_coverage(scene: Scene, coverage: CoverageMap) -> Scene:
    """Draw a map of the gain in the plane of the receiver, clipped to the stage."""
    scene.shown["map"] = coverage
    data = to_pyvista(coverage).clip_box(scene.stage.bounds, invert=False)
    look: Any = {"cmap": SEQUENTIAL, "opacity": 0.75, "lighting": False}
    bar = scene.bar("channel gain")
    scene.add_mesh(data, scalars="gain", name="coverage", scalar_bar_args=bar, **look)
    return scene
