"""What an MCAP file ends with: a metadata record, the index, and where the index begins."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence

from fastcrc import crc32
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from .bag_metadata import Span

MAGIC = b"\x89MCAP0\r\n"


def end_of_file(
    at: int,
    metadata: Metadata,
    schemas: Sequence[Schema],
    channels: Sequence[Channel],
    chunks: Sequence[ChunkIndex],
    span: Span,
    counts: Mapping[int, int],
) -> bytes:
    """All that comes after the last chunk.

    Args:
        at: where in the file that is.
        counts: number of a channel -> its messages.
    """
    end, summary, offsets = RecordBuilder(), RecordBuilder(), []
    metadata.write(end)
    about_metadata = MetadataIndex(offset=at, length=end.count, name=metadata.name)
    DataEnd(data_section_crc=0).write(end)
    summary_at = at + end.count
    statistics = Statistics(
        attachment_count=0,
        channel_count=len(channels),
        channel_message_counts=dict(counts),
        chunk_count=len(chunks),
        message_count=span.count,
        message_start_time=span.first_ns or 0,
        message_end_time=span.last_ns,
        metadata_count=1,
        schema_count=len(schemas),
    )
    groups: list[tuple[Opcode, Sequence[McapRecord]]] = [
        (Opcode.SCHEMA, schemas),
        (Opcode.CHANNEL, channels),
        (Opcode.STATISTICS, [statistics]),
        (Opcode.CHUNK_INDEX, chunks),
        (Opcode.METADATA_INDEX, [about_metadata]),
    ]
    for opcode, records in groups:
        start = summary.count
        for record in records:
            record.write(summary)
        if records:
            offsets.append(SummaryOffset(opcode, summary_at + start, summary.count - start))
    offsets_at = summary_at + summary.count
    for offset in offsets:
        offset.write(summary)
    text = summary.end()
    footer = bytes_of(Footer(summary_start=summary_at, summary_offset_start=offsets_at, summary_crc=0))
    checksum = crc32.iso_hdlc(footer[:-4], crc32.iso_hdlc(text))
    return end.end() + text + footer[:-4] + struct.pack("<I", checksum) + MAGIC


def bytes_of(record: McapRecord) -> bytes:
    """A record as it stands in a file."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
