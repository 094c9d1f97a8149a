"""The newest state and status, and how those who look on get them.

Nothing is queued for anybody: who is ready for more gets what is newest then. A client that stops
reading holds up nobody, and costs what one message takes.
"""

import asyncio
import hashlib
from dataclasses import dataclass

BEAT = 10.0
"""Seconds after which who has heard nothing hears that there is nothing."""
RETRY_MS = 1000
"""Milliseconds after which a browser that lost the connection tries again."""


@dataclass(frozen=True, slots=True)
class Message:
    """One server-sent event; `mark` is another one where the text is."""

    mark: str
    event: bytes


class Hub:
    """Holds the newest message of each kind. All methods are for the thread of the event loop."""

    def __init__(self, page: str) -> None:
        self.clients = 0
        self._page = page
        self._newest: dict[str, Message] = {}
        self._changed = asyncio.Event()

    @property
    def hello(self) -> bytes:
        """What every client hears first: which page this server has, and when to try again."""
        return f"retry: {RETRY_MS}\nevent: hello\ndata: {self._page}\n\n".encode()

    def publish(self, kind: str, text: str) -> None:
        """Replace the newest message of a kind by a text of one line."""
        mark = hashlib.sha256(text.encode()).hexdigest()[:16]
        if kind in self._newest and self._newest[kind].mark == mark:
            return
        name = f"id: {mark}\n" if kind == "state" else ""
        event = f"event: {kind}\n{name}data: {text}\n\n".encode()
        self._newest[kind] = Message(mark, event)
        self._changed.set()
        self._changed = asyncio.Event()

    def unheard(self, heard: dict[str, str]) -> bytes:
        """Return what is new to a client, and note that it is not any more."""
        found = b""
        for kind in sorted(self._newest):  # the state before its status
            newest = self._newest[kind]
            if heard.get(kind) != newest.mark:
                heard[kind] = newest.mark
                found += newest.event
        return found

    async def news(self, heard: dict[str, str]) -> bytes:
        """Wait until there is something new to a client; a beat where there is not for long."""
        changed = self._changed
        found = self.unheard(heard)
        if found:
            return found
        try:
            await asyncio.wait_for(changed.wait(), BEAT)
        except TimeoutError:
            return b"event: beat\ndata:\n\n"
        return self.unheard(heard)
