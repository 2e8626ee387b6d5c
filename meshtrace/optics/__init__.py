"""Optical properties of the water: absorption, scattering, phase functions, bubbles, Fresnel."""

import meshtrace.optics.constituents  # noqa: F401, its spectrum joins the family
from meshtrace.lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
