"""One flight through the real protocols: three peers, the nodes, a recording; each peer fails once and comes back."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from autopilot_peers import Peers, free_port
from fake_blaze import FakeBlaze, producer
from gige_peers import ADDRESS, our_camera
from rendered_flight import IMAGE_PERIOD_NS, IMAGE_RATE_HZ, TOF_RATE_HZ, RenderedFlight
from rgbd_dic_processing.core.settings import ProcessingSettings
from rgbd_dic_processing.graph import (
    ACQUISITION,
    CAMERA_TOPICS,
    TOF_TOPICS,
    TYPES,
    GraphFiles,
    NodeSpec,
    all_topics,
    processing_nodes,
)
from rgbd_dic_processing.processes import GraphProcesses
from rgbd_dic_processing.watch import GraphWatch

EXPOSURE_S = 0.002
DELIVERY_S = 0.01  # of an attitude, from when it is measured to when it is sent
ATTITUDE_PERIOD_S = 0.02
CAMERA, TOF, AUTOPILOT = "camera", "ToF camera", "autopilot"
NODES = {CAMERA: "camera_node", TOF: "tof_node", AUTOPILOT: "mavlink_node"}
PERIODS_S = {CAMERA: 1 / IMAGE_RATE_HZ, TOF: 1 / TOF_RATE_HZ, AUTOPILOT: ATTITUDE_PERIOD_S}
TIME_REFERENCE = "sensor_msgs/msg/TimeReference"
OTHER_TYPES = {
    "camera/time_reference": TIME_REFERENCE,
    "tof/time_reference": TIME_REFERENCE,
    "autopilot/time_reference": TIME_REFERENCE,
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
SETTLE_S = 5.0  # in which the clocks are compared
RUN_OUT_S = 1.0  # after the part that counts, so that what is on its way arrives
FIRST_NICE = -10  # of sensors and recorder, as docs/payload.md advises, where that may be set
BAG, FLOWN = "bag", "flown.json"  # in the folder of a session
SENT = {CAMERA: "sent.csv", TOF: "blaze/sent.csv", AUTOPILOT: "attitudes.csv"}
TICKS_A_SECOND = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Plan:
    """How long all is well before each fault and after the last, and how long a peer is gone [s]."""

    well_s: float
    gone_s: float


@dataclass(frozen=True)
class Flown:
    """What was done, in host time [ns], and what it cost.

    Attributes:
        begin_ns, end_ns: of the part that counts.
        faults: peer -> when it failed, and when it was there again.
        cores: node -> processor time over time.
    """

    begin_ns: int
    end_ns: int
    faults: dict[str, tuple[int, int]]
    cores: dict[str, float]

    def save(self, folder: Path) -> None:
        (folder / FLOWN).write_text(json.dumps(dataclasses.asdict(self), indent=1))

    @classmethod
    def load(cls, folder: Path) -> Flown:
        return cls(**json.loads((folder / FLOWN).read_text()))


def sent(folder: Path, peer: str) -> np.ndarray:
    """(N, k): of each frame of a camera number, host and device time, index; of each attitude host time, w to z."""
    return np.loadtxt(folder / SENT[peer], np.int64 if peer != AUTOPILOT else float, delimiter=",", ndmin=2)


class FlightPeers:
    """Camera, ToF camera and autopilot of one flight; what they sent is in files of the folder."""

    def __init__(self, rendered: RenderedFlight, folder: Path) -> None:
        self._rendered, self._folder = rendered, folder
        self.port = free_port()
        self._closing = contextlib.ExitStack()
        self.camera = self._closing.enter_context(
            our_camera(rendered.images, folder, "--latch", rate_hz=1e9 / IMAGE_PERIOD_NS)
        )
        tof = rendered.settings.tof
        (folder / "blaze").mkdir()
        size = (tof.width_px, tof.height_px)
        played = {"played": rendered.depth, "played_ns": rendered.played_ns}
        self.blaze = FakeBlaze(folder / "blaze", size=size, **played)
        os.environ.update(self.blaze.environment)
        self._autopilots = Peers(folder)
        self._closing.callback(self._autopilots.end)
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

    def _fly(self, **options: float):
        played = {"played": self._rendered.attitude, "played_ns": self._rendered.played_ns}
        log = self._folder / SENT[AUTOPILOT]
        return self._autopilots.mavsdk(
            f"udpout://{ADDRESS}:{self.port}",
            delay_s=DELIVERY_S,
            rate_hz=1 / ATTITUDE_PERIOD_S,
            log=log,
            **played,
            **options,
        )

    def __enter__(self) -> FlightPeers:
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.close()


def sensor_nodes(rendered: RenderedFlight, port: int) -> list[NodeSpec]:
    """camera_node, tof_node and mavlink_node on the peers."""
    calibration = {"calibration": str(rendered.calibration.resolve())}
    aravis = {"transport": "gige", "address": ADDRESS, "packet_bytes": 9000, "gain": 0.0, "exposure_s": EXPOSURE_S}
    aravis["stamps"] = "end"  # as this camera sends at once
    tof = {"producer": str(producer()), "frame_rate_hz": TOF_RATE_HZ}
    return [
        _sensor("camera_node", CAMERA_TOPICS, "camera/time_reference", source="aravis", **calibration, aravis=aravis),
        _sensor("tof_node", TOF_TOPICS, "tof/time_reference", source="gentl", **calibration, tof=tof),
        _sensor("mavlink_node", ("imu/data",), "autopilot/time_reference", link={"url": f"udpin://{ADDRESS}:{port}"}),
    ]


def _sensor(name: str, topics: tuple[str, ...], reference: str, **parameters: object) -> NodeSpec:
    flat: dict[str, object] = {}
    for key, value in parameters.items():
        flat |= {f"{key}.{inner}": each for inner, each in value.items()} if isinstance(value, dict) else {key: value}
    return NodeSpec(ACQUISITION, name, (), (*topics, reference), parameters=flat)


def recorder(output: Path, nodes: list[NodeSpec]) -> NodeSpec:
    """A recorder of all that the nodes give, and of what they say of themselves."""
    topics = all_topics(nodes)
    types = {**TYPES, **OTHER_TYPES}
    entries = [
        f"{topic} {types[topic]}{' latched' if topic == 'reference' else ''}" for topic in (*topics, "/diagnostics")
    ]
    parameters = {"output": str(output.resolve()), "topics": entries}
    return NodeSpec(ACQUISITION, "recorder_node", topics, (), parameters=parameters)


def fly(rendered: RenderedFlight, settings: ProcessingSettings, plan: Plan, folder: Path) -> Flown:
    """The whole session. The folder has the recording and what each peer wrote down."""
    files = GraphFiles(rendered.calibration, rendered.regions)
    with FlightPeers(rendered, folder) as peers, _graph(folder) as (watch, processes):
        sensors, behind = sensor_nodes(rendered, peers.port), processing_nodes(files, settings, ("h_pose",))
        behind.insert(0, recorder(folder / BAG, [*sensors, *behind]))
        watch.refuse_second_graph([*sensors, *behind])
        watch.subscribe()
        running = {}
        for nodes in (behind, sensors):  # images come only when all are there to take them
            for node in nodes:
                running[node.node_name] = processes.start(node)
                if node.package == ACQUISITION:
                    give_turn(running[node.node_name].pid, FIRST_NICE)
            watch.wait_until_connected(nodes, processes.check)
        for node in behind:
            if node.package != ACQUISITION:
                give_turn(running[node.node_name].pid, 0)  # whatever this program was started with
        while not watch.openings:
            processes.check()
            watch.spin(0.1)
        watch.spin(SETTLE_S)
        begin_ns, used_s = time.time_ns(), {name: processor_s(process.pid) for name, process in running.items()}
        faults = _carry_out(plan, peers, lambda: (processes.check(), watch.spin(0.05)))
        end_ns = time.time_ns()
        took_s = (end_ns - begin_ns) * 1e-9
        cores = {name: (processor_s(process.pid) - used_s[name]) / took_s for name, process in running.items()}
        watch.spin(RUN_OUT_S)
        processes.check()
        processes.end()
    flown = Flown(begin_ns, end_ns, faults, cores)
    flown.save(folder)
    return flown


def _carry_out(plan: Plan, peers: FlightPeers, go_on: Callable[[], object]) -> dict[str, tuple[int, int]]:
    """Have the peers fail and come back in their turn; when they did, [ns]."""

    def wait(seconds: float) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            go_on()

    done = {}
    for peer in NODES:
        wait(plan.well_s)
        ill_ns = time.time_ns()
        peers.fail(peer)
        print(f"the {peer} is gone", flush=True)
        wait(plan.gone_s)
        peers.come_back(peer)
        done[peer] = (ill_ns, time.time_ns())
        print(f"the {peer} is there again", flush=True)
    wait(plan.well_s)
    return done


@contextlib.contextmanager
def _graph(folder: Path) -> Iterator[tuple[GraphWatch, GraphProcesses]]:
    processes = GraphProcesses(folder / "logs", False, "")
    with GraphWatch({"h_pose": "crack_opening"}, "", lambda _: None) as watch, processes:
        yield watch, processes


def give_turn(process: int, nice: int) -> None:
    """To all its threads: a camera has a processor of its own, and a driver goes before the processing."""
    for thread in Path(f"/proc/{process}/task").iterdir():
        with contextlib.suppress(OSError):  # it has ended, or the right is missing
            os.setpriority(os.PRIO_PROCESS, int(thread.name), nice)


def processor_s(process: int) -> float:
    """User and system time of a process [s]."""
    fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_A_SECOND
