"""HTTP that hangs up on who has stopped reading for long."""

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol

PATIENCE = 30.0
"""Seconds in which a client that is sent something has to read any of it."""


class PatientProtocol(H11Protocol):
    """uvicorn's HTTP, which waits for a client that does not read, but not for ever."""

    _waiting: asyncio.TimerHandle | None = None
    _left = 0

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
        super().connection_lost(exc)

    def _wait(self) -> None:
        self._left = self.transport.get_write_buffer_size()
        self._waiting = self.loop.call_later(PATIENCE, self._judge)

    def _judge(self) -> None:
        if self.transport.get_write_buffer_size() >= self._left:
            self.transport.abort()
        else:
            self._wait()

    def _rest(self) -> None:
        if self._waiting is not None:
            self._waiting.cancel()
            self._waiting = None
