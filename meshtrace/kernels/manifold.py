"""Manifold next-event estimation: crossings of smooth waves that join two points.

Without random slopes the light of a point in the water reaches a point of an aperture only where
the mesh refracts it there. All such crossings are found as those of scattering chains
(`meshtrace.kernels.crossings`), from the crossing of still water [1]_.

References
----------
.. [1] J. Hanika, M. Droske and L. Fascione, "Manifold next event estimation", Computer Graphics
   Forum 34 (2015), doi:10.1111/cgf.12681.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.kernels.aiming import flat_crossing
from meshtrace.kernels.crossings import Search, roots_near
from meshtrace.kernels.facets import Surface
from meshtrace.kernels.jit import NO, ZERO, inlined, outlined
from meshtrace.kernels.scene import Scene


class Manifold(NamedTuple):
    """Search for the crossings of one thread, and its room."""

    search: Search  # for targets without bounds
    flat: NDArray[np.void]  # (1,) FLAT
    roots: NDArray[np.void]  # ROOT
    counters: NDArray[np.int64]  # by `Counter`


@outlined
def crossings_between(x, y, level, shot, audit, scene, manifold):
    """Write the crossings from the start of a shot to its goal (`roots`); return their number.

    Array twin: `crossings.enumerate_roots`, which searches every facet.
    (x, y) is the crossing of a flat sea at the height `level`, that of the waves over a start
    near them.
    """
    search, flat = manifold.search, manifold.flat[0]
    flat_crossing(flat, x, y, shot, _raised(level, scene))
    if flat.low <= 0.0:
        return ZERO
    bounded = Search(
        search.audit, search.slope, search.margin, scene.target.reach + search.widest,
        search.curvature, search.near,
    )  # fmt: skip
    unlisted = search.near.facet
    return roots_near(
        ZERO, flat, audit, bounded, NO, unlisted, shot, scene, manifold.roots, manifold.counters
    )


@inlined
def _raised(level, scene):
    """Return a scene whose flat sea has another height."""
    s = scene.surface
    surface = Surface(
        s.vertices, s.faces, s.face_normals, s.vertex_normals, s.low, s.high, s.max_slope,
        s.interpolate, s.roughness, level,
    )  # fmt: skip
    return Scene(
        scene.emitter, scene.target, surface, scene.locator, scene.facets, scene.medium,
        scene.interface, scene.mirrored,
    )  # fmt: skip
