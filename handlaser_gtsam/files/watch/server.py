"""The server of the page, in a thread of its own: starlette finds the answer, uvicorn speaks HTTP.

It hangs up on clients that stop reading. Nothing is queued for anybody: who is ready for more gets what
is newest then, and a client that stops reading holds up nobody.

Only requests by a name of this computer are answered, or by an address where others may reach it, and
none that another page sends. A page from elsewhere can make a browser ask a server on the same
computer, under a name of its own that leads there (DNS rebinding) or from its own origin. Both show in
what the browser says of the request.
"""

import asyncio
import errno
import ipaddress
import re
import secrets
import socket
import threading
from collections.abc import AsyncIterator, Callable, Mapping
from http import HTTPStatus
from http.client import HTTP_PORT

from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn import Config, Server
from uvicorn.protocols.http.h11_impl import H11Protocol

from ...errors import InputError
from ..report.page import live_page

PORT = 8642
"""The port of the page where none is stated: one that no common server takes."""
EVENTS = "text/event-stream"
READ_TIMEOUT_S = 30.0
"""Seconds in which a client has to read what fills the buffers on its way: slow networks take a few."""


def listening(host: str, port: int | None) -> socket.socket:
    """Return a socket that listens.

    Parameters
    ----------
    host : str
    port : int or None
        0 takes any that is free; None takes `PORT`, or any that is free where it is taken.

    Raises
    ------
    InputError
        The port is taken, or the host is none of this computer's.
    """
    wanted = PORT if port is None else port
    try:
        places = socket.getaddrinfo(host, wanted, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        return socket.create_server((host, wanted), family=places[0][0])
    except (OSError, UnicodeError) as error:
        if isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
            if port is None:
                return listening(host, 0)
            found = f"port {port} of {host}, which is in use"
            raise InputError(found, "--port with another, or 0 for any that is free") from error
        why = getattr(error, "strerror", None) or "no such name"
        found = f"no way to listen at {host}, port {wanted} ({why})"
        raise InputError(found, "a host and a port of this computer") from error


class PageServer:
    """A context in which the page is served.

    Parameters
    ----------
    host : str
        As it was asked for.
    bound : socket
        It listens already; it is closed at the end.

    Attributes
    ----------
    clients : int
        How many look on.
    """

    def __init__(self, host: str, bound: socket.socket) -> None:
        self._bound, self.clients = bound, 0
        self._page, self._name, policy = live_page()
        self._hub = Hub()
        routes = [Route("/", self._index), Route("/events", self._events)]
        guarded = Guard(Starlette(routes=routes), host, bound, policy)
        self._server = Server(
            Config(
                guarded,
                http=PatientProtocol,
                limit_concurrency=64,  # a browser has one connection a tab, and opens a few ahead
                ws="none",
                lifespan="off",
                log_config=None,
                log_level="critical",
                access_log=False,
                server_header=False,
                timeout_graceful_shutdown=1,
            )
        )
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)

    def __enter__(self) -> "PageServer":
        self._thread.start()
        self._ready.wait()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.should_exit = self._server.force_exit = True
        self._soon(self._hang_up)
        self._thread.join(3.0)
        self._bound.close()

    @property
    def url(self) -> str:
        """Where the page is."""
        host, port = self._bound.getsockname()[:2]
        if ipaddress.ip_address(host.partition("%")[0]).is_unspecified:
            host = socket.gethostname()
        return f"http://{spelt(host)}:{port}/"

    def publish(self, messages: Mapping[str, str]) -> None:
        """Send messages by topic, each one line, to all who look on; from any thread.

        Raises
        ------
        RuntimeError
            The server has ended, which it does only at the end of its context.
        """
        if not self._thread.is_alive():
            raise RuntimeError("the server of the page has ended")
        self._soon(lambda: self._hub.publish(messages))

    def _soon(self, what: Callable[[], None]) -> None:
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(what)

    def _hang_up(self) -> None:
        for one in list(self._server.server_state.connections):
            one.transport.abort()

    def _run(self) -> None:
        asyncio.run(self._serve())

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._ready.set()
        await self._server.serve(sockets=[self._bound])

    async def _index(self, _: Request) -> Response:
        return HTMLResponse(self._page)

    async def _events(self, request: Request) -> Response:
        if request.method == "HEAD":
            return Response(media_type=EVENTS)
        known = self._hub.known_to(request.headers.get("last-event-id", ""))
        return StreamingResponse(self._news(known), media_type=EVENTS)

    async def _news(self, known: int) -> AsyncIterator[bytes]:
        """Yield what is new to a client until it has gone, which cancels this."""
        self.clients += 1
        try:
            # Which page this server has, and when to try again [ms].
            yield f"retry: 1000\nevent: hello\ndata: {self._name}\n\n".encode()
            while True:
                known, news = await self._hub.news(known)
                yield news
        finally:
            self.clients -= 1


class PatientProtocol(H11Protocol):
    """uvicorn's HTTP, which waits for clients that do not read, but not for ever."""

    _waiting: asyncio.TimerHandle | None = None

    def pause_writing(self) -> None:
        """Begin to wait: what was sent fills all buffers on the way."""
        super().pause_writing()
        self._waiting = self.loop.call_later(READ_TIMEOUT_S, self.transport.abort)

    def resume_writing(self) -> None:
        """Go on: the client has read."""
        self._rest()
        super().resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        self._rest()
        super().connection_lost(exc)

    def _rest(self) -> None:
        if self._waiting is not None:
            self._waiting.cancel()


STATE, STATUS = "state", "status"
"""Topics: that all of a calibration was sent, and what is going on."""


class Hub:
    """Holds the newest message of each topic. All methods are for the thread of the event loop."""

    def __init__(self) -> None:
        # Another one after a restart, which begins to count again.
        self._server = secrets.token_hex(4)
        self._number = 0
        # By topic: the number of the publication that changed its text, and the text.
        self._newest: dict[str, tuple[int, str]] = {}
        self._changed = asyncio.Event()

    def publish(self, messages: Mapping[str, str]) -> None:
        """Replace the newest messages of some topics, at once, by texts of one line.

        The event has the name of the topic up to a colon.
        """
        self._number += 1
        for topic, text in messages.items():
            if topic not in self._newest or self._newest[topic][1] != text:
                self._newest[topic] = self._number, text
        self._changed.set()
        self._changed = asyncio.Event()

    def known_to(self, mark: str) -> int:
        """Return the publication up to which a client knows all that comes back with a state's mark."""
        server, _, number = mark.partition(".")
        return int(number) if server == self._server and number.isdecimal() else 0

    def unheard(self, known: int) -> bytes:
        """Return the events of what has changed since a publication."""
        found = []
        # In the order figures, sections, state, status.
        for topic, (number, text) in sorted(self._newest.items()):
            if number > known:
                mark = f"id: {self._server}.{number}\n" if topic == STATE else ""
                found.append(f"event: {topic.partition(':')[0]}\n{mark}data: {text}\n\n")
        return "".join(found).encode()

    async def news(self, known: int) -> tuple[int, bytes]:
        """Wait until there is something new to a client; a beat where there is not for long.

        Returns the publication up to which the client then knows all, and the events.
        """
        changed = self._changed
        if known == self._number:
            try:
                await asyncio.wait_for(changed.wait(), 10.0)  # the page gives up after 35 s
            except TimeoutError:
                return known, b"event: beat\ndata:\n\n"
        return self._number, self.unheard(known)


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
