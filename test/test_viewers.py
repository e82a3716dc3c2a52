"""The field's own viewers: what their files name is there, and a viewer on the websocket sees what is published."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
import yaml
from ament_index_python.packages import get_package_prefix
from foxglove_viewer import Watched, watch
from rclpy.executors import SingleThreadedExecutor
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.calibration import load_calibration
from rgbd_dic_acquisition.message_types import know_type, typestore
from rgbd_dic_acquisition.messages import stamp_to_ns
from rgbd_dic_processing.core.regions_file import load_regions
from rgbd_dic_processing.graph import TYPES
from rgbd_dic_processing.view_topics import PREVIEWED_FIELD, VIEW_TYPES
from rosbags.interfaces import Nodetype
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CompressedImage
from system import ROOT, SAMPLE, environment, rgbd_dic

FILES = ROOT / "src/rgbd_dic_processing/viewers"
LAYOUT = json.loads((FILES / "rgbd_dic.foxglove.json").read_text())
PATH = re.compile(r"/(?P<topic>[\w/]+)(?P<fields>(\.\w+(\[:\])?)+)(\.@mul\(1000\))?")
NUMBERS = {"float32", "float64", "uint8", "int32", "uint32"}
needs_foxglove = pytest.mark.skipif(
    subprocess.run([sys.executable, "-c", "import foxglove"], capture_output=True).returncode != 0,
    reason="no foxglove-sdk: make setup-viewers",
)


def field_type(typename: str, fields: str) -> str:
    """The basic type that fields such as `.status.value` or `.dx[:]` of a message lead to."""
    know_type(typename)
    kind: Any = (Nodetype.NAME, typename)
    for name, sliced in re.findall(r"\.(\w+)(\[:\])?", fields):
        node, content = kind
        assert node == Nodetype.NAME, f"{fields}: there is nothing inside {content}"
        kind = dict(typestore().fielddefs[content][1])[name]
        if kind[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            assert sliced, f"{fields}: {name} is an array"
            kind = kind[1][0]
        else:
            assert not sliced, f"{fields}: {name} is no array"
    assert kind[0] == Nodetype.BASE, f"{fields} is no number"
    return kind[1][0]


def panels(layout: Any) -> list[str]:
    """The panels that a layout shows."""
    return [layout] if isinstance(layout, str) else panels(layout["first"]) + panels(layout["second"])


def paths_of(panel: dict[str, Any]) -> list[str]:
    return [entry["value"] for entry in [*panel.get("paths", []), *filter(None, [panel.get("xAxisPath")])]]


def test_the_layout_shows_each_of_its_panels_once() -> None:
    assert sorted(panels(LAYOUT["layout"])) == sorted(LAYOUT["configById"])


@pytest.mark.parametrize("path", sorted({p for panel in LAYOUT["configById"].values() for p in paths_of(panel)}))
def test_every_message_path_of_the_layout_leads_to_a_number(path: str) -> None:
    parts = PATH.fullmatch(path)
    assert parts, "not a topic with fields"
    assert field_type(TYPES[parts["topic"]], parts["fields"]) in NUMBERS


def test_every_topic_of_the_layout_has_a_type_that_its_panel_shows() -> None:
    shown = []
    for name, panel in LAYOUT["configById"].items():
        if name.startswith("Image!"):
            mode = panel["imageMode"]
            shown.append((mode["imageTopic"], "sensor_msgs/msg/Image"))
            shown += [(topic, "visualization_msgs/msg/ImageMarker") for topic in mode.get("annotations", ())]
            shown += [(mode[key], "sensor_msgs/msg/CameraInfo") for key in ("calibrationTopic",) if key in mode]
        for topic, settings in panel.get("topics", {}).items():
            is_cloud = "colorField" in settings
            shown.append((topic, f"{'sensor_msgs' if is_cloud else 'visualization_msgs'}/msg/"))
    assert len(shown) > 6
    for topic, kind in shown:
        assert TYPES[topic.lstrip("/")].startswith(kind), topic


def test_every_display_of_the_rviz_configuration_has_its_topic() -> None:
    content = yaml.safe_load((FILES / "rgbd_dic.rviz").read_text())["Visualization Manager"]
    kinds = {
        "Camera": "sensor_msgs/msg/Image",
        "Image": "sensor_msgs/msg/Image",
        "MarkerArray": "visualization_msgs/msg/MarkerArray",
        "PointCloud2": "sensor_msgs/msg/PointCloud2",
    }
    assert content["Global Options"]["Fixed Frame"] == "camera_optical_frame"
    for display in content["Displays"]:
        kind = kinds[display["Class"].removeprefix("rviz_default_plugins/")]
        topic = display["Topic"]["Value"]
        assert TYPES[topic.lstrip("/")] == kind, topic
        if display["Class"].endswith("/Camera"):  # rviz looks for its calibration beside it
            assert TYPES[f"{topic.lstrip('/').rsplit('/', 1)[0]}/camera_info"] == "sensor_msgs/msg/CameraInfo"
            names = {entry["Name"] for entry in content["Displays"]} | {"Value"}
            assert set(display["Visibility"]) <= names


QOS = {"Value", "Depth", "History Policy", "Reliability Policy", "Durability Policy"}
FILTERED = QOS | {"Filter size"}  # of displays that wait for a transform
COMMON = {"Class", "Name", "Enabled", "Value", "Topic"}
CLOUD = {
    *("Alpha", "Color Transformer", "Position Transformer", "Style", "Size (Pixels)", "Size (m)", "Selectable"),
    *("Decay Time", "Channel Name", "Use rainbow", "Invert Rainbow", "Min Color", "Max Color"),
    *("Autocompute Intensity Bounds", "Min Intensity", "Max Intensity"),
}
PROPERTIES = {  # class -> the names of its properties in rviz's sources, and those of its topic
    "Camera": (
        {"Image Rendering", "Overlay Alpha", "Far Plane Distance", "Zoom Factor", "Visibility"},
        QOS,
    ),
    "Image": ({"Normalize Range", "Min Value", "Max Value", "Median window"}, QOS),
    "MarkerArray": ({"Namespaces"}, QOS),
    "PointCloud2": (CLOUD, FILTERED),
}
CHOICES = {
    "Image Rendering": {"background", "overlay", "background and overlay"},
    "Style": {"Points", "Squares", "Flat Squares", "Spheres", "Boxes", "Tiles"},
    "Color Transformer": {"RGB8", "Intensity"},
    "Position Transformer": {"XYZ"},
    "History Policy": {"System Default", "Keep Last", "Keep All"},
    "Reliability Policy": {"System Default", "Reliable", "Best Effort"},
    "Durability Policy": {"System Default", "Transient Local", "Volatile"},
}
ORBIT = {
    *(
        "Class",
        "Name",
        "Value",
        "Target Frame",
        "Distance",
        "Focal Point",
        "Focal Shape Fixed Size",
        "Focal Shape Size",
    ),
    *("Invert Z Axis", "Near Clip Distance", "Pitch", "Yaw"),
}
TOOLS = {"MoveCamera", "Select", "FocusCamera", "Measure"}


def test_the_rviz_configuration_has_the_names_of_rviz() -> None:
    """rviz takes no notice of a property that it does not know, and says nothing."""
    content = yaml.safe_load((FILES / "rgbd_dic.rviz").read_text())["Visualization Manager"]
    for display in content["Displays"]:
        own, of_topic = PROPERTIES[display["Class"].removeprefix("rviz_default_plugins/")]
        assert set(display) <= COMMON | own and set(display["Topic"]) <= of_topic, display["Name"]
        for name, value in {**display, **display["Topic"]}.items():
            assert name not in CHOICES or value in CHOICES[name], f"{display['Name']}: {name}"
        if channel := display.get("Channel Name"):
            assert channel == "behind" and display["Topic"]["Value"] == "/view/cloud"
    assert {tool["Class"].removeprefix("rviz_default_plugins/") for tool in content["Tools"]} <= TOOLS
    view = content["Views"]["Current"]
    assert view["Class"] == "rviz_default_plugins/Orbit" and set(view) <= ORBIT
    assert abs(view["Pitch"]) < np.pi / 2 - 0.001


def free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


def recorded(run: Path, topic: str) -> dict[int, bytes]:
    """Stamp -> bytes of what was published on a topic."""
    with BagReader(run / "bag") as bag:
        return {
            stamp_to_ns(bag.deserialise(kind, data).header.stamp): data
            for _, kind, _, data in bag.raw_messages([topic])
        }


def true_poses() -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Stamp -> R, t of X_camera = R X_panel + t [m], of the sample flight."""
    lines = np.genfromtxt(SAMPLE / "truth.csv", delimiter=",", names=True)
    stamps = [int(line.split(",")[0]) for line in (SAMPLE / "truth.csv").read_text().splitlines()[1:]]
    places = np.column_stack([lines[f"panel_{axis}_mm"] for axis in "xyz"]) * 1e-3
    turns = Rotation.from_quat(np.column_stack([lines[f"panel_q{axis}"] for axis in "xyzw"])).as_matrix()
    return dict(zip(stamps, zip(turns, places, strict=True), strict=True))


def enough(wanted: dict[str, int]) -> Any:
    return lambda seen: all(len(seen.came.get(topic, ())) >= count for topic, count in wanted.items())


@needs_foxglove
@pytest.mark.timeout(250)
def test_a_viewer_sees_what_is_published_where_it_truly_is(tmp_path: Path) -> None:
    """The sample flight, slowly; the viewer's bytes are those that the recorder heard, by the schema of the server.

    The motion that carries the zones is that of the whole panel, whose plates part by up to 1 mm = 0.7 px: they lie
    within 0.7 px of the truth in the picture. The corners in space are off by the noise of a single ToF plane, some
    tenths of a millimetre, and by up to 25 ms of motion between the ToF frame and the image: less than 5 mm.
    """
    run, port = tmp_path / "run", free_port()
    command = ["rgbd-dic", "up", SAMPLE, "--rate", "0.15", "--foxglove", port, "--domain", "88", "--out", run]
    process = subprocess.Popen(list(map(str, command)), env=environment(), stdout=subprocess.DEVNULL)
    wanted = {"/view/regions": 5, "/view/scene": 5, "/view/image_rect": 5, "/crack_opening": 20, "/view/opening": 20}
    try:
        seen = watch(port, {*wanted, "/reference", "/view/displacement"}, enough(wanted), timeout_s=150)
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(60)
    assert enough(wanted)(seen), {topic: len(came) for topic, came in seen.came.items()}
    assert len(seen.came["/reference"]) >= 1  # it was published before the viewer came
    for topic in wanted:
        published = recorded(run, topic) if topic != "/view/scene" else {}
        came = {stamp_to_ns(message.header.stamp): data for _, message, data in seen.came[topic]} if published else {}
        assert all(published[stamp] == data for stamp, data in came.items() if stamp in published)
        assert len(set(came) & set(published)) >= len(came) - 1  # the recorder may be ended before the last
    openings = {stamp_to_ns(m.header.stamp): m for _, m, _ in seen.came["/crack_opening"]}
    bands = {stamp_to_ns(m.header.stamp): m for _, m, _ in seen.came["/view/opening"]}
    both = set(openings) & set(bands)
    assert len(both) > 10
    for stamp in both:
        assert bands[stamp].upper_mm - bands[stamp].opening_mm == pytest.approx(openings[stamp].u_opening * 1e3)
    check_zones(seen)


def check_zones(seen: Watched) -> None:
    camera, regions = load_calibration(SAMPLE / "calibration.yaml").camera, load_regions(SAMPLE / "regions.yaml")
    poses = true_poses()
    R0, t0 = poses[min(poses)]
    normal, inverse = R0[:, 2], R0.T
    checked = 0
    for _, message, _ in seen.came["/view/regions"]:
        stamp = stamp_to_ns(message.header.stamp)
        R, t = poses[stamp]
        edges = np.array([[p.x, p.y] for p in message.points]).reshape(-1, 2, 2) - 0.5
        for name, zone, start in (("left", regions.crack.left, 8), ("right", regions.crack.right, 12)):
            rays = camera.rays(camera.undistort(zone))
            first = rays * (normal @ t0 / (rays @ normal))[:, None]
            corners = (first - t0) @ inverse.T @ R.T + t
            expected = camera.project(corners)  # the sample's images are small enough to be shown as they are
            np.testing.assert_allclose(edges[start : start + 4, 0], expected, atol=0.7)
            marker = scene_of(seen, stamp, name)
            if marker is not None:
                np.testing.assert_allclose([[p.x, p.y, p.z] for p in marker.points][:4], corners, atol=5e-3)
                checked += 1
    assert checked >= 6


def scene_of(seen: Watched, stamp_ns: int, name: str) -> Any:
    for _, message, _ in seen.came["/view/scene"]:
        for marker in message.markers:
            if marker.ns == name and stamp_to_ns(marker.header.stamp) == stamp_ns:
                return marker
    return None


def test_a_bag_is_annotated_with_what_viewers_show(tmp_path: Path) -> None:
    """The bag of a short run: all that was in it is still there, byte by byte, and what is added lies on the truth."""
    run, annotated = tmp_path / "run", tmp_path / "annotated"
    done = rgbd_dic("up", SAMPLE, "--as-fast-as-possible", "--duration", 8, "--domain", 89, "--out", run)
    assert done.returncode == 0, done.stderr
    done = rgbd_dic("annotate", run / "bag", "--out", annotated)
    assert done.returncode == 0, done.stderr
    with BagReader(run / "bag") as before, BagReader(annotated) as after:
        kept = [message for message in after.raw_messages() if message[0].lstrip("/") not in VIEW_TYPES]
        assert kept == list(before.raw_messages())
        assert {name.lstrip("/") for name in after.topics} >= set(VIEW_TYPES)
        assert after.topics["/view/opening"].count == before.topics["/crack_opening"].count
        seen = Watched()
        for topic, log_time_ns, message in after.messages(["/view/regions", "/view/scene"]):
            seen.came.setdefault(topic, []).append((log_time_ns, message, b""))
    assert len(seen.came["/view/scene"]) >= 5
    check_zones(seen)
    again = rgbd_dic("annotate", annotated, "--out", tmp_path / "again")
    assert again.returncode == 1 and "already" in again.stderr
    raw = rgbd_dic("annotate", SAMPLE, "--out", tmp_path / "raw")
    assert raw.returncode == 1 and "has no topic" in raw.stderr


@pytest.fixture
def published_and_served():
    """A publisher of an image topic in a domain of its own, and the websocket beside it: (publish, matched, port)."""
    domain, port = 30 + os.getpid() % 40, free_port()
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node("source", context=context)
    publisher = node.create_publisher(CompressedImage, "picture", 10)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    path = Path(get_package_prefix("rgbd_dic_processing"), "lib/rgbd_dic_processing/foxglove_node")
    given = ["--ros-args", "-p", f"foxglove.port:={port}", "-p", "foxglove.large_rate_hz:=20.0", "-p"]
    process = subprocess.Popen(
        [str(path), *given, "foxglove.backlog:=8"], env={**environment(), "ROS_DOMAIN_ID": str(domain)}
    )
    yield publisher, executor, port, process
    process.terminate()
    process.wait(20)
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown(context=context)


@needs_foxglove
@pytest.mark.timeout(200)
def test_a_topic_is_heard_only_while_it_is_shown_and_a_slow_viewer_misses_messages(published_and_served) -> None:
    """300 messages of 300 KB in 6 s or more, offered 20 times a second to a viewer that reads nothing meanwhile.

    Of the 36 MB and more that it slept through, it gets what the connection holds (10 MB of buffers at most) and the
    backlog of 8 messages, the newest among them.
    """
    publisher, executor, port, process = published_and_served
    awake, seen = threading.Event(), []

    def until_subscriptions(count: int) -> None:
        deadline = time.monotonic() + 60
        while publisher.get_subscription_count() != count and time.monotonic() < deadline:
            executor.spin_once(timeout_sec=0.05)
        assert publisher.get_subscription_count() == count

    def newest_seen(watched: Watched) -> bool:
        return bool(watched.came) and watched.came["/picture"][-1][1].header.stamp.sec > 290

    while socket.socket().connect_ex(("127.0.0.1", port)):
        assert process.poll() is None
        time.sleep(0.2)
    time.sleep(2.0)
    assert publisher.get_subscription_count() == 0
    viewer = threading.Thread(target=lambda: seen.append(watch(port, {"/picture"}, newest_seen, 90, awake)))
    viewer.start()
    until_subscriptions(1)
    message = CompressedImage(format="number", data=bytes(300_000))
    for number in range(300):
        message.header.stamp.sec = number
        publisher.publish(message)
        time.sleep(0.02)
    awake.set()
    viewer.join()
    until_subscriptions(0)
    assert process.poll() is None
    numbers = [message.header.stamp.sec for _, message, _ in seen[0].came["/picture"]]
    assert numbers == sorted(numbers)
    assert numbers[-1] > 290
    assert 8 <= len(numbers) < 80


LOOKER = """
import rclpy
from sensor_msgs.msg import Image
rclpy.init()
node = rclpy.create_node("looker")
node.create_subscription(Image, "view/image_rect", lambda message: print(message.header.stamp.sec, flush=True), 5)
rclpy.spin(node)
"""


@pytest.mark.slow
@pytest.mark.timeout(250)
def test_a_viewer_that_vanished_is_not_worked_for_and_may_come_back(tmp_path: Path) -> None:
    """A stopped process is what a lost connection looks like: nothing is said, nothing is confirmed.

    It would be matched until its lease of 20 s is over; long before, nothing is heard for it any more.
    """
    domain = 90
    command = ["rgbd-dic", "up", SAMPLE, "--rate", "0.15", "--domain", domain, "--out", tmp_path / "run"]
    graph = subprocess.Popen(list(map(str, command)), env=environment(), stdout=subprocess.DEVNULL)
    here = {**environment(), "ROS_DOMAIN_ID": str(domain)}
    path = Path(get_package_prefix("rgbd_dic_processing"), "lib/rgbd_dic_processing/viewer_node")
    calibration = f"calibration_file:={SAMPLE / 'calibration.yaml'}"
    viewer = subprocess.Popen([str(path), "--ros-args", "-p", calibration], env=here)
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node("onlooker", context=context)

    def until_heard_by(count: int, timeout_s: float) -> bool:
        deadline = time.monotonic() + timeout_s
        while node.count_subscribers(PREVIEWED_FIELD) != count and time.monotonic() < deadline:
            time.sleep(0.1)
        return node.count_subscribers(PREVIEWED_FIELD) == count

    looker = subprocess.Popen([sys.executable, "-c", LOOKER], env=here, stdout=subprocess.PIPE)
    try:
        assert looker.stdout.readline()  # it sees pictures
        assert until_heard_by(1, 20)
        looker.send_signal(signal.SIGSTOP)
        assert until_heard_by(0, 15)
        looker.send_signal(signal.SIGCONT)
        assert until_heard_by(1, 40)
    finally:
        looker.kill()
        viewer.terminate()
        viewer.wait(20)
        graph.send_signal(signal.SIGINT)
        graph.wait(60)
        node.destroy_node()
        rclpy.shutdown(context=context)
