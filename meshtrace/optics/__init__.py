"""Optical properties of the water: absorption, scattering, phase functions, bubbles, Fresnel."""

import lazy_loader

import meshtrace.optics.constituents  # noqa: F401, its spectrum joins the family

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
