"""What the nodes say about themselves: each is made once, not run, and asked for its topics and parameters."""

from __future__ import annotations

import importlib
import os
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
from blocks import table
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from settings_tables import FLIGHT, NODES, OF_PROCESSING, PATHS, STAGES, parameter_names

SAMPLE = Path(__file__).parents[2] / "bags" / "sample"
NAMESPACE = "/docs"
FILES = {"regions_file": SAMPLE / "regions.yaml", "calibration_file": SAMPLE / "calibration.yaml"}
CLOUDS = {"use_points": "true"}
ACQUISITION = ("camera_node", "tof_node", "mavlink_node", "recorder_node", "player_node")
PROCESSING = (
    *("pairing_node", "plane_node", "dic_node", "compensation_node", "crack_opening_node", "operator_node"),
    *("viewer_node", "foxglove_node"),
)
COMMON_TOPICS = {"/diagnostics", "/rosout", "/parameter_events"}
COMMON_PARAMETERS = {"use_sim_time", "start_type_description_service"}
SERVICES = {
    "~/set_reference": "takes the next good image as the new reference, from which displacements count anew",
    "~/renew_keyframe": "follows the subsets from the next good image on; displacements count from where they did",
    "~/set_regions": "measures by other regions from now on; the image that they are drawn on becomes the reference",
    "~/history": "all openings since the node began, for a viewer that comes late",
    "~/record": "stops writing, or starts again; latched topics are written in any case",
}
OPTIONAL = {"tof_node": {"/tf_static": ("tf2_msgs/TFMessage", "reliable, latched")}}  # needs tf2_msgs, not always there
SHOWN = {  # of nodes that have no subscription while nobody looks
    "operator_node": {
        "crack_opening": ("rgbd_dic_msgs/CrackOpening", "best effort, keep 300"),
        "/diagnostics": ("diagnostic_msgs/DiagnosticArray", "reliable, keep 100"),
        "reference": ("rgbd_dic_msgs/Reference", "reliable, latched"),
        "camera/camera_info": ("sensor_msgs/CameraInfo", "best effort, keep 1"),
        "_preview": ("rgbd_dic_msgs/Preview", "best effort, keep 1"),
        "camera/image_raw": ("sensor_msgs/Image", "best effort, keep 1"),
        "plane": ("rgbd_dic_msgs/PlaneStamped", "best effort, keep 1"),
    },
    "viewer_node": {
        "_preview": ("rgbd_dic_msgs/Preview", "best effort, keep 1"),
        "reference": ("rgbd_dic_msgs/Reference", "reliable, latched"),
        "_previewed_field": ("rgbd_dic_msgs/DisplacementField", "best effort, keep 1"),
        "crack_opening": ("rgbd_dic_msgs/CrackOpening", "best effort, keep 300"),
        "plane": ("rgbd_dic_msgs/PlaneStamped", "best effort, keep 20"),
        "tof/depth/image_raw": ("sensor_msgs/Image", "best effort, keep 1"),
        "tof/points": ("sensor_msgs/PointCloud2", "best effort, keep 1"),
    },
    "foxglove_node": {
        "every topic of its namespace, `/diagnostics`, `/rosout`, `/tf`, `/tf_static`": ("any", "as offered, keep 10")
    },
}
SELDOM = {
    "tof/points": "with `use_points`, in place of `tof/depth/...`",
    "/tf_static": "where tf2_msgs is installed",
}


@dataclass(frozen=True)
class Facts:
    """One node. Topics: name -> type and quality of service; parameters: name -> description."""

    about: str
    takes: dict[str, tuple[str, str]]
    gives: dict[str, tuple[str, str]]
    services: dict[str, str]
    parameters: dict[str, str]


def section(package: str, executables: tuple[str, ...]) -> str:
    """The nodes of a package: what each is, its topics, its services, its parameters."""
    texts = []
    for executable in executables:
        facts = _facts(package, executable)
        parts = [f"### {executable}", facts.about, _topics(executable, facts)]
        parts += [f"Service `{name}` ({kind}), {SERVICES[name]}." for name, kind in facts.services.items()]
        texts.append("\n\n".join([*parts, _parameters(executable, facts)]))
    return "\n\n".join(texts)


def undocumented_parameters() -> set[str]:
    """Parameters of the processing nodes that config/processing.yaml would lack."""
    known = parameter_names({**STAGES, **{name: NODES[name] for name in OF_PROCESSING}}) | set(PATHS)
    return {name for executable in PROCESSING for name in _facts("rgbd_dic_processing", executable).parameters} - known


def _facts(package: str, executable: str) -> Facts:
    module = importlib.import_module(f"{package}.nodes.{executable}")
    kind = next(
        value
        for value in vars(module).values()
        if isinstance(value, type) and issubclass(value, Node) and value.__module__ == module.__name__
    )
    with tempfile.TemporaryDirectory() as folder:
        files = {**FILES, "bag": SAMPLE, "output": Path(folder) / "bag"}
        variants = [files, {**files, **CLOUDS}] if executable in ("pairing_node", "plane_node") else [files]
        asked = [_ask(kind, {name: str(value) for name, value in variant.items()}) for variant in variants[::-1]]
    takes = {name: entry for facts in reversed(asked) for name, entry in facts["takes"].items()}
    about = module.__doc__.strip().split("\n")[0].removeprefix(f"{executable}: ")
    return Facts(about[0].upper() + about[1:], **{**asked[-1], "takes": takes})


def _ask(kind: type[Node], parameters: dict[str, str]) -> dict[str, Any]:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"
    remap = ["-r", f"__ns:={NAMESPACE}"]
    given = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    rclpy.init(args=["--ros-args", "--log-level", "error", *remap, *given])
    try:
        node = kind()
        try:
            names = sorted(name for name in node.get_parameters_by_prefix("") if name not in COMMON_PARAMETERS)
            return {
                "takes": _described(node, Node.subscriptions.fget(node)),  # a node may hide some from the executor
                "gives": _described(node, node.publishers),
                "services": {
                    service.srv_name: _type(service.srv_type)
                    for service in node.services
                    if service.srv_name in SERVICES
                },
                "parameters": {name: node.describe_parameter(name).description for name in names},
            }
        finally:
            if hasattr(node, "close"):
                node.close()
            node.destroy_node()
    finally:
        rclpy.try_shutdown()


def _described(node: Node, ends: Any) -> dict[str, tuple[str, str]]:
    """Name -> type and quality of service of publishers or subscriptions."""
    found = {}
    for end in ends:
        name = end.topic_name.removeprefix(f"{NAMESPACE}/")
        if name not in COMMON_TOPICS:
            qos = end.qos_profile
            latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
            reliable = "reliable" if qos.reliability == ReliabilityPolicy.RELIABLE else "best effort"
            found[name] = (_type(end.msg_type), f"{reliable}, {'latched' if latched else f'keep {qos.depth}'}")
    return found


def _type(kind: Any) -> str:
    package, _, *_ = kind.__module__.split(".")
    return f"{package}/{kind.__name__}"


def _topics(executable: str, facts: Facts) -> str:
    takes, gives = dict(facts.takes), {**facts.gives, **OPTIONAL.get(executable, {})}
    if executable == "player_node":
        gives = {"every topic of the bag": ("as recorded", "reliable, keep `queue_depth`; latched if it was")}
        gives |= {name: entry for name, entry in facts.gives.items() if name == "/clock"}
        takes = {"`acknowledge_topics`": ("as they say", "reliable, keep `queue_depth`")}
    if executable in SHOWN:
        takes = {
            f"{name if ' ' in name else f'`{name}`'}{_when(name)} while somebody looks": entry
            for name, entry in SHOWN[executable].items()
        }
    if executable == "recorder_node":
        takes = {"`topics`, or all of its namespace and `/tf_static`": ("any", "as offered, keep `queue_depth`")}
    rows = []
    for direction, topics in (("takes", takes), ("gives", gives)):
        for name, (kind, qos) in topics.items():
            shown = name if "`" in name or " " in name else f"`{name}`"
            rows.append((direction, f"{shown} ({SELDOM[name]})" if name in SELDOM else shown, _linked(kind), qos))
    return table(("", "Topic", "Type", "Quality of service"), rows)


def _when(topic: str) -> str:
    return f" ({SELDOM[topic]})" if topic in SELDOM else ""


def _linked(kind: str) -> str:
    package, _, name = kind.partition("/")
    return f"[{kind}](../src/rgbd_dic_msgs/msg/{name}.msg)" if package == "rgbd_dic_msgs" else kind


def _parameters(executable: str, facts: Facts) -> str:
    own = parameter_names({executable: NODES[executable]}) if executable in NODES else set()
    own = {name.removeprefix(f"{executable}.") for name in own}
    rest = [name for name in facts.parameters if name not in own and "." not in name]
    prefixes = dict.fromkeys(name.split(".")[0] for name in facts.parameters if "." in name)
    unknown = set(prefixes) - {*STAGES, *NODES, *FLIGHT}
    if unknown:
        sys.exit(f"{executable} has parameters of {', '.join(unknown)}, which tools/docs/settings_tables.py lacks")
    links = [f"[`{name}`](parameters.md#{name})" for name in ([executable] if own else [])]
    links += [f"[`{name}.*`](parameters.md#{name})" for name in prefixes]
    links += [f"`{name}` ({facts.parameters[name] or PATHS[name][1]})" for name in rest]
    return f"Parameters: {', '.join(links)}."
