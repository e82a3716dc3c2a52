"""Hostile bags, changed anywhere, with lengths that lie, and bombs: no crash, no hang, no memory; BagError alone."""

from __future__ import annotations

import random
import resource
import struct
import time
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, ChunkIndex, DataEnd, Footer, Header, McapRecord, Schema, Statistics
from mcap.writer import CompressionType, Writer
from rgbd_dic_acquisition.bag import BagReader, make_message
from rgbd_dic_acquisition.bag_reader import MAGIC
from rgbd_dic_acquisition.bag_repair import repair_bag
from rgbd_dic_acquisition.errors import BagError
from rgbd_dic_acquisition.message_types import definition, serialise

from rgbd_dic_acquisition import messages

COMPRESSIONS = (CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4)
HEAD, FOOTER = struct.Struct("<BQ"), 8 + 29  # opcode and length of a record; the last record and the magic bytes
MAGIC_SIZE = 8
# A file of a few kilobytes; what the libraries keep of it, and what the allocator rounds up to.
MEMORY_BYTES = 60_000_000
BOMB_BYTES = 2 << 30


def sample(path: Path, compression: CompressionType) -> bytes:
    """A small bag of the kinds that are read, without checksums, so that changes reach whoever reads what is inside."""
    rng = np.random.default_rng(1)
    pixels = rng.integers(0, 256, (12, 16), np.uint8)
    about = (make_message, 10**9, "camera")
    said = [
        ("/camera/image_raw", messages.IMAGE, messages.image_message(*about, pixels, "mono8")),
        ("/tof/points", messages.POINT_CLOUD, messages.points_message(*about, rng.random((20, 3)))),
        ("/imu/data", messages.IMU, messages.imu_message(*about, (0, 0, 0, 1), np.eye(3))),
        ("/crack_opening", "rgbd_dic_msgs/msg/CrackOpening", make_message("rgbd_dic_msgs/msg/CrackOpening")),
        ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", make_message("diagnostic_msgs/msg/DiagnosticArray")),
    ]
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1500, compression=compression, enable_crcs=False)
        writer.start(profile="ros2", library="test")
        for name, kind, message in said:
            schema = writer.register_schema(kind, "ros2msg", definition(kind)[0].encode())
            channel = writer.register_channel(name, "cdr", schema, {"offered_qos_profiles": "[]"})
            for k in range(4):
                writer.add_message(channel, 10**9 + k, serialise(message), 10**9 + k)
        writer.finish()
    return path.read_bytes()


def records(data: bytes) -> list[int]:
    """Where the records of a file begin."""
    found, at = [], MAGIC_SIZE
    while at + HEAD.size <= len(data) - MAGIC_SIZE:
        found.append(at)
        at += HEAD.size + HEAD.unpack_from(data, at)[1]
    return found


def hostile(rng: random.Random, data: bytes, heads: list[int]) -> bytes:
    """The file with a few of its bytes or lengths changed, cut, or without the index; it still looks like a file."""
    changed = bytearray(data)
    for _ in range(rng.randrange(1, 5)):
        kind = rng.randrange(5)
        if kind == 0:  # a length that lies
            lie = rng.choice([0, 1, rng.randrange(2**16), 2**31, 2**63, 2**64 - 1])
            struct.pack_into("<Q", changed, rng.choice(heads) + 1, lie)
        elif kind == 1:  # within a record's first fields, where lengths, numbers and offsets are
            at = rng.choice(heads) + HEAD.size + rng.randrange(60)
            changed[at : at + 4] = rng.choice([rng.randbytes(4), b"\xff" * 4, bytes(4)])
        elif kind == 2:
            at = rng.randrange(len(changed))
            changed[at : at + 8] = rng.choice([rng.randbytes(8), b"\xff" * 8, bytes(8)])
        elif kind == 3:  # another kind of record
            changed[rng.choice(heads)] = rng.randrange(1, 16)
        else:
            changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    changed = changed[: len(data)]
    if rng.random() < 0.2:  # no index: the whole file is gone through
        struct.pack_into("<Q", changed, len(changed) - FOOTER + HEAD.size, 0)
    if rng.random() < 0.2:
        at = rng.randrange(len(changed) - FOOTER)
        del changed[at : at + rng.randrange(200)]
    changed[:MAGIC_SIZE] = changed[-MAGIC_SIZE:] = MAGIC
    changed[-FOOTER : -FOOTER + HEAD.size] = data[-FOOTER : -FOOTER + HEAD.size]
    return bytes(changed)


def read(path: Path) -> int:
    """Go through all that can be read; how many messages were."""
    count = 0
    try:
        with BagReader(path) as bag:
            for _, kind, _, data in bag.raw_messages():
                try:
                    bag.deserialise(kind, data)
                    count += 1
                except BagError:
                    continue
    except BagError:
        pass
    return count


def peak_bytes() -> int:
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


@pytest.mark.parametrize("seconds", [0.0, pytest.param(60.0, marks=pytest.mark.slow)])
def test_hostile_bags(tmp_path: Path, seconds: float) -> None:
    """At least three hundred, and for so long. Some are still read, and some not, or it would be no test."""
    files = [(data := sample(tmp_path / "sample.mcap", kind), records(data)) for kind in COMPRESSIONS]
    path, rng = tmp_path / "hostile.mcap", random.Random(1)
    assert read(tmp_path / "sample.mcap") == 20
    begin, before, tried, whole = time.monotonic(), peak_bytes(), 0, 0
    while tried < 300 or time.monotonic() - begin < seconds:
        path.write_bytes(hostile(rng, *rng.choice(files)))
        whole += read(path) == 20
        if tried % 10 == 0:
            try:
                repair_bag(path, tmp_path / f"repaired_{tried}")
            except BagError:
                continue
            finally:
                tried += 1
        tried += 1
    print(f"{tried} bags, {whole} of them read whole; {(peak_bytes() - before) / 1e6:.1f} MB more at the most")
    assert 0 < whole < tried
    assert peak_bytes() - before < MEMORY_BYTES


@pytest.fixture(scope="module", params=["zstd", "lz4"])
def zeros(request: pytest.FixtureRequest) -> tuple[str, bytes]:
    """(Compression, two gigabytes of zeros)"""
    packer = {"zstd": zstandard.ZstdCompressor().compressobj, "lz4": lz4.frame.LZ4FrameCompressor}[request.param]()
    begin = packer.begin() if request.param == "lz4" else b""
    piece = bytes(16 << 20)
    return request.param, b"".join([begin, *(packer.compress(piece) for _ in range(BOMB_BYTES >> 24)), packer.flush()])


@pytest.mark.parametrize("promised", [1000, BOMB_BYTES])
@pytest.mark.parametrize("indexed", [False, True])
def test_bombs_do_not_go_off(tmp_path: Path, zeros: tuple[str, bytes], promised: int, indexed: bool) -> None:
    """A chunk that unfolds to two gigabytes, which says so or does not."""
    path = tmp_path / "bomb.mcap"
    path.write_bytes(bomb(*zeros, promised, indexed))
    before = peak_bytes()
    with pytest.raises(BagError, match="a chunk promises"), BagReader(path) as bag:
        list(bag.raw_messages())
    with pytest.raises(BagError, match="holds no whole chunk"):
        repair_bag(path, tmp_path / "repaired")
    assert peak_bytes() - before < MEMORY_BYTES


def bomb(compression: str, data: bytes, promised: int, indexed: bool) -> bytes:
    """A file with one such chunk, and with or without an index."""
    imu = messages.IMU
    header, data_end = packed(Header(profile="ros2", library="test")), packed(DataEnd(data_section_crc=0))
    chunk = packed(Chunk(compression, data, 1, 1, 0, promised))
    start = MAGIC_SIZE + len(header)
    index = [
        Schema(id=1, data=definition(imu)[0].encode(), encoding="ros2msg", name=imu),
        Channel(id=1, topic="/imu/data", message_encoding="cdr", metadata={}, schema_id=1),
        ChunkIndex(
            len(chunk), start, compression, len(data), 1, 31, {1: start + len(chunk)}, 1, promised
        ),  # of one message
        Statistics(0, 1, {1: 1}, 1, 1, 1, 1, 0, 1),
    ]
    summary = b"".join(map(packed, index)) if indexed else b""
    footer = Footer(start + len(chunk) + len(data_end) if indexed else 0, summary_offset_start=0, summary_crc=0)
    return MAGIC + header + chunk + data_end + summary + packed(footer) + MAGIC


def packed(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
