"""The server of the page, in a thread of its own: starlette finds the answer, uvicorn speaks HTTP.

It hangs up on clients that stop reading.
"""

import asyncio
import errno
import ipaddress
import socket
import threading
from collections.abc import AsyncIterator, Callable, Mapping

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response, StreamingResponse
from starlette.routing import Route
from uvicorn import Config, Server
from uvicorn.protocols.http.h11_impl import H11Protocol

from ...errors import InputError
from ..report.page import live_page
from .guard import Guard, is_loopback, spelt
from .hub import Hub

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
    """

    def __init__(self, host: str, bound: socket.socket) -> None:
        self._bound = bound
        self._page, name, policy = live_page()
        self._hub = Hub(name)
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

    @property
    def loopback(self) -> bool:
        """Whether only this computer reaches the page."""
        return is_loopback(self._bound)

    @property
    def clients(self) -> int:
        """How many look on."""
        return self._hub.clients

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
        self._hub.clients += 1
        try:
            yield self._hub.hello
            while True:
                known, news = await self._hub.news(known)
                yield news
        finally:
            self._hub.clients -= 1


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
