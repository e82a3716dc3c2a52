"""What nodes publish last is recorded, whoever is told first to end."""

from __future__ import annotations

import signal
import stat
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_processing.graph import NodeSpec, recorder
from rgbd_dic_processing.processes import GraphProcesses
from test_faults import wait_for

from rgbd_dic_processing import processes

LAST = 30  # messages that the node publishes when it is told to end, a while after that
LAST_NODE = f"""#!{sys.executable}
import time

from rclpy.node import Node
from rgbd_dic_acquisition.nodes.spinning import run
from sensor_msgs.msg import Image

class LastNode(Node):
    def __init__(self):
        super().__init__("last_node")
        self._publisher = self.create_publisher(Image, "camera/image_raw", 100)

    def work(self):
        while not self._publisher.get_subscription_count():
            yield 0.05
        print("heard", flush=True)
        while True:
            yield 0.05

    def close(self):
        time.sleep(1.0)
        for number in range({LAST}):
            image = Image(data=bytes(300_000))
            image.header.stamp.nanosec = number
            self._publisher.publish(image)
        print("published", flush=True)

raise SystemExit(run(LastNode))
"""

pytestmark = pytest.mark.timeout(120)


@pytest.fixture
def graph(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[GraphProcesses]:
    """A recorder, that is told how long to linger, and a node that publishes when it ends."""
    monkeypatch.setenv("ROS_DOMAIN_ID", "86")
    script, found = tmp_path / "last_node", processes._executable
    script.write_text(LAST_NODE)
    script.chmod(script.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setattr(processes, "_executable", lambda *of: script if of[1] == "last_node" else found(*of))
    with GraphProcesses(tmp_path / "logs", use_sim_time=False) as running:
        recording = recorder(tmp_path / "bag", ("camera/image_raw",))
        running.start(replace(recording, parameters={**recording.parameters, "linger_s": request.param}))
        running.start(NodeSpec("here", "last_node", (), ("camera/image_raw",)))
        wait_for(lambda: "heard" in running.log_of("last_node").read_text(), "the recorder to be found")
        time.sleep(1.0)  # and the other way round
        yield running


def recorded(path: Path) -> list[int]:
    with BagReader(path) as bag:
        return [message.header.stamp.nanosec for *_, message in bag.messages()]


@pytest.mark.parametrize("graph", [0.0], indirect=True)
def test_the_recorder_is_ended_last(graph: GraphProcesses, tmp_path: Path) -> None:
    graph.end()
    assert recorded(tmp_path / "bag") == list(range(LAST))


@pytest.mark.parametrize("graph", [0.0], indirect=True)
def test_what_is_on_its_way_is_waited_for(graph: GraphProcesses, tmp_path: Path) -> None:
    """The recorder does not get to run until the node has published and would be gone."""
    halted = graph._running["recorder_node"]
    halted.send_signal(signal.SIGSTOP)

    def go_on() -> None:
        wait_for(lambda: "published" in graph.log_of("last_node").read_text(), "the last messages")
        halted.send_signal(signal.SIGCONT)

    going_on = threading.Thread(target=go_on)
    going_on.start()
    graph.end()
    going_on.join()
    assert recorded(tmp_path / "bag") == list(range(LAST))


@pytest.mark.parametrize("graph", [30.0], indirect=True)
def test_all_told_at_once(graph: GraphProcesses, tmp_path: Path) -> None:
    """As by Ctrl-C in a terminal, or by ROS' launch."""
    running = list(graph._running.values())
    for process in running:
        process.send_signal(signal.SIGINT)
    assert [process.wait(30) for process in running] == [0, 0]
    assert recorded(tmp_path / "bag") == list(range(LAST))
