"""Starts the simulated autopilots of `peers/` as processes, and joins two serial lines."""

from __future__ import annotations

import os
import pty
import select
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import tty
from pathlib import Path

import pytest

PEERS = Path(__file__).parent / "peers"
NODE_MODULES = Path(__file__).parents[3] / "build" / "node_peers"


def free_port(kind: int = socket.SOCK_DGRAM) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Peer:
    """A process that flies; killed, stopped and continued by the tests."""

    def __init__(self, command: list[str], log: Path, folder: Path = PEERS) -> None:
        with log.open("w") as output:
            self.process = subprocess.Popen(command, cwd=folder, stdout=output, stderr=subprocess.STDOUT)
        end = time.monotonic() + 30
        while "flying" not in log.read_text():
            assert self.process.poll() is None and time.monotonic() < end, log.read_text()
            time.sleep(0.02)

    def signal(self, number: int) -> None:
        self.process.send_signal(number)

    def kill(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()


class Peers:
    """Starts peers and ends all of them."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._running = folder, []

    def mavsdk(self, url: str, **options: object) -> Peer:
        pytest.importorskip("mavsdk", reason="pip install mavsdk==4.1.0")
        words = [f"--{name.replace('_', '-')}={value}" for name, value in options.items()]
        return self._started([sys.executable, str(PEERS / "mavsdk_autopilot.py"), url, *words])

    def node_mavlink(self, port: int) -> Peer:
        if shutil.which("npm") is None:
            pytest.skip("no npm: apt-get install -y npm")
        NODE_MODULES.mkdir(parents=True, exist_ok=True)
        for name in (".npmrc", "package.json", "package-lock.json", "node_mavlink_autopilot.mjs"):
            shutil.copy(PEERS / name, NODE_MODULES)
        if not (NODE_MODULES / "node_modules" / "node-mavlink").exists():
            subprocess.run(["npm", "ci", "--no-audit", "--no-fund"], cwd=NODE_MODULES, check=True, timeout=240)
        return self._started(["node", "node_mavlink_autopilot.mjs", str(port)], NODE_MODULES)

    def end(self) -> None:
        for peer in self._running:
            peer.signal(signal.SIGCONT)
            peer.kill()

    def _started(self, command: list[str], folder: Path = PEERS) -> Peer:
        peer = Peer(command, self._folder / f"peer_{len(self._running)}.txt", folder)
        self._running.append(peer)
        return peer


class SerialCable:
    """Two pseudo-terminals joined end to end; `ends` are the devices. Bytes of `noise` reach the second one too."""

    def __init__(self) -> None:
        pairs = [pty.openpty(), pty.openpty()]
        self._masters = [master for master, _ in pairs]
        self._slaves = [slave for _, slave in pairs]  # kept open, so that nobody sees the line hang up
        for slave in self._slaves:
            tty.setraw(slave)
        self.ends = [os.ttyname(slave) for slave in self._slaves]
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._pump, daemon=True)
        self._thread.start()

    def noise(self, data: bytes) -> None:
        os.write(self._masters[1], data)

    def unplug(self) -> None:
        self._stop.set()
        self._thread.join()
        for end in (*self._masters, *self._slaves):
            os.close(end)

    def _pump(self) -> None:
        while not self._stop.is_set():
            ready, _, _ = select.select(self._masters, [], [], 0.02)
            for master in ready:
                os.write(self._masters[1 - self._masters.index(master)], os.read(master, 4096))
