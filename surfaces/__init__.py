"""Sea surfaces: wave spectra, random seas, and the triangle meshes made of them."""

# the built-in seas and spectra join their families
import meshtrace.surfaces.seas
import meshtrace.surfaces.tabulated  # noqa: F401
from meshtrace.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
