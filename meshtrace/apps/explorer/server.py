"""Server of the explorer: a page and a session for every browser that opens it."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import sys
import webbrowser
from contextlib import suppress
from threading import Thread
from typing import Any

from aiohttp import web
from yarl import URL

from meshtrace.apps.explorer.page import Page, guard, new_token
from meshtrace.errors import Described, Refused, one_line, require_whole
from meshtrace.scenario import Scenario

_LONGEST_END = 20.0  # of the sessions, for whose connections aiohttp waits [s]

MOST_SESSIONS = 16
"""Open sessions beyond which new browsers are turned away."""


class Explorer:
    """Web server that opens a separate session for each visit with a valid token.

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

    def __init__(self, scenario: Scenario, title: str, host: str, port: int) -> None:
        self._scenario, self._title, self._host = scenario, title, host
        require_whole(port, 0, 65_535, "port")
        self._wanted_port = port
        self._token = new_token()
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
        """Address of a session, with its access token."""
        address = URL.build(scheme="http", host=self._host, port=self.port, path="/")
        return str(address.with_query(token=self._token))

    async def start(self) -> None:
        """Start to listen.

        Raises
        ------
        Refused
            If the address cannot be listened on.
        """
        # trame reads the arguments of the process and compresses traffic within this machine
        os.environ.setdefault("TRAME_ARGS", "")
        os.environ.setdefault("WSLINK_WS_COMPRESS", "0")
        app = web.Application()
        app.router.add_get("/", self._open, allow_head=False)
        guard(app, self._host, self._token, {"/"})
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
        with suppress(TimeoutError):
            async with asyncio.timeout(_LONGEST_END):  # browsers that do not close
                for page in self.pages:
                    await page.server.stop()
                await asyncio.gather(*self._tasks.values(), return_exceptions=True)
        for page in self._tasks:
            page.session.close()
            # no bound: Python joins its threads in any case, and a step is a simulation of seconds
            await asyncio.to_thread(page.session.join)
        if self._runner is not None:
            await self._runner.cleanup()

    async def _open(self, request: web.Request) -> web.Response:
        """Create a session and redirect the browser to its page."""
        async with self._opening:  # trame starts one server at a time
            self._tasks = {page: self._tasks[page] for page in self.pages}
            # each session has threads, a scene and a simulation of its own
            if len(self._tasks) >= MOST_SESSIONS:
                raise web.HTTPServiceUnavailable(text=f"{MOST_SESSIONS} sessions are open")
            page = Page(self._scenario, self._title, self.url)
            try:
                self._tasks[page] = await page.start(self._host)
            except RuntimeError as error:
                raise web.HTTPServiceUnavailable(text=f"{error}\n") from error
        raise web.HTTPFound(page.url(request.url))


async def serve(explorer: Explorer, open_browser: bool) -> None:
    """Serve until cancelled or terminated."""
    # a thread at work holds the interpreter for 5 ms by default, which moved controls would feel
    sys.setswitchinterval(5e-4)
    loop, terminated = asyncio.get_running_loop(), asyncio.Event()
    loop.set_exception_handler(_report)
    with suppress(ValueError):  # another thread than the main one
        # not `add_signal_handler`, which the loops of Windows lack
        signal.signal(signal.SIGTERM, lambda *_: loop.call_soon_threadsafe(terminated.set))
    messages = logging.StreamHandler()
    messages.setFormatter(_OneLine())
    messages.addFilter(_of_open_browsers)
    logging.basicConfig(handlers=[messages])
    logging.getLogger("wslink").setLevel(logging.CRITICAL + 1)  # the page shows its errors
    await explorer.start()
    print(f"explorer at {explorer.url} (Ctrl-C ends it)", flush=True)
    if open_browser:
        # some browsers, those of a terminal or of BROWSER, return when they are closed
        Thread(target=webbrowser.open, args=(explorer.url,), daemon=True).start()
    try:
        await terminated.wait()  # no bound: a server
    finally:
        await explorer.stop()
    print("explorer ended: terminated", file=sys.stderr, flush=True)


class _OneLine(logging.Formatter):
    """Format a message and its exception as one line."""

    def format(self, record: logging.LogRecord) -> str:
        error = record.exc_info[1] if record.exc_info else None
        reason = f": {type(error).__name__}: {error}" if error else ""
        return one_line(f"{record.levelname.lower()}: {record.getMessage()}{reason}")


def _report(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Report an error of a task, unless a browser has just been closed."""
    if not isinstance(context.get("exception"), ConnectionResetError):
        loop.default_exception_handler(context)


def _of_open_browsers(record: logging.LogRecord) -> bool:
    """Return False for a message about a failed write to a closed browser."""
    return not (record.exc_info and isinstance(record.exc_info[1], ConnectionResetError))
