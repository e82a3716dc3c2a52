"""The acquisition nodes as they run: processes over the real middleware, each test in a domain of its own."""

from __future__ import annotations

import itertools
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from mcap.reader import make_reader
from pymavlink import mavutil
from rclpy.executors import SingleThreadedExecutor
from rgbd_dic_acquisition.bag import BagReader, BagWriter, make_message
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.drivers.attitude import enu_flu_from_ned_frd, quaternion_from_rpy
from rgbd_dic_acquisition.in_flight import header_stamp_ns
from rgbd_dic_acquisition.message_types import serialise
from rgbd_dic_acquisition.messages import (
    camera_info_message,
    depth_from_message,
    image_from_message,
    image_message,
    imu_message,
    stamp_to_ns,
)
from rgbd_dic_acquisition.nodes.diagnostics import matched_subscriptions
from rgbd_dic_acquisition.simulator.flight import Flight, FlightSettings
from rgbd_dic_acquisition.simulator.live import scene_time_s

START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 16_666_667
IMAGES = 90
RECORDED = {
    "camera/image_raw": "sensor_msgs/msg/Image",
    "camera/camera_info": "sensor_msgs/msg/CameraInfo",
    "imu/data": "sensor_msgs/msg/Imu",
    "label": "std_msgs/msg/String latched",
}
_domains = itertools.count(os.getpid())


os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"


class Processes:
    """Starts nodes in one ROS domain and ends all of them."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(10 + next(_domains) % 90),
            "ROS_LOG_DIR": str(folder / "log"),
            "PYTHONUNBUFFERED": "1",
        }
        self._running: list[subprocess.Popen] = []

    def node(self, name: str, *more: str, **parameters: object) -> subprocess.Popen:
        arguments = [f"{key.replace('__', '.')}:={_yaml(value)}" for key, value in parameters.items()]
        given = [word for argument in arguments for word in ("-p", argument)]
        return self.start("-m", f"rgbd_dic_acquisition.nodes.{name}", "--ros-args", *given, *more)

    def start(self, *arguments: str) -> subprocess.Popen:
        number = len(self._running)
        with (self._folder / f"process_{number}.txt").open("w") as log:
            process = subprocess.Popen(
                [sys.executable, *arguments], env=self._environment, stdout=log, stderr=subprocess.STDOUT
            )
        process.log = Path(log.name)
        self._running.append(process)
        return process

    def wait_until_matched(self, topics: list[str], seconds: float = 30.0) -> None:
        """Until each topic has a subscription, by what its publisher's node says on /diagnostics."""
        matched: dict[str, int] = {}

        def take(message: DiagnosticArray) -> None:
            matched.update({topic: n for (_, topic), n in matched_subscriptions(message).items()})

        context = rclpy.Context()
        rclpy.init(context=context, domain_id=int(self._environment["ROS_DOMAIN_ID"]))
        node, executor = (
            rclpy.create_node("watcher", context=context),
            SingleThreadedExecutor(context=context),
        )
        try:
            node.create_subscription(DiagnosticArray, "/diagnostics", take, 100)
            executor.add_node(node)
            end = time.monotonic() + seconds
            while not all(matched.get(f"/{topic}") for topic in topics):
                assert time.monotonic() < end, matched
                executor.spin_once(timeout_sec=0.1)
        finally:
            executor.shutdown()
            node.destroy_node()
            rclpy.shutdown(context=context)

    def end(self) -> None:
        for process in self._running:
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
        for process in self._running:
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _yaml(value: object) -> str:
    return yaml.safe_dump(value, default_flow_style=True, width=10_000).replace("\n...", "").strip()


def _stop(process: subprocess.Popen, number: int = signal.SIGTERM) -> str:
    process.send_signal(number)
    assert process.wait(10) == 0, process.log.read_text()
    return process.log.read_text()


def _finish(process: subprocess.Popen, code: int = 0) -> str:
    assert process.wait(60) == code, process.log.read_text()
    return process.log.read_text()


def _wait_for(process: subprocess.Popen, text: str, seconds: float = 30.0) -> None:
    end = time.monotonic() + seconds
    while text not in process.log.read_text():
        assert process.poll() is None and time.monotonic() < end, process.log.read_text()
        time.sleep(0.05)


@pytest.fixture
def processes(tmp_path):
    started = Processes(tmp_path)
    yield started
    started.end()


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    """1.5 s of small images, their calibration, attitude at 120 Hz and one latched message, in several files."""
    path = tmp_path_factory.mktemp("source") / "flight"
    rng = np.random.default_rng(11)
    camera = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
    with BagWriter(path, split_bytes=120_000) as writer:
        for name, kind in RECORDED.items():
            writer.add_topic(f"/{name}", kind.split()[0], transient_local="latched" in kind)
        writer.write("/label", START_NS, serialise(make_message("std_msgs/msg/String", data="panel 1")))
        for k in range(IMAGES):
            stamp = START_NS + k * PERIOD_NS
            pixels = rng.integers(0, 256, (48, 64), np.uint8)
            about = (make_message, stamp, "camera_optical_frame")
            writer.write("/camera/image_raw", stamp + 9_000_000, serialise(image_message(*about, pixels, "mono8")))
            writer.write("/camera/camera_info", stamp + 9_100_000, serialise(camera_info_message(*about, camera)))
            for shift in (10_000_000, 16_000_000):
                imu = imu_message(make_message, stamp + shift, "base_link", (0, 0, 0, 1), np.eye(3))
                writer.write("/imu/data", stamp + shift, serialise(imu))
    assert len(list(path.glob("*.mcap"))) == 4
    return path


def _messages(path: Path) -> dict[str, list[bytes]]:
    found = defaultdict(list)
    with BagReader(path) as reader:
        for topic, _, _, data in reader.raw_messages():
            found[topic].append(data)
    return dict(found)


def _padded(data: bytes) -> bytes:
    """As the middleware delivers it: RTPS fills payloads up to a multiple of four bytes."""
    return data + b"\0" * (-len(data) % 4)


def _requested(names=RECORDED) -> list[str]:
    return [f"{name} {RECORDED[name]}" for name in names]


def _matched(names=RECORDED, count: int = 1) -> list[str]:
    return [f"{name} {count}" for name in names]


@pytest.mark.parametrize("rate", [1.0, 0.0])
def test_what_is_played_is_recorded_byte_for_byte(processes, bag, tmp_path, rate):
    output = tmp_path / "copy"
    deep = {"queue_depth": 1000}  # the whole bag: without acknowledgements nothing else holds a fast player back
    recorder = processes.node("recorder_node", output=str(output), topics=_requested(), use_sim_time=True, **deep)
    player = processes.node("player_node", bag=str(bag), rate=rate, wait_for_matched=_matched(), **deep)
    log = _finish(player)
    _stop(recorder)
    source, copy = _messages(bag), _messages(output)
    assert {topic: len(data) for topic, data in source.items()} == {
        "/camera/image_raw": IMAGES,
        "/camera/camera_info": IMAGES,
        "/imu/data": 2 * IMAGES,
        "/label": 1,
    }
    assert copy == {topic: [_padded(message) for message in data] for topic, data in source.items()}
    for topic, data in source.items():
        assert f"published {len(data)} on {topic}" in log
    # The same with the reader of the format itself, every checksum checked, and in the metadata.
    with (output / "copy_0.mcap").open("rb") as file:
        independent = defaultdict(list)
        for _, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            independent[channel.topic].append(message.data)
    assert independent == copy
    information = yaml.safe_load((output / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    counts = {t["topic_metadata"]["name"]: t["message_count"] for t in information["topics_with_message_count"]}
    assert counts == {topic: len(data) for topic, data in source.items()}


def test_log_times_follow_the_clock_of_the_bag(processes, bag, tmp_path):
    output = tmp_path / "copy"
    recorder = processes.node("recorder_node", output=str(output), topics=_requested(), use_sim_time=True)
    _finish(processes.node("player_node", bag=str(bag), wait_for_matched=_matched(), start_delay_s=0.3))
    _stop(recorder)
    with BagReader(output) as reader:
        times = [(header_stamp_ns(data), log) for topic, _, log, data in reader.raw_messages() if "image" in topic]
    delays_ms = [(log - stamp) / 1e6 for stamp, log in times]
    # The bag was recorded 9 ms after each stamp; /clock steps by the messages, up to 8 ms apart.
    assert np.median(delays_ms) == pytest.approx(9, abs=1)
    assert max(delays_ms) < 100


FLOW_CONTROL = {
    "rate": 0.0,
    "window": 4,
    "acknowledge_topics": ["frame_pair rgbd_dic_msgs/msg/FramePair", "plane rgbd_dic_msgs/msg/PlaneStamped"],
}


def test_answers_hold_the_player_back_and_none_is_lost(processes, bag, tmp_path):
    report = tmp_path / "report.json"
    answering = processes.start(str(Path(__file__).with_name("answering_node.py")), str(report), "0.03", "0")
    player = processes.node(
        "player_node",
        bag=str(bag),
        **FLOW_CONTROL,
        wait_for_matched=["camera/image_raw 1"],
        start_delay_s=0.5,
    )
    started = time.monotonic()
    _finish(player)
    _stop(answering)
    seen = json.loads(report.read_text())
    assert seen["received"] == IMAGES
    assert seen["most"] == 4
    assert time.monotonic() - started > IMAGES / 4 * 0.03  # it did wait for the answers


def test_a_missing_answer_ends_the_player_with_its_name(processes, bag, tmp_path):
    script = str(Path(__file__).with_name("answering_node.py"))
    processes.start(script, str(tmp_path / "report.json"), "0.0", "5")
    player = processes.node(
        "player_node",
        bag=str(bag),
        **FLOW_CONTROL,
        acknowledge_timeout_s=1.0,
        wait_for_matched=["camera/image_raw 1"],
        start_delay_s=0.5,
    )
    log = _finish(player, code=1)
    stamp_s = (START_NS + 4 * PERIOD_NS) / 1e9
    assert f"waiting for plane for the image of stamp {stamp_s:.9f} s" in log


def test_sigterm_leaves_a_readable_bag_of_all_topics_in_the_namespace(processes, bag, tmp_path):
    output = tmp_path / "cut"
    recorder = processes.node("recorder_node", "-r", "__ns:=/uav1", output=str(output), linger_s=0.0)
    player = processes.node(
        "player_node", "-r", "__ns:=/uav1", bag=str(bag), rate=0.2, wait_for_matched=_matched(), linger_s=0.0
    )
    _wait_for(player, "1.")
    time.sleep(1.0)
    log = _stop(recorder)
    assert player.poll() is None
    copy, source = _messages(output), _messages(bag)
    assert set(copy) == {f"/uav1/{name}" for name in RECORDED}
    assert 0 < len(copy["/uav1/camera/image_raw"]) < IMAGES
    for topic, data in copy.items():
        original = [_padded(message) for message in source[topic.removeprefix("/uav1")]]
        first = original.index(data[0])
        assert data == original[first : first + len(data)]  # without a gap
    total = sum(map(len, copy.values()))
    assert f"recorded {total} messages of 4 topics" in log


def test_a_type_that_is_not_installed_is_skipped_and_named(processes, tmp_path):
    recorder = processes.node(
        "recorder_node",
        output=str(tmp_path / "bag"),
        topics=["a no_such_msgs/msg/Thing", *_requested(["imu/data"])],
    )
    _wait_for(recorder, "recording into")
    log = _stop(recorder, signal.SIGINT)
    assert "/a is not recorded: message type 'no_such_msgs/msg/Thing' is not available" in log
    assert "recorded 0 messages of 1 topics" in log


FLIGHT = {
    "flight__seed": 5,
    "flight__duration_s": 0.2,
    "flight__camera__width_px": 96,
    "flight__camera__height_px": 72,
    "flight__timing__camera_rate_hz": 50.0,
}


def test_both_sensors_show_the_same_flight_with_stamps_that_match(processes, tmp_path):
    output = tmp_path / "live"
    topics = ["camera/image_raw sensor_msgs/msg/Image", "camera/camera_info sensor_msgs/msg/CameraInfo"]
    topics += [
        "tof/depth/image_raw sensor_msgs/msg/Image",
        "tof/depth/camera_info sensor_msgs/msg/CameraInfo",
    ]
    recorder = processes.node("recorder_node", output=str(output), topics=topics)
    _wait_for(recorder, "recording into")
    camera = processes.node("camera_node", **FLIGHT)
    tof = processes.node("tof_node", **FLIGHT)
    processes.wait_until_matched([topic.split()[0] for topic in topics])
    _wait_for(camera, "camera runs")
    time.sleep(2.0)
    for process in (camera, tof, recorder):
        _stop(process)
    found = defaultdict(dict)
    with BagReader(output) as reader:
        for topic, _, message in reader.messages():
            found[topic][stamp_to_ns(message.header.stamp)] = message
    images, infos = found["/camera/image_raw"], found["/camera/camera_info"]
    depths, depth_infos = found["/tof/depth/image_raw"], found["/tof/depth/camera_info"]
    assert list(images) == list(infos) and list(depths) == list(depth_infos)
    assert len(images) > 60 and len(depths) > 25
    assert set(np.diff(sorted(images))) == {20_000_000}
    assert {message.header.frame_id for message in images.values()} == {"camera_optical_frame"}
    assert {message.header.frame_id for message in infos.values()} == {"camera_optical_frame"}
    settings = FlightSettings.from_mapping(
        {
            "seed": 5,
            "duration_s": 0.2,
            "camera": {"width_px": 96, "height_px": 72},
            "timing": {"camera_rate_hz": 50.0},
        }
    )
    flight = Flight(settings)
    assert Camera.from_camera_info(next(iter(infos.values()))) == flight.calibration.camera
    stamp, message = list(images.items())[7]
    index = round(scene_time_s(stamp, settings) * 50)
    np.testing.assert_array_equal(image_from_message(message), flight.image(index / 50, index))
    stamp, message = list(depths.items())[7]
    number, rest = divmod(stamp - 7_300_000, 50_000_000)  # 20 Hz, 7.3 ms after the camera
    assert rest == 0
    expected = flight.depth(scene_time_s(stamp, settings), number).depth_m
    np.testing.assert_allclose(depth_from_message(message), expected, atol=0.51e-3)  # sent in millimetres


def test_attitude_of_an_autopilot_reaches_the_graph(processes, tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    output = tmp_path / "attitude"
    topics = ["imu/data sensor_msgs/msg/Imu", "autopilot/time_reference sensor_msgs/msg/TimeReference"]
    recorder = processes.node("recorder_node", output=str(output), topics=topics)
    _wait_for(recorder, "recording into")
    node = processes.node("mavlink_node", link__url=f"udpin://127.0.0.1:{port}", orientation_std_rad=0.1)
    peer = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_component=1, dialect="common")
    processes.wait_until_matched(["imu/data", "autopilot/time_reference"])
    q = quaternion_from_rpy(0.1, -0.2, 2.0)
    sent_from = time.time_ns()
    for k in range(60):
        peer.mav.attitude_quaternion_send(1000 + 20 * k, *q, 0.01, 0.02, 0.03)
        time.sleep(0.02)
    peer.mav.system_time_send(1_700_000_000_000_000, 1000 + 20 * 60)
    time.sleep(0.5)
    peer.close()
    _stop(node)
    _stop(recorder)
    with BagReader(output) as reader:
        received = list(reader.messages())
    attitudes = [message for topic, _, message in received if topic == "/imu/data"]
    (reference,) = [message for topic, _, message in received if topic == "/autopilot/time_reference"]
    assert len(attitudes) == 60
    orientation = attitudes[0].orientation
    expected = enu_flu_from_ned_frd(q)
    assert (orientation.w, orientation.x, orientation.y, orientation.z) == pytest.approx(expected, abs=1e-6)
    assert attitudes[0].orientation_covariance[0] == pytest.approx(0.01)
    assert attitudes[0].angular_velocity.y == pytest.approx(-0.02)
    stamps = [stamp_to_ns(message.header.stamp) for message in attitudes]
    assert sent_from - 10_000_000 < stamps[0] and all(a < b for a, b in itertools.pairwise(stamps))
    assert stamp_to_ns(reference.time_ref) == 1_700_000_000_000_000_000


@pytest.mark.parametrize(
    ("node", "parameters", "reason"),
    [
        ("camera_node", {"source": "webcam"}, r"source = 'webcam': choose one of simulated, aravis"),
        ("camera_node", {"aravis__exposure_s": 0.02}, r"longer than the time between images at frame_rate_hz = 60"),
        ("camera_node", {"depth": 0}, r"depth = 0 frames is out of range: must be at least 1"),
        ("camera_node", {"flight__seed": "x"}, r"seed = 'x': expected int"),
        ("tof_node", {"reliability": "maybe"}, r"reliability = 'maybe': choose one of reliable, best_effort"),
        ("tof_node", {"calibration": "/none.yaml"}, r"cannot read calibration /none.yaml"),
        ("mavlink_node", {"link__url": "udp:14550"}, r"link 'udp:14550' is not understood"),
        ("recorder_node", {}, r"parameter output is missing"),
        ("player_node", {"bag": "/no/such/bag"}, r"there is no bag /no/such/bag"),
        ("player_node", {"bag": "x", "rate": -1.0}, r"rate = -1.0 x is out of range"),
        ("player_node", {"acknowledge_topics": ["plane"]}, r"'plane' is not understood; give 'NAME TYPE'"),
    ],
)
def test_a_wrong_parameter_is_refused_with_the_reason(processes, node, parameters, reason):
    log = _finish(processes.node(node, **parameters), code=1)
    assert re.search(reason, log)
    assert len(log.splitlines()) == 1  # no traceback


@pytest.mark.parametrize(
    ("entry", "reason"),
    [("label", "'label' is not understood; give 'NAME COUNT [NODE ...]'"), ("x 1", "x is not played")],
)
def test_what_to_wait_for_must_be_played(processes, bag, entry, reason):
    assert reason in _finish(processes.node("player_node", bag=str(bag), wait_for_matched=[entry]), code=1)


def test_nobody_to_play_for_is_an_error(processes, bag):
    player = processes.node(
        "player_node", bag=str(bag), wait_for_matched=["imu/data 2"], match_timeout_s=0.5, topics=["imu/data"]
    )
    assert "/imu/data has 0 of 2 subscriptions" in _finish(player, code=1)


def test_the_parameter_file_reaches_a_node_in_a_namespace(processes, tmp_path):
    default = Path(__file__).parents[1] / "config" / "acquisition.yaml"
    changed = tmp_path / "changed.yaml"
    changed.write_text(default.read_text().replace("source: simulated", "source: webcam"))
    arguments = ("-r", "__ns:=/uav1", "--params-file", str(changed))
    assert "source = 'webcam'" in _finish(processes.node("camera_node", *arguments), code=1)
