"""Embree-backed triangle-mesh Monte Carlo ray tracing of light that crosses a wavy sea."""

from pathlib import Path
from typing import Any

import lazy_loader

_attribute, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# Python started in a checkout imports this folder even if the package is installed elsewhere;
# `meshtrace.surfaces` and `meshtrace.viz` then lie beside it.
_beside = Path(__file__).parents[1]
if not Path(__file__).with_name("surfaces").is_dir() and (_beside / "pyproject.toml").is_file():
    __path__.append(str(_beside))


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("meshtrace")
    return _attribute(name)
