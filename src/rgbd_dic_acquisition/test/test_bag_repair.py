"""Bags that were cut off anywhere: what is in whole chunks is in the new bag, and the old one is untouched."""

from __future__ import annotations

import random
import subprocess
import sys
import time

import numpy as np
import pytest
import rclpy
import yaml
from mcap.reader import make_reader
from rgbd_dic_acquisition.bag import BagReader, BagWriter, make_message
from rgbd_dic_acquisition.bag_repair import repair_bag
from rgbd_dic_acquisition.bag_writer import CHUNK_BYTES
from rgbd_dic_acquisition.errors import BagError
from rgbd_dic_acquisition.message_types import serialise
from rgbd_dic_acquisition.messages import stamp_to_ns
from rgbd_dic_acquisition.offered_qos import latched_topics
from sensor_msgs.msg import Image
from test_nodes import Processes

from rgbd_dic_acquisition import messages

IMAGES = 40  # of 100 kB: four chunks


def write(path, compression="none", first=0):
    """Images, attitude, and a latched topic that nothing was said on."""
    rng = np.random.default_rng(first)
    with BagWriter(path, compression) as bag:
        bag.add_topic("/camera/image_raw", messages.IMAGE, reliable=False)
        bag.add_topic("/tf_static", messages.TF, transient_local=True)
        for k in range(first, first + IMAGES):
            pixels = rng.integers(0, 256, (250, 400), np.uint8)
            image = messages.image_message(make_message, 1000 * k, "camera", pixels, "mono8")
            bag.write_message("/camera/image_raw", 1000 * k, image)
            if k == first + 12:
                bag.add_topic("/imu/data", messages.IMU)  # introduced in the second chunk
            if k >= first + 12:
                imu = messages.imu_message(make_message, 1000 * k, "base_link", (0, 0, 0, 1), np.eye(3))
                bag.write_message("/imu/data", 1000 * k + 500, imu)
    return path


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """(bag, its bytes, all its messages, [(end of chunk, how many messages until there)])"""
    path = write(tmp_path_factory.mktemp("whole") / "flight")
    (path / "calibration.yaml").write_text("camera: {}\n")
    with BagReader(path) as bag:
        sent = list(bag.raw_messages())
    return path, (path / "flight_0.mcap").read_bytes(), sent, chunk_ends(path / "flight_0.mcap")


def chunk_ends(file):
    with file.open("rb") as stream:
        reader = make_reader(stream)
        index = sorted(reader.get_summary().chunk_indexes, key=lambda chunk: chunk.chunk_start_offset)
        times = [message.log_time for _, _, message in reader.iter_messages()]
    return [
        (chunk.chunk_start_offset + chunk.chunk_length, sum(t <= chunk.message_end_time for t in times))
        for chunk in index
    ]


def read(path):
    with BagReader(path) as bag:
        return list(bag.raw_messages())


def positions(size, ends):
    """Each end of a chunk and its neighbourhood, the ends of the file, and anywhere."""
    near = [end + shift for end, _ in ends for shift in (-1, 0, 1, 8, 9, 200)]
    anywhere = random.Random(1).sample(range(size), 40)
    return sorted({*near, *anywhere, 0, 4, 8, 9, 20, size - 200, size - 9, size - 8, size - 1})


def test_cut_anywhere(whole, tmp_path):
    _, data, sent, ends = whole
    for cut in positions(len(data), ends):
        bag = tmp_path / f"cut_{cut}"
        bag.mkdir()
        file = bag / "flight_0.mcap"
        file.write_bytes(data[:cut])
        expected = max([count for end, count in ends if end <= cut], default=0)
        if expected == 0:
            with pytest.raises(BagError, match="holds no whole chunk"):
                repair_bag(bag)
            assert not (tmp_path / f"cut_{cut}_repaired").exists()
            continue
        repair = repair_bag(bag)
        assert repair.path == tmp_path / f"cut_{cut}_repaired"
        assert repair.messages == expected and repair.damaged_chunks == 0
        assert read(repair.path) == sent[:expected], cut
        assert file.read_bytes() == data[:cut], "the old one is only read"
        assert list(bag.iterdir()) == [file]
        information = yaml.safe_load((repair.path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
        assert information["message_count"] == expected


def test_what_is_lost_is_told(whole, tmp_path):
    _, data, _, ends = whole
    file = tmp_path / "flight_0.mcap"
    file.write_bytes(data[: ends[1][0] + 5000])
    index_bytes = 2000  # of the messages of the chunk before, which is whole itself
    assert 5000 - index_bytes < repair_bag(file).lost_bytes <= 5000
    file.write_bytes(data[:-9])
    assert repair_bag(file, tmp_path / "second").lost_bytes == 0, "the messages are all there"


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_topics_are_described_as_before(tmp_path, compression):
    path = write(tmp_path / "flight", compression)
    before = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    data = (path / "flight_0.mcap").read_bytes()
    (path / "flight_0.mcap").write_bytes(data[:-100])
    after = yaml.safe_load((repair_bag(path).path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    for key in ("topics_with_message_count", "message_count", "duration", "starting_time"):
        assert after[key] == before[key]
    assert (tmp_path / "flight_repaired" / "flight_repaired_0.mcap").stat().st_size == pytest.approx(
        len(data), rel=0.01
    )


def test_a_damaged_chunk_is_left_out_and_the_rest_kept(whole, tmp_path):
    _, data, sent, ends = whole
    damaged = bytearray(data)
    damaged[(ends[1][0] + ends[2][0]) // 2] ^= 0x10
    file = tmp_path / "flight_0.mcap"
    file.write_bytes(damaged)
    repair = repair_bag(file)
    assert repair.damaged_chunks == 1
    assert read(repair.path) == sent[: ends[1][1]] + sent[ends[2][1] :]


def test_a_damaged_index_is_made_anew(whole, tmp_path):
    _, data, sent, ends = whole
    for k, at in enumerate(range(ends[-1][0] + 700, len(data), 150)):
        damaged = bytearray(data)
        damaged[at : at + 4] = b"\xff" * 4
        file = tmp_path / f"{k}.mcap"
        file.write_bytes(damaged)
        assert read(repair_bag(file).path or file) == sent  # some bytes there mean nothing
    assert k > 20


def test_room_that_was_never_written_is_not_taken_for_messages(whole, tmp_path):
    """After power loss a file may have its length, and zeros in place of its end."""
    _, data, sent, ends = whole
    for end in (ends[1][0], ends[1][0] + 100_000):
        file = tmp_path / f"{end}.mcap"
        file.write_bytes(data[:end] + bytes(len(data) - end))
        assert read(repair_bag(file).path) == sent[: ends[1][1]]


def test_missing_metadata_is_made_anew(whole, tmp_path):
    _, data, sent, _ = whole
    bag = tmp_path / "flight"
    bag.mkdir()
    (bag / "flight_0.mcap").write_bytes(data)
    (bag / "calibration.yaml").write_text("camera: {}\n")
    repair = repair_bag(bag)
    assert read(repair.path) == sent
    assert (repair.path / "flight_repaired_0.mcap").samefile(bag / "flight_0.mcap"), "linked, as it is whole"
    assert (repair.path / "calibration.yaml").read_text() == "camera: {}\n"
    assert sorted(path.name for path in bag.iterdir()) == ["calibration.yaml", "flight_0.mcap"]


def test_a_bag_of_several_files_of_which_the_last_was_cut(whole, tmp_path):
    _, data, sent, _ = whole
    bag = tmp_path / "flight"
    bag.mkdir()
    second = write(tmp_path / "later", first=IMAGES)
    end, count = chunk_ends(second / "later_0.mcap")[2]
    (bag / "flight_2.mcap").write_bytes(data)
    (bag / "flight_10.mcap").write_bytes((second / "later_0.mcap").read_bytes()[: end + 50_000])
    with pytest.raises(BagError, match="rgbd-dic info --repair"):
        BagReader(bag)
    assert read(repair_bag(bag).path) == sent + read(second)[:count]


def test_a_recording_of_several_files_that_was_not_closed(tmp_path):
    """As a killed recorder leaves it: the finished files are linked, what was flushed of the last one is copied."""
    bag = BagWriter(tmp_path / "flight", split_bytes=500_000)
    bag.add_topic("/t", "std_msgs/msg/String", transient_local=True)
    for k in range(19):
        bag.write("/t", k, bytes([k]) * 100_000)
    bag.flush()
    bag.write("/t", 19, b"lost")
    finished = sorted((tmp_path / "flight").glob("*.mcap"))[:-1]
    with pytest.raises(BagError, match="rgbd-dic info --repair"):
        BagReader(tmp_path / "flight")
    repair = repair_bag(tmp_path / "flight")
    assert [data[0] for *_, data in read(repair.path)] == list(range(19))
    assert len(finished) == 3 and repair.lost_bytes == 0
    for k, file in enumerate(finished):
        assert (repair.path / f"flight_repaired_{k}.mcap").samefile(file)
    assert latched_topics(repair.path) == {"/t"}


def test_nothing_to_repair(whole):
    path, _, sent, _ = whole
    repair = repair_bag(path)
    assert (repair.path, repair.messages, repair.lost_bytes) == (None, len(sent), 0)
    assert not path.with_name("flight_repaired").exists()


def test_refused_in_words(whole, tmp_path):
    _, data, _, _ = whole
    with pytest.raises(BagError, match=r"holds no \.mcap file"):
        repair_bag(tmp_path)
    file = tmp_path / "flight_0.mcap"
    file.write_bytes(data[:-100])
    (tmp_path / "flight_0_repaired").mkdir()
    with pytest.raises(BagError, match="exists already: remove it first, or choose another name with --out"):
        repair_bag(file)
    file.write_bytes(b"RIFF" + bytes(1000))
    with pytest.raises(BagError, match="holds no whole chunk"):
        repair_bag(file, tmp_path / "other")


def test_hostile_bytes_are_refused_or_repaired(whole, tmp_path):
    """Bytes changed anywhere, lengths of records among them: whatever is kept was sent, in that order."""
    _, data, sent, ends = whole
    rng = random.Random(2)
    file = tmp_path / "flight_0.mcap"
    for k in range(60):
        changed = bytearray(data[: rng.randrange(ends[0][0], len(data))])
        for _ in range(rng.randrange(1, 4)):
            at = rng.choice([rng.randrange(len(changed)), rng.choice(ends)[0] + rng.randrange(20)]) % len(changed)
            changed[at : at + 8] = rng.choice([rng.randbytes(8), b"\xff" * 8, bytes(8)])
        file.write_bytes(changed)
        try:
            repair = repair_bag(file, tmp_path / f"out_{k}")
        except BagError:
            continue
        kept = iter(sent)
        assert all(message in kept for message in read(repair.path)), "a subsequence"


def test_a_recorder_that_is_killed_loses_at_most_its_last_chunk(tmp_path):
    script = (
        "import sys, itertools\n"
        "from rgbd_dic_acquisition.bag import BagWriter\n"
        "bag = BagWriter(sys.argv[1])\n"
        "bag.add_topic('/t', 'std_msgs/msg/String')\n"
        "for k in itertools.count():\n"
        "    bag.write('/t', k, k.to_bytes(8, 'little') * 2500)\n"
        "    print(k, flush=True)\n"
    )
    with subprocess.Popen([sys.executable, "-c", script, str(tmp_path / "flight")], stdout=subprocess.PIPE) as writer:
        for line in writer.stdout:
            if int(line) == 1000:
                break
        writer.kill()
        last = int((writer.stdout.read().split() or [line])[-1])
    repair = repair_bag(tmp_path / "flight")
    kept = [int.from_bytes(data[:8], "little") for *_, data in read(repair.path)]
    assert kept == list(range(len(kept)))
    chunk = 1024 * 1024 / 20_000
    assert len(kept) >= last + 1 - chunk - 2


def test_a_recorder_node_that_is_killed_in_flight(tmp_path):
    """The recorder gets SIGKILL while images come; what it wrote is repaired, and none is missing but the latest."""
    processes, flight = Processes(tmp_path), tmp_path / "flight"
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=int(processes._environment["ROS_DOMAIN_ID"]))
    node = rclpy.create_node("camera", context=context)
    try:
        publisher = node.create_publisher(Image, "camera/image_raw", 100)
        topics = ["camera/image_raw sensor_msgs/msg/Image"]
        recorder = processes.node("recorder_node", output=str(flight), topics=topics)
        file, end, sent = flight / "flight_0.mcap", time.monotonic() + 120, 0
        while not file.exists() or file.stat().st_size < 4_000_000:
            assert time.monotonic() < end, recorder.log.read_text()
            if publisher.get_subscription_count():
                pixels = np.full((250, 400), sent % 256, np.uint8)
                image = messages.image_message(make_message, sent, "camera", pixels, "mono8")
                publisher.publish(serialise(image))
                sent += 1
            time.sleep(0.01)
        recorder.kill()
        recorder.wait()
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)
        processes.end()
    with pytest.raises(BagError, match=r"is cut short .*rgbd-dic info --repair"):
        BagReader(flight)
    before = file.read_bytes()
    repair = repair_bag(flight)
    assert file.read_bytes() == before
    with BagReader(repair.path) as bag:
        received = [stamp_to_ns(message.header.stamp) for *_, message in bag.messages()]
    assert received == list(range(len(received))) and len(received) >= 30
    assert repair.lost_bytes < CHUNK_BYTES + 200_000, "at most the chunk that was being written"
