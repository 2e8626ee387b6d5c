"""Description of an optical link: water, bubbles, sources, receivers and physics."""

from meshtrace.link.link import Footprint, Link
from meshtrace.link.physics import Physics, Whitecaps
from meshtrace.link.receivers import (
    AnyAperture,
    Aperture,
    IrradiancePlanes,
    Receiver,
    WaterAperture,
)
from meshtrace.link.sources import (
    AirSource,
    AnySource,
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
    "AirSource",
    "AnyAperture",
    "AnySource",
    "Aperture",
    "CardioidalSky",
    "Footprint",
    "GaussianBeam",
    "IrradiancePlanes",
    "IsotropicSource",
    "Led",
    "Link",
    "Physics",
    "Receiver",
    "Source",
    "Sun",
    "TopHatBeam",
    "UniformSky",
    "WaterAperture",
    "WaterSource",
    "Whitecaps",
]
