"""The sensor nodes of a real payload, as nodes of the graph."""

from __future__ import annotations

from pathlib import Path

from rgbd_dic_acquisition.errors import RgbdDicError
from rgbd_dic_acquisition.payload import SENSORS, Payload

from .graph import ACQUISITION, CAMERA_TOPICS, TOF_TOPICS, NodeSpec

AUTOPILOT = "mavlink_node"
GIVES = {
    "camera_node": (*CAMERA_TOPICS, "camera/time_reference"),
    "tof_node": (*TOF_TOPICS, "tof/time_reference"),
    AUTOPILOT: ("imu/data", "autopilot/time_reference"),
}


def live_sensors(payload: Payload, calibration: Path) -> list[NodeSpec]:
    """Camera, ToF camera and, if the payload has one, the autopilot; both cameras by the same calibration.yaml.

    Raises:
        RgbdDicError: if the payload does not say where a sensor's frames come from, or sends them in a way that may
            lose some.
    """
    nodes = []
    for name in (*SENSORS, *([AUTOPILOT] if AUTOPILOT in payload.parameters else [])):
        parameters, gives = payload.flat(name), GIVES[name]
        if parameters.get("reliability", "reliable") != "reliable":
            raise RgbdDicError(
                f"{payload.path}: {name} has reliability: {parameters['reliability']}; the graph records every frame "
                "and needs reliable: leave the parameter out"
            )
        if name in SENSORS:
            payload.source(name)
            parameters["calibration"] = str(calibration.resolve())
        if parameters.get("publish_points"):
            gives = (*gives, "tof/points")
        nodes.append(NodeSpec(ACQUISITION, name, (), gives, parameters=parameters))
    return nodes


def live_calibration(given: Path | None, payload: Payload) -> Path:
    """The calibration.yaml given, or that of the payload's camera_node.

    Raises:
        RgbdDicError: if there is neither.
    """
    path = given or payload.calibration
    if path is None:
        raise RgbdDicError(
            f"no calibration.yaml: give it with --calibration, or as parameter calibration of camera_node in "
            f"{payload.path} (see docs/payload.md)"
        )
    return path
