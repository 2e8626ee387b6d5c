"""The command line, one module for each command.

Heavy imports happen inside the commands, so that --help is quick.
"""

from meshtrace.cli import bench, ber, converge, figures, run, series, sweep, validate, view, warm
from meshtrace.cli.app import app

__all__ = [
    "app",
    "bench",
    "ber",
    "converge",
    "figures",
    "main",
    "run",
    "series",
    "sweep",
    "validate",
    "view",
    "warm",
]


def main() -> None:
    """Run the command line and exit."""
    app(prog_name="meshtrace")
