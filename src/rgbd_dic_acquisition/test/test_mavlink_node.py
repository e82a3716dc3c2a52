"""mavlink_node in a graph, with a real autopilot (MAVSDK) that is killed, restarted, frozen and shouted down."""

from __future__ import annotations

import random
import signal
import socket
import time

import numpy as np
import pytest
import rclpy
from autopilot_peers import Peers, free_port
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rgbd_dic_acquisition.drivers.autopilot_readings import Attitude
from rgbd_dic_acquisition.messages import stamp_to_ns
from sensor_msgs.msg import Imu
from test_mavlink_peers import DELAY_S, TOLERANCE_S, errors_s
from test_nodes import Processes

ATTITUDE_HZ = 50.0


class Listener:
    """Takes attitude and the node's own status, each with the time at which it came [s, monotonic]."""

    def __init__(self, domain: int) -> None:
        self.attitudes: list[tuple[float, Attitude]] = []
        self.statuses: list[tuple[float, DiagnosticStatus]] = []
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node("listener", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._node.create_subscription(Imu, "imu/data", self._take_attitude, 100)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._take_status, 100)
        self._executor.add_node(self._node)

    def spin(self, seconds: float = 60.0, until=lambda: False) -> float:
        """For so long, or until something is so; the time when it ended."""
        end = time.monotonic() + seconds
        while not until() and time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.02)
        return time.monotonic()

    def says(self, text: str, since: float = 0.0):
        """Whether the latest status, younger than that, has these words."""
        return lambda: bool(self.statuses) and self.statuses[-1][0] > since and text in self.statuses[-1][1].message

    def value(self, name: str) -> str:
        return next(pair.value for pair in self.statuses[-1][1].values if pair.key == name)

    def close(self) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)

    def _take_attitude(self, message: Imu) -> None:
        q, rate = message.orientation, message.angular_velocity
        attitude = Attitude(stamp_to_ns(message.header.stamp), 0.0, (q.x, q.y, q.z, q.w), (rate.x, rate.y, rate.z))
        assert message.header.frame_id == "base_link"
        self.attitudes.append((time.monotonic(), attitude))

    def _take_status(self, message: DiagnosticArray) -> None:
        self.statuses += [(time.monotonic(), status) for status in message.status if status.name == "/mavlink_node"]


@pytest.fixture
def graph(tmp_path):
    """(peers, listener, port) of a mavlink_node that runs."""
    processes, peers, port = Processes(tmp_path), Peers(tmp_path), free_port()
    listener = Listener(int(processes._environment["ROS_DOMAIN_ID"]))
    processes.node("mavlink_node", link__url=f"udpin://127.0.0.1:{port}", link__timesync_rate_hz=50.0)
    listener.spin(until=listener.says("nothing heard yet"))
    yield peers, listener, port
    listener.close()
    processes.end()
    peers.end()


def test_killed_restarted_frozen_and_shouted_down(graph):
    peers, listener, port = graph
    url = f"udpout://127.0.0.1:{port}"
    peer = peers.mavsdk(url, delay_s=DELAY_S, boot_s=300.0)
    listener.spin(until=listener.says("OK"))
    listener.spin(4)
    assert listener.value("stamps by") == "TIMESYNC"
    assert float(listener.value("uncertainty of the stamps [ms]")) < 5

    peer.kill()
    killed = time.monotonic()
    _tell("silence found after [s]", listener.spin(until=listener.says("no attitude for")) - killed)
    listener.spin(until=listener.says("nothing heard for"))
    attitudes = len(listener.attitudes)
    begun = time.monotonic()
    peer = peers.mavsdk(url, delay_s=DELAY_S, boot_s=5.0)
    found = listener.spin(until=lambda: len(listener.attitudes) > attitudes)
    _tell("attitude again after [s], start of the autopilot included", found - begun)
    listener.spin(until=listener.says("OK", since=found))
    listener.spin(4)
    assert listener.value("restarts of the autopilot") == "1"
    assert listener.value("stamps by") == "TIMESYNC"

    peer.signal(signal.SIGSTOP)
    frozen = time.monotonic()
    _tell("freeze found after [s]", listener.spin(until=listener.says("no attitude for")) - frozen)
    peer.signal(signal.SIGCONT)
    thawed = time.monotonic()
    _tell("well again after [s]", listener.spin(until=listener.says("OK", since=thawed)) - thawed)

    rng = random.Random(1)
    attitudes, begun = len(listener.attitudes), time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as source:
        while time.monotonic() < begun + 3:
            source.sendto(bytes([0xFD]) + rng.randbytes(rng.randrange(300)), ("127.0.0.1", port))
            listener.spin(0.001)
    # That none is lost is for test_mavlink.py: here a busy computer slows the autopilot itself.
    assert (len(listener.attitudes) - attitudes) / 3 > 0.5 * ATTITUDE_HZ, "attitude goes on"
    listener.spin(1.5)
    assert int(listener.value("garbage")) > 100
    assert listener.statuses[-1][1].message == "OK"

    stamps = [attitude.stamp_ns for _, attitude in listener.attitudes]
    assert np.all(np.diff(stamps) > 0), "in order, over the restart too"
    errors = errors_s([attitude for _, attitude in listener.attitudes])
    # No stamp is ever wrong: while TIMESYNC is not known they are late by the delay, and a new clock's first jitter,
    # which a busy computer makes long.
    assert np.all((errors > -0.05) & (errors < DELAY_S + 0.5))
    assert np.median(np.abs(errors)) < TOLERANCE_S
    _tell("attitudes", len(errors))
    _tell("median error of the stamps [ms]", 1e3 * np.median(np.abs(errors)))


def _tell(what: str, number: float) -> None:
    """For who runs it with -rP."""
    print(f"{what}: {number:.3f}")
