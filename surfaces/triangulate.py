"""Triangle meshes of sheets over uniform or graded grids, and from other programs."""

from __future__ import annotations

import math
from functools import lru_cache
from os import PathLike
from os.path import isfile
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.checks import Inside, check_call
from meshtrace.errors import Described, Refused, reason_of, require_array, require_plain
from meshtrace.mesh import TriangleMesh, UnresolvedSlopes, vertex_normals

from .parameters import Floats, Positive, in_range

if TYPE_CHECKING:
    import trimesh

MAX_LINES = 20_001
"""Most lines of one axis; a finer grid is most likely a typing error."""

GROWTH = 1.1
"""Ratio of neighbouring steps in the coarsening part of a graded grid."""

DEFAULT_COARSENING = 10.0
"""Ratio of the largest step of a graded grid to its finest, by default."""


class GridLines(NamedTuple):
    """Extent and spacing of the lines of an axis.

    Parameters
    ----------
    extent : float
        Half-length of the axis [m].
    spacing : float
        Largest distance of neighbouring lines [m], or of those in the fine part.
    fine_extent : float, optional
        Half-length of a fine part [m], outside of which the lines move apart.
    coarse_spacing : float, optional
        Largest distance of neighbouring lines outside of it [m], at least `spacing`; by default
        `DEFAULT_COARSENING` times `spacing`.
    """

    extent: float
    spacing: float
    fine_extent: float | None = None
    coarse_spacing: float | None = None

    def widened(self, reach: float) -> GridLines:
        """Return lines that reach farther by a length [m]."""
        fine = None if self.fine_extent is None else self.fine_extent + reach
        return self._replace(extent=self.extent + reach, fine_extent=fine)

    def axis(self, center: float = 0.0) -> Floats:
        """Return the grid lines about a centre [m].

        Returns
        -------
        ndarray, shape (n,)
            Increasing positions [m], symmetric about `center`, with lines at center -+ extent and
            at center -+ fine_extent. Equally spaced lines number ceil(2 extent / spacing) + 1;
            a fine part that is as long as the axis has them as well.

        Raises
        ------
        Refused
            If a number is out of range, `coarse_spacing` comes without `fine_extent`, or the axis
            would have more than `MAX_LINES` lines.

        Notes
        -----
        Where 2 extent / spacing is not an integer the lines move closer than `spacing`, never
        apart, so that the boundary is met. The steps outside the fine part follow
        spacing `GROWTH`^i up to `coarse_spacing` and are then shrunk by one common factor so
        that the last line meets the boundary.

        Examples
        --------
        >>> GridLines(1.0, 0.5).axis()
        array([-1. , -0.5,  0. ,  0.5,  1. ])
        >>> GridLines(2.0, 0.5, fine_extent=0.5).axis().round(2)
        array([-2.  , -1.45, -0.95, -0.5 ,  0.  ,  0.5 ,  0.95,  1.45,  2.  ])
        """
        extent, spacing, fine_extent, coarse_spacing = self
        in_range("center", -math.inf, unit="m")(center)
        in_range("extent", 0.0, unit="m")(extent)
        in_range("spacing", 0.0, unit="m")(spacing)
        if fine_extent is None and coarse_spacing is not None:
            raise Refused("coarse_spacing", coarse_spacing, "only with fine_extent")
        if fine_extent is not None:
            in_range("fine_extent", 0.0, unit="m")(fine_extent)
            coarse = DEFAULT_COARSENING * spacing if coarse_spacing is None else coarse_spacing
            in_range("coarse_spacing", spacing, unit="m", closed=True)(coarse)
            if fine_extent < extent:
                half = _graded(fine_extent, extent, spacing, coarse)
                return center + np.concatenate([-half[:0:-1], half])
        steps = _step_count(2.0 * extent, spacing)
        return center + extent * ((2.0 * np.arange(steps + 1) - steps) / steps)


@lru_cache(maxsize=8)
def _graded(fine_extent: float, extent: float, spacing: float, coarse_spacing: float) -> Floats:
    """Return the lines of a graded axis from its centre to its end [m]."""
    fine_steps = _step_count(fine_extent, spacing)
    inner = fine_extent * (np.arange(fine_steps + 1) / fine_steps)
    rest = extent - fine_extent
    # number of steps, not a whole one, after which the growing step is the coarse one
    growing = math.log(coarse_spacing / spacing) / math.log(GROWTH)
    # all later steps are coarse ones, which bounds their number
    most = _step_count(rest, spacing, growing + 1.0 + rest / coarse_spacing)
    steps = spacing * GROWTH ** np.minimum(np.arange(1, most + 1), growing)
    reach = np.cumsum(steps)
    # the first step that meets the end, up to rounding; all are then shrunk so that it is the end
    needed = int(np.searchsorted(reach, rest * (1.0 - 1e-12))) + 1
    half = np.concatenate([inner, fine_extent + reach[:needed] * (rest / reach[needed - 1])])
    # without rounding, so that meshes of one extent have the same bounds
    half[-1] = extent
    half.flags.writeable = False  # shared by the meshes of a series
    return half


def _step_count(length: float, spacing: float, enough: float = math.inf) -> int:
    """Return the number of steps over a length [m], at most `enough` (rounded up)."""
    # The tolerance keeps 2 * 20 / 0.1 at 400 steps whatever the last bit of the quotient.
    steps = min(length / spacing * (1.0 - 1e-12), enough)
    if not steps < MAX_LINES - 1:
        allowed = f"at most {MAX_LINES} grid lines over {length:g} m"
        raise Refused("spacing", spacing, allowed)
    return max(1, math.ceil(steps))


@check_call
def triangulate(
    x_axis: ArrayLike,
    y_axis: ArrayLike,
    z: ArrayLike,
    sx: ArrayLike,
    sy: ArrayLike,
    unresolved: UnresolvedSlopes | None = None,
) -> TriangleMesh:
    """Triangulate a height field on a tensor grid.

    Parameters
    ----------
    x_axis : array_like, shape (nx,)
        Increasing grid lines [m].
    y_axis : array_like, shape (ny,)
        Increasing grid lines [m].
    z : array_like, shape (nx, ny)
        Elevation [m] at (x_axis[i], y_axis[j]).
    sx, sy : array_like, shape (nx, ny)
        Slopes dz/dx and dz/dy.
    unresolved : UnresolvedSlopes, optional
        Slopes that the grid leaves out.

    Returns
    -------
    TriangleMesh
        nx ny vertices, vertex i ny + j at (x_axis[i], y_axis[j]), and 2 (nx - 1)(ny - 1) facets,
        counter-clockwise seen from the air; vertex normals (-sx, -sy, 1) / norm.

    Raises
    ------
    Refused
        If an axis is not strictly increasing or has fewer than two lines, or a shape is wrong.

    Notes
    -----
    Cell (i, j) is cut from (i, j) to (i + 1, j + 1) if i + j is even, and across otherwise. With
    one diagonal throughout, every cell would have its slope error of second order in the same
    direction, and a mirrored sea would not give the mirrored mesh; alternating cells do.

    Examples
    --------
    >>> flat = np.zeros((3, 2))
    >>> triangulate([0.0, 1.0, 2.0], [0.0, 1.0], flat, flat, flat).faces.tolist()
    [[0, 2, 3], [0, 3, 1], [2, 4, 3], [4, 5, 3]]
    """
    return mesh_of_sheet(*height_field(x_axis, y_axis, z, sx, sy), unresolved)


@check_call
def height_field(
    x_axis: ArrayLike, y_axis: ArrayLike, z: ArrayLike, sx: ArrayLike, sy: ArrayLike
) -> tuple[Floats, Floats]:
    """Return the points and unit normals of a height field, (nx, ny, 3); see `triangulate`."""
    x_axis, y_axis = increasing("x_axis", x_axis), increasing("y_axis", y_axis)
    shape = len(x_axis), len(y_axis)
    z, sx, sy = (np.asarray(a, dtype=np.float64) for a in (z, sx, sy))
    for name, array in (("z", z), ("sx", sx), ("sy", sy)):
        if array.shape != shape:
            raise Refused(name, array.shape, f"the shape {shape} of these axes")
    upward = 1.0 / np.sqrt(1.0 + sx**2 + sy**2)
    normals = np.stack([-sx * upward, -sy * upward, upward], axis=-1)
    return grid_points(x_axis, y_axis, z), normals


def mesh_of_sheet(
    points: Floats,
    normals: Floats,
    unresolved: UnresolvedSlopes | None = None,
    overhangs: bool = False,
) -> TriangleMesh:
    """Return the mesh of points and unit normals, shapes (nx, ny, 3); see `triangulate`."""
    faces = grid_faces(*points.shape[:2])
    flat = points.reshape(-1, 3), faces, normals.reshape(-1, 3)
    return TriangleMesh(*flat, unresolved, overhangs)


@lru_cache(maxsize=8)
def grid_faces(nx: int, ny: int) -> NDArray[np.int32]:
    """Return the facets of an nx by ny grid, shape (2 (nx - 1)(ny - 1), 3), see `triangulate`.

    The array is shared between meshes of one shape and therefore read-only.
    """
    corner = np.arange(nx * ny, dtype=np.int32).reshape(nx, ny)
    # corners of every cell, counter-clockwise from (i, j): (i + 1, j), (i + 1, j + 1), (i, j + 1)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    even = (np.add.outer(np.arange(nx - 1), np.arange(ny - 1)) % 2 == 0)[..., None]
    first = np.where(even, np.stack([a, b, c], axis=-1), np.stack([a, b, d], axis=-1))
    second = np.where(even, np.stack([a, c, d], axis=-1), np.stack([b, c, d], axis=-1))
    faces = np.stack([first, second], axis=2).reshape(-1, 3)
    faces.flags.writeable = False
    return faces


def increasing(name: str, axis: ArrayLike) -> Floats:
    """Return grid lines as an array; refuse them unless they are two or more and increasing."""
    axis = np.asarray(axis, dtype=np.float64)
    if axis.ndim != 1 or len(axis) < 2 or not (np.diff(axis) > 0.0).all():
        raise Refused(name, Described(f"shape {axis.shape}"), "two or more increasing numbers [m]")
    return axis


def grid_points(x_axis: Floats, y_axis: Floats, z: Floats) -> Floats:
    """Return the points of a height field, shape (nx, ny, 3)."""
    return np.stack(np.broadcast_arrays(x_axis[:, None], y_axis, z), axis=-1)


# Relative to the size of the square. float32 files (binary STL, PLY) carry positions to 6e-8.
_COVERAGE_TOLERANCE = 1e-6
_STEEPEST_NORMAL_Z = 1e-6  # z of the unit normal of a facet that counts as vertical
_SMALLEST_AREA = 1e-12  # twice the area of a facet over its longest edge squared


@check_call
def from_trimesh(
    source: Annotated[trimesh.Trimesh | str | PathLike[str] | tuple[ArrayLike, ...], Inside()],
    extent: Positive | None = None,
    *,
    overhangs: bool = False,
    normals: Literal["area", "angle"] = "area",
) -> TriangleMesh:
    """Return the mesh of a surface from a file, a `trimesh.Trimesh` or arrays.

    Parameters
    ----------
    source : trimesh.Trimesh, path or tuple
        A `trimesh.Trimesh`; a file that trimesh reads (STL, PLY, OBJ); (vertices, faces) of
        shapes (n, 3) and (m, 3); or a grid (x, y, z) with z of shape (nx, ny) and x, y either
        axes of shapes (nx,), (ny,) or the arrays of `numpy.meshgrid`. Lengths in m.
    extent : float, optional
        Half-length [m] of the square |x|, |y| <= extent that the surface has to cover.
    overhangs : bool
        Allow facets that stand upright or face down, such as those under a plunging crest.
    normals : {"area", "angle"}
        Weights of the facets in the vertex normals, see `meshtrace.mesh.vertex_normals`.

    Returns
    -------
    TriangleMesh
        With equal vertices merged and unused ones dropped. Vertex normals are the mean of the
        adjacent facets.

    Raises
    ------
    Refused
        If the surface is empty, not finite, has facets without area, is closed, has facets that
        do not face up, is not one piece without holes, folds over itself, or does not cover
        the square. With overhangs: if neighbouring facets are wound against each other, the
        whole is turned over, or the outline crosses itself seen from above.

    Notes
    -----
    Faults are refused, never repaired: a surface that is turned over could as well be one with
    the wrong axis up. Vertices are merged only if equal in all digits, which joins the
    facets of an STL file and nothing else. The square may stick out by 1e-6 of its size, for
    the sake of files with single precision.

    A connected surface of facets that all face up has no fold exactly if its outline, seen from
    above, does not touch itself. (The sum of the facets' areas is no test: by Green's theorem
    it equals the area inside the outline with folds as well.)

    With overhangs the side of the air follows from the winding: an outline that runs
    counter-clockwise seen from above has the air above it. Sheets that pass through each other
    away from the outline are not found.

    Examples
    --------
    >>> corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0.1), (0, 1, 0)]
    >>> len(from_trimesh((corners, [(0, 1, 2), (0, 2, 3)])).faces)
    2
    """
    vertices, faces = _merged(*read_mesh(source))
    outline = _outline(len(vertices), faces, _area_vectors(vertices, faces), overhangs)
    _refuse_folds(vertices, outline, overhangs)
    if extent is not None:
        _refuse_uncovered(vertices[outline][..., :2], extent)
    corner_normals = vertex_normals(vertices, faces, normals)
    return TriangleMesh(vertices, faces.astype(np.int32), corner_normals, overhangs=overhangs)


def unfit(reason: str, allowed: str) -> Refused:
    """Return the refusal of a source of meshes, for the caller to raise."""
    return Refused("source", Described(reason), allowed)


@check_call
def read_mesh(source: Any) -> tuple[Floats, NDArray[np.int64]]:
    """Return vertices and facets of any source of `from_trimesh`; refuse wrong shapes."""
    if isinstance(source, str | PathLike):
        import trimesh

        allowed = "an undamaged STL, PLY or OBJ file"
        if not isfile(source):
            raise Refused(str(source), Described("no such file"), allowed)
        try:
            source = trimesh.load_mesh(source, process=False)
        except Exception as error:  # readers raise IndexError, KeyError, struct.error, ...
            raise Refused(str(source), Described(reason_of(error)), allowed) from error
    if isinstance(source, tuple | list) and len(source) == 3:
        return _read_grid(*source)
    pair = (source.vertices, source.faces) if hasattr(source, "faces") else source
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        allowed = "trimesh.Trimesh, a path, (vertices, faces) or (x, y, z)"
        raise unfit(type(source).__name__, allowed)
    vertices, faces = (
        require_array(array, "source", "vertices (n, 3) and faces (m, 3)", dtype)
        for array, dtype in zip(pair, (float, None), strict=True)
    )
    if vertices.size == 0 or faces.size == 0:
        raise unfit("empty", "a surface of one or more facets")
    if any(array.ndim != 2 or array.shape[1] != 3 for array in (vertices, faces)):
        raise unfit(f"shapes {vertices.shape} and {faces.shape}", "(n, 3) and (m, 3)")
    if not np.issubdtype(faces.dtype, np.integer):
        raise unfit(f"faces of type {faces.dtype}", "integers")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise unfit(f"faces {faces.min()}..{faces.max()}", f"0..{len(vertices) - 1}")
    return vertices, faces.astype(np.int64)


def _read_grid(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> tuple[Floats, NDArray[np.int64]]:
    """Return vertices and facets of a grid, given by its axes or the arrays of `numpy.meshgrid`."""
    for name, values in (("x", x), ("y", y), ("z", z)):
        require_plain(values, name, "a grid without gaps")
    x, y, z = (np.asarray(a, dtype=np.float64) for a in (x, y, z))
    if x.ndim == 2:
        if x.shape != z.shape or y.shape != z.shape or z.size == 0:
            raise unfit(f"shapes {x.shape}, {y.shape}, {z.shape}", "equal ones")
        # x varies along the second index: numpy.meshgrid with indexing="xy", its default
        if np.ptp(x[0]) > 0.0:
            x, y, z = x.T, y.T, z.T
        if (x != x[:, :1]).any() or (y != y[:1]).any():
            raise unfit("x, y are no grid", "the arrays of numpy.meshgrid")
        x, y = x[:, 0], y[0]
    x, y = increasing("x", x), increasing("y", y)
    if z.shape != (len(x), len(y)):
        raise Refused("z", z.shape, f"the shape {(len(x), len(y))} of x and y")
    return grid_points(x, y, z).reshape(-1, 3), grid_faces(*z.shape).astype(np.int64)


def _merged(vertices: Floats, faces: NDArray[np.int64]) -> tuple[Floats, NDArray[np.int64]]:
    """Merge equal vertices, drop unused ones, and renumber the facets."""
    import pandas as pd

    # corner: index of every corner of a facet into the used vertices
    used, corner = np.unique(faces, return_inverse=True)
    vertices = vertices[used]
    if not np.isfinite(vertices).all():
        raise unfit("vertices not all finite", "finite coordinates [m]")
    table = pd.DataFrame(vertices)
    # groups of equal vertices, numbered in the order of their first ones
    group = table.groupby([0, 1, 2], sort=False).ngroup().to_numpy()
    return vertices[~table.duplicated().to_numpy()], group[corner].reshape(-1, 3)


def _area_vectors(vertices: Floats, faces: NDArray[np.int64]) -> Floats:
    """Return twice the area vectors of the facets; refuse facets without area."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    edge2 = np.max([((b - a) ** 2).sum(1), ((c - b) ** 2).sum(1), ((a - c) ** 2).sum(1)], axis=0)
    cross = np.cross(b - a, c - a)
    count = np.count_nonzero(np.linalg.norm(cross, axis=1) <= _SMALLEST_AREA * edge2)
    if count:
        raise unfit(f"{count} of {len(faces)} facets without area", "none")
    return cross


def _outline(n: int, faces: NDArray[np.int64], cross: Floats, overhangs: bool) -> NDArray[np.int64]:
    """Return the directed boundary edges (e, 2) of one open piece that faces up; refuse others.

    `cross` holds the area vectors of the facets, and `n` is the number of vertices.
    """
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    # a directed edge as one number, for sorting
    forward, backward = edges[:, 0] * n + edges[:, 1], edges[:, 1] * n + edges[:, 0]
    # by sorting: numpy's hash tables take ten times as long for such keys
    undirected = np.sort(np.minimum(forward, backward))
    # uses: number of facets at each edge, from where the next edge starts in the sorted list
    starts = np.flatnonzero(np.diff(undirected, prepend=-1))
    uses = np.diff(starts, append=len(undirected))
    if (uses > 1).all():
        raise unfit("closed solid", "an open surface")
    up = cross[:, 2] / np.linalg.norm(cross, axis=1)
    if not overhangs:
        _refuse_count("facets face down", up < -_STEEPEST_NORMAL_Z, len(faces))
        _refuse_count("facets are vertical", up <= _STEEPEST_NORMAL_Z, len(faces))
    _refuse_count("edges join more than two facets", uses > 2, len(uses))
    if overhangs:
        # facets of the same winding run along their common edge in opposite directions
        against = np.count_nonzero(np.diff(np.sort(forward)) == 0)
        allowed = "facets counter-clockwise seen from the air"
        if against:
            raise unfit(f"{against} edges between facets of opposite winding", allowed)
        if not cross[:, 2].sum() > 0.0:
            reason = "turned over: its outline runs clockwise seen from above"
            raise unfit(reason, f"{allowed}, z up")
    # edges of the outline are those that no facet runs along in the opposite direction
    reverse = np.sort(backward)
    index = np.minimum(np.searchsorted(reverse, forward), len(reverse) - 1)
    outline = edges[reverse[index] != forward]
    _refuse_many_pieces(n, edges, outline)
    return outline


def _refuse_count(what: str, wrong: NDArray[np.bool_], total: int) -> None:
    """Refuse a source with wrong facets or edges, with their number."""
    count = np.count_nonzero(wrong)
    if count:
        raise unfit(f"{count} of {total} {what}", "a height field that faces up")


def _refuse_many_pieces(n: int, edges: NDArray[np.int64], outline: NDArray[np.int64]) -> None:
    """Require a surface of one piece without holes."""
    pieces = _component_count(n, edges)
    if pieces > 1:
        raise unfit(f"{pieces} separate pieces or sheets", "one")
    if len(np.unique(outline[:, 0])) < len(outline):
        raise unfit("pieces joined at a single vertex only", "one surface")
    # Holes are the loops of the outline but for the outer one: its components, less those of single
    # vertices inside (n - len(outline), as each vertex of a loop starts one edge), less 1.
    holes = _component_count(n, outline) - (n - len(outline)) - 1
    if holes:
        raise unfit(f"{holes} holes inside the outline", "none")


def _component_count(n: int, edges: NDArray[np.int64]) -> int:
    """Return the number of connected components of n vertices, isolated ones included."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n, n))
    return int(connected_components(graph, directed=False, return_labels=False))


def _refuse_folds(vertices: Floats, outline: NDArray[np.int64], overhangs: bool) -> None:
    """Refuse an outline that touches itself seen from above, apart from shared vertices.

    With overhangs it may run over itself, as where a plunging crest is cut by a vertical plane,
    but not across.
    """
    from scipy.spatial import cKDTree

    start, end = vertices[outline[:, 0], :2], vertices[outline[:, 1], :2]
    # Two segments can only meet if their middles are at most the longest segment apart.
    longest = np.linalg.norm(end - start, axis=1).max()
    tree = cKDTree(0.5 * (start + end))
    i, j = tree.query_pairs(longest * (1.0 + 1e-9), output_type="ndarray").T
    # neighbours share a vertex
    apart = (outline[i, 0] != outline[j, 1]) & (outline[i, 1] != outline[j, 0])
    i, j = i[apart], j[apart]
    # a length of the tolerance times one of the longest segment, as an area
    least = _COVERAGE_TOLERANCE * longest**2 if overhangs else 0.0
    touching = np.count_nonzero(_segments_meet(start[i], end[i], start[j], end[j], least))
    if touching:
        raise unfit(
            f"outline meets itself {touching} times seen from above",
            "one sheet, without several sheets over one point or seams of unequal vertices",
        )


def _segments_meet(p: Floats, q: Floats, r: Floats, s: Floats, least: float) -> NDArray[np.bool_]:
    """Return the mask of segments p-q and r-s, points (n, 2), that have a point in common.

    Where `least` > 0, segments that touch or run over each other do not count: twice the area of
    the triangles of one segment and an end of the other has to be larger than that [m2].
    """

    def side(a: Floats, b: Floats, c: Floats) -> Floats:
        """Return 1 where c lies to the left of a-b, -1 to the right, 0 on it."""
        u, v = b - a, c - a
        twice = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        return np.where(np.abs(twice) <= least, 0.0, np.sign(twice))

    first, second = side(p, q, r) * side(p, q, s), side(r, s, p) * side(r, s, q)
    # products of signs: -1 where the ends lie on both sides of the other line, 0 for a touch
    straddle = np.maximum(first, second) < (0.0 if least > 0.0 else 0.5)
    # bounding boxes overlap: segments on one line have only products of 0
    boxes = (np.maximum(p, q) >= np.minimum(r, s)) & (np.maximum(r, s) >= np.minimum(p, q))
    return straddle & boxes.all(axis=1)


def _refuse_uncovered(segments: Floats, extent: float) -> None:
    """Refuse an outline, shape (e, 2, 2), that leaves part of the square |x|, |y| <= extent."""
    inner = extent * (1.0 - _COVERAGE_TOLERANCE)
    corners = inner * np.array([[[1.0, 1.0]], [[-1.0, 1.0]], [[-1.0, -1.0]], [[1.0, -1.0]]])
    start, end = segments[:, 0], segments[:, 1]
    crosses = [_segments_meet(start, end, corners[i - 1], corners[i], 0.0).any() for i in range(4)]
    # An outline that crosses no side goes round the whole square, or round no corner. It goes round
    # the corner (inner, inner) if a ray from there along +x meets it an odd number of times.
    passing = (start[:, 1] > inner) != (end[:, 1] > inner)
    (x, y), (step_x, step_y) = start[passing].T, (end - start)[passing].T
    right = np.count_nonzero(x + (inner - y) * step_x / step_y > inner)
    if any(crosses) or right % 2 == 0:
        low, high = start.min(axis=0), start.max(axis=0)
        allowed = (
            "a square |x|, |y| <= extent [m] that the surface covers; it lies in "
            f"x {low[0]:g}..{high[0]:g} m, y {low[1]:g}..{high[1]:g} m"
        )
        raise Refused("extent", Described(f"{extent} m"), allowed)
