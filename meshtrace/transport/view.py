"""View of a receiver: points of its disk and directions inside its field of view."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from meshtrace.errors import Described, Refused
from meshtrace.link import Link
from meshtrace.link.receivers import Aperture
from meshtrace.models import Floats
from meshtrace.stored import SHIFTS
from meshtrace.transport.frame import Frame


class View(NamedTuple):
    """Receiver in local coordinates: disk, line of sight, field of view, and its points."""

    center: Floats
    axis: Floats  # line of sight, from the receiver
    radius: float
    sin2_psi: float  # of half the field of view
    uniforms: Floats  # (rays, 7): disk, cone, tilt of the first reflection

    @classmethod
    def of(cls, aperture: Aperture, frame: Frame, uniforms: Floats) -> View:
        """Return the view of an aperture in the coordinates of a frame."""
        psi = math.radians(0.5 * aperture.fov_deg)
        axis, center = -np.array(aperture.axis), frame.points(np.array(aperture.center))
        return cls(center, axis, aperture.radius / frame.unit, math.sin(psi) ** 2, uniforms)

    def origins(self) -> Floats:
        """Return points on the disk (rays, 3)."""
        r, phi = self.radius * np.sqrt(self.uniforms[:, 0]), 2 * math.pi * self.uniforms[:, 1]
        e1, e2 = _across(self.axis)
        return self.center + np.outer(r * np.cos(phi), e1) + np.outer(r * np.sin(phi), e2)

    def directions(self) -> Floats:
        """Return directions (rays, 3) by the cosine law inside the field of view."""
        return cone(self.axis, self.sin2_psi * self.uniforms[:, 2], self.uniforms[:, 3])

    def accepted(self, directions: Floats) -> Floats:
        """Return cosines at the disk (rays,) of directions from it; 0 outside of the view."""
        cosine = directions @ self.axis
        return np.where((cosine > 0.0) & (1.0 - cosine**2 <= self.sin2_psi), cosine, 0.0)

    def share_of_disk(self, towards: Floats, radius: float) -> float:
        """Return the share of a disk of small angular radius [rad] that lies in a wider view.

        That of two circles in a plane: (r^2 a + R^2 b - d r sin a) / (pi r^2) with the angles a
        and b that half of their common chord spans from either centre.
        """
        psi = math.asin(math.sqrt(self.sin2_psi))
        apart = math.acos(max(-1.0, min(1.0, float(towards @ self.axis))))
        if apart >= psi + radius:
            return 0.0
        if apart <= psi - radius:
            return 1.0
        a = math.acos((apart**2 + radius**2 - psi**2) / (2.0 * apart * radius))
        b = math.acos((apart**2 + psi**2 - radius**2) / (2.0 * apart * psi))
        common = radius**2 * a + psi**2 * b - apart * radius * math.sin(a)
        return common / (math.pi * radius**2)


def cone(axis: Floats, sin2: Floats, u_phi: Floats) -> Floats:
    """Return directions (n, 3) at squared sines sin2 and azimuths 2 pi u_phi about an axis."""
    s, phi = np.sqrt(sin2), 2.0 * math.pi * u_phi
    e1, e2 = _across(axis)
    out = np.outer(s * np.cos(phi), e1) + np.outer(s * np.sin(phi), e2)
    return out + np.outer(np.sqrt(1.0 - sin2), axis)


def _across(axis: Floats) -> tuple[Floats, Floats]:
    """Return two unit vectors across an axis and each other."""
    aside = np.eye(3)[int(np.argmin(np.abs(axis)))]
    e1 = np.cross(axis, aside)
    e1 /= np.linalg.norm(e1)
    return e1, np.cross(axis, e1)


def only_aperture(link: Link) -> Aperture:
    """Return the aperture of a link that has one, or refuse."""
    if len(link.receivers) != 1:
        raise Refused("receiver", Described(f"{len(link.receivers)} apertures"), "one aperture")
    return link.receivers[0]


def shifted_points(points: int, width: int, seed: int) -> Floats:
    """Return some Sobol points (points, width), each of the 32 shifts together."""
    per_shift = points // SHIFTS
    from scipy.stats import qmc

    rng = np.random.default_rng((seed, 19))
    size = math.ceil(math.log2(max(per_shift, 2)))
    sobol = qmc.Sobol(width, scramble=True, rng=rng).random_base2(size)[:per_shift]
    u = (sobol[None] + rng.random((SHIFTS, 1, width))) % 1.0
    return np.clip(u.reshape(-1, width), 1e-12, 1.0 - 1e-12)
