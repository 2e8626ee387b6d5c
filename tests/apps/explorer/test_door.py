"""The door of the explorer: requests of other hosts and origins open, read and steer nothing."""

import asyncio
import http.server
import json
import re
import signal
import subprocess
import sys
import threading
from random import Random

import aiohttp
import msgpack
import pytest
from browser import chromium, until
from test_server import FEW, served
from wslink.chunking import generate_chunks

from meshtrace.apps.explorer import server

SMALL = f"""
from meshtrace.apps.explorer import influences, stages
vars(stages).update({FEW})
influences.INPUTS = ()
from meshtrace.__main__ import main
main()
"""
EXPLORE = [sys.executable, "-c", SMALL, "explore", "--no-browser", "--port", "0"]

UPGRADE = {
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
}


async def raw(port, line, headers):
    """Return the status of a request with headers that no client would send."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    head = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
    writer.write(f"{line} HTTP/1.1\r\n{head}\r\n".encode())
    status = await asyncio.wait_for(reader.readline(), 30.0)
    writer.close()
    return int(status.split()[1])


async def opened(explorer, client):
    """Open a session and return its page and the address of it."""
    async with client.get(explorer.url, allow_redirects=False) as answer:
        return explorer.pages[-1], answer.headers["Location"]


FOREIGN = [
    {"Host": "evil.example:{port}"},
    {"Host": "127.0.0.1.evil.example:{port}"},
    {"Host": "127.0.0.1"},
    {"Host": "127.0.0.1:1"},
    {"Host": "[::1]:{port}"},
    {"Host": "[::::"},
    {},
    {"Host": "127.0.0.1:{port}", "Origin": "http://evil.example"},
    {"Host": "127.0.0.1:{port}", "Origin": "http://127.0.0.1:1"},
    {"Host": "127.0.0.1:{port}", "Origin": "https://127.0.0.1:{port}"},
    {"Host": "127.0.0.1:{port}", "Origin": "null"},
    {"Host": "127.0.0.1:{port}", "Origin": ""},
]


def test_foreign_hosts_and_origins_are_turned_away_with_the_token_too(monkeypatch):
    """17 visits under a foreign host once used up all sessions for ten minutes."""
    monkeypatch.setattr(server, "MOST_SESSIONS", 1)

    async def visits(explorer, client):
        token = explorer.url.partition("?")[2]
        found = []
        for headers in FOREIGN:
            named = {key: value.format(port=explorer.port) for key, value in headers.items()}
            found.append(await raw(explorer.port, f"GET /?{token}", named))
        own = {"Host": f"127.0.0.1:{explorer.port}"}
        for wrong in ("/", "/?token=", "/?token=x", f"/?{token}x", f"/{token}", "/?token=%ff"):
            found.append(await raw(explorer.port, f"GET {wrong}", own))
        assert explorer.pages == []
        page, _ = await opened(explorer, client)
        token = f"token={page._token}"
        for headers in FOREIGN:
            named = {key: value.format(port=page.port) for key, value in headers.items()}
            for line in (f"GET /index.html?{token}", f"POST /paraview/?{token}"):
                found.append(await raw(page.port, line, named))
            found.append(await raw(page.port, f"GET /ws?{token}", {**named, **UPGRADE}))
        own = {"Host": f"127.0.0.1:{page.port}"}
        for line in ("GET /", "GET /index.html", "POST /paraview/", "GET /ws", "GET /ws?token=x"):
            found.append(await raw(page.port, line, {**own, **UPGRADE}))
        assert page._browsers == 0
        return found

    assert set(served(visits)) <= {400, 403, 404}


def test_own_requests_are_answered():
    async def visits(explorer, client):
        page, place = await opened(explorer, client)
        own = {"Host": f"localhost:{page.port}", "Origin": f"http://localhost:{page.port}"}
        token = f"token={page._token}"
        found = [await raw(page.port, f"GET /ws?{token}", {**own, **UPGRADE})]
        async with client.get(place) as answer:
            found.append(answer.status)
            policy = answer.headers["Content-Security-Policy"]
        async with client.post(f"http://127.0.0.1:{page.port}/paraview/?{token}") as answer:
            given = await answer.json()
        assert given["sessionURL"] == f"ws://127.0.0.1:{page.port}/ws?{token}"
        return found, policy, explorer.url

    found, policy, url = served(visits)
    assert found == [101, 200]
    assert "frame-ancestors 'none'" in policy
    assert "script-src 'self' 'unsafe-eval' 'sha256-" in policy
    assert len(url.partition("token=")[2]) >= 32


def test_a_connection_needs_the_secret():
    async def replies(explorer, client):
        page, _ = await opened(explorer, client)
        address = f"ws://127.0.0.1:{page.port}/ws?token={page._token}"
        found = []
        for secret in ("wslink-secret", page._token):
            async with client.ws_connect(address) as connection:
                await call(connection, "system:c0:0", "wslink.hello", {"secret": secret})
                found.append((await connection.receive(30.0)).data)
        return found

    wrong, right = served(replies)
    assert b"clientID" not in wrong
    assert b"clientID" in right


async def call(connection, number, method, *args):
    """Call a method of a session."""
    message = {"wslink": "1.0", "id": number, "method": method, "args": args, "kwargs": {}}
    for chunk in generate_chunks(msgpack.packb(message), 0):
        await connection.send_bytes(chunk)


@pytest.fixture
def explorer():
    """Yield the running command and its address."""
    with subprocess.Popen(
        EXPLORE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        yield process, re.search(r"http://\S+", process.stdout.readline())[0]
        process.kill()


VALUES = [None, "x", -1, 1e300, [], {}, [[]], {"key": 1}, True, "\x00", 10**30, b"\xff"]
ACTIONS = ["compare", "design", "drawn", "make_map", "restore", "scene_ready", "seek", "show_text",
           "swap"]  # fmt: skip
KEYS = ["depth", "wind", "water", "light", "playing", "time", "trame__title", "text", ""]


@pytest.mark.process
@pytest.mark.thorough
def test_wrong_messages_are_lines_and_the_session_goes_on(explorer):
    """Wrong arguments of 29 triggers once were 29 tracebacks, and SIGTERM ended it with no word."""
    process, url = explorer
    random = Random("messages")

    async def talk():
        async with aiohttp.ClientSession() as client:
            async with client.get(url, allow_redirects=False) as answer:
                place = answer.headers["Location"]
            address = place.replace("http", "ws").replace("/index.html", "/ws")
            token = place.partition("token=")[2]
            for bad in (b"", b"\xff" * 40, b"\x00" * 12 + b"\xc1"):
                async with client.ws_connect(address) as connection:
                    await connection.send_bytes(bad)
                    await connection.send_str("text")
                    await connection.close()
            async with client.ws_connect(address) as connection:
                await call(connection, "system:c0:0", "wslink.hello", {"secret": token})
                for i in range(300):
                    value, key = random.choice(VALUES), random.choice(KEYS)
                    name = random.choice(ACTIONS)
                    method, *args = random.choice(
                        [
                            ("trame.trigger", name, [value], {}),
                            ("trame.trigger", name, [], {"x": value}),
                            ("trame.trigger", value),
                            ("trame.state.update", [{"key": key, "value": value}]),
                            ("trame.state.update", value),
                            ("no.such.method", value),
                        ]
                    )
                    if isinstance(value, int) and value > 2**63:
                        continue  # no number of the protocol
                    await call(connection, f"rpc:c0:{i}", method, *args)
                await call(connection, "rpc:c0:end", "trame.state.get")
                while True:
                    received = await connection.receive(120.0)
                    assert received.type == aiohttp.WSMsgType.BINARY
                    if b"rpc:c0:end" in received.data:
                        return b"refused" in received.data

    assert asyncio.run(talk())
    process.send_signal(signal.SIGTERM)
    assert process.wait(120.0) == 0
    *lines, last = process.stderr.read().splitlines()
    assert last == "explorer ended: terminated"
    assert not [line for line in lines if "Traceback" in line]
    assert [line for line in lines if not line.startswith(("error: ", "warning: "))] == []


HOSTILE = """<!doctype html><title>waiting</title><body><script>
const at = %s;
const tried = [];
for (let i = 0; i < 20; i++) {
  for (const url of [at.first, at.first + "?token=x"]) {
    tried.push(fetch(url, { mode: "no-cors" }).catch(() => 0));
    const image = new Image(); image.src = url;
  }
}
const readable = async (url, options) => {
  try { return (await (await fetch(url, options)).text()).slice(0, 60); } catch { return ""; }
};
const socket = (url) => new Promise((done) => {
  const ws = new WebSocket(url);
  ws.onopen = () => done("open"); ws.onerror = () => done("closed");
});
const framed = (url) => new Promise((done) => {
  const frame = document.createElement("iframe");
  frame.onload = () => {
    try { done(frame.contentDocument ? "empty" : "foreign"); } catch { done("foreign"); }
  };
  frame.src = url; document.body.append(frame);
});
(async () => {
  await Promise.all(tried);
  window.found = {
    read: await readable(at.whole), posted: await readable(at.secret, { method: "POST" }),
    ws: await socket(at.ws), unknown: await socket(at.ws.split("?")[0]),
    frame: await framed(at.page), script: await new Promise((done) => {
      const script = document.createElement("script");
      script.onload = () => done("run"); script.onerror = () => done("refused");
      script.src = at.script; document.body.append(script);
    }),
  };
  document.title = "done";
})();
</script>"""


@pytest.mark.browser
@pytest.mark.process
@pytest.mark.thorough
@pytest.mark.parametrize("name", ["127.0.0.1", "evil.example"])
@pytest.mark.slow_but("evil.example")
def test_a_hostile_page_opens_and_reads_nothing(explorer, name):
    """It even knows the addresses and secrets of an open session, of which no page can know."""
    _, url = explorer
    first = url.partition("?")[0]
    with served_page() as hostile, chromium(800, 600, MAPPED) as driver:
        driver.get(url)
        until(lambda: driver.find_elements("id", "gain"), "no page")
        page = driver.current_url
        origin, token = page.partition("/index.html")[0], page.partition("token=")[2]
        at = {
            "first": first,
            "whole": url,
            "page": page,
            "secret": f"{origin}/paraview/?token={token}",
            "ws": f"{origin.replace('http', 'ws')}/ws?token={token}",
            "script": f"{origin}/vue.global.js",
        }
        driver.switch_to.new_window("tab")
        driver.get(hostile(name, HOSTILE % json.dumps(at)))
        until(lambda: driver.title == "done", "the hostile page is still at work")
        found = driver.execute_script("return window.found")
        assert found == {
            "read": "",
            "posted": "",
            "ws": "closed",
            "unknown": "closed",
            "frame": "foreign",
            "script": "refused",
        }
        messages = str(driver.get_log("browser"))
        assert "frame-ancestors" in messages
        driver.get(url)  # no session is used up
        until(lambda: driver.find_elements("id", "gain"), "no page")


@pytest.mark.browser
@pytest.mark.process
@pytest.mark.slow
def test_a_name_that_points_at_this_machine_opens_nothing(explorer):
    """As after DNS rebinding: of one origin with the explorer for the browser."""
    _, url = explorer
    with chromium(800, 600, MAPPED) as driver:
        for _ in range(17):
            driver.get(url.replace("127.0.0.1", "evil.example"))
            assert driver.find_element("tag name", "body").text == "another host"
        driver.get(url)
        until(lambda: driver.find_elements("id", "gain"), "no page")


MAPPED = "--host-resolver-rules=MAP evil.example 127.0.0.1, MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"


class served_page:  # noqa: N801
    """Serve one page on this machine under any name; the address comes from name and content."""

    def __enter__(self):
        outer = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self):
                self.send_response(200)
                self.send_header("Content-Type", "text/html")
                self.end_headers()
                self.wfile.write(outer.content.encode())

            def log_message(self, *_):
                pass

        self.content = ""
        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

        def address(name, content):
            self.content = content
            return f"http://{name}:{self.server.server_port}/"

        return address

    def __exit__(self, *_):
        self.server.shutdown()
        self.server.server_close()
