"""What is refused before any page is asked: other hosts, foreign origins, clients without a session, long messages."""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Iterable
from dataclasses import dataclass, field
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware.body_limit import RequestBodyLimitMiddleware
from starlette.requests import cookie_parser
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from hil.console.admission import Admission

MOST_BYTES = 65_536
"""Longest body and longest message of a WebSocket: the largest form has some hundred bytes."""
REFUSED = 4403  # close code of a WebSocket that is refused; before it is accepted a client sees HTTP 403
LOOPBACK = ("127.0.0.1", "localhost", "::1")
ENTRANCE = "/enter"

HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; frame-ancestors 'none'; base-uri 'none'; "
        "form-action 'self'; object-src 'none'"
    ),
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""The page is in no frame, so that nothing lies over its stop button; it loads from nowhere else; no token leaves it in a referrer."""
PAGE_OF_A_FILE = "sandbox allow-scripts allow-popups allow-downloads; frame-ancestors 'none'"
"""Reports are pages of their own, without the rights of this origin: none of them can start or stop anything."""


@dataclass(frozen=True)
class Hosts:
    """Names by which the server may be called.

    A page elsewhere can let its own name point here (DNS rebinding), but then calls the server by that name.

    Attributes
    ----------
    bound : str
        The address that the server listens at.
    names : tuple of str
        Of this computer.
    """

    bound: str
    names: tuple[str, ...] = field(default_factory=lambda: (socket.gethostname().lower(), socket.getfqdn().lower()))

    @property
    def is_loopback(self) -> bool:
        """Whether only this computer reaches the server."""
        return is_loopback(self.bound)

    def allow(self, host: str) -> bool:
        """Return whether a `Host` header, with or without a port, names this server."""
        try:
            name = (urlsplit(f"//{host}").hostname or "").lower()
        except ValueError:
            return False
        if name in LOOPBACK or name == self.bound.lower():
            return True
        return not self.is_loopback and (name in self.names or _is_address(name))


class Guard:
    """ASGI middleware in front of every page.

    Parameters
    ----------
    app : ASGIApp
    admission : Admission
    hosts : Hosts
    """

    def __init__(self, app: ASGIApp, admission: Admission, hosts: Hosts) -> None:
        self._app = RequestBodyLimitMiddleware(app, MOST_BYTES)
        self._admission, self._hosts = admission, hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse, or pass on with the headers that keep a browser strict."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        status, why = self._refusal(scope, Headers(scope=scope))
        if not why:
            await self._app(scope, receive, _strict(send))
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": REFUSED, "reason": why[:120]})
        else:
            await PlainTextResponse(f"{why}\n", status)(scope, receive, _strict(send))

    def _refusal(self, scope: Scope, headers: Headers) -> tuple[int, str]:
        host = headers.get("host", "")
        if len(headers.getlist("host")) != 1 or not self._hosts.allow(host):
            return 421, f"this server is not called {host[:80] or 'nothing'}; open the address that `isocenter bench` has printed"
        changes = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        origin = headers.get("origin")
        if (changes and origin is None) or (origin is not None and not _is_own(origin, host)):
            return 403, "a page of another origin may not ask this server; open the address that `isocenter bench` has printed"
        if scope["path"] != ENTRANCE and not self._admission.knows(session_of(headers)):
            return (
                401,
                "open, once, the address with a token that `isocenter bench` has printed; a page that is in makes another",
            )
        return 200, ""


def session_of(headers: Headers) -> str:
    """Return the session in a request's cookie, "" without one."""
    return cookie_parser(headers.get("cookie", "")).get(cookie_name(headers.get("host", "")), "")


def cookie_name(host: str) -> str:
    """Return the name of a server's cookie, with the port that its `Host` header has: browsers keep cookies of all ports together."""
    port = re.search(r":([0-9]{1,5})$", host)
    return f"isocenter_bench_{port[1]}" if port else "isocenter_bench"


def is_loopback(host: str) -> bool:
    """Return whether an address to bind is reached from this computer alone."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _is_own(origin: str, host: str) -> bool:
    try:
        parts = urlsplit(origin)
    except ValueError:
        return False
    return parts.scheme in ("http", "https") and parts.netloc.lower() == host.lower()


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _strict(send: Send) -> Send:
    async def strictly(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in _missing(headers, HEADERS.items()):
                headers[name] = value
        await send(message)

    return strictly


def _missing(headers: MutableHeaders, wanted: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    return [(name, value) for name, value in wanted if name not in headers]
