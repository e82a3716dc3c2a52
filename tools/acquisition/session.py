"""One flight through the real protocols: three peers, the nodes, a recording; each peer fails once and comes back."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from fake_blaze import producer
from flight_peers import AUTOPILOT, CAMERA, EXPOSURE_S, FIRST_NICE, TOF, FlightPeers, give_turn
from gige_peers import ADDRESS
from process_cost import processor_s
from rendered_flight import TOF_RATE_HZ, RenderedFlight
from rgbd_dic_processing.core.settings import ProcessingSettings
from rgbd_dic_processing.graph import (
    ACQUISITION,
    CAMERA_TOPICS,
    RECORDER,
    TOF_TOPICS,
    TYPES,
    GraphFiles,
    NodeSpec,
    all_topics,
    processing_nodes,
)
from rgbd_dic_processing.processes import GraphProcesses
from rgbd_dic_processing.watch import GraphWatch

NODES = {CAMERA: "camera_node", TOF: "tof_node", AUTOPILOT: "mavlink_node"}
TIME_REFERENCE = "sensor_msgs/msg/TimeReference"
OTHER_TYPES = {
    "camera/time_reference": TIME_REFERENCE,
    "tof/time_reference": TIME_REFERENCE,
    "autopilot/time_reference": TIME_REFERENCE,
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
SOCKET_BUFFER_BYTES = 33_554_432  # as docs/payload.md advises; the system gives as much as it is set to
SETTLE_S = 5.0  # in which the clocks are compared
RUN_OUT_S = 1.0  # after the part that counts, so that what is on its way arrives
BAG, FLOWN = "bag", "flown.json"  # in the folder of a session


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


def sensor_nodes(rendered: RenderedFlight, port: int) -> list[NodeSpec]:
    """camera_node, tof_node and mavlink_node on the peers."""
    calibration = {"calibration": str(rendered.calibration.resolve())}
    aravis = {"transport": "gige", "address": ADDRESS, "packet_bytes": 9000, "gain": 0.0, "exposure_s": EXPOSURE_S}
    aravis["stamps"] = "end"  # as this camera sends at once
    aravis["socket_buffer_bytes"] = SOCKET_BUFFER_BYTES
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
    return NodeSpec(ACQUISITION, RECORDER, topics, (), parameters=parameters)


def fly(rendered: RenderedFlight, settings: ProcessingSettings, plan: Plan, folder: Path) -> Flown:
    """The whole session. The folder has the recording and what each peer wrote down."""
    files = GraphFiles(rendered.calibration, rendered.regions)
    with FlightPeers(rendered, folder) as peers, _graph(folder) as (watch, processes):
        sensors, behind = sensor_nodes(rendered, peers.port), processing_nodes(files, settings, ("h_pose",), live=True)
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
