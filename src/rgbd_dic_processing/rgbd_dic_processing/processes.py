"""Starting and ending the nodes of a graph as processes of their own, without ROS' launch system."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import time
from collections.abc import Iterable
from pathlib import Path

import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from rgbd_dic_acquisition.errors import RgbdDicError

from .graph import COMPOSED, PROCESSING, RECORDER, SHARING, NodeSpec

END_TIMEOUT_S = 10.0
RECORDER_TIMEOUT_S = 20.0  # it may have half a gigabyte to bring to a slow disk
_PRCTL = getattr(ctypes.CDLL(None), "prctl", None)


class GraphProcesses:
    """The running nodes; a context manager that ends them all, whatever happens.

    Args:
        folder: for each node's parameter file and log.
        use_sim_time: whether the nodes follow /clock.
        namespace: pushed on all names.
    """

    def __init__(self, folder: Path, use_sim_time: bool, namespace: str = ""):
        self._folder, self._use_sim_time, self._namespace = folder, use_sim_time, namespace
        self._running: dict[str, subprocess.Popen] = {}
        self._specs: dict[str, NodeSpec] = {}
        folder.mkdir(parents=True, exist_ok=True)

    def start(self, spec: NodeSpec) -> subprocess.Popen:
        """Start one node; its output goes to `<node>.log`."""
        self._specs[spec.node_name] = spec
        command = [str(_executable(spec.package, spec.executable)), *self._arguments(spec)]
        return self._run(spec.node_name, command)

    def start_all(self, specs: list[NodeSpec], composed: str = "") -> None:
        """Start nodes; those that `composed`, a key of `SHARING`, names in one process together."""
        together = [spec for spec in specs if spec.executable in SHARING.get(composed, ())]
        if together:
            command = [str(_executable(PROCESSING, COMPOSED))]
            for spec in together:
                command += ["--node", spec.executable, *self._arguments(spec)]
            self._run(COMPOSED, command)
        for spec in specs:
            if spec not in together:
                self.start(spec)

    @property
    def pids(self) -> dict[str, int]:
        """Of each process that was started, by the name of its node."""
        return {name: process.pid for name, process in self._running.items()}

    def _arguments(self, spec: NodeSpec) -> list[str]:
        parameters = self._folder / f"{spec.node_name}.yaml"
        values = {"use_sim_time": self._use_sim_time and spec.follows_clock, **spec.parameters}
        values = {name: value for name, value in values.items() if value != []}
        parameters.write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}))
        arguments = ["--ros-args", "-r", f"__node:={spec.node_name}"]
        if self._namespace:
            arguments += ["-r", f"__ns:={self._namespace}"]
        for before, after in spec.remappings.items():
            arguments += ["-r", f"{before}:={after}"]
        return [*arguments, "--params-file", str(parameters)]

    def _run(self, name: str, command: list[str]) -> subprocess.Popen:
        with self.log_of(name).open("ab" if name in self._running else "wb") as log:
            process = subprocess.Popen(
                command,
                stdout=log,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                env=_environment(),
                start_new_session=True,
                preexec_fn=_end_with_parent,
            )
        self._running[name] = process
        return process

    def revive(self, names: Iterable[str]) -> list[str]:
        """Start again those of these nodes that a signal ended, such as a crash of their driver; returns which."""
        ended = [name for name in names if (self._running[name].poll() or 0) < 0]
        for name in ended:
            self.start(self._specs[name])
        return ended

    def log_of(self, node_name: str) -> Path:
        return self._folder / f"{node_name}.log"

    def check(self) -> None:
        """Raise if a node has ended in failure.

        Raises:
            RgbdDicError: naming the node, with the last line that it said.
        """
        for name, process in self._running.items():
            if process.poll() not in (None, 0):
                lines = self.log_of(name).read_text(errors="replace").strip().splitlines() or ["(it said nothing)"]
                raise RgbdDicError(
                    f"{name} ended with exit code {process.returncode}: {lines[-1]} (log: {self.log_of(name)})"
                )

    def end(self) -> None:
        """SIGINT to all, to the recorder when the others are gone, so that what those publish last is recorded; SIGKILL
        to what is still there after a while."""
        recorders = {name for name, spec in self._specs.items() if spec.executable == RECORDER}
        _end([process for name, process in self._running.items() if name not in recorders], END_TIMEOUT_S)
        _end([process for name, process in self._running.items() if name in recorders], RECORDER_TIMEOUT_S)

    def __enter__(self) -> GraphProcesses:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()


def _end(processes: list[subprocess.Popen], timeout_s: float) -> None:
    for process in processes:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
    deadline = time.monotonic() + timeout_s
    for process in processes:
        try:
            process.wait(max(0.1, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _executable(package: str, name: str) -> Path:
    try:
        path = Path(get_package_prefix(package), "lib", package, name)
    except PackageNotFoundError as error:
        raise RgbdDicError(
            f"package {package} is not found: source the workspace's install/setup.bash first"
        ) from error
    if not path.exists():
        raise RgbdDicError(f"{path} is missing: build the workspace again")
    return path


def _end_with_parent() -> None:
    """In the child: SIGINT when the parent is gone, even if it was killed (Linux; elsewhere nothing happens)."""
    if _PRCTL is not None:
        set_parent_death_signal = 1
        _PRCTL(set_parent_death_signal, int(signal.SIGINT))


def _environment() -> dict[str, str]:
    environment = dict(os.environ)
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    environment["PYTHONUNBUFFERED"] = "1"
    return environment
