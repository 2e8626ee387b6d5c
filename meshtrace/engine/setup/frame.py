"""Local coordinates of a link: its own origin and unit of length.

Tolerances of the kernels and single precision of Embree suit lengths of some metres near the
origin. A tank of 10 cm and a link far from the origin are mapped to it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from meshtrace.errors import Described, Refused
from meshtrace.kernels.medium import Medium
from meshtrace.kernels.sources import Sources
from meshtrace.kernels.tally import Apertures
from meshtrace.link import Link
from meshtrace.mesh import FARTHEST, TriangleMesh
from meshtrace.models import Floats

# fields of a medium without a raster
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
        local = self.points(mesh.vertices)
        largest = float(np.abs(local).max())
        if largest > FARTHEST:
            far = Described(f"reaches {self.unit * largest:.3g} m from the link")
            raise Refused("mesh", far, f"at most {self.unit * FARTHEST:.3g} m for its size")
        return replace(mesh, vertices=local)

    def sources(self, sources: Sources) -> Sources:
        """Return sources in local coordinates."""
        return sources._replace(
            position=self.points(sources.position), size=sources.size / self.unit
        )

    def apertures(self, apertures: Apertures) -> Apertures:
        """Return apertures in local coordinates."""
        return apertures._replace(
            center=self.points(apertures.center), radius=apertures.radius / self.unit
        )

    def medium(self, medium: Medium) -> Medium:
        """Return water without a raster with coefficients per unit of length."""
        if self == IDENTITY:
            return medium
        scaled = {name: getattr(medium, name) * self.unit for name in _PER_LENGTH}
        lengths = {name: getattr(medium, name) / self.unit for name in _LENGTHS}
        return medium._replace(**scaled, **lengths)


IDENTITY = Frame(0.0, 0.0, 1.0)


def frame_of(link: Link) -> Frame:
    """Return the local frame of a link; the identity for links of ordinary size near the origin."""
    return Frame(*link.origin, link.unit)
