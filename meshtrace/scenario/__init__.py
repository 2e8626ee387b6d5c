"""Link files: TOML to a link, a sea and run options, and back.

A scenario is everything that one run depends on. This is the only package that joins the core
with `meshtrace.surfaces`, by late imports.
"""

from meshtrace.engine.setup.options import Meshing, Run
from meshtrace.scenario.files import KEYS, parse_setting
from meshtrace.scenario.model import Scenario
from meshtrace.scenario.parts import DEFAULT_WIND_SPEED
from meshtrace.scenario.seas import MeshFile

__all__ = [
    "DEFAULT_WIND_SPEED",
    "KEYS",
    "MeshFile",
    "Meshing",
    "Run",
    "Scenario",
    "parse_setting",
]
