"""The 3D scene of the explorer: parts made once, whose points are replaced by every change."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyvista as pv
from matplotlib import colormaps
from matplotlib.colors import to_rgb

from meshtrace.engine.paths import PhotonPaths
from meshtrace.explorer.controls import State
from meshtrace.link.sources import AirLamp, WaterSource
from meshtrace.mesh import MeshSource, TriangleMesh
from meshtrace.models import Floats
from meshtrace.results.coverage import CoverageMap
from meshtrace.viz import parts
from meshtrace.viz.light import select_paths
from meshtrace.viz.scenes import wind_of
from meshtrace.viz.stage import Scene, Stage, look, round_range, stage_of
from meshtrace.viz.style import LED_COLOR, PALETTE, RECEIVER_COLOR, UAV_COLOR, water_map
from meshtrace.viz.water import SeaLight, radiance, screen_colors

CELLS = 120
"""Cells of the sea along a side."""

WINDOW = (1200, 800)

UNSCATTERED_COLOR, SCATTERED_COLOR = PALETTE["vermilion"], PALETTE["orange"]

_WIDEST = 85.0  # half-angle, beyond which a cone is not drawn [deg]
_ZOOM = 1.04  # there is no key or colour bar within the window
_LEAST_IRRADIANCE = 1e-4  # of daylight rather than moon or night [W m-2 nm-1]
_ELEVATION_LOOK = {"ambient": 0.3, "diffuse": 0.75, "specular": 0.25}
_DAYLIGHT_LOOK = {"ambient": 1.0, "diffuse": 0.0, "specular": 0.0}  # the colours are those seen
_WATER_MAP = np.rint(255.0 * water_map()(np.linspace(0.0, 1.0, 256))[:, :3]).astype(np.uint8)
_NEW_CAMERA = (0.6, 1.1)  # sizes of the stage, relative to that framed, that keep the camera
_NEW_SQUARE = (0.75, 1.25)  # half-widths, relative to that of the present sea, that keep it
_OFF_CENTER = 0.2  # distance of the centres, over the half-width, that keeps it


class LiveScene:
    """Scene of a link over its sea, updated in place.

    Parameters
    ----------
    state : State
        Link, sea and time.

    Attributes
    ----------
    plotter : Scene
        Plotter whose render window is shown; nothing is rendered here.
    elevation_range : tuple of float
        Ends of the colours of the sea by elevation [m].
    """

    def __init__(self, state: State) -> None:
        self._key: Any = None
        self._faces: Any = None
        self._made: tuple[Any, TriangleMesh] | None = None
        self._drawn: TriangleMesh | None = None
        self._parts: dict[str, pv.PolyData] = {}
        self._actors: dict[str, Any] = {}
        self.elevation_range = (-1.0, 1.0)
        self._place(state)
        self.plotter = Scene(self.stage, off_screen=True, window_size=WINDOW)
        self._frame()
        self._add_parts()
        self.update(state)

    def update(self, state: State, running: bool = False) -> bool:
        """Replace the points of all parts but the light; return whether the camera moved.

        Parameters
        ----------
        state : State
            Link, sea and time.
        running : bool
            Whether time alone changed: the parts of the link stay.
        """
        if not running:
            self._place(state)
        mesh = self._mesh(state.time)
        if not running:
            low, high = mesh.bounds[:, 2]
            self.elevation_range = round_range(float(low), max(float(high), float(low) + 0.01))
            self._light = _light(state, self._surface)
            shine = _ELEVATION_LOOK if self._light is None else _DAYLIGHT_LOOK
            for name, share in shine.items():
                setattr(self._actors["sea"].prop, name, share)
        if mesh is not self._drawn or self._light is not None:
            self._set("sea", self._sea(mesh))
        self._drawn = None if self._light is not None else mesh
        self._set("water", _water(mesh, self.stage))
        if running:
            return False
        for name, part in _link_parts(state, self.stage).items():
            self._set(name, part)
        if _NEW_CAMERA[0] < self._size / self._framed < _NEW_CAMERA[1]:
            return False
        self._frame()
        return True

    @property
    def shows_daylight(self) -> bool:
        """Whether the sea is coloured by the daylight that it reflects."""
        return self._light is not None

    def _sea(self, mesh: TriangleMesh) -> pv.PolyData:
        """Return the surface, in single precision, coloured by elevation or by the daylight."""
        points: Any = mesh.vertices.astype(np.float32)
        normals: Any = mesh.vertex_normals.astype(np.float32)
        if self._faces is not mesh.faces.base:  # grids of one shape share their facets
            self._faces = mesh.faces.base
            self._grid = pv.PolyData.from_regular_faces(points, mesh.faces.astype(int))
        part = pv.PolyData()
        part.copy_structure(self._grid)
        part.points = points
        if self._light is None:
            low, high = self.elevation_range
            share = (points[:, 2] - low) / (high - low)
            tint = _WATER_MAP[np.clip(256.0 * share, 0.0, 255.0).astype(np.uint8)]
        else:
            eye = tuple(self.plotter.camera.position)
            slopes = -normals[:, :2] / normals[:, 2:]
            rest = (0.0, 0.0) if mesh.unresolved is None else mesh.unresolved.vertex
            tint = screen_colors(radiance(points, slopes, eye, self._light, rest))
        part.point_data["tint"] = tint
        part.point_data.active_normals = normals
        return part

    def _frame(self) -> None:
        """Point the camera at the stage."""
        self._framed = self._size
        look(self.plotter)
        self.plotter.camera.zoom(_ZOOM)

    def show_rays(self, paths: PhotonPaths | None) -> None:
        """Show or remove paths of received light."""
        for name, part in _rays(paths, self.stage).items():
            self._set(name, part)

    def show_map(self, coverage: CoverageMap | None, height: float) -> None:
        """Show or remove a map at a height [m]."""
        self._set("map", None if coverage is None else _plane(coverage, height))

    def close(self) -> None:
        """Release all parts.

        The observers that trame adds to serialized objects are removed first: called during a
        garbage collection they end the process.
        """
        window: Any = self.plotter.render_window
        objects = [window]
        for renderer in window.GetRenderers():
            objects += [renderer, renderer.GetActiveCamera(), *renderer.GetLights()]
            for prop in renderer.GetViewProps():
                objects += [prop, prop.GetProperty()]
        for actor in self._actors.values():
            objects += [actor.mapper, actor.mapper.lookup_table, actor.mapper.dataset]
        for found in objects:
            found.RemoveObservers("DeleteEvent")
        self.plotter.close()

    def profile(self) -> list[tuple[float, float]]:
        """Return points (x, z) [m] of the waves along x through the middle of the stage."""
        vertices = self._parts["sea"].points
        rows = np.abs(vertices[:, 1] - self.stage.center[1])
        line = vertices[rows < rows.min() + 1e-4 * self.stage.half]
        line = line[np.argsort(line[:, 0])]
        return [(round(float(x), 3), round(float(z), 3)) for x, _, z in line]

    def _place(self, state: State) -> None:
        """Take over the link and the sea of a state."""
        if self._key != state.moves or self._key is None:
            case = state.channel.case()
            self._surface, self._key = case.surface, state.moves
            stage = stage_of(case.link, case.surface, None)
            self._size, self.stage = stage.size, self._on_square(stage)
        if hasattr(self, "plotter"):
            self.plotter.stage = self.stage

    def _on_square(self, stage: Stage) -> Stage:
        """Return the stage over the present square of the sea if both are of similar size.

        A move of the link then leaves the surface, most of the data of the scene, as it is.
        """
        if not hasattr(self, "stage"):
            return stage
        (x, y), half = self.stage.center, self.stage.half
        shift = max(abs(stage.center[0] - x), abs(stage.center[1] - y))
        if _NEW_SQUARE[0] < stage.half / half < _NEW_SQUARE[1] and shift < _OFF_CENTER * half:
            return stage._replace(center=(x, y), half=half)
        return stage

    def _mesh(self, time: float) -> TriangleMesh:
        """Return the surface at a time, that made before if it is the same."""
        if not isinstance(self._surface, MeshSource):
            return self._surface
        stage = self.stage
        wanted = self._surface, time, stage.half, stage.center
        if self._made is None or self._made[0] != wanted:
            step = 2.0 * stage.half / CELLS
            self._made = wanted, self._surface.mesh(time, stage.half, step, center=stage.center)
        return self._made[1]

    def _add_parts(self) -> None:
        """Add all parts, empty, from back to front: translucent ones are blended in this order."""
        plain: Any = {"lighting": False}
        self._add("water", "far water", scalars="tint", rgb=True, culling="front", **plain)
        self._add("lamp", color=LED_COLOR, ambient=0.7, specular=0.3)
        self._add("beam", color=LED_COLOR, opacity=0.22, **plain)
        self._add("sea", scalars="tint", rgb=True, opacity=0.85, specular_power=30.0)
        glow: Any = {"ambient": 0.75, "diffuse": 0.35}
        self._add("scattered", color=SCATTERED_COLOR, **glow)
        self._add("unscattered", color=UNSCATTERED_COLOR, **glow)
        self._add("crossings", color="white", **glow)
        self._add("view", color=RECEIVER_COLOR, opacity=0.14, **plain)
        self._add("receiver", color=RECEIVER_COLOR, ambient=0.4)
        self._add("uav", color=UAV_COLOR, ambient=0.35, specular=0.3)
        self._add("map", scalars="tint", rgb=True, opacity=0.8, **plain)
        self._add("water", "near water", scalars="tint", rgb=True, culling="back",
                  opacity=parts.NEAR_OPACITY, **plain)  # fmt: skip

    def _add(self, name: str, actor: str = "", **options: Any) -> None:
        part = self._parts.setdefault(name, pv.PolyData())
        self._set(name, None)
        options.setdefault("show_scalar_bar", False)
        if options.get("rgb"):
            del options["show_scalar_bar"]
        self._actors[actor or name] = self.plotter.add_mesh(part, name=actor or name, **options)

    def _set(self, name: str, part: pv.PolyData | None) -> None:
        """Replace the points and cells of a part; None leaves nothing to see."""
        # not by visibility: the page draws parts white that were invisible at first
        if part is None or not part.n_points:  # a triangle without area
            part = pv.PolyData(np.zeros((3, 3), np.float32), faces=[3, 0, 1, 2])
            part.point_data["tint"] = np.zeros((3, 4), np.uint8)
        self._parts[name].shallow_copy(part)


def _light(state: State, surface: Any) -> SeaLight | None:
    """Return the daylight on the sea of a state, or None at night."""
    day = state.scenario.daylight
    if day is None or day.irradiance < _LEAST_IRRADIANCE:
        return None
    return SeaLight.of(state.scenario.link, day, wind_of(surface))


def _water(mesh: TriangleMesh, stage: Stage) -> pv.PolyData | None:
    """Return the sides and the floor of the water below the edge of the sea."""
    ring = _edge(mesh.vertices)
    n = len(ring)
    foot = np.column_stack([ring[:, :2], np.full(n, stage.bottom)])
    i = np.arange(n)
    j = (i + 1) % n
    sides = np.column_stack([np.full(n, 4), i, j, j + n, i + n])
    floor = np.concatenate([[n], np.arange(2 * n - 1, n - 1, -1)])
    part = pv.PolyData(
        np.vstack([ring, foot]).astype(np.float32), faces=np.concatenate([sides.ravel(), floor])
    )
    tint = np.full((2 * n, 4), 140, np.uint8)
    for rows, color in zip((slice(n), slice(n, None)), parts.WATER_COLORS, strict=True):
        tint[rows, :3] = np.rint(255.0 * np.array(to_rgb(color)))
    part.point_data["tint"] = tint
    return part


def _edge(vertices: Floats) -> Floats:
    """Return the vertices on the sides of the square that a mesh covers, anticlockwise."""
    (x0, y0), (x1, y1) = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
    x, y = vertices[:, :2].T
    near = 1e-6 * (x1 - x0)
    on_edge = (x - x0 < near) | (x1 - x < near) | (y - y0 < near) | (y1 - y < near)
    ring = vertices[on_edge]
    u, v = (ring[:, :2] - (0.5 * (x0 + x1), 0.5 * (y0 + y1))).T
    return ring[np.argsort(np.arctan2(v, u))]


def _link_parts(state: State, stage: Stage) -> dict[str, pv.PolyData | None]:
    """Return the lamps, receivers and aircraft of a link with their cones."""
    link, size = state.scenario.link, stage.size
    found: dict[str, list[pv.PolyData]] = {
        name: [] for name in ("lamp", "beam", "receiver", "view", "uav")
    }
    for source in link.transmitters:
        if isinstance(source, WaterSource | AirLamp):
            found["lamp"].append(pv.Sphere(radius=0.014 * size, center=source.center))
            found["beam"] += _cone(source.center, source.axis, source.spread_deg, stage)
    for receiver in link.receivers:
        x, y, z = receiver.axis
        found["view"] += _cone(receiver.center, (-x, -y, -z), receiver.fov_deg / 2.0, stage)
        found["receiver"].append(parts.receiver_disk(receiver, stage)[0].triangulate())
    found["uav"] = [parts.quadcopter(0.055 * size, *place) for place in parts.carried(link)]
    return {
        name: pv.merge(pieces) if len(pieces) > 1 else next(iter(pieces), None)
        for name, pieces in found.items()
    }


def _cone(
    apex: tuple[float, float, float], axis: tuple[float, float, float], half: float, stage: Stage
) -> list[pv.PolyData]:
    """Return a cone from its apex to the still water, or to the side of the stage."""
    if not 0.0 < half < _WIDEST:
        return []
    rays = parts.cone_rays(axis, half, 73)
    longest = 2.0 * stage.size
    with np.errstate(divide="ignore"):
        to_water = np.where(rays[:, 2] * apex[2] < 0.0, -apex[2] / rays[:, 2], longest)
        for i in (0, 1):
            side = np.copysign(stage.half, rays[:, i]) + stage.center[i] - apex[i]
            to_water = np.minimum(to_water, np.maximum(side / rays[:, i], 0.0))
    rim = np.array(apex) + to_water[:, None] * rays
    return [parts.fan(np.array(apex, np.float32), rim.astype(np.float32))]


def _rays(paths: PhotonPaths | None, stage: Stage) -> dict[str, pv.PolyData | None]:
    """Return tubes along unscattered and along scattered paths, and dots at the crossings."""
    found: dict[str, pv.PolyData | None] = dict.fromkeys(("unscattered", "scattered", "crossings"))
    if paths is None or not len(paths.what):
        return found
    direct = paths.length <= 3
    for name, chosen in (("unscattered", direct), ("scattered", ~direct)):
        points, cells = select_paths(paths, chosen).polylines()
        if len(points):
            lines = pv.PolyData(points.astype(np.float32), lines=cells)
            found[name] = lines.tube(radius=0.0013 * stage.size, n_sides=6).triangulate()
    crossing = paths.vertex[np.arange(len(paths.what)), np.maximum(paths.length - 2, 0)]
    ball = pv.Sphere(radius=0.0035 * stage.size, theta_resolution=6, phi_resolution=6)
    found["crossings"] = pv.PolyData(crossing).glyph(geom=ball, scale=False, orient=False)
    return found


def _plane(coverage: CoverageMap, height: float) -> pv.PolyData:
    """Return a map as a plane, whose colour and opacity follow the gain."""
    x, y = np.meshgrid(coverage.x, coverage.y, indexing="ij")
    share = coverage.gain / max(float(coverage.gain.max()), 1e-300)
    grid = pv.StructuredGrid(x, y, np.full_like(x, height))
    tint = (255.0 * colormaps["viridis"](share.ravel(order="F"))).astype(np.uint8)
    tint[:, 3] = np.rint(255.0 * np.clip(0.15 + share.ravel(order="F"), 0.0, 1.0))
    grid.point_data["tint"] = tint
    return grid.extract_surface(algorithm=None).triangulate()
