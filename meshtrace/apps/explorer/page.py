"""Page of one user of the explorer: a trame server that shows a session and sends its moves.

A page of any site can send requests to servers of this machine. Those that carry another host
(a name that a stranger points at this machine) or another origin are turned away, and a session is
opened, read and steered with the token of its address alone.
"""

from __future__ import annotations

import asyncio
import base64
import functools
import hashlib
import logging
import math
import re
import secrets
import socket
import uuid
from collections.abc import Collection
from contextlib import suppress
from ipaddress import ip_address
from pathlib import Path
from typing import Any

from aiohttp import web
from trame.app.core import AVAILABLE_SERVERS, get_server
from yarl import URL

from meshtrace.apps.explorer import controls, readings, stages
from meshtrace.apps.explorer.controls import BY_NAME, CHOICES, STARTS, State, groups
from meshtrace.apps.explorer.scene import COLORS, LiveScene
from meshtrace.apps.explorer.session import STAGES, Failed, Session
from meshtrace.errors import Refused, one_line
from meshtrace.scenario import Scenario
from meshtrace.viz import live

_ASSETS = Path(__file__).with_name("assets")
_TEMPLATE = (_ASSETS / "page.html").read_text(encoding="utf-8")
_SCENE_PERIOD = 0.05  # shortest time between two scenes while a control moves [s]
_FRAME_PERIOD = 0.1  # shortest time between two frames of the running sea [s]
_PATIENCE = 2.0  # longest wait for the browser to draw such a frame [s]
_REST = 0.5  # time without a move after which controls are taken to be at rest [s]
_FIXED_ZOOM = re.compile(r",\s*maximum-scale=1,minimum-scale=1")  # users may enlarge the page
_LONGEST_START = 30.0  # longest wait for a server, which starts in a tenth of a second [s]
_IDLE = 600  # time without a browser after which a session ends [s]

_POLICY = (
    "default-src 'self'; connect-src 'self' data: blob: ws://{host}; img-src 'self' data: blob:; "
    "font-src 'self' data:; style-src 'self' 'unsafe-inline'; "
    "script-src 'self' 'unsafe-eval' {scripts}; "  # Vue compiles the template in the browser
    "object-src 'none'; base-uri 'self'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
_INLINE = re.compile(r"<script>(.*?)</script>", re.DOTALL)


class Page:
    """Trame server of one session.

    Parameters
    ----------
    scenario : Scenario
        Link at the start.
    title : str
        Name of the link.
    base : str
        Address that opens a session, before the fragment with the moved controls.
    """

    def __init__(self, scenario: Scenario, title: str, base: str) -> None:
        self.server = get_server(f"meshtrace-{uuid.uuid4().hex}", client_type="vue3")
        self.server.enable_module(
            {
                "serve": {"__meshtrace": str(_ASSETS), "__scene": str(live.ASSETS)},
                "scripts": ["__scene/shaders.js", "__scene/scene.js", "__meshtrace/page.js"],
                "styles": ["__scene/scene.css", "__meshtrace/page.css"],
                "vue_use": ["meshtrace"],
            }
        )
        self.session = Session(scenario, self._answered)
        self._given, self._title = scenario, title
        self.scene = LiveScene(self.session.state)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._scene_due: asyncio.TimerHandle | None = None
        self._resync: asyncio.TimerHandle | None = None
        # refused controls, and whether an accepted value has followed (see `_resync_soon`)
        self._unsure: dict[str, bool] = {}
        self._scene_time = 0.0  # when the scene was last updated, by the clock of the loop [s]
        self._running: asyncio.Task[None] | None = None
        self._drawn = asyncio.Event()
        self._token = new_token()
        self._browsers = 0
        self._state_a: tuple[State, dict[str, Any]] | None = None  # compared state
        self._start_a = ""  # name of its link to start from
        self._design: asyncio.Task[None] | None = None
        self._quiet: asyncio.Task[None] | None = None
        self._designed: State | None = None  # state whose design is shown
        self._fill(base)
        for action in (self.begin, self.compare, self.swap, self.restore, self.show_text,
                       self.design, self.scene_ready, self.drawn, self.seek,
                       self.make_map):  # fmt: skip
            self.server.trigger(action.__name__)(action)
        self.server.state.change(*BY_NAME, *CHOICES)(self._moved)
        self.server.state.change("playing")(self._play_or_pause)
        self.server.controller.on_exception.add(self._report)

    async def start(self, host: str) -> asyncio.Task[Any]:
        """Start to serve on a free port; return the task that ends with the session.

        Raises
        ------
        RuntimeError
            If the server fails, or does not start in time: without this bound later visits, which
            wait for the start, would hang.
        """
        self._loop = asyncio.get_running_loop()
        self.server.cli.set_defaults(authKey=self._token)
        self.server.controller.on_server_bind.add(functools.partial(self._bind, host))
        serving: Any = self.server.start(
            port=0, host=host, timeout=_IDLE, exec_mode="coroutine", thread=True,
            show_connection_info=False, open_browser=False, disable_logging=True,
        )  # fmt: skip
        task = asyncio.create_task(serving)
        task.add_done_callback(self._end)
        ready = self.server.ready
        first = asyncio.FIRST_COMPLETED
        await asyncio.wait({task, ready}, timeout=_LONGEST_START, return_when=first)
        error = next((work.exception() for work in (ready, task) if work.done()), None)
        if error is not None or not ready.done():
            task.cancel()
            reason = f": {one_line(error)}" if error else f" within {_LONGEST_START:.0f} s"
            raise RuntimeError(f"no page{reason}") from error
        self.session.working = "gain"
        self._quiet = asyncio.create_task(self._begin_quietly())
        return task

    async def _begin_quietly(self) -> None:
        """Show the sea at a quiet time, then start the first answer."""
        time = self._given.meshing.time
        try:
            time = await asyncio.to_thread(stages.quiet_time, self._given)
        except Exception as error:
            self._report(error)
        self._given = controls.begun_at(self._given, time)
        if not self.server.state.start:
            self.session.begin_at(time)
        with self.server.state:
            self._refresh()
        if self._running is None:  # a running sea shows itself
            self._show_scene()

    @property
    def port(self) -> int:
        """Port of the page."""
        return int(self.server.port)

    def url(self, visited: URL) -> URL:
        """Return the address of the page, on the host of the visited one."""
        return visited.with_port(self.port).with_path("/index.html").with_query(token=self._token)

    def _end(self, _: Any) -> None:
        """Release the session and cancel all work for it."""
        self.session.close()
        for due in (self._running, self._design, self._quiet, self._scene_due, self._resync):
            if due is not None:
                due.cancel()
        self._loop = None
        AVAILABLE_SERVERS.pop(self.server.name, None)

    def _bind(self, host: str, web_server: Any) -> None:
        """Install access checks, and routes for the page and the address of its connection."""

        async def index(request: web.Request) -> web.Response:
            html = Path(self.server.server_options.content, "index.html").read_text("utf-8")
            # trame asks this address for its connection; it would leave the token of the page out
            html_start = f'<html data-session-manager-url="paraview/?token={self._token}"'
            headers = {"Content-Security-Policy": policy(request, html)}
            text = _FIXED_ZOOM.sub("", html.replace("<html", html_start, 1))
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
                if not self._browsers and self._loop is not None:  # no browser shows the sea
                    with self.server.state as page:
                        page.playing = False

        web_server.app.router.add_get("/index.html", index)
        web_server.app.router.add_post("/paraview/", session)
        guard(web_server.app, host, self._token, {"/", "/index.html", "/paraview/", "/ws"})
        web_server.app.middlewares.append(count)

    def _report(self, error: BaseException) -> None:
        """Show an error as a line in the page; an internal one on the console, too."""
        if isinstance(error, ConnectionResetError):  # a browser was closed meanwhile
            return
        text = str(error)
        if not isinstance(error, Refused):
            text = f"internal error: {type(error).__name__}: {one_line(error)}"
            logging.getLogger(__name__).error(text)
        with self.server.state as page:
            page.refused = {"": text}

    def show_text(self, kind: str) -> None:
        """Show the link at the displayed time as TOML or Python text for copying."""
        make = {"TOML": readings.as_toml, "Python": readings.as_python}[kind]
        state = self.session.state
        text = make(controls.begun_at(state.scenario, state.time))
        self.server.state.update({"text_title": kind, "text": text, "text_shown": True})

    def make_map(self) -> None:
        """Start the coverage map of the present state."""
        self.session.make_map()
        self._refresh()

    def design(self) -> None:
        """Start a design of the present state in another process, or cancel the running one."""
        if self._design is not None:
            self._design.cancel()
        elif self._loop is not None:
            self._design = self._loop.create_task(self._show_design(self.session.state))

    async def _show_design(self, state: State) -> None:
        """Show the elapsed seconds until the design of a state is complete, then the design."""
        loop, page = asyncio.get_running_loop(), self.server.state
        start, work = loop.time(), asyncio.ensure_future(stages.design_of(state.scenario))
        shown = None
        try:
            while not work.done():
                with page:
                    page.designing = round(loop.time() - start)
                await asyncio.wait({work}, timeout=1.0)
            shown = readings.design_reading(work.result())
        except asyncio.CancelledError:
            work.cancel()
            await asyncio.wait({work})  # its process is killed
        except Refused as error:
            shown = {"problem": str(error)}
        except Exception as error:
            self._report(error)
        self._design = None
        with page:
            page.designing = None
            if shown is not None:
                self._designed, page.design = state, shown
            self._refresh()

    def seek(self, time: float) -> None:
        """Show the sea at a time [s]."""
        self.session.show_time(max(float(time), 0.0))
        self._show_scene()

    def scene_ready(self) -> None:
        """Send the whole scene to a page that has been loaded."""
        self.server.js_call("scene", "show", self.scene.parts)
        if self._state_a is not None:
            self.server.js_call("scene", "keep", self._state_a[1])

    def drawn(self) -> None:
        """Continue the running sea: a browser has drawn its last frame."""
        self._drawn.set()

    def compare(self) -> None:
        """Toggle the comparison with the present state as A."""
        self._keep(self._state_a is None)

    def swap(self) -> None:
        """Exchange the present state and state A."""
        if self._state_a is not None:
            before, start = self._state_a[0], self._start_a
            self._keep(True)
            begun = {"start": start} if start else {}
            self._restore(dict(before.moves) | {"time": before.time} | begun)

    def _keep(self, present: bool) -> None:
        """Make the present state state A, with its scene and readings; or end the comparison."""
        page, session = self.server.state, self.session
        self._state_a = (session.state, dict(self.scene.parts)) if present else None
        self._start_a = page.start
        reading, fading = readings.gain_reading(session), readings.fading_reading(session)
        page.kept = {"reading": reading, "fading": fading} if present else None
        self.server.js_call("scene", "keep", self._state_a[1] if self._state_a else None)
        self._refresh()

    def begin(self, name: str) -> None:
        """Show one of the links to start from."""
        self.restore({"start": name})

    def restore(self, values: dict[str, Any]) -> None:
        """Show the state of a link, from the view that frames it."""
        self.scene.frame_anew()
        self._restore(values)

    def _restore(self, values: dict[str, Any]) -> None:
        """Show the state with these values of moved controls and this time [s]."""
        values, page = dict(values), self.server.state
        known = str(values.get("start", "")) in STARTS
        page.start = values.pop("start") if known else ""  # another one is refused below
        page.title = STARTS[page.start]["title"] if page.start else self._title
        initial = controls.start_of(page.start) if page.start else self._given
        time = _number(values.pop("time", initial.meshing.time))
        self.session.begin(initial)
        refused = self._refused(values) if values else {}
        self._tell(refused)
        page.update(self.session.state.settings)
        self.seek(time if isinstance(time, float) and math.isfinite(time) else 0.0)
        self._refresh()

    def _fill(self, base: str) -> None:
        """Set all variables of the page."""
        state, page = self.session.state, self.server.state
        page.trame__title, page.trame__template_main = "meshtrace explorer", _TEMPLATE
        page.update(state.settings | {"title": self._title, "base": base, "colors": COLORS})
        page.update({"controls": groups(), "labels": readings.LABELS})
        page.update({"start": "", "starts": readings.starts()})
        page.update(dict.fromkeys(("text", "text_title"), "") | {"refused": {}})
        page.update(dict.fromkeys(("playing", "text_shown", "design_shown"), False))
        page.update(dict.fromkeys(("kept", "design", "designing")))
        self._refresh()
        self._refresh_views()

    def _moved(self, **_: Any) -> None:
        """Move the state to the changed controls, and reset the controls of refused values."""
        page, now = self.server.state, self.session.state.settings
        displayed = {key: _number(page[key]) if key in BY_NAME else page[key] for key in now}
        moves = {key: value for key, value in displayed.items() if value != now[key]}
        if not moves:
            return
        refused = self._refused(moves)
        self._tell(refused)
        settings = self.session.state.settings
        # to the page: all controls after a refusal, else those that a move of others has changed
        page.update(
            {k: v for k, v in settings.items() if refused or (k not in moves and v != displayed[k])}
        )
        unsure = refused.keys() | (moves.keys() & self._unsure.keys())
        self._unsure |= {name: name not in refused for name in unsure}
        if unsure:
            self._resync_soon()
        self._refresh()
        self._scene_soon()

    def _refused(self, moves: dict[str, Any]) -> dict[str, Refused]:
        """Move all controls at once or, if that is refused, one by one; return the refusals."""
        refused: dict[str, Refused] = {}
        try:
            self.session.move(moves, answer=False)  # `_show_scene` answers, after the scene
        except Refused as error:
            if len(moves) == 1:
                return dict.fromkeys(moves, error)
            for name, value in moves.items():
                refused |= self._refused({name: value})
        return refused

    def _tell(self, refused: dict[str, Refused]) -> None:
        """Show each refusal below its field, or over the scene if it has no field."""
        texts = {name: readings.refusal(name, error) for name, error in refused.items()}
        told = {name: text for name, text in texts.items() if name in BY_NAME}
        rest = "; ".join(text for name, text in texts.items() if name not in told)
        self.server.state.refused = told | ({"": rest} if rest else {})

    def _resync_soon(self) -> None:
        """Resend refused controls when they have come to rest, and again after their next value.

        That next value may cross with the reset of the field to its value before the refusal: the
        page then shows the reset, while the session has moved on.
        """
        if self._resync is not None:
            self._resync.cancel()
        if self._loop is not None:
            self._resync = self._loop.call_later(_REST, self._send_controls)

    def _send_controls(self) -> None:
        """Resend unconfirmed controls; forget controls with a later accepted value."""
        self._resync = None
        self.server.force_state_push(*self._unsure)
        self._unsure = {name: sure for name, sure in self._unsure.items() if not sure}

    def _scene_soon(self) -> None:
        """Update the scene once for all moves of a short time."""
        # an update that is due already shows the state of its own time
        if self._loop is None or self._scene_due is not None:
            return
        wait = max(self._scene_time + _SCENE_PERIOD - self._loop.time(), 0.0)
        self._scene_due = self._loop.call_later(wait, self._show_scene)

    def _show_scene(self) -> None:
        """Update the scene and the views to the state, and start to answer it."""
        self._scene_due = None
        try:
            self.scene.update(self.session.state)
            with self.server.state:
                self._show_light()
            self._scene_time = self._loop.time() if self._loop else 0.0
        except Refused:  # the answer of a stage reports the same refusal
            pass
        except Exception as error:
            self._report(error)
        finally:
            self.session.answer_now()

    def _show_light(self) -> None:
        """Show the complete rays and maps, and refresh the views."""
        self.scene.show_rays(self._shown("rays"))
        self.scene.show_map(self._shown("map"))
        self._push_scene()
        self._refresh_views()

    def _push_scene(self) -> None:
        """Send the parts of the scene that have changed to the open pages."""
        if changes := self.scene.changes():
            self.server.js_call("scene", "show", changes)

    def _shown(self, name: str) -> Any:
        """Return the answer of a stage to the present state; None if it is missing or failed."""
        answer = self.session.answer(name) if self.session.fresh(name) else None
        return None if isinstance(answer, Failed) else answer

    def _answered(self, name: str) -> None:
        """Show an answer; called in the thread of the work."""
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._show_answer, name)

    def _show_answer(self, name: str) -> None:
        try:
            with self.server.state:
                self._refresh()
                # a running sea has rays of its own
                if name in ("rays", "map") and self.session.fresh(name) and not self._running:
                    self._show_light()
        except Exception as error:
            self._report(error)

    def _refresh(self) -> None:
        """Set the readings, the charts and the marks of stale answers."""
        session, page = self.session, self.server.state
        outdated = self._designed is not None and self._designed != session.state.at(
            self._designed.time
        )
        page.stale = {name: not session.fresh(name) for name in STAGES} | {"design": outdated}
        page.update(session.state.limits)
        page.working = session.working
        page.reading = readings.gain_reading(session)
        page.fading = readings.fading_reading(session)
        page.influences = readings.influences(session)
        page.caption = readings.caption(session)
        page.map_note = readings.map_note(session)
        # what the address of the page holds: the time only where it is another
        page.moves, time = dict(session.state.moves), session.state.time
        if page.start:
            page.moves = {"start": page.start} | page.moves
        if time != session.state.initial.meshing.time:
            page.moves = page.moves | {"time": time}
        if self._state_a is not None:
            page.kept = page.kept | {
                "lines": readings.differences(self._state_a[0], session.state),
                "gain": readings.gain_difference(page.kept["reading"], page.reading),
            }

    def _refresh_views(self) -> None:
        """Set the side view, the plan, the time and the colour bar."""
        page, state = self.server.state, self.session.state
        page.time = round(state.time, 3)
        page.update(self.scene.views(state))
        coverage = self._shown("map")
        page.map = None if coverage is None else readings.map_image(coverage)

    def _play_or_pause(self, playing: bool = False, **_: Any) -> None:
        """Start the running sea; `_run` ends by itself once `playing` is false."""
        if playing and self._loop is not None and self._running is None:
            self._running = self._loop.create_task(self._run())

    async def _run(self) -> None:
        """Run the sea in real time until paused, repeating the time of the fading series."""
        loop, session = asyncio.get_running_loop(), self.session
        start = loop.time() - session.state.time
        try:
            while self.server.state.playing:
                frame_start = loop.time()
                state = session.show_time((frame_start - start) % stages.DURATION)
                rays = functools.partial(next, stages.rays(state, lambda *_: None))
                paths = await asyncio.to_thread(stages.unless_refused, rays)
                if session.state != state:  # a move or seek came meanwhile
                    await asyncio.sleep(0)
                    continue
                self.scene.update(state, running=True)
                self._drawn.clear()
                with suppress(ConnectionResetError), self.server.state as page:
                    self.scene.show_rays(paths)
                    page.time = round(state.time, 3)
                    page.update(self.scene.views(state))
                    page.reading = readings.gain_reading(session, running=True)
                    self._push_scene()
                # frames sent faster than they are drawn would queue up before all answers
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._drawn.wait(), _PATIENCE)
                await asyncio.sleep(max(_FRAME_PERIOD - (loop.time() - frame_start), 0.005))
        except Exception as error:
            self._report(error)
            with self.server.state as page:
                page.playing = False
        finally:
            self._running = None
        self.seek(session.state.time)


def _number(value: Any) -> Any:
    """Convert the text of a field to a number if possible."""
    try:
        return float(value)
    except (TypeError, ValueError):
        return value


def new_token() -> str:
    """Return a secret for an address.

    It begins with a letter and has no capitals: the page would read digits as a number, and
    capitals as small letters.
    """
    return f"t{secrets.token_hex(24)}"


def guard(app: web.Application, host: str, token: str, private: Collection[str]) -> None:
    """Install middleware that refuses foreign hosts and origins, and protects paths by a token.

    Parameters
    ----------
    app : aiohttp.web.Application
        Application, not yet started.
    host : str
        Address that it listens on.
    token : str
        Value of the parameter `token` of the private paths.
    private : collection of str
        Paths that need the token.
    """

    @web.middleware
    async def check(request: web.Request, handler: Any) -> web.StreamResponse:
        if not _is_of(request, host):
            raise web.HTTPForbidden(text="another host\n")
        if set(request.headers.getall("Origin", ())) - {f"http://{request.host}"}:
            raise web.HTTPForbidden(text="another origin\n")
        token_sent = request.query.get("token", "")
        if request.path in private and not secrets.compare_digest(
            token_sent.encode(), token.encode()
        ):
            raise web.HTTPForbidden(text="open the address that meshtrace explore prints\n")
        response: web.StreamResponse = await handler(request)
        return response

    async def protect(request: web.Request, response: web.StreamResponse) -> None:
        for name, value in (*_HEADERS.items(), ("Content-Security-Policy", policy(request, ""))):
            response.headers.setdefault(name, value)

    app.middlewares.append(check)
    app.on_response_prepare.append(protect)


def policy(request: web.Request, page: str) -> str:
    """Return the Content-Security-Policy of a page: its scripts and this server only, no frames."""
    digests = (hashlib.sha256(script.encode()).digest() for script in _INLINE.findall(page))
    scripts = (f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests)
    return _POLICY.format(host=request.host, scripts=" ".join(scripts))


def _is_of(request: web.Request, host: str) -> bool:
    """Return whether a request is addressed to this server."""
    if request.transport is None:
        return False
    address, port, *_ = request.transport.get_extra_info("sockname")
    # a page may be opened by the name of this machine, too
    names = {host, address}
    names.add("localhost" if ip_address(address).is_loopback else socket.gethostname())
    try:
        return request.url.host in names and request.url.port == port
    except ValueError:  # the request names no valid host
        return False
