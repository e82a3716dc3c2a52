"""Chunks of an MCAP file, decompressed to no more than they promise.

A kilobyte of zstd or lz4 can hold gigabytes. The libraries that read bags decompress all of it and compare its length
afterwards.
"""

from __future__ import annotations

from io import BytesIO

import lz4.frame
import zstandard

LARGEST_CHUNK_BYTES = 1 << 30  # what a damaged file may promise before it is disbelieved
_READERS = {
    "lz4": lz4.frame.LZ4FrameFile,
    "zstd": lambda data: zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True),
}


def decompressed(data: bytes, size: int, compression: str) -> bytes:
    """The content of a chunk that promises so many bytes.

    Raises:
        ValueError: it promises too much, or holds more or less than that.
        Exception: of the libraries, if it is damaged.
    """
    if size > LARGEST_CHUNK_BYTES:
        raise ValueError(f"a chunk promises {size} bytes; at most {LARGEST_CHUNK_BYTES} are believed")
    raw = _READERS[compression](BytesIO(data)).read(size + 1) if compression else data
    if len(raw) != size:
        raise ValueError(f"a chunk promises {size} bytes and holds {'more' if len(raw) > size else len(raw)}")
    return raw
