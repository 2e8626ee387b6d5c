"""Sea surfaces: wave spectra, random seas, and the triangle meshes made of them."""

from .leaning import LeaningWave
from .measured import from_wavespectra
from .random_seas import JonswapSea, MeasuredSea, RandomSea, SpectralSea
from .seas import sea_from_config, sea_in_wind
from .sequence import MeshSequence
from .spectra import Elfouhaily, Jonswap, PiersonMoskowitz, Spectrum, Tma
from .spreading import (
    Cos2sSpreading,
    ElfouhailySpreading,
    IttcSpreading,
    MitsuyasuSpreading,
    Spreading,
)
from .surface import FlatSea, Surface, TiltedPlane
from .triangulate import from_trimesh
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
    "PiersonMoskowitz",
    "RandomSea",
    "SinusoidalSea",
    "SpectralSea",
    "Spectrum",
    "Spreading",
    "Surface",
    "TiltedPlane",
    "Tma",
    "WaveComponents",
    "WaveSurface",
    "from_trimesh",
    "from_wavespectra",
    "sea_from_config",
    "sea_in_wind",
]
