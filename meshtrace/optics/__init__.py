"""Optical properties of the water: absorption, scattering, phase functions, bubbles, Fresnel."""

from meshtrace.optics.bubbles import BubblePopulation as BubblePopulation
from meshtrace.optics.bubbles import HallNovarini as HallNovarini
from meshtrace.optics.constituents import Constituents as Constituents
from meshtrace.optics.fresnel import fresnel_reflectance as fresnel_reflectance
from meshtrace.optics.phase import FournierForand as FournierForand
from meshtrace.optics.phase import HenyeyGreenstein as HenyeyGreenstein
from meshtrace.optics.phase import HistogramPhase as HistogramPhase
from meshtrace.optics.phase import MixturePhase as MixturePhase
from meshtrace.optics.phase import Petzold as Petzold
from meshtrace.optics.phase import PhaseFunction as PhaseFunction
from meshtrace.optics.phase import Rayleigh as Rayleigh
from meshtrace.optics.phase import TabulatedPhase as TabulatedPhase
from meshtrace.optics.spectra import SpectralTable as SpectralTable
from meshtrace.optics.spectra import WaterSpectrum as WaterSpectrum
from meshtrace.optics.spectra import WaterType as WaterType
from meshtrace.optics.water import Water as Water
