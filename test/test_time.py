"""Planes carried in time, and ToF stamps that are known to be late: the graph gives the same numbers as offline."""

from __future__ import annotations

import csv
import time
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rgbd_dic_acquisition.message_types import make_message
from rgbd_dic_acquisition.messages import stamp_message, stamp_to_ns
from rgbd_dic_processing.cli import main
from rgbd_dic_processing.core.displacement import DisplacementMeasurement
from rgbd_dic_processing.core.sensor_delay import TOLD_AS, SensorDelay
from rgbd_dic_processing.nodes import compensation_node
from system import rgbd_dic

SETTINGS = {
    "correlation": {"step": 20},
    "compensation": {"plane_in_time": "carried", "plane_window_s": 0.2, "method": "h_3d"},
}
DELAY_NS = 40_000_000
LATE = SensorDelay(0.0402, 0.0003, 90)


def late(topic: str, _: int, message: Any) -> Any:
    """The ToF frames arrive when they do, but say that they were exposed later."""
    if topic.startswith("/tof/"):
        message.header.stamp = stamp_message(make_message, stamp_to_ns(message.header.stamp) + DELAY_NS)
    return message


@pytest.mark.timeout(120)
def test_carried_planes_and_a_known_delay(flight: Path, edited: Any, tmp_path: Path) -> None:
    """With the delay taken off, a flight with late stamps gives the rows of the flight itself, offline and online."""

    def run(name: str, command: str, bag: Path, delay_s: float, *options: str) -> list[dict[str, str]]:
        settings, out = tmp_path / f"{name}.yaml", tmp_path / name
        settings.write_text(yaml.safe_dump({**SETTINGS, "pairing": {"tof_delay_s": delay_s}}))
        done = rgbd_dic(command, bag, "--settings", settings, "--out", out, *options)
        assert done.returncode == 0, done.stderr
        with (out / "crack_opening.csv").open(newline="") as file:
            return [{name: value for name, value in row.items() if name != "latency_s"} for row in csv.DictReader(file)]

    right = run("right", "process", flight, 0.0)
    bag, delay_s = edited(late), DELAY_NS * 1e-9
    assert len(right) == 30 and all(row["valid"] == "1" for row in right)
    assert run("offline", "process", bag, delay_s) == right
    assert run("online", "up", bag, delay_s, "--as-fast-as-possible", "--domain", "83") == right
    facts = yaml.safe_load((tmp_path / "offline" / "run.yaml").read_text())["facts"]
    assert facts[TOLD_AS] == "unknown: 10 ToF planes, at least 20 needed"


def test_process_warns_of_a_delay(
    flight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(DisplacementMeasurement, "sensor_delay", lambda _: LATE)
    settings = tmp_path / "settings.yaml"
    settings.write_text(yaml.safe_dump(SETTINGS))
    assert main(["process", str(flight), "--settings", str(settings), "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr()
    assert f"warning: {LATE.warning}" in printed.err
    assert f"{TOLD_AS}: 40.2, standard uncertainty 0.3" in printed.out


def test_the_node_warns_of_a_delay(flight: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """When a stream has ended, and on diagnostics from then on."""
    monkeypatch.setattr(DisplacementMeasurement, "sensor_delay", lambda _: LATE)
    files = [f"{name}_file:={flight / name}.yaml" for name in ("regions", "calibration")]
    rclpy.init(args=["--ros-args", *(word for file in files for word in ("-p", file))], domain_id=83)
    node, user = compensation_node.CompensationNode(), rclpy.create_node("user")
    executor = SingleThreadedExecutor()
    for each in (node, user):
        executor.add_node(each)
    heard: list[DiagnosticStatus] = []
    user.create_subscription(DiagnosticArray, "/diagnostics", lambda message: heard.append(message.status[0]), 10)
    try:
        node._flush()
        end = time.monotonic() + 20
        while not any(status.message == LATE.warning for status in heard):
            assert time.monotonic() < end
            executor.spin_once(timeout_sec=0.1)
        assert heard[-1].level == DiagnosticStatus.WARN
        assert [(value.key, value.value) for value in heard[-1].values] == [(TOLD_AS, str(LATE))]
    finally:
        for each in (node, user):
            each.destroy_node()
        rclpy.shutdown()
