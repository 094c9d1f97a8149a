"""The server of the page, in a thread of its own: starlette finds the answer, uvicorn speaks HTTP.

It hangs up on clients that stop reading, leave a request unfinished, or are too many.
"""

import asyncio
import errno
import ipaddress
import socket
import threading
from collections.abc import AsyncIterator, Callable, Mapping
from typing import cast

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route
from uvicorn import Config, Server
from uvicorn.protocols.http.h11_impl import H11Protocol

from ...errors import InputError
from ..report.page import live_page
from .guard import Guard, is_loopback, names_of, spelt
from .hub import Hub

PORT = 8642
"""The port of the page where none is stated: one that no common server takes."""
PORTS_TRIED = 20
"""Ports that are tried, from `PORT` on, where none is asked for: as many pages stand open at a time."""
EVENTS = "text/event-stream"
SEND_BUFFER = 1 << 18
"""Bytes that the system holds back at most for a client that does not read: a quarter of a state."""
READ_TIMEOUT_S = 30.0
"""Seconds in which a client that is sent something has to read any of it: slow networks take a few."""
HEAD_TIMEOUT_S = 10.0
"""Seconds in which a client has to send the whole head of a request, which is one packet."""
MOST_CLIENTS = 64
"""Clients that look on at a time: a browser has one a tab, and more would take the time of
calibrating."""


def listening(host: str, port: int | None) -> socket.socket:
    """Return a socket that listens.

    Parameters
    ----------
    host : str
    port : int or None
        0 takes any that is free; None takes `PORT`, or the next that is free.

    Raises
    ------
    InputError
        The port is taken, or the host is none of this computer's.
    """
    ports = range(PORT, PORT + PORTS_TRIED) if port is None else (port,)
    for one in ports:
        try:
            return _bound(host, one)
        except (OSError, UnicodeError) as error:
            taken = isinstance(error, OSError) and error.errno == errno.EADDRINUSE
            if taken and one != ports[-1]:
                continue
            if taken:
                found = f"port {one} of {host}, which is in use"
                raise InputError(found, "--port with another, or 0 for any that is free") from error
            why = getattr(error, "strerror", None) or "no such name"
            found = f"no way to listen at {host}, port {one} ({why})"
            raise InputError(found, "a host and a port of this computer") from error
    raise AssertionError(ports)


def _bound(host: str, port: int) -> socket.socket:
    family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0][0]
    found = socket.create_server((host, port), family=family)
    found.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)  # connections take it over
    return found


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
        guarded = Guard(Starlette(routes=routes), names_of(host, bound), policy)
        self._server = Server(
            Config(
                guarded,
                http=PatientProtocol,
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
        if self._hub.clients >= MOST_CLIENTS:
            return PlainTextResponse("too many look on already\n", 503, {"retry-after": "10"})
        if request.method == "HEAD":
            return Response(media_type=EVENTS)
        heard = self._hub.known_to(request.headers.get("last-event-id", ""))
        return StreamingResponse(self._news(heard), media_type=EVENTS)

    async def _news(self, heard: dict[str, str]) -> AsyncIterator[bytes]:
        """Yield what is new to a client until it has gone, which cancels this."""
        self._hub.clients += 1
        try:
            yield self._hub.hello
            while True:
                yield await self._hub.news(heard)
        finally:
            self._hub.clients -= 1


class PatientProtocol(H11Protocol):
    """uvicorn's HTTP, which waits for clients, but not for ever."""

    _waiting: asyncio.TimerHandle | None = None
    _head: asyncio.TimerHandle | None = None
    _left = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin, and wait for the head of a request."""
        stream = cast(asyncio.Transport, transport)
        super().connection_made(stream)
        if len(self.connections) > 4 * MOST_CLIENTS:  # a browser opens two or three ahead of need
            stream.abort()
        else:
            self._head = self.loop.call_later(HEAD_TIMEOUT_S, stream.abort)

    def data_received(self, data: bytes) -> None:
        """Take a part of a request; the head has come once there is a cycle that answers it."""
        super().data_received(data)
        whole = self.cycle is not None and not self.cycle.response_complete
        if whole and self._head is not None:
            self._head.cancel()
            self._head = None
        elif not whole and self._head is None:
            self._head = self.loop.call_later(HEAD_TIMEOUT_S, self._judge_head)

    def _judge_head(self) -> None:
        """Hang up where the head of a further request is not whole, and nothing is being answered."""
        self._head = None
        if self.cycle is None or self.cycle.response_complete:
            self.transport.abort()

    def pause_writing(self) -> None:
        """Begin to wait: what was sent fills all buffers on the way."""
        super().pause_writing()
        self._wait()

    def resume_writing(self) -> None:
        """Go on: it has read."""
        self._rest()
        super().resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        self._rest()
        if self._head is not None:
            self._head.cancel()
        super().connection_lost(exc)

    def _wait(self) -> None:
        self._left = self.transport.get_write_buffer_size()
        self._waiting = self.loop.call_later(READ_TIMEOUT_S, self._judge)

    def _judge(self) -> None:
        if self.transport.get_write_buffer_size() >= self._left:
            self.transport.abort()
        else:
            self._wait()

    def _rest(self) -> None:
        if self._waiting is not None:
            self._waiting.cancel()
            self._waiting = None
