"""The light of a scene: photon paths, their footprint on the surface, coverage of a plane."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
import pyvista as pv

from meshtrace.engine.paths import PhotonPaths
from meshtrace.engine.photons.state import Vertex
from meshtrace.errors import Refused
from meshtrace.mesh import TriangleMesh
from meshtrace.results.coverage import CoverageMap

from .export import surface_sampler, to_pyvista
from .stage import ScenePlotter
from .style import CHALK, FATE_COLORS, SEQUENTIAL

PathColor = Literal["fate", "weight"]


def add_paths(
    scene: ScenePlotter, paths: PhotonPaths, *, color: PathColor = "fate"
) -> ScenePlotter:
    """Draw photon paths within the stage.

    Parameters
    ----------
    scene : ScenePlotter
        Scene to draw into.
    paths : PhotonPaths
        The paths.
    color : {"fate", "weight"}
        Colour by the fate of the photon, or by its weight along the path. Rays are the fainter
        the more there are and the less light they carry, and fade out at the sides of the stage.
        Received light is drawn thicker; dots mark its scattering.

    Returns
    -------
    ScenePlotter
        The same scene.

    Raises
    ------
    Refused
        If the colour is unknown.
    """
    scene.shown["received" if paths.received.all() else "paths"] = paths
    width = scene.window_size[0] / 1600.0
    landed = ~paths.received & (paths.final == Vertex.LANDED)
    fates = (paths.received, landed, ~paths.received & ~landed)  # in the order of the colours
    for (name, shade), rows in reversed([*zip(FATE_COLORS.items(), fates, strict=True)]):
        chosen = select_paths(paths, rows)
        if not len(chosen.what):
            continue
        received = name == "received"
        rays, seen = _rays(scene, chosen)
        if not seen:
            continue
        strength = (_RECEIVED if received else _SEEN) / math.sqrt(seen)
        alpha = min(strength, 0.8) * rays["fade"] * (1.0 if received else rays["weight"])
        thick: Any = {"line_width": (1.6 if received else 1.0) * width}
        if color == "weight":
            look: Any = {"cmap": SEQUENTIAL, "clim": (0.0, 1.0), "opacity": alpha}
            bar = scene.bar("photon weight")
            scene.add_mesh(
                rays, scalars="weight", lighting=False, scalar_bar_args=bar, **look, **thick
            )
        else:
            scene.add_tinted(rays, shade, alpha, **thick)
            scene.key[f"photons {name}"] = shade
        if received:
            _add_dots(scene, chosen, (Vertex.SCATTER,), 0.002 * scene.stage.size, shade)
    return scene


_SEEN, _RECEIVED = 10.0, 3.0  # opacity of the rays times the root of their number
_PIECES = 60  # of a ray as long as the stage
_SOFT = 0.1  # width of the rim in which rays fade, over the size of the stage


def _rays(scene: ScenePlotter, paths: PhotonPaths) -> tuple[pv.PolyData, int]:
    """Return photon paths as short straight pieces, and the number of photons seen.

    Points have the weight, and a factor by which rays fade towards the sides of the stage, and at
    their end if that is no aperture.
    """
    stage, count = scene.stage, np.maximum(paths.length - 1, 0)
    row = np.repeat(np.arange(len(count)), count)
    step = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    start, end = paths.vertex[row, step], paths.vertex[row, step + 1]
    low, high = np.reshape(stage.bounds, (3, 2)).T
    length = np.linalg.norm(end - start, axis=1)
    near = (np.maximum(start, end) > low).all(axis=1) & (np.minimum(start, end) < high).all(axis=1)
    start, end, length, row, step = (a[near] for a in (start, end, length, row, step))
    last = (step == paths.length[row] - 2) & ~paths.received[row]
    longest = 3.0 * stage.size  # of the rest nothing is seen
    shown = np.minimum(length, longest)
    end = start + (shown / np.maximum(length, 1e-12))[:, None] * (end - start)
    n = np.ceil(shown / stage.size * _PIECES).astype(int) + 1
    share = (np.arange(n.sum()) - np.repeat(np.cumsum(n) - n, n)) / np.repeat(n - 1, n).clip(1)
    points = np.repeat(start, n, axis=0) + share[:, None] * np.repeat(end - start, n, axis=0)
    pieces = np.column_stack([np.arange(n.sum())[:-1], np.arange(n.sum())[1:]])
    inside = np.minimum(points - low, high - points).min(axis=1)
    ahead = np.where(np.repeat(last, n), (1.0 - share) * np.repeat(length, n), np.inf)
    fade = np.clip(np.minimum(inside, ahead) / (_SOFT * stage.size), 0.0, 1.0)
    first = np.zeros(n.sum(), bool)
    first[np.cumsum(n) - n] = True
    kept = ~first[pieces[:, 1]] & (fade[pieces] > 0.0).any(axis=1)
    rays = pv.PolyData(points, lines=np.insert(pieces[kept], 0, 2, axis=1).ravel())
    before, after = (np.repeat(paths.weight[row, step + i], n) for i in (0, 1))
    rays["weight"], rays["fade"] = before + share * (after - before), fade
    return rays, len(np.unique(row))


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
    scene: ScenePlotter, paths: PhotonPaths, what: tuple[Vertex, ...], radius: float, color: str
) -> None:
    """Draw balls at the events within the stage."""
    points = paths.vertex[np.isin(paths.what, what)]
    low, high = np.reshape(scene.stage.bounds, (3, 2)).T
    points = points[((points >= low) & (points <= high)).all(axis=1)]
    if len(points):
        ball = pv.Sphere(radius=radius, theta_resolution=10, phi_resolution=10)
        dots = pv.PolyData(points).glyph(geom=ball, scale=False, orient=False)
        scene.add_mesh(dots, color=color, ambient=0.6)


_LEGIBLE = 0.1  # size over that of the stage of a patch whose colours can be read
FOOTPRINT_RANGE_DB = 20.0
"""Lower end of the colours of the footprint, below its brightest spot."""


def add_footprint(scene: ScenePlotter, mesh: TriangleMesh, received: PhotonPaths) -> ScenePlotter:
    """Draw the crossings of the received light, in decibels below the brightest spot.

    Parameters
    ----------
    scene : ScenePlotter
        Scene to draw into.
    mesh : TriangleMesh
        The surface.
    received : PhotonPaths
        Paths of received light, drawn in proportion to the light they carry.

    Returns
    -------
    ScenePlotter
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
    look: Any = {"opacity": "linear", "lighting": False, "show_scalar_bar": False}
    if max(np.ptp(np.reshape(lit.bounds, (3, 2)), axis=1)) > _LEGIBLE * size:
        look |= {
            "show_scalar_bar": True,
            "scalar_bar_args": scene.bar("received light crossing [dB]"),
        }
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


def add_coverage(scene: ScenePlotter, coverage: CoverageMap) -> ScenePlotter:
    """Draw a map of the gain in the plane of the receiver, clipped to the stage.

    It is the clearer the smaller the gain, so that it hides nothing.
    """
    scene.shown["map"] = coverage
    data = to_pyvista(coverage).clip_box(scene.stage.bounds, invert=False)
    frame = data.extract_feature_edges()
    scene.add_mesh(frame, color=CHALK, opacity=0.5, lighting=False, name="frame")
    look: Any = {"cmap": "inferno", "opacity": [0.05, 0.6, 0.7], "lighting": False}
    bar = scene.bar("channel gain")
    scene.add_mesh(data, scalars="gain", name="coverage", scalar_bar_args=bar, **look)
    return scene
