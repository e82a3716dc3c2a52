"""`rgbd-dic up --live` as a user runs it: a GigE Vision camera, a ToF camera behind GenTL, an autopilot on MAVLink."""

from __future__ import annotations

import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from autopilot_peers import Peers, free_port
from fake_blaze import FakeBlaze
from gige_peers import ADDRESS, needs_aravis, our_camera, wait_for
from graph_ear import GraphEar
from live_peers import DOMAIN, NOBODY, payload
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_processing.results import read_openings
from shown_crack import SHOWN_HZ, ShownCrack
from system import environment, rgbd_dic

from rgbd_dic_msgs.msg import CrackOpening

OPENINGS = 20

pytestmark = [needs_aravis, pytest.mark.timeout(400)]


class Flight:
    """A running `rgbd-dic up --live`; what it says is in `said`."""

    def __init__(self, folder: Path, *options: object) -> None:
        self._log = folder / "said.txt"
        command = ["rgbd-dic", "up", "--live", "--domain", DOMAIN, "--out", folder / "run", *options]
        with self._log.open("w") as log:
            self.process = subprocess.Popen(
                list(map(str, command)),
                stdout=log,
                stderr=subprocess.STDOUT,
                env=environment(),
                preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background jobs ignore it
            )

    @property
    def said(self) -> str:
        return self._log.read_text()

    def wait_for(self, condition, what: str) -> None:
        def met() -> bool:
            assert self.process.poll() is None, self.said
            return condition()

        wait_for(met, f"{what}: {self._log.read_text()}", 120.0)

    def end(self) -> int:
        """As Ctrl-C does; the exit code."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(60)


@pytest.fixture
def flights() -> Iterator[list[Flight]]:
    started: list[Flight] = []
    yield started
    for flight in started:
        if flight.process.poll() is None:
            flight.process.terminate()  # its nodes end with it
            flight.process.wait(60)


def test_a_flight(tmp_path: Path, shown: ShownCrack, blaze: FakeBlaze, flights: list[Flight]) -> None:
    """The camera comes late, the ToF camera is unplugged for a while, the camera's node is killed; what is measured is
    the crack that is shown, and all of it is recorded."""
    peers, port = Peers(tmp_path), free_port()
    file = payload(tmp_path / "payload.yaml", shown, port)
    flight = Flight(tmp_path, "--payload", file, "--regions", shown.files.regions)
    flights.append(flight)
    with GraphEar(DOMAIN, "tof_node", {"crack_opening": CrackOpening}) as ear:
        openings = ear.heard["crack_opening"]
        try:
            flight.wait_for(lambda: f"camera_node: no camera answers at {ADDRESS}" in flight.said, "the missing camera")
            flight.wait_for(lambda: "mavlink_node: nothing heard" in flight.said, "the missing autopilot")
            with our_camera(shown.images, tmp_path, "--latch", rate_hz=SHOWN_HZ):
                peers.mavsdk(f"udpout://127.0.0.1:{port}")
                flight.wait_for(lambda: len(openings) >= OPENINGS, "openings")
                assert "camera_node: is well" in flight.said
                well = flight.said.count("tof_node: is well")
                blaze["present"] = 0
                flight.wait_for(lambda: "tof_node: no frame comes" in flight.said, "the unplugged ToF camera")
                blaze["present"] = 1
                flight.wait_for(lambda: flight.said.count("tof_node: is well") > well, "the ToF camera")
                _kill(tmp_path / "run", "camera_node")
                flight.wait_for(lambda: "camera_node was killed, and is started again" in flight.said, "its restart")
                count = len(openings) + OPENINGS
                flight.wait_for(lambda: len(openings) >= count, "openings after all that")
                assert flight.end() == 0, flight.said
        finally:
            peers.end()
    valid = [opening for opening in read_openings(tmp_path / "run" / "crack_opening.csv") if opening.valid]
    rms_m = np.sqrt(np.mean(np.square(shown.errors_m(valid))))
    print(f"{len(valid)} openings, RMS error {rms_m * 1e3:.4f} mm")
    assert len(valid) >= OPENINGS and rms_m < shown.rms_limit_m
    assert np.ptp([o.opening_m for o in valid]) > 0.2e-3  # there was something to measure
    with BagReader(tmp_path / "run" / "bag") as bag:
        recorded = {name: topic.count for name, topic in bag.topics.items()}
        pairs = [message for _, _, message in bag.messages(["/frame_pair"])]
    of_camera = [recorded[f"/camera/{name}"] for name in ("image_raw", "camera_info", "time_reference")]
    assert max(of_camera) - min(of_camera) <= 1  # SIGKILL may have come between the messages of one image
    assert recorded["/crack_opening"] >= len(valid) and recorded["/tof/depth/image_raw"] > 0
    with_attitude = [pair for pair in pairs if np.isfinite(pair.attitude_offset)]
    assert len(with_attitude) >= OPENINGS  # the autopilot came before the first of them
    for pair in with_attitude:
        assert abs(pair.attitude_offset) <= 0.1
        assert np.linalg.norm([getattr(pair.attitude, axis) for axis in "xyzw"]) == pytest.approx(1, abs=1e-6)
    assert recorded["/imu/data"] > 0 and recorded["/tof/time_reference"] > 0


def test_a_flight_without_sensors(tmp_path: Path, shown: ShownCrack, blaze: FakeBlaze) -> None:
    """Nothing is plugged in: it runs for its time, says what it waited for, and that nothing was measured."""
    blaze["present"] = 0
    file = payload(tmp_path / "payload.yaml", shown, address=NOBODY)
    command = ["up", "--live", "--payload", file, "--regions", shown.files.regions, "--out", tmp_path / "run"]
    done = rgbd_dic(*command, "--domain", str(DOMAIN), "--duration", "3")
    assert done.returncode == 3, done.stderr
    assert f"camera_node: no camera answers at {NOBODY}" in done.stderr
    assert "tof_node: " in done.stderr
    assert (tmp_path / "run" / "crack_opening.csv").read_text().count("\n") == 1


def _kill(run: Path, node: str) -> None:
    """SIGKILL to a node of a run, found by its file of parameters."""
    parameters = str(run.resolve() / "logs" / f"{node}.yaml")
    found = [path for path in Path("/proc").glob("[0-9]*") if parameters in _command(path)]
    assert len(found) == 1
    subprocess.run(["kill", "-KILL", found[0].name], check=True)
    time.sleep(0.1)


def _command(process: Path) -> str:
    try:
        return (process / "cmdline").read_text().replace("\0", " ")
    except OSError:
        return ""
