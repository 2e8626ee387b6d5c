"""Embree-backed triangle-mesh Monte Carlo ray tracing of light that crosses a wavy sea."""

from typing import Any

import lazy_loader

_attribute, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("meshtrace")
    return _attribute(name)
