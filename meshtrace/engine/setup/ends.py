"""Sources, receivers and water of a link for forced detection, and its restrictions."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.setup import arrays
from meshtrace.engine.setup.options import Analog, Estimator
from meshtrace.errors import Described, Refused
from meshtrace.kernels.interface import Interface
from meshtrace.kernels.medium import Medium
from meshtrace.kernels.scene import Emitter, Target
from meshtrace.kernels.sources import SourceKind
from meshtrace.kernels.vectors import ORIGIN, Vec3
from meshtrace.link import Link, Receiver, Source, WaterReceiver, WaterSource
from meshtrace.link.link import SAME_SIDE, Direction
from meshtrace.link.receivers import Aperture
from meshtrace.link.sources import AirLamp
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats

ANALOG = 'else estimator="analog"'
"""Advice of a refusal."""
POINTS_ONLY = f"a point source in bottomless water, with these switches of physics; {ANALOG}"
"""Links that chains follow, for a refusal where joined photons do not."""
_NEGLIGIBLE = 1e-7  # light at the reach over that straight above the source
_NARROWEST_ON_ONE_SIDE = 1e-3  # [deg]: no chains are aimed, photons start in any cone
_NARROWEST = 0.1  # [deg], of a lamp: narrower spots are smaller than the parts of a facet
# switches of physics whose form as published makes light differ from light that is reversed
_REVERSIBLE = ("snell", "direction", "fresnel", "free_path", "fov")
# caps where a tangent diverges: a view of almost a hemisphere sees no farther than this
_WIDEST = math.radians(88.0)
_FARTHEST = 200.0  # reach of a view, in the unit of the frame
_NO_LAMP = Emitter(ORIGIN, ORIGIN, kind=int(SourceKind.ISOTROPIC), spread=0.0, norm=0.0)


class Forwards(NamedTuple):
    """Lamps in the air and apertures in the water, turned upside down."""

    emitters: list[Emitter]
    targets: list[Target]
    medium: Medium  # with interchanged indices; its heights are not mirrored


class ForcedLink(NamedTuple):
    """A link as arrays and numbers in its local frame.

    Chains start at the emitters in the water and aim at the targets in the air: sources and
    receivers, or, for light that goes down, receivers and lamps. Of ends on one side emitters are
    the sources and targets the receivers, reached by the mirror of the surface.
    """

    frame: arrays.Frame
    emitters: list[Emitter]
    power: Floats  # (sources,) shares of the power
    targets: list[Target]
    medium: Medium
    interface: Interface
    forwards: Forwards | None  # of light that starts in the air
    direction: Direction  # `Link.direction`
    sizes: tuple[float, ...]  # radius of each emitter, in the unit of the frame
    stands_for: NDArray[np.intp]  # (targets,) the one that stands for each, see `representatives`

    @property
    def down(self) -> bool:
        """Whether the chains run against the light."""
        return self.direction == "down"

    @property
    def reflects(self) -> bool:
        """Whether the ends lie on one side of the surface."""
        return self.direction in SAME_SIDE

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Pairs of an emitter and a target."""
        return list(np.ndindex(len(self.emitters), len(self.targets)))

    def receiver(self, emitter: int, target: int) -> int:
        """Return the receiver of a pair."""
        return emitter if self.down else target

    @property
    def stands_for_receivers(self) -> NDArray[np.intp]:
        """Representative of each receiver, (receivers,)."""
        return np.arange(len(self.emitters)) if self.down else self.stands_for

    def share(self, emitter: int, target: int) -> float:
        """Return the share of the power of the source of a pair."""
        return float(self.power[target if self.down else emitter])

    def by_receiver(self, values: Floats) -> Floats:
        """Return the sum over the sources of values (emitters, targets), by share of the power."""
        return values @ self.power if self.down else self.power @ values


def require_height_field(mesh: TriangleMesh) -> None:
    """Refuse a surface with more than one crossing on a vertical."""
    if not mesh.single_valued:
        overhangs = Described(f"overhangs ({mesh.facing_down} facets face down)")
        raise Refused("sea.mesh", overhangs, f"a height field; overhangs need {ANALOG[5:]}")


def forced_link(link: Link, frame: arrays.Frame | None = None) -> ForcedLink:
    """Return the link as arrays and numbers, in a given frame or the link's.

    Raises
    ------
    Refused
        If the link has a feature that only the analog estimator follows.
    """
    require_followable(link)
    power = np.array([t.power_mw for t in link.transmitters])
    # the sea is not known yet: bubbles are tabulated up to crests of 5 m
    medium = expected_water(link, crest=5.0)
    frame = frame or arrays.frame_of(link)
    low: tuple[Source | Aperture, ...] = link.transmitters
    forwards, water = None, frame.medium(medium)
    if link.direction == "down":
        # chains start in the water, at the receivers, and run against the light: reciprocity of
        # radiance over n^2
        low = link.receivers
    if link.direction in ("down", "over"):
        # unscattered light from the air is followed forwards, with everything upside down
        forwards = Forwards(
            [_mirrored(emitter_of(t, frame), "position") for t in link.transmitters],
            [_mirrored(target_of(r, frame), "center") for r in link.receivers],
            water._replace(n_water=water.n_air, n_air=water.n_water),
        )
    emitters, targets = [emitter_of(end, frame) for end in low], _targets(link, frame)
    return ForcedLink(
        frame=frame,
        emitters=emitters,
        power=power / power.sum(),
        targets=targets,
        medium=water,
        interface=arrays.interface_arrays(link),
        forwards=forwards,
        direction=link.direction,
        sizes=tuple(end.size / frame.unit if isinstance(end, Source) else 0.0 for end in low),
        stands_for=representatives(emitters, targets),
    )


def require_points(link: Link) -> None:
    """Refuse an extended source, whose light joined photons follow but no chains."""
    for path, item in link.items():
        if isinstance(item, Source) and item.size > 0.0:
            raise Refused(path, Described(f"a radius of {item.size:g} m"), POINTS_ONLY)


def _mirrored(end: Any, place: str) -> Any:
    """Return an emitter or target at the opposite height."""
    names = (place, "axis", "e1", "e2")
    turned = {name: getattr(end, name)._replace(z=-getattr(end, name).z) for name in names}
    return end._replace(**turned)


def crossing_reach(link: Link) -> float:
    """Return the largest distance from `Link.origin` of light that crosses to a receiver [m]."""
    require_followable(link)
    frame = arrays.frame_of(link)
    farthest = max(t.reach + math.hypot(t.center.x, t.center.y) for t in _targets(link, frame))
    return frame.unit * farthest


def resolved_reach(link: Link, estimator: Estimator) -> float:
    """Return the distance from `Link.origin` within which an estimator needs the surface [m].

    Photons cross anywhere.
    """
    return math.inf if isinstance(estimator, Analog) else crossing_reach(link)


def _targets(link: Link, frame: arrays.Frame) -> list[Target]:
    """Return the receivers as numbers, with the reach beyond which light is negligible."""
    # the clearest layer: in no water does light reach farther
    water = link.water
    a = water.a if water.layers is None else min(row[1] for row in water.layers)
    if link.direction == "down":
        targets = []
        for lamp in link.transmitters:
            if isinstance(lamp, AirLamp):
                t = lamp_target(lamp, link, frame)
                ways = [_way_of_light(lamp, end, a) for end in link.receivers]
                targets.append(t._replace(reach=min(t.reach, max(ways) / frame.unit)))
        return targets
    # the view of a receiver, or the light of all sources, whichever ends first
    spots = []
    for s in link.transmitters:
        if isinstance(s, WaterSource):
            spots.append((s.position, _lit_radius(s.depth, a) + 4.0 * s.size))
        elif isinstance(s, AirLamp):
            lit = frame.unit * lamp_target(s, link, frame).reach
            spots.append((s.position, lit + 4.0 * s.size))
    targets = []
    for end in link.receivers:
        t = target_of(end, frame)
        farthest = max(math.dist(middle, end.position) + wide for middle, wide in spots)
        targets.append(t._replace(reach=min(t.reach, farthest / frame.unit)))
    return targets


def _way_of_light(lamp: AirLamp, end: Aperture, a: float) -> float:
    """Return the distance from below a lamp beyond which its light to a receiver is negligible [m].

    Beyond it the light on a ring of still water, times exp(-a D) / D^2 with the least distance D
    from the ring to the receiver, is below 1e-7 of the largest.
    """
    height, depth, aside = lamp.height, -end.center[2], math.dist(lamp.position, end.position)
    # radii of rings about the foot of the lamp, 0.7 % apart, up to a thousand sizes of the link
    way = np.geomspace(1e-3, 1e3, 2048) * (height + depth + aside)
    angle = np.arctan2(way, height)
    off = np.maximum(angle - math.radians(lamp.tilt_deg), 0.0)
    # of a ring: intensity, cosine of incidence, 1 / r^2 from the lamp, circumference; logarithms,
    # as products of these underflow
    log_light = np.log(np.maximum(lamp_intensity(lamp, np.cos(off)), 1e-300))
    log_light += np.log(np.cos(angle)) - 2.0 * np.log(np.hypot(way, height)) + np.log(way)
    distance = np.hypot(depth, np.maximum(way - aside, 0.0))
    log_light -= a * distance + 2.0 * np.log(distance)
    seen = np.flatnonzero(log_light > log_light.max() + math.log(_NEGLIGIBLE))
    return float(way[min(seen[-1] + 1, len(way) - 1)])


def _lit_radius(depth: float, a: float) -> float:
    """Return the horizontal distance from a source beyond which its light is negligible [m].

    There exp(-a D) / D^2 has fallen to 1e-7 of its value straight above the source, D the
    distance of the crossing from the source.
    """
    fall = -math.log(_NEGLIGIBLE)
    # without absorption 1 / D^2 alone falls to the limit at the upper end
    low, high = depth, depth * math.exp(0.5 * fall)
    # bisection of a D + 2 ln D, which rises with D; 60 halvings are below rounding
    for _ in range(60):
        way = 0.5 * (low + high)
        if a * (way - depth) + 2.0 * math.log(way / depth) < fall:
            low = way
        else:
            high = way
    return math.sqrt(high**2 - depth**2)


def require_followable(link: Link) -> None:
    """Refuse features that neither chains nor joined photons follow."""
    # the first source and receiver decide for all: one link has one kind of light
    in_air = any(isinstance(t, AirLamp) for t in link.transmitters)
    into_air = any(isinstance(r, Receiver) for r in link.receivers)
    source, source_side = (AirLamp, "air") if in_air else (WaterSource, "water")
    end, end_side = (Receiver, "air") if into_air else (WaterReceiver, "water")
    narrowest = _NARROWEST_ON_ONE_SIDE if in_air == into_air else _NARROWEST
    for path, item in link.items():
        if isinstance(item, source):
            if item.spread_deg < narrowest:
                angle = Described(f"a half-angle of {item.spread_deg:g} deg")
                raise Refused(path, angle, f">= {narrowest:g} deg; {ANALOG}")
        elif isinstance(item, Source):
            raise Refused(path, Described(item.kind), f"a source in the {source_side}; {ANALOG}")
        elif not isinstance(item, end):
            raise Refused(path, Described(item.kind), f"a receiver in the {end_side}; {ANALOG}")
        elif in_air and item.fov_deg < narrowest:
            allowed = f">= {narrowest:g} deg; {ANALOG}"
            raise Refused(f"{path}.fov_deg", item.fov_deg, allowed)
    if not link.receivers:
        raise Refused("receiver", (), "at least one")
    if in_air or not into_air:
        _require_reversible(link)
    if link.planes is not None:
        raise Refused("planes", Described("given"), f"None; {ANALOG}")
    # these forms as published know the coefficients of one depth only
    if link.bubbles is not None or link.water.layers is not None:
        for name, paper in (("absorption", "paper"), ("free_path", "local_c")):
            if getattr(link.physics, name) == paper:
                allowed = f"the physical form in stratified water; {ANALOG}"
                raise Refused(f"physics.{name}", paper, allowed)


def _require_reversible(link: Link) -> None:
    """Refuse forms as published, but for light that leaves the water: they have one direction."""
    default = type(link.physics)()
    physical = {name: getattr(default, name) for name in _REVERSIBLE}
    if link.water.layers is not None:
        physical["absorption"] = default.absorption
    printed = {n: w for n in physical if (w := getattr(link.physics, n)) in ("paper", "paper_both")}
    if link.physics.free_path == "local_c":
        printed["free_path"] = "local_c"
    if link.physics.fov == "paper_position":
        printed["fov"] = "paper_position"
    if printed:
        names = ", ".join(f'{name} = "{word}"' for name, word in printed.items())
        allowed = f"the physical forms: those as published are not reversible; {ANALOG}"
        raise Refused("physics", Described(names), allowed)


def expected_water(link: Link, crest: float) -> Medium:
    """Return the water; the printed Algorithm 1 acts as b -> albedo b (E5)."""
    medium = arrays.medium_arrays(link, crest)
    if link.physics.absorption == "paper":
        medium = medium._replace(b=medium.b * link.water.albedo)
    return medium


def emitter_of(end: Source | Aperture, frame: arrays.Frame = arrays.IDENTITY) -> Emitter:
    """Return a source, or an aperture whose light is reversed, as numbers in a frame."""
    position, disk = _placed(end, frame), across(end.axis)
    if isinstance(end, Aperture):
        axis, radius = Vec3(*(-x for x in end.axis)), end.radius / frame.unit
        half = math.radians(end.fov_deg) / 2.0
        # projected solid angle of the cone of view: int cos dOmega = pi sin^2(half)
        view = math.pi * math.sin(half) ** 2
        power, kind = math.pi * radius**2 * view, int(SourceKind.APERTURE)
        return Emitter(position, axis, kind, half, 1.0 / view, power, radius, *disk)
    kind, spread = arrays.pattern_of(end)
    if kind == SourceKind.LED:
        # I(w) = (m + 1) / (2 pi) cos^m(theta), of unit power
        norm = (spread + 1.0) / (2.0 * math.pi)
    elif kind == SourceKind.GAUSSIAN_BEAM:
        # exp(-2 theta^2 / spread^2), of unit power for small angles
        norm = 2.0 / (math.pi * spread**2)
    elif kind == SourceKind.TOP_HAT_BEAM:
        norm = 1.0 / (2.0 * math.pi * (1.0 - math.cos(spread)))
    else:
        norm = 1.0 / (4.0 * math.pi)
    return Emitter(position, Vec3(*end.axis), kind, spread, norm, 1.0, 0.0, *disk)


def lamp_intensity(lamp: AirLamp, cosine: Floats) -> Floats:
    """Return the intensity of a lamp at the cosine of an angle to its axis [sr-1]."""
    emitter = emitter_of(lamp)
    cosine = np.clip(cosine, 0.0, 1.0)
    if emitter.kind == SourceKind.LED:
        return np.asarray(emitter.norm * cosine**emitter.spread)
    angle = np.arccos(cosine)
    if emitter.kind == SourceKind.GAUSSIAN_BEAM:
        return np.asarray(emitter.norm * np.exp(-2.0 * (angle / emitter.spread) ** 2))
    return np.where(angle <= emitter.spread, emitter.norm, 0.0)


def _placed(end: Source | Aperture, frame: arrays.Frame) -> Vec3:
    """Return the place of an end in a frame."""
    return Vec3(*frame.points(np.array(end.center)).tolist())


@lru_cache
def across(axis: tuple[float, float, float]) -> tuple[Vec3, Vec3]:
    """Return two unit vectors across an axis, which receivers have in common."""
    # from an axis that is far from parallel, whose cross product keeps its digits
    e1 = np.cross(axis, (0.0, 1.0, 0.0) if abs(axis[1]) < 0.9 else (1.0, 0.0, 0.0))
    e1 /= np.linalg.norm(e1)
    return Vec3(*e1.tolist()), Vec3(*np.cross(axis, e1).tolist())


def lamp_target(lamp: AirLamp, link: Link, frame: arrays.Frame = arrays.IDENTITY) -> Target:
    """Return a lamp in the air as the point that chains from the water aim at.

    Its light has fallen to 1e-7 at the largest angle to its axis.
    """
    center = _placed(lamp, frame)
    kind, widest_angle = arrays.pattern_of(lamp)
    # I = I_0 cos^m(theta), or I_0 exp(-2 theta^2 / spread^2), solved for I = 1e-7 I_0
    if kind == SourceKind.LED:
        widest_angle = math.acos(_NEGLIGIBLE ** (1.0 / widest_angle))
    elif kind == SourceKind.GAUSSIAN_BEAM:
        widest_angle *= math.sqrt(-0.5 * math.log(_NEGLIGIBLE))
    widest = min(widest_angle + math.radians(lamp.tilt_deg), _WIDEST)
    return Target(
        center=center,
        axis=Vec3(0.0, 0.0, 1.0),
        e1=Vec3(1.0, 0.0, 0.0),
        e2=Vec3(0.0, 1.0, 0.0),
        # radiance over n^2 is conserved (basic radiance), where an aperture has its area
        area=(link.water.n / link.n_air) ** 2,
        radius=0.0,
        cos_half_fov=max(math.cos(widest_angle), 0.0),
        tan_half_fov=0.0,
        # crossings may lie 2 below still water, in a trough
        reach=min((center.z + 2.0) * math.tan(widest), _FARTHEST),
        sin_widest=math.sin(widest),
        is_lamp=True,
        lamp=emitter_of(lamp, frame),
    )


def target_of(receiver: Any, frame: arrays.Frame = arrays.IDENTITY) -> Target:
    """Return a receiver as numbers, lengths in the unit of a frame."""
    e1, e2 = across(receiver.axis)
    half = math.radians(receiver.fov_deg) / 2.0
    widest = min(half + math.radians(receiver.tilt_deg), _WIDEST)
    center, radius = _placed(receiver, frame), receiver.radius / frame.unit
    return Target(
        center=center,
        axis=Vec3(*receiver.axis),
        e1=e1,
        e2=e2,
        area=math.pi * radius**2,
        radius=radius,
        # exactly 0, so that light along the aperture is inside in spite of rounding
        cos_half_fov=0.0 if half >= math.pi / 2.0 else math.cos(half),
        tan_half_fov=math.tan(min(half, 1.55)),
        reach=min((abs(center.z) + 2.0) * math.tan(widest), _FARTHEST) + 2.0 * radius,
        sin_widest=math.sin(widest),
        is_lamp=False,
        lamp=_NO_LAMP,
    )


_MANY = 64  # targets up to which each stands for itself
_CELL = 0.06  # edge of a neighbourhood over the height of a target above the sources


def representatives(emitters: Sequence[Emitter], targets: Sequence[Target]) -> NDArray[np.intp]:
    """Return the representative of each target.

    Notes
    -----
    Up to 64 targets stand for themselves. Of more, those that differ in their horizontal place
    alone share square cells of 6 % of their height above the highest source: the target nearest to
    the middle of a cell stands for the others in it. Which it is does not depend on the order of
    the targets.
    """
    stands_for = np.arange(len(targets))
    if len(targets) <= _MANY:
        return stands_for
    # from the source a cell of 0.06 heights is seen under 3 deg: one pilot stands for all in it
    alike: dict[Target, list[int]] = defaultdict(list)
    for i, t in enumerate(targets):
        alike[t._replace(center=Vec3(0.0, 0.0, t.center.z), reach=0.0)].append(i)
    level = max(e.position.z for e in emitters)
    for kind, members_of_kind in alike.items():
        # sorted by place: the cells of the same targets in another order are the same
        order = np.array(sorted(members_of_kind, key=lambda i: targets[i].center))
        places = np.array([targets[i].center[:2] for i in order])
        edge = _CELL * (kind.center.z - level)
        cells = np.floor((places - places.min(axis=0)) / edge)
        _, cell, size = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
        for members in np.split(np.argsort(cell.ravel(), kind="stable"), np.cumsum(size)[:-1]):
            middle = 0.5 * (places[members].min(axis=0) + places[members].max(axis=0))
            square = np.square(places[members] - middle).sum(axis=1)
            stands_for[order[members]] = order[members[np.argmin(square)]]
    return stands_for
