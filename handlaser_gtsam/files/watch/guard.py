"""Who may ask: only requests by a name of this computer, or where others may reach it by an address.

No other page may ask.

A page from elsewhere can make a browser ask a server on the same computer, under a name of its own that
leads there (DNS rebinding) or from its own origin. Both show in what the browser says of the request.
"""

import ipaddress
import re
import socket
from http import HTTPStatus
from http.client import HTTP_PORT

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

AUTHORITY = re.compile(r"(\[[0-9a-f:.]+\]|[a-z0-9._-]+)(?::([0-9]{1,5}))?")
HEADERS = {
    "cache-control": "no-store",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
}


def is_loopback(bound: socket.socket) -> bool:
    """Tell whether only this computer reaches a socket."""
    return ipaddress.ip_address(bound.getsockname()[0].partition("%")[0]).is_loopback


def spelt(host: str) -> str:
    """Return a host as an address of a page has it."""
    host = host.lower()
    return f"[{host}]" if ":" in host else host


class Guard:
    """Refuses requests under a foreign name or from a foreign page, and sets headers of security.

    Parameters
    ----------
    app : ASGIApp
    host : str
        Where the server was asked to listen.
    bound : socket
        Where it listens.
    policy : str
        The content security policy of the page.
    """

    def __init__(self, app: ASGIApp, host: str, bound: socket.socket, policy: str) -> None:
        self._app, self._loopback = app, is_loopback(bound)
        address, self._port = bound.getsockname()[:2]
        self._names = {spelt(host), spelt(address), "localhost"}
        if self._loopback:
            self._names |= {"127.0.0.1", "[::1]"}
        else:
            name = socket.gethostname().lower()
            self._names |= {name, f"{name.partition('.')[0]}.local"}
        headers = HEADERS | {"content-security-policy": policy}
        self._headers = [(name.encode(), value.encode()) for name, value in headers.items()]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or let the application do so."""

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", []), *self._headers]
            await send(message)

        fault = self.fault(Headers(scope=scope))
        app = self._app if not fault else PlainTextResponse(f"{fault}\n", HTTPStatus.FORBIDDEN)
        await app(scope, receive, with_headers)

    def fault(self, headers: Headers) -> str:
        """Return why a request is refused; empty where it is not."""
        hosts = headers.getlist("host")
        if len(hosts) != 1 or not self.allows(hosts[0]):
            return "refused: asked under a name that is not that of this server"
        own = f"http://{hosts[0].lower()}"
        if any(origin.lower() != own for origin in headers.getlist("origin")):
            return "refused: asked from another page"
        # Browsers that send no origin with images and frames say where these are asked from.
        elsewhere = headers.get("sec-fetch-site") in ("cross-site", "same-site")
        if elsewhere and headers.get("sec-fetch-mode") != "navigate":
            return "refused: asked from another page"
        return ""

    def allows(self, authority: str) -> bool:
        """Tell whether `authority`, a host with a port, is this server.

        Where others may ask, every numerical address will do: nobody can tell which of them lead here,
        and no name can be made to lead to them.
        """
        found = AUTHORITY.fullmatch(authority.lower())
        if found is None or int(found[2] or HTTP_PORT) != self._port:
            return False
        return found[1] in self._names or (not self._loopback and _is_address(found[1]))


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host.strip("[]"))
    except ValueError:
        return False
    return True
