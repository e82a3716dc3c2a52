"""The node graph, described once: `rgbd-dic up` starts it from here, and so do the launch files.

All names are relative, so that a namespace can be pushed on them.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .core.settings import ProcessingSettings
from .view_topics import PREVIEWED_FIELD, VIEW_TYPES

ACQUISITION, PROCESSING = "rgbd_dic_acquisition", "rgbd_dic_processing"

TYPES = {
    "camera/image_raw": "sensor_msgs/msg/Image",
    "camera/camera_info": "sensor_msgs/msg/CameraInfo",
    "tof/depth/image_raw": "sensor_msgs/msg/Image",
    "tof/depth/camera_info": "sensor_msgs/msg/CameraInfo",
    "tof/intensity/image_raw": "sensor_msgs/msg/Image",
    "tof/confidence/image_raw": "sensor_msgs/msg/Image",
    "tof/points": "sensor_msgs/msg/PointCloud2",
    "imu/data": "sensor_msgs/msg/Imu",
    "camera/time_reference": "sensor_msgs/msg/TimeReference",
    "tof/time_reference": "sensor_msgs/msg/TimeReference",
    "autopilot/time_reference": "sensor_msgs/msg/TimeReference",
    "frame_pair": "rgbd_dic_msgs/msg/FramePair",
    "plane": "rgbd_dic_msgs/msg/PlaneStamped",
    "reference": "rgbd_dic_msgs/msg/Reference",
    "subset_field": "rgbd_dic_msgs/msg/SubsetField",
    "displacement_field": "rgbd_dic_msgs/msg/DisplacementField",
    "crack_opening": "rgbd_dic_msgs/msg/CrackOpening",
    "event": "rgbd_dic_msgs/msg/Event",
    **VIEW_TYPES,
}
LATCHED = {"reference"}
CAMERA_TOPICS = ("camera/image_raw", "camera/camera_info")
TOF_TOPICS = (
    "tof/depth/image_raw",
    "tof/depth/camera_info",
    "tof/intensity/image_raw",
    "tof/confidence/image_raw",
)

LIVE_WAITING = 3  # frames that a busy node may have to catch up with before it leaves some out
# What works on every image, and may share a process; there they run one after another. A plane takes longer, and comes
# beside them.
COMPOSABLE = ("dic_node", "pairing_node", "compensation_node", "crack_opening_node")
ALL, AFTER_DIC = "all", "after_dic"
SHARING = {ALL: COMPOSABLE, AFTER_DIC: COMPOSABLE[1:]}  # by what `composed` says; the DIC takes half of the time
COMPOSED = "composed_nodes"
RECORDER = "recorder_node"
SENSOR_TOPICS = (*CAMERA_TOPICS, *TOF_TOPICS, "tof/points", "imu/data")


@dataclass(frozen=True)
class NodeSpec:
    """One node: what it is started from, and the topics it takes and gives (names after remapping).

    follows_clock: whether it runs by /clock when a bag is played; the player, which gives that clock, does not.
    """

    package: str
    executable: str
    takes: tuple[str, ...]
    gives: tuple[str, ...]
    name: str = ""
    parameters: dict[str, Any] = field(default_factory=dict)
    remappings: dict[str, str] = field(default_factory=dict)
    follows_clock: bool = True

    @property
    def node_name(self) -> str:
        return self.name or self.executable


@dataclass(frozen=True)
class GraphFiles:
    """The files that the processing nodes are given."""

    calibration: Path
    regions: Path


def processing_nodes(
    files: GraphFiles,
    settings: ProcessingSettings,
    methods: tuple[str, ...],
    use_points: bool = False,
    live: bool = False,
) -> list[NodeSpec]:
    """DIC, pairing, planes, and a compensation and a crack_opening node for each method.

    With `use_points` the ToF frames come as `tof/points`, else as `tof/depth/image_raw`. With `live`, nodes that are
    too slow leave frames out, so that latency does not grow; else all frames are measured.

    The first method publishes `displacement_field` and `crack_opening`; every other one under its own name, such as
    `h_3d/crack_opening`.
    """
    calibration = {"calibration_file": str(files.calibration.resolve())}
    regions = {"regions_file": str(files.regions.resolve())}
    stages = settings.as_dict()
    keep_up = {"keep_up.max_waiting": LIVE_WAITING if live else 0}

    def stage(*names: str) -> dict[str, Any]:
        return {f"{name}.{key}": value for name in names for key, value in stages[name].items()}

    nodes = [
        NodeSpec(
            PROCESSING,
            "dic_node",
            ("camera/image_raw",),  # and one camera/camera_info, for which nobody need wait
            ("reference", "subset_field"),
            parameters={**calibration, **regions, **keep_up, **stage("correlation", "search", "renewal")},
        ),
        NodeSpec(
            PROCESSING,
            "pairing_node",
            ("camera/camera_info", "tof/points" if use_points else "tof/depth/camera_info", "imu/data"),
            ("frame_pair",),
            parameters={"use_points": use_points, **stage("pairing")},
        ),
        NodeSpec(
            PROCESSING,
            "plane_node",
            ("tof/points" if use_points else "tof/depth/image_raw", "subset_field", "reference"),
            ("plane",),
            parameters={
                "use_points": use_points,
                **calibration,
                **regions,
                **keep_up,
                **stage("pairing", "plane"),
            },
        ),
    ]
    for index, method in enumerate(methods):
        suffix = f"_{method}" if index else ""
        named = ("displacement_field", "crack_opening", PREVIEWED_FIELD)
        moved = {topic: f"{method}/{topic}" for topic in named} if index else {}
        displacement, opening = (moved.get(t, t) for t in ("displacement_field", "crack_opening"))
        nodes += [
            NodeSpec(
                PROCESSING,
                "compensation_node",
                ("reference", "subset_field", "plane", "frame_pair"),
                (displacement,),
                f"compensation_node{suffix}",
                {**calibration, **regions, **keep_up, **stage("compensation"), "compensation.method": method},
                moved,
            ),
            NodeSpec(
                PROCESSING,
                "crack_opening_node",
                (displacement, "reference"),
                (opening,),
                f"crack_opening_node{suffix}",
                {**calibration, **regions, **keep_up, **stage("crack")},
                moved,
            ),
        ]
    return nodes


def operator_page(host: str, port: int, files: GraphFiles, settings: ProcessingSettings, regions_out: Path) -> NodeSpec:
    """The live page; what it takes, it takes only while somebody looks, so nobody need wait for it."""
    stages = settings.as_dict()
    used = {
        f"{name}.{key}": value
        for name in ("correlation", "plane", "compensation", "crack")
        for key, value in stages[name].items()
    }
    return NodeSpec(
        PROCESSING,
        "operator_node",
        (),
        ("event",),
        parameters={
            "operator.host": host,
            "operator.port": port,
            "calibration_file": str(files.calibration.resolve()),
            "regions_out": str(regions_out.resolve()),
            **used,
        },
    )


def viewer(files: GraphFiles, use_points: bool = False) -> NodeSpec:
    """What Foxglove and rviz show; what it takes, it takes only while somebody looks."""
    calibration = {"calibration_file": str(files.calibration.resolve())}
    return NodeSpec(
        PROCESSING, "viewer_node", (), tuple(VIEW_TYPES), parameters={"use_points": use_points, **calibration}
    )


def foxglove_server(port: int) -> NodeSpec:
    """The websocket for Foxglove, on this computer alone."""
    return NodeSpec(PROCESSING, "foxglove_node", (), (), parameters={"foxglove.port": port})


def opening_topic(method: str, methods: tuple[str, ...]) -> str:
    """Where the openings of a method are published."""
    return "crack_opening" if method == methods[0] else f"{method}/crack_opening"


def simulated_sensors() -> list[NodeSpec]:
    """Camera and ToF sensor on the simulated flight."""
    return [
        NodeSpec(ACQUISITION, "camera_node", (), CAMERA_TOPICS, parameters={"source": "simulated"}),
        NodeSpec(ACQUISITION, "tof_node", (), TOF_TOPICS, parameters={"source": "simulated"}),
    ]


def recorder(output: Path, topics: tuple[str, ...]) -> NodeSpec:
    """A recorder of these topics."""
    entries = [f"{topic} {topic_type(topic)}{' latched' if topic in LATCHED else ''}" for topic in topics]
    return NodeSpec(
        ACQUISITION,
        RECORDER,
        topics,
        (),
        parameters={"output": str(output.resolve()), "topics": entries},
    )


def player(
    bag: Path,
    topics: tuple[str, ...],
    nodes: list[NodeSpec],
    answers: tuple[str, ...],
    rate: float,
    window: int,
) -> NodeSpec:
    """A player of these topics of a bag that waits until the nodes are connected.

    Args:
        answers: topics that answer each image; the player keeps at most `window` images unanswered. Empty: it plays
            by the clock alone.
        rate: speed; 0 is as fast as the answers come.
    """
    expected = takers(nodes)
    return NodeSpec(
        ACQUISITION,
        "player_node",
        answers,
        topics,
        parameters={
            "bag": str(bag.resolve()),
            "topics": list(topics),
            "rate": float(rate),
            "window": window,
            "acknowledge_topics": [f"{topic} {topic_type(topic)}" for topic in answers],
            "wait_for_matched": [
                " ".join((topic, str(len(expected[topic])), *expected[topic])) for topic in topics if expected[topic]
            ],
        },
        follows_clock=False,
    )


def takers(nodes: list[NodeSpec]) -> defaultdict[str, list[str]]:
    """The names of the nodes that take each topic, beside those that take it only while somebody looks."""
    found = defaultdict(list)
    for node in nodes:
        for topic in node.takes:
            found[topic].append(node.node_name)
    return found


def topic_type(topic: str) -> str:
    """Type of a topic, with or without a method's name before it."""
    return TYPES[topic] if topic in TYPES else TYPES[topic.rsplit("/", 1)[-1]]


def all_topics(nodes: list[NodeSpec]) -> tuple[str, ...]:
    """Every topic that the nodes take or give, in the order of the description."""
    return tuple(dict.fromkeys(topic for node in nodes for topic in (*node.takes, *node.gives)))
