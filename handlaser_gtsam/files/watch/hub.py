"""The newest state and status, and how those who look on get them.

Nothing is queued for anybody: who is ready for more gets what is newest then. A client that stops
reading holds up nobody, and costs what one message takes.
"""

import asyncio
import secrets
from collections.abc import Mapping

STATE, STATUS = "state", "status"
"""Topics: that all of a calibration was sent, and what is going on."""


class Hub:
    """Holds the newest message of each topic. All methods are for the thread of the event loop."""

    def __init__(self, page: str) -> None:
        self.clients = 0
        self._page = page
        # Another one after a restart, which begins to count again.
        self._server = secrets.token_hex(4)
        self._number = 0
        # By topic: the number of the publication that changed its text, and the text.
        self._newest: dict[str, tuple[int, str]] = {}
        self._changed = asyncio.Event()

    @property
    def hello(self) -> bytes:
        """What every client hears first: which page this server has, and when to try again [ms]."""
        return f"retry: 1000\nevent: hello\ndata: {self._page}\n\n".encode()

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
