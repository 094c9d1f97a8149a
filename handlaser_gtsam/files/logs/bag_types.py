"""What is used of bags, whichever ROS they come from; messages have types only while they are read."""

from collections.abc import Iterator, Sequence
from typing import Any, Protocol


class Topic(Protocol):
    """A topic of a bag."""

    @property
    def topic(self) -> str:
        """Its name."""
        ...

    @property
    def msgtype(self) -> str:
        """The type of its messages."""
        ...

    @property
    def msgcount(self) -> int:
        """How many there are."""
        ...


class Bag(Protocol):
    """A bag that is open."""

    @property
    def connections(self) -> Sequence[Topic]:
        """Its topics."""
        ...

    def messages(self, wanted: Sequence[Topic]) -> Iterator[tuple[Topic, int, bytes]]:
        """Yield topic, time of receipt [ns] and content of every message that is wanted."""
        ...

    def deserialize(self, data: bytes, msgtype: str) -> Any:
        """Return a message."""
        ...
