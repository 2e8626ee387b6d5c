"""Sea surfaces: wave spectra, random seas, and the triangle meshes made of them."""

import lazy_loader

import meshtrace.surfaces.seas  # noqa: F401, the built-in seas and spectra join their families

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
