"""Link files: TOML to a link, a sea and run options, and back.

A scenario is everything that one run depends on. This is the only package that joins the core
with `meshtrace.surfaces`, by late imports.
"""

from meshtrace.engine.setup.options import Meshing as Meshing
from meshtrace.engine.setup.options import Run as Run
from meshtrace.scenario.files import KEYS as KEYS
from meshtrace.scenario.files import parse_setting as parse_setting
from meshtrace.scenario.model import Scenario as Scenario
from meshtrace.scenario.parts import DEFAULT_WIND_SPEED as DEFAULT_WIND_SPEED
from meshtrace.scenario.seas import MeshFile as MeshFile
