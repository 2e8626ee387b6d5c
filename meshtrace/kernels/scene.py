"""Scene of one source, one surface and one aperture, with bins to find the facet at (x, y).

Lengths are in the unit of the local frame of a link, `Link.unit`, called m here; z is up from still
water.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.bodies import BodyArrays
from meshtrace.kernels.interface import Interface, MeshArrays, corners, inside_facet
from meshtrace.kernels.jit import entry, inlined, record_type
from meshtrace.kernels.medium import Medium
from meshtrace.kernels.vectors import ORIGIN, Vec2, Vec3, cross, minus, norm, row

FLAT_SEA = np.int64(-1)
"""Facet that stands for a flat sea; an int64 as all facets, so that kernels compile once."""

FACET = record_type(
    [
        ("radius", float),  # largest horizontal distance of a corner from the centroid [m]
        # largest change of slope along an edge over the edge's horizontal length [m-1]
        ("curvature", float),
        ("x", float),  # centroid [m]
        ("y", float),
        ("z", float),
        ("slope_x", float),  # dz/dx and dz/dy of the facet's plane
        ("slope_y", float),
    ]
)
"""Summary of a facet, see `facet_summary`."""


class Emitter(NamedTuple):
    """The end that chains start from: a source, or an aperture from which light is traced back."""

    position: Vec3
    axis: Vec3  # unit vector along the brightest light
    kind: int  # SourceKind
    spread: float  # Lambertian order, or half-angle of divergence or field of view [rad]
    norm: float  # intensity on the axis for a power of 1 [sr-1]
    # Reciprocity: chains of a downlink start at the receiver, whose etendue stands for its power.
    power: float = 1.0  # 1, or the etendue of an aperture [m2 sr]
    radius: float = 0.0  # of the disk that the chains start from [m], 0 for a point
    e1: Vec3 = ORIGIN  # perpendicular unit vectors in the plane of the disk
    e2: Vec3 = ORIGIN
    table: int = 0  # address of a table of intensities, see `kernels.tables`


class Target(NamedTuple):
    """The end that chains lead to: an aperture, or the lamp of light traced back."""

    center: Vec3
    axis: Vec3  # direction in which light at normal incidence travels
    e1: Vec3  # perpendicular unit vectors in the plane of the aperture
    e2: Vec3
    # of the aperture [m2]; for a lamp (n_water / n_air)^2, as radiance over n^2 is conserved
    area: float
    radius: float  # [m]
    cos_half_fov: float  # of the angle between light and axis
    tan_half_fov: float
    reach: float  # largest horizontal distance of a crossing inside the field of view [m]
    sin_widest: float  # sine of the largest angle between accepted light and the vertical
    is_lamp: bool
    lamp: Emitter  # pattern of the lamp


class Locator(NamedTuple):
    """Square bins over (x, y), each with a list of the facets that may touch it.

    Bin (i, j) is number i ny + j; its facets are `facet[start[number] : start[number + 1]]`.
    """

    x: float  # corner of bin (0, 0) [m]
    y: float
    step: float  # edge of a bin [m]
    nx: int
    ny: int
    start: NDArray[np.int64]  # (nx * ny + 1,)
    facet: NDArray[np.int32]


class Scene(NamedTuple):
    """One source, one surface and one aperture.

    Light starts below the surface and ends above it, or, where the surface `reflects` it to its
    target, below it again. A mirrored scene is turned upside down for this: its source lies in the
    air, drawn below the surface, and the refractive indices of its medium are interchanged.
    """

    emitter: Emitter
    target: Target
    surface: MeshArrays
    locator: Locator
    facets: NDArray[np.void]  # (m,) FACET
    medium: Medium
    interface: Interface
    mirrored: bool = False
    reflects: bool = False  # source and target lie on one side, and the surface is their mirror
    bodies: BodyArrays | None = None  # the right way up, in a mirrored scene too


@inlined
def height_on(x, y, facet, surface):
    """Return the height of a facet's plane at (x, y); facet -1 is a flat sea.

    Array twin: barycentric interpolation of the corners.
    """
    if facet < 0:
        return surface.level
    a = row(surface.vertices, surface.faces[facet, 0])
    n = row(surface.face_normals, facet)
    # (p - a) . n = 0, solved for p.z: no barycentrics, and continued beyond the facet
    return a.z - ((x - a.x) * n.x + (y - a.y) * n.y) / n.z


@inlined
def locate(locator, surface, x, y):
    """Return the facet at (x, y), -1 where there is none.

    Array twin: vertical rays of `BruteForceIntersector`.
    """
    i = math.floor((x - locator.x) / locator.step)
    j = math.floor((y - locator.y) / locator.step)
    if i < 0 or j < 0 or i >= locator.nx or j >= locator.ny:
        return FLAT_SEA
    # a few facets a bin: compared one by one
    cell = i * locator.ny + j
    for k in range(locator.start[cell], locator.start[cell + 1]):
        f = np.int64(locator.facet[k])
        if inside_facet(x, y, f, surface):
            return f
    return FLAT_SEA


@inlined
def bins_near(x, y, radius, grid):
    """Return the first and last bins of a locator, along x and y, within a radius of (x, y)."""
    # clipped: beside the bins no facet is listed; a last bin below the first stands for none
    i0 = max(int((x - radius - grid.x) / grid.step), 0)
    i1 = min(int((x + radius - grid.x) / grid.step), grid.nx - 1)
    j0 = max(int((y - radius - grid.y) / grid.step), 0)
    j1 = min(int((y + radius - grid.y) / grid.step), grid.ny - 1)
    return i0, i1, j0, j1


@inlined
def is_first_bin(i, j, i0, j0, f, surface, grid):
    """Return whether a search from bin (i0, j0) meets facet f for the first time in bin (i, j)."""
    a, b, c = corners(surface.vertices, f, surface.faces)
    # A facet is listed in all bins that its bounding box touches, and is to count once.
    fi = _bin_of(min(a.x, b.x, c.x), grid.x, grid.step, grid.nx)
    fj = _bin_of(min(a.y, b.y, c.y), grid.y, grid.step, grid.ny)
    return i == max(fi, i0) and j == max(fj, j0)


@inlined
def _bin_of(x, start, step, n):
    """Return the bin of a coordinate, -1 below the first and n above the last."""
    # clipped as a float: a coordinate far outside may not fit an integer
    return math.floor(max(min((x - start) / step, float(n)), -1.0))


@inlined
def _span(p, q):
    """Return the squared horizontal distance between two points [m2]."""
    return (p.x - q.x) ** 2 + (p.y - q.y) ** 2


@inlined
def _bend(m, n):
    """Return the squared difference of the slopes of two normals."""
    return (m.x / m.z - n.x / n.z) ** 2 + (m.y / m.z - n.y / n.z) ** 2


@entry
def facet_normals(vertices, faces, normal, area):
    """Write the unit normals of facets (m, 3), and twice their areas (m,) [m2].

    Returns the lowest and the highest corner of the bounds and the square of the largest slope.

    Array twin: numpy.cross of edges.
    The normal points up for corners that run counter-clockwise as seen from above; it is nan for a
    facet without area.
    """
    low, high = Vec3(math.inf, math.inf, math.inf), Vec3(-math.inf, -math.inf, -math.inf)
    steepest = 0.0
    for f in range(len(faces)):
        a, b, c = corners(vertices, f, faces)
        n = cross(minus(b, a), minus(c, a))
        area[f] = norm(n)
        normal[f, 0], normal[f, 1], normal[f, 2] = n.x / area[f], n.y / area[f], n.z / area[f]
        # squared slope: the root is taken once, by the caller
        steepest = max(steepest, (n.x * n.x + n.y * n.y) / (n.z * n.z))
        for p in (a, b, c):
            low = Vec3(min(low.x, p.x), min(low.y, p.y), min(low.z, p.z))
            high = Vec3(max(high.x, p.x), max(high.y, p.y), max(high.z, p.z))
    return low, high, steepest


@entry
def facet_summary(surface, out):
    """Write the `FACET` record of each facet.

    Array twin: numpy.linalg.norm over corners.
    The curvature is 0 where normals are not interpolated.
    """
    for f in range(len(surface.faces)):
        a, b, c = corners(surface.vertices, f, surface.faces)
        n_a, n_b, n_c = corners(surface.vertex_normals, f, surface.faces)
        x, y, z = (a.x + b.x + c.x) / 3.0, (a.y + b.y + c.y) / 3.0, (a.z + b.z + c.z) / 3.0
        middle = Vec2(x, y)
        # horizontal distances: searches for a facet go over (x, y)
        out[f].radius = math.sqrt(max(_span(a, middle), _span(b, middle), _span(c, middle)))
        # Change of the interpolated slope per length: bounds how far the image of a facet departs
        # from that of a plane.
        squared = max(_bend(n_a, n_b) / _span(a, b), _bend(n_b, n_c) / _span(b, c))
        squared = max(squared, _bend(n_c, n_a) / _span(c, a))
        out[f].curvature = math.sqrt(squared) if surface.interpolate else 0.0
        out[f].x, out[f].y, out[f].z = x, y, z
        g = row(surface.face_normals, f)
        out[f].slope_x, out[f].slope_y = -g.x / g.z, -g.y / g.z


@entry
def count_bins(vertices, faces, grid, bins):
    """Count the facets of each bin into `grid.start[1:]`, and write the bin (i, j) of each vertex.

    `bins` is (n, 2), for `fill_bins`; the caller sums `start` up in between.
    """
    # two passes, counts and then lists: arrays of the right size without a list for each bin
    for v in range(len(vertices)):
        bins[v, 0] = _bin_of(vertices[v, 0], grid.x, grid.step, grid.nx)
        bins[v, 1] = _bin_of(vertices[v, 1], grid.y, grid.step, grid.ny)
    for f in range(len(faces)):
        i0, i1, j0, j1 = _bin_range(faces, f, grid, bins)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                grid.start[i * grid.ny + j + 1] += 1


@entry
def fill_bins(faces, grid, bins, cursor):
    """Write the facets of each bin into `grid.facet`; cursor is a copy of `grid.start[:-1]`."""
    for f in range(len(faces)):
        i0, i1, j0, j1 = _bin_range(faces, f, grid, bins)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                cell = i * grid.ny + j
                grid.facet[cursor[cell]] = f
                cursor[cell] += 1


@inlined
def _bin_range(faces, f, grid, bins):
    """Return the first and last bins, along x and along y, that a facet may touch."""
    # those of its bounding box, cut to the grid
    a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
    i0, j0 = min(bins[a, 0], bins[b, 0], bins[c, 0]), min(bins[a, 1], bins[b, 1], bins[c, 1])
    i1, j1 = max(bins[a, 0], bins[b, 0], bins[c, 0]), max(bins[a, 1], bins[b, 1], bins[c, 1])
    return max(i0, 0), min(i1, grid.nx - 1), max(j0, 0), min(j1, grid.ny - 1)
