"""The processing nodes, for sensors that are there already; the same description of the graph as `rgbd-dic up`."""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import Node
from rgbd_dic_processing.graph import GraphFiles, processing_nodes, viewer
from rgbd_dic_processing.launching import COMMON_ARGUMENTS, chosen, is_true, node_action, path_argument

ARGUMENTS = (
    DeclareLaunchArgument("regions", description="regions.yaml: panel, fixed region and crack [px]; required"),
    DeclareLaunchArgument("calibration", description="calibration.yaml: both sensors and T_camera_tof; required"),
    DeclareLaunchArgument(
        "use_points", default_value="false", description="take tof/points in place of tof/depth/image_raw"
    ),
    DeclareLaunchArgument("use_sim_time", default_value="false", description="take the time from /clock"),
    *COMMON_ARGUMENTS,
)


def _nodes(context: LaunchContext) -> list[Node]:
    settings, methods = chosen(context)
    files = GraphFiles(path_argument(context, "calibration"), path_argument(context, "regions"))
    use_points, use_sim_time = (is_true(context, name) for name in ("use_points", "use_sim_time"))
    nodes = processing_nodes(files, settings, methods, use_points, live=not use_sim_time)
    if is_true(context, "viewers"):
        nodes.append(viewer(files, use_points))
    return [node_action(spec, use_sim_time) for spec in nodes]


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=_nodes)])
