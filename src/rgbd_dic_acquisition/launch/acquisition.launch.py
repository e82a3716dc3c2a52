"""Both sensors, the autopilot and, if asked for, the recorder."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, PythonExpression
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

PACKAGE = "rgbd_dic_acquisition"
DEFAULT_PARAMETERS = PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "acquisition.yaml"])

ARGUMENTS = (
    DeclareLaunchArgument("namespace", default_value="", description="namespace of all nodes and topics"),
    DeclareLaunchArgument("use_sim_time", default_value="false", description="take the time from /clock"),
    DeclareLaunchArgument("params_file", default_value=DEFAULT_PARAMETERS, description="YAML file of parameters"),
    DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn, error or fatal"),
    DeclareLaunchArgument("output", default_value="", description="directory of the bag to record; empty: none"),
    DeclareLaunchArgument("autopilot", default_value="true", description="whether to start mavlink_node"),
)


def _node(executable: str, condition: IfCondition | None = None, **parameters: LaunchConfiguration) -> Node:
    use_sim_time = {"use_sim_time": LaunchConfiguration("use_sim_time")}
    return Node(
        package=PACKAGE,
        executable=executable,
        namespace=LaunchConfiguration("namespace"),
        parameters=[LaunchConfiguration("params_file"), use_sim_time, parameters],
        arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
        condition=condition,
        output="screen",
    )


def generate_launch_description() -> LaunchDescription:
    output = LaunchConfiguration("output")
    recording = IfCondition(PythonExpression(["'", output, "' != ''"]))
    return LaunchDescription(
        [
            *ARGUMENTS,
            _node("camera_node"),
            _node("tof_node"),
            _node("mavlink_node", IfCondition(LaunchConfiguration("autopilot"))),
            _node("recorder_node", recording, output=output),
        ]
    )
