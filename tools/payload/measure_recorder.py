"""recorder_node at full size: what it records and loses, and its processor time and memory.

    tools/run python tools/payload/measure_recorder.py                   # a minute
    tools/run python tools/payload/measure_recorder.py --seconds 600 --write

Another process publishes mono8 images of 1440 x 1080 at 60 Hz, depth, intensity and confidence of 640 x 480 at 20 Hz,
their camera_infos and attitude at 50 Hz. Prints the tables of docs/payload.md; --write puts them there.

Ten minutes are 78 GB. So finished files of the bag are counted by their index and deleted behind the recorder, but for
the last two; --keep leaves all. --out says where the bag is written: the disk of the temporary folder, if not given.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import struct
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from mcap.reader import make_reader
from rclpy.executors import SingleThreadedExecutor
from rgbd_dic_acquisition.bag import make_message
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.message_types import serialise
from rgbd_dic_acquisition.messages import camera_info_message, image_message, imu_message
from rgbd_dic_acquisition.nodes.ros_messages import message_class
from rgbd_dic_acquisition.nodes.spinning import prepare_process

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "tools"))
from process_cost import TICKS, own_memory_mb, processor_s  # noqa: E402 - found by the line above

DOMAIN = os.environ.get("ROS_DOMAIN_ID", "75")
KEPT_FILES = 2
ROWS = 8  # of the table over time
SETTLE_S = 3.0
IMAGE, INFO, IMU = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/Imu"
TOPICS = {  # type, rate [Hz]
    "camera/image_raw": (IMAGE, 60.0),
    "camera/camera_info": (INFO, 60.0),
    "tof/depth/image_raw": (IMAGE, 20.0),
    "tof/intensity/image_raw": (IMAGE, 20.0),
    "tof/confidence/image_raw": (IMAGE, 20.0),
    "tof/depth/camera_info": (INFO, 20.0),
    "imu/data": (IMU, 50.0),
}


def samples() -> dict[str, list[bytes]]:
    """A few messages of each topic."""
    rng = np.random.default_rng(1)
    about = (make_message, 0, "sensor")
    camera, tof = Camera(1440, 1080, 2460.0, 2460.0, 719.5, 539.5), Camera(640, 480, 500.0, 500.0, 319.5, 239.5)
    images = [rng.integers(0, 256, (1080, 1440), np.uint8) for _ in range(6)]
    frames = [rng.integers(500, 4000, (480, 640), np.uint16) for _ in range(3)]
    tof_images = {
        f"tof/{name}/image_raw": [serialise(image_message(*about, frame, encoding)) for frame in frames]
        for name, encoding in (("depth", "16UC1"), ("intensity", "mono16"), ("confidence", "mono16"))
    }
    return {
        "camera/image_raw": [serialise(image_message(*about, image, "mono8")) for image in images],
        "camera/camera_info": [serialise(camera_info_message(*about, camera))],
        "tof/depth/camera_info": [serialise(camera_info_message(*about, tof))],
        "imu/data": [serialise(imu_message(*about, (0, 0, 0, 1), np.eye(3)))],
        **tof_images,
    }


def publish(seconds: float) -> None:
    """In a process of its own: all topics at their rates, once somebody listens to each; says what was sent."""
    prepare_process()
    rclpy.init(domain_id=int(DOMAIN))
    node, messages = rclpy.create_node("sensors"), samples()
    publishers = {topic: node.create_publisher(message_class(kind), topic, 10) for topic, (kind, _) in TOPICS.items()}
    while not all(publisher.get_subscription_count() for publisher in publishers.values()):
        time.sleep(0.1)
    time.sleep(1.0)
    sent: Counter[str] = Counter()
    start, start_ns = time.monotonic() + 0.1, time.time_ns()
    while True:
        topic = min(TOPICS, key=lambda topic: sent[topic] / TOPICS[topic][1])
        due_s = sent[topic] / TOPICS[topic][1]
        if due_s >= seconds:
            break
        time.sleep(max(0.0, start + due_s - time.monotonic()))
        of_topic = messages[topic]
        data = of_topic[sent[topic] % len(of_topic)]
        stamp = struct.pack("<iI", *divmod(start_ns + round(due_s * 1e9), 1_000_000_000))
        publishers[topic].publish(data[:4] + stamp + data[12:])
        sent[topic] += 1
    print(json.dumps({"sent": sent, "took": time.monotonic() - start}), flush=True)
    time.sleep(5.0)  # what is under way arrives


class Recorder:
    """recorder_node, and what it says and costs."""

    def __init__(self, folder: Path, output: Path, parameters: list[str]) -> None:
        topics = [f"{name} {kind}" for name, (kind, _) in TOPICS.items()]
        given = [f"output:={output}", f"topics:={json.dumps(topics)}", *parameters]
        command = [sys.executable, "-m", "rgbd_dic_acquisition.nodes.recorder_node", "--ros-args"]
        command += [word for parameter in given for word in ("-p", parameter)]
        self.log = (folder / "recorder.txt").open("w")
        self.process = subprocess.Popen(command, env=environment(folder), stdout=self.log, stderr=subprocess.STDOUT)
        self.told: dict[str, str] = {}
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=int(DOMAIN))
        self._node = rclpy.create_node("measure", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._take, 100)

    def _take(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "/recorder_node":
                self.told = {pair.key: pair.value for pair in status.values} | {"message": status.message}

    def listen(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def threads_s(self) -> Counter[str]:
        """Processor time of its threads [s]: of the middleware, of the one that takes, and of those that write."""
        spent: Counter[str] = Counter()
        for thread in Path(f"/proc/{self.process.pid}/task").iterdir():
            middleware = (thread / "comm").read_text().startswith("dds")
            first = int(thread.name) == self.process.pid
            spent["middleware" if middleware else "taking" if first else "writing"] += processor_s(thread)
        return spent

    def close(self) -> None:
        self.process.terminate()
        self.process.wait(60)
        self.log.close()
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)


class Bag:
    """Counts the messages of finished files by their index, and deletes those behind the last ones."""

    def __init__(self, path: Path, keep: bool) -> None:
        self.path, self._keep = path, keep
        self._files: dict[str, Counter[str]] = {}

    def look(self, finished: bool = False) -> None:
        files = sorted(self.path.glob("*.mcap"), key=lambda file: int(file.stem.rpartition("_")[2]))
        for file in files if finished else files[:-1]:
            if file.name not in self._files:
                with file.open("rb") as stream:
                    summary = make_reader(stream).get_summary()
                self._files[file.name] = Counter(
                    {
                        summary.channels[number].topic.lstrip("/"): count
                        for number, count in summary.statistics.channel_message_counts.items()
                    }
                )
        for file in () if self._keep else files[:-KEPT_FILES]:
            file.unlink()

    def counts(self) -> Counter[str]:
        return sum(self._files.values(), Counter())


def environment(folder: Path) -> dict[str, str]:
    quiet = {"ROS_DOMAIN_ID": DOMAIN, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_LOG_DIR": str(folder)}
    return {**os.environ, **quiet}


def measure(folder: Path, output: Path, seconds: float, keep: bool, parameters: list[str]) -> str:
    """Both tables, and a line on what else the computer did."""
    publisher = subprocess.Popen(
        [sys.executable, __file__, "--seconds", str(seconds), "--publish"],
        env=environment(folder),
        stdout=subprocess.PIPE,
    )
    recorder, bag = Recorder(folder, output, parameters), Bag(output, keep)
    try:
        cost = watch(recorder, publisher, bag, seconds)
        said = json.loads(publisher.stdout.readline())
        recorder.listen(3.0)
        publisher.wait()
    finally:
        publisher.terminate()
        recorder.close()
    bag.look(finished=True)
    return tables(said, bag.counts(), cost, recorder.told)


def watch(recorder: Recorder, publisher: subprocess.Popen, bag: Bag, seconds: float) -> tuple[list[str], str]:
    """While all is published: the rows of the table over time, and a sentence on the whole."""
    while float(recorder.told.get("rate [MB/s]", "0")) < 10:
        recorder.listen(0.2)
        if publisher.poll() is not None or recorder.process.poll() is not None:
            raise SystemExit(f"one of the processes ended: {Path(recorder.log.name).read_text()}")
    recorder.listen(SETTLE_S)
    processes = (recorder.process, publisher)
    begun, spent, busy = time.monotonic(), recorder.threads_s(), _busy_s()
    own = sum(_process_s(process) for process in processes)
    rows, most_waiting, most_mb = [], 0.0, 0.0
    span_s = max(5.0, seconds - SETTLE_S - 5.0)
    before = (begun, sum(spent.values()))
    for row in range(1, ROWS + 1):
        while (left := begun + span_s * row / ROWS - time.monotonic()) > 0:
            recorder.listen(min(1.0, left))
            bag.look()
            most_waiting = max(most_waiting, float(recorder.told["waiting for the disk [MB]"]))
            most_mb = max(most_mb, own_memory_mb(recorder.process.pid))
        now, total = time.monotonic(), sum(recorder.threads_s().values())
        share = 100 * (total - before[1]) / (now - before[0])
        rate = recorder.told["rate [MB/s]"]
        rows.append(
            f"| {now - begun + SETTLE_S:.0f} | {share:.1f} | {own_memory_mb(recorder.process.pid):.0f} | {rate} |"
        )
        before = (now, total)
    took_s = time.monotonic() - begun
    shares = {kind: 100 * (s - spent[kind]) / took_s for kind, s in recorder.threads_s().items()}
    others_s = _busy_s() - busy - (sum(_process_s(process) for process in processes) - own)
    return rows, (
        f"The recorder took {sum(shares.values()):.1f} % of a core ("
        + ", ".join(f"{kind} {share:.1f}" for kind, share in sorted(shares.items()))
        + f"), at most {most_mb:.0f} MB of memory of its own, and {most_waiting:.0f} MB of messages waited for the "
        f"disk ({_disk(bag.path)}). Meanwhile other programs took {100 * max(0.0, others_s) / took_s:.0f} % of the "
        f"{100 * os.cpu_count()} % that the computer has."
    )


def tables(said: dict, recorded: Counter[str], cost: tuple[list[str], str], told: dict[str, str]) -> str:
    """What goes into the page: what was sent and recorded, and what it cost."""
    sent = Counter(said["sent"])
    missed, dropped = (
        sum(int(count) for key, count in told.items() if key.startswith(f"{name} /")) for name in ("missed", "dropped")
    )
    lines = ["| Topic | sent | recorded | lost |", "|---|---|---|---|"]
    lines += [
        f"| `{topic}` | {sent[topic]} | {recorded[topic]} | {sent[topic] - recorded[topic]} |" for topic in TOPICS
    ]
    lines += ["", "| After [s] | processor [% of a core] | memory [MB] | rate over 5 s [MB/s] |", "|---|---|---|---|"]
    lines += cost[0]
    lines += ["", f"Published in {said['took']:.1f} s. {cost[1]} It counted {missed} missed and {dropped} dropped."]
    return "\n".join(lines)


def _process_s(process: subprocess.Popen) -> float:
    return 0.0 if process.poll() is not None else processor_s(process.pid)


def _busy_s() -> float:
    """Time that all cores have worked, together [s]."""
    user, nice, system, _, _, interrupt, soft, *_ = map(int, Path("/proc/stat").read_text().split("\n")[0].split()[1:])
    return (user + nice + system + interrupt + soft) / TICKS


def _disk(path: Path) -> str:
    kind = subprocess.run(
        ["findmnt", "-n", "-o", "FSTYPE", "-T", str(path.parent)], capture_output=True, text=True
    ).stdout.strip()
    return f"{kind or 'of an unknown kind'}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="how long is published")
    parser.add_argument("--out", type=Path, help="folder for the bag")
    parser.add_argument("--keep", action="store_true", help="delete no file of the bag")
    parser.add_argument("--write", action="store_true", help="put the tables into docs/payload.md")
    parser.add_argument("--parameter", action="append", default=[], help="of the recorder, such as split_mb:=1000")
    parser.add_argument("--publish", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.publish:
        publish(given.seconds)
        return 0
    with tempfile.TemporaryDirectory(dir=given.out) as name:
        folder = Path(name)
        text = measure(folder, folder / "bag", given.seconds, given.keep, ["split_mb:=1000", *given.parameter])
        print(text)
        if given.keep:
            target = (given.out or Path.cwd()) / "measured_bag"
            shutil.move(folder / "bag", target)
            print(f"the bag is {target}")
    if given.write:
        sys.path.insert(0, str(ROOT / "tools/docs"))
        from blocks import replace_block

        page = ROOT / "docs/payload.md"
        page.write_text(replace_block(page.read_text(), "recorder", text))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
