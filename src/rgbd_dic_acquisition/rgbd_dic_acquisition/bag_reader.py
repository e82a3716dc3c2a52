"""Reading of bags: a directory with metadata.yaml, or one .mcap file."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import storage_mcap

from .errors import BagError
from .mcap_chunks import decompressed
from .mcap_end import MAGIC
from .message_types import typestore

CHUNKS_OVERLAP_S = 2.0  # threads of a recorder write messages that late after one another
# In place of rosbags' own, which decompress without a limit.
storage_mcap.DECOMPRESSORS.update(
    {name: partial(decompressed, compression=name) for name in storage_mcap.DECOMPRESSORS}
)


@dataclass(frozen=True)
class TopicInfo:
    """Type and number of messages of one topic in a bag."""

    type: str
    count: int


class BagReader:
    """Reads a bag: a directory with metadata.yaml, or one .mcap file. A context manager.

    Attributes:
        topics: name -> TopicInfo, in the order of the names.
        start_ns, end_ns: log times of the first and the last message; both 0 if there is none.

    Raises:
        BagError: there is no bag, it is not MCAP, or it is cut short; with what to do about it.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        source = _bag_at(self.path)
        self._reader = AnyReader([source], default_typestore=typestore())
        try:
            self._reader.open()
        except Exception as error:  # damaged bytes raise almost anything
            raise BagError(
                f"cannot read the bag {self.path}: {error}. If it is damaged, try `rgbd-dic info --repair "
                f"{self.path}`, or record it again"
            ) from error
        counts: dict[str, TopicInfo] = {}
        for connection in sorted(self._reader.connections, key=lambda item: item.topic):
            before = counts.get(connection.topic)
            if before is not None and before.type != connection.msgtype:
                raise BagError(f"{self.path}: topic {connection.topic} has two types; record it again")
            count = connection.msgcount + (before.count if before else 0)
            counts[connection.topic] = TopicInfo(connection.msgtype, count)
        self.topics = counts
        empty = not any(info.count for info in counts.values())
        self.start_ns = 0 if empty else self._reader.start_time
        self.end_ns = 0 if empty else self._reader.end_time - 1

    def require(self, topic: str, typename: str) -> str:
        """The name of a topic as the bag spells it, with or without a namespace, if it is of this type.

        Raises:
            BagError: there is no such topic, it is in several namespaces, or it has another type.
        """
        wanted = "/" + topic.lstrip("/")
        names = [name for name in self.topics if f"/{name}".endswith(wanted)]
        exact = [name for name in names if name.lstrip("/") == topic.lstrip("/")]
        name = (exact or names or [None])[0]
        if not exact and len(names) > 1:
            raise BagError(
                f"{self.path} has {topic} in several namespaces: {', '.join(names)}; record one of them alone"
            )
        if name is None:
            raise BagError(
                f"{self.path} has no topic {topic}; it has {', '.join(self.topics) or 'none'}. Record that topic"
            )
        if self.topics[name].type != typename:
            raise BagError(
                f"{self.path}: topic {name} is of type {self.topics[name].type}, needed is {typename}; "
                "record the right topic"
            )
        return name

    def messages(self, topics: Collection[str] | None = None) -> Iterator[tuple[str, int, Any]]:
        """(topic, log_time_ns, message) of these topics, or of all, in the order of log time.

        Raises:
            BagError: there is no such topic, or the bag is damaged at that place.
        """
        for topic, typename, log_time_ns, data in self.raw_messages(topics):
            try:
                message = self.deserialise(typename, data)
            except BagError as error:
                raise BagError(f"{self.path}: {topic} at {log_time_ns} ns: {error}") from error
            yield topic, log_time_ns, message

    def deserialise(self, typename: str, data: bytes) -> Any:
        """The message of CDR bytes.

        Raises:
            BagError: the bytes are not such a message.
        """
        try:
            return self._reader.deserialize(data, typename)
        except Exception as error:  # damaged bytes raise almost anything
            raise BagError(
                f"a {typename} of {len(data)} bytes cannot be read: {str(error) or type(error).__name__}"
            ) from error

    def raw_messages(self, topics: Collection[str] | None = None) -> Iterator[tuple[str, str, int, bytes]]:
        """(topic, typename, log_time_ns, CDR bytes) of these topics, or of all, in the order of log time."""
        missing = sorted(set(topics or ()) - set(self.topics))
        if missing:
            raise BagError(f"{self.path} has no topic {', '.join(missing)}; it has {', '.join(self.topics) or 'none'}")
        wanted = [c for c in self._reader.connections if topics is None or c.topic in topics]
        if not wanted:
            return
        try:
            for connection, log_time_ns, data in self._reader.messages(wanted):
                yield connection.topic, connection.msgtype, log_time_ns, bytes(data)
        except Exception as error:  # damaged bytes raise almost anything
            raise BagError(
                f"{self.path} is damaged: {error}. Try `rgbd-dic info --repair {self.path}`, or record it again"
            ) from error

    def close(self) -> None:
        if self._reader.stack is not None:
            self._reader.close()

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def mcap_files(path: Path) -> list[Path]:
    """The files of a bag, a directory or one .mcap file, in the order of the numbers in their names.

    Raises:
        BagError: there are none.
    """
    files = [path] if path.is_file() else [file for file in path.glob("*.mcap") if file.is_file()]
    if not files:
        raise BagError(f"{path} holds no .mcap file: give the directory of a bag, or the .mcap file itself")
    return sorted(files, key=lambda file: [(len(part), part) for part in re.split(r"(\d+)", file.name)])


def _bag_at(path: Path) -> Path:
    """What the reader shall open: the directory, or the file; checked so far that the errors can be plain."""
    if not path.exists():
        raise BagError(f"there is no bag {path}: check the path")
    files = mcap_files(path)
    for file in files:
        _check_mcap(file)
    _check_order(files)
    if path.is_file():
        return path
    if (path / "metadata.yaml").exists():
        return path
    if len(files) > 1:
        raise BagError(f"{path} has no metadata.yaml: run `rgbd-dic info --repair {path}`, or give one .mcap file")
    return files[0]


def _check_mcap(path: Path) -> None:
    with path.open("rb") as file:
        head = file.read(len(MAGIC))
        file.seek(0, 2)
        size = file.tell()
        file.seek(max(0, size - len(MAGIC)))
        tail = file.read()
    if head != MAGIC:
        raise BagError(
            f"{path} is not an MCAP file (it begins with {head!r}): give an MCAP bag; other formats can be "
            "converted with `ros2 bag convert`"
        )
    if tail != MAGIC or size < 2 * len(MAGIC):
        raise BagError(
            f"{path} is cut short (no footer): the recording was not closed. Make a new bag of what is there with "
            "`rgbd-dic info --repair`"
        )
    if path.suffix != ".mcap":
        raise BagError(f"{path}: the name of an MCAP file must end in .mcap; rename it")


def _check_order(files: Sequence[Path]) -> None:
    """Refuse a bag that cannot be read in the order of its recording, because its log times do not tell it."""
    index = []
    for path in files:
        with path.open("rb") as file:
            try:
                chunks = make_reader(file).get_summary().chunk_indexes
            except Exception:  # damaged bytes raise almost anything; who opens it to read will say so
                return
        index += [(path, chunk) for chunk in sorted(chunks, key=lambda chunk: chunk.chunk_start_offset)]
    for (_, before), (path, after) in pairwise(index):
        back_s = (before.message_end_time - after.message_start_time) * 1e-9
        if back_s > CHUNKS_OVERLAP_S:
            raise BagError(
                f"{path}: the clock of the computer that recorded it ran back by {back_s:.1f} s: the order of its "
                "messages is not known any more. Split it there with `mcap filter`, or record it again"
            )
