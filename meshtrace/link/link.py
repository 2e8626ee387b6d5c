"""Description of an optical link: water, bubbles, sources, receivers and physics."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from pydantic import Field, field_validator, model_validator

from meshtrace.link.models import Model
from meshtrace.link.physics import Physics, Whitecaps
from meshtrace.link.receivers import Aperture, IrradiancePlanes, Receiver
from meshtrace.link.sources import Led, Source
from meshtrace.optics.bubbles import HallNovarini
from meshtrace.optics.water import Water

_NEAR = 64.0  # depths plus heights: links closer to the origin keep it


class Footprint(NamedTuple):
    """The part of the surface that a link needs, as keyword arguments of `SurfaceModel.mesh`."""

    center: tuple[float, float]
    extent: float
    spacing: float
    fine_extent: float
    coarse_spacing: float


class Link(Model, frozen=True):
    """A link from sources to receivers through water, surface and air.

    Parameters
    ----------
    water : Water
        Absorption, scattering, refractive index, bottom.
    bubbles : HallNovarini or None
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
        Switches between right physics and printed forms.

    Notes
    -----
    `Link()` is the paper's default link (Table of link parameters) without bubbles.
    """

    water: Water = Water()
    bubbles: HallNovarini | None = None
    transmitter: Source | tuple[Source, ...] = Led()
    receiver: Aperture | tuple[Aperture, ...] = Receiver()
    whitecaps: Whitecaps | None = None
    planes: IrradiancePlanes | None = None
    n_air: float = Field(1.0, ge=1.0, le=2.0, allow_inf_nan=False)
    physics: Physics = Physics()

    @field_validator("physics", mode="before")
    @classmethod
    def _preset(cls, physics: Any) -> Any:
        if physics == "physical":
            return Physics()
        if physics == "paper":
            return Physics.paper()
        if isinstance(physics, str):
            raise ValueError('allowed "physical", "paper" or a table of switches')
        return physics

    @model_validator(mode="after")
    def _consistent(self) -> Link:
        if not self.transmitters:
            raise ValueError("transmitter: (), allowed at least one source")
        bottom = self.water.bottom_depth
        for item in (*self.transmitters, *self.receivers):
            depth = getattr(item, "depth", 0.0)
            if bottom is not None and depth >= bottom:
                raise ValueError(
                    f"{item.kind}.depth: {depth:g} m, allowed less than water.bottom_depth "
                    f"{bottom:g} m"
                )
        return self

    @property
    def transmitters(self) -> tuple[Source, ...]:
        """The sources as a tuple."""
        return self.transmitter if isinstance(self.transmitter, tuple) else (self.transmitter,)

    @property
    def receivers(self) -> tuple[Aperture, ...]:
        """The apertures as a tuple."""
        return self.receiver if isinstance(self.receiver, tuple) else (self.receiver,)

    @property
    def origin(self) -> tuple[float, float]:
        """Origin (x, y) of the local coordinates [m]: (0, 0) unless the link lies far from it."""
        items = (*self.transmitters, *self.receivers)
        x, y = (sum(item.position[i] for item in items) / len(items) for i in (0, 1))
        size = max(getattr(t, "depth", 0.0) for t in items)
        size += max(getattr(t, "height", 0.0) for t in items)
        return (0.0, 0.0) if math.hypot(x, y) <= _NEAR * size else (x, y)

    def footprint(self) -> Footprint:
        """Return where the surface must be meshed, and how finely.

        Notes
        -----
        The fine part covers where the unscattered light of a rough sea can cross to a
        receiver: a slope s moves the crossing by beta s with beta = (n-1) h d / (d + n h).
        The extent reaches to where the water leaves e^-6 of the light that goes straight up.
        """
        center = self.origin
        lateral = [
            abs(v - c)
            for item in (*self.transmitters, *self.receivers)
            for v, c in zip(item.position, center, strict=True)
        ]
        height = max((r.height for r in self.receivers if isinstance(r, Receiver)), default=1.0)
        radius = max((r.radius for r in self.receivers), default=0.0)
        depth = max((getattr(t, "depth", 1.0) for t in self.transmitters), default=1.0)
        n = self.water.n / self.n_air
        beta = (n - 1.0) * height * depth / (depth + n * height)
        fine = max(2.5 * beta + radius + max(lateral), 1.0)
        lamps = any(hasattr(t, "depth") for t in self.transmitters)
        reach = 10.0 * depth if lamps else 50.0
        if self.water.a > 0.0:
            reach = min(reach, math.sqrt((depth + 6.0 / self.water.a) ** 2 - depth**2))
        width = max(
            (t.half_width for t in self.transmitters if hasattr(t, "half_width")), default=0
        )
        extent = fine + max(reach, 5.0) + width
        return Footprint(center, extent, 0.1, fine, 1.0)
