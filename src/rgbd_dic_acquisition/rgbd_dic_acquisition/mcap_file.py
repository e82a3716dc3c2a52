"""One MCAP file, written chunk by chunk without copying what is in it.

The `mcap` library's writer cannot end a chunk at a given time, nor take one back when the disk is full. It copies each
message twice on its way and takes zlib's checksum of it, which makes it twice as expensive. The records other than
messages and chunks are the library's. Where the file goes past the kernel's memory, a record of an application's own,
which readers have to skip, fills up what is written to whole blocks; another one before it lets the largest message be
written from where it lies. Format: https://mcap.dev/spec
"""

from __future__ import annotations

import errno
import struct
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import zstandard
from fastcrc import crc32
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Header, MessageIndex, Metadata, Schema

from .bag_metadata import Span
from .disk_file import BLOCK_BYTES, LARGE_BYTES, DiskFile, place_in_block
from .mcap_end import MAGIC, bytes_of, end_of_file

CHUNK_BYTES = 1024 * 1024
_SMALL_BYTES = 4096  # copied together with its head
_FULL = (errno.ENOSPC, errno.EDQUOT)
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_CHUNK_HEAD = struct.Struct("<BQQQQI")
_RECORD_HEAD = struct.Struct("<BQ")
_FILLER = 0x80  # the first opcode that the format leaves to applications


class McapFile:
    """Writes one MCAP file. What is in finished chunks can be read, whatever comes after.

    Args:
        direct: write past the kernel's memory for files, if the file system can.

    Attributes:
        path: of the file.

    Raises:
        OSError: the disk refuses.
    """

    def __init__(self, path: Path, compression: str = "", direct: bool = False) -> None:
        self.path = path
        self._compression = compression
        self._file = DiskFile(path, direct)
        self._end_at = 0
        self._schemas: dict[str, Schema] = {}
        self._channels: list[Channel] = []
        self._chunks: list[tuple[ChunkIndex, dict[int, int]]] = []  # and how many messages of each channel
        self._begin_chunk()
        try:
            self._append([MAGIC, bytes_of(Header("ros2", "rgbd_dic"))])
        except OSError:
            self._file.close()
            path.unlink()
            raise

    @property
    def closed(self) -> bool:
        return self._file.closed

    @property
    def size(self) -> int:
        """With the chunk that is being filled [bytes]."""
        return self._end_at + self._chunk_size

    @property
    def span(self) -> Span:
        """Of the messages in finished chunks."""
        indexes = [index for index, _ in self._chunks]
        return Span(
            min((index.message_start_time for index in indexes), default=None),
            max((index.message_end_time for index in indexes), default=0),
            sum(self.counts.values()),
        )

    @property
    def counts(self) -> Counter[int]:
        """Number of a channel -> its messages in finished chunks."""
        total: Counter[int] = Counter()
        for _, counts in self._chunks:
            total.update(counts)
        return total

    def add_channel(self, topic: str, typename: str, definition: bytes, metadata: dict[str, str]) -> int:
        """Announce a topic; the number of its channel."""
        if typename not in self._schemas:
            schema = Schema(id=len(self._schemas) + 1, name=typename, encoding="ros2msg", data=definition)
            self._schemas[typename] = schema
            self._put(bytes_of(schema))
        number = len(self._channels) + 1
        channel = Channel(
            id=number,
            topic=topic,
            message_encoding="cdr",
            schema_id=self._schemas[typename].id,
            metadata=metadata,
        )
        self._channels.append(channel)
        self._put(bytes_of(channel))
        return number

    def write(self, channel: int, log_time_ns: int, publish_time_ns: int, sequence: int, data: bytes) -> None:
        """Add a message to the chunk. `data` is kept, not copied: it must not change any more."""
        self._index.setdefault(channel, []).append((log_time_ns, self._chunk_size))
        head = _MESSAGE_HEAD.pack(
            Opcode.MESSAGE,
            _MESSAGE_HEAD.size - 9 + len(data),
            channel,
            sequence & 0xFFFFFFFF,
            log_time_ns,
            publish_time_ns,
        )
        if len(data) > _SMALL_BYTES:
            self._put(head)
            self._put(data)
        else:
            self._put(head + data)
        if self._chunk_size >= CHUNK_BYTES:
            self.flush()

    def flush(self) -> None:
        """End the chunk and hand it to the kernel; nothing if no message is in it.

        Raises:
            OSError: the disk refuses. The chunk is then given up, and the file ends after the one before.
        """
        if not self._index:
            return
        pieces, index, size = self._pieces, self._index, self._chunk_size
        self._begin_chunk()
        checksum = 0
        for piece in pieces:
            checksum = crc32.iso_hdlc(piece, checksum)
        stored, stored_size = pieces, size
        if self._compression:
            stored = [zstandard.compress(b"".join(pieces))]
            stored_size = len(stored[0])
        times = [time for entries in index.values() for time, _ in entries]
        name = self._compression.encode()
        tail = struct.pack(f"<I{len(name)}sQ", len(name), name, stored_size)
        length = _CHUNK_HEAD.size + len(tail) + stored_size
        head = _CHUNK_HEAD.pack(Opcode.CHUNK, length - 9, min(times), max(times), size, checksum) + tail
        before = self._room_before(len(head), pieces)
        begin = self._end_at + len(before)
        messages, offsets = RecordBuilder(), {}
        for channel, entries in index.items():
            offsets[channel] = begin + length + messages.count
            MessageIndex(channel_id=channel, records=entries).write(messages)
        chunk = ChunkIndex(
            message_start_time=min(times),
            message_end_time=max(times),
            chunk_start_offset=begin,
            chunk_length=length,
            message_index_offsets=offsets,
            message_index_length=messages.count,
            compression=self._compression,
            compressed_size=stored_size,
            uncompressed_size=size,
        )
        self._append([before, head, *stored, messages.end()])
        self._chunks.append((chunk, {channel: len(entries) for channel, entries in index.items()}))

    def duplicate(self) -> int:
        """A descriptor of the file of its own, such as for another thread to wait with until all is on the disk."""
        return self._file.duplicate()

    def close(self, name: str, about: Callable[[], dict[str, str]], durable: bool = False) -> None:
        """Write the chunk, the metadata record `name` and the index, and close the file, whatever happens.

        On a full disk the last chunks make room for the index.

        Args:
            about: the metadata, from what is then in the file.
            durable: wait until all is on the disk.

        Raises:
            OSError: the disk refuses.
        """
        try:
            try:
                self.flush()
            except OSError as error:
                if error.errno not in _FULL:
                    raise
                self._take_back()
            self._file.go_through_the_kernel()
            while True:
                try:
                    self._append([self._end(Metadata(name, about()))])
                    break
                except OSError as error:
                    if error.errno not in _FULL or not self._chunks:
                        raise
                    self._take_back()
            if durable:
                self._file.sync()
        finally:
            self._file.close()

    def _begin_chunk(self) -> None:
        self._pieces: list[bytes] = []
        self._chunk_size = 0
        self._index: dict[int, list[tuple[int, int]]] = {}

    def _put(self, piece: bytes) -> None:
        self._pieces.append(piece)
        self._chunk_size += len(piece)

    def _take_back(self) -> None:
        """Give the last chunk up."""
        if self._chunks:
            self._end_at = self._chunks.pop()[0].chunk_start_offset
            self._file.cut(self._end_at)

    def _append(self, pieces: Sequence[bytes]) -> None:
        if self._file.direct:
            pieces = [*pieces, _filler(sum(map(len, pieces)))]
        self._end_at = self._file.write(pieces, self._end_at)

    def _room_before(self, head_bytes: int, pieces: Sequence[bytes]) -> bytes:
        """A record that brings the largest piece of the next chunk to the place in a block that it has in memory."""
        largest = max(range(len(pieces)), key=lambda number: len(pieces[number]))
        if not self._file.direct or self._compression or len(pieces[largest]) < LARGE_BYTES:
            return b""
        at = self._end_at + head_bytes + sum(map(len, pieces[:largest]))
        return _filler(at - place_in_block(pieces[largest]))

    def _end(self, metadata: Metadata) -> bytes:
        """All that comes after the last chunk."""
        chunks = [index for index, _ in self._chunks]
        return end_of_file(
            self._end_at, metadata, list(self._schemas.values()), self._channels, chunks, self.span, self.counts
        )


def _filler(size: int) -> bytes:
    """A record that fills so many bytes up to whole blocks."""
    room = -(size + _RECORD_HEAD.size) % BLOCK_BYTES
    return _RECORD_HEAD.pack(_FILLER, room) + bytes(room)
