"""Description of an optical link: water, bubbles, sources, receivers and physics."""

from __future__ import annotations

import math
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from meshtrace.errors import Described, Refused, require_real, within
from meshtrace.link.bodies import Body
from meshtrace.link.crossings import Crossing, mirror_crossing, refracted_crossing
from meshtrace.link.crossings import spot_radius as spot_radius
from meshtrace.link.physics import Physics, Whitecaps
from meshtrace.link.receivers import (
    Aperture,
    IrradiancePlanes,
    Receiver,
    WaterAperture,
    WaterReceiver,
)
from meshtrace.link.sources import ABOVE, AirLamp, AirSource, Led, Source, WaterSource
from meshtrace.models import FamilyField, FamilyFields, Model, converted
from meshtrace.optics.bubbles import BubblePopulation, HallNovarini
from meshtrace.optics.water import Water

# Depth plus height of links whose unit of length is the metre [m]; `Link()` has 15 m.
_TYPICAL = 16.0
# Lengths of a mesh are in proportion to the unit of the link where that is below 1 m over this
# number, for depth plus height of some 2 m: such links need less than metres.
_SMALL = 8.0
_ASIDE = 20.0  # a mesh centred on the origin is fine up to receivers this far aside [m]
_MOST_CELLS = 160  # over the half-width of the fine part, in links with both ends on one side
_NEAR = 64.0  # links keep the origin (0, 0) up to this distance from it, over depth plus height
# Least distance of a source or receiver from still water: usually [m]; over the distance of the
# farthest end, for links of a few millimetres; and of any link [m]: rays have no meaning below the
# wavelength.
_LEAST_DISTANCE = 1e-3
_LEAST_SHARE = 0.1
_SHORTEST = 1e-9
# fields of kind, place and axis, which an end leaves behind when it changes places, see `_moved`
_PLACED = {"kind", "position", "depth", "height"}
_PLACED |= {"zenith_deg", "azimuth_deg", "tilt_deg", "tilt_azimuth_deg"}


Direction = Literal["up", "down", "under", "over", "mixed"]
"""Media of the ends of a link, see `Link.direction`."""

SAME_SIDE = "under", "over"
"""Directions of links whose ends lie in one medium, with the surface as a mirror."""

FEW_METRES = 10.0
"""Depth [m] from which light comes back to the air, if there is no bottom above it.

Absorption by the water of `Link()`, 0.114 m-1, leaves a tenth of it on the way down and up.
"""


class Footprint(NamedTuple):
    """The part of the surface that a link needs, as keyword arguments of `SurfaceModel.mesh`."""

    center: tuple[float, float]  # (x, y) [m]
    extent: float  # half-width of the mesh [m]
    spacing: float  # of the fine part about the centre [m]
    fine_extent: float  # half-width of the fine part [m]
    coarse_spacing: float  # largest one outside of it [m]


class Link(Model, frozen=True):
    """A link from sources to receivers through water, surface and air.

    Parameters
    ----------
    water : Water
        Absorption, scattering, refractive index, bottom.
    bubbles : BubblePopulation or None
        Bubbles below the surface.
    transmitter : source or tuple of sources
        `Led`, `GaussianBeam`, `TopHatBeam`, `IsotropicSource` in the water; `AirLed`, `AirBeam`,
        `AirTopHatBeam`, `Sun`, `UniformSky`, `CardioidalSky` in the air. Several share the
        photons in proportion to their power.
    receiver : Receiver, WaterReceiver, WaterAperture or tuple of them
        Apertures; each has its own gain.
    whitecaps : Whitecaps or None
        Foam on the surface.
    planes : IrradiancePlanes or None
        Irradiance planes in the water.
    objects : Body or sequence of Body
        Bodies beside the sea, see `bodies`.
    n_air : float
        Refractive index of the air.
    physics : Physics, "physical" or "paper"
        Switches between the correct physics and the published forms.

    Notes
    -----
    `Link()` is the paper's default link (Table of link parameters) without bubbles.
    """

    water: Water = Water()
    bubbles: FamilyField[BubblePopulation | None] = converted(default=None)
    transmitter: FamilyFields[Source] = converted(default=Led())
    receiver: FamilyFields[Aperture] = converted(default=Receiver())
    whitecaps: Whitecaps | None = None
    planes: IrradiancePlanes | None = None
    objects: tuple[Body, ...] = ()
    n_air: float = Field(default=1.0, ge=1.0, le=2.0, allow_inf_nan=False)
    physics: Physics = Physics()

    @field_validator("physics", mode="before")
    @classmethod
    def _preset(cls, physics: Any) -> Any:
        return Physics.preset(physics) if isinstance(physics, str) else physics

    @field_validator("objects", mode="before")
    @classmethod
    def _one_or_several(cls, objects: Any) -> Any:
        return (objects,) if isinstance(objects, Body | dict) else objects

    @model_validator(mode="after")
    def _consistent(self) -> Link:
        if not self.transmitters:
            raise Refused("transmitter", (), "at least one source")
        self._require_albedos()
        bottom = self.water.bottom_depth
        for path, item in self.items():
            depth = -item.center[2]
            if bottom is not None and depth >= bottom:
                allowed = f"less than water.bottom_depth {bottom:g} m"
                raise Refused(f"{path}.depth", Described(f"{depth:g} m"), allowed)
            if 0.0 < abs(depth) < self.least_distance and not isinstance(item, WaterAperture):
                name = "depth" if depth > 0.0 else "height"
                allowed = f"at least {self.least_distance:g} m from still water"
                raise Refused(f"{path}.{name}", Described(f"{abs(depth):g} m"), allowed)
        return self

    def _require_albedos(self) -> None:
        """Refuse bodies without one albedo at the wavelength of the sources."""
        wavelengths = dict.fromkeys(t.wavelength_nm for t in self.transmitters)
        for i, body in enumerate(self.bodies):
            with within("objects", i) if i < len(self.objects) else within("water", "bottom"):
                if isinstance(body.albedo, tuple) and len(wavelengths) > 1:
                    several = Described("a table of wavelength")
                    raise Refused("albedo", several, "a number for sources of several wavelengths")
                body.albedo_at(next(iter(wavelengths)))

    @property
    def bodies(self) -> tuple[Body, ...]:
        """The objects, and the bottom of the water if it is a mesh."""
        if self.water.bottom is None:
            return self.objects
        with within("water", "bottom"):
            return *self.objects, Body(self.water.bottom, albedo=self.water.bottom_albedo)

    @property
    def least_distance(self) -> float:
        """Least distance of a source or receiver from the surface [m].

        A millimetre, or a tenth of the largest depth or height if that is less, but at least a
        nanometre.
        """
        farthest = max(abs(item.center[2]) for _, item in self.items())
        return max(min(_LEAST_DISTANCE, _LEAST_SHARE * farthest), _SHORTEST)

    def items(self) -> list[tuple[str, Source | Aperture]]:
        """Return all sources and apertures with the paths by which errors name them."""
        named: list[tuple[str, Source | Aperture]] = []
        for name in ("transmitter", "receiver"):
            part = getattr(self, name)
            if isinstance(part, tuple):
                named += [(f"{name}[{i}]", item) for i, item in enumerate(part)]
            else:
                named.append((name, part))
        return named

    @property
    def transmitters(self) -> tuple[Source, ...]:
        """The sources as a tuple."""
        return self.transmitter if isinstance(self.transmitter, tuple) else (self.transmitter,)

    @property
    def pixels(self) -> int:
        """Largest number of pixels along a side of the receivers."""
        return max((getattr(end, "pixels", 1) for end in self.receivers), default=1)

    @property
    def receivers(self) -> tuple[Aperture, ...]:
        """The apertures as a tuple."""
        return self.receiver if isinstance(self.receiver, tuple) else (self.receiver,)

    @property
    def only_receiver(self) -> Receiver:
        """The only receiver of the link, which is in the air.

        Raises
        ------
        Refused
            If there are several apertures, none, or one in the water.
        """
        if not isinstance(self.receiver, Receiver):
            kinds = ", ".join(r.kind for r in self.receivers) or "none"
            raise Refused("receiver", Described(kinds), "one receiver in the air")
        return self.receiver

    @property
    def air_end(self) -> tuple[Literal["transmitter", "receiver"], AirLamp | Receiver]:
        """Field name of the only end of the link in the air, and that lamp or receiver itself.

        Raises
        ------
        Refused
            If there are several such ends, or none.
        """
        if isinstance(self.transmitter, AirLamp) and self.direction == "down":
            return "transmitter", self.transmitter
        return "receiver", self.only_receiver

    @property
    def direction(self) -> Direction:
        """Media of the two ends: "up" from the water into the air, or "down"; else see `SAME_SIDE`.

        "under": both ends in the water; "over": both in the air; "mixed": sources or receivers in
        either medium.
        """
        from_water = {isinstance(t, WaterSource) for t in self.transmitters}
        into_air = {isinstance(r, Receiver) for r in self.receivers}
        if len(from_water) > 1 or len(into_air) > 1:
            return "mixed"
        # planes alone, without a receiver, count light in the water: a link from there is "up", one
        # from the air "down"
        (water,) = from_water
        air = into_air.pop() if into_air else water
        if water:
            return "up" if air else "under"
        # sun and sky have no place in the air
        lamps = all(isinstance(t, AirLamp) for t in self.transmitters)
        return ("over" if lamps else "mixed") if air else "down"

    def require_chains(self) -> None:
        """Refuse a link that photons follow, but no chains of scatterings.

        Raises
        ------
        Refused
            If its direction is "under" or "over", or if it has bodies.
        """
        if self.direction in SAME_SIDE:
            raise Refused("link", Described("ends on one side"), "a link that changes sides")
        self.require_no_bodies("none: no chains of scatterings pass them")

    def require_no_bodies(self, allowed: str) -> None:
        """Refuse a link with bodies.

        Raises
        ------
        Refused
            If it has `objects`, or a mesh as its bottom; `allowed` is what the text allows.
        """
        if self.bodies:
            path = "objects" if self.objects else "water.bottom"
            raise Refused(path, Described(f"{len(self.bodies)} of them"), allowed)

    def mirrored(self) -> Self:
        """Return the link in the other direction: lamp and receiver change places.

        Each keeps its pattern: half-angle or divergence, radius, field of view, power and
        wavelength. Positions and axes stay with the places, so that ends that face each other
        still do.

        Raises
        ------
        Refused
            If the link has several sources or receivers, sun, sky or an isotropic source,
            apertures without direction, or planes.

        Examples
        --------
        >>> down = Link().mirrored()
        >>> down.transmitter.kind, down.transmitter.height, down.receiver.depth
        ('air-led', 5.0, 10.0)
        >>> down.mirrored() == Link()
        True
        """
        lamp, end = self.transmitter, self.receiver
        if self.planes is not None:
            raise Refused("planes", Described("given"), "None for the other direction")
        lamps: dict[Any, Any] = ABOVE | {air: air for air in ABOVE.values()}
        from_water = isinstance(lamp, WaterSource)
        if not isinstance(end, Receiver | WaterReceiver) or type(lamp) not in lamps:
            kinds = ", ".join(item.kind for _, item in self.items()) or "none"
            allowed = "one LED or beam and one receiver, in the water or in the air"
            raise Refused("link", Described(kinds), allowed)
        if isinstance(end, WaterReceiver):  # the lamp comes to be in the water, as the receiver is
            lamps = {kind: water for water, air in ABOVE.items() for kind in (water, air)}
        return self.replace(
            transmitter=_moved(lamps[type(lamp)], lamp, end),
            receiver=_moved(WaterReceiver if from_water else Receiver, end, lamp),
        )

    @property
    def wind_speed(self) -> float | None:
        """Wind speed of the bubbles, or else of the whitecaps [m s-1]; None without either."""
        parts = (self.bubbles, self.whitecaps)
        return next((u for part in parts if (u := getattr(part, "wind_speed", None))), None)

    def in_wind(self, wind_speed: float) -> Self:
        """Return the link with the whitecaps and bubbles of a wind.

        Parameters
        ----------
        wind_speed : float
            Wind speed at 10 m [m s-1], 0 ... 30; 0 for neither whitecaps nor bubbles.

        Examples
        --------
        >>> round(Link().in_wind(13.0).whitecaps.transmittance, 4)
        0.8899
        """
        if require_real(wind_speed, "wind_speed", "0 <= wind_speed <= 30") == 0.0:
            return self.replace(whitecaps=None, bubbles=None)
        wavelength = self.transmitters[0].wavelength_nm
        return self.replace(
            whitecaps=Whitecaps(wind_speed=wind_speed),
            bubbles=HallNovarini(
                wind_speed=wind_speed, n_water=self.water.n, wavelength_nm=wavelength
            ),
        )

    @property
    def depth(self) -> float:
        """Depth of the only source or receiver in the water [m]; nan for another link."""
        end = self.receiver if self.direction == "down" else self.transmitter
        return float(getattr(end, "depth", math.nan))

    def at_depth(self, depth: float) -> Self:
        """Return the link with its only source, or receiver, in the water at a depth [m].

        Raises
        ------
        Refused
            If there are several sources, or none in the water, or the depth is not allowed.
        """
        if self.direction == "down" and isinstance(self.receiver, WaterReceiver):
            return self.replace("receiver.depth", depth)
        if not isinstance(self.transmitter, WaterSource):
            kinds = ", ".join(t.kind for t in self.transmitters)
            raise Refused("transmitter", Described(kinds), "one source in the water")
        return self.replace("transmitter.depth", depth)

    def at_wavelength(self, wavelength_nm: float) -> Self:
        """Return the link with all sources and the water at another wavelength.

        Parameters
        ----------
        wavelength_nm : float
            Wavelength in vacuum [nm], 200 ... 1200.

        Raises
        ------
        Refused
            If the water has no spectrum, or its spectrum no values at the wavelength; the same
            wavelength is always allowed.

        Notes
        -----
        Bubbles keep their phase function, whose tables take half a minute: from 470 to 400 or 700
        nm, with the index of `quan_fry`, the mean cosine changes by 0.005 at most and the
        scattering efficiency by 0.3 %. Replace `bubbles.wavelength_nm` and `bubbles.n_water` where
        that matters.

        Examples
        --------
        >>> link = Link(water=Water.from_type("jerlov-IB")).at_wavelength(520.0)
        >>> link.transmitter.wavelength_nm, link.water.c
        (520.0, 0.1004)
        """
        sources = tuple(t.replace(wavelength_nm=wavelength_nm) for t in self.transmitters)
        if sources == self.transmitters and self.water.wavelength_nm in (None, wavelength_nm):
            return self
        water = self.water.at_wavelength(wavelength_nm)
        several = isinstance(self.transmitter, tuple)
        return self.replace(transmitter=sources if several else sources[0], water=water)

    @property
    def unit(self) -> float:
        """Unit of length of the local coordinates [m], a power of two.

        It follows the greatest depth plus height of the ends, and is 1 m for some 16 m. Wide
        apertures and sources close to the surface have a larger unit, up to 1 m, by their widths.
        """
        levels = [0.0, *(item.center[2] for _, item in self.items())]
        widths = [
            getattr(item, "half_width", getattr(item, "radius", 0.0)) for _, item in self.items()
        ]
        unit = _power_of_two((max(levels) - min(levels)) / _TYPICAL)
        return max(unit, min(1.0, _power_of_two(max(widths) / _TYPICAL))) if unit else 1.0

    @property
    def origin(self) -> tuple[float, float]:
        """Origin (x, y) of the local coordinates [m]: (0, 0), or the mean of ends far from it."""
        centers = [item.center for _, item in self.items()]
        # fsum: the same digits in any order of the parts
        x, y = (math.fsum(c[i] for c in centers) / len(centers) for i in (0, 1))
        levels = [0.0, *(c[2] for c in centers)]
        size = max(levels) - min(levels)
        return (0.0, 0.0) if math.hypot(x, y) <= _NEAR * size else (x, y)

    def footprint(self, aside: float = _ASIDE) -> Footprint:
        """Return the extent and the spacing of the mesh that the link needs.

        Parameters
        ----------
        aside : float
            Horizontal distance of sources and receivers up to which the fine part covers them all
            [m]; if one of them is farther aside, it covers the crossings of their light.

        Notes
        -----
        The fine part covers the region where unscattered light of a rough sea can cross to a
        receiver: a slope s moves the crossing by beta s with beta = (n-1) h d / (d + n h), for the
        depth d, the height h and the relative index n of the water. The mirror of links on one side
        has beta = 2 h h' / (h + h') for the distances h and h' of the ends from it; there the fine
        part is no wider than what the beams light, or what is seen of the light in the water.
        The extent reaches to slanted rays that absorption weakens by e^-6 more than vertical ones.
        """
        # metres for links of ordinary size
        scale = min(_SMALL * self.unit, 1.0)
        high = [item.height for _, item in self.items() if isinstance(item, Receiver | AirLamp)]
        low = [
            item.depth for _, item in self.items() if isinstance(item, WaterSource | WaterReceiver)
        ]
        # 1 m where there is no such end, as under sun and sky
        height, depth = max(high, default=1.0), max(low, default=1.0)
        radius = max((r.radius for r in self.receivers), default=0.0)
        n = self.water.n / self.n_air
        beta = (n - 1.0) * height * depth / (depth + n * height)
        # beta for h = inf: parallel light of sun and sky
        skies = [t for t in self.transmitters if isinstance(t, AirSource)]
        under_sky = [-r.center[2] for r in self.receivers if skies and not isinstance(r, Receiver)]
        beta = max(beta, (n - 1.0) / n * max(under_sky, default=0.0))
        # slope of the waves up to which crossings lie in the fine part: 12 standard deviations of
        # slopes along a wind of 13 m/s (`surfaces.cox_munk`)
        steepest = 2.5
        if self.direction in SAME_SIDE:
            # a slope of 1 turns reflected light by a right angle
            beta, steepest = max(crossing.lever for crossing in self.crossings()), 1.0
        center, half_fine, half_ends = self._middle(aside * scale)
        fine = min(steepest * beta, self._widest_light()) + radius + half_fine
        if len(skies) == len(self.transmitters):
            # the squares as seen from the centre
            edges = [np.ptp([center, t.position], 0).max() + t.half_width for t in skies]
            fine = min(fine, float(max(edges)))
        fine = max(fine, scale)
        # at most ten depths aside, where a ray from the lamp is 84 degrees off the vertical; 50 m
        # for links in the air alone, which have no depth
        reach = 10.0 * depth if low else 50.0
        if self.water.a > 0.0:
            clear = 6.0 / self.water.a
            # a ray of the length depth + clear: sqrt((depth + clear)^2 - depth^2) aside, in a form
            # whose squares do not overflow
            reach = min(reach, math.sqrt(clear) * math.sqrt(2.0 * depth + clear))
        width = max(getattr(t, "half_width", 0.0) for t in self.transmitters)
        # the margin of the fine part about all ends, not only those that it covers, and the reach
        # of slanted rays, at least 5 m
        extent = fine - half_fine + half_ends + max(reach, 5.0 * scale) + width
        # a lamp high in the air is reflected over hectares: facets of the fine part are limited
        spacing = 0.1 * scale
        if self.direction in SAME_SIDE:
            spacing = max(spacing, fine / _MOST_CELLS)
        return Footprint(center, extent, spacing, fine, max(spacing, scale))

    def lit_patch(self, slope: float) -> tuple[tuple[float, float], float]:
        """Return centre and half-width [m] of the crossings of unscattered light to the receivers.

        Parameters
        ----------
        slope : float
            Standard deviation of the slope of the sea in one direction.

        Notes
        -----
        4.5 standard deviations of the displaced crossing about that of a flat sea, see `crossings`,
        plus the aperture as seen from the source, plus 5 cm, or less for small links.

        Raises
        ------
        Refused
            If no light of the sources crosses the surface on a straight way to a receiver.
        """
        crossings = self.crossings()
        if not crossings:
            allowed = "a receiver on the other side of the surface"
            raise Refused("receiver", Described("none that light crosses to"), allowed)
        low, high = np.full(2, math.inf), np.full(2, -math.inf)
        margin = 0.05 * min(_SMALL * self.unit, 1.0)
        widest = self._widest_light()
        for place, lever, seen, least, most in crossings:
            # Gaussian slopes exceed 4.5 standard deviations at 7 in a million places
            reach = min(4.5 * lever * slope, widest) + seen + margin
            low = np.minimum(low, np.clip(place - reach, least, most))
            high = np.maximum(high, np.clip(place + reach, least, most))
        middle = 0.5 * (low + high)
        # daylight of a square beside its crossing leaves nothing: the mesh needs some width
        half = max(float(0.5 * (high - low).max()), margin)
        return (float(middle[0]), float(middle[1])), half

    def crossings(self) -> list[Crossing]:
        """Return where unscattered light crosses a flat sea, from each source to each receiver.

        In links of sources and receivers on either side those on one side have no crossing.

        Notes
        -----
        A slope moves the crossing of slanted light farther than that of vertical light
        (`footprint`). For ends on one side these are the places where the sea reflects the light,
        with the factor 1 / cos^2 theta, theta the angle of incidence.
        """
        n = self.water.n / self.n_air
        crossings = []
        for t in self.transmitters:
            for r in self.receivers:
                if self.direction in SAME_SIDE:
                    crossings.append(mirror_crossing(t, r))
                elif isinstance(t, WaterSource) is isinstance(r, Receiver):
                    crossings.append(refracted_crossing(t, r, n))
        return crossings

    def _widest_light(self) -> float:
        """Return the largest distance from a mirror crossing up to which facets are to be fine [m].

        Infinite for links that change sides. Of links on one side beams light their spot alone, and
        light from the water is seen within the view, or within `FEW_METRES` of its depth.
        """
        if self.direction not in SAME_SIDE:
            return math.inf
        spots = [spot_radius(t) for t in self.transmitters]
        if self.direction == "under":
            return max(spots)
        # 1.5 rad, 86 degrees: tan has its pole at 90
        seen = [
            abs(r.center[2]) * math.tan(min(math.radians(r.fov_deg) / 2.0, 1.5))
            for r in self.receivers
        ]
        return max(*spots, min(max(seen), self.water.bottom_depth or FEW_METRES))

    def _middle(self, most: float) -> tuple[tuple[float, float], float, float]:
        """Return the middle of the fine mesh, and half-widths of what it covers and of all ends.

        It covers all ends about the origin, unless one of them lies farther aside than `most` [m];
        then it covers the crossings alone, about their own middle.
        """
        places = np.array([item.position for _, item in self.items()])
        middle = np.array(self.origin)
        # without a crossing the middle is that of the ends
        crossings = np.array([crossing.place for crossing in self.crossings()] or places)
        farthest = float(np.abs(places - middle).max())
        # daylight alone crosses farther aside than all ends, and beams in the air that look aside
        spots = crossings if self.direction == "over" else places
        if max(farthest, float(np.abs(spots - middle).max())) <= most:
            return (float(middle[0]), float(middle[1])), farthest, farthest
        middle = 0.5 * (crossings.min(axis=0) + crossings.max(axis=0))
        half = float(np.abs(crossings - middle).max())
        return (float(middle[0]), float(middle[1])), half, float(np.abs(places - middle).max())


def _power_of_two(size: float) -> float:
    """Return the power of two nearest to a size on a logarithmic scale; 0 for 0."""
    return float(2.0 ** round(math.log2(size))) if size > 0.0 else 0.0


def _moved(kind: type[Any], end: Any, place: Any) -> Any:
    """Return an end of `kind` at the position, level and axis of the end `place`.

    Pattern, power and wavelength are those of `end`.
    """
    # fields that were not set take the defaults of the new kind
    fields = {name: getattr(end, name) for name in end.model_fields_set if name not in _PLACED}
    level = "depth" if hasattr(place, "depth") else "height"
    fields |= {"position": place.position, level: getattr(place, level)}
    angles = zip(_angle_names(kind), _angle_names(type(place)), strict=True)
    return kind.model_validate(fields | {new: getattr(place, old) for new, old in angles})


def _angle_names(kind: type[Any]) -> tuple[str, str]:
    """Return the names of the polar and the azimuthal angle of the axis of a kind of end."""
    water = issubclass(kind, WaterSource)
    return ("zenith_deg", "azimuth_deg") if water else ("tilt_deg", "tilt_azimuth_deg")
