"""Embree-backed triangle-mesh Monte Carlo ray tracing of light that crosses a wavy sea.

`dir` lists the names of most programs; all others are in the groups, such as `optics.Petzold`.
"""

from importlib import import_module
from pathlib import Path
from typing import Any

from meshtrace.lazy import attach

# in a checkout `surfaces/` and `viz/` lie beside this folder; a wheel has them inside
if not Path(__file__).with_name("surfaces").is_dir():
    __path__.append(str(Path(__file__).parents[1]))

_attribute, _, _ = attach(__name__, __file__)

__all__ = [  # noqa: RUF022, by subject
    # one link, many surfaces, many places
    "simulate", "ensemble", "time_series", "coverage_map", "background", "explore",
    # descriptions
    "Link", "Led", "Receiver", "Water", "JonswapSea", "Meshing", "Scenario", "Refused",
    # groups of further names
    "sources", "receivers", "optics", "surfaces", "daylight", "uav", "options",
    "results", "fading", "comms", "studies", "apps", "viz",
]  # fmt: skip


def __dir__() -> list[str]:
    return sorted(__all__)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("meshtrace")
    if name == "options":
        return import_module("meshtrace.engine.setup.options")
    return _attribute(name)
