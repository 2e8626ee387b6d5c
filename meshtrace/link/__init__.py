"""Description of an optical link: water, bubbles, sources, receivers and physics."""

from meshtrace.link.link import Footprint as Footprint
from meshtrace.link.link import Link as Link
from meshtrace.link.physics import Physics as Physics
from meshtrace.link.physics import Whitecaps as Whitecaps
from meshtrace.link.receivers import Aperture as Aperture
from meshtrace.link.receivers import IrradiancePlanes as IrradiancePlanes
from meshtrace.link.receivers import Receiver as Receiver
from meshtrace.link.receivers import WaterAperture as WaterAperture
from meshtrace.link.receivers import WaterReceiver as WaterReceiver
from meshtrace.link.sources import AirBeam as AirBeam
from meshtrace.link.sources import AirLed as AirLed
from meshtrace.link.sources import AirSource as AirSource
from meshtrace.link.sources import AirTopHatBeam as AirTopHatBeam
from meshtrace.link.sources import CardioidalSky as CardioidalSky
from meshtrace.link.sources import GaussianBeam as GaussianBeam
from meshtrace.link.sources import IsotropicSource as IsotropicSource
from meshtrace.link.sources import Led as Led
from meshtrace.link.sources import Source as Source
from meshtrace.link.sources import Sun as Sun
from meshtrace.link.sources import TopHatBeam as TopHatBeam
from meshtrace.link.sources import UniformSky as UniformSky
from meshtrace.link.sources import WaterSource as WaterSource
