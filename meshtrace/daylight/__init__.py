"""Daylight: spectra, position of the sun, patterns of the sky, glint, light out of the water."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
