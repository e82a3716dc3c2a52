"""What the player knows without ROS: answers, stamps in serialised messages, latched topics of a bag."""

from __future__ import annotations

import struct

import pytest
from rgbd_dic_acquisition.bag import BagWriter
from rgbd_dic_acquisition.errors import BagError
from rgbd_dic_acquisition.in_flight import InFlight, header_stamp_ns
from rgbd_dic_acquisition.offered_qos import latched_topics


def test_an_image_is_in_flight_until_every_topic_has_answered():
    in_flight = InFlight(["plane", "frame_pair"])
    in_flight.sent(10)
    in_flight.sent(20)
    assert not in_flight.acknowledged("plane", 10)
    assert not in_flight.acknowledged("plane", 10)  # twice counts once
    assert not in_flight.acknowledged("plane", 15)  # no such image
    assert len(in_flight) == 2 and in_flight.oldest() == "frame_pair for the image of stamp 0.000000010 s"
    assert in_flight.acknowledged("frame_pair", 10)
    assert len(in_flight) == 1 and (in_flight.answered, in_flight.most) == (1, 2)


def test_without_answers_nothing_is_in_flight():
    in_flight = InFlight([])
    in_flight.sent(10)
    assert len(in_flight) == 0 and in_flight.oldest() == "nothing"


@pytest.mark.parametrize(("encapsulation", "order"), [(b"\x00\x01\x00\x00", "<"), (b"\x00\x00\x00\x00", ">")])
def test_stamp_of_a_serialised_message(encapsulation, order):
    serialised = encapsulation + struct.pack(order + "iI", 1_700_000_000, 123_456_789) + b"rest"
    assert header_stamp_ns(serialised) == 1_700_000_000_123_456_789


def test_a_message_too_short_for_a_stamp_is_refused():
    with pytest.raises(BagError, match="11 bytes is too short"):
        header_stamp_ns(bytes(11))


def test_latched_topics_of_a_bag(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/label", "std_msgs/msg/String", transient_local=True)
        writer.add_topic("/imu/data", "sensor_msgs/msg/Imu")
    assert latched_topics(tmp_path / "bag") == {"/label"}
    assert latched_topics(tmp_path / "bag" / "bag_0.mcap") == {"/label"}
    (tmp_path / "text.mcap").write_text("not a bag")
    with pytest.raises(BagError, match="cannot read"):
        latched_topics(tmp_path / "text.mcap")
