"""Server of the explorer: a page and a session for every browser that opens it."""

from __future__ import annotations

import asyncio
import os
import webbrowser
from typing import Any

from aiohttp import web

from meshtrace.errors import Described, Refused, require_whole
from meshtrace.explorer.page import Page
from meshtrace.link import Link
from meshtrace.mesh import MeshSource
from meshtrace.scenario import Scenario
from meshtrace.scenario.seas import wind_of
from meshtrace.transport.case import resolve

LOCAL = "127.0.0.1"
MOST_SESSIONS = 16
"""Open sessions beyond which new browsers are turned away."""


class Explorer:
    """Web server that opens a page of its own for every visit.

    Parameters
    ----------
    scenario : Scenario
        Link that every page starts with.
    title : str
        Name of the link.
    host : str
        Address to listen on.
    port : int
        Port of the first page, 0 for a free one. Each session is served on a further free port.
    """

    def __init__(
        self, scenario: Scenario, title: str = "link", host: str = LOCAL, port: int = 0
    ) -> None:
        self._scenario, self._title, self._host = scenario, title, host
        require_whole(port, 0, 65_535, "port")
        self._wanted_port = port
        self._runner: web.AppRunner | None = None
        self._tasks: dict[Page, asyncio.Task[Any]] = {}
        self._opening = asyncio.Lock()
        self.port = 0

    @property
    def pages(self) -> list[Page]:
        """Pages of the open sessions."""
        return [page for page, task in self._tasks.items() if not task.done()]

    @property
    def url(self) -> str:
        """Address that opens a session."""
        return f"http://{self._host}:{self.port}/"

    async def start(self) -> None:
        """Start to listen.

        Raises
        ------
        Refused
            If the address cannot be listened on.
        """
        # trame reads the arguments of the process and compresses what stays on this machine
        os.environ.setdefault("TRAME_ARGS", "")
        os.environ.setdefault("WSLINK_WS_COMPRESS", "0")
        app = web.Application()
        app.router.add_get("/", self._open)
        self._runner = web.AppRunner(app)
        await self._runner.setup()
        try:
            site = web.TCPSite(self._runner, self._host, self._wanted_port)
            await site.start()
        except OSError as error:
            await self._runner.cleanup()
            address = Described(f"{self._host}:{self._wanted_port}, {error.strerror}")
            raise Refused("port", address, "a free port, or 0") from error
        self.port = self._runner.addresses[0][1]

    async def stop(self) -> None:
        """Stop to listen and end all sessions."""
        for page in self.pages:
            await page.server.stop()
        if self._tasks:
            await asyncio.gather(*self._tasks.values(), return_exceptions=True)
        if self._runner is not None:
            await self._runner.cleanup()

    async def _open(self, request: web.Request) -> web.Response:
        """Make a session and send the browser to its page."""
        async with self._opening:  # trame starts one server at a time
            self._tasks = {page: self._tasks[page] for page in self.pages}
            if len(self._tasks) >= MOST_SESSIONS:
                raise web.HTTPServiceUnavailable(text=f"{MOST_SESSIONS} sessions are open")
            page = Page(self._scenario, self._title)
            self._tasks[page] = await page.start(self._host)
        raise web.HTTPFound(f"http://{request.url.host}:{page.port}/index.html")


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
    Every browser, and every visit of the first page, has a state of its own.
    """
    scenario = scenario_of(link, surface)
    try:
        asyncio.run(_serve(Explorer(scenario, title, host, port), open_browser))
    except KeyboardInterrupt:
        pass


async def _serve(explorer: Explorer, open_browser: bool) -> None:
    await explorer.start()
    print(f"explorer at {explorer.url} (Ctrl-C ends it)", flush=True)
    if open_browser:
        webbrowser.open(explorer.url)
    try:
        await asyncio.Event().wait()
    finally:
        await explorer.stop()


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
