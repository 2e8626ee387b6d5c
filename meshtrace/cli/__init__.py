"""The command line: commands that run a study are in `studies.py`, others in `tools.py`, `view.py`.

Heavy imports happen inside the commands, so that --help is quick.
"""

from meshtrace.cli import studies, tools, view  # noqa: F401, the commands join the application
from meshtrace.cli.application import app

__all__ = ["app"]
