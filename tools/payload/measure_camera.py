"""camera_node at full size: a GigE Vision camera of 1440 x 1080 at 60 Hz on 127.0.0.1, and one subscriber.

    tools/run python tools/payload/measure_camera.py --seconds 30 --packet 1500

Prints a row of the table in docs/payload.md: images that the camera sent, that the node received and lost, that the
subscriber got, and the processor time of each process.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import rclpy
from rclpy.qos import QoSProfile
from rgbd_dic_acquisition.calibration import Calibration, save_calibration
from rgbd_dic_acquisition.in_flight import header_stamp_ns
from rgbd_dic_acquisition.nodes.spinning import prepare_process
from rgbd_dic_acquisition.simulator.sensors import FLIR
from sensor_msgs.msg import Image

sys.path.append(str(Path(__file__).parents[1]))
from process_cost import processor_s

ADDRESS = "127.0.0.1"
SETTLE_S = 3.0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--packet", type=int, default=1500, help="bytes")
    given = parser.parse_args()
    prepare_process()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        np.save(folder / "images.npy", np.random.default_rng(1).integers(0, 256, (6, 1080, 1440), np.uint8))
        save_calibration(Calibration(FLIR), folder / "calibration.yaml")
        camera = ["rgbd_dic_acquisition.simulator.gige_camera", folder / "images.npy", "--log", folder / "sent.csv"]
        parameters = {"transport": "gige", "address": ADDRESS, "packet_bytes": given.packet}
        node = ["rgbd_dic_acquisition.nodes.camera_node", "--ros-args", "-p", "source:=aravis"]
        node += ["-p", f"calibration:={folder / 'calibration.yaml'}"]
        node += [word for key, value in parameters.items() for word in ("-p", f"aravis.{key}:={value}")]
        running = [subprocess.Popen([sys.executable, "-m", *map(str, command)]) for command in (camera, node)]
        try:
            print(measure(given.seconds, given.packet, folder / "sent.csv", [process.pid for process in running]))
        finally:
            for process in running[::-1]:
                process.terminate()
                process.wait()
    return 0


def measure(seconds: float, packet: int, log: Path, processes: list[int]) -> str:
    """A row: packet, sent, at the subscriber, processor of the node, of the subscriber, of the camera [%]."""
    got: list[int] = []
    rclpy.init()
    listener = rclpy.create_node("listener")
    take = lambda data: got.append(header_stamp_ns(data))  # noqa: E731
    listener.create_subscription(Image, "camera/image_raw", take, QoSProfile(depth=100), raw=True)

    def spin(until: float) -> None:
        while time.monotonic() < until:
            rclpy.spin_once(listener, timeout_sec=0.05)

    while not got:
        spin(time.monotonic() + 0.1)
    spin(time.monotonic() + SETTLE_S)
    everyone = [*processes, os.getpid()]
    before, first_ns, started = [processor_s(process) for process in everyone], got[-1], time.monotonic()
    spin(started + seconds)
    took_s, after, last_ns = time.monotonic() - started, [processor_s(process) for process in everyone], got[-1]
    camera, node, own = (100 * (b - a) / took_s for a, b in zip(before, after, strict=True))
    exposed = np.loadtxt(log, np.int64, delimiter=",", ndmin=2)[:, 1]
    sent = np.count_nonzero((exposed > first_ns) & (exposed <= last_ns))  # a stamp is later than that, by half a ms
    received = sum(first_ns < stamp <= last_ns for stamp in got)
    rclpy.shutdown()
    return f"| {packet} | {sent} | {received} | {node:.1f} | {own:.1f} | {camera:.1f} |"


if __name__ == "__main__":
    raise SystemExit(main())
