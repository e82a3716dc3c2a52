"""Measures tof_node: frames, losses, CPU and memory at full size, and how soon it notices and mends faults.

    tools/run python tools/payload/measure_tof.py

The cameras are those of the tests: viky.cti of the genicam wheel, and a producer with the features of a Blaze.
It prints the tables of docs/payload.md.
"""

from __future__ import annotations

import argparse
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import genicam
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rgbd_dic_acquisition.calibration import Calibration, Camera, save_calibration
from sensor_msgs.msg import Image

ROOT = Path(__file__).parents[2]
sys.path += [str(ROOT / "tools"), str(ROOT / "src/rgbd_dic_acquisition/test")]
from fake_blaze import FakeBlaze, producer  # noqa: E402 - what is imported here is found by the line above
from process_cost import processor_s  # noqa: E402

VIKY = Path(genicam.__file__).with_name("viky.cti")
DOMAIN = os.environ.get("ROS_DOMAIN_ID", "74")


class Run:
    """tof_node with some parameters, and what it publishes."""

    def __init__(self, folder: Path, environment: dict[str, str], **parameters: object) -> None:
        given = [word for name, value in parameters.items() for word in ("-p", f"{name.replace('__', '.')}:={value}")]
        command = [sys.executable, "-m", "rgbd_dic_acquisition.nodes.tof_node", "--ros-args", *given]
        quiet = {"ROS_DOMAIN_ID": DOMAIN, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_LOG_DIR": str(folder)}
        self._log = (folder / "log.txt").open("w")
        self.process = subprocess.Popen(
            command, env={**os.environ, **environment, **quiet}, stdout=self._log, stderr=subprocess.STDOUT
        )
        self.stamps: list[int] = []
        self.warning, self.counters = "", {}
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=int(DOMAIN))
        self._node = rclpy.create_node("measure", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._node.create_subscription(Image, "tof/depth/image_raw", self._take_frame, 100)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._take_status, 100)

    def _take_frame(self, message: Image) -> None:
        self.stamps.append(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)

    def _take_status(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "/tof_node":
                self.warning = status.message if status.level == DiagnosticStatus.WARN else ""
                self.counters = {pair.key: pair.value for pair in status.values}

    def until(self, condition: Callable[[], bool], seconds: float = 30.0) -> float:
        """Wait for it; how long it took [s]."""
        start = time.monotonic()
        while not condition():
            if time.monotonic() - start > seconds:
                raise SystemExit(f"waited in vain: {self.warning or 'no warning'}; see {self._log.name}")
            self._executor.spin_once(timeout_sec=0.02)
        return time.monotonic() - start

    def memory_mb(self) -> float:
        lines = Path(f"/proc/{self.process.pid}/status").read_text().splitlines()
        return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmRSS"))

    def close(self) -> None:
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(20)
        self._log.close()
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)


def throughput(name: str, run: Run, seconds: float) -> str:
    """One row: what arrived in some seconds, and what it cost."""
    run.until(lambda: len(run.stamps) > 10)
    settled = time.monotonic() + 3
    run.until(lambda: time.monotonic() > settled)
    first, cpu_s, begun = len(run.stamps), processor_s(run.process.pid), time.monotonic()
    run.until(lambda: time.monotonic() - begun > seconds, 2 * seconds)
    took_s = time.monotonic() - begun
    frames, share = len(run.stamps) - first, (processor_s(run.process.pid) - cpu_s) / took_s
    counters = run.counters
    row = (
        f"| {name} | {frames / took_s:.2f} | {counters['lost']} | {counters['failed']} | {100 * share:.1f} | "
        f"{run.memory_mb():.0f} | {counters['clock']} |"
    )
    run.close()
    return row


def faults(run: Run, blaze: FakeBlaze, repeats: int) -> list[str]:
    """For each fault, when it was told and when frames came again, after the camera was well again [s]."""
    told: dict[str, list[float]] = {}
    back: dict[str, list[float]] = {}
    run.until(lambda: len(run.stamps) > 10)
    for _ in range(repeats):
        for name, register, ill, well in (
            ("one buffer fails", "fail", 1, None),
            ("it sends nothing", "frozen", 1, 0),
            ("it is unplugged", "present", 0, 1),
        ):
            run.until(lambda: not run.warning)
            made = len(run.stamps)
            run.until(lambda made=made: len(run.stamps) > made)  # just after a frame
            blaze[register] = ill
            told.setdefault(name, []).append(run.until(lambda: bool(run.warning)))
            if well is not None:
                time.sleep(2.0)
                blaze[register] = well
            before = time.time_ns()
            back.setdefault(name, []).append(
                run.until(lambda before=before: bool(run.stamps) and run.stamps[-1] > before)
            )
    run.close()
    return [
        f"| {name} | {statistics.median(told[name]):.2f} | {max(told[name]):.2f} | "
        f"{statistics.median(back[name]):.2f} | {max(back[name]):.2f} |"
        for name in told
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=30.0, help="how long each camera runs")
    parser.add_argument("--repeats", type=int, default=5, help="how often each fault is tried")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        square = Camera(400, 400, 400.0, 400.0, 199.5, 199.5)
        save_calibration(Calibration(square, square), folder / "viky.yaml")
        viky = {
            "tof__producer": VIKY,
            "tof__device": "'1'",
            "tof__depth_min_m": 0.0,
            "calibration": folder / "viky.yaml",
        }
        print("| Camera | frames/s | lost | failed | CPU [% of a core] | memory [MB] | clock |")
        print("|---|---|---|---|---|---|---|")
        print(
            throughput(
                "viky.cti, 400x400, points and intensity", Run(folder, {}, source="gentl", **viky), asked.seconds
            )
        )
        for label, more in (
            ("depth, intensity, confidence", {}),
            ("the same in fast mode", {"tof__fast_mode": "true", "tof__frame_rate_hz": 30.0}),
            ("points, intensity, confidence", {"tof__range_format": "Coord3D_ABC32f"}),
            ("the same, tof/points published", {"tof__range_format": "Coord3D_ABC32f", "publish_points": "true"}),
        ):
            blaze = FakeBlaze(folder, size=(640, 480))
            run = Run(folder, blaze.environment, source="gentl", tof__producer=producer(), **more)
            print(throughput(f"as a Blaze, 640x480, {label}", run, asked.seconds), flush=True)
        print("\n| Fault | told after, median [s] | longest | frames again after, median [s] | longest |")
        print("|---|---|---|---|---|")
        blaze = FakeBlaze(folder, size=(640, 480))
        run = Run(folder, blaze.environment, source="gentl", tof__producer=producer())
        print("\n".join(faults(run, blaze, asked.repeats)))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
