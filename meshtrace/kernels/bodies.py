"""Bodies in the water and the air: the facets that light meets, and how they reflect it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.interface import plane_distance
from meshtrace.kernels.jit import inlined, outlined
from meshtrace.kernels.rays import Bvh, first_facet
from meshtrace.kernels.vectors import along, dot, minus, row, scaled, turn


class BodyArrays(NamedTuple):
    """Facets of all bodies of a link; both sides reflect."""

    vertices: NDArray[np.float64]  # (n, 3) [m]
    faces: NDArray[np.int32]  # (m, 3)
    face_normals: NDArray[np.float64]  # (m, 3) unit
    body: NDArray[np.int32]  # (m,) of each facet
    albedo: NDArray[np.float64]  # (bodies,) 0 for a black body
    is_mirror: NDArray[np.bool_]  # (bodies,) else Lambertian
    bvh: Bvh


@outlined
def first_body(p, d, bodies):
    """Return the first facet of a body along a ray and its distance; -1 and inf for none.

    Array twin: `BruteForceIntersector`.
    """
    facet = first_facet(bodies.bvh, p, d)
    if facet < 0:
        return facet, math.inf
    # single precision chooses the facet alone: its plane gives the distance
    return facet, max(plane_distance(p, d, facet, bodies), 0.0)


_HAIR = 1e-4  # by which a path is shortened at its end, over 1 + its length: Embree is float32


@inlined
def is_hidden(p, d, length, bodies):
    """Return whether a body cuts the straight path from p along d over a length.

    Array twin: `BruteForceIntersector`.
    """
    if bodies is None:  # an argument: the rest is not compiled for links without bodies
        return False
    _, distance = first_body(p, d, bodies)
    return distance < length - _HAIR * (1.0 + length)


@inlined
def normal_facing(d, facet, bodies):
    """Return the normal of a facet that faces light along d."""
    n = row(bodies.face_normals, facet)
    return scaled(-1.0, n) if dot(d, n) > 0.0 else n


_OFFSET = 1e-5  # distance of reflected light from its facet, over 1 + its largest coordinate


@inlined
def reflected(p, d, facet, u_cos, u_phi, bodies):
    """Return origin and direction of light along d after reflection by a facet.

    Array twin: cos theta = sqrt(u), or the law of reflection.
    """
    n = normal_facing(d, facet, bodies)
    # started on the facet itself, a ray of single precision could meet it again
    reach = max(abs(p.x), abs(p.y), abs(p.z))
    start = along(p, n, _OFFSET * (1.0 + reach))
    if bodies.is_mirror[bodies.body[facet]]:
        return start, minus(d, scaled(2.0 * dot(d, n), n))
    # Lambertian: cos theta = u^(1/2), and sin^2(theta / 2) = (1 - cos theta) / 2
    return start, turn(n, 0.5 * (1.0 - math.sqrt(u_cos)), u_phi)
