"""Sea surfaces: wave spectra, random seas, and the triangle meshes made of them."""

from .bands import Band
from .foreign_mesh import from_trimesh
from .measured import MeasuredSea, from_wavespectra
from .seas import (
    JonswapSea,
    RandomSea,
    SpectralSea,
    SumSea,
    resolved_sea,
    sea_from_config,
    sea_in_wind,
)
from .sequence import MeshSequence
from .spectra import (
    Elfouhaily,
    Jonswap,
    OchiHubble,
    PiersonMoskowitz,
    Spectrum,
    TabulatedSpectrum,
    Tma,
    Torsethaugen,
)
from .spreading import (
    Cos2sSpreading,
    ElfouhailySpreading,
    IttcSpreading,
    MitsuyasuSpreading,
    Spreading,
)
from .surface import FlatSea, Surface, TiltedPlane
from .wave_surface import SinusoidalSea, WaveSurface
from .waves import WaveComponents

__all__ = [
    "Band",
    "Cos2sSpreading",
    "Elfouhaily",
    "ElfouhailySpreading",
    "FlatSea",
    "IttcSpreading",
    "Jonswap",
    "JonswapSea",
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
