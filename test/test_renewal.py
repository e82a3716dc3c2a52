"""New keyframes and new references in the graph: the same numbers as offline, and the services of dic_node."""

from __future__ import annotations

import csv
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
import yaml
from rclpy.executors import SingleThreadedExecutor
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.messages import image_from_message, image_message, stamp_to_ns
from rgbd_dic_acquisition.nodes.ros_messages import latched_qos, make
from rgbd_dic_processing.core.status import FrameStatus
from rgbd_dic_processing.nodes.dic_node import DicNode
from rgbd_dic_processing.nodes.inputs import OfReference
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger
from system import rgbd_dic

from rgbd_dic_msgs.msg import Reference, SubsetField

SETTINGS = {"correlation": {"step": 20}, "renewal": {"after_frames": 4, "max_stretch": 1.01, "zncc_drop": 0.002}}


@pytest.mark.timeout(120)
def test_a_renewing_graph_gives_the_same_numbers_as_offline(flight: Path, tmp_path: Path) -> None:
    settings = tmp_path / "settings.yaml"
    settings.write_text(yaml.safe_dump(SETTINGS))
    for command, options in (("process", ()), ("up", ("--as-fast-as-possible", "--domain", "83"))):
        done = rgbd_dic(command, flight, "--settings", settings, "--out", tmp_path / command, *options)
        assert done.returncode == 0, done.stderr
    online, offline = (rows(tmp_path / command / "crack_opening.csv") for command in ("up", "process"))
    assert len(offline) == 30 and online == offline
    facts = [yaml.safe_load((tmp_path / name / "run.yaml").read_text())["facts"] for name in ("up", "process")]
    assert facts[0]["renewed keyframes"] == facts[1]["renewed keyframes"] > 0
    with BagReader(tmp_path / "up" / "bag") as bag:
        seen = [message for _, _, message in bag.messages(["/subset_field"])]
    keyframes = [(m.keyframe_stamp.sec, m.keyframe_stamp.nanosec) for m in seen]
    assert keyframes == sorted(keyframes) and len(set(keyframes)) == 1 + facts[0]["renewed keyframes"]
    assert len({(m.reference_stamp.sec, m.reference_stamp.nanosec) for m in seen}) == 1


def test_fields_wait_for_the_reference_that_they_count_from() -> None:
    handed: list[tuple[int, str | None]] = []
    of_reference = OfReference(lambda field, known: handed.append((field.reference_stamp_ns, known)))
    for stamp_ns in (0, 10):
        of_reference.add(SimpleNamespace(reference_stamp_ns=stamp_ns))
    assert handed == [(0, None), (10, None)]  # nobody publishes references
    of_reference.know(10, "first")
    for stamp_ns in (10, 20, 10):
        of_reference.add(SimpleNamespace(reference_stamp_ns=stamp_ns))
    assert handed[2:] == [(10, "first")]  # in their order
    of_reference.know(20, "second")
    assert handed[3:] == [(20, "second"), (10, "first")]
    of_reference.add(SimpleNamespace(reference_stamp_ns=15))
    assert handed[5:] == [(15, None)]  # it was missed, and never comes


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return [{name: value for name, value in row.items() if name != "latency_s"} for row in csv.DictReader(file)]


def test_services_of_the_dic_node(flight: Path) -> None:
    """A new keyframe, a new reference, and the refusal of one while the panel is out of sight."""
    files = [f"{name}_file:={flight / name}.yaml" for name in ("regions", "calibration")]
    rclpy.init(args=["--ros-args", *(word for file in files for word in ("-p", file))], domain_id=84)
    dic, user = DicNode(), rclpy.create_node("user")
    executor = SingleThreadedExecutor()
    for node in (dic, user):
        executor.add_node(node)
    fields, references = [], []
    user.create_subscription(SubsetField, "subset_field", fields.append, 10)
    user.create_subscription(Reference, "reference", references.append, latched_qos())
    images = user.create_publisher(Image, "camera/image_raw", 10)

    def spin_until(condition: Callable[[], bool]) -> None:
        end = time.monotonic() + 20
        while not condition():
            assert time.monotonic() < end
            executor.spin_once(timeout_sec=0.1)

    def show(recorded: Any, light: int = 1) -> SubsetField:
        count, stamp_ns = len(fields), stamp_to_ns(recorded.header.stamp)
        pixels = light * image_from_message(recorded)
        images.publish(image_message(make, stamp_ns, "camera_optical_frame", pixels, "mono8"))
        spin_until(lambda: len(fields) > count)
        return fields[-1]

    def ask(service: str) -> Trigger.Response:
        client = user.create_client(Trigger, f"dic_node/{service}")
        spin_until(client.service_is_ready)
        answer = client.call_async(Trigger.Request())
        spin_until(answer.done)
        return answer.result()

    try:
        spin_until(lambda: images.get_subscription_count() > 0 and dic.count_subscribers("subset_field") > 0)
        with BagReader(flight) as bag:
            recorded = [message for _, _, message in bag.messages(["/camera/image_raw"])][:7]
        first, _, third = (show(message) for message in recorded[:3])
        assert third.reference_stamp == third.keyframe_stamp == first.header.stamp
        assert ask("renew_keyframe").success
        fourth, fifth = (show(message) for message in recorded[3:5])
        assert fourth.keyframe_stamp == first.header.stamp
        assert fifth.keyframe_stamp == fourth.header.stamp and fifth.reference_stamp == first.header.stamp
        assert ask("set_reference").success
        sixth = show(recorded[5])
        assert sixth.reference_stamp == sixth.keyframe_stamp == sixth.header.stamp
        spin_until(lambda: len(references) == 2)
        assert [r.header.stamp for r in references] == [first.header.stamp, sixth.header.stamp]
        assert references[0].drawn_x == references[1].drawn_x == references[0].x != references[1].x
        assert show(recorded[6], light=0).status.value == FrameStatus.LOST
        refused = ask("set_reference")
        assert not refused.success and "not found in the image at present" in refused.message
    finally:
        for node in (dic, user):
            node.destroy_node()
        rclpy.shutdown()
