"""Sea surfaces: wave spectra, random seas, and the triangle meshes made of them."""

from .double_peaked import OchiHubble, Torsethaugen
from .foreign_mesh import from_trimesh
from .leaning import LeaningWave
from .measured import from_wavespectra
from .measured_sea import MeasuredSea
from .random_sea import RandomSea
from .random_seas import JonswapSea, SpectralSea
from .seas import resolved_sea, sea_from_config, sea_in_wind
from .sequence import MeshSequence
from .spectra import Elfouhaily, Jonswap, PiersonMoskowitz, Spectrum, Tma
from .spreading import (
    Cos2sSpreading,
    ElfouhailySpreading,
    IttcSpreading,
    MitsuyasuSpreading,
    Spreading,
)
from .sum_sea import SumSea
from .surface import FlatSea, Surface, TiltedPlane
from .tabulated import TabulatedSpectrum
from .wave_surface import SinusoidalSea, WaveSurface
from .waves import WaveComponents

__all__ = [
    "Cos2sSpreading",
    "Elfouhaily",
    "ElfouhailySpreading",
    "FlatSea",
    "IttcSpreading",
    "Jonswap",
    "JonswapSea",
    "LeaningWave",
    "MeasuredSea",
    "MeshSequence",
    "MitsuyasuSpreading",
    "OchiHubble",
    "PiersonMoskowitz",
    "RandomSea",
    "SinusoidalSea",
    "SpectralSea",
    "Spectrum",
    "Spreading",
    "SumSea",
    "Surface",
    "TabulatedSpectrum",
    "TiltedPlane",
    "Tma",
    "Torsethaugen",
    "WaveComponents",
    "WaveSurface",
    "from_trimesh",
    "from_wavespectra",
    "resolved_sea",
    "sea_from_config",
    "sea_in_wind",
]
