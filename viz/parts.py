"""The parts of a link in a scene: sea, bubbles, bodies, sources, receivers and the aircraft."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from typing import Any, Literal

import numpy as np
import pyvista as pv
from matplotlib.colors import ListedColormap, to_rgb
from numpy.typing import ArrayLike

from meshtrace.engine.bvh import EmbreeIntersector
from meshtrace.link import Link, Receiver
from meshtrace.link.receivers import Aperture
from meshtrace.link.sources import AirLamp, Source, WaterSource
from meshtrace.mesh import TriangleMesh
from meshtrace.optics.bubbles import BubblePopulation

from .export import surface_sampler, to_pyvista
from .stage import ScenePlotter, Stage, Z, add_labels, round_range
from .style import BODY_COLORS, LED_COLOR, PALETTE, RECEIVER_COLOR, SHALLOW, plain_label, water_map
from .water import SeaLight, ShadedSea

SurfaceColor = Literal["water", "elevation", "slope", "slope_x", "slope_y", "plain"]

SURFACE_COLORS = {
    "elevation": plain_label("elevation"),
    "slope": "slope of the surface",
    "slope_x": plain_label("slope_x"),
    "slope_y": plain_label("slope_y"),
}
"""Titles of the colour bars of the surface."""

BUBBLE_COLOR = EDGE_COLOR = "#FFFFFF"
_AIRCRAFT_COLOR = "#9AA6B2"
LIGHT_COLOR = "#BFF3FF"
"""Colour of a beam in the water."""

Vector = tuple[float, float, float]


def add_surface(
    scene: ScenePlotter,
    mesh: TriangleMesh,
    *,
    color: SurfaceColor = "water",
    color_limit: float | None = None,
    edges: bool = False,
    opacity: float = 0.9,
    shaded: ShadedSea | None = None,
    light_color: str = "white",
) -> ScenePlotter:
    """Draw the sea surface within the stage.

    Parameters
    ----------
    scene : ScenePlotter
        Scene to draw into.
    mesh : TriangleMesh
        The surface.
    color : str
        "water": as a viewer sees it; "elevation", "slope", "slope_x", "slope_y" or "plain".
    color_limit : float, optional
        End of the colour scale, in the unit of `color`; it begins at minus this value, or at 0 for
        "slope". By default the range of the values.
    edges : bool
        Draw the edges of the facets.
    opacity : float
        0 for clear, 1 for opaque.
    shaded : ShadedSea, optional
        Colours of "water"; by default those of this mesh, without wind, in the default daylight.
    light_color : str
        Colour of the light on "water": grey for dusk.

    Returns
    -------
    ScenePlotter
        The same scene.

    Raises
    ------
    Refused
        If the colour is unknown.
    """
    scene.shown["surface"] = mesh
    data: Any = to_pyvista(mesh)
    if color == "water":
        _add_water(scene, data, shaded or ShadedSea(mesh, SeaLight()), opacity, edges, light_color)
        return scene
    data = _within(data, scene.stage.bounds)
    look: dict[str, Any] = {"color": PALETTE["blue"]}
    if color != "plain":
        clim = limits_of(data.point_data[color], color, color_limit)
        bar = scene.bar(SURFACE_COLORS[color])
        look = {"scalars": color, "clim": clim, "cmap": water_map(), "scalar_bar_args": bar}
    scene.add_mesh(
        data, name="surface", opacity=opacity, smooth_shading=True,
        show_edges=edges, edge_color=EDGE_COLOR, edge_opacity=0.25, line_width=1.2,
        ambient=0.3, diffuse=0.75, specular=0.2, specular_power=30.0, **look,
    )  # fmt: skip
    return scene


def limits_of(values: Any, color: str, color_limit: float | None) -> tuple[float, float]:
    """Return the limits of the colour scale of a surface; see `add_surface`."""
    if color_limit is not None:
        return (0.0 if color == "slope" else -color_limit, color_limit)
    if color != "elevation":
        # facets of a crest that hangs over have slopes without a bound, which would leave one
        # colour to all others
        values = np.clip(values, -_STEEPEST, _STEEPEST)
    return round_range(float(values.min()), float(values.max()))


_STEEPEST = 2.0  # tuned: slope beyond which colours do not change, 63 degrees


def _add_water(
    scene: ScenePlotter, data: pv.PolyData, shaded: ShadedSea, opacity: float, edges: bool,
    light_color: str,
) -> None:  # fmt: skip
    """Draw the water as seen from the camera; `look` updates its colours."""
    if textured := shaded.grid is not None:
        u, v = np.meshgrid(*(np.linspace(0.0, 1.0, n) for n in shaded.grid), indexing="ij")
        data.active_texture_coordinates = np.column_stack([u.ravel(), v.ravel()])
    else:
        data.point_data["tint"] = np.zeros((data.n_points, 3), np.uint8)
    data = _within(data, scene.stage.bounds)
    # the colours are those of reflected light: no lamp of the scene shall shade them again
    actor = scene.add_mesh(
        data, name="surface", color=light_color, opacity=opacity, lighting=False,
        ambient=1.0, diffuse=0.0, specular=0.0,
        scalars=None if textured else "tint", rgb=not textured,
    )  # fmt: skip
    if edges:  # VTK draws no edges of textured facets
        scene.add_mesh(
            data, name="edges", style="wireframe", color=EDGE_COLOR, opacity=0.25, line_width=1.2,
            lighting=False,
        )  # fmt: skip

    def shade() -> None:
        colors = shaded.colors(tuple(scene.camera.position))
        if not textured:
            data.point_data["tint"] = np.rint(colors * to_rgb(light_color)).astype(np.uint8)
            return
        # (nx, ny, 3) to lines of an image, of which the first is the top, v = 1
        texture = pv.Texture(np.ascontiguousarray(colors.transpose(1, 0, 2)[::-1]))
        texture.interpolate, texture.mipmap = True, True
        actor.texture = texture

    scene.shade = shade
    shade()


def _within(data: pv.PolyData, bounds: Any, axes: int = 2) -> pv.PolyData:
    """Clip facets to the stage along its first `axes`; choppy seas reach beyond its sides."""
    # bounds: x0, x1, y0, y1, z0, z1
    for i, normal in enumerate(np.eye(3)[:axes]):
        low, high = bounds[2 * i : 2 * i + 2]
        if data.n_cells and data.bounds[2 * i] < low:
            data = data.clip(normal, origin=low * normal, invert=False)
        if data.n_cells and data.bounds[2 * i + 1] > high:
            data = data.clip(normal, origin=high * normal)
    return data


def add_bubbles(
    scene: ScenePlotter,
    mesh: TriangleMesh,
    bubbles: BubblePopulation | None = None,
    *,
    near: bool = False,
) -> ScenePlotter:
    """Draw the block of water below the surface, with bubbles in proportion to their density.

    Bubbles are enlarged points at random places, one for many. The far and the near sides, as seen
    from the camera, are two parts; all other parts are drawn between them.

    Parameters
    ----------
    scene : ScenePlotter
        Scene to draw into.
    mesh : TriangleMesh
        The surface.
    bubbles : BubblePopulation, optional
        The bubbles; clear water by default.
    near : bool
        Draw the near sides, with lower opacity, instead of the far ones.

    Returns
    -------
    ScenePlotter
        The same scene.
    """
    corners, bottom = walls(mesh, scene.stage.bottom), scene.stage.bottom
    faces: Any = np.arange(3 * len(corners)).reshape(-1, 3)
    block = pv.PolyData.from_regular_faces(corners.reshape(-1, 3), faces)
    if not near:
        # where a wave hangs over, the edge of the mesh runs back and forth above its foot
        (x0, y0, _), (x1, y1, _) = mesh.bounds
        foot = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
        foot = foot if mesh.overhangs else mesh.vertices[outline(mesh)[:-1], :2]
        foot = np.pad(foot, ((0, 0), (0, 1)), constant_values=bottom)
        scene.add_mesh(pv.lines_from_points(foot, close=True), color=SHALLOW, opacity=0.5)
        floor = pv.PolyData(foot, faces=[len(foot), *reversed(range(len(foot)))]).triangulate()
        block = pv.merge([block, floor], merge_points=False)
    levels = np.linspace(bottom, 0.0, 256)
    dark = _darkness(scene, np.pad(levels[:, None], ((0, 0), (2, 0))))
    shallow, deep = (np.array(to_rgb(c)) for c in (SHALLOW, scene.deep))
    # near sides face the camera: culling removes the others; opacities are tuned
    name, alpha = ("near water", 0.302) if near else ("water", 0.97)
    block.point_data["z"] = block.points[:, 2]
    scene.add_mesh(
        block, scalars="z", cmap=ListedColormap(shallow + dark * (deep - shallow)),
        clim=(bottom, 0.0), opacity=alpha, lighting=False, show_scalar_bar=False, name=name,
        culling="back" if near else "front",
    )  # fmt: skip
    if bubbles is not None and not near:
        _add_points(scene, mesh, bubbles)
    return scene


def walls(mesh: TriangleMesh, bottom: float) -> np.ndarray:
    """Return the triangles (n, 3, 3) [m] of the side walls of the water below a mesh.

    They are anticlockwise from outside. Where the edge of a wave that hangs over stays in a plane
    they fill what it encloses with the foot, so that air below the crest stays free.
    """
    ring = mesh.vertices[outline(mesh)]
    foot = np.column_stack([ring[:, :2], np.full(len(ring), bottom)])
    a, b, c, d = ring[:-1], ring[1:], foot[:-1], foot[1:]
    if not mesh.overhangs:
        return np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])
    (x0, y0, _), (x1, y1, _) = mesh.bounds
    close = 1e-6 * max(x1 - x0, y1 - y0)
    ends_of_mesh = (1, y0), (0, x1), (1, y1), (0, x0)
    on = np.stack([np.abs(ring[:, k] - end) < close for k, end in ends_of_mesh])
    # the side of the mesh that each piece of the edge lies on; -1: none, as of a round mesh
    both = on[:, :-1] & on[:, 1:]
    side = np.where(both.any(axis=0), both.argmax(axis=0), -1)
    start = int(np.argmax(side != np.roll(side, 1)))  # of a side
    side, ring = np.roll(side, -start), np.vstack([np.roll(ring[:-1], -start, axis=0), ring[start]])
    cuts = np.flatnonzero((side[1:] != side[:-1]) | (side[1:] < 0)) + 1
    triangles = []
    for piece in np.split(np.arange(len(side)), cuts):
        top = ring[piece[0] : piece[-1] + 2]
        ends = top[[0, -1]].copy()
        ends[:, 2] = bottom
        n = len(top) + 2
        filled = pv.PolyData(np.vstack([ends, top[::-1]]), faces=[n, *range(n)]).triangulate()
        triangles.append(filled.points[filled.regular_faces])
    return np.concatenate(triangles)


def cut_to(mesh: TriangleMesh, bounds: Any) -> TriangleMesh:
    """Clip a mesh to the limits (x, x, y, y) [m]; keep a mesh outside them whole."""
    data: Any = to_pyvista(mesh)
    data.point_data["normal"] = mesh.vertex_normals
    cut = _within(data, bounds)
    if cut is data or not cut.n_cells:
        return mesh
    cut = cut.triangulate().clean(tolerance=1e-9)
    # exactly within, or it would be cut again when it is drawn
    low, high = np.reshape(bounds, (3, 2)).T
    points, faces = np.asarray(cut.points, float), cut.regular_faces
    points[:, :2] = np.clip(points[:, :2], low[:2], high[:2])
    a, b, c = points[faces].swapaxes(0, 1)
    area = np.cross(b - a, c - a)
    # slivers at the sides of the stage have no normal
    whole = np.linalg.norm(area, axis=1) > 1e-12
    whole &= mesh.overhangs | (area[:, 2] > 0.0)
    normals = np.asarray(cut.point_data["normal"], float)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return TriangleMesh(points, faces[whole], normals, mesh.unresolved, mesh.overhangs)


def _add_points(scene: ScenePlotter, mesh: TriangleMesh, bubbles: BubblePopulation) -> None:
    """Draw bubbles in three sizes."""
    points = bubble_points(scene.stage, mesh, bubbles)
    # points are sized for windows of 1600 pixels
    pixel = scene.window_size[0] / 1600.0
    for i, (size, alpha) in enumerate(((2.0, 0.3), (3.0, 0.5), (5.0, 0.7))):
        # a third of the points each, but only a quarter of the largest
        subset = points[i::3] if i < 2 else points[2::12]
        if len(subset):
            scene.add_mesh(
                pv.PolyData(subset), color=BUBBLE_COLOR, opacity=alpha, point_size=size * pixel,
                render_points_as_spheres=True, lighting=False,
            )  # fmt: skip
    scene.key[bubble_words(bubbles)] = BUBBLE_COLOR


def bubble_words(bubbles: BubblePopulation) -> str:
    """Return the label of bubbles in a key."""
    return f"bubbles, {float(bubbles.b(0.0)):.2g} 1/m at the surface"


def bubble_points(stage: Stage, mesh: TriangleMesh, bubbles: BubblePopulation) -> np.ndarray:
    """Sample points (n, 3) [m] whose density follows the scattering by bubbles."""
    rng = np.random.default_rng(1)
    depth = np.linspace(0.0, -stage.bottom, 2001)
    b = bubbles.b(depth)
    # optical thickness from the surface down; trapezoidal: scipy.integrate takes seconds to import
    cumulated = np.append(0.0, np.cumsum(0.5 * (b[1:] + b[:-1]) * np.diff(depth)))
    n = int(min(_BUBBLES_SHOWN * cumulated[-1] / _THICK, 2.0 * _BUBBLES_SHOWN))
    x, y = (c + stage.half * rng.uniform(-1.0, 1.0, n) for c in stage.center)
    z = surface_sampler(mesh)(np.column_stack([x, y]))
    # depths below the surface by inversion: uniform in optical thickness
    z -= np.interp(rng.uniform(0.0, cumulated[-1], n), cumulated, depth)
    return np.column_stack([x, y, z])[z > stage.bottom]


_BUBBLES_SHOWN, _THICK = 12_000, 0.05
"""Bubbles drawn, and the optical thickness of scattering at which there are so many (tuned)."""


def outline(mesh: TriangleMesh) -> np.ndarray:
    """Return the indices of the vertices along the edge of a mesh, anticlockwise and closed."""
    facets = pv.PolyData.from_regular_faces(mesh.vertices, mesh.faces.astype(int))
    facets["vertex"] = np.arange(facets.n_points)
    edge = facets.extract_feature_edges(
        boundary_edges=True, feature_edges=False, manifold_edges=False, non_manifold_edges=False
    )
    # in one piece: by default strips end after a thousand points
    loop = edge.strip(join=True, max_length=edge.n_points + 1)
    ring = np.asarray(loop["vertex"])[loop.lines[1 : loop.lines[0] + 1]]
    x, y = mesh.vertices[ring, :2].T
    # twice the signed area (shoelace formula), negative if clockwise
    clockwise = float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])) < 0.0
    return ring[::-1] if clockwise else ring


def add_bodies(scene: ScenePlotter, link: Link) -> ScenePlotter:
    """Draw the bodies of a link within the stage, darker with depth as the water is."""
    for i, body in enumerate(link.bodies, 1):
        scene.shown[f"body_{i}"] = body
        facets: Any = to_pyvista(body)
        solid = _within(facets, scene.stage.bounds, 3)
        if not solid.n_cells:
            continue
        color, deep = (np.array(to_rgb(c)) for c in (BODY_COLORS[body.reflection], SHALLOW))
        haze = _HAZE * _darkness(scene, solid.points)
        colors = color + haze * (deep * (1.0 - haze) - color)
        solid.point_data["tint"] = np.rint(255.0 * colors).astype(np.uint8)
        scene.add_mesh(
            solid, name=f"body_{i}", scalars="tint", rgb=True, ambient=0.25, specular=0.1
        )
        name = "body" if body.reflection == "lambert" else f"{body.reflection} body"
        scene.key[name] = BODY_COLORS[body.reflection]
    return scene


_HAZE = 0.5  # tuned: share of the colour of the water in that of a body at the bottom of the stage


def _darkness(scene: ScenePlotter, points: Any) -> Any:
    """Return the darkness of the water at points (n, 1), from 0 at the surface to 1."""
    # light from above decays with depth; 3: tuned, to e^-3 at the bottom
    return 1.0 - np.exp(-3.0 * np.clip(points[:, 2:] / scene.stage.bottom, 0.0, 1.0))


def add_transmitter(
    scene: ScenePlotter, link: Link, mesh: TriangleMesh, *, labels: bool = True
) -> ScenePlotter:
    """Draw every source: an LED or a beam with its cone, or the light of the sun or sky.

    The cone ends at the surface; its half-angle is that of half power (LED), of 1/e^2
    (Gaussian beam), or of the whole beam.
    """
    for source in link.transmitters:
        if not isinstance(source, WaterSource | AirLamp):
            _add_sky(scene, source, labels)
            continue
        center = source.center
        half_angle = source.spread_deg
        if half_angle < 180.0:
            if scene.stage.contains(center):
                _add_beam(scene, mesh, link.water.c, center, source.axis, half_angle)
            _add_cone(scene, mesh, center, source.axis, half_angle, LED_COLOR, fill=0.0)
        if not scene.stage.contains(center):
            continue
        ball = pv.Sphere(radius=0.012 * scene.stage.size, center=center)
        scene.add_mesh(ball, color=LED_COLOR, ambient=0.7, specular=0.3)
        angle = f"\nhalf-angle {half_angle:g}°" if half_angle < 180.0 else ""
        if labels:
            _label(scene, center, 0.03, ", ".join(words_of(source)) + angle)
    return scene


def words_of(item: Source | Aperture) -> list[str]:
    """Describe a source or receiver by its kind and, if it has one, its height or depth."""
    name = "LED" if getattr(item, "pattern", "") == "led" else item.kind.replace("-", " ")
    keys = [key for key in ("height", "depth") if hasattr(item, key)]
    return [name, *(f"{key} {getattr(item, key):g} m" for key in keys)]


def _add_sky(scene: ScenePlotter, source: Any, labels: bool) -> None:
    """Draw the illuminated square of a sun or sky, with the direction of its light."""
    stage, half = scene.stage, source.half_width  # [m]
    direction, target = np.array(source.axis), np.array(source.center)
    square = pv.Plane(center=target, i_size=2.0 * half, j_size=2.0 * half).extract_feature_edges()
    scene.add_mesh(square.tube(radius=0.002 * stage.size), color=LED_COLOR, lighting=False)
    length = 0.2 * stage.size
    arrow = pv.Arrow(start=target - length * direction, direction=direction, scale=length)
    scene.add_mesh(arrow, color=LED_COLOR, ambient=0.5)
    if labels:
        add_labels(scene, [target - 1.1 * length * direction], [source.kind.replace("-", " ")])


def add_receiver(
    scene: ScenePlotter,
    link: Link,
    mesh: TriangleMesh,
    *,
    labels: bool = True,
    aside: float = 0.0,
) -> ScenePlotter:
    """Draw every receiver as a disk, enlarged to be visible, with its field of view.

    Texts are at least `aside` [m] from the receiver, beside a map around it.
    """
    stage = scene.stage
    for i, receiver in enumerate(link.receivers, 1):
        scene.shown[f"receiver_{i}"] = receiver
        x, y, z = receiver.axis
        # the cone of the field of view opens against the axis
        half_fov = receiver.fov_deg / 2.0
        _add_cone(scene, mesh, receiver.center, (-x, -y, -z), half_fov, RECEIVER_COLOR)
        if not stage.contains(receiver.center):
            continue
        radius = max(receiver.radius, 0.016 * stage.size)  # tuned: large enough to be visible
        disk = pv.Cylinder(
            center=receiver.center, direction=receiver.axis, radius=radius, height=0.15 * radius
        )
        scene.add_mesh(disk, color=RECEIVER_COLOR, ambient=0.4)
        scale = radius / receiver.radius
        size = "" if scale == 1.0 else f"\n(drawn {scale:.2g}x)"
        text = f"receiver, radius {receiver.radius:g} m{size}\nfield of view {receiver.fov_deg:g}°"
        if labels:
            _label(scene, receiver.center, max(0.075, aside / stage.size), text)
    return scene


def _label(scene: ScenePlotter, place: Vector, shift: float, text: str) -> None:
    """Write a text beside a place [m], at a distance relative to the size of the stage."""
    beside = np.array(place) + np.array([shift * scene.stage.size, 0.0, 0.0])
    add_labels(scene, [beside], [text], align="left")


def _add_cone(
    scene: ScenePlotter,
    mesh: TriangleMesh,
    apex: Vector,
    axis: Vector,
    half_deg: float,
    color: str,
    fill: float = 0.1,
) -> None:
    """Draw a cone from its apex to the surface, unless it is wider than the stage or 85 degrees."""
    if not 0.0 < half_deg < 85.0:
        return
    stage = scene.stage
    rim = cone_rim(mesh, apex, axis, half_deg, 2.0 * stage.size)
    x0, x1, y0, y1, *_ = stage.bounds
    if not ((rim[:, :2] >= (x0, y0)) & (rim[:, :2] <= (x1, y1))).all():
        return
    side = np.arange(len(rim) - 1)  # a triangle between the apex and each side of the rim
    faces = np.column_stack([np.full_like(side, 3), np.zeros_like(side), side + 1, side + 2])
    cone = pv.PolyData(np.vstack([apex, rim]), faces=faces.ravel())
    # where a crest hangs over, the rim leaps from the crest to the sea behind it
    step = np.linalg.norm(np.diff(rim, axis=0), axis=1)
    joined = np.flatnonzero(step <= _LEAP * np.median(step))
    # lifted off the surface, or both would flicker
    ends = np.stack([rim[joined], rim[joined + 1]], axis=1).reshape(-1, 3) + 2e-3 * stage.size * Z
    ring = pv.line_segments_from_points(ends).tube(radius=0.0014 * stage.size)
    for part, opacity in ((cone, fill), (ring, 0.9)):
        inside = part.clip_box(stage.bounds, invert=False)
        if inside.n_cells and opacity:
            scene.add_mesh(inside, color=color, opacity=opacity, lighting=False)


_SHELLS = 8  # tuned: nested cones that stand for a beam
_LEAP = 8.0  # tuned: steps of a rim that are no part of it, over the median; a tilt has 2 or 3
_IN_AIR = 0.25  # tuned: brightness of a beam in the air, which scatters next to nothing of it


def _add_beam(
    scene: ScenePlotter, mesh: TriangleMesh, c: float, apex: Vector, axis: Vector, half_deg: float
) -> None:
    """Draw the beam of a lamp as nested cones that fade with distance s as exp(-c s).

    In the air they do not fade; c is the attenuation of the water [m-1].
    """
    stage, fraction = scene.stage, np.linspace(0.0, 1.0, 40)[:, None, None]
    attenuation, bright = (c, 1.0) if apex[2] < 0.0 else (0.0, _IN_AIR)
    half_angles = min(half_deg, 80.0) * np.arange(1, _SHELLS + 1) / _SHELLS
    for rim in cone_rim(mesh, apex, axis, half_angles, 2.0 * stage.size):
        points = np.array(apex) + fraction * (rim - apex)
        distance = np.linalg.norm(points - apex, axis=2)
        grid = pv.StructuredGrid(*(points[..., k][..., None] for k in range(3)))
        alpha = 0.11 * bright * np.exp(-attenuation * distance)
        grid.point_data["alpha"] = alpha.ravel(order="F")
        shell = grid.extract_surface(algorithm=None)
        scene.add_tinted(shell, LIGHT_COLOR, shell["alpha"], clipped=True)


def cone_rim(
    mesh: TriangleMesh, apex: Vector, axis: Vector, half_deg: ArrayLike, longest: float
) -> np.ndarray:
    """Return the closed outlines of cones on the surface, (*half_deg.shape, 97, 3) [m].

    Rays without a crossing within `longest` [m] end there.
    """
    azimuth, half = np.linspace(0.0, 2.0 * math.pi, 97), np.radians(half_deg)[..., None]
    across = np.cos(azimuth) * np.sin(half), np.sin(azimuth) * np.sin(half)
    rays = np.stack(np.broadcast_arrays(*across, np.cos(half)), axis=-1) @ rotation_from_z(axis).T
    origins = np.broadcast_to(apex, rays.shape).reshape(-1, 3)
    hits = EmbreeIntersector(mesh, 1).intersect(origins, rays.reshape(-1, 3))
    length = np.minimum(hits.distance, longest).reshape(rays.shape[:-1])
    rim: np.ndarray = np.array(apex) + length[..., None] * rays
    return rim


def add_uav(scene: ScenePlotter, link: Link) -> ScenePlotter:
    """Draw a quadcopter above every receiver or lamp in the air, with its tilt."""
    for center, up in carried(link):
        if scene.stage.contains(center):
            glyph = quadcopter(0.05 * scene.stage.size, center, up)
            scene.add_mesh(glyph, color=_AIRCRAFT_COLOR, ambient=0.35, specular=0.3)
    return scene


def carried(link: Link) -> Iterator[tuple[Vector, Vector]]:
    """Yield the place and upward axis of each aircraft, one per receiver or lamp in the air."""
    for receiver in link.receivers:
        if isinstance(receiver, Receiver):
            yield receiver.center, receiver.axis
    for lamp in link.transmitters:
        if isinstance(lamp, AirLamp):
            x, y, z = lamp.axis
            yield lamp.center, (-x, -y, -z)


def quadcopter(arm: float, center: Vector, up: Vector) -> pv.PolyData:
    """Return an aircraft with arms of length `arm` [m], whose payload is at `center` [m]."""
    glyph = _unit_quadcopter().copy()
    glyph.points *= arm
    glyph.points = glyph.points @ rotation_from_z(up).T + np.array(center)
    return glyph


@cache
def _unit_quadcopter() -> pv.PolyData:
    """Return an aircraft with arms of length 1 along the diagonals of x and y, payload at 0."""
    up = 0.28
    body = pv.Cube(center=(0, 0, up), x_length=0.7, y_length=0.5, z_length=up)
    parts = [body.triangulate()]
    for azimuth in np.radians([45.0, 135.0, 225.0, 315.0]):
        x, y = math.cos(azimuth), math.sin(azimuth)
        post = pv.Cylinder(center=(x, y, 1.5 * up), direction=(0, 0, 1), radius=0.09, height=0.14)
        rotor = pv.Disc(center=(x, y, 1.8 * up), inner=0.0, outer=0.52, c_res=40)
        spar = pv.Tube(pointa=(0, 0, up), pointb=(x, y, 1.3 * up), radius=0.055)
        parts += [post, rotor, spar]
    return pv.merge(parts).extract_surface(algorithm=None)


def rotation_from_z(normal: Vector) -> np.ndarray:
    """Return a rotation (3, 3) that turns +z to a unit vector, about a horizontal axis."""
    if normal[2] < -1.0 + 1e-12:
        # to turn +z straight down any horizontal axis will do: half a turn about x
        return np.diag([1.0, -1.0, -1.0])
    # Rodrigues' formula for the axis Z x n; scipy's rotations take half a second to import
    x, y, z = normal
    # 1 / (1 + z), which loses its digits below the horizon
    s = 1.0 / (1.0 + z) if z > 0.0 else (1.0 - z) / (x * x + y * y)
    return np.array(
        [[1.0 - s * x * x, -s * x * y, x], [-s * x * y, 1.0 - s * y * y, y], [-x, -y, z]]
    )
