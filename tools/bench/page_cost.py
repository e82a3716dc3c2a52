"""What the live page costs: CPU of operator_node, and of who publishes what it hears, with and without viewers.

    tools/run python tools/bench/page_cost.py

A process publishes what a graph with the real camera does: 60 images of 1440 x 1080 a second, each with a subset field
of 12,000 subsets and an opening. Viewers are a client that does what the page does. Writes the table into
docs/operator.md.
"""

from __future__ import annotations

import argparse
import asyncio
import multiprocessing
import os
import socket
import statistics
import subprocess
import sys
import time
from pathlib import Path

import aiohttp
import numpy as np

ROOT = Path(__file__).parents[2]
sys.path += [str(ROOT / "tools"), str(ROOT / "tools" / "docs"), str(ROOT / "test")]
from process_cost import processor_s  # noqa: E402

WIDTH, HEIGHT, RATE_HZ, SUBSETS, PORT = 1440, 1080, 60.0, 12_000, 8497
SLOW_LINK = 20_000  # bytes a second
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


class Seen:
    """What a viewer has seen so far: pictures, how late the newest opening of each portion was [s], and how often the
    last picture was halved."""

    def __init__(self) -> None:
        self.pictures = multiprocessing.Value("i", 0)
        self.late_s = multiprocessing.Array("d", [0.0, 0.0])  # median, longest
        self.coarse = multiprocessing.Value("i", 0)


def view(bytes_per_s: float | None, seen: Seen) -> None:
    """A viewer, on a link of so many bytes a second if it is said."""
    from slow_link import SlowLink

    port = SlowLink(PORT, bytes_per_s).port if bytes_per_s else PORT
    late_s: list[float] = []

    async def pictures(session: aiohttp.ClientSession) -> None:
        number = -1
        while True:
            query = f"after={number}&coarse={seen.coarse.value}"
            async with session.get(f"http://127.0.0.1:{port}/live/picture?{query}") as answer:
                begun = time.monotonic()
                body = await answer.read()
            if answer.status == 200:
                number = int(body.split(b":", 1)[1].split(b",", 1)[0])
                seen.pictures.value += 1
                took = time.monotonic() - begun
                seen.coarse.value = min(max(seen.coarse.value + (took > 0.5) - (took < 0.1), 0), 2)

    async def look() -> None:
        async with aiohttp.ClientSession() as session:
            fetching = asyncio.create_task(pictures(session))
            async with session.ws_connect(f"http://127.0.0.1:{port}/live/numbers") as numbers:
                while True:
                    last = (await numbers.receive_json()).get("last")
                    await numbers.send_str("")
                    if last:
                        late_s.append(time.time() - int(last["stamp_ns"]) * 1e-9)
                        seen.late_s[:] = statistics.median(late_s), max(late_s)
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
    from blocks import replace_block, table

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
    rows = []
    try:
        wait_for_page()
        for words, links in (
            ("none", []),
            ("one", [None]),
            (f"one on a link of {SLOW_LINK // 1000} KB/s", [SLOW_LINK]),
            ("four", [None] * 4),
            ("none again", []),
        ):
            seen = Seen()
            viewers = [multiprocessing.Process(target=view, args=(link, seen)) for link in links]
            for viewer in viewers:
                viewer.start()
            time.sleep(5.0)
            before, pictures, start = [processor_s(p.pid) for p in (page, graph)], seen.pictures.value, time.monotonic()
            time.sleep(options.seconds)
            took = time.monotonic() - start
            used = [100 * (processor_s(p.pid) - b) / took for p, b in zip((page, graph), before, strict=True)]
            row = [words, *(f"{share:.1f}" for share in used)]
            if links:
                rate = (seen.pictures.value - pictures) / took / len(links)
                row += [f"{rate:.1f}", f"{800 >> seen.coarse.value}", "{:.2f}, {:.2f}".format(*seen.late_s)]
            rows.append(row + ["–"] * (6 - len(row)))
            print(*rows[-1], sep=" | ", flush=True)
            for viewer in viewers:
                viewer.terminate()
                viewer.join()
    finally:
        for process in (page, graph, *viewers):
            process.terminate()
    header = ("viewers", "`operator_node`", "publisher of all that", "pictures each [1/s]", "their width [px]")
    content = table((*header, "opening late by, median and longest [s]"), rows)
    document = ROOT / "docs/operator.md"
    document.write_text(replace_block(document.read_text(), "cost", content))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
