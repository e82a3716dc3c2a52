"""One case: the graph as `rgbd-dic up` starts it, before the flight that is played, and what became of each image."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections import Counter
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from ament_index_python.packages import get_package_share_directory
from diagnostic_msgs.msg import DiagnosticArray
from flight import RATE_HZ, Flight, step_for, true_opening_m
from numpy.typing import NDArray
from processes import Costs
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_processing.core.crack import CrackOpening
from rgbd_dic_processing.core.settings import ProcessingSettings, load_settings
from rgbd_dic_processing.graph import CAMERA_TOPICS, GraphFiles, NodeSpec, all_topics, processing_nodes, recorder
from rgbd_dic_processing.processes import GraphProcesses
from rgbd_dic_processing.watch import GraphWatch

HERE = Path(__file__).parent
SENSORS = (*CAMERA_TOPICS, "tof/depth/image_raw", "tof/depth/camera_info", "imu/data")
WARM_UP_S = 3.0  # not counted: the reference is made, its first plane comes
SETTLE_S = 2.0  # after the last image


@dataclass(frozen=True)
class Case:
    """composed: as of `rgbd-dic up`. settings: `live`, `default`, or a path. threads: of the DIC; 0 for all cores."""

    subsets: int
    recording: bool
    duration_s: float
    composed: str = ""
    settings: str = "live"
    threads: int = 0


class Ear(GraphWatch):
    """Hears the openings, with the moment at which each came, and the counters of the nodes."""

    def __init__(self) -> None:
        self.heard: dict[int, tuple[int, CrackOpening]] = {}
        self.counters: dict[str, dict[str, int]] = {}
        super().__init__({"h_pose": "crack_opening"}, "", self._hear)

    def _hear(self, opening: CrackOpening) -> None:
        self.heard[opening.stamp_ns] = time.time_ns(), opening

    def _diagnostics(self, message: DiagnosticArray) -> None:
        super()._diagnostics(message)
        for status in message.status:
            if ": " not in status.name:
                values = {pair.key: int(pair.value) for pair in status.values if pair.value.isdigit()}
                self.counters[status.name.lstrip("/")] = values


def settings_of(case: Case) -> ProcessingSettings:
    """The settings of a case, with the distance between subsets that makes as many as it asks for."""
    live = Path(get_package_share_directory("rgbd_dic_processing"), "config", "live.yaml")
    path = {"live": live, "default": None}.get(case.settings, case.settings)
    settings = load_settings(path)
    correlation = replace(settings.correlation, step=step_for(case.subsets), threads=case.threads)
    return replace(settings, correlation=correlation)


def measure(case: Case, played: Flight, folder: Path) -> dict[str, Any]:
    """Run a case in a folder that does not exist yet; returns its results, as JSON has them. The bag is not kept."""
    folder.mkdir(parents=True)
    settings, files = settings_of(case), GraphFiles(played.calibration, played.regions)
    truth_m = true_opening_m(played, settings.correlation)
    nodes = processing_nodes(files, settings, ("h_pose",), live=True)
    if case.recording:
        nodes.append(recorder(folder / "bag", tuple(dict.fromkeys((*SENSORS, *all_topics(nodes))))))
    with Ear() as ear, GraphProcesses(folder / "logs", use_sim_time=False) as processes:
        ear.refuse_second_graph(nodes)
        ear.subscribe()
        processes.start_all(nodes, case.composed)
        ear.wait_until_connected(nodes, processes.check)
        source = _source(case, played, nodes, folder)
        try:
            while not ear.heard:
                processes.check()
                ear.spin(0.1)
            ear.spin(WARM_UP_S)
            costs = Costs({**processes.pids, "source": source.pid, "listener": os.getpid()})
            costs.start()
            ear.spin(case.duration_s)
            cost = costs.stop()
            while not (folder / "sent.json").exists():
                processes.check()
                ear.spin(0.1)
            ear.spin(SETTLE_S)
        finally:
            source.terminate()
            source.wait()
    results = {"case": asdict(case), "costs": cost, "counters": ear.counters} | _openings(ear, truth_m, folder)
    if case.recording:
        results["recorded"] = _recorded(folder / "bag")
        results["recording_ended"] = ended_early(folder)
        for path in (folder / "bag").glob("*"):
            path.unlink()
    (folder / "results.json").write_text(json.dumps(results, indent=1))
    return results


def _source(case: Case, played: Flight, nodes: list[NodeSpec], folder: Path) -> subprocess.Popen:
    heard_by = sum("camera/image_raw" in node.takes for node in nodes)
    arguments = {
        "flight": played.folder,
        "duration": case.duration_s + WARM_UP_S + 1,
        "connected": heard_by,
        "log": folder / "sent.json",
    }
    command = [sys.executable, str(HERE / "source.py")]
    command += [word for name, value in arguments.items() for word in (f"--{name}", str(value))]
    environment = {name: value for name, value in os.environ.items() if name != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    with (folder / "logs" / "source.log").open("wb") as log:
        return subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, env=environment)


def _openings(ear: Ear, truth_m: NDArray[np.float64], folder: Path) -> dict[str, Any]:
    """What became of the images after the warm-up."""
    sent = json.loads((folder / "sent.json").read_text())["sent"]
    begin_ns = sent[0][0] + round(WARM_UP_S * 1e9)
    counted = [(stamp_ns, index) for stamp_ns, index in sent if stamp_ns >= begin_ns]
    answered = [(stamp_ns, index, *ear.heard[stamp_ns]) for stamp_ns, index in counted if stamp_ns in ear.heard]
    valid = [(index, opening) for _, index, _, opening in answered if opening.valid]
    index_of = dict(sent)
    errors = [
        opening.opening_m - (truth_m[index] - truth_m[index_of[opening.reference_stamp_ns]]) for index, opening in valid
    ]
    latency_ms = np.array([(heard_ns - stamp_ns) * 1e-6 for stamp_ns, _, heard_ns, _ in answered] or [np.nan])
    missing = np.array([stamp_ns not in ear.heard for stamp_ns, _ in counted])
    return {
        "published": len(sent),
        "sent": len(counted),
        "answered": len(answered),
        "invalid": Counter(opening.reason for *_, opening in answered if not opening.valid),
        "subsets": next((opening.n_left + opening.n_right for _, opening in valid), 0),
        "rate_hz": len(answered) / (len(counted) / RATE_HZ),
        "longest_gap": _longest_run(missing),
        "latency_ms": {str(q): float(np.percentile(latency_ms, q)) for q in (1, 50, 90, 99, 100)},
        "latency_halves_ms": [float(np.median(half)) for half in np.array_split(latency_ms, 2)],
        "rms_mm": float(np.sqrt(np.mean(np.square(errors))) * 1e3) if errors else float("nan"),
        "stated_mm": float(np.median([opening.u_opening_m for _, opening in valid]) * 1e3) if valid else float("nan"),
    }


def _longest_run(flags: np.ndarray) -> int:
    """How many in a row are true at most."""
    longest = run = 0
    for flag in flags:
        run = run + 1 if flag else 0
        longest = max(longest, run)
    return longest


def ended_early(folder: Path) -> bool:
    """Whether the recorder ended its bag because the disk was full."""
    return "was ended, as its disk is full" in (folder / "logs" / "recorder_node.log").read_text()


def _recorded(bag: Path) -> dict[str, int]:
    with BagReader(bag) as reader:
        return {name.lstrip("/"): topic.count for name, topic in reader.topics.items()}
