"""Description of an optical link: water, bubbles, sources, receivers and physics."""

from meshtrace.link.link import Footprint, Link
from meshtrace.link.models import Position
from meshtrace.link.physics import Physics, Whitecaps
from meshtrace.link.receivers import Aperture, IrradiancePlanes, Receiver, WaterAperture
from meshtrace.link.sources import (
    CardioidalSky,
    GaussianBeam,
    IsotropicSource,
    Led,
    Source,
    Sun,
    TopHatBeam,
    UniformSky,
    WaterSource,
)

__all__ = [
    "Aperture",
    "CardioidalSky",
    "Footprint",
    "GaussianBeam",
    "IrradiancePlanes",
    "IsotropicSource",
    "Led",
    "Link",
    "Physics",
    "Position",
    "Receiver",
    "Source",
    "Sun",
    "TopHatBeam",
    "UniformSky",
    "WaterAperture",
    "WaterSource",
    "Whitecaps",
]
