"""Explorer of a link in the browser: its start from Python, and the page with its answers."""

from __future__ import annotations

import asyncio

from meshtrace import MeshSource
from meshtrace.engine.setup.options import resolve
from meshtrace.errors import extra
from meshtrace.link import Link
from meshtrace.scenario import Scenario
from meshtrace.scenario.seas import wind_of

LOCAL = "127.0.0.1"


def explore(
    link: Link | Scenario | None = None,
    surface: MeshSource | None = None,
    *,
    host: str = LOCAL,
    port: int = 8080,
    open_browser: bool = True,
    title: str = "link",
) -> None:
    """Explore a link in the browser until interrupted.

    Parameters
    ----------
    link : Link or Scenario, optional
        Link at the start; the paper's by default.
    surface : MeshSource, optional
        The sea; by default that of the scenario, or a JONSWAP sea of the link's wind.
    host : str
        Address to listen on; the default is reached from this machine only.
    port : int
        Port of the first page, 0 for a free one.
    open_browser : bool
        Open the page in a browser.
    title : str
        Name shown in the page.

    Raises
    ------
    Refused
        If the link or the sea cannot be written as a link file, the address is in use, or the
        packages of the extra "explore" are missing.

    Notes
    -----
    Every browser, and every visit of the first page, has a separate state. The address that is
    printed holds a token; without it, from another host or another origin, no page is opened.
    """
    with extra("explore", "explore"):
        from meshtrace.apps.explorer.server import Explorer, serve
    explorer = Explorer(scenario_of(link, surface), title, host, port)
    try:
        asyncio.run(serve(explorer, open_browser))
    except KeyboardInterrupt:
        pass


def scenario_of(link: Link | Scenario | None, surface: MeshSource | None = None) -> Scenario:
    """Return the scenario of a link with its sea.

    Raises
    ------
    Refused
        If it cannot be written as a link file.
    """
    if link is None:
        link = Scenario.from_toml("")
    if isinstance(link, Scenario) and surface is None:
        scenario = link
    else:
        case = resolve(link, surface)
        wind = wind_of(case.link, case.surface)
        scenario = Scenario(wind_speed=wind, link=case.link, surface=case.surface)
    Scenario.from_config(scenario.to_config())
    return scenario
