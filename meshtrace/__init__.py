"""Embree-backed triangle-mesh Monte Carlo ray tracing of light that crosses a wavy sea."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
