"""Link files: TOML to a link, a sea and run options, and back.

A scenario is everything that one run depends on. This is the only package that joins the core
with `meshtrace.surfaces`, by late imports.
"""

from .errors import LARGEST, ScenarioError
from .files import KEYS, parse_setting
from .model import Scenario
from .options import Run, Sampling
from .parts import DEFAULT_WIND_SPEED
from .seas import MOST_FACTORS, MOST_VERTICES, MeshFile

__all__ = [
    "DEFAULT_WIND_SPEED",
    "KEYS",
    "LARGEST",
    "MOST_FACTORS",
    "MOST_VERTICES",
    "MeshFile",
    "Run",
    "Sampling",
    "Scenario",
    "ScenarioError",
    "parse_setting",
]
