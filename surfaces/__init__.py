"""Sea surfaces: wave spectra, random seas, and the triangle meshes made of them."""

import meshtrace.surfaces.seas  # noqa: F401, the built-in seas and spectra join their families
from meshtrace.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
