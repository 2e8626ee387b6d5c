"""Daylight: spectra, position of the sun, patterns of the sky, glint, light out of the water."""

from meshtrace.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
