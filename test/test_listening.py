"""Nothing listens where another computer reaches it, unless it is told to."""

from __future__ import annotations

import re
import signal
from pathlib import Path

import numpy as np
import pytest
from autopilot_peers import free_port
from gige_peers import ADDRESS, calibrated, needs_aravis, our_camera
from open_sockets import heard_beyond_loopback, open_sockets
from rgbd_dic_acquisition.calibration import Calibration, save_calibration
from system import ROOT
from test_faults import playing, processes_of, start, wait_for
from test_nodes import Processes, _wait_for

pytestmark = pytest.mark.timeout(120)


def test_a_replay_with_its_page(tmp_path: Path) -> None:
    graph = start(tmp_path / "run", 80, "--rate", "0.2", "--page", str(free_port()))
    try:
        wait_for(lambda: playing(tmp_path / "run"), "the player")
        running = {**processes_of(tmp_path / "run"), "rgbd-dic": graph.pid}
        assert len(running) == 9
        assert all(open_sockets(process) for process in running.values()), "each takes part in the graph"
        assert heard_beyond_loopback(running) == {}
    finally:
        graph.send_signal(signal.SIGTERM)
        graph.communicate(timeout=40)


@needs_aravis
def test_the_sensors_and_the_recorder(tmp_path: Path) -> None:
    """With a GigE Vision camera, whose stream comes in over a socket of its own, and MAVLink as it is by default."""
    save_calibration(Calibration(calibrated(64, 48)), tmp_path / "calibration.yaml")
    camera = {"aravis__transport": "gige", "aravis__address": ADDRESS, "aravis__packet_bytes": 1500}
    processes = Processes(tmp_path)
    try:
        with our_camera(np.zeros((2, 48, 64), np.uint8), tmp_path):
            running = {
                "camera": processes.node(
                    "camera_node", source="aravis", calibration=str(tmp_path / "calibration.yaml"), **camera
                ),
                "tof": processes.node("tof_node"),
                "mavlink": processes.node("mavlink_node"),
                "recorder": processes.node("recorder_node", output=str(tmp_path / "bag")),
            }
            _wait_for(running["camera"], "camera runs")
            _wait_for(running["recorder"], "recording into")
            numbers = {name: process.pid for name, process in running.items()}
            ports = {name: [each.port for each in open_sockets(number)] for name, number in numbers.items()}
            assert 14550 in ports["mavlink"] and len(ports["camera"]) > len(ports["recorder"])
            assert heard_beyond_loopback(numbers) == {}
    finally:
        processes.end()


def test_told_to_reach_other_computers_a_node_listens_for_them(tmp_path: Path) -> None:
    """Otherwise the test above would find nothing wrong where nothing can be."""
    processes = Processes(tmp_path)
    processes._environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET"
    processes._environment.pop("FASTRTPS_DEFAULT_PROFILES_FILE", None)
    try:
        node = processes.node("recorder_node", output=str(tmp_path / "bag"))
        _wait_for(node, "recording into")
        assert heard_beyond_loopback({"recorder": node.pid})
    finally:
        processes.end()


def test_the_profiles_differ_in_that_alone() -> None:
    folder = ROOT / "src/rgbd_dic_acquisition/config"
    both, alone = (without_comments((folder / name).read_text()) for name in ("fastdds.xml", "fastdds_loopback.xml"))
    assert alone.replace("<interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>", "") == both


def without_comments(text: str) -> str:
    return "".join(re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL).split())
