"""A bag that a thread of its own writes, so that a slow disk does not stop what brings the messages."""

from __future__ import annotations

import os
import threading
import time
from collections import Counter, deque
from collections.abc import Iterable

from .bag_writer import CHUNK_BYTES, BagWriter
from .errors import BagError
from .message_types import definition

TURN_S = 0.1  # the longest that a message waits before it goes into a chunk
FLUSH_S = 0.3  # the longest that a chunk waits before it goes to the kernel
SYNC_S = 0.5  # between the times at which all is brought to the disk


class Recording:
    """Messages go into a buffer of bounded size, and from there into the bag.

    The bag ends by itself, with its index, before the disk is full, and also if the disk refuses.

    Args:
        bag: open; from now on only to be read of.
        buffer_bytes: of messages that wait for the disk.
        reserve_bytes: what remains free on the disk; 0 goes on until the disk refuses.

    Attributes:
        recorded: topic -> messages that were taken; of a bag that has ended, those in it.
        dropped: topic -> messages that the buffer had no room for, or that the end of the bag caught.
        buffered_bytes: of messages that wait for the disk.
        free_bytes: on the disk, above the reserve.
        ended: why the bag has ended before `close`; empty while it goes on.
    """

    def __init__(self, bag: BagWriter, buffer_bytes: int, reserve_bytes: int) -> None:
        self.bag = bag
        self.recorded: Counter[str] = Counter()
        self.dropped: Counter[str] = Counter()
        self.buffered_bytes = 0
        self.ended = ""
        self._buffer_bytes, self._reserve_bytes = buffer_bytes, reserve_bytes
        self.free_bytes = self._free_bytes()
        self._lock = threading.Lock()
        self._topics: dict[str, tuple[str, bool, bool]] = {}
        self._new_topics: deque[str] = deque()
        self._waiting: deque[tuple[str, int, bytes]] = deque()
        self._first_ns = 0
        self._wake, self._closing = threading.Event(), threading.Event()
        self._refused = ""
        self._flushed_at = self._looked_at = time.monotonic()
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._write, self._sync)]
        for thread in self._threads:
            thread.start()

    def add_topic(self, name: str, typename: str, transient_local: bool, reliable: bool) -> None:
        """Announce a topic, as `BagWriter.add_topic` does.

        Raises:
            BagError: the type is unknown, or the topic was announced before.
        """
        if name in self._topics:
            raise BagError(f"topic {name} is recorded already, as {self._topics[name][0]}; name it once")
        definition(typename)
        self._topics[name] = (typename, transient_local, reliable)
        self._new_topics.append(name)

    def put(self, messages: Iterable[tuple[str, int, bytes]]) -> None:
        """Take messages: topic, log time [ns], data. Never waits.

        The topic was announced. The log time is when the message was received; 0 if that is not known yet: it then gets
        the first time that is.
        """
        with self._lock:
            for topic, log_time_ns, data in messages:
                if self.ended or self.buffered_bytes + len(data) > self._buffer_bytes:
                    self.dropped[topic] += 1
                    continue
                self._waiting.append((topic, log_time_ns, data))
                self._first_ns = self._first_ns or log_time_ns
                self.buffered_bytes += len(data)
                self.recorded[topic] += 1
        if self.buffered_bytes >= CHUNK_BYTES:
            self._wake.set()

    def close(self) -> None:
        """Write what waits, and finish the bag.

        Raises:
            BagError: the bag has ended before; with the reason.
        """
        self._closing.set()
        self._wake.set()
        for thread in self._threads:
            thread.join()
        if self.ended:
            raise BagError(self.ended)

    def _write(self) -> None:
        try:
            while not self._closing.is_set():
                self._wake.wait(TURN_S)
                self._wake.clear()
                self._write_waiting()
            self._write_waiting()
            self.bag.close()
        except Exception as error:  # whatever it is: what is in the bag is kept, and the reason is told
            self._end(str(error) or repr(error))

    def _write_waiting(self) -> None:
        self._check_disk(0)
        while self._waiting and (self._first_ns or self._closing.is_set()):
            topic, log_time_ns, data = self._waiting[0]
            self._check_disk(len(data))
            self._add_new_topics()
            self.bag.write(topic, log_time_ns or self._first_ns, data)
            with self._lock:
                self._waiting.popleft()
                self.buffered_bytes -= len(data)
            self._flush_if_due()
        self._add_new_topics()
        self._flush_if_due()

    def _add_new_topics(self) -> None:
        while self._new_topics:
            name = self._new_topics.popleft()
            self.bag.add_topic(name, *self._topics[name])

    def _flush_if_due(self) -> None:
        if time.monotonic() - self._flushed_at > FLUSH_S:
            self.bag.flush()
            self._flushed_at = time.monotonic()

    def _check_disk(self, more_bytes: int) -> None:
        if self._refused:
            raise BagError(self._refused)
        now = time.monotonic()
        if now - self._looked_at > TURN_S / 2:
            self.free_bytes, self._looked_at = self._free_bytes(), now
        self.free_bytes -= more_bytes
        if self._reserve_bytes and self.free_bytes < 0:
            raise BagError(
                f"the bag {self.bag.path} was ended, as its disk is full but for {self._reserve_bytes / 1e6:.0f} MB: "
                "make room, and start the recorder again with a new output"
            )

    def _free_bytes(self) -> int:
        disk = os.statvfs(self.bag.path)
        return disk.f_bavail * disk.f_frsize - self._reserve_bytes

    def _end(self, reason: str) -> None:
        """Finish the bag with what is in it; what waits is dropped."""
        try:
            self.bag.close()
        except BagError as error:
            reason = f"{reason}; {error}. Make a whole bag of it with `rgbd-dic info --repair {self.bag.path}`"
        kept = Counter(self.bag.counts)
        with self._lock:
            self.ended = reason
            self.dropped += self.recorded - kept
            self.recorded = kept
            self._waiting.clear()
            self.buffered_bytes = 0

    def _sync(self) -> None:
        """Without it, power loss would take up to half a minute, and the kernel would stop the writer now and then."""
        while not self._closing.wait(SYNC_S) and not self.ended:
            try:
                self.bag.sync()
            except BagError as error:
                self._refused = str(error)
                self._wake.set()
