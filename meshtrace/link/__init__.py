"""Description of an optical link: water, bubbles, sources, receivers and physics."""

from meshtrace.link.link import Footprint, Link
from meshtrace.link.physics import Physics, Whitecaps
from meshtrace.link.receivers import (
    AnyAperture,
    Aperture,
    IrradiancePlanes,
    Receiver,
    WaterAperture,
    WaterReceiver,
)
from meshtrace.link.sources import (
    AirBeam,
    AirLamp,
    AirLed,
    AirSource,
    AirTopHatBeam,
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
    "AirBeam",
    "AirLamp",
    "AirLed",
    "AirSource",
    "AirTopHatBeam",
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
    "WaterReceiver",
    "WaterSource",
    "Whitecaps",
]
