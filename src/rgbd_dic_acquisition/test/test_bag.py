"""Bags: written as ros2 bag expects them, read back whole by two libraries, refused in words when bad."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from rgbd_dic_acquisition.bag import BagReader, BagWriter, make_message
from rgbd_dic_acquisition.bag_repair import repair_bag
from rgbd_dic_acquisition.errors import BagError
from rgbd_dic_acquisition.message_types import definition
from rgbd_dic_acquisition.offered_qos import latched_topics
from rosbags.rosbag2 import Reader

from rgbd_dic_acquisition import messages

IMAGE, OPENING = messages.IMAGE, "rgbd_dic_msgs/msg/CrackOpening"


def write_sample(path, compression="none", count=30, split_bytes=0, truth_late_ns=-500):
    """Images of 100 kB, so that there is more than one chunk, and truth; log times not in order, unless it is late."""
    with BagWriter(path, compression, split_bytes) as bag:
        bag.add_topic("/camera/image_raw", IMAGE, reliable=False)
        bag.add_topic("/crack_opening_truth", OPENING)
        bag.add_topic("/tf_static", messages.TF, transient_local=True)
        for k in range(count):
            pixels = np.full((250, 400), k, np.uint8)
            image = messages.image_message(make_message, 1000 * k, "camera", pixels, "mono8")
            bag.write_message("/camera/image_raw", 1000 * k + 500, image)
            bag.write_message(
                "/crack_opening_truth", 1000 * k + 500 + truth_late_ns, make_message(OPENING, opening=float(k))
            )
    return bag


@pytest.fixture
def bag_path(tmp_path):
    write_sample(tmp_path / "flight")
    return tmp_path / "flight"


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_both_libraries_read_every_message(tmp_path, compression):
    written = write_sample(tmp_path / "flight", compression)
    with Reader(tmp_path / "flight") as reader:
        by_rosbags = [(c.topic, time, bytes(data)) for c, time, data in reader.messages(reader.connections)]
    with (tmp_path / "flight" / "flight_0.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        statistics = reader.get_summary().statistics
        by_mcap = [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages()]
    assert statistics.chunk_count > 1
    assert statistics.message_count == sum(written.counts.values()) == 60
    assert by_rosbags == by_mcap
    assert [time for _, time, _ in by_mcap] == sorted(time for _, time, _ in by_mcap)


@pytest.mark.parametrize("which", ["", "flight_0.mcap"])
def test_reader_gives_topics_times_and_messages(bag_path, which):
    with BagReader(bag_path / which) as bag:
        assert {name: (info.type, info.count) for name, info in bag.topics.items()} == {
            "/camera/image_raw": (IMAGE, 30),
            "/crack_opening_truth": (OPENING, 30),
            "/tf_static": (messages.TF, 0),
        }
        assert (bag.start_ns, bag.end_ns) == (0, 29500)
        truth = [(time, msg.opening) for _, time, msg in bag.messages(["/crack_opening_truth"])]
        assert truth == [(1000 * k, float(k)) for k in range(30)]
        both = [time for _, time, _ in bag.messages()]
        assert both == sorted(both) and len(both) == 60
        raw = list(bag.raw_messages(["/camera/image_raw"]))
        assert {(topic, typename) for topic, typename, _, _ in raw} == {("/camera/image_raw", IMAGE)}


def test_raw_bytes_can_be_written_on(bag_path, tmp_path):
    with BagReader(bag_path) as source, BagWriter(tmp_path / "copy") as copy:
        for topic, typename, time, data in source.raw_messages():
            copy.add_topic(topic, typename)
            copy.write(topic, time, data, time + 1)
        expected = list(source.raw_messages())
    with BagReader(tmp_path / "copy") as bag:
        assert list(bag.raw_messages()) == expected


def test_file_is_what_ros2_bag_play_accepts(bag_path):
    information = yaml.safe_load((bag_path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["version"] == 9
    assert information["message_count"] == 60
    with (bag_path / "flight_0.mcap").open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        (record,) = [item for item in reader.iter_metadata() if item.name == "rosbag2"]
    assert yaml.safe_load(record.metadata["serialized_metadata"]) == information
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
        assert channel.metadata["topic_type_hash"] == definition(schema.name)[1]
        (qos,) = yaml.safe_load(channel.metadata["offered_qos_profiles"])
        durability = "transient_local" if channel.topic == "/tf_static" else "volatile"
        reliability = "best_effort" if channel.topic == "/camera/image_raw" else "reliable"
        assert (qos["durability"], qos["reliability"]) == (durability, reliability)


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_a_bag_of_several_files(tmp_path, compression):
    """As `ros2 bag record --max-bag-size` makes it: read as one bag by us and by rosbags, each file alone by mcap."""
    whole, path = tmp_path / "whole", tmp_path / "flight"
    write_sample(whole, compression, truth_late_ns=250)
    written = write_sample(path, compression, split_bytes=700_000, truth_late_ns=250)
    with BagReader(whole) as one, BagReader(path) as several:
        sent = list(one.raw_messages())
        assert list(several.raw_messages()) == sent
        assert several.topics == one.topics
        assert (several.start_ns, several.end_ns) == (one.start_ns, one.end_ns)
    with Reader(path) as reader:
        by_rosbags = [(c.topic, c.msgtype, time, bytes(data)) for c, time, data in reader.messages(reader.connections)]
        assert reader.message_count == 60 and reader.duration == 29250 + 1
        counts = {name: topic.msgcount for name, topic in reader.topics.items()}
    assert by_rosbags == sent
    assert counts == written.counts == {"/camera/image_raw": 30, "/crack_opening_truth": 30, "/tf_static": 0}
    assert latched_topics(path) == {"/tf_static"}

    information = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    names = [f"flight_{k}.mcap" for k in range(len(information["files"]))]
    assert len(names) == 5, "images of 100 kB, eight at a time until a file has its size"
    assert information["relative_file_paths"] == [file["path"] for file in information["files"]] == names
    assert sorted(file.name for file in path.iterdir()) == sorted([*names, "metadata.yaml"])
    by_file = []
    for about in information["files"]:
        with (path / about["path"]).open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            by_file.append([(c.topic, s.name, m.log_time, m.data) for s, c, m in reader.iter_messages()])
            channels, (record,) = reader.get_summary().channels.values(), reader.iter_metadata()
        times = [time for _, _, time, _ in by_file[-1]]
        assert about["message_count"] == len(times)
        assert about["starting_time"]["nanoseconds_since_epoch"] == min(times)
        assert about["duration"]["nanoseconds"] == max(times) - min(times)
        described = yaml.safe_load(record.metadata["serialized_metadata"])
        assert described["files"] == [about]
        of_bag = {
            topic["topic_metadata"]["name"]: topic["topic_metadata"]
            for topic in information["topics_with_message_count"]
        }
        for channel in channels:  # every file says all that is to know of every topic
            about_topic = of_bag[channel.topic]
            assert yaml.safe_load(channel.metadata["offered_qos_profiles"]) == about_topic["offered_qos_profiles"]
            assert channel.metadata["topic_type_hash"] == about_topic["type_description_hash"]
        assert {channel.topic for channel in channels} == set(of_bag)
    assert [message for of_file in by_file for message in of_file] == sent


def test_more_than_ten_files_are_read_in_their_order(tmp_path):
    write_sample(tmp_path / "flight", split_bytes=100_000, truth_late_ns=250)
    assert len(list((tmp_path / "flight").glob("*.mcap"))) == 31
    with BagReader(tmp_path / "flight") as bag:
        times = [time for _, time, _ in bag.messages()]
    assert times == sorted(times) and len(times) == 60


def test_what_was_flushed_is_there_whatever_comes_after(tmp_path):
    with BagWriter(tmp_path / "flight") as bag:
        bag.add_topic("/t", OPENING)
        bag.write_message("/t", 1, make_message(OPENING, opening=1.0))
        assert bag.counts == {"/t": 0}, "in no chunk yet"
        bag.flush()
        bag.write_message("/t", 2, make_message(OPENING, opening=2.0))
        assert bag.counts == {"/t": 1}
        repair = repair_bag(tmp_path / "flight")
    with BagReader(repair.path) as bag:
        assert [message.opening for *_, message in bag.messages()] == [1.0]


@pytest.mark.parametrize("typename", [IMAGE, messages.CAMERA_INFO, messages.IMU, OPENING])
def test_hashes_are_those_of_the_installed_messages(typename):
    packages = pytest.importorskip("ament_index_python.packages")
    package, _, name = typename.split("/")
    share = Path(packages.get_package_share_directory(package))
    hashes = json.loads((share / "msg" / f"{name}.json").read_text())["type_hashes"]
    installed = {entry["type_name"]: entry["hash_string"] for entry in hashes}
    assert definition(typename)[1] == installed[typename]


def test_same_messages_give_the_same_bytes(tmp_path):
    for name in "ab":
        write_sample(tmp_path / name / "flight", "zstd")
    for file in ("flight_0.mcap", "metadata.yaml"):
        one, two = ((tmp_path / name / "flight" / file).read_bytes() for name in "ab")
        assert one == two


def test_bag_is_closed_when_writing_fails(tmp_path):
    with pytest.raises(RuntimeError), BagWriter(tmp_path / "flight") as bag:
        bag.add_topic("/t", OPENING)
        bag.write_message("/t", 1, make_message(OPENING))
        raise RuntimeError
    with BagReader(tmp_path / "flight") as bag:
        assert bag.topics["/t"].count == 1


def test_empty_bag(tmp_path):
    BagWriter(tmp_path / "flight").close()
    with BagReader(tmp_path / "flight") as bag:
        assert (bag.topics, bag.start_ns, bag.end_ns, list(bag.messages())) == ({}, 0, 0, [])


def test_existing_path_is_refused(bag_path):
    with pytest.raises(BagError, match=r"flight exists already: choose another name, or remove it"):
        BagWriter(bag_path)


def test_wrong_use_of_the_writer_is_refused(tmp_path):
    with pytest.raises(BagError, match="compression 'lz9': choose one of none, zstd"):
        BagWriter(tmp_path / "a", "lz9")
    with BagWriter(tmp_path / "b") as bag:
        with pytest.raises(BagError, match="topic /t was not added"):
            bag.write("/t", 0, b"")
        with pytest.raises(BagError, match=r"package no_such_msgs is not found.*build the workspace"):
            bag.add_topic("/t", "no_such_msgs/msg/Thing")
        with pytest.raises(BagError, match="'Thing' is not the name of a message type"):
            bag.add_topic("/t", "Thing")
        bag.add_topic("/t", OPENING)
        with pytest.raises(BagError, match="log time -1 ns"):
            bag.write("/t", -1, b"")
        with pytest.raises(BagError, match="is rgbd_dic_msgs/msg/CrackOpening already"):
            bag.add_topic("/t", IMAGE)


def test_missing_bag(tmp_path):
    with pytest.raises(BagError, match=r"there is no bag .*nothing: check the path"):
        BagReader(tmp_path / "nothing")
    with pytest.raises(BagError, match=r"holds no .mcap file: give the directory of a bag"):
        BagReader(tmp_path)


def test_file_that_is_no_mcap(tmp_path):
    (tmp_path / "video.mcap").write_bytes(b"RIFF" + bytes(1000))
    with pytest.raises(BagError, match="is not an MCAP file"):
        BagReader(tmp_path / "video.mcap")
    (tmp_path / "empty.mcap").write_bytes(b"")
    with pytest.raises(BagError, match="is not an MCAP file"):
        BagReader(tmp_path / "empty.mcap")


@pytest.mark.parametrize("which", ["", "flight_0.mcap"])
def test_bag_that_is_cut_short(bag_path, which):
    file = bag_path / "flight_0.mcap"
    file.write_bytes(file.read_bytes()[:-2000])
    with pytest.raises(BagError, match=r"is cut short \(no footer\).*rgbd-dic info --repair"):
        BagReader(bag_path / which)


def test_bag_with_a_damaged_chunk_names_the_remedy(bag_path):
    file = bag_path / "flight_0.mcap"
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0xFF
    file.write_bytes(data)
    with BagReader(bag_path) as bag, pytest.raises(BagError, match=r"is damaged: .*rgbd-dic info --repair"):
        list(bag.messages())


def test_bag_without_metadata_is_read_from_its_file(bag_path):
    (bag_path / "metadata.yaml").unlink()
    with BagReader(bag_path) as bag:
        assert bag.topics["/camera/image_raw"].count == 30


def test_missing_topic_and_wrong_type_name_what_there_is(bag_path):
    with BagReader(bag_path) as bag:
        assert bag.require("camera/image_raw", IMAGE) == "/camera/image_raw"
        with pytest.raises(BagError, match="has no topic /tof/points; it has /camera/image_raw"):
            list(bag.messages(["/tof/points"]))
        with pytest.raises(BagError, match="has no topic tof/points"):
            bag.require("tof/points", messages.POINT_CLOUD)
        with pytest.raises(BagError, match="is of type sensor_msgs/msg/Image, needed is"):
            bag.require("/camera/image_raw", messages.CAMERA_INFO)
