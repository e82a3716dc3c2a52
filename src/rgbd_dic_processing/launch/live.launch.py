"""A real payload: its sensors, the processing nodes and, if asked for, a recorder and the live page; as `rgbd-dic up
--live` starts them."""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from rgbd_dic_acquisition.errors import RgbdDicError
from rgbd_dic_acquisition.payload import load_payload
from rgbd_dic_processing.graph import GraphFiles, all_topics, operator_page, processing_nodes, recorder
from rgbd_dic_processing.launching import COMMON_ARGUMENTS, chosen, live_actions, path_argument
from rgbd_dic_processing.live_sensors import live_calibration, live_sensors

ARGUMENTS = (
    DeclareLaunchArgument("payload", description="payload.yaml: parameters of the sensor nodes; required"),
    DeclareLaunchArgument("regions", description="regions.yaml: panel, fixed region and crack [px]; required"),
    DeclareLaunchArgument(
        "calibration",
        default_value="",
        description="calibration.yaml: both sensors and T_camera_tof; empty: that of camera_node in the payload",
    ),
    DeclareLaunchArgument("output", default_value="", description="directory of the bag to record; empty: none"),
    DeclareLaunchArgument("page", default_value="", description="port of the live page, such as 8420; empty: none"),
    DeclareLaunchArgument("page_host", default_value="127.0.0.1", description="address that the live page listens on"),
    DeclareLaunchArgument(
        "composed",
        default_value="false",
        description="true or all: the nodes that work on every image in one process; after_dic: those after the DIC "
        "(docs/live.md)",
    ),
    *COMMON_ARGUMENTS,
)


def _nodes(context: LaunchContext) -> list[Node]:
    settings, methods = chosen(context)
    path = path_argument(context, "payload")
    if path is None:
        raise RgbdDicError("no payload: give the parameters of the sensor nodes with payload:=PATH (docs/payload.md)")
    payload = load_payload(path)
    calibration = live_calibration(path_argument(context, "calibration"), payload)
    files = GraphFiles(calibration, path_argument(context, "regions"))
    nodes = [*processing_nodes(files, settings, methods, live=True), *live_sensors(payload, calibration)]
    host, port = (LaunchConfiguration(name).perform(context) for name in ("page_host", "page"))
    if port:
        nodes.append(operator_page(host, int(port), files, settings, Path("regions_drawn.yaml")))
    output = path_argument(context, "output")
    if output is not None:
        nodes.append(recorder(output, all_topics(nodes)))
    return live_actions(context, nodes)


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=_nodes)])
