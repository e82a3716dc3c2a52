"""A node that lags behind, with the real middleware and executor: it takes what has come, and works on the newest."""

from __future__ import annotations

import os
import time

import pytest
import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rgbd_dic_acquisition.nodes.diagnostics import Diagnostics
from rgbd_dic_acquisition.nodes.spinning import spin
from rgbd_dic_processing.nodes.keeping_up import SKIPPED, KeepUp
from std_msgs.msg import Int32

DELIVERED_S = 0.5  # after which messages inside one process have come, however busy the computer is


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(os.environ, "ROS_DOMAIN_ID", "92")
    monkeypatch.setitem(os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = rclpy.Context()
    rclpy.init(args=["--ros-args", "-p", "keep_up.max_waiting:=3"], context=context)
    made = Node("slow_node", context=context)
    yield made
    made.destroy_node()
    rclpy.shutdown(context=context)


def test_the_newest_are_worked_off_and_the_rest_is_counted(node: Node) -> None:
    """60 messages have come before the first turn, and 10 more come during it: the last one of each is worked off."""
    diagnostics, worked = Diagnostics(node), []
    output = node.create_publisher(Int32, "numbers", 100)
    keep_up = KeepUp(node, diagnostics)

    def send(numbers: range) -> None:
        for number in numbers:
            output.publish(Int32(data=number))
        time.sleep(DELIVERED_S)

    def slow(message: Int32) -> None:
        worked.append(message.data)
        if len(worked) == 1:
            send(range(60, 70))

    keep_up.subscribe(Int32, "numbers", slow, 100)
    executor = EventsExecutor(context=node.context)
    executor.add_node(node)
    while not output.get_subscription_count():
        time.sleep(0.05)
    send(range(60))
    work, end = keep_up.work(), time.monotonic() + 60
    while (not worked or worked[-1] < 69) and time.monotonic() < end:
        spin(executor, next(work))
    executor.remove_node(node)
    executor.shutdown()
    assert worked == [59, 69]
    assert diagnostics._counters[SKIPPED] == 70 - len(worked)
    assert SKIPPED in keep_up.warning


def test_nothing_else_falls_behind(node: Node) -> None:
    """A hundred times as many other messages come as the node works off: whenever it begins with one, it knows all
    others that came before. With a bounded number of events between two of them, those would wait longer each time."""
    known, known_by = [], []
    kinds = ("numbers", "others")
    outputs = [node.create_publisher(Int32, topic, 1000) for topic in kinds]
    keep_up = KeepUp(node, Diagnostics(node))
    keep_up.subscribe(Int32, "numbers", lambda message: known_by.append((message.data, len(known))), 100)
    node.create_subscription(Int32, "others", known.append, 1000)
    executor = EventsExecutor(context=node.context)
    executor.add_node(node)
    while not all(output.get_subscription_count() for output in outputs):
        time.sleep(0.05)
    spin(executor, 0.1)  # it then hears of what comes
    work, end = keep_up.work(), time.monotonic() + 60
    for number in range(5):
        for other in range(100):
            outputs[1].publish(Int32(data=other))
        outputs[0].publish(Int32(data=number))
        time.sleep(DELIVERED_S)
        while len(known_by) <= number and time.monotonic() < end:
            spin(executor, next(work))
    executor.remove_node(node)
    executor.shutdown()
    assert known_by == [(number, 100 * (number + 1)) for number in range(5)]
