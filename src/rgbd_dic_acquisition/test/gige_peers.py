"""GigE Vision cameras for the tests, each a process of its own on 127.0.0.1."""

from __future__ import annotations

import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.drivers.aravis_library import GVCP_PORT, INSTALL, aravis
from rgbd_dic_acquisition.errors import DeviceError

PROGRAM = "arv-fake-gv-camera-0.8"
ADDRESS = "127.0.0.1"


def why_not() -> str:
    """What is missing for these tests, and how it is installed; empty if nothing is."""
    if shutil.which(PROGRAM) is None:
        return f"{PROGRAM} is missing: sudo apt install aravis-tools"
    try:
        aravis()
    except DeviceError:
        return f"Aravis cannot be loaded. {INSTALL}"
    return ""


needs_aravis = pytest.mark.skipif(bool(why_not()), reason=why_not())


class Peer:
    """A camera process that can be killed, frozen, thawed and started again."""

    def __init__(self, *command: str, speaks: bool = False) -> None:
        self._command, self._speaks = command, speaks
        self.start()

    def start(self) -> None:
        """Returns once it listens, if it says so; waits while another camera is on the address."""
        wait_for(_port_is_free, f"the end of another camera on {ADDRESS}")
        self._process = subprocess.Popen(self._command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        if self._speaks:
            assert "listens" in self._process.stdout.readline()

    @property
    def pid(self) -> int:
        return self._process.pid

    def kill(self) -> None:
        self._process.kill()
        self._process.communicate()

    def freeze(self) -> None:
        self._process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        self._process.send_signal(signal.SIGCONT)

    def __enter__(self) -> Peer:
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()


def _port_is_free() -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((ADDRESS, GVCP_PORT))
        except OSError:
            return False
    return True


def aravis_camera(serial: str = "GV42", lost_per_thousand: float = 0.0) -> Peer:
    """Aravis' own program."""
    return Peer(PROGRAM, "--interface", ADDRESS, "--serial", serial, "--gvsp-lost-ratio", str(lost_per_thousand))


def our_camera(images: np.ndarray | Path, folder: Path, *options: str, rate_hz: float = 60.0) -> Peer:
    """The same with these images (N, rows, cols), or those of a file; what it sent is in `sent(folder)`."""
    path = images
    if isinstance(images, np.ndarray):
        path = folder / "images.npy"
        np.save(path, images)
    module = "rgbd_dic_acquisition.simulator.gige_camera"
    given = ("--address", ADDRESS, "--rate", str(rate_hz), "--log", str(folder / "sent.csv"))
    return Peer(sys.executable, "-m", module, str(path), *given, *options, speaks=True)


def sent(folder: Path) -> np.ndarray:
    """(N, 4) int64 of each frame: its number, host time and device time [ns], index of the image."""
    return np.loadtxt(folder / "sent.csv", np.int64, delimiter=",", ndmin=2)


def calibrated(width: int, height: int) -> Camera:
    """A camera of this size."""
    return Camera(width, height, float(width), float(width), (width - 1) / 2, (height - 1) / 2)


def wait_for(condition, what: str, seconds: float = 60.0) -> float:
    """Seconds until the condition holds."""
    started = time.monotonic()
    while not condition():
        assert time.monotonic() < started + seconds, f"waited in vain for {what}"
        time.sleep(0.01)
    return time.monotonic() - started
