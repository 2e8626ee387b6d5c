"""The command line, one module for each command.

Heavy imports happen inside the commands, so that --help is quick.
"""

from meshtrace.cli import (  # noqa: F401, the commands join the application
    bench,
    ber,
    compare,
    converge,
    coverage,
    explore,
    figures,
    new,
    optimize,
    plot,
    run,
    sensitivity,
    series,
    sweep,
    validate,
    view,
    warm,
)
from meshtrace.cli.app import app

__all__ = ["app"]
