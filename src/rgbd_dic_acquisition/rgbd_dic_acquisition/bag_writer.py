"""Writing of bags: MCAP with the ros2 profile and metadata.yaml, as `ros2 bag` and Foxglove open them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from mcap.writer import CompressionType, Writer

from . import bag_metadata
from .bag_metadata import Span, Topic
from .errors import BagError
from .message_types import definition, serialise

CHUNK_BYTES = 1024 * 1024  # what a crash loses at most
_COMPRESSIONS = {"none": CompressionType.NONE, "zstd": CompressionType.ZSTD}
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
    """Writes one bag: the directory `path` with `<name>_0.mcap` and, when closed, `metadata.yaml`.

    Not for use by several threads at a time. Use it as a context manager, so that it is closed in any case:
    until then a reader finds no index.

    Raises:
        BagError: the path exists, cannot be made, or `compression` is not none or zstd.
    """

    def __init__(self, path: Path | str, compression: str = "none") -> None:
        self.path = Path(path)
        if compression not in _COMPRESSIONS:
            raise BagError(f"compression '{compression}': choose one of {', '.join(_COMPRESSIONS)}")
        if self.path.exists():
            raise BagError(f"{self.path} exists already: choose another name, or remove it first")
        try:
            self.path.mkdir(parents=True)
            self._file = (self.path / f"{self.path.name}_0.mcap").open("wb")
        except OSError as error:
            raise BagError(f"cannot make the bag {self.path}: {error.strerror}") from error
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=_COMPRESSIONS[compression])
        self._writer.start(profile="ros2", library="rgbd_dic")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._topics: dict[str, Topic] = {}
        self._span = Span()
        self.counts: dict[str, int] = {}

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
        if typename not in self._schemas:
            self._schemas[typename] = self._writer.register_schema(typename, "ros2msg", text.encode())
        qos = [_offered_qos(transient_local, reliable)]
        channel_metadata = {
            "offered_qos_profiles": yaml.safe_dump(qos, sort_keys=False),
            "topic_type_hash": type_hash,
        }
        self._channels[name] = self._writer.register_channel(name, "cdr", self._schemas[typename], channel_metadata)
        self._topics[name] = Topic(name, typename, type_hash, qos)
        self.counts[name] = 0

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
            self._writer.add_message(
                self._channels[topic], log_time_ns, serialized, publish_time_ns, self.counts[topic]
            )
        except OSError as error:
            raise BagError(f"cannot write to the bag {self.path}: {error.strerror}") from error
        self.counts[topic] += 1
        self._span.add(log_time_ns)

    def write_message(self, topic: str, log_time_ns: int, message: Any, publish_time_ns: int | None = None) -> None:
        """Serialise a message made by `make_message` and write it."""
        self.write(topic, log_time_ns, serialise(message), publish_time_ns)

    def close(self) -> None:
        """Write index and metadata. A second time does nothing."""
        if self._file.closed:
            return
        information = self._information()
        try:
            self._writer.add_metadata("rosbag2", {"serialized_metadata": yaml.safe_dump(information, sort_keys=False)})
            self._writer.finish()
            self._file.close()
            bag_metadata.write(self.path, information)
        except OSError as error:
            raise BagError(f"cannot finish the bag {self.path}: {error.strerror}") from error

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _information(self) -> dict[str, Any]:
        for name, topic in self._topics.items():
            topic.count = self.counts[name]
        return bag_metadata.information({Path(self._file.name).name: self._span}, list(self._topics.values()))
