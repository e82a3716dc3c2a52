"""camera_node and a GigE Vision camera to which things happen; both are processes of their own."""

from __future__ import annotations

import itertools
import os
import resource
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from gige_peers import ADDRESS, aravis_camera, calibrated, needs_aravis, our_camera, sent, wait_for
from graph_ear import GraphEar
from open_sockets import open_sockets
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_acquisition.calibration import Calibration, save_calibration
from rgbd_dic_acquisition.messages import stamp_to_ns
from sensor_msgs.msg import CameraInfo

pytestmark = [needs_aravis, pytest.mark.timeout(280)]
WIDTH, HEIGHT, RATE_HZ = 320, 240, 60.0
EXPOSURE_NS = 100_000
STRANGER = "127.0.0.66"
LOSS = "images are lost on the way from the camera"
TOPIC = "camera/camera_info"
_domains = itertools.count(os.getpid())


class Flown:
    """A camera_node, and what it publishes."""

    def __init__(self, folder: Path, domain: int | None = None) -> None:
        save_calibration(Calibration(calibrated(WIDTH, HEIGHT)), folder / "calibration.yaml")
        self.domain = domain = domain or 10 + next(_domains) % 90
        settings = {"transport": "gige", "address": ADDRESS, "exposure_s": 1e-4, "gain": 0.0, "packet_bytes": 1500}
        parameters = {"source": "aravis", "calibration": folder / "calibration.yaml"}
        parameters |= {f"aravis.{name}": value for name, value in settings.items()}
        words = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_LOG_DIR": str(folder / "log")}
        self.log = folder / "camera_node.txt"
        with self.log.open("w") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "rgbd_dic_acquisition.nodes.camera_node", "--ros-args", *words],
                env=environment,
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        self.ear = GraphEar(domain, "camera_node", {TOPIC: CameraInfo})

    def __enter__(self) -> Flown:
        self.ear.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self.process.send_signal(signal.SIGTERM)
        try:
            self.process.wait(15)
        finally:
            self.process.kill()
            self.ear.__exit__()

    @property
    def stamps(self) -> list[int]:
        return [stamp for _, stamp in self.ear.heard[TOPIC]]

    def wait_for_images(self, count: int) -> float:
        """Seconds until so many more came, counted to the first of them."""
        before, started = len(self.stamps), time.monotonic()
        wait_for(lambda: len(self.stamps) >= before + count, "images")
        return self.ear.heard[TOPIC][before][0] - started

    def wait_until_missed(self) -> float:
        """Seconds until the diagnostics say that the camera is missing."""
        return wait_for(lambda: self.ear.level == 1 and LOSS not in self.ear.message, "a warning")

    def wait_until_well(self) -> float:
        """Seconds until they do not; a busy computer may still lose images on the way."""
        return wait_for(lambda: self.ear.level == 0 or LOSS in self.ear.message, "the end of the warning")


@pytest.fixture
def images() -> np.ndarray:
    return np.random.default_rng(1).integers(0, 256, (8, HEIGHT, WIDTH), np.uint8)


@pytest.fixture
def told():
    """What was measured [s]; printed with `-s`, asserted nowhere, as it depends on what else the computer does."""
    measured: dict[str, float] = {}
    yield measured
    print(", ".join(f"{what} {seconds:.3f} s" for what, seconds in measured.items()))


def _stamps_are_true(stamps: list[int], folder: Path) -> None:
    """Each is the middle of an exposure that there was, to a part of what pairing needs; they only increase."""
    exposed = np.sort(sent(folder)[:, 1]) + EXPOSURE_NS // 2
    assert np.all(np.diff(stamps) > 0)
    after = np.clip(np.searchsorted(exposed, stamps), 1, exposed.size - 1)
    errors_ns = np.minimum(np.abs(exposed[after] - stamps), np.abs(exposed[after - 1] - stamps))
    assert np.median(errors_ns) < 2e6
    assert np.mean(errors_ns < 5e6) > 0.98  # a computer busy with other things delays some deliveries


def test_a_killed_camera_is_missed_and_taken_up_again(tmp_path, images, told):
    with our_camera(images, tmp_path, "--latch") as camera, Flown(tmp_path) as flown:
        flown.wait_for_images(60)
        flown.wait_until_well()
        camera.kill()
        told["missed after"] = flown.wait_until_missed()
        wait_for(lambda: f"no camera answers at {ADDRESS}" in flown.ear.message, "the tries to open it")
        camera.start()
        told["images after its return"] = flown.wait_for_images(60)
        flown.wait_until_well()
        assert int(flown.ear.values["reopened"]) >= 1
        _stamps_are_true(flown.stamps, tmp_path)


@pytest.mark.parametrize("frozen_s", [0.7, 5.0])
def test_a_frozen_camera_is_missed_and_goes_on(tmp_path, images, told, frozen_s):
    """For a short time it goes on by itself; after seconds it has forgotten who controls it."""
    with our_camera(images, tmp_path) as camera, Flown(tmp_path) as flown:
        flown.wait_for_images(60)
        flown.wait_until_well()
        camera.freeze()
        told["missed after"] = flown.wait_until_missed()
        time.sleep(frozen_s)
        camera.thaw()
        told["images after its thaw"] = flown.wait_for_images(60)
        flown.wait_until_well()
        _stamps_are_true(flown.stamps, tmp_path)


def test_a_node_that_is_killed_leaves_the_camera_to_the_next_and_the_recording_whole(tmp_path, images, told):
    """SIGKILL. Nobody gives the control back, so the camera lets the next one in once it has waited for the first."""
    with our_camera(images, tmp_path, "--latch") as _, Flown(tmp_path) as flown:
        given = ["-p", f"output:={tmp_path / 'bag'}", "-p", f"topics:=['{TOPIC} sensor_msgs/msg/CameraInfo']"]
        environment = {**os.environ, "ROS_DOMAIN_ID": str(flown.domain), "ROS_LOG_DIR": str(tmp_path / "log")}
        command = [sys.executable, "-m", "rgbd_dic_acquisition.nodes.recorder_node", "--ros-args", *given]
        recorder = subprocess.Popen(command, env=environment)
        try:
            flown.wait_for_images(60)
            flown.wait_until_well()
            file = tmp_path / "bag" / "bag_0.mcap"
            wait_for(lambda: file.exists(), "the recording")
            flown.wait_for_images(60)
            flown.process.kill()
            with Flown(tmp_path, flown.domain) as second:
                told["images after the start of the next"] = second.wait_for_images(60)
                second.wait_until_well()
        finally:
            recorder.send_signal(signal.SIGTERM)
            recorder.wait(15)
    with BagReader(tmp_path / "bag") as bag:
        recorded = [stamp_to_ns(message.header.stamp) for *_, message in bag.messages()]
    heard = {stamp for stamp in (*flown.stamps, *second.stamps) if stamp >= recorded[0]}
    assert heard <= set(recorded) and any(stamp in heard for stamp in flown.stamps)
    _stamps_are_true(recorded, tmp_path)


def test_dropped_packets_cost_their_images_and_are_told(tmp_path):
    with aravis_camera(lost_per_thousand=1.0), Flown(tmp_path) as flown:
        flown.wait_for_images(100)
        wait_for(lambda: LOSS in flown.ear.message, "a warning of the loss")
        assert int(flown.ear.values["incomplete"]) > 0 and flown.ear.values["reopened"] == "0"
        assert int(flown.ear.values["received"]) <= len(flown.stamps) + 100


def test_a_camera_that_comes_late_is_waited_for(tmp_path, images):
    with Flown(tmp_path) as flown:
        flown.wait_until_missed()
        assert f"no camera answers at {ADDRESS}" in flown.ear.message and flown.process.poll() is None
        with our_camera(images, tmp_path):
            flown.wait_for_images(10)
            flown.wait_until_well()


@pytest.mark.slow
def test_garbage_on_its_ports_harms_nothing(tmp_path, images):
    """For a minute, of a stranger: noise, and headers of the stream and the control protocol with noise after them."""
    random = np.random.default_rng(7)
    headers = [b"", *(bytes([0, 0, 253, number]) + bytes([kind]) for number in range(4) for kind in (1, 2, 3, 4, 0x81))]
    headers += [bytes.fromhex(text) for text in ("42010002", "00000003", "00000081", "00000083", "00008085")]
    with our_camera(images, tmp_path) as _, Flown(tmp_path) as flown:
        flown.wait_for_images(60)
        before = _resident_bytes(flown.process.pid)
        ports, sent_packets = [each.port for each in open_sockets(flown.process.pid)], 0
        assert ports
        end = time.monotonic() + 60
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.bind((STRANGER, 0))
            while time.monotonic() < end:
                for _ in range(20):
                    noise = random.bytes(int(random.integers(0, 1500)))
                    packet = headers[int(random.integers(len(headers)))] + noise
                    stranger.sendto(packet, (ADDRESS, ports[int(random.integers(len(ports)))]))
                sent_packets += 20
                time.sleep(0.005)
                assert flown.process.poll() is None, flown.log.read_text()
        flown.wait_for_images(60)
        flown.wait_until_well()
        grown = _resident_bytes(flown.process.pid) - before
        print(f"{sent_packets} packets to ports {ports}, {grown / 1e6:.1f} MB more; {flown.ear.values}")
        assert grown < 50_000_000  # of which DDS and the allocator take some in any case
        _stamps_are_true(flown.stamps, tmp_path)


def _resident_bytes(process: int) -> int:
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * resource.getpagesize()


def test_a_node_that_was_stopped_itself_goes_on(tmp_path, images):
    with our_camera(images, tmp_path) as _, Flown(tmp_path) as flown:
        flown.wait_for_images(60)
        flown.process.send_signal(signal.SIGSTOP)
        time.sleep(1.5)
        flown.process.send_signal(signal.SIGCONT)
        flown.wait_for_images(60)
        flown.wait_until_well()
        assert flown.ear.values["reopened"] == "0"
        _stamps_are_true(flown.stamps, tmp_path)
