"""What the live page costs: CPU of operator_node, and of who publishes what it hears, with and without viewers.

    tools/run python tools/bench/page_cost.py

A process publishes what a graph with the real camera does: 60 images of 1440 x 1080 a second, each with a subset field
of 12,000 subsets and an opening. Viewers are a client that does what the page does. Prints a table in Markdown.
"""

from __future__ import annotations

import argparse
import asyncio
import multiprocessing
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import aiohttp
import numpy as np

sys.path.append(str(Path(__file__).parents[1]))
from process_cost import processor_s

WIDTH, HEIGHT, RATE_HZ, SUBSETS, PORT = 1440, 1080, 60.0, 12_000, 8497
REGIONS = """panel: [[100, 100], [1340, 100], [1340, 980], [100, 980]]
fixed: [[[100, 100], [600, 100], [600, 980], [100, 980]]]
crack: {point: [720, 540], direction: [0, 1], size: [200, 400], gap: 40}
"""


def publish() -> None:
    """The graph's part, until it is ended."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions
    from rgbd_dic_acquisition.calibration import Camera
    from rgbd_dic_acquisition.messages import camera_info_message, image_message
    from rgbd_dic_acquisition.nodes.ros_messages import latched_qos, make
    from rgbd_dic_acquisition.nodes.spinning import prepare_process
    from rgbd_dic_processing.core.crack import CrackOpening
    from rgbd_dic_processing.core.regions_file import entries_of_text, regions_of
    from rgbd_dic_processing.core.search import SeedSource
    from rgbd_dic_processing.core.status import FrameStatus
    from rgbd_dic_processing.core.subset_field import Reference, SubsetField
    from rgbd_dic_processing.nodes.messages import crack_opening_message, reference_message, subset_field_message
    from rgbd_dic_processing.nodes.preview import PreviewOutput, PreviewSettings
    from scipy.ndimage import gaussian_filter
    from sensor_msgs.msg import CameraInfo, Image

    from rgbd_dic_msgs import msg

    prepare_process()
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("graph")
    kinds = {
        "camera/image_raw": Image,
        "camera/camera_info": CameraInfo,
        "subset_field": msg.SubsetField,
        "crack_opening": msg.CrackOpening,
    }
    outputs = {topic: node.create_publisher(kind, topic, 10) for topic, kind in kinds.items()}
    latched = node.create_publisher(msg.Reference, "reference", latched_qos())
    camera = Camera(WIDTH, HEIGHT, 2459.0, 2466.0, 719.5, 539.5)
    speckle = gaussian_filter(np.random.default_rng(1).standard_normal((HEIGHT, WIDTH)), 2.5)
    pixels = np.clip(128 + 50 * speckle / speckle.std(), 0, 255).astype(np.uint8)
    centres = np.random.default_rng(2).uniform(100, 980, (SUBSETS, 2))
    reference = Reference(1, pixels, centres, 31, 10, centres, np.eye(3), regions_of(entries_of_text(REGIONS)))
    latched.publish(reference_message(make, reference, "camera"))
    single, small = np.full(SUBSETS, 0.9, np.float32), np.zeros(SUBSETS, np.uint8)
    preview = PreviewOutput(node, PreviewSettings())
    next_s = time.monotonic()
    while rclpy.ok():
        stamp_ns = time.time_ns()
        field = SubsetField(
            *(stamp_ns, 1, 1, FrameStatus.OK, "", SeedSource.PREDICTION, 31.0, np.eye(3)),
            *(centres, np.full((SUBSETS, 2), 0.01, np.float32), single, small, small),
        )
        opening = CrackOpening(
            *(stamp_ns, 1, "h_pose", FrameStatus.OK, "", 1e-4, 0.0, np.nan, 1e-4, 4e-6, 4e-6, np.nan, 4e-6, 70, 70, 0.0)
        )
        outputs["camera/image_raw"].publish(image_message(make, stamp_ns, "camera", pixels, "mono8"))
        outputs["camera/camera_info"].publish(camera_info_message(make, stamp_ns, "camera", camera))
        outputs["subset_field"].publish(subset_field_message(make, field, "camera"))
        outputs["crack_opening"].publish(crack_opening_message(make, opening))
        preview.offer(pixels, field, "camera")
        next_s += 1 / RATE_HZ
        time.sleep(max(0.0, next_s - time.monotonic()))


def view(pause_s: float, taken: multiprocessing.Value) -> None:
    """A viewer that rests so long between two pictures; counts them."""

    async def pictures(session: aiohttp.ClientSession) -> None:
        number = -1
        while True:
            async with session.get(f"http://127.0.0.1:{PORT}/live/picture?after={number}") as answer:
                body = await answer.read()
            if answer.status == 200:
                number = int(body.split(b":", 1)[1].split(b",", 1)[0])
                taken.value += 1
            await asyncio.sleep(pause_s)

    async def look() -> None:
        async with aiohttp.ClientSession() as session:
            fetching = asyncio.create_task(pictures(session))
            async with session.ws_connect(f"http://127.0.0.1:{PORT}/live/numbers") as numbers:
                async for _ in numbers:
                    pass
            fetching.cancel()

    asyncio.run(look())


def wait_for_page() -> None:
    """Until it is served, and the publisher is certainly at work."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        try:
            socket.create_connection(("127.0.0.1", PORT), 1.0).close()
            break
        except OSError:
            time.sleep(0.2)
    time.sleep(5.0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--publish", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--seconds", type=float, default=20.0, help="length of each measurement [s]")
    parser.add_argument("--domain", type=int, default=98, help="ROS domain")
    options = parser.parse_args()
    os.environ["ROS_DOMAIN_ID"] = str(options.domain)
    if options.publish:
        publish()
        return 0
    environment = {name: value for name, value in os.environ.items() if name != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    from ament_index_python.packages import get_package_prefix

    node = Path(get_package_prefix("rgbd_dic_processing"), "lib", "rgbd_dic_processing", "operator_node")
    graph = subprocess.Popen([sys.executable, __file__, "--publish", "--domain", str(options.domain)], env=environment)
    page = subprocess.Popen(
        [
            str(node),
            "--ros-args",
            "--log-level",
            "warn",
            "-p",
            f"operator.port:={PORT}",
            "-p",
            "operator.linger_s:=1.0",
        ],
        env=environment,
    )
    viewers: list[multiprocessing.Process] = []
    try:
        wait_for_page()
        print("| viewers | operator_node [% of a core] | publisher [% of a core] | pictures [1/s] |\n|---|---|---|---|")
        for words, pauses in (
            ("none", []),
            ("one", [0.0]),
            ("one on a slow link, 2 s a picture", [2.0]),
            ("four", [0.0] * 4),
            ("none again", []),
        ):
            taken = multiprocessing.Value("i", 0)
            viewers = [multiprocessing.Process(target=view, args=(pause, taken)) for pause in pauses]
            for viewer in viewers:
                viewer.start()
            time.sleep(5.0)
            before, pictures, start = [processor_s(p.pid) for p in (page, graph)], taken.value, time.monotonic()
            time.sleep(options.seconds)
            took = time.monotonic() - start
            used = [100 * (processor_s(p.pid) - b) / took for p, b in zip((page, graph), before, strict=True)]
            rate = (taken.value - pictures) / took / max(len(pauses), 1)
            print(f"| {words} | {used[0]:.1f} | {used[1]:.1f} | {rate:.1f} |", flush=True)
            for viewer in viewers:
                viewer.terminate()
                viewer.join()
    finally:
        for process in (page, graph, *viewers):
            process.terminate()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
