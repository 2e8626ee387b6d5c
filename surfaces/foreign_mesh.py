"""Meshes of other programs: accepted objects and files, limits and refusals."""

from __future__ import annotations

from os import PathLike
from os.path import isfile
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshtrace.errors import Described, Refused, reason_of, require_array
from meshtrace.mesh import TriangleMesh, vertex_normals

from .parameters import Floats, Range
from .triangulate import grid_faces, grid_points, increasing

if TYPE_CHECKING:
    import trimesh

# float32 files (binary STL, PLY) carry positions to 6e-8 of their size.
_COVERAGE_TOLERANCE = 1e-6
_STEEPEST_NORMAL_Z = 1e-6
_SMALLEST_AREA = 1e-12


def from_trimesh(
    source: trimesh.Trimesh | str | PathLike[str] | tuple[ArrayLike, ...],
    extent: float | None = None,
    *,
    overhangs: bool = False,
    normals: Literal["area", "angle"] = "area",
) -> TriangleMesh:
    """Return the mesh of a surface from another source.

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
        _refuse_uncovered(vertices[outline][..., :2], Range("extent", 0.0, unit="m").check(extent))
    corner_normals = vertex_normals(vertices, faces, normals)
    return TriangleMesh(vertices, faces.astype(np.int32), corner_normals, overhangs=overhangs)


def unfit(found: str, allowed: str) -> Refused:
    """Return the refusal of a source of meshes, by words about it."""
    return Refused("source", Described(found), allowed)


def read_mesh(source: Any) -> tuple[Floats, NDArray[np.int64]]:
    """Return vertices and facets of any source of `from_trimesh`, with their shapes checked."""
    if isinstance(source, str | PathLike):
        source = _loaded(source)
    if isinstance(source, tuple | list) and len(source) == 3:
        return _read_grid(*source)
    pair = (source.vertices, source.faces) if hasattr(source, "faces") else source
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        allowed = "trimesh.Trimesh, a path, (vertices, faces) or (x, y, z)"
        raise unfit(type(source).__name__, allowed)
    vertices, faces = (
        require_array(rows, "source", "vertices (n, 3) and faces (m, 3)", dtype)
        for rows, dtype in zip(pair, (float, None), strict=True)
    )
    if vertices.size == 0 or faces.size == 0:
        raise unfit("empty", "a surface of one or more facets")
    if any(rows.ndim != 2 or rows.shape[1] != 3 for rows in (vertices, faces)):
        raise unfit(f"shapes {vertices.shape} and {faces.shape}", "(n, 3) and (m, 3)")
    if not np.issubdtype(faces.dtype, np.integer):
        raise unfit(f"faces of type {faces.dtype}", "integers")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise unfit(f"faces {faces.min()}..{faces.max()}", f"0..{len(vertices) - 1}")
    return vertices, faces.astype(np.int64)


def _loaded(path: str | PathLike[str]) -> trimesh.Trimesh:
    """Read a mesh file; refuse files that its reader fails on."""
    import trimesh

    allowed = "an undamaged STL, PLY or OBJ file"
    if not isfile(path):
        raise Refused(str(path), Described("no such file"), allowed)
    try:
        return trimesh.load_mesh(path, process=False)
    except Exception as error:  # readers raise IndexError, KeyError, struct.error, ...
        raise Refused(str(path), Described(reason_of(error)), allowed) from error


def _read_grid(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> tuple[Floats, NDArray[np.int64]]:
    x, y, z = (np.asarray(a, dtype=np.float64) for a in (x, y, z))
    if x.ndim == 2:
        if x.shape != z.shape or y.shape != z.shape or z.size == 0:
            raise unfit(f"shapes {x.shape}, {y.shape}, {z.shape}", "equal ones")
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
    """Return the distinct used vertices, in their first order, and the facets."""
    import pandas as pd

    used, corner = np.unique(faces, return_inverse=True)
    vertices = vertices[used]
    if not np.isfinite(vertices).all():
        raise unfit("vertices not all finite", "finite coordinates [m]")
    table = pd.DataFrame(vertices)
    group = table.groupby([0, 1, 2], sort=False).ngroup().to_numpy()
    return vertices[~table.duplicated().to_numpy()], group[corner].reshape(-1, 3)


def _area_vectors(vertices: Floats, faces: NDArray[np.int64]) -> Floats:
    """Return twice the area vectors of the facets; refuse facets without area."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    edge = np.max([((b - a) ** 2).sum(1), ((c - b) ** 2).sum(1), ((a - c) ** 2).sum(1)], axis=0)
    cross = np.cross(b - a, c - a)
    count = np.count_nonzero(np.linalg.norm(cross, axis=1) <= _SMALLEST_AREA * edge)
    if count:
        raise unfit(f"{count} of {len(faces)} facets without area", "none")
    return cross


def _outline(n: int, faces: NDArray[np.int64], cross: Floats, overhangs: bool) -> NDArray[np.int64]:
    """Return the directed boundary edges, shape (e, 2), of one open piece under air."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    forward, backward = edges[:, 0] * n + edges[:, 1], edges[:, 1] * n + edges[:, 0]
    # by sorting: numpy's hash tables take ten times as long for such keys
    undirected = np.sort(np.minimum(forward, backward))
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
        against = np.count_nonzero(np.diff(np.sort(forward)) == 0)
        allowed = "facets counter-clockwise seen from the air"
        if against:
            raise unfit(f"{against} edges between facets of opposite winding", allowed)
        if not cross[:, 2].sum() > 0.0:
            found = "turned over: its outline runs clockwise seen from above"
            raise unfit(found, f"{allowed}, z up")
    reverse = np.sort(backward)
    at = np.minimum(np.searchsorted(reverse, forward), len(reverse) - 1)
    outline = edges[reverse[at] != forward]
    _refuse_many_pieces(n, edges, outline)
    return outline


def _refuse_count(what: str, wrong: NDArray[np.bool_], total: int) -> None:
    count = np.count_nonzero(wrong)
    if count:
        raise unfit(f"{count} of {total} {what}", "a height field that faces up")


def _refuse_many_pieces(n: int, edges: NDArray[np.int64], outline: NDArray[np.int64]) -> None:
    pieces = _component_count(n, edges)
    if pieces > 1:
        raise unfit(f"{pieces} separate pieces or sheets", "one")
    if len(np.unique(outline[:, 0])) < len(outline):
        raise unfit("pieces joined at a single vertex only", "one surface")
    holes = _component_count(n, outline) - (n - len(outline)) - 1
    if holes:
        raise unfit(f"{holes} holes inside the outline", "none")


def _component_count(n: int, edges: NDArray[np.int64]) -> int:
    """Return the number of connected components of n vertices, lone ones included."""
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
    apart = (outline[i, 0] != outline[j, 1]) & (outline[i, 1] != outline[j, 0])
    i, j = i[apart], j[apart]
    least = _COVERAGE_TOLERANCE * longest**2 if overhangs else 0.0
    touching = np.count_nonzero(_segments_meet(start[i], end[i], start[j], end[j], least))
    if touching:
        raise unfit(
            f"outline meets itself {touching} times seen from above",
            "one sheet, without several sheets over one point or seams of unequal vertices",
        )


def _segments_meet(p: Floats, q: Floats, r: Floats, s: Floats, least: float) -> NDArray[np.bool_]:
    """Return the mask of segments p-q and r-s in the plane with a point in common.

    Where `least` > 0, segments that touch or run over each other do not count: the triangles of
    the ends have to be larger than that [m2].
    """

    def side(a: Floats, b: Floats, c: Floats) -> Floats:
        u, v = b - a, c - a
        twice = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        return np.where(np.abs(twice) <= least, 0.0, np.sign(twice))

    first, second = side(p, q, r) * side(p, q, s), side(r, s, p) * side(r, s, q)
    straddle = np.maximum(first, second) < (0.0 if least > 0.0 else 0.5)
    boxes = (np.maximum(p, q) >= np.minimum(r, s)) & (np.maximum(r, s) >= np.minimum(p, q))
    return straddle & boxes.all(axis=1)


def _refuse_uncovered(segments: Floats, extent: float) -> None:
    """Refuse an outline, shape (e, 2, 2), that leaves part of the square |x|, |y| <= extent."""
    inner = extent * (1.0 - _COVERAGE_TOLERANCE)
    start, step = segments[:, 0], segments[:, 1] - segments[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (-inner - start) / step, (inner - start) / step
    # A segment along an axis stays inside or outside that slab for good.
    parallel = step == 0.0
    within = np.abs(start) < inner
    enter = np.where(parallel, np.where(within, -np.inf, np.inf), np.minimum(first, second))
    leave = np.where(parallel, np.inf, np.maximum(first, second))
    crosses = np.maximum(enter.max(axis=1), 0.0) < np.minimum(leave.min(axis=1), 1.0)
    if crosses.any() or not _around_origin(start, step):
        low, high = start.min(axis=0), start.max(axis=0)
        allowed = (
            "a square |x|, |y| <= extent [m] that the surface covers; it lies in "
            f"x {low[0]:g}..{high[0]:g} m, y {low[1]:g}..{high[1]:g} m"
        )
        raise Refused("extent", Described(f"{extent} m"), allowed)


def _around_origin(start: Floats, step: Floats) -> bool:
    """Return whether a closed outline that avoids the origin winds around it."""
    end = start + step
    crossing = (start[:, 1] > 0.0) != (end[:, 1] > 0.0)
    start, step = start[crossing], step[crossing]
    x = start[:, 0] - start[:, 1] * step[:, 0] / step[:, 1]
    return bool(np.count_nonzero(x > 0.0) % 2)
