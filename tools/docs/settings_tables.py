"""What the dataclasses of settings say about themselves: tables for docs/parameters.md, and config/processing.yaml."""

from __future__ import annotations

import dataclasses
from typing import Any

import yaml
from blocks import table
from rgbd_dic_acquisition.drivers.aravis_connection import AravisSettings
from rgbd_dic_acquisition.drivers.mavlink import MavlinkSettings
from rgbd_dic_acquisition.drivers.tof_settings import TofSettings
from rgbd_dic_acquisition.nodes.camera_node import CameraNodeSettings
from rgbd_dic_acquisition.nodes.mavlink_node import MavlinkNodeSettings
from rgbd_dic_acquisition.nodes.player_node import PlayerSettings
from rgbd_dic_acquisition.nodes.recorder_node import RecorderSettings
from rgbd_dic_acquisition.nodes.tof_node import TofNodeSettings
from rgbd_dic_acquisition.settings import Settings
from rgbd_dic_acquisition.simulator.flight import FlightSettings
from rgbd_dic_acquisition.simulator.laboratory import LaboratorySettings
from rgbd_dic_processing.core.settings import ProcessingSettings
from rgbd_dic_processing.nodes.foxglove_node import FoxgloveSettings
from rgbd_dic_processing.nodes.inputs import SensorQosSettings
from rgbd_dic_processing.nodes.keeping_up import KeepUpSettings
from rgbd_dic_processing.nodes.preview import PreviewSettings
from rgbd_dic_processing.nodes.view_messages import ViewerSettings
from rgbd_dic_processing.pages.settings import OperatorSettings

STAGES: dict[str, type[Settings]] = {
    field.name: field.default_factory for field in dataclasses.fields(ProcessingSettings)
}
OFFLINE = ("panel_finding",)  # stages before the graph; no node has their parameters
# Groups of parameters of the nodes: the part of the name before the dot, or the node's own.
NODES: dict[str, type[Settings]] = {
    "sensor_qos": SensorQosSettings,
    "keep_up": KeepUpSettings,
    "camera_node": CameraNodeSettings,
    "aravis": AravisSettings,
    "tof_node": TofNodeSettings,
    "tof": TofSettings,
    "mavlink_node": MavlinkNodeSettings,
    "link": MavlinkSettings,
    "preview": PreviewSettings,
    "operator": OperatorSettings,
    "viewer": ViewerSettings,
    "foxglove": FoxgloveSettings,
    "recorder_node": RecorderSettings,
    "player_node": PlayerSettings,
}
OF_PROCESSING = ("sensor_qos", "keep_up", "preview", "operator", "viewer", "foxglove")  # of these, of processing nodes
FLIGHT: dict[str, type[Settings]] = {"flight": FlightSettings} | {
    f"flight.{field.name}": type(field.default)
    for field in dataclasses.fields(FlightSettings)
    if isinstance(field.default, Settings)
}
# Here the values count, as a group may have other defaults in the laboratory than by itself.
LABORATORY: dict[str, Settings] = {"laboratory": LaboratorySettings()} | {
    field.name: field.default for field in dataclasses.fields(LaboratorySettings) if isinstance(field.default, Settings)
}
# Parameters of the processing nodes that are no settings of a stage: name -> default and what it is.
PATHS = {
    "regions_file": ("", "path of regions.yaml; needed by all but pairing_node"),
    "calibration_file": ("", "path of calibration.yaml; needed by plane_node, the others then take camera/camera_info"),
    "regions_out": ("", "path that the page of operator_node saves regions to; regions.yaml where it runs, if empty"),
    "use_points": (False, "whether pairing_node and plane_node take tof/points in place of tof/depth/..."),
}


def sections(groups: dict[str, type[Settings]] | dict[str, Settings]) -> str:
    """For each group a heading, its sentence and its table."""
    return "\n\n".join(f"### {name}\n\n{kind.__doc__.strip()}\n\n{_table(kind)}" for name, kind in groups.items())


def processing_yaml() -> str:
    """All parameters of the processing nodes with their defaults."""
    groups = {name: kind for name, kind in STAGES.items() if name not in OFFLINE}
    groups |= {name: NODES[name] for name in OF_PROCESSING}
    lines = [
        "# All parameters of the processing nodes, with their defaults (docs/parameters.md). Written by `make docs`.",
        "# `/**` makes them hold for every node in any namespace; a node takes those that it knows.",
        "/**:",
        "  ros__parameters:",
    ]
    for name, (default, doc) in PATHS.items():
        lines.append(_with_comment(f"    {name}: {_scalar(default)}", doc))
    for name, kind in groups.items():
        lines += ["", _with_comment(f"    {name}:", _sentence(kind.__doc__))]
        for field in dataclasses.fields(kind):
            unit = field.metadata["unit"]
            doc = _sentence(field.metadata["doc"])
            lines.append(
                _with_comment(f"      {field.name}: {_scalar(field.default)}", f"[{unit}] {doc}" if unit else doc)
            )
    return "\n".join(lines) + "\n"


def parameter_names(groups: dict[str, type[Settings]]) -> set[str]:
    """ROS parameters of groups of settings, without those that are groups themselves."""
    return {
        f"{name}.{field.name}"
        for name, kind in groups.items()
        for field in dataclasses.fields(kind)
        if not isinstance(field.default, Settings)
    }


def _table(kind: type[Settings] | Settings) -> str:
    return table(
        ("Parameter", "Default", "Unit", "Range", "Meaning"),
        [
            (f"`{field.name}`", _default(_value(kind, field)), field.metadata["unit"], _range(field), _meaning(field))
            for field in dataclasses.fields(kind)
            if not isinstance(field.default, Settings)
        ],
    )


def _value(kind: type[Settings] | Settings, field: dataclasses.Field) -> Any:
    return getattr(kind, field.name) if isinstance(kind, Settings) else field.default


def _default(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(f"`{entry}`" for entry in value) or "none"
    return f"`{_scalar(value)}`"


def _range(field: dataclasses.Field) -> str:
    meta = field.metadata
    if meta["choices"]:
        return ", ".join(f"`{choice}`" for choice in meta["choices"])
    low, high = meta["low"], meta["high"]
    if low is None and high is None:
        return ""
    if high is None:
        return f"from {low:.10g}"
    return f"up to {high:.10g}" if low is None else f"{low:.10g} to {high:.10g}"


def _meaning(field: dataclasses.Field) -> str:
    return _sentence(field.metadata["doc"]) + "."


def _sentence(text: str) -> str:
    text = text.strip().rstrip(".")
    return text[:1].upper() + text[1:] if text.split(" ")[0].isalpha() else text


def _scalar(value: Any) -> str:
    return yaml.safe_dump(value, default_flow_style=True, width=1000).removesuffix("\n").removesuffix("\n...")


def _with_comment(line: str, comment: str) -> str:
    return f"{line:<38} # {comment}"
