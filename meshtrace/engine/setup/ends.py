"""Conversion of a link's sources, receivers and water to numbers, for forced detection.

Forced detection aims light at the receivers: by chains of scatterings (`engine.chains`) or by
photons joined to the targets (`engine.photons`). Links that it cannot follow are refused here.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshtrace.engine.setup import arrays
from meshtrace.engine.setup.bodies import BodyScene, scene_of
from meshtrace.engine.setup.options import Analog, Estimator
from meshtrace.errors import Described, Refused
from meshtrace.kernels.interface import Interface
from meshtrace.kernels.medium import Medium
from meshtrace.kernels.scene import Emitter, Target
from meshtrace.kernels.sources import SourceKind
from meshtrace.kernels.vectors import ORIGIN, Vec3
from meshtrace.link import Body, Link, Receiver, Source, WaterReceiver, WaterSource
from meshtrace.link.link import SAME_SIDE, Direction
from meshtrace.link.receivers import Aperture
from meshtrace.link.sources import AirLamp, AirMeasuredLamp, MeasuredLamp
from meshtrace.mesh import TriangleMesh
from meshtrace.models import Floats

ANALOG = 'else estimator="analog"'
"""End of the text of a refusal: the estimator that follows every link."""
POINTS_ONLY = f"a point source in bottomless water, with these switches of physics; {ANALOG}"
"""Allowed links, in a refusal where joined photons cannot stand in for chains."""
_NEGLIGIBLE = 1e-7  # light at the reach, relative to the brightest: what lies beyond is left out
# smallest half-angle of a source, or view of an underwater receiver, [deg]: narrower spots are
# smaller than the parts into which facets are cut for the integral of unscattered light
_NARROWEST = 0.1
# the same of links on one side, where photons start in any cone and no chains are aimed
_NARROWEST_ON_ONE_SIDE = 1e-3
# switches whose published form has no reciprocity: a path and its reverse carry different light
_REVERSIBLE = ("snell", "direction", "fresnel", "free_path", "fov")
# tan(widest angle) diverges for views of a hemisphere: tuned caps of angle and reach
_WIDEST = math.radians(88.0)
_FARTHEST = 200.0  # in the unit of the frame; a link is up to some 16 units high
# placeholder in the field `lamp` of apertures, which kernels do not read
_NO_LAMP = Emitter(ORIGIN, ORIGIN, kind=int(SourceKind.ISOTROPIC), spread=0.0, norm=0.0)


class ForcedLink(NamedTuple):
    """A link as arrays and numbers in its local frame.

    Chains start at the emitters in the water and aim at the targets in the air: sources and
    receivers, or, for light that goes down, receivers and lamps. Of ends on one side emitters are
    the sources and targets the receivers, reached by the mirror of the surface.
    """

    frame: arrays.Frame
    emitters: list[Emitter]
    power: Floats  # (sources,) share of the total power, sums to 1
    targets: list[Target]
    medium: Medium
    interface: Interface
    # Of light that starts in the air, in its direction and upside down: the lamps as emitters, the
    # apertures as targets, indices interchanged. Kernels of unscattered light expect the emitter
    # below the surface (`kernels.scene.Scene`).
    forwards: ForcedLink | None
    direction: Direction  # `Link.direction`
    sizes: tuple[float, ...]  # (emitters,) `Source.size` in the unit of the frame, 0 for receivers
    stands_for: NDArray[np.intp]  # (targets,) index of the representative, see `representatives`
    bodies: BodyScene | None  # the right way up, for light that starts in the air too

    @property
    def down(self) -> bool:
        """Whether this is a downlink: chains run against the light, from receivers to lamps."""
        return self.direction == "down"

    @property
    def reflects(self) -> bool:
        """Whether the ends lie on one side of the surface."""
        return self.direction in SAME_SIDE

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """All pairs of indices (emitter, target)."""
        return list(np.ndindex(len(self.emitters), len(self.targets)))

    def receiver(self, emitter: int, target: int) -> int:
        """Return the index of the receiver of a pair."""
        return emitter if self.down else target

    def lamp(self, emitter: int, target: int) -> int:
        """Return the position of the source in a pair of indices."""
        return target if self.down else emitter

    @property
    def stands_for_receivers(self) -> NDArray[np.intp]:
        """Index of the representative of each receiver, (receivers,): itself in a downlink."""
        return np.arange(len(self.emitters)) if self.down else self.stands_for

    def share(self, emitter: int, target: int) -> float:
        """Return the share of the total power that the source of a pair emits."""
        return float(self.power[self.lamp(emitter, target)])

    def by_receiver(self, values: Floats) -> Floats:
        """Return (receivers,) sums of values (emitters, targets), weighted by the power shares."""
        return values @ self.power if self.down else self.power @ values


def require_height_field(mesh: TriangleMesh) -> None:
    """Refuse a surface with more than one crossing on a vertical."""
    if not mesh.single_valued:
        overhangs = Described(f"overhangs ({mesh.facing_down} facets face down)")
        # [5:] leaves out "else "
        raise Refused("sea.mesh", overhangs, f"a height field; overhangs need {ANALOG[5:]}")


def forced_link(link: Link, frame: arrays.Frame | None = None) -> ForcedLink:
    """Convert a link to arrays and numbers, in the given local frame or the link's.

    Raises
    ------
    Refused
        If the link has a feature that only the analog estimator follows.
    """
    require_followable(link)
    power = np.array([t.power_mw for t in link.transmitters])
    # the sea is not known yet; tuned: bubbles are tabulated up to crests of 5 m
    medium = expected_water(link, crest=5.0)
    frame = frame or arrays.frame_of(link)
    low: tuple[Source | Aperture, ...] = link.transmitters
    water = frame.medium(medium)
    if link.direction == "down":
        # Chains start in the water, at the receivers, and run against the light: reciprocity
        # conserves radiance over n^2 (docs/downlink.md).
        low = link.receivers
    emitters, targets = [emitter_of(end, frame) for end in low], _targets(link, frame)
    forced = ForcedLink(
        frame=frame,
        emitters=emitters,
        power=power / power.sum(),
        targets=targets,
        medium=water,
        interface=arrays.interface_arrays(link),
        forwards=None,
        direction=link.direction,
        sizes=tuple(end.size / frame.unit if isinstance(end, Source) else 0.0 for end in low),
        stands_for=representatives(emitters, targets),
        bodies=scene_of(link, frame),
    )
    if link.direction not in ("down", "over"):
        return forced
    # unscattered light from the air is followed forwards; depths of layers stay as they are
    upside_down = forced._replace(
        emitters=[_mirrored(emitter_of(t, frame)) for t in link.transmitters],
        targets=[_mirrored(target_of(r, frame)) for r in link.receivers],
        medium=water._replace(n_water=water.n_air, n_air=water.n_water),
    )
    return forced._replace(forwards=upside_down)


def require_chains(link: Link) -> None:
    """Refuse links that only joined photons follow: `Link.require_chains`, wide lamps."""
    link.require_chains()
    for path, item in link.items():
        if isinstance(item, Source) and item.size > 0.0:
            raise Refused(path, Described(f"a radius of {item.size:g} m"), POINTS_ONLY)


def _mirrored(end: Any) -> Any:
    """Return an emitter or target mirrored at still water, z -> -z."""
    return end._make(item._replace(z=-item.z) if isinstance(item, Vec3) else item for item in end)


def crossing_reach(link: Link) -> float:
    """Return the largest horizontal distance from `Link.origin` of a relevant crossing [m]."""
    require_followable(link)
    frame = arrays.frame_of(link)
    farthest = max(t.reach + math.hypot(t.center.x, t.center.y) for t in _targets(link, frame))
    return frame.unit * farthest


def resolved_reach(link: Link, estimator: Estimator) -> float:
    """Return the distance from `Link.origin` within which an estimator needs the surface [m].

    Infinite for analog photons, which may cross anywhere.
    """
    return math.inf if isinstance(estimator, Analog) else crossing_reach(link)


def _targets(link: Link, frame: arrays.Frame) -> list[Target]:
    """Return the ends that light is aimed at, with the reach beyond which light is negligible."""
    # absorption of the clearest layer bounds the reach from above
    water = link.water
    a = water.a if water.layers is None else min(row[1] for row in water.layers)
    if link.direction == "down":
        targets = []
        for lamp in link.transmitters:
            if isinstance(lamp, AirLamp):
                target = lamp_target(lamp, link, frame)
                radii = [_lamp_reach(lamp, end, a) for end in link.receivers]
                targets.append(target._replace(reach=min(target.reach, max(radii) / frame.unit)))
        return targets
    # the view of a receiver, or the light of all sources, whichever ends first;
    # 4 waists of a Gaussian: the light outside is exp(-32)
    spots = []
    for s in link.transmitters:
        if isinstance(s, WaterSource):
            spots.append((s.position, _source_reach(s.depth, a) + 4.0 * s.size))
        elif isinstance(s, AirLamp):
            reach = frame.unit * lamp_target(s, link, frame).reach
            spots.append((s.position, reach + 4.0 * s.size))
    targets = []
    for end in link.receivers:
        target = target_of(end, frame)
        farthest = max(math.dist(middle, end.position) + radius for middle, radius in spots)
        targets.append(target._replace(reach=min(target.reach, farthest / frame.unit)))
    return targets


def _lamp_reach(lamp: AirLamp, end: Aperture, a: float) -> float:
    """Return the distance from a lamp's foot beyond which its light to a receiver is negligible.

    Horizontal [m]. Beyond it the light on a ring of still water, times exp(-a D) / D^2 with the
    least distance D from the ring to the receiver, is below 1e-7 of the largest. `a` is the
    absorption [m-1]; the foot is the point straight below the lamp.
    """
    height, depth, aside = lamp.height, -end.center[2], math.dist(lamp.position, end.position)
    # radii of rings about the foot, 0.7 % apart, from a thousandth to a thousand sizes of the link
    ring = np.geomspace(1e-3, 1e3, 2048) * (height + depth + aside)
    nadir_angle = np.arctan2(ring, height)
    # least angle to the axis on the ring: where it lies towards the tilt
    off_axis = np.maximum(nadir_angle - math.radians(lamp.tilt_deg), 0.0)
    # light on a ring ~ intensity x cosine of incidence / distance^2 from the lamp x radius of the
    # ring (its circumference); as a logarithm, since the product underflows
    log_flux = np.log(np.maximum(lamp_intensity(lamp, np.cos(off_axis)), 1e-300))
    log_flux += np.log(np.cos(nadir_angle)) - 2.0 * np.log(np.hypot(ring, height)) + np.log(ring)
    distance = np.hypot(depth, np.maximum(ring - aside, 0.0))
    log_flux -= a * distance + 2.0 * np.log(distance)
    seen = np.flatnonzero(log_flux > log_flux.max() + math.log(_NEGLIGIBLE))
    return float(ring[min(seen[-1] + 1, len(ring) - 1)])


def _source_reach(depth: float, a: float) -> float:
    """Return the horizontal distance from a source beyond which its light is negligible [m].

    There exp(-a D) / D^2 has fallen to 1e-7 of its value straight above the source, D the
    distance of the crossing from the source and `a` the absorption [m-1].
    """
    fall = -math.log(_NEGLIGIBLE)
    # without absorption 1 / D^2 alone falls to the limit at the upper end
    low, high = depth, depth * math.exp(0.5 * fall)
    # bisection of a D + 2 ln D, which rises with D; 60 halvings reach the last digit
    for _ in range(60):
        distance = 0.5 * (low + high)
        if a * (distance - depth) + 2.0 * math.log(distance / depth) < fall:
            low = distance
        else:
            high = distance
    return math.sqrt(high**2 - depth**2)


def require_followable(link: Link) -> None:
    """Refuse features that neither chains nor joined photons follow."""
    require_followed_bodies(link)
    # the first source and receiver decide for all: one link has one kind of light
    in_air = any(isinstance(t, AirLamp) for t in link.transmitters)
    into_air = any(isinstance(r, Receiver) for r in link.receivers)
    source_type, source_side = (AirLamp, "air") if in_air else (WaterSource, "water")
    receiver_type, end_side = (Receiver, "air") if into_air else (WaterReceiver, "water")
    narrowest = _NARROWEST_ON_ONE_SIDE if in_air == into_air else _NARROWEST
    for path, item in link.items():
        if isinstance(item, source_type):
            if item.spread_deg < narrowest:
                angle = Described(f"a half-angle of {item.spread_deg:g} deg")
                raise Refused(path, angle, f">= {narrowest:g} deg; {ANALOG}")
        elif isinstance(item, Source):
            raise Refused(path, Described(item.kind), f"a source in the {source_side}; {ANALOG}")
        elif not isinstance(item, receiver_type):
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
    # as published, these two take the coefficients at one depth for the whole path
    if link.bubbles is not None or link.water.layers is not None:
        for name, paper in (("absorption", "paper"), ("free_path", "local_c")):
            if getattr(link.physics, name) == paper:
                allowed = f"the physical form in stratified water; {ANALOG}"
                raise Refused(f"physics.{name}", paper, allowed)


def require_followed_bodies(link: Link, trough: float = 0.0, rough: bool = True) -> None:
    """Refuse bodies that reflect light which no joined photon follows.

    `trough` is the height of the lowest trough [m], `rough` whether the sea has random slopes.
    """
    for i, body in enumerate(link.bodies):
        if not body.albedo_at(link.transmitters[0].wavelength_nm) > 0.0:
            continue
        path = f"objects[{i}]" if i < len(link.objects) else "water.bottom"
        # photons are joined to ends in the air, and do not go on there
        top = _top_of(body)
        if top > trough:
            height = Described(f"a body that reflects, up to z = {top:.4g} m")
            allowed = f"below the lowest trough, z = {trough:.4g} m, or black; {ANALOG}"
            raise Refused(path, height, allowed)
        # a photon that runs backwards cannot hit the point that a lamp is
        if body.reflection == "mirror" and not rough and link.direction == "down":
            allowed = f"Lambertian or black below smooth waves and a lamp in the air; {ANALOG}"
            raise Refused(f"{path}.reflection", "mirror", allowed)


@lru_cache(maxsize=64)
def _top_of(body: Body) -> float:
    """Return the height of the highest corner of a body [m]."""
    return float(body.triangles()[0][:, 2].max())


def _require_reversible(link: Link) -> None:
    """Refuse published forms that break reciprocity or hold only for light out of the water.

    Chains of a downlink run against the light; links on one side have no published forms.
    """
    default = type(link.physics)()
    physical = {name: getattr(default, name) for name in _REVERSIBLE}
    # in uniform water the published absorption is a factor of b, the same both ways
    if link.water.layers is not None:
        physical["absorption"] = default.absorption
    # "paper_both" is a value of `fresnel`
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
    """Return the water with the scattering that gives the expected weight of a photon.

    The published Algorithm 1 scatters with the probability of the albedo and also weights by it:
    on average b -> albedo b, with the same absorption (E5 of docs/paper.md). `crest` is that of
    `arrays.medium_arrays` [m].
    """
    medium = arrays.medium_arrays(link, crest)
    if link.physics.absorption == "paper":
        medium = medium._replace(b=medium.b * link.water.albedo)
    return medium


def emitter_of(end: Source | Aperture, frame: arrays.Frame = arrays.IDENTITY) -> Emitter:
    """Convert a source, or an aperture that emits reversed light, to numbers in a frame."""
    position, disk = _placed(end, frame), across(end.axis)
    if isinstance(end, Aperture):
        axis, radius = Vec3(*(-x for x in end.axis)), end.radius / frame.unit
        half = math.radians(end.fov_deg) / 2.0
        # projected solid angle of the cone of view: int cos dOmega = pi sin^2(half)
        view = math.pi * math.sin(half) ** 2
        # the etendue stands for the power, see `Emitter`
        power, kind = math.pi * radius**2 * view, int(SourceKind.APERTURE)
        return Emitter(position, axis, kind, half, 1.0 / view, power, radius, *disk)
    kind, spread = arrays.pattern_of(end)
    # norm: intensity on the axis of a source of unit power [sr-1]
    if kind == SourceKind.LED:
        # I = (m + 1) / (2 pi) cos^m(theta), m the spread
        norm = (spread + 1.0) / (2.0 * math.pi)
    elif kind == SourceKind.GAUSSIAN_BEAM:
        # I = norm exp(-2 theta^2 / spread^2); unit power in the limit of small angles
        norm = 2.0 / (math.pi * spread**2)
    elif kind == SourceKind.TOP_HAT_BEAM:
        # one over the solid angle of the cone
        norm = 1.0 / (2.0 * math.pi * (1.0 - math.cos(spread)))
    elif isinstance(end, MeasuredLamp | AirMeasuredLamp):
        disk = Vec3(*end.sides[0].tolist()), Vec3(*end.sides[1].tolist())
        norm = 1.0  # the table has all
    else:
        norm = 1.0 / (4.0 * math.pi)
    table = arrays.table_of(end)
    return Emitter(position, Vec3(*end.axis), kind, spread, norm, 1.0, 0.0, *disk, table)


def lamp_intensity(lamp: AirLamp, cosine: Floats) -> Floats:
    """Return the intensity of a lamp of unit power at cosines of the angle to its axis [sr-1].

    Of a measured lamp the largest over the azimuth and all larger angles.
    """
    emitter = emitter_of(lamp)
    if isinstance(lamp, AirMeasuredLamp):
        return np.asarray(
            np.interp(np.arccos(np.clip(cosine, -1.0, 1.0)), *lamp.photometry.envelope, right=0.0)
        )
    cosine = np.clip(cosine, 0.0, 1.0)
    if emitter.kind == SourceKind.LED:
        return np.asarray(emitter.norm * cosine**emitter.spread)
    angle = np.arccos(cosine)
    if emitter.kind == SourceKind.GAUSSIAN_BEAM:
        return np.asarray(emitter.norm * np.exp(-2.0 * (angle / emitter.spread) ** 2))
    return np.where(angle <= emitter.spread, emitter.norm, 0.0)


def _placed(end: Source | Aperture, frame: arrays.Frame) -> Vec3:
    """Return the centre of a source or receiver in a frame."""
    return Vec3(*frame.points(np.array(end.center)).tolist())


@lru_cache
def across(axis: tuple[float, float, float]) -> tuple[Vec3, Vec3]:
    """Return two perpendicular unit vectors across an axis, from a cache: receivers share axes."""
    # cross product with y, or with x where the axis is nearly parallel to y and digits would cancel
    e1 = np.cross(axis, (0.0, 1.0, 0.0) if abs(axis[1]) < 0.9 else (1.0, 0.0, 0.0))
    e1 /= np.linalg.norm(e1)
    return Vec3(*e1.tolist()), Vec3(*np.cross(axis, e1).tolist())


def lamp_target(lamp: AirLamp, link: Link, frame: arrays.Frame = arrays.IDENTITY) -> Target:
    """Return a lamp in the air as the point target of chains from the water.

    Its field of view ends where the intensity has fallen to 1e-7 of that on the axis.
    """
    center = _placed(lamp, frame)
    # the spread: the widest angle of a top hat, the order of an LED, the 1/e^2 angle of a Gaussian
    kind, widest_angle = arrays.pattern_of(lamp)
    # I = I_0 cos^m(theta), or I_0 exp(-2 theta^2 / spread^2), solved for I = 1e-7 I_0
    if kind == SourceKind.LED:
        widest_angle = math.acos(_NEGLIGIBLE ** (1.0 / widest_angle))
    elif kind == SourceKind.GAUSSIAN_BEAM:
        widest_angle *= math.sqrt(-0.5 * math.log(_NEGLIGIBLE))
    elif isinstance(lamp, AirMeasuredLamp):
        theta, highest = lamp.photometry.envelope
        widest_angle = float(theta[highest >= _NEGLIGIBLE * highest[0]][-1])
    widest = min(widest_angle + math.radians(lamp.tilt_deg), _WIDEST)
    return Target(
        center=center,
        axis=Vec3(0.0, 0.0, 1.0),
        e1=Vec3(1.0, 0.0, 0.0),
        e2=Vec3(0.0, 1.0, 0.0),
        # radiance over n^2 (basic radiance) is conserved: this factor takes the place of an area
        area=(link.water.n / link.n_air) ** 2,
        radius=0.0,
        cos_half_fov=max(math.cos(widest_angle), 0.0),
        tan_half_fov=0.0,
        # + 2.0: crossings may lie 2 units of the frame below still water, in a trough
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
        # exactly 0 for a hemisphere: light that grazes the aperture is inside despite rounding
        cos_half_fov=0.0 if half >= math.pi / 2.0 else math.cos(half),
        tan_half_fov=math.tan(min(half, 1.55)),  # capped at 88.8 deg: finite for a hemisphere
        # + 2.0: a trough, as in `lamp_target`; the disk adds its radius, and again as a margin
        reach=min((abs(center.z) + 2.0) * math.tan(widest), _FARTHEST) + 2.0 * radius,
        sin_widest=math.sin(widest),
        is_lamp=False,
        lamp=_NO_LAMP,
    )


_MANY = 64  # targets up to which each stands for itself
_CELL = 0.06  # edge of a cell, relative to the height of its targets above the highest source


def representatives(emitters: Sequence[Emitter], targets: Sequence[Target]) -> NDArray[np.intp]:
    """Return the index of the representative of each target, (targets,).

    Pilot runs and crossings of still water are those of the representatives alone.

    Notes
    -----
    Up to 64 targets represent themselves. Among more, targets that differ only in their horizontal
    position are grouped into square cells, with an edge of 6 % of their height above the highest
    source: the target nearest to the middle of a cell represents the others. The choice does not
    depend on the order of the targets.
    """
    stands_for = np.arange(len(targets))
    if len(targets) <= _MANY:
        return stands_for
    # seen from the source a cell subtends 3 deg, so that one pilot run represents all in it
    # the reach, too, depends on the position
    alike: dict[Target, list[int]] = defaultdict(list)
    for i, t in enumerate(targets):
        alike[t._replace(center=Vec3(0.0, 0.0, t.center.z), reach=0.0)].append(i)
    highest_source = max(e.position.z for e in emitters)
    for template, members_of_kind in alike.items():
        # sorted by place: the cells of the same targets in another order are the same
        order = np.array(sorted(members_of_kind, key=lambda i: targets[i].center))
        places = np.array([targets[i].center[:2] for i in order])
        edge = _CELL * (template.center.z - highest_source)
        cells = np.floor((places - places.min(axis=0)) / edge)
        _, cell, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
        # indices into `order` of the targets of each cell
        for members in np.split(np.argsort(cell.ravel(), kind="stable"), np.cumsum(counts)[:-1]):
            middle = 0.5 * (places[members].min(axis=0) + places[members].max(axis=0))
            squared_distance = np.square(places[members] - middle).sum(axis=1)
            stands_for[order[members]] = order[members[np.argmin(squared_distance)]]
    return stands_for
