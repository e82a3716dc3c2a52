"""What is whole in an MCAP file, whatever happened to it.

An MCAP file is a sequence of records, most of them chunks of about a megabyte with a checksum, and an index at its
end. Whatever cut it off, the records before the cut are whole. A chunk that is cut, or whose checksum is wrong, is
left out, as what is in it cannot be told from garbage.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import breakup_chunk

from .bag_metadata import Span
from .mcap_chunks import decompressed
from .mcap_end import MAGIC

_HEAD = struct.Struct("<BQ")  # opcode and length of every record
_TAIL = struct.Struct("<QQI8s")  # where the index and its own index begin, its checksum, the magic bytes
_READ = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK)


class SalvagedFile:
    """One .mcap file, only read. All but `path` is known once `messages` has been gone through.

    Attributes:
        is_closed: whether its index and its end are there, as they were written.
        damaged_chunks: chunks that are there in full length, but not as they were written.
        lost_bytes: in damaged chunks and what depends on them, and from the cut on.
        compression: of its chunks: "", "zstd" or "lz4".
        span: log times of its messages, and how many there are.
        channels: number of a channel -> what it says of itself, and its schema.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._forget()

    @property
    def is_whole(self) -> bool:
        return self.is_closed and not self.damaged_chunks

    def messages(self) -> Iterator[tuple[Channel, Message]]:
        """All messages that are whole, in the order of the file."""
        self._forget()
        schemas: dict[int, Schema] = {}
        with self.path.open("rb") as file:
            for record in self._records(file):
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel) and record.schema_id in schemas:
                    self.channels[record.id] = (record, schemas[record.schema_id])
                elif isinstance(record, Message) and record.channel_id in self.channels:
                    self.span.add(record.log_time)
                    yield self.channels[record.channel_id][0], record
                elif isinstance(record, Message):  # of a channel that a damaged chunk has introduced
                    self.lost_bytes += len(record.data)

    def _forget(self) -> None:
        self.is_closed = False
        self.damaged_chunks = self.lost_bytes = 0
        self.compression = ""
        self.span = Span()
        self.channels: dict[int, tuple[Channel, Schema]] = {}

    def _records(self, file: BinaryIO) -> Iterator[McapRecord]:
        for opcode, body in self._bodies(file):
            try:
                records = _parsed(opcode, body)
            except Exception:  # damaged bytes raise almost anything
                self.damaged_chunks += 1
                self.lost_bytes += len(body)
                continue
            if opcode == Opcode.CHUNK:
                self.compression = Chunk.read(_stream(body)).compression
            yield from records

    def _bodies(self, file: BinaryIO) -> Iterator[tuple[int, bytes]]:
        """Opcode and content of each record that has messages, or what they need, up to the cut."""
        size = self.path.stat().st_size
        whole_to = len(MAGIC) if file.read(len(MAGIC)) == MAGIC else 0
        while whole_to and len(head := file.read(_HEAD.size)) == _HEAD.size:
            opcode, length = _HEAD.unpack(head)
            end = whole_to + _HEAD.size + length
            if opcode == 0 or end > size:  # zeros, where a file system made room and nothing was written; or the cut
                break
            if opcode == Opcode.DATA_END:
                self.is_closed = self._has_index(file, size)
                return
            if opcode in _READ:
                yield opcode, file.read(length)
            whole_to = end
            file.seek(whole_to)
        self.lost_bytes += size - whole_to

    def _has_index(self, file: BinaryIO, size: int) -> bool:
        """Whether the file ends as it should, and its index is as it was written."""
        file.seek(max(0, size - _TAIL.size))
        tail = file.read()
        summary_at, _, checksum, magic = _TAIL.unpack(tail) if len(tail) == _TAIL.size else (0, 0, 0, b"")
        file.seek(min(summary_at, size))
        return magic == MAGIC and zlib.crc32(file.read()[: -len(MAGIC) - 4]) == checksum


def _parsed(opcode: int, body: bytes) -> list[McapRecord]:
    """The records in a body.

    Raises:
        Exception: of any kind, if they are not what was written.
    """
    if opcode == Opcode.SCHEMA:
        return [Schema.read(_stream(body))]
    if opcode == Opcode.CHANNEL:
        return [Channel.read(_stream(body))]
    if opcode == Opcode.MESSAGE:
        return [Message.read(_stream(body), len(body))]
    chunk = Chunk.read(_stream(body))
    raw = decompressed(chunk.data, chunk.uncompressed_size, chunk.compression)
    return breakup_chunk(replace(chunk, compression="", data=raw), validate_crc=True)


def _stream(body: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))
