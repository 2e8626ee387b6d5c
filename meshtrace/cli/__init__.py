"""The command line, one module for each command.

Heavy imports happen inside the commands, so that --help is quick.
"""

from meshtrace.cli import (
    bench,
    ber,
    compare,
    converge,
    coverage,
    explore,
    figures,
    new,
    plot,
    run,
    series,
    sweep,
    validate,
    view,
)
from meshtrace.cli.app import app

__all__ = [
    "app",
    "bench",
    "ber",
    "compare",
    "converge",
    "coverage",
    "explore",
    "figures",
    "main",
    "new",
    "plot",
    "run",
    "series",
    "sweep",
    "validate",
    "view",
]


def main() -> None:
    """Run the command line and exit."""
    app(prog_name="meshtrace")
