"""Which images are on their way through the graph, so that playing never runs too far ahead of it."""

from __future__ import annotations

import struct
from collections.abc import Iterable

from .errors import BagError


def header_stamp_ns(serialised: bytes) -> int:
    """Stamp [ns] of a serialised message that begins with a std_msgs/Header (CDR: four bytes, then the data).

    Raises:
        BagError: the message is too short for one.
    """
    if len(serialised) < 12:
        raise BagError(f"a message of {len(serialised)} bytes is too short for a header with a stamp")
    byte_order = "<" if serialised[1] & 1 else ">"
    sec, nanosec = struct.unpack_from(byte_order + "iI", serialised, 4)
    return sec * 1_000_000_000 + nanosec


class InFlight:
    """Images that were sent and have not been answered on every acknowledging topic.

    An answer is a message with the image's stamp. Without acknowledging topics nothing is ever in flight.

    Attributes:
        answered: images that all topics have answered.
        most: the largest number that was in flight at a time.
    """

    def __init__(self, topics: Iterable[str]) -> None:
        self._topics = frozenset(topics)
        self._missing: dict[int, set[str]] = {}
        self.answered = 0
        self.most = 0

    def __len__(self) -> int:
        return len(self._missing)

    def sent(self, stamp_ns: int) -> None:
        if self._topics:
            self._missing[stamp_ns] = set(self._topics)
            self.most = max(self.most, len(self._missing))

    def acknowledged(self, topic: str, stamp_ns: int) -> bool:
        """Take an answer; whether it was the last that its image needed."""
        missing = self._missing.get(stamp_ns)
        if missing is None:
            return False
        missing.discard(topic)
        if missing:
            return False
        del self._missing[stamp_ns]
        self.answered += 1
        return True

    def oldest(self) -> str:
        """What is waited for, in words."""
        if not self._missing:
            return "nothing"
        stamp_ns, topics = next(iter(self._missing.items()))
        return f"{', '.join(sorted(topics))} for the image of stamp {stamp_ns / 1e9:.9f} s"
