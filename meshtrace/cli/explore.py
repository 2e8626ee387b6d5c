"""`meshtrace explore`: a link in the browser, with controls and live results."""

from __future__ import annotations

from typer import Option

from meshtrace.cli.app import app
from meshtrace.cli.console import scenario_of
from meshtrace.cli.options import LinkFile, Settings, Trust, Wind


@app.command()
def explore(
    link: LinkFile = None,
    host: str = Option(
        "127.0.0.1", metavar="ADDRESS", help="Address to listen on; default: this machine only."
    ),
    port: int = Option(8080, metavar="N", min=0, max=65_535, help="Port; 0 for a free one."),
    browser: bool = Option(True, "--browser/--no-browser", help="Open the page in a browser."),
    wind: Wind = None,
    settings: Settings = None,
    trust: Trust = False,
) -> None:
    """Explore a link in the browser: move its parts and see gain, rays, fading and coverage."""
    from meshtrace.explorer.launch import explore as start

    scenario = scenario_of(link, settings, wind, trust)
    title = "the link of the paper" if link is None else link.name
    start(scenario, host=host, port=port, open_browser=browser, title=title)
