"""How every node of rgbd_dic is started, spun and ended."""

from __future__ import annotations

import ctypes
import gc
import inspect
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import rclpy
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rclpy.duration import Duration
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from threadpoolctl import threadpool_limits

from ..errors import RgbdDicError

# The longest wait of one turn [s]: how late SIGINT and SIGTERM may be noticed.
TURN_S = 0.2
# The longest that a node waits at its end until what it published has arrived [s].
ARRIVE_S = 2.0


def run(node_factory: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Make a node, spin it until SIGINT, SIGTERM or the end of its own work, close it; return the exit code.

    A node may have two methods beside its callbacks:

    - `work()`: an iterator that does a part of the node's own work each time it is advanced and yields how
      long it is then content to wait for callbacks [s]. When it ends, the node ends, with exit code 0.
    - `close()`: called at the end, whatever ended it, while publishers and subscriptions still work. What was
      published by then is given two seconds to arrive.

    An RgbdDicError from any of these becomes one line on stderr and exit code 1; anything else is a bug and
    keeps its traceback.
    """
    return run_together(lambda: [node_factory()], args)


def run_together(make_nodes: Callable[[], list[Node]], args: Sequence[str] | None = None) -> int:
    """As `run`, of several nodes in this process and thread; when the work of one ends, all end."""
    prepare_process()
    program = Path(sys.argv[0]).stem
    signals: list[int] = []  # no Event: its lock may be held by what a signal interrupts, such as another signal
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: signals.append(number))
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # the errors of malformed arguments and parameter files have no common base
        print(f"{program}: {error}", file=sys.stderr)
        return 1
    try:
        nodes = make_nodes()
        executor = EventsExecutor()
        for node in nodes:
            executor.add_node(node)
        _settle()
        try:
            _spin(nodes, executor, signals)
        finally:
            for node in nodes:
                _close(node, executor)
            executor.shutdown()
    except RgbdDicError as error:
        print(f"{program}: {error}", file=sys.stderr)
        return 1
    finally:
        rclpy.try_shutdown()
    return 0


def _spin(nodes: list[Node], executor: Any, signals: list[int]) -> None:
    # EventsExecutor.spin() without a timeout would never notice the signals.
    works: list[Iterator[float]] = [node.work() for node in nodes if hasattr(node, "work")]
    try:
        while True:
            waits_s = [next(work, None) for work in works]
            if None in waits_s or signals or not rclpy.ok():
                return
            spin(executor, max(min([*waits_s, TURN_S]), 0.0))
    except (ExternalShutdownException, InvalidHandle):
        if rclpy.ok():
            raise


def spin(executor: Any, timeout_s: float) -> None:
    """Wait for something to come, and handle all that has come by then.

    EventsExecutor.spin_once handles one event. A node whose work takes longer than the next events need to come would
    fall behind with those, more and more, until their queues in the middleware overflow.
    """
    executor.spin_once(timeout_sec=timeout_s)
    done: list[bool] = []
    executor.create_task(done.append, True)  # comes after what has come
    while not done and rclpy.ok():
        executor.spin_once(timeout_sec=0.0)


def _close(node: Node, executor: Any) -> None:
    try:
        if hasattr(node, "close"):
            node.close()
        _let_arrive(node)
    finally:
        executor.remove_node(node)
        node.destroy_node()


def _let_arrive(node: Node) -> None:
    """Wait until all reliable subscriptions have what the node published: what is still on its way ends with it."""
    deadline = time.monotonic() + ARRIVE_S
    for publisher in node.publishers if rclpy.ok() else ():
        publisher.wait_for_all_acked(Duration(seconds=max(0.0, deadline - time.monotonic())))


def _settle() -> None:
    """Do now what would hold up a node once at work, for longer than images take to follow each other."""
    # rclpy asks `inspect` who logs, which the first time looks through all modules: a node that warned of an image that
    # it left out, as the first thing that it logged, left out more for that.
    inspect.getmodule(inspect.currentframe())
    # What was made so far stays: the garbage collector need not look through it again.
    gc.collect()
    gc.freeze()


def prepare_process() -> None:
    """Defaults that the user's environment overrides, an allocator that keeps the memory of images, and no threads for
    linear algebra."""
    threadpool_limits(1, user_api="blas")  # a node's matrices are small: threads would but wait for each other, busily
    reach = os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    alone = reach == "LOCALHOST" and not os.environ.get("ROS_STATIC_PEERS")
    name = "fastdds_loopback.xml" if alone else "fastdds.xml"
    try:
        profile = Path(get_package_share_directory("rgbd_dic_acquisition"), "config", name)
    except (PackageNotFoundError, LookupError):
        profile = None
    if profile is not None and profile.is_file():
        os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(profile))
    # Otherwise glibc returns the memory of each image to the kernel and spends most of the time on that.
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mmap_threshold, trim_threshold = -3, -1
        mallopt(mmap_threshold, 16 << 20)
        mallopt(trim_threshold, 256 << 20)
