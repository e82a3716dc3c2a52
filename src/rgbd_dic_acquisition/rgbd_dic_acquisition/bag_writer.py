"""Writing of bags: MCAP with the ros2 profile and metadata.yaml, as `ros2 bag` and Foxglove open them."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path
from typing import Any

import yaml

from . import bag_metadata
from .bag_metadata import Span, Topic
from .errors import BagError
from .mcap_file import CHUNK_BYTES, McapFile
from .message_types import definition, serialise

__all__ = ["CHUNK_BYTES", "BagWriter"]
_COMPRESSIONS = {"none": "", "zstd": "zstd"}
_FOREVER = {"sec": 9223372036, "nsec": 854775807}


def _offered_qos(transient_local: bool, reliable: bool) -> dict[str, Any]:
    return {
        "history": "keep_last",
        "depth": 1 if transient_local else 10,
        "reliability": "reliable" if reliable else "best_effort",
        "durability": "transient_local" if transient_local else "volatile",
        "deadline": _FOREVER.copy(),
        "lifespan": _FOREVER.copy(),
        "liveliness": "automatic",
        "liveliness_lease_duration": _FOREVER.copy(),
        "avoid_ros_namespace_conventions": False,
    }


class BagWriter:
    """Writes one bag: a directory with `<name>_0.mcap`, `<name>_1.mcap`, ... and, when it is closed, `metadata.yaml`.

    Not for use by several threads at a time, `sync` apart. Use it as a context manager, so that it is closed in any
    case: until then a reader finds no index.

    Args:
        compression: none or zstd.
        split_bytes: a file that has reached this size is closed, and the next one is begun; 0 makes one file.
        durable: have each file on the disk, and not just in the kernel's memory, when it is closed; and write past that
            memory where the file system can, which costs the processor less.

    Raises:
        BagError: the path exists, cannot be made, or `compression` is not none or zstd.
    """

    def __init__(
        self, path: Path | str, compression: str = "none", split_bytes: int = 0, durable: bool = False
    ) -> None:
        self.path = Path(path)
        if compression not in _COMPRESSIONS:
            raise BagError(f"compression '{compression}': choose one of {', '.join(_COMPRESSIONS)}")
        if self.path.exists():
            raise BagError(f"{self.path} exists already: choose another name, or remove it first")
        self._compression, self._split_bytes, self._durable = _COMPRESSIONS[compression], split_bytes, durable
        self._definitions: dict[str, bytes] = {}
        self._channels: dict[str, int] = {}
        self._topics: dict[str, Topic] = {}
        self._sequence: Counter[str] = Counter()
        self._spans: dict[str, Span] = {}  # of the files that are closed; below their messages and their size
        self._counts: Counter[str] = Counter()
        self._size = 0
        self._finished = False
        try:
            self.path.mkdir(parents=True)
            self._file = self._next_file()
        except OSError as error:
            raise BagError(f"cannot make the bag {self.path}: {error.strerror}") from error

    @property
    def counts(self) -> dict[str, int]:
        """Topic -> messages of it in finished chunks; all of them once the bag is closed."""
        open_file = {} if self._file.closed else self._counts_of(self._file)
        return {name: self._counts[name] + open_file.get(name, 0) for name in self._topics}

    @property
    def size(self) -> int:
        """Of all files so far [bytes]."""
        return self._size + (0 if self._file.closed else self._file.size)

    def add_topic(self, name: str, typename: str, transient_local: bool = False, reliable: bool = True) -> None:
        """Announce a topic, such as /imu/data of sensor_msgs/msg/Imu. A second time does nothing.

        Raises:
            BagError: the type is unknown, or the topic was added with another type.
        """
        if name in self._topics:
            if self._topics[name].type != typename:
                raise BagError(f"topic {name} is {self._topics[name].type} already, not {typename}")
            return
        text, type_hash = definition(typename)
        self._definitions[typename] = text.encode()
        topic = Topic(name, typename, type_hash, [_offered_qos(transient_local, reliable)])
        self._announce(self._file, topic)
        self._topics[name] = topic

    def write(self, topic: str, log_time_ns: int, serialized: bytes, publish_time_ns: int | None = None) -> None:
        """Write one message, CDR bytes as they come from ROS. `log_time_ns` is when it was received.

        Raises:
            BagError: the topic was not added, the bag is closed, or the disk refuses (full, for example).
        """
        if topic not in self._channels:
            raise BagError(f"topic {topic} was not added to the bag {self.path}; call add_topic first")
        if self._file.closed:
            raise BagError(f"bag {self.path} is closed")
        if log_time_ns < 0:
            raise BagError(f"log time {log_time_ns} ns of a message on {topic}: must be 0 or later")
        publish_time_ns = log_time_ns if publish_time_ns is None else publish_time_ns
        try:
            if 0 < self._split_bytes <= self._file.size:
                self._close_file()
                self._file = self._next_file()
            self._file.write(self._channels[topic], log_time_ns, publish_time_ns, self._sequence[topic], serialized)
        except OSError as error:
            raise BagError(f"cannot write to the bag {self.path}: {error.strerror}") from error
        self._sequence[topic] += 1

    def write_message(self, topic: str, log_time_ns: int, message: Any, publish_time_ns: int | None = None) -> None:
        """Serialise a message made by `make_message` and write it."""
        self.write(topic, log_time_ns, serialise(message), publish_time_ns)

    def flush(self) -> None:
        """Hand all messages to the kernel, so that the end of this process does not take them along.

        Raises:
            BagError: the disk refuses. What was not handed over yet is lost.
        """
        try:
            self._file.flush()
        except OSError as error:
            raise BagError(f"cannot write to the bag {self.path}: {error.strerror}") from error

    def sync(self) -> None:
        """Wait until all that was handed to the kernel is on the disk. For another thread than the one that writes.

        Raises:
            BagError: the disk refuses, now or some time before.
        """
        try:
            descriptor = self._file.duplicate()
        except OSError:  # closed in this moment, and `durable` then takes care
            return
        try:
            os.fdatasync(descriptor)
            os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)  # else the bag fills the memory
        except OSError as error:
            raise BagError(f"cannot write to the bag {self.path}: {error.strerror}") from error
        finally:
            os.close(descriptor)

    def close(self) -> None:
        """Write index and metadata. A second time does nothing.

        Raises:
            BagError: the disk refuses. What is in the bag can be repaired.
        """
        if self._finished:
            return
        self._finished = True
        try:
            if not self._file.closed:
                self._close_file()
            bag_metadata.write(self.path, self._information(self._spans, self._counts))
        except OSError as error:
            raise BagError(f"cannot finish the bag {self.path}: {error.strerror}") from error

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _next_file(self) -> McapFile:
        file = McapFile(self.path / f"{self.path.name}_{len(self._spans)}.mcap", self._compression, self._durable)
        for topic in self._topics.values():
            self._announce(file, topic)
        return file

    def _announce(self, file: McapFile, topic: Topic) -> None:
        metadata = {
            "offered_qos_profiles": yaml.safe_dump(topic.offered_qos, sort_keys=False),
            "topic_type_hash": topic.type_hash,
        }
        self._channels[topic.name] = file.add_channel(topic.name, topic.type, self._definitions[topic.type], metadata)

    def _close_file(self) -> None:
        file = self._file
        try:
            file.close("rosbag2", lambda: self._described(file), self._durable)
        finally:
            self._spans[file.path.name] = file.span
            self._counts.update(self._counts_of(file))
            self._size += file.size

    def _described(self, file: McapFile) -> dict[str, str]:
        """What rosbag2 wants to find in a file about it."""
        information = self._information({file.path.name: file.span}, self._counts_of(file))
        return {"serialized_metadata": yaml.safe_dump(information, sort_keys=False)}

    def _counts_of(self, file: McapFile) -> dict[str, int]:
        counts = file.counts
        return {name: counts[number] for name, number in self._channels.items()}

    def _information(self, files: dict[str, Span], counts: dict[str, int]) -> dict[str, Any]:
        for name, topic in self._topics.items():
            topic.count = counts.get(name, 0)
        return bag_metadata.information(files, list(self._topics.values()))
