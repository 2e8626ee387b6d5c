"""Sea surfaces: wave spectra, random seas, and the triangle meshes made of them."""

from .measured import from_wavespectra
from .seas import (
    FlatSea,
    JonswapSea,
    MeasuredSea,
    SinusoidalSea,
    SpectralSea,
    Surface,
    TiltedPlane,
    sea_from_config,
    sea_in_wind,
)
from .spectra import Elfouhaily, Jonswap, PiersonMoskowitz, Tma
from .spectra import SpectrumModel as Spectrum
from .spreading import (
    Cos2sSpreading,
    ElfouhailySpreading,
    IttcSpreading,
    MitsuyasuSpreading,
)
from .spreading import SpreadingModel as Spreading
from .triangulate import from_trimesh
from .waves import WaveComponents

__all__ = [
    "Cos2sSpreading",
    "Elfouhaily",
    "ElfouhailySpreading",
    "FlatSea",
    "IttcSpreading",
    "Jonswap",
    "JonswapSea",
    "MeasuredSea",
    "MitsuyasuSpreading",
    "PiersonMoskowitz",
    "SinusoidalSea",
    "SpectralSea",
    "Spectrum",
    "Spreading",
    "Surface",
    "TiltedPlane",
    "Tma",
    "WaveComponents",
    "from_trimesh",
    "from_wavespectra",
    "sea_from_config",
    "sea_in_wind",
]
