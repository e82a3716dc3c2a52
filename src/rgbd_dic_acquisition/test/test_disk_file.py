"""Bags that are written past the kernel's memory: the same messages to every reader, whole blocks on the disk."""

from __future__ import annotations

import errno
import mmap
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader
from rgbd_dic_acquisition.bag import BagWriter
from rgbd_dic_acquisition.bag_repair import repair_bag
from rgbd_dic_acquisition.disk_file import BLOCK_BYTES, DiskFile, place_in_block
from rosbags.rosbag2 import Reader

KIND = "std_msgs/msg/String"
SIZES = (1, 3, 4095, 4096, 4097, 700_000, 1_555_253, 17, 2_500_001, 9)  # over a block, and over a chunk
MESSAGES = [np.random.default_rng(size).bytes(size) for size in SIZES]


def read(path: Path) -> list[list[bytes]]:
    """Messages, by the reader of the index, the one that goes from record to record, and rosbags."""
    file = path / f"{path.name}_0.mcap"
    found = []
    for reader in (make_reader, NonSeekingReader):
        with file.open("rb") as stream:
            found.append([message.data for *_, message in reader(stream, validate_crcs=True).iter_messages()])
    with Reader(path) as bag:
        found.append([data for *_, data in bag.messages()])
    return found


@pytest.mark.parametrize("durable", [False, True])
@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_every_reader_finds_the_same(tmp_path: Path, durable: bool, compression: str) -> None:
    path = tmp_path / "bag"
    with BagWriter(path, compression, durable=durable) as bag:
        bag.add_topic("/t", KIND)
        for number, message in enumerate(MESSAGES):
            bag.write("/t", number, message)
            bag.flush()
        shutil.copytree(path, tmp_path / "killed")
    assert read(path) == [MESSAGES] * 3
    assert repair_bag(path).path is None, "it is whole"
    (killed,) = (tmp_path / "killed").glob("*.mcap")
    killed.rename(killed.with_name("killed_0.mcap"))
    if durable:
        assert killed.with_name("killed_0.mcap").stat().st_size % BLOCK_BYTES == 0
    repaired = repair_bag(tmp_path / "killed").path
    assert read(repaired) == [MESSAGES] * 3


@pytest.mark.parametrize("place", [0, 1, 16, 2047, 4047, 4095])
def test_a_large_message_goes_to_the_disk_from_where_it_lies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: int
) -> None:
    memory = memoryview(mmap.mmap(-1, 4_000_000))
    memory[:] = np.random.default_rng(place).bytes(len(memory))
    first, large, small = (
        memory[at : at + size] for at, size in ((0, 600_003), (2_000_000 - 1152 + place, 1_555_253), (7, 90))
    )
    assert place_in_block(large) == place
    uncopied = []

    def spy(descriptor: int, views: list[memoryview], at: int) -> int:
        uncopied.extend(len(view) for view in views if view.obj is memory.obj)
        return pwritev(descriptor, views, at)

    pwritev = os.pwritev
    monkeypatch.setattr(os, "pwritev", spy)
    with BagWriter(tmp_path / "bag", durable=True) as bag:
        bag.add_topic("/t", KIND)
        for number, message in enumerate((small, first, small, large, small)):
            bag.write("/t", number, message)
    assert len(uncopied) == 1, "a chunk can be moved to where its largest message lies, and no other"
    assert uncopied[0] > len(large) - 2 * BLOCK_BYTES, "but for the blocks that it has in part"
    assert read(tmp_path / "bag") == [[bytes(message) for message in (small, first, small, large, small)]] * 3


def test_a_file_system_that_cannot_is_written_as_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> int:
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))

    monkeypatch.setattr(os, "pwrite", refuse)
    file = DiskFile(tmp_path / "file", direct=True)
    assert not file.direct
    assert file.write([b"odd", b"", b"bytes"], 0) == 8
    file.close()
    assert (tmp_path / "file").read_bytes() == b"oddbytes"


def test_a_full_disk_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "pwrite", refuse)
    with pytest.raises(OSError, match="space"):
        DiskFile(tmp_path / "file", direct=True)
    assert not (tmp_path / "file").exists()
