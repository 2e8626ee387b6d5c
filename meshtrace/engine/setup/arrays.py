"""Conversion of validated models and meshes to NamedTuples of arrays for the kernels.

Each link has local coordinates, with an origin and a unit of length: the kernels' tolerances and
the single precision of Embree are made for lengths of some metres near the origin. Small links,
such as a tank of 10 cm, and links far from the origin are mapped to such coordinates.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from copy import copy
from enum import IntEnum
from functools import lru_cache
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from meshtrace.engine.bvh import Hits, Intersector, filled_bins
from meshtrace.errors import Described, Refused
from meshtrace.kernels import interface, tables
from meshtrace.kernels.medium import (
    ANGLE_CELLS,
    CELLS_PER_LOG,
    LOG_SMALLEST,
    Absorption,
    DepthMode,
    Medium,
)
from meshtrace.kernels.rays import ROUNDING, Axis, Grid
from meshtrace.kernels.scene import Locator, Target
from meshtrace.kernels.sources import SourceKind, Sources
from meshtrace.kernels.tally import Apertures
from meshtrace.link import AirSource, Link, Receiver, Source, WaterSource
from meshtrace.link.link import SAME_SIDE
from meshtrace.link.sources import AirMeasuredLamp, MeasuredLamp
from meshtrace.mesh import FARTHEST, TriangleMesh
from meshtrace.models import Floats
from meshtrace.optics.phase import PhaseFunction
from meshtrace.optics.water import Water
from meshtrace.quadrature import gauss_legendre
from meshtrace.surfaces.gram_charlier import series_of
from meshtrace.surfaces.triangulate import grid_faces

# fields of `Medium` that a frame scales, rasters left out: coefficients [m-1] and lengths [m]
_PER_LENGTH = ("a", "b", "layer_a", "layer_b", "bubble_b", "b_max", "c_max")
_LENGTHS = ("layer_step", "bubble_start", "bubble_step", "bottom_z")


class Frame(NamedTuple):
    """Origin (x, y) [m] and unit of length [m], a power of two: scaling rounds nothing."""

    x: float
    y: float
    unit: float

    def points(self, points: Floats) -> Floats:
        """Return local coordinates of points [m]."""
        return (points - np.array([self.x, self.y, 0.0])) / self.unit

    def metres(self, points: Floats) -> Floats:
        """Return the coordinates [m] of local points."""
        return points * self.unit + np.array([self.x, self.y, 0.0])

    def mesh(self, mesh: TriangleMesh) -> TriangleMesh:
        """Return a mesh in local coordinates, with the same normals."""
        if self == IDENTITY:
            return mesh
        # cached: a mesh serves several links and estimators with the same frame
        local = _LOCAL.setdefault(mesh, {})
        if self not in local:
            local[self] = self._moved(mesh)
        return local[self]

    def _moved(self, mesh: TriangleMesh) -> TriangleMesh:
        """Return a copy of a mesh with vertices and bounds in local coordinates."""
        local = self.points(mesh.vertices)
        largest = float(np.abs(local).max())
        if largest > FARTHEST:
            far = Described(f"reaches {self.unit * largest:.3g} m from the link")
            raise Refused("mesh", far, f"at most {self.unit * FARTHEST:.3g} m for its size")
        # A shallow copy shares the cached facet normals, which do not change and would take half of
        # the time of making a mesh.
        moved = copy(mesh)
        object.__setattr__(moved, "vertices", local)  # the model is frozen
        moved.__dict__["bounds"] = self.points(mesh.bounds)
        return moved

    def medium(self, medium: Medium) -> Medium:
        """Return water without rasters, with lengths and coefficients in the unit of the frame."""
        if self == IDENTITY:
            return medium
        # optical depths have no unit: tables of integrals stay as they are
        scaled = {name: getattr(medium, name) * self.unit for name in _PER_LENGTH}
        scaled |= {name: getattr(medium, name) / self.unit for name in _LENGTHS}
        return medium._replace(**scaled)


IDENTITY = Frame(0.0, 0.0, 1.0)
_LOCAL: WeakKeyDictionary[TriangleMesh, dict[Frame, TriangleMesh]] = WeakKeyDictionary()


def frame_of(link: Link) -> Frame:
    """Return the local frame of a link; the identity for links of ordinary size near the origin."""
    return Frame(*link.origin, link.unit)


_LAYER_NODES = 2049  # depths in the tables of layered water; tuned

# Rays that the grid answers without Embree: their slope |dz| / horizontal distance is at least
# twice that of the steepest facet, and at least 0.2.
_SLOPES, _LEAST_STEEP = 2.0, 0.2
# most bins of an axis: meshes with a few tiny cells would need more, and are left to Embree
_MOST_BINS = 2**17

_NONE = Axis(np.zeros(0), np.zeros(0), np.zeros(0, np.int64), 0.0)
NO_GRID = Grid(_NONE, _NONE, 0.0, np.inf, 0.0, 0.0, False)
"""Grid without cells, which leaves every ray to Embree."""
NO_BINS = Locator(0.0, 0.0, 1.0, 0, 0, np.zeros(1, np.int64), np.zeros(0, np.int32))
"""Bins of no facets, for a flat sea."""


def _code(codes: type[IntEnum], name: str) -> int:
    """Return the code of a named switch, as a plain integer (faster dispatch in numba)."""
    return int(codes[name.upper().replace("-", "_")])


def surface_arrays(
    mesh: TriangleMesh, normals: str, unresolved: str = "none"
) -> interface.MeshArrays:
    """Return the mesh as arrays; `normals` is "vertex" or "facet".

    `unresolved` is `Physics.unresolved`: whether random slopes stand for the waves that the mesh
    leaves out.
    """
    low, high = mesh.bounds
    roughness = interface.SMOOTH
    if unresolved == "tilt" and mesh.unresolved is not None:
        # interpolated normals resolve some of the slopes that flat facets leave out
        missing = mesh.unresolved.vertex if normals == "vertex" else mesh.unresolved.facet
        wind = math.radians(mesh.unresolved.direction_deg)
        roughness = interface.Roughness(
            along=math.sqrt(missing[0]),
            across=math.sqrt(missing[1]),
            cos=math.cos(wind),
            sin=math.sin(wind),
            series=series_of(mesh.unresolved.cumulants, missing),
        )
    return interface.MeshArrays(
        vertices=mesh.vertices,
        faces=mesh.faces,
        face_normals=mesh.face_normals,
        vertex_normals=mesh.vertex_normals,
        low=low,
        high=high,
        max_slope=mesh.max_slope,
        interpolate=normals == "vertex",
        roughness=roughness,
    )


def interface_arrays(link: Link) -> interface.Interface:
    """Return the switches of the surface crossing."""
    p = link.physics
    return interface.Interface(
        snell=_code(interface.Snell, p.snell),
        direction=_code(interface.Direction, p.direction),
        fresnel=_code(interface.FresnelMode, p.fresnel),
        follow_reflected=p.reflected == "trace",
        follow_second_hit=p.second_hit == "trace",
        foam_transmittance=link.whitecaps.transmittance if link.whitecaps else 1.0,
        fov=_code(interface.FieldOfView, p.fov),
    )


def pattern_of(source: Source) -> tuple[int, float]:
    """Return a source's `SourceKind` and its spread: a Lambertian order, or a half-angle [rad]."""
    # Lambertian sources cos^m have an order m, beams a divergence, isotropic sources neither
    spread = getattr(source, "order", None)
    if isinstance(source, MeasuredLamp | AirMeasuredLamp):
        spread = 2.0 * source.photometry.scale  # as a Gaussian beam, of twice its deviation
    elif spread is None:
        spread = math.radians(getattr(source, "divergence_deg", 0.0))
    return _code(SourceKind, source.pattern), float(spread)


def table_of(source: Source) -> int:
    """Return the address of a source's table of intensities, see `kernels.tables`; 0 without."""
    if not isinstance(source, MeasuredLamp | AirMeasuredLamp):
        return 0
    table, step = source.photometry.rings
    key = table.tobytes(), table.shape, step
    # kept as long as Python runs: what has the address holds no array
    if key not in _TABLES:
        _TABLES[key] = tables.packed(table, step)
    return int(_TABLES[key].ctypes.data)


_TABLES: dict[Any, Floats] = {}


def source_arrays(link: Link, top: float, frame: Frame = IDENTITY) -> Sources:
    """Return the sources in a frame; sun and sky start at height `top` [m], above every wave."""
    sources = link.transmitters
    n = len(sources)
    kind = np.array([pattern_of(t)[0] for t in sources], np.int64)
    position, axis = np.zeros((n, 3)), np.zeros((n, 3))
    spread, size = np.array([pattern_of(t)[1] for t in sources]), np.zeros(n)
    for i, t in enumerate(sources):
        axis[i], size[i] = t.axis, t.size
        if not isinstance(t, AirSource):
            position[i] = t.center
        else:
            # start where the slanted ray to the middle of the square at still water passes `top`;
            # the axis points down, so that `back` < 0
            back = top / axis[i, 2]
            position[i] = t.position[0] + back * axis[i, 0], t.position[1] + back * axis[i, 1], top
    e1 = np.array([t.sides[0] if hasattr(t, "sides") else (1.0, 0.0, 0.0) for t in sources])
    table = np.array([table_of(t) for t in sources], np.int64)
    in_water = np.array([isinstance(t, WaterSource) for t in sources], bool)
    power = np.array([t.power_mw for t in sources])
    # photons choose their source by inversion of the cumulative power
    cum_power = np.cumsum(power) / power.sum()
    local = frame.points(position)
    return Sources(kind, local, axis, spread, size / frame.unit, in_water, cum_power, e1, table)


def aperture_arrays(link: Link, frame: Frame = IDENTITY) -> Apertures:
    """Return the apertures in a frame."""
    receivers = link.receivers
    in_water = np.array([not isinstance(r, Receiver) for r in receivers], bool)
    half = np.radians([r.fov_deg for r in receivers]) / 2.0
    with np.errstate(over="ignore"):  # huge for a hemisphere
        tan_half = np.tan(half)
    return Apertures(
        center=frame.points(np.array([r.center for r in receivers], float).reshape(-1, 3)),
        axis=np.array([r.axis for r in receivers], float).reshape(-1, 3),
        radius=np.array([r.radius for r in receivers], float) / frame.unit,
        # exactly 0 for a hemisphere: it accepts grazing light despite rounding
        cos_half_fov=np.where(half >= math.pi / 2.0, 0.0, np.cos(half)),
        tan_half_fov=tan_half,
        in_water=in_water,
        any_in_water=bool(in_water.any()),
        any_in_air=bool((~in_water).any()),
        same_side=link.direction in SAME_SIDE,
    )


# Fields of rasters by surface: one serves the water of every wavelength and of neighbouring links.
_RASTERS = WeakKeyDictionary[Intersector, dict[str, Any]]()


def with_raster(medium: Medium, intersector: Intersector) -> Medium:
    """Return the medium with rasters of the mesh's heights, if depths count from the local surface.

    The heights are those of vertical rays at the nodes of a square raster. Lengths are in the unit
    of the mesh.
    """
    if medium.depth_mode != DepthMode.LOCAL:
        return medium
    if known := _RASTERS.get(intersector):
        return medium._replace(**known)
    low, high = intersector.mesh.bounds
    width = float(max(high[0] - low[0], high[1] - low[1]))
    nodes = int(np.clip(width / 0.25, 16, 256))  # along a side; tuned: time and memory
    step = width / (nodes - 1)
    # rays 1e-4 inside of the rim: one at the rim itself may miss the mesh
    x = np.clip(low[0] + step * np.arange(nodes), low[0] + 1e-4, high[0] - 1e-4)
    y = np.clip(low[1] + step * np.arange(nodes), low[1] + 1e-4, high[1] - 1e-4)
    places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)

    def rays(start: Floats | float, up: float) -> tuple[Floats, Floats]:
        """Return origins and directions (nodes^2, 3) of rays up (1) or down (-1) from heights."""
        z = np.broadcast_to(start, (nodes, nodes))
        origins = np.concatenate([places, z[..., None]], axis=-1).reshape(-1, 3)
        return origins, np.broadcast_to((0.0, 0.0, up), origins.shape)

    def heights(hits: Hits, start: Floats | float, up: float, missed: Floats | float) -> Floats:
        """Return the heights (nodes, nodes) of the first hits, `missed` where a ray has none."""
        distance = hits.distance.reshape(nodes, nodes)
        return np.where(np.isfinite(distance), start + up * distance, missed)

    start = high[2] + 1.0
    top = heights(intersector.intersect(*rays(start, -1.0)), start, -1.0, 0.0)
    x0, y0 = (float(side) for side in low[:2])
    fields: dict[str, Any] = {"raster_x": x0, "raster_y": y0, "raster_step": step, "raster": top}
    if not intersector.mesh.single_valued:
        # a vertical through an overhang meets sea, underside of the jet above it, and its top
        start = low[2] - 1.0
        lowest = heights(intersector.intersect(*rays(start, 1.0)), start, 1.0, top)
        start = lowest + 1e-4  # to the underside of the jet, if there is one
        above = heights(intersector.intersect(*rays(start, 1.0)), start, 1.0, lowest)
        fields |= {"overhangs": True, "raster_low": np.where(above > lowest, lowest, top)}
        # the middle of the air under the jet tells points below the sea from those in the jet
        fields["raster_split"] = np.where(above > lowest, 0.5 * (lowest + above), top)
    _RASTERS[intersector] = fields
    return medium._replace(**fields)


def medium_arrays(link: Link, crest: float = 0.0) -> Medium:
    """Return the water with its bubbles, in metres; a frame scales it.

    `crest` is the height [m] up to which bubbles are tabulated where their depth counts from the
    mean level. Depths below the local surface need `with_raster`.
    """
    water, bubbles = link.water, link.bubbles
    # unread without bubbles: two nodes give the tables the type that the kernels expect
    mode, start, step, b_bub = int(DepthMode.NONE), 0.0, 1.0, np.zeros(2)
    phase_bubble = water.phase.tables()
    if bubbles is not None:
        mode = _code(DepthMode, bubbles.depth)
        # linear interpolation of exp(-z / L) over steps L / 64 is good to (1 / 64)^2 / 8 = 3e-5
        step = bubbles.e_folding / 64.0
        if mode == DepthMode.MEAN_LEVEL:
            # whole steps above the mean level, so that this level is a node
            start = -math.ceil(max(crest, 0.0) / step) * step
        nodes = start + step * np.arange(math.ceil((12.0 * bubbles.e_folding - start) / step) + 1)
        b_bub = bubbles.b(nodes)
        b_bub[-1] = 0.0  # none below 12 e-foldings, exp(-12) = 6e-6
        phase_bubble = bubbles.phase_function().tables()
    # users give layers at any depths; kernels look up a uniform grid without a search
    layer_step, layer_a, layer_b = 1.0, np.full(2, water.a), np.full(2, water.b)
    if water.layers is not None:
        depth, a, b = np.array(water.layers).T
        # 1e-3: no zero step for a single layer, of depth 0
        layer_step = max(float(depth[-1]), 1e-3) / (_LAYER_NODES - 1)
        grid = layer_step * np.arange(_LAYER_NODES)
        layer_a, layer_b = np.interp(grid, depth, a), np.interp(grid, depth, b)
    # majorants of delta tracking, see `kernels.medium`
    b_max = float(layer_b.max() + b_bub.max())
    return Medium(
        a=water.a,
        b=water.b,
        n_water=water.n,
        n_air=link.n_air,
        layered=water.layers is not None,
        layer_step=layer_step,
        layer_a=layer_a,
        layer_b=layer_b,
        layer_a_path=integral(layer_a, layer_step),
        layer_b_path=integral(layer_b, layer_step),
        depth_mode=mode,
        bubble_start=start,
        bubble_step=step,
        bubble_b=b_bub,
        bubble_path=integral(b_bub, step),
        b_max=b_max,
        c_max=b_max + float(layer_a.max()),
        bottom_z=-math.inf if water.bottom_depth is None else -water.bottom_depth,
        bottom_albedo=water.bottom_albedo,
        absorption=_code(Absorption, link.physics.absorption),
        local_c=link.physics.free_path == "local_c",
        phase_water=water.phase.tables(),
        phase_bubble=phase_bubble,
    )


def integral(values: Floats, step: float) -> Floats:
    """Return the cumulative trapezoidal integral from the first node, along the last axis."""
    integrals = np.zeros_like(values)
    integrals[..., 1:] = np.cumsum(0.5 * step * (values[..., 1:] + values[..., :-1]), axis=-1)
    return integrals


def mean_water(water: Water, depth: float) -> tuple[float, float]:
    """Return the mean absorption and scattering coefficients from still water to a depth [m-1]."""
    if water.layers is None:
        return water.a, water.b
    a, b = water.profile(np.linspace(0.0, depth, 257))
    return float(np.mean(a)), float(np.mean(b))


def mean_square_slope(surface: interface.MeshArrays) -> float:
    """Return the mean square slope of a mesh: the average of both components, over its vertices."""
    n = surface.vertex_normals
    # the components are -n_x / n_z and -n_y / n_z
    return float(0.5 * np.mean((n[:, 0] ** 2 + n[:, 1] ** 2) / n[:, 2] ** 2))


def locator(surface: interface.MeshArrays, targets: Sequence[Target]) -> Locator:
    """Return bins over the part of the surface that any target can see, see `Locator`.

    Successive surfaces over the same grid lines share their bins. Lengths are in the unit of the
    frame.
    """
    pad = 2.0  # beyond the reach; tuned
    low = [min(t.center[i] - t.reach - pad for t in targets) for i in range(2)]
    high = [max(t.center[i] + t.reach + pad for t in targets) for i in range(2)]
    # bins beyond the mesh would be empty
    low = [max(low[i], float(surface.low[i])) for i in range(2)]
    high = [min(high[i], float(surface.high[i])) for i in range(2)]
    key = *low, *high
    faces, places = surface.faces, surface.vertices[:, :2]
    for (old_faces, old_places), old, known in tuple(_recent_bins):
        if key == old and np.array_equal(old_places, places) and np.array_equal(old_faces, faces):
            return known
    # bins of 0.1, the default spacing of facets (`Link.footprint`), at most 400 along a side, and
    # some ten along a side of a facet
    width = max(high[0] - low[0], high[1] - low[1])
    step = max(0.1, width / min(400.0, 10.0 * math.sqrt(len(surface.faces))))
    nx, ny = (max(math.ceil((high[i] - low[i]) / step), 1) for i in range(2))
    grid = filled_bins(low[0], low[1], step, (nx, ny), surface.vertices, faces)
    _recent_bins.append(((faces, places.copy()), key, grid))
    return grid


# ((faces, places (n, 2)), bounds, bins); two, as links up and down may take turns over a series
_recent_bins: deque[Any] = deque(maxlen=2)


@lru_cache(maxsize=32)
def angle_table(phase: PhaseFunction) -> Floats:
    """Tabulate a phase function [sr-1] over the scattering angle, for `kernels.medium.phase_at`.

    Parameters
    ----------
    phase : PhaseFunction
        The phase function.

    Notes
    -----
    A cell holds the mean over its solid angle, by 4 Gauss points in theta; its edges are 0.5 %
    apart.
    """
    edge = angle_edges()
    node, weight = gauss_legendre(4)
    half = 0.5 * np.diff(edge)[:, None]
    theta = edge[:-1, None] + half * (1.0 + node)
    solid_angle = weight * np.sin(theta)  # up to a factor for each cell
    return (phase.pdf(theta) * solid_angle).sum(axis=1) / solid_angle.sum(axis=1)


def angle_edges() -> Floats:
    """Return the edges [rad] of the cells of `angle_table`."""
    edge = np.exp(LOG_SMALLEST + np.arange(ANGLE_CELLS + 1) / CELLS_PER_LOG)
    # exactly pi, which rounding may miss: every angle has a cell
    edge[-1] = math.pi
    return edge


def grid_shape(mesh: TriangleMesh) -> tuple[int, int] | None:
    """Return the numbers of vertices (nx, ny) of a mesh by `triangulate`, None for any other."""
    # vertex (i, j) is number i ny + j, and the first facet of `grid_faces` starts with 0 and ny
    ny = int(mesh.faces[0, 1])
    nx = len(mesh.vertices) // ny if ny > 1 else 0
    if nx < 2 or nx * ny != len(mesh.vertices) or not mesh.single_valued:
        return None
    return (nx, ny) if np.array_equal(mesh.faces, grid_faces(nx, ny)) else None


def grid_arrays(mesh: TriangleMesh) -> Grid:
    """Return the grid of a height field made by `triangulate`, `NO_GRID` for another mesh.

    Close to an edge it leaves rays to Embree, so that both always answer with the same facet.
    """
    shape = grid_shape(mesh)
    if shape is None:
        return NO_GRID
    x, y = (mesh.vertices[:, k].reshape(shape) for k in (0, 1))
    lines = x[:, 0].copy(), y[0].copy()
    if (x != lines[0][:, None]).any() or (y != lines[1]).any():
        return NO_GRID
    # `Axis` needs rising lines
    if any((np.diff(line) <= 0.0).any() for line in lines):  # a grid that was turned
        return NO_GRID
    along_x, along_y = (_axis(line) for line in lines)
    if max(len(along_x.guide), len(along_y.guide)) > _MOST_BINS:
        return NO_GRID
    low, high = mesh.bounds
    return Grid(
        along_x,
        along_y,
        level=float(0.5 * (low[2] + high[2])),
        steep=max(_SLOPES * mesh.max_slope, _LEAST_STEEP) ** 2,
        height=float(high[2] - low[2] + max(high[2], -low[2])),  # see `Grid`
        clear=ROUNDING * float(np.abs(mesh.bounds).max()),
        flat=bool(low[2] == high[2]),
    )


def _axis(line: Floats) -> Axis:
    """Return grid lines (n,), with bins 1 % narrower than the smallest distance between lines."""
    # such a bin holds one line at most: the cell is that of the bin's start, or the next
    edges = np.diff(line)
    span = float(line[-1] - line[0])
    # one more than allowed tells `grid_arrays` to give up
    bins = min(int(1.01 * span / edges.min()) + 1, _MOST_BINS + 1)
    starts = line[0] + span * np.arange(bins) / bins
    guide = np.searchsorted(line, starts, side="right") - 1
    return Axis(np.append(line[:-1], np.inf), 1.0 / edges, guide.astype(np.int64), bins / span)
