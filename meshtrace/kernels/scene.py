"""One source, one surface and one aperture, and the bins that find the facet over a point.

Lengths are in the unit of the frame of a link, called m here.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.interface import Interface, MeshArrays, corners, inside_facet
from meshtrace.kernels.jit import entry, inlined, record_type
from meshtrace.kernels.medium import Medium
from meshtrace.kernels.vectors import ORIGIN, Vec2, Vec3, cross, minus, norm, row

FLAT_SEA = np.int64(-1)
"""Facet that stands for a flat sea; of the type of all facets, so that kernels compile once."""

FACET = record_type(
    [
        ("radius", float),  # largest horizontal distance of a corner from the centroid [m]
        ("curvature", float),  # largest change of slope along an edge over its length [m-1]
        ("x", float),  # centroid
        ("y", float),
        ("z", float),
        ("slope_x", float),
        ("slope_y", float),
    ]
)
"""Summary of a facet, see `facet_summary`."""


class Emitter(NamedTuple):
    """A source: position, axis and angular distribution; an aperture whose light is reversed."""

    position: Vec3
    axis: Vec3  # unit vector along the brightest light
    kind: int  # SourceKind
    spread: float  # Lambertian order, or half-angle of divergence or field of view [rad]
    norm: float  # intensity on the axis [sr-1]
    # Reciprocity: chains of a downlink start at the receiver, whose etendue stands for its power.
    power: float = 1.0  # 1, or the etendue of an aperture [m2 sr]
    radius: float = 0.0  # of the disk that the chains start from [m], 0 for a point
    e1: Vec3 = ORIGIN  # unit vectors in the plane of the disk
    e2: Vec3 = ORIGIN


class Target(NamedTuple):
    """An aperture, its plane, and the region of crossings to it; or a lamp, reached backwards."""

    center: Vec3
    axis: Vec3  # direction of light at normal incidence
    e1: Vec3  # unit vectors in the plane of the aperture
    e2: Vec3
    area: float  # of the aperture [m2]; the square of the relative index for a lamp
    radius: float
    cos_half_fov: float
    tan_half_fov: float
    reach: float  # largest horizontal distance of a crossing inside the field of view [m]
    sin_widest: float  # sine of the largest angle of accepted light from the vertical
    is_lamp: bool
    lamp: Emitter  # pattern of the lamp


class Locator(NamedTuple):
    """Square bins over (x, y) that list the facets in each: which facet lies over a point.

    Bin (i, j) is number i ny + j; its facets are `facet[start[number] : start[number + 1]]`.
    """

    x: float  # lower corner [m]
    y: float
    step: float  # edge of a bin [m]
    nx: int
    ny: int
    start: NDArray[np.int64]  # (nx * ny + 1,)
    facet: NDArray[np.int32]


class Scene(NamedTuple):
    """One source, one surface and one aperture.

    A mirrored scene is turned upside down: its source lies in the air, drawn below the surface,
    and the indices of its medium are interchanged.
    """

    emitter: Emitter
    target: Target
    surface: MeshArrays
    locator: Locator
    facets: NDArray[np.void]  # (m,) FACET
    medium: Medium
    interface: Interface
    mirrored: bool = False


@inlined
def height_on(x, y, facet, surface):
    """Return the height of a facet's plane over (x, y); facet -1 is a flat sea.

    Array twin: barycentric interpolation of the corners.
    """
    if facet < 0:
        return surface.level
    a = row(surface.vertices, surface.faces[facet, 0])
    n = row(surface.face_normals, facet)
    # (P - a) . n = 0, solved for z: no barycentrics, and continued beyond the facet
    return a.z - ((x - a.x) * n.x + (y - a.y) * n.y) / n.z


@inlined
def locate(locator, surface, x, y):
    """Return the facet over (x, y), -1 outside.

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
    """Return the first and last bins, along x and along y, within a radius of a point."""
    # clipped: beside the bins no facet is listed
    i0 = max(int((x - radius - grid.x) / grid.step), 0)
    i1 = min(int((x + radius - grid.x) / grid.step), grid.nx - 1)
    j0 = max(int((y - radius - grid.y) / grid.step), 0)
    j1 = min(int((y + radius - grid.y) / grid.step), grid.ny - 1)
    return i0, i1, j0, j1


@inlined
def is_first_bin(i, j, i0, j0, f, surface, grid):
    """Return whether bin (i, j) is the first bin from (i0, j0) on that lists a facet."""
    a, b, c = corners(surface.vertices, f, surface.faces)
    # A facet is listed in all bins that it touches: taken in the first of those searched, once.
    fi = _bin_of(min(a.x, b.x, c.x), grid.x, grid.step, grid.nx)
    fj = _bin_of(min(a.y, b.y, c.y), grid.y, grid.step, grid.ny)
    return i == max(fi, i0) and j == max(fj, j0)


@inlined
def _bin_of(x, start, step, n):
    """Return the bin of a coordinate, clipped before the conversion: it may not fit an integer."""
    return math.floor(max(min((x - start) / step, float(n)), -1.0))


@inlined
def _span(p, q):
    """Return the squared horizontal distance of two points."""
    return (p.x - q.x) ** 2 + (p.y - q.y) ** 2


@inlined
def _bend(m, n):
    """Return the squared difference of the slopes of two normals."""
    return (m.x / m.z - n.x / n.z) ** 2 + (m.y / m.z - n.y / n.z) ** 2


@entry
def facet_normals(vertices, faces, normal, area):
    """Write the unit normals of facets (m, 3), and twice their areas (m,) [m2].

    Returns the lowest and the highest corner and the square of the largest slope.

    Array twin: numpy.cross of edges.
    A facet without area has a normal that is no number.
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
    The curvature of faceted normals is 0.
    """
    for f in range(len(surface.faces)):
        a, b, c = corners(surface.vertices, f, surface.faces)
        k, m, n = corners(surface.vertex_normals, f, surface.faces)
        x, y, z = (a.x + b.x + c.x) / 3.0, (a.y + b.y + c.y) / 3.0, (a.z + b.z + c.z) / 3.0
        middle = Vec2(x, y)
        # horizontal: bounds over (x, y) are bounds of projections
        out[f].radius = math.sqrt(max(_span(a, middle), _span(b, middle), _span(c, middle)))
        # Change of the interpolated slope per length: bounds how far the image of a facet departs
        # from that of a plane.
        curvature = max(_bend(k, m) / _span(a, b), _bend(m, n) / _span(b, c))
        curvature = max(curvature, _bend(n, k) / _span(c, a))
        out[f].curvature = math.sqrt(curvature) if surface.interpolate else 0.0
        out[f].x, out[f].y, out[f].z = x, y, z
        g = row(surface.face_normals, f)
        out[f].slope_x, out[f].slope_y = -g.x / g.z, -g.y / g.z


@entry
def count_bins(surface, grid, bins):
    """Count the facets of each bin into `grid.start[1:]`, and write the bin of each vertex."""
    # two passes, counts and then lists: arrays of the right size without a list for each bin
    for v in range(len(surface.vertices)):
        bins[v, 0] = _bin_of(surface.vertices[v, 0], grid.x, grid.step, grid.nx)
        bins[v, 1] = _bin_of(surface.vertices[v, 1], grid.y, grid.step, grid.ny)
    for f in range(len(surface.faces)):
        i0, i1, j0, j1 = _bin_range(surface.faces, f, grid, bins)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                grid.start[i * grid.ny + j + 1] += 1


@entry
def fill_bins(surface, grid, bins, cursor):
    """Write the facets of each bin into `grid.facet`; cursor is a copy of `grid.start[:-1]`."""
    for f in range(len(surface.faces)):
        i0, i1, j0, j1 = _bin_range(surface.faces, f, grid, bins)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                cell = i * grid.ny + j
                grid.facet[cursor[cell]] = f
                cursor[cell] += 1


@inlined
def _bin_range(faces, f, grid, bins):
    """Return the first and last bins, along x and along y, that a facet may touch."""
    a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
    i0, j0 = min(bins[a, 0], bins[b, 0], bins[c, 0]), min(bins[a, 1], bins[b, 1], bins[c, 1])
    i1, j1 = max(bins[a, 0], bins[b, 0], bins[c, 0]), max(bins[a, 1], bins[b, 1], bins[c, 1])
    # Bounding box of the facet, cut to the grid.
    return max(i0, 0), min(i1, grid.nx - 1), max(j0, 0), min(j1, grid.ny - 1)
