"""HTTP that hangs up on clients that stop reading, leave a request unfinished, or are too many."""

import asyncio
from typing import cast

from uvicorn.protocols.http.h11_impl import H11Protocol

READ_TIMEOUT_S = 30.0
"""Seconds in which a client that is sent something has to read any of it: slow networks take a few."""
HEAD_TIMEOUT_S = 10.0
"""Seconds in which a client has to send the whole head of a request, which is one packet."""
MOST_CLIENTS = 64
"""Clients that look on at a time: a browser has one a tab, and more would take the time of
calibrating."""


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
