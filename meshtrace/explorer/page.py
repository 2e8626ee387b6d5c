"""Page of one user of the explorer: a trame server that shows a session and sends its moves."""

from __future__ import annotations

import asyncio
import base64
import functools
import io
import logging
import uuid
from pathlib import Path
from typing import Any

import numpy as np
from aiohttp import web
from matplotlib.colors import to_hex
from trame.app.core import AVAILABLE_SERVERS, get_server
from trame_vtk.modules.vtk import HELPERS_PER_SERVER
from yarl import URL

from meshtrace.engine.paths import PhotonPaths
from meshtrace.errors import Refused, one_line
from meshtrace.explorer import code, layout, readings, stages
from meshtrace.explorer.controls import BY_NAME, CHOICES, State
from meshtrace.explorer.door import guard, new_token, policy
from meshtrace.explorer.scene import LiveScene
from meshtrace.explorer.session import STAGES, Session
from meshtrace.results.coverage import CoverageMap
from meshtrace.scenario import Scenario

_ASSETS = Path(__file__).with_name("assets")
_SCENE_PERIOD = 0.05  # shortest time between two scenes while a control moves [s]
_FRAME_PERIOD = 0.1  # of the running sea [s]
_REST = 0.5  # time without a move after which controls rest [s]
_IDLE = 600  # time without a browser after which a session ends [s]


class Page:
    """Trame server of one session.

    Parameters
    ----------
    scenario : Scenario
        Link at the start.
    title : str
        Name of the link.
    """

    def __init__(self, scenario: Scenario, title: str) -> None:
        self.server = get_server(f"meshtrace-{uuid.uuid4().hex}", client_type="vue3")
        self.server.enable_module(
            {
                "serve": {"__meshtrace": str(_ASSETS)},
                "scripts": ["__meshtrace/page.js"],
                "styles": ["__meshtrace/page.css"],
                "vue_use": ["meshtrace"],
            }
        )
        self.session = Session(scenario, self._answered)
        self.scene = LiveScene(self.session.state)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._scene_due: asyncio.TimerHandle | None = None
        self._resync: asyncio.TimerHandle | None = None
        self._scene_time = 0.0
        self._running: asyncio.Task[None] | None = None
        self._token = new_token()
        self._browsers = 0
        self._fill(title)
        self.view = layout.build(self.server, self.scene.plotter.render_window, self, scenario.link)
        self.server.state.change(*BY_NAME, *CHOICES)(self._moved)
        self.server.state.change("playing")(self._play_or_pause)
        self.server.controller.on_exception.add(self._tell)

    async def start(self, host: str) -> asyncio.Task[Any]:
        """Start to serve on a free port; return the task that ends with the session."""
        self._loop = asyncio.get_running_loop()
        self.server.cli.set_defaults(authKey=self._token)
        self.server.controller.on_server_bind.add(functools.partial(self._bind, host))
        options: Any = {"port": 0, "host": host, "timeout": _IDLE, "exec_mode": "coroutine"}
        quiet: Any = {"show_connection_info": False, "open_browser": False, "thread": True}
        task = asyncio.create_task(self.server.start(**options, **quiet, disable_logging=True))
        task.add_done_callback(self._end)
        await self.server.ready
        self.session.answer_now()
        return task

    @property
    def port(self) -> int:
        """Port of the page."""
        return int(self.server.port)

    def url(self, visited: URL) -> URL:
        """Return the address of the page, on the host of the visited one."""
        return visited.with_port(self.port).with_path("/index.html").with_query(token=self._token)

    def _end(self, _: Any) -> None:
        """Release the session, its running sea and its scene."""
        self.session.close()
        if self._running is not None:
            self._running.cancel()
        for due in (self._scene_due, self._resync):
            if due is not None:
                due.cancel()
        self._loop = None
        self.scene.close()
        AVAILABLE_SERVERS.pop(self.server.name, None)
        HELPERS_PER_SERVER.pop(self.server.name, None)

    def _bind(self, host: str, web_server: Any) -> None:
        """Add the door and the answers that need it: the page, and the way to its connection."""

        async def index(request: web.Request) -> web.Response:
            html = Path(self.server.server_options.content, "index.html").read_text("utf-8")
            place = f'<html data-session-manager-url="paraview/?token={self._token}"'
            headers = {"Content-Security-Policy": policy(request, html)}
            text = html.replace("<html", place, 1)
            return web.Response(text=text, content_type="text/html", headers=headers)

        async def session(request: web.Request) -> web.Response:
            address = f"ws://{request.host}/ws?token={self._token}"
            return web.json_response({"sessionURL": address, "secret": self._token})

        @web.middleware
        async def count(request: web.Request, handler: Any) -> web.StreamResponse:
            if request.path != "/ws":
                return await handler(request)
            self._browsers += 1
            try:
                return await handler(request)
            finally:
                self._browsers -= 1
                if not self._browsers and self._loop is not None:  # nobody sees the sea
                    with self.server.state as page:
                        page.playing = False

        web_server.app.router.add_get("/index.html", index)
        web_server.app.router.add_post("/paraview/", session)
        guard(web_server.app, host, self._token, {"/", "/index.html", "/paraview/", "/ws"})
        web_server.app.middlewares.append(count)

    def _tell(self, error: BaseException) -> None:
        """Show an error as a line in the page; an internal one on the console, too."""
        text = str(error)
        if not isinstance(error, Refused):
            text = f"internal error: {type(error).__name__}: {one_line(error)}"
            logging.getLogger(__name__).error(text)
        with self.server.state as page:
            page.refused = text

    def show_text(self, kind: str) -> None:
        """Show the link as TOML or as Python, to be copied."""
        make = {"TOML": code.as_toml, "Python": code.as_python}[kind]
        self.server.state.update(
            {"text_title": kind, "text": make(self.session.state.scenario), "text_shown": True}
        )

    def make_map(self) -> None:
        """Start the coverage map of the present state."""
        self.session.make_map()
        self._refresh()

    def seek(self, time: float) -> None:
        """Show the sea at a time [s]."""
        self.session.show_time(max(float(time), 0.0))
        self._show_scene()

    def _fill(self, title: str) -> None:
        """Set all variables of the page."""
        state, page = self.session.state, self.server.state
        page.trame__title = "meshtrace explorer"
        page.client_only("shot", "framed")
        page.update({**state.settings, "choices": {k: list(v) for k, v in CHOICES.items()}})
        page.update({"title": title, "refused": "", "text": "", "text_title": "", "shot": None})
        page.update(dict.fromkeys(("playing", "framed", "text_shown"), False))
        self._refresh()
        self._refresh_views()

    def _moved(self, **_: Any) -> None:
        """Move the state to the changed controls, and reset the controls of refused values."""
        page, now = self.server.state, self.session.state.settings
        shown = {key: _number(page[key]) if key in BY_NAME else page[key] for key in now}
        moves = {key: value for key, value in shown.items() if value != now[key]}
        if not moves:
            return
        refusals = self._refusals(moves)
        page.refused = "; ".join(map(str, refusals))
        if refusals:
            page.update(self.session.state.settings)
        if refusals or self._resync is not None:
            self._resync_soon()
        self._refresh()
        self._scene_soon()

    def _refusals(self, moves: dict[str, Any]) -> list[Refused]:
        """Move all controls together, or else each that can; return the refusals of the others."""
        refusals = []
        try:
            self.session.move(moves, answer=False)  # the scene is first: it is ready sooner
        except Refused as error:
            if len(moves) == 1:
                return [error]
            for name, value in moves.items():
                refusals += self._refusals({name: value})
        return refusals

    def _resync_soon(self) -> None:
        """Send all controls once they rest.

        A value that a field sends while that of a refusal is on its way would be overwritten.
        """
        if self._resync is not None:
            self._resync.cancel()
        if self._loop is not None:
            self._resync = self._loop.call_later(_REST, self._send_controls)

    def _send_controls(self) -> None:
        self._resync = None
        self.server.force_state_push(*self.session.state.settings)

    def _scene_soon(self) -> None:
        """Update the scene once for all moves of a short time."""
        if self._loop is None or self._scene_due is not None:
            return
        wait = max(self._scene_time + _SCENE_PERIOD - self._loop.time(), 0.0)
        self._scene_due = self._loop.call_later(wait, self._show_scene)

    def _show_scene(self) -> None:
        """Update the scene and the views to the state, and start to answer it."""
        self._scene_due = None
        try:
            camera = self.scene.update(self.session.state)
            with self.server.state:
                self._show_light()
                if camera:
                    self.view.push_camera()
            self._scene_time = self._loop.time() if self._loop else 0.0
        except Refused:  # the answer reports it
            pass
        except Exception as error:
            self._tell(error)
        finally:
            self.session.answer_now()

    def _show_light(self) -> None:
        """Show the rays and the map of the state, or none, and refresh the views."""
        self.scene.show_rays(self._shown("rays", PhotonPaths))
        height = self.session.state.channel.link.receivers[0].center[2]
        self.scene.show_map(self._shown("map", CoverageMap), height)
        self.view.push_changes()
        self._refresh_views()

    def _shown(self, name: str, kind: type) -> Any:
        """Return the answer of a stage to the present state, or None if it is missing or failed."""
        found = self.session.answer(name)
        return found if self.session.fresh(name) and isinstance(found, kind) else None

    def _answered(self, name: str) -> None:
        """Show an answer; called in the thread of the work."""
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._show_answer, name)

    def _show_answer(self, name: str) -> None:
        try:
            with self.server.state:
                self._refresh()
                if name in ("rays", "map") and self.session.fresh(name) and not self._running:
                    self._show_light()
                if not name:
                    self.view.update()
        except Exception as error:
            self._tell(error)

    def _refresh(self) -> None:
        """Set the readings, the charts and the marks of stale answers."""
        session, page = self.session, self.server.state
        page.stale = {name: not session.fresh(name) for name in STAGES}
        page.working = session.working
        page.reading = readings.gain_reading(session)
        page.fading = readings.fading_reading(session)
        page.caption = readings.caption(session)
        page.map_note = readings.map_note(session)

    def _refresh_views(self) -> None:
        """Set the side view, the plan, the time and the colour bar."""
        page, state = self.server.state, self.session.state
        page.time = round(state.time, 3)
        page.update(layout.views(state, self.scene))
        found = self._shown("map", CoverageMap)
        page.map = None if found is None else _map_image(found)

    def _play_or_pause(self, playing: bool = False, **_: Any) -> None:
        if self._loop is None or bool(self._running) == playing:
            return
        if playing:
            self._running = self._loop.create_task(self._run())

    async def _run(self) -> None:
        """Let the sea run in natural time until paused, in a loop over the series."""
        loop, session = asyncio.get_running_loop(), self.session
        start = loop.time() - session.state.time
        try:
            while self.server.state.playing:
                begun = loop.time()
                state = session.show_time((begun - start) % stages.DURATION)
                paths = await loop.run_in_executor(None, _paths_at, state)
                if session.state != state:  # moved meanwhile
                    await asyncio.sleep(0)
                    continue
                self.scene.update(state, running=True)
                with self.server.state as page:
                    self.scene.show_rays(paths)
                    page.time = round(state.time, 3)
                    page.update(layout.views(state, self.scene))
                    page.reading = readings.gain_reading(session, running=True)
                    self.view.push_changes()
                await asyncio.sleep(max(_FRAME_PERIOD - (loop.time() - begun), 0.005))
        except Exception as error:
            self._tell(error)
        finally:
            self._running = None
        self.seek(session.state.time)


def _paths_at(state: State) -> PhotonPaths | None:
    return stages.unless_refused(lambda: next(stages.rays(state, lambda *_: None)))


def _number(value: Any) -> Any:
    """Return the number of a text field, or its text."""
    try:
        return float(value)
    except (TypeError, ValueError):
        return value


def _map_image(found: CoverageMap) -> dict[str, Any]:
    """Return a map as a picture with its limits [m], and its peak."""
    from matplotlib import colormaps
    from PIL import Image

    share = found.gain / max(float(found.gain.max()), 1e-300)
    shades = (255.0 * colormaps["viridis"](share.T[::-1])).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(shades).save(file, "PNG")
    half = 0.5 * (found.x[1] - found.x[0])
    low, high = float(found.x[0] - half), float(found.x[-1] + half)
    i, j = np.unravel_index(int(found.gain.argmax()), found.gain.shape)
    return {
        "url": f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}",
        "x0": low, "x1": high, "y0": low, "y1": high,
        "peak": f"{found.gain[i, j]:.2e} at ({found.x[i]:.1f}, {found.y[j]:.1f}) m",
        "colors": ", ".join(to_hex(colormaps["viridis"](v)) for v in np.linspace(0, 1, 8)),
    }  # fmt: skip
