"""Camera, ToF camera and autopilot that play one rendered flight; the ToF camera is a library in its node's process."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import numpy as np
from autopilot_peers import Peer, Peers, free_port
from fake_blaze import FakeBlaze
from gige_peers import ADDRESS, our_camera
from rendered_flight import IMAGE_PERIOD_NS, IMAGE_RATE_HZ, TOF_RATE_HZ, RenderedFlight

EXPOSURE_S = 0.002
DELIVERY_S = 0.01  # of an attitude, from when it is measured to when it is sent
ATTITUDE_PERIOD_S = 0.02
CAMERA, TOF, AUTOPILOT = "camera", "ToF camera", "autopilot"
PERIODS_S = {CAMERA: 1 / IMAGE_RATE_HZ, TOF: 1 / TOF_RATE_HZ, AUTOPILOT: ATTITUDE_PERIOD_S}
FIRST_NICE = -10  # of sensors and recorder, as docs/payload.md advises, where that may be set
SENT = {CAMERA: "sent.csv", TOF: "blaze/sent.csv", AUTOPILOT: "attitudes.csv"}


def sent(folder: Path, peer: str) -> np.ndarray:
    """(N, k): of each frame of a camera number, host and device time, index; of each attitude host time, w to z."""
    return np.loadtxt(folder / SENT[peer], np.int64 if peer != AUTOPILOT else float, delimiter=",", ndmin=2)


class FlightPeers:
    """Camera, ToF camera and autopilot of one flight; what they sent is in files of the folder."""

    def __init__(self, rendered: RenderedFlight, folder: Path) -> None:
        self._rendered, self._folder = rendered, folder
        self.port = free_port()
        with contextlib.ExitStack() as closing:  # if one of them does not start
            self._start(closing)
            self._closing = closing.pop_all()

    def _start(self, closing: contextlib.ExitStack) -> None:
        rendered, folder = self._rendered, self._folder
        self.camera = closing.enter_context(
            our_camera(rendered.images, folder, "--latch", rate_hz=1e9 / IMAGE_PERIOD_NS)
        )
        tof = rendered.settings.tof
        (folder / "blaze").mkdir()
        size = (tof.width_px, tof.height_px)
        played = {"played": rendered.depth, "played_ns": rendered.played_ns}
        self.blaze = FakeBlaze(folder / "blaze", size=size, **played)
        os.environ.update(self.blaze.environment)
        self._autopilots = Peers(folder)
        closing.callback(self._autopilots.end)
        self.autopilot = self._fly()
        give_turn(self.camera.pid, FIRST_NICE)

    def fail(self, peer: str) -> None:
        if peer == CAMERA:
            self.camera.kill()
        elif peer == TOF:
            self.blaze["present"] = 0
        else:
            self.autopilot.kill()

    def come_back(self, peer: str) -> None:
        if peer == CAMERA:
            self.camera.start()
            give_turn(self.camera.pid, FIRST_NICE)
        elif peer == TOF:
            self.blaze["present"] = 1
        else:
            self.autopilot = self._fly(boot_s=5.0)

    def _fly(self, **options: float) -> Peer:
        played = {"played": self._rendered.attitude, "played_ns": self._rendered.played_ns}
        log = self._folder / SENT[AUTOPILOT]
        peer = self._autopilots.mavsdk(
            f"udpout://{ADDRESS}:{self.port}",
            delay_s=DELIVERY_S,
            rate_hz=1 / ATTITUDE_PERIOD_S,
            log=log,
            **played,
            **options,
        )
        give_turn(peer.process.pid, FIRST_NICE)
        return peer

    def __enter__(self) -> FlightPeers:
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.close()


def give_turn(process: int, nice: int) -> None:
    """To all its threads: a peer has a processor of its own, and a driver goes before the processing."""
    for thread in Path(f"/proc/{process}/task").iterdir():
        with contextlib.suppress(OSError):  # it has ended, or the right is missing
            os.setpriority(os.PRIO_PROCESS, int(thread.name), nice)
