"""Door of the explorer: requests that its web servers answer, and the headers of their answers.

A page of any site can send requests to servers of this machine. Those that carry another host
(a name that a stranger points at this machine) or another origin are turned away, and a session is
opened, read and steered with the token of its address alone.
"""

from __future__ import annotations

import base64
import hashlib
import re
import secrets
import socket
from collections.abc import Collection
from ipaddress import ip_address
from typing import Any

from aiohttp import web

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


def new_token() -> str:
    """Return a secret for an address: the page reads digits as a number, capitals as small."""
    return f"t{secrets.token_hex(24)}"


def guard(app: web.Application, host: str, token: str, private: Collection[str]) -> None:
    """Let an application answer its own host and origin alone, and some paths with a token.

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
        given = request.query.get("token", "")
        if request.path in private and not secrets.compare_digest(given.encode(), token.encode()):
            raise web.HTTPForbidden(text="open the address that meshtrace explore prints\n")
        response: web.StreamResponse = await handler(request)
        return response

    async def protect(request: web.Request, response: web.StreamResponse) -> None:
        for name, value in (*_HEADERS.items(), ("Content-Security-Policy", policy(request, ""))):
            response.headers.setdefault(name, value)

    app.middlewares.append(check)
    app.on_response_prepare.append(protect)


def policy(request: web.Request, page: str) -> str:
    """Return the Content-Security-Policy of a page: its own scripts, this server, no frame."""
    digests = (hashlib.sha256(script.encode()).digest() for script in _INLINE.findall(page))
    scripts = (f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests)
    return _POLICY.format(host=request.host, scripts=" ".join(scripts))


def _is_of(request: web.Request, host: str) -> bool:
    """Return whether a request names the address that it has reached."""
    if request.transport is None:
        return False
    address, port, *_ = request.transport.get_extra_info("sockname")
    names = {host, address}
    names.add("localhost" if ip_address(address).is_loopback else socket.gethostname())
    try:
        return request.url.host in names and request.url.port == port
    except ValueError:  # no name of a host
        return False
