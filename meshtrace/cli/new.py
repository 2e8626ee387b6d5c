"""`meshtrace new`: a link file to begin with."""

from __future__ import annotations

import typer

from meshtrace.cli.app import app
from meshtrace.cli.console import scenario_of
from meshtrace.cli.options import LinkFile, Settings, Trust, Wind


@app.command()
def new(
    link: LinkFile = None, wind: Wind = None, settings: Settings = None, trust: Trust = False
) -> None:
    """Print a complete link file with a note on every key.

    Redirect it to a file: meshtrace new > link.toml
    """
    typer.echo(scenario_of(link, settings, wind, trust).to_toml(notes=True), nl=False)
