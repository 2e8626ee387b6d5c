"""Visualisation: 3D scenes, movies, web pages, files for ParaView, and plots of results.

Everything here needs the `viz` extra; modules load when a name is first used. Functions taken from
here refuse arguments that do not match their annotations.
"""

from importlib.util import find_spec
from inspect import isfunction
from typing import Any

from meshtrace.errors import installing
from meshtrace.lazy import attach

for _package in ("matplotlib", "pyvista", "trame_client", "imageio"):
    if not find_spec(_package):
        raise ImportError(f"viz: {_package} is not installed: {installing('viz')}", name=_package)

_attribute, __dir__, __all__ = attach(__name__, __file__)


def __getattr__(name: str) -> Any:
    value = _attribute(name)
    if isfunction(value):
        from meshtrace.checks import check_call

        value = check_call(value, all_named=True)
    globals()[name] = value  # lazy_loader keeps the function itself
    return value
