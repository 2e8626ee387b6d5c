"""Description of an optical link: water, bubbles, sources, receivers and physics."""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, field_validator, model_validator

from meshtrace.errors import Described, Refused, require_kind
from meshtrace.link.physics import Physics, Whitecaps
from meshtrace.link.receivers import AnyAperture, Aperture, IrradiancePlanes, Receiver
from meshtrace.link.sources import AnySource, Led, Source, WaterSource
from meshtrace.models import Model
from meshtrace.optics.bubble_base import AnyBubbles
from meshtrace.optics.bubbles import HallNovarini
from meshtrace.optics.water import Water
from meshtrace.registry import Family

_TYPICAL = 16.0  # [m], depth plus height of links that keep the metre
_SMALL = 8.0  # units below a metre, up to which meshes keep their spacing
_ASIDE = 20.0  # [m], receivers farther aside have the fine mesh where their light crosses
_NEAR = 64.0  # depths plus heights: links closer to the origin keep it


class Footprint(NamedTuple):
    """The part of the surface that a link needs, as keyword arguments of `SurfaceModel.mesh`."""

    center: tuple[float, float]
    extent: float
    spacing: float
    fine_extent: float
    coarse_spacing: float


def _one_or_more(family: type[Family]) -> BeforeValidator:
    """Return a validator that reads one part, or a list of parts as a tuple."""

    def read(value: Any) -> Any:
        if not isinstance(value, list | tuple):
            return family.read(value)
        parts = []
        for i, item in enumerate(value):
            try:
                parts.append(family.read(item))
            except Refused as error:
                raise error.inside(i) from None
        return tuple(parts)

    return BeforeValidator(read)


class Link(Model, frozen=True):
    """A link from sources to receivers through water, surface and air.

    Parameters
    ----------
    water : Water
        Absorption, scattering, refractive index, bottom.
    bubbles : BubblePopulation or None
        Bubbles below the surface.
    transmitter : source or tuple of sources
        `Led`, `GaussianBeam`, `TopHatBeam`, `IsotropicSource`, `Sun`, `UniformSky`,
        `CardioidalSky`. Several share the photons in proportion to their power.
    receiver : Receiver, WaterAperture or tuple of them
        Apertures; each has its own gain.
    whitecaps : Whitecaps or None
        Foam on the surface.
    planes : IrradiancePlanes or None
        Irradiance planes in the water.
    n_air : float
        Refractive index of the air.
    physics : Physics, "physical" or "paper"
        Switches between the correct physics and the published forms.

    Notes
    -----
    `Link()` is the paper's default link (Table of link parameters) without bubbles.
    """

    water: Water = Water()
    bubbles: AnyBubbles | None = None
    transmitter: Annotated[AnySource | tuple[AnySource, ...], _one_or_more(Source)] = Led()
    receiver: Annotated[AnyAperture | tuple[AnyAperture, ...], _one_or_more(Aperture)] = Receiver()
    whitecaps: Whitecaps | None = None
    planes: IrradiancePlanes | None = None
    n_air: float = Field(1.0, ge=1.0, le=2.0, allow_inf_nan=False)
    physics: Physics = Physics()

    @field_validator("physics", mode="before")
    @classmethod
    def _preset(cls, physics: Any) -> Any:
        return Physics.preset(physics) if isinstance(physics, str) else physics

    @model_validator(mode="after")
    def _consistent(self) -> Link:
        if not self.transmitters:
            raise Refused("transmitter", (), "at least one source")
        bottom = self.water.bottom_depth
        for path, item in self.items():
            depth = -item.center[2]
            if bottom is not None and depth >= bottom:
                allowed = f"less than water.bottom_depth {bottom:g} m"
                raise Refused(f"{path}.depth", Described(f"{depth:g} m"), allowed)
        return self

    def items(self) -> list[tuple[str, Source | Aperture]]:
        """Return all sources and apertures with the paths that errors name them by."""
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
    def receivers(self) -> tuple[Aperture, ...]:
        """The apertures as a tuple."""
        return self.receiver if isinstance(self.receiver, tuple) else (self.receiver,)

    @property
    def only_receiver(self) -> Receiver:
        """The receiver of a link that has one, in the air.

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
        if wind_speed == 0.0:
            return self.replace(whitecaps=None, bubbles=None)
        wavelength = self.transmitters[0].wavelength_nm
        return self.replace(
            whitecaps=Whitecaps(wind_speed=wind_speed),
            bubbles=HallNovarini(
                wind_speed=wind_speed, n_water=self.water.n, wavelength_nm=wavelength
            ),
        )

    def at_depth(self, depth: float) -> Self:
        """Return the link with its only source at a depth [m] in the water.

        Raises
        ------
        Refused
            If there are several sources, or one in the air, or the depth is not allowed.
        """
        if not isinstance(self.transmitter, WaterSource):
            kinds = ", ".join(t.kind for t in self.transmitters)
            raise Refused("transmitter", Described(kinds), "one source in the water")
        return self.replace("transmitter.depth", depth)

    @property
    def unit(self) -> float:
        """Unit of length of the local coordinates [m], a power of two: 1 for some 15 m.

        That of the depths and heights, but for wide apertures and sources close to the surface,
        whose widths count up to a unit of 1.
        """
        levels = [0.0, *(item.center[2] for _, item in self.items())]
        widths = [
            getattr(item, "half_width", getattr(item, "radius", 0.0)) for _, item in self.items()
        ]
        unit = _power_of_two((max(levels) - min(levels)) / _TYPICAL)
        return max(unit, min(1.0, _power_of_two(max(widths) / _TYPICAL))) if unit else 1.0

    @property
    def origin(self) -> tuple[float, float]:
        """Origin (x, y) of the local coordinates [m]: (0, 0) unless the link lies far from it."""
        centers = [item.center for _, item in self.items()]
        x, y = (sum(c[i] for c in centers) / len(centers) for i in (0, 1))
        levels = [0.0, *(c[2] for c in centers)]
        size = max(levels) - min(levels)
        return (0.0, 0.0) if math.hypot(x, y) <= _NEAR * size else (x, y)

    def footprint(self, aside: float = _ASIDE) -> Footprint:
        """Return the extent and the spacing of the mesh that the link needs.

        Parameters
        ----------
        aside : float
            Distance aside up to which the fine part covers all sources and receivers [m]; it
            lies where their light crosses if one of them is farther aside.

        Notes
        -----
        The fine part covers the region where unscattered light of a rough sea can cross to a
        receiver: a slope s moves the crossing by beta s with beta = (n-1) h d / (d + n h).
        The extent reaches to the rays of which the water leaves e^-6 of the vertical light.
        """
        scale = min(_SMALL * self.unit, 1.0)
        height = max((r.height for r in self.receivers if isinstance(r, Receiver)), default=1.0)
        radius = max((r.radius for r in self.receivers), default=0.0)
        depth = max((getattr(t, "depth", 1.0) for t in self.transmitters), default=1.0)
        n = self.water.n / self.n_air
        beta = (n - 1.0) * height * depth / (depth + n * height)
        center, aside, far = self._middle(aside * scale)
        fine = max(2.5 * beta + radius + aside, scale)
        submerged = any(hasattr(t, "depth") for t in self.transmitters)
        reach = 10.0 * depth if submerged else 50.0
        if self.water.a > 0.0:
            clear = 6.0 / self.water.a  # sqrt((depth + clear)^2 - depth^2), which may not overflow
            reach = min(reach, math.sqrt(clear) * math.sqrt(2.0 * depth + clear))
        width = max(
            (t.half_width for t in self.transmitters if hasattr(t, "half_width")), default=0
        )
        extent = fine - aside + far + max(reach, 5.0 * scale) + width
        return Footprint(center, extent, 0.1 * scale, fine, scale)

    def lit_patch(self, slope: float) -> tuple[tuple[float, float], float]:
        """Return where unscattered light crosses to the receivers: the middle and half-width [m].

        Parameters
        ----------
        slope : float
            Root mean square slope of the sea in one direction.

        Notes
        -----
        4.5 standard deviations of beta s about the crossings of a flat sea, see `footprint`, the
        apertures as seen from the sources, and 5 cm. Slanted light is moved farther, by
        1 + 2 tan^2 of its angle to the power 3/2.
        """
        n = self.water.n / self.n_air
        low, high = np.full(2, math.inf), np.full(2, -math.inf)
        for t in self.transmitters:
            for r in self.receivers:
                depth, height = getattr(t, "depth", 1.0), getattr(r, "height", 1.0)
                share = depth / (depth + n * height)  # of the way to the receiver, in the water
                place = _crossing(t, r, n)
                aside = math.dist(t.position, r.position) / (depth + height)
                lever = (n - 1.0) * height * share * (1.0 + 2.0 * aside**2) ** 1.5
                reach = 4.5 * lever * slope + share * r.radius + 0.05 * min(_SMALL * self.unit, 1.0)
                low, high = np.minimum(low, place - reach), np.maximum(high, place + reach)
        middle = 0.5 * (low + high)
        return (float(middle[0]), float(middle[1])), float(0.5 * (high - low).max())

    def _middle(self, most: float) -> tuple[tuple[float, float], float, float]:
        """Return the middle of the fine mesh, and the half-widths of crossings and of the link.

        The origin, unless sources or receivers lie farther aside than `most`.
        """
        places = np.array([item.position for _, item in self.items()])
        middle = np.array(self.origin)
        far = float(np.abs(places - middle).max())
        if far <= most:
            return (float(middle[0]), float(middle[1])), far, far
        n = self.water.n / self.n_air
        crossings = np.array(
            [_crossing(t, r, n) for t in self.transmitters for r in self.receivers]
        )
        middle = 0.5 * (crossings.min(axis=0) + crossings.max(axis=0))
        half = float(np.abs(crossings - middle).max())
        return (float(middle[0]), float(middle[1])), half, float(np.abs(places - middle).max())


def in_wind(link: Link, wind_speed: float) -> Link:
    """Return a link with the whitecaps and bubbles of a wind, see `Link.in_wind`."""
    require_kind(link, Link, "link")
    return link.in_wind(wind_speed)


def _power_of_two(size: float) -> float:
    return float(2.0 ** round(math.log2(size))) if size > 0.0 else 0.0


def _crossing(source: Source, end: Aperture, n: float) -> NDArray[np.float64]:
    """Return where light from a source to a receiver crosses still water (x, y) [m]."""
    a, b = np.array(source.position), np.array(end.position)
    depth, height = getattr(source, "depth", 1.0), getattr(end, "height", 1.0)
    distance = math.dist(a, b)
    low, high = 0.0, 1.0
    for _ in range(40):  # n sin(angle in water) - sin(angle in air) grows with the share
        share = 0.5 * (low + high)
        x, y = share * distance, (1.0 - share) * distance
        if n * x * math.hypot(y, height) < y * math.hypot(x, depth):
            low = share
        else:
            high = share
    return a + share * (b - a)
