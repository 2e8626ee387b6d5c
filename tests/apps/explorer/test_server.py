"""The server: a session for every visit, on this machine only, released at its end."""

import asyncio
import socket
import sys
import threading

import aiohttp
import pytest
from trame.app.core import AVAILABLE_SERVERS

import meshtrace as mt
from meshtrace.apps.explorer import controls, influences, server, stages
from meshtrace.apps.explorer import page as page_of_session
from meshtrace.errors import Refused
from meshtrace.scenario import Scenario

PAPER = Scenario.from_toml("")

FEW = {"CHAINS": (64, 64), "FADING_CHAINS": 64, "FADING_FRAMES": 8, "MAP_PHOTONS": (1000, 2000)}
"""Settings of `stages` for sessions whose answers nobody reads."""


def served(test, **options):
    """Run a test of a started explorer, of small works, and a client."""

    async def run():
        explorer = server.Explorer(PAPER, "link", **{"host": "127.0.0.1", "port": 0, **options})
        await explorer.start()
        try:
            async with aiohttp.ClientSession() as client:
                return await test(explorer, client)
        finally:
            await explorer.stop()

    with pytest.MonkeyPatch.context() as patch:
        for name, value in FEW.items():
            patch.setattr(stages, name, value)
        patch.setattr(influences, "INPUTS", ())
        return asyncio.run(run())


def test_a_running_sea_waits_for_the_browser(monkeypatch):
    """Moves were once answered after a minute where a slow browser owed hundreds of pictures."""
    monkeypatch.setattr(page_of_session, "_PATIENCE", 600.0)

    async def visits(explorer, client):
        async with client.get(explorer.url, allow_redirects=False):
            page = explorer.pages[0]
        sent = []
        monkeypatch.setattr(page, "_push_scene", lambda: sent.append(page.session.state.time))
        with page.server.state as state:
            state.playing = True
        for shown in (1, 2):
            while len(sent) < shown:
                await asyncio.sleep(0.02)
            await asyncio.sleep(0.3)  # three times the period
            assert len(sent) == shown
            page.drawn()
        with page.server.state as state:
            state.playing = False

    served(visits)


def test_a_comparison_keeps_the_links_that_both_states_started_from():
    async def visits(explorer, client):
        async with client.get(explorer.url, allow_redirects=False):
            page = explorer.pages[0]
        with page.server.state as state:
            page.begin("storm")
            page.compare()
            page.restore({"start": "deep", "depth": 90.0})
            page.swap()
            assert (state.start, state.title) == ("storm", "Storm")
            assert page.session.state == controls.State(
                controls.start_of("storm"), time=controls.STARTS["storm"]["time"]
            )
            page.swap()
            assert state.moves == {"start": "deep", "depth": 90.0}
            page.restore({"start": "nowhere"})
            assert "nowhere" in state.refused[""]
            assert state.moves == {}

    served(visits)


def test_every_visit_has_a_session_that_is_released_at_the_end():
    before = set(AVAILABLE_SERVERS)

    async def visits(explorer, client):
        places = []
        for _ in range(2):
            async with client.get(explorer.url, allow_redirects=False) as answer:
                places.append(answer.headers["Location"])
        first, second = explorer.pages
        ports = [page.port for page in explorer.pages]
        assert [place.partition("?")[0] for place in places] == [
            f"http://127.0.0.1:{port}/index.html" for port in ports
        ]
        assert first.session is not second.session
        assert len(set(AVAILABLE_SERVERS) - before) == 2
        async with client.get(places[0]) as answer:
            assert "vue.global.js" in await answer.text()
        await first.server.stop()
        await explorer._tasks[first]
        await asyncio.sleep(0)
        assert explorer.pages == [second]
        return first, second

    pages = served(visits)
    for page in pages:
        page.session.join()
    assert not [one for one in threading.enumerate() if "meshtrace explorer" in one.name]
    assert set(AVAILABLE_SERVERS) == before


def test_it_listens_on_one_address_of_this_machine():
    async def addresses(explorer, client):
        async with client.get(explorer.url, allow_redirects=False):
            pass
        for port in (explorer.port, explorer.pages[0].port):
            socket.create_connection(("127.0.0.1", port), 5.0).close()
            with pytest.raises(OSError, match="refused"):
                socket.create_connection(("127.0.0.2", port), 5.0)

    served(addresses)


def test_more_sessions_than_allowed_are_turned_away(monkeypatch):
    monkeypatch.setattr(server, "MOST_SESSIONS", 1)

    async def visits(explorer, client):
        found = []
        for _ in range(2):
            async with client.get(explorer.url, allow_redirects=False) as answer:
                found.append(answer.status)
        return found

    assert served(visits) == [302, 503]


@pytest.mark.parametrize("host", ["127.0.0.1", "no.such.host.example"])
def test_an_address_that_cannot_be_used_is_refused(host):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(Refused, match="port"):
            mt.explore(host=host, port=taken.getsockname()[1], open_browser=False)


def test_a_port_beyond_the_range_is_refused():
    with pytest.raises(Refused, match="port: 70000"):
        mt.explore(port=70_000)


def test_missing_packages_are_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "meshtrace.apps.explorer.server", None)
    with pytest.raises(Refused, match=r'pip install "meshtrace\[explore\]"'):
        mt.explore()


@pytest.mark.parametrize("fails", [True, False], ids=["fails", "hangs"])
def test_a_page_that_does_not_start_leaves_the_next_visit_its_turn(monkeypatch, fails):
    """Visits wait for each other, and once did so for ever."""
    start = page_of_session.Page.start

    async def broken(self, host):
        async def never(**options):
            if fails:
                raise OSError("no port")
            await asyncio.Event().wait()

        monkeypatch.setattr(self.server, "start", never)
        return await start(self, host)

    async def visits(explorer, client):
        with monkeypatch.context() as patched:
            patched.setattr(page_of_session, "_LONGEST_START", 0.2)
            patched.setattr(page_of_session.Page, "start", broken)
            async with client.get(explorer.url, allow_redirects=False) as answer:
                assert answer.status == 503
                assert await answer.text() == (
                    "no page: no port\n" if fails else "no page within 0 s\n"
                )
        assert explorer.pages == []
        async with client.get(explorer.url, allow_redirects=False) as answer:
            assert answer.status == 302

    served(visits)


def test_sessions_whose_browsers_stay_do_not_hold_the_end(monkeypatch):
    monkeypatch.setattr(server, "_LONGEST_END", 0.2)

    async def visits(explorer, client):
        async with client.get(explorer.url, allow_redirects=False):
            (page,) = explorer.pages
        stop = page.server.stop

        async def never():
            await stop()
            await asyncio.Event().wait()

        monkeypatch.setattr(page.server, "stop", never)

    served(visits)


def test_a_browser_that_returns_when_it_is_closed_does_not_hold_the_page(monkeypatch):
    """As those of a terminal, or named by BROWSER: the page was once not served meanwhile."""
    closed = threading.Event()
    monkeypatch.setattr("webbrowser.open", lambda url: closed.wait(60.0))

    async def visits():
        explorer = server.Explorer(PAPER, "link", "127.0.0.1", 0)
        serving = asyncio.create_task(server.serve(explorer, open_browser=True))
        try:
            while not explorer.port:
                await asyncio.sleep(0.02)
            async with aiohttp.ClientSession() as client, asyncio.timeout(30.0):
                async with client.get(explorer.url, allow_redirects=False) as answer:
                    assert answer.status == 302
        finally:
            serving.cancel()
            await asyncio.wait({serving})

    asyncio.run(visits())
    closed.set()
