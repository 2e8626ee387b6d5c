"""The command line; `commands.py` has the table of the commands that run a study.

Heavy imports happen inside the commands, so that --help is quick.
"""

from meshtrace.cli import tools  # noqa: F401, the commands join the application
from meshtrace.cli.commands import app

__all__ = ["app"]
