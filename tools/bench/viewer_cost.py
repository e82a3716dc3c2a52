"""What viewers cost: CPU of viewer_node and foxglove_node, and of who publishes what they hear, with and without one.

    tools/run python tools/bench/viewer_cost.py

A process publishes what a graph with the real sensors does: 60 images of 1440 x 1080 a second, each with a displacement
field of 12,000 subsets and an opening, 20 depth frames of 640 x 480 with a plane each, and the small pictures that
somebody asks for. Writes the table into docs/viewers.md.
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from page_cost import HEIGHT, RATE_HZ, REGIONS, SUBSETS, WIDTH
from process_cost import processor_s  # page_cost makes it found

ROOT = Path(__file__).parents[2]
sys.path += [str(ROOT / "test"), str(ROOT / "tools" / "docs")]
PORT = 8498
SETTLE_S, GONE_S = 6.0, 5.0  # before each measurement; after viewers that left without a word
DEPTH_EVERY = 3  # images a depth frame
SHOWN = (  # by the layout for Foxglove
    *("/view/image_rect", "/view/camera_info", "/view/regions", "/view/displacement", "/view/subsets", "/view/scene"),
    *("/view/opening", "/view/cloud", "/crack_opening", "/displacement_field", "/camera/image_raw"),
)


def publish(calibration_path: Path) -> None:
    """The graph's part, until it is ended."""
    import rclpy
    from rclpy.experimental.events_executor import EventsExecutor
    from rclpy.signals import SignalHandlerOptions
    from rgbd_dic_acquisition.calibration import load_calibration
    from rgbd_dic_acquisition.messages import depth_message, image_message
    from rgbd_dic_acquisition.nodes.ros_messages import latched_qos, make
    from rgbd_dic_acquisition.nodes.spinning import prepare_process, spin
    from rgbd_dic_processing.core.crack import CrackOpening
    from rgbd_dic_processing.core.displacement_field import DisplacementField
    from rgbd_dic_processing.core.geometry import Plane
    from rgbd_dic_processing.core.plane import PlaneEstimate
    from rgbd_dic_processing.core.regions_file import entries_of_text, regions_of
    from rgbd_dic_processing.core.search import SeedSource
    from rgbd_dic_processing.core.status import FrameStatus
    from rgbd_dic_processing.core.subset_field import Reference, SubsetField
    from rgbd_dic_processing.nodes.messages import (
        crack_opening_message,
        displacement_field_message,
        plane_message,
        reference_message,
    )
    from rgbd_dic_processing.nodes.preview import PreviewedFields, PreviewOutput, PreviewSettings
    from scipy.ndimage import gaussian_filter
    from sensor_msgs.msg import Image

    from rgbd_dic_msgs import msg

    prepare_process()
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("graph")
    kinds = {
        "camera/image_raw": Image,
        "tof/depth/image_raw": Image,
        "plane": msg.PlaneStamped,
        "displacement_field": msg.DisplacementField,
        "crack_opening": msg.CrackOpening,
    }
    outputs = {topic: node.create_publisher(kind, topic, 10) for topic, kind in kinds.items()}
    latched = node.create_publisher(msg.Reference, "reference", latched_qos())
    camera = load_calibration(calibration_path).camera
    rng = np.random.default_rng(1)
    speckle = gaussian_filter(rng.standard_normal((HEIGHT, WIDTH)), 2.5)
    pixels = np.clip(128 + 50 * speckle / speckle.std(), 0, 255).astype(np.uint8)
    centres = rng.uniform(110, 970, (SUBSETS, 2))
    reference = Reference(1, pixels, centres, 31, 10, centres, np.eye(3), regions_of(entries_of_text(REGIONS)))
    latched.publish(reference_message(make, reference, "camera_optical_frame"))
    plane = Plane(np.array([0.0, 0.0, 1.0]), -2.0, np.zeros((4, 4)))
    position = plane.points(camera.rays(centres))[:, :2]
    displacement = np.column_stack([1e-3 * (centres[:, 0] > 720), np.zeros(SUBSETS), np.full(SUBSETS, np.nan)])
    depth = (2.0 + 0.005 * rng.standard_normal((480, 640))).astype(np.float32)
    small = np.zeros(SUBSETS, np.uint8)
    sigma = np.full((SUBSETS, 3), 2e-6, np.float32)
    preview, previewed = PreviewOutput(node, PreviewSettings()), PreviewedFields(node)
    executor = EventsExecutor()
    executor.add_node(node)
    number, next_s = 0, time.monotonic()
    while rclpy.ok():
        stamp_ns = time.time_ns()
        outputs["camera/image_raw"].publish(image_message(make, stamp_ns, "camera_optical_frame", pixels, "mono8"))
        found = SubsetField(
            *(stamp_ns, 1, 1, FrameStatus.OK, "", SeedSource.PREDICTION, 31.0, np.eye(3)),
            *(centres, sigma[:, :2], sigma[:, 0], small, small),
        )
        preview.offer(pixels, found, "camera_optical_frame")
        if number % DEPTH_EVERY == 0:
            outputs["tof/depth/image_raw"].publish(depth_message(make, stamp_ns, "tof_optical_frame", depth))
            estimate = PlaneEstimate(stamp_ns, FrameStatus.OK, plane=plane)
            outputs["plane"].publish(plane_message(make, estimate, "camera_optical_frame"))
        field = DisplacementField(
            *(stamp_ns, 1, 1, "h_pose", FrameStatus.OK, "", 0.0, 31.0),
            *(centres.astype(np.float32), position, displacement, sigma),
            *(np.zeros((6, 3, 6)), np.zeros(6, np.uint8), np.zeros((6, 2, 3)), 0.0, np.nan, 0.01),
        )
        message = displacement_field_message(make, field)
        outputs["displacement_field"].publish(message)
        previewed.offer(message)
        opening = CrackOpening(
            *(stamp_ns, 1, "h_pose", FrameStatus.OK, "", 1e-4, 0.0, np.nan, 1e-4, 4e-6, 4e-6, np.nan, 4e-6, 70, 70, 0.0)
        )
        outputs["crack_opening"].publish(crack_opening_message(make, opening))
        number += 1
        next_s += 1 / RATE_HZ
        spin(executor, 0.0)
        time.sleep(max(0.0, next_s - time.monotonic()))


def look_by_ros(taken: multiprocessing.Value) -> None:
    """A viewer such as rviz: it subscribes all that viewer_node gives."""
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from rgbd_dic_acquisition.nodes.ros_messages import message_class
    from rgbd_dic_processing.view_topics import VIEW_TYPES

    rclpy.init(args=[])
    node = rclpy.create_node("rviz")

    def took(_: bytes) -> None:
        taken.value += 1

    for topic, kind in VIEW_TYPES.items():
        counted = took if topic == "view/image_rect" else (lambda _: None)
        node.create_subscription(message_class(kind), topic, counted, 5, raw=True)
    with contextlib.suppress(ExternalShutdownException):
        rclpy.spin(node)


def look_by_websocket(taken: multiprocessing.Value) -> None:
    """A viewer such as Foxglove with the layout."""
    from foxglove_viewer import Watched, watch

    def counted(seen: Watched) -> bool:
        taken.value = len(seen.came.get("/view/image_rect", ()))
        return False

    watch(PORT, SHOWN, counted, timeout_s=1e6, decode=False)


def write_calibration(folder: Path) -> Path:
    """That of the sample bag, with the pixels of the real sensors."""
    from rgbd_dic_acquisition.calibration import Calibration, load_calibration, save_calibration

    sample = load_calibration(ROOT / "bags/sample/calibration.yaml")
    tof = sample.tof.scaled_to(640, 480)
    path = folder / "calibration.yaml"
    extrinsics = (sample.R_camera_tof, sample.t_camera_tof)
    save_calibration(Calibration(sample.camera.scaled_to(WIDTH, HEIGHT), tof, *extrinsics), path)
    return path


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--publish", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--seconds", type=float, default=20.0, help="length of each measurement [s]")
    parser.add_argument("--domain", type=int, default=97, help="ROS domain")
    options = parser.parse_args()
    os.environ["ROS_DOMAIN_ID"] = str(options.domain)
    if options.publish:
        publish(options.publish)
        return 0
    import tempfile

    from ament_index_python.packages import get_package_prefix
    from blocks import replace_block, table

    environment = {name: value for name, value in os.environ.items() if name != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    nodes = Path(get_package_prefix("rgbd_dic_processing"), "lib", "rgbd_dic_processing")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = write_calibration(Path(folder))
        quiet = ["--ros-args", "--log-level", "warn", "-p"]
        commands = (
            [str(nodes / "viewer_node"), *quiet, f"calibration_file:={path}"],
            [str(nodes / "foxglove_node"), *quiet, f"foxglove.port:={PORT}"],
            [sys.executable, __file__, "--publish", str(path), "--domain", str(options.domain)],
        )
        processes = [subprocess.Popen(command, env=environment) for command in commands]
        viewers: list[multiprocessing.Process] = []
        try:
            time.sleep(12.0)
            for words, looks in (
                ("none", []),
                ("one such as rviz: all of `view/`", [look_by_ros]),
                ("one on the websocket, with the layout for Foxglove", [look_by_websocket]),
                ("none again", []),
            ):
                taken = multiprocessing.Value("i", 0)
                viewers = [multiprocessing.Process(target=look, args=(taken,)) for look in looks]
                for viewer in viewers:
                    viewer.start()
                time.sleep(SETTLE_S if looks or not rows else GONE_S)
                before, pictures, start = [processor_s(p.pid) for p in processes], taken.value, time.monotonic()
                time.sleep(options.seconds)
                took = time.monotonic() - start
                used = [100 * (processor_s(p.pid) - b) / took for p, b in zip(processes, before, strict=True)]
                rows.append((words, *(f"{share:.1f}" for share in used), f"{(taken.value - pictures) / took:.1f}"))
                print(*rows[-1], sep=" | ", flush=True)
                for viewer in viewers:
                    viewer.terminate()
                    viewer.join()
        finally:
            for process in (*processes, *viewers):
                process.terminate()
    page = ROOT / "docs/viewers.md"
    content = table(("viewers", "`viewer_node`", "`foxglove_node`", "publisher of all that", "pictures [1/s]"), rows)
    page.write_text(replace_block(page.read_text(), "cost", content))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
