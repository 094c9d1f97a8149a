"""The newest state and status, and how those who look on get them.

Nothing is queued for anybody: who is ready for more gets what is newest then. A client that stops
reading holds up nobody, and costs what one message takes.
"""

import asyncio
import hashlib
from collections.abc import Mapping

BEAT_S = 10.0
"""Seconds after which a client hears that nothing is new, and so that the server is there."""
STATE, STATUS = "state", "status"
"""Topics: that all of a calibration was sent, and what is going on."""


class Hub:
    """Holds the newest message of each topic. All methods are for the thread of the event loop."""

    def __init__(self, page: str) -> None:
        self.clients = 0
        self._page = page
        # By topic: a mark, which is another one where the text is, and the server-sent event.
        self._newest: dict[str, tuple[str, bytes]] = {}
        self._changed = asyncio.Event()

    @property
    def hello(self) -> bytes:
        """What every client hears first: which page this server has, and when to try again [ms]."""
        return f"retry: 1000\nevent: hello\ndata: {self._page}\n\n".encode()

    def publish(self, messages: Mapping[str, str]) -> None:
        """Replace the newest messages of some topics, at once, by texts of one line.

        The event has the name of the topic up to a colon.
        """
        for topic, text in messages.items():
            mark = hashlib.sha256(text.encode()).hexdigest()[:16]
            name = f"id: {mark}\n" if topic == STATE else ""
            event = f"event: {topic.partition(':')[0]}\n{name}data: {text}\n\n".encode()
            self._newest[topic] = (mark, event)
        self._changed.set()
        self._changed = asyncio.Event()

    def known_to(self, mark: str) -> dict[str, str]:
        """Return what a client has heard that comes back with the mark of a state."""
        marks = {topic: newest for topic, (newest, _) in self._newest.items() if topic != STATUS}
        return marks if marks.get(STATE) == mark else {}

    def unheard(self, heard: dict[str, str]) -> bytes:
        """Return what is new to a client, and note that it is not any more."""
        found = b""
        for topic in sorted(self._newest):  # figures, sections, the state, its status
            mark, event = self._newest[topic]
            if heard.get(topic) != mark:
                heard[topic] = mark
                found += event
        return found

    async def news(self, heard: dict[str, str]) -> bytes:
        """Wait until there is something new to a client; a beat where there is not for long."""
        changed = self._changed
        found = self.unheard(heard)
        if found:
            return found
        try:
            await asyncio.wait_for(changed.wait(), BEAT_S)
        except TimeoutError:
            return b"event: beat\ndata:\n\n"
        return self.unheard(heard)
