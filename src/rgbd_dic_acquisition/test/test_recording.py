"""A recording on disks that are slow, full or broken: bounded, counted, and what is in the bag stays readable."""

from __future__ import annotations

import itertools
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rgbd_dic_acquisition.bag import BagReader, BagWriter
from rgbd_dic_acquisition.bag_repair import repair_bag
from rgbd_dic_acquisition.errors import BagError
from rgbd_dic_acquisition.recording import Recording
from rosbags.rosbag2 import Reader
from small_disks import frozen, image_disk, memory_disk

MB = 1_000_000
KIND = "std_msgs/msg/String"
BYTES = 100_000


def begin(path: Path, buffer_mb: int = 512, reserve_mb: int = 0, split_mb: int = 0) -> Recording:
    recording = Recording(BagWriter(path, split_bytes=split_mb * MB, durable=True), buffer_mb * MB, reserve_mb * MB)
    recording.add_topic("/t", KIND, transient_local=False, reliable=True)
    return recording


_NOISE = np.random.default_rng(3).bytes(BYTES)


def message(number: int, size: int = BYTES) -> bytes:
    return number.to_bytes(8, "little") + _NOISE[8:size]


def put_many(recording: Recording, first: int, count: int, every_s: float = 0.0) -> int:
    """Messages with their numbers, until there are so many or the bag has ended; the number of the next."""
    for number in range(first, first + count):
        if recording.ended:
            return number
        recording.put([("/t", 1 + number, message(number))])
        time.sleep(every_s)
    return first + count


def numbers(path: Path) -> list[int]:
    """Of the messages in a bag, each of which must be as it was sent."""
    with BagReader(path) as bag:
        found = [(int.from_bytes(data[:8], "little"), data) for *_, data in bag.raw_messages()]
    assert all(data == message(number, len(data)) for number, data in found)
    return [number for number, _ in found]


def wait_for(condition, seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_all_is_in_the_bag_and_nothing_is_kept(tmp_path):
    recording = begin(tmp_path / "bag", split_mb=5)
    sent = put_many(recording, 0, 200)
    recording.close()
    assert numbers(tmp_path / "bag") == list(range(sent))
    assert recording.recorded == {"/t": sent} and not recording.dropped and recording.buffered_bytes == 0
    assert len(list((tmp_path / "bag").glob("*.mcap"))) == 4


def test_the_first_known_time_is_that_of_what_came_before_it(tmp_path):
    recording = begin(tmp_path / "bag")
    for number, time_ns in enumerate((0, 0, 5, 6)):
        recording.put([("/t", time_ns, message(number))])
    recording.close()
    with BagReader(tmp_path / "bag") as bag:
        assert [time_ns for _, _, time_ns, _ in bag.raw_messages()] == [5, 5, 5, 6]


def test_a_slow_topic_alone_does_not_wait_for_a_chunk_to_be_full(tmp_path):
    recording = begin(tmp_path / "bag")
    file, copies = tmp_path / "bag" / "bag_0.mcap", itertools.count()
    empty = file.stat().st_size
    for number in range(3):
        recording.put([("/t", 1 + number, message(number, 200))])
    wait_for(lambda: file.stat().st_size > empty)

    def is_safe() -> bool:
        copy = tmp_path / f"killed_{next(copies)}"
        shutil.copytree(tmp_path / "bag", copy)  # what SIGKILL would leave
        return numbers(repair_bag(copy).path) == [0, 1, 2]

    wait_for(is_safe)
    recording.close()


def test_a_topic_with_two_types_or_none_is_refused_and_the_rest_recorded(tmp_path):
    recording = begin(tmp_path / "bag")
    with pytest.raises(BagError, match="/t is recorded already, as std_msgs/msg/String"):
        recording.add_topic("/t", "sensor_msgs/msg/Imu", transient_local=False, reliable=True)
    with pytest.raises(BagError, match="no_such_msgs"):
        recording.add_topic("/u", "no_such_msgs/msg/Thing", transient_local=False, reliable=True)
    put_many(recording, 0, 3)
    recording.close()
    assert numbers(tmp_path / "bag") == [0, 1, 2]


def test_a_disk_that_stalls_loses_nothing_while_the_buffer_has_room(tmp_path):
    with image_disk(tmp_path, 64) as (disk, _):
        recording = begin(disk / "bag")
        sent = put_many(recording, 0, 50, 0.002)
        with frozen(disk):
            sent = put_many(recording, sent, 150, 0.002)  # 15 MB, and put does not wait for the disk
            assert recording.buffered_bytes > 10 * MB
        wait_for(lambda: recording.buffered_bytes == 0)
        sent = put_many(recording, sent, 50)
        recording.close()
        assert numbers(disk / "bag") == list(range(sent)) and not recording.dropped


def test_what_the_buffer_has_no_room_for_is_counted(tmp_path):
    with image_disk(tmp_path, 64) as (disk, _):
        recording = begin(disk / "bag", buffer_mb=5)
        sent = put_many(recording, 0, 40, 0.005)
        wait_for(lambda: recording.buffered_bytes == 0)
        with frozen(disk):
            sent = put_many(recording, sent, 200)
            assert 4 * MB < recording.buffered_bytes <= 5 * MB, "bounded"
        wait_for(lambda: recording.buffered_bytes == 0)
        sent = put_many(recording, sent, 20, 0.005)
        recording.close()
        kept = numbers(disk / "bag")
    assert recording.dropped["/t"] == sent - len(kept) >= 140
    assert kept == sorted(kept) and {*range(40), *range(sent - 20, sent)} <= set(kept)
    assert recording.recorded == {"/t": len(kept)}


def test_of_what_comes_together_all_that_has_room_is_kept(tmp_path):
    recording = begin(tmp_path / "bag", buffer_mb=5)
    recording.put([("/t", 1, message(0)), ("/t", 2, bytes(6 * MB)), ("/t", 3, message(2))])
    recording.close()
    assert numbers(tmp_path / "bag") == [0, 2]
    assert recording.dropped == {"/t": 1}


@pytest.mark.parametrize("split_mb", [0, 4])
def test_a_full_disk_ends_the_bag_before_it_is_full(tmp_path, split_mb):
    with memory_disk(tmp_path, 24) as disk:
        recording = begin(disk / "bag", reserve_mb=6, split_mb=split_mb)
        sent = put_many(recording, 0, 500, 0.002)
        assert sent < 500
        assert "was ended, as its disk is full but for 6 MB: make room, and start the recorder again" in recording.ended
        recording.put([("/t", 10_000, message(sent))])
        with pytest.raises(BagError, match="make room"):
            recording.close()
        kept = numbers(disk / "bag")
        assert kept == list(range(len(kept)))
        assert 17 * MB < len(kept) * BYTES < 20.5 * MB, "25.2 MB but for 6, and a chunk more or less"
        assert recording.recorded == {"/t": len(kept)} and recording.dropped == {"/t": sent + 1 - len(kept)}
        assert repair_bag(disk / "bag").path is None, "nothing to repair: index and metadata are there"
        with Reader(disk / "bag") as reader:
            assert reader.message_count == len(kept)


def test_a_disk_that_is_full_at_the_start_is_told_at_once(tmp_path):
    with memory_disk(tmp_path, 8) as disk:
        recording = begin(disk / "bag", reserve_mb=16)
        wait_for(lambda: recording.ended)
        recording.put([("/t", 1, message(0))])
        with pytest.raises(BagError, match="make room"):
            recording.close()
        assert numbers(disk / "bag") == [] and recording.dropped == {"/t": 1}


def test_a_bag_whose_folder_is_taken_away_is_told(tmp_path):
    recording = begin(tmp_path / "bag")
    shutil.rmtree(tmp_path / "bag")
    wait_for(lambda: recording.ended)
    assert "No such file or directory" in recording.ended


@pytest.mark.parametrize("megabytes", [5, 6, 7, 8])
def test_a_disk_that_refuses_leaves_a_bag_that_can_be_read(tmp_path, megabytes):
    """Without a reserve: it is full in the middle of a chunk, and the chunks at its end make room for the index."""
    with memory_disk(tmp_path, megabytes) as disk:
        recording = begin(disk / "bag")
        sent = put_many(recording, 0, 500, 0.002)
        assert "No space left on device" in recording.ended and sent < 500
        with pytest.raises(BagError, match="No space left"):
            recording.close()
        kept = numbers(disk / "bag")
        assert kept == list(range(len(kept))) and megabytes - 3 < len(kept) * BYTES / MB
        assert recording.dropped["/t"] == sent - len(kept)
        with next((disk / "bag").glob("*.mcap")).open("rb") as file:
            assert sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages()) == len(kept)


def test_a_disk_that_breaks_is_told_and_what_was_on_it_is_repaired(tmp_path):
    """The disk is a file on another one that is full: it says that there is room, and fails (EIO) when it writes."""
    with memory_disk(tmp_path / "below", 24) as below:
        with image_disk(tmp_path / "above", 200, below / "disk.img") as (disk, image):
            recording = begin(disk / "bag", reserve_mb=16)
            sent = put_many(recording, 0, 4000, 0.01)
            assert sent < 4000, "told"
            assert "cannot write to the bag" in recording.ended
            with pytest.raises(BagError, match="cannot write to the bag"):
                recording.close()
            assert recording.dropped["/t"] + recording.recorded["/t"] == sent
        copy = tmp_path / "rescued.img"
        shutil.copyfile(image, copy)
    with image_disk(tmp_path / "rescued", 200, copy) as (disk, _):
        kept = numbers(repair_bag(disk / "bag", tmp_path / "out").path or disk / "bag")
    assert kept == list(range(len(kept))) and len(kept) * BYTES > 5 * MB


def test_power_loss_takes_no_more_than_what_is_new(tmp_path):
    """What the disk itself holds at some moment is what power loss at that moment leaves.

    The kernel alone would bring the messages to the disk after half a minute; they must be there in less.
    """
    copies = itertools.count()
    with image_disk(tmp_path / "flying", 64) as (disk, image):
        recording = begin(disk / "bag", reserve_mb=16)
        sent = put_many(recording, 0, 50)

        def is_safe() -> bool:
            folder = tmp_path / f"found_{next(copies)}"
            folder.mkdir()
            shutil.copyfile(image, folder / "lost.img")
            with image_disk(folder, 64, folder / "lost.img") as (found, _):
                try:
                    return numbers(repair_bag(found / "bag", folder / "out").path) == list(range(sent))
                except BagError:  # there is nothing yet
                    return False

        wait_for(is_safe)
        recording.close()
