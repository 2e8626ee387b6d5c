"""Sources, receivers and water of a link for forced detection, and its restrictions."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.errors import Described, Refused
from meshtrace.kernels.interface import Interface
from meshtrace.kernels.medium import Medium
from meshtrace.kernels.scene import Emitter, Target
from meshtrace.kernels.sources import SourceKind
from meshtrace.kernels.vectors import Vec3
from meshtrace.link import GaussianBeam, Led, Link, Receiver, Source, TopHatBeam, WaterSource
from meshtrace.mesh import TriangleMesh
from meshtrace.transport.arrays import interface_arrays, medium_arrays
from meshtrace.transport.frame import IDENTITY, Frame, frame_of

ANALOG = 'else estimator="analog"'
"""Advice of a refusal."""
_NEGLIGIBLE = 1e-7  # light at the reach over that straight above the source
_NARROWEST = 0.1  # [deg], of a lamp: narrower spots are smaller than the parts of a facet


class ForcedLink(NamedTuple):
    """A link as arrays and numbers in its local frame."""

    frame: Frame
    emitters: list[Emitter]
    power: NDArray[np.float64]  # (emitters,) shares of the power
    targets: list[Target]
    medium: Medium
    interface: Interface
    sizes: tuple[float, ...]  # radius of each source, in the unit of the frame


def require_height_field(mesh: TriangleMesh) -> None:
    """Refuse a surface with more than one crossing on a vertical."""
    if not mesh.single_valued:
        found = Described(f"overhangs ({mesh.facing_down} facets face down)")
        raise Refused("sea.mesh", found, f"a height field; overhangs need {ANALOG[5:]}")


def forced_link(link: Link) -> ForcedLink:
    """Return the link as arrays and numbers.

    Raises
    ------
    Refused
        If the link has a feature that only the analog estimator follows.
    """
    require_followable(link)
    power = np.array([t.power_mw for t in link.transmitters])
    medium = expected_water(link, crest=5.0)
    frame = frame_of(link)
    sources = [t for t in link.transmitters if isinstance(t, WaterSource)]
    return ForcedLink(
        frame,
        [emitter_of(t, frame) for t in sources],
        power / power.sum(),
        _targets(link, frame),
        frame.medium(medium),
        interface_arrays(link),
        tuple(t.size / frame.unit for t in sources),
    )


def needs_paths(link: Link) -> tuple[str, object] | None:
    """Return the field and value that chains do not follow, but adjoint paths do; None if none."""
    for path, item in link.items():
        if isinstance(item, WaterSource) and item.size > 0.0:
            return path, Described(f"a radius of {item.size:g} m")
    if link.water.bottom_depth is not None:
        return "water.bottom_depth", link.water.bottom_depth
    return None


def crossing_reach(link: Link) -> float:
    """Return the largest distance from `Link.origin` of light that crosses to a receiver [m]."""
    require_followable(link)
    frame = frame_of(link)
    farthest = max(t.reach + math.hypot(t.center.x, t.center.y) for t in _targets(link, frame))
    return frame.unit * farthest


def _targets(link: Link, frame: Frame) -> list[Target]:
    """Return the receivers as numbers, with the reach beyond which light is negligible."""
    water = link.water
    a = water.a if water.layers is None else min(row[1] for row in water.layers)
    targets = []
    for r in link.receivers:
        if isinstance(r, Receiver):
            t = target_of(r, frame)
            lit = [
                math.dist(s.position, r.position) + _lit_radius(s.depth, a) + 4.0 * s.size
                for s in link.transmitters
                if isinstance(s, WaterSource)
            ]
            targets.append(t._replace(reach=min(t.reach, max(lit) / frame.unit)))
    return targets


def _lit_radius(depth: float, a: float) -> float:
    """Return the horizontal distance from a source beyond which its light is negligible [m].

    There exp(-a D) / D^2 has fallen to 1e-7 of its value straight above the source, D the
    distance of the crossing from the source.
    """
    fall = -math.log(_NEGLIGIBLE)
    low, high = depth, depth * math.exp(0.5 * fall)
    for _ in range(60):
        way = 0.5 * (low + high)
        if a * (way - depth) + 2.0 * math.log(way / depth) < fall:
            low = way
        else:
            high = way
    return math.sqrt(high**2 - depth**2)


def require_followable(link: Link) -> None:
    """Refuse what neither chains nor adjoint paths follow."""
    for path, item in link.items():
        if isinstance(item, WaterSource):
            if item.spread_deg < _NARROWEST:
                angle = Described(f"a half-angle of {item.spread_deg:g} deg")
                raise Refused(path, angle, f">= {_NARROWEST:g} deg; {ANALOG}")
        elif isinstance(item, Source):
            raise Refused(path, Described(item.kind), f"a source in the water; {ANALOG}")
        elif not isinstance(item, Receiver):
            raise Refused(path, Described(item.kind), f"a receiver in the air; {ANALOG}")
    if not link.receivers:
        raise Refused("receiver", (), "at least one")
    if link.planes is not None:
        raise Refused("planes", Described("given"), f"None; {ANALOG}")
    if link.bubbles is not None or link.water.layers is not None:
        for name, paper in (("absorption", "paper"), ("free_path", "local_c")):
            if getattr(link.physics, name) == paper:
                allowed = f"the physical form in stratified water; {ANALOG}"
                raise Refused(f"physics.{name}", paper, allowed)


def expected_water(link: Link, crest: float) -> Medium:
    """Return the water; the printed Algorithm 1 acts as b -> albedo b (E5)."""
    medium = medium_arrays(link, crest)
    if link.physics.absorption == "paper":
        medium = medium._replace(b=medium.b * link.water.albedo)
    return medium


def emitter_of(source: WaterSource, frame: Frame = IDENTITY) -> Emitter:
    """Return a source as numbers, lengths in the unit of a frame."""
    if isinstance(source, Led):
        kind, spread = SourceKind.LED, source.order
        norm = (spread + 1.0) / (2.0 * math.pi)
    elif isinstance(source, GaussianBeam):
        kind, spread = SourceKind.GAUSSIAN_BEAM, math.radians(source.divergence_deg)
        norm = 2.0 / (math.pi * spread**2)
    elif isinstance(source, TopHatBeam):
        kind, spread = SourceKind.TOP_HAT_BEAM, math.radians(source.divergence_deg)
        norm = 1.0 / (2.0 * math.pi * (1.0 - math.cos(spread)))
    else:
        kind, spread, norm = SourceKind.ISOTROPIC, 0.0, 1.0 / (4.0 * math.pi)
    position = Vec3(*frame.points(np.array([*source.position, -source.depth])).tolist())
    return Emitter(position, Vec3(*source.axis), int(kind), float(spread), norm)


def target_of(receiver: Receiver, frame: Frame = IDENTITY) -> Target:
    """Return a receiver as numbers, lengths in the unit of a frame."""
    axis = np.array(receiver.axis)
    e1 = np.cross(axis, (0.0, 1.0, 0.0) if abs(axis[1]) < 0.9 else (1.0, 0.0, 0.0))
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(axis, e1)
    half = math.radians(receiver.fov_deg) / 2.0
    widest = min(half + math.radians(receiver.tilt_deg), math.radians(88.0))
    center = Vec3(*frame.points(np.array(receiver.center)).tolist())
    radius = receiver.radius / frame.unit
    return Target(
        center=center,
        axis=Vec3(*receiver.axis),
        e1=Vec3(*e1.tolist()),
        e2=Vec3(*e2.tolist()),
        radius=radius,
        cos_half_fov=0.0 if half >= math.pi / 2.0 else math.cos(half),
        tan_half_fov=math.tan(min(half, 1.55)),
        reach=min((center.z + 2.0) * math.tan(widest), 200.0) + 2.0 * radius,
        sin_widest=math.sin(widest),
    )
