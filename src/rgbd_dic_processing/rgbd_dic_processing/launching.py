"""The nodes of the graph as actions of ROS' launch system: the launch files are wired with these.

Needs `launch` and `launch_ros`, which a full ROS 2 has; `rgbd-dic up` starts the same graph without them.
"""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import Any

from launch import LaunchContext
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from .commands.options import measurement_settings
from .core.displacement import SOLVERS
from .core.settings import ProcessingSettings
from .graph import NodeSpec

COMMON_ARGUMENTS = (
    DeclareLaunchArgument("namespace", default_value="", description="namespace of all nodes and topics"),
    DeclareLaunchArgument(
        "method",
        default_value="",
        description=f"compensation method, or several with commas: {', '.join(SOLVERS)}; or all; empty: that of the "
        "settings",
    ),
    DeclareLaunchArgument(
        "settings", default_value="", description="settings.yaml, grouped by stage; empty: the defaults"
    ),
    DeclareLaunchArgument(
        "viewers", default_value="false", description="publish what Foxglove and rviz show (docs/viewers.md)"
    ),
    DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn, error or fatal"),
)


def path_argument(context: LaunchContext, name: str) -> Path | None:
    """The value of a launch argument as a path; None if it is empty."""
    value = LaunchConfiguration(name).perform(context)
    return Path(value).expanduser() if value else None


def is_true(context: LaunchContext, name: str) -> bool:
    """Whether a launch argument says true."""
    return LaunchConfiguration(name).perform(context).lower() == "true"


def chosen(context: LaunchContext) -> tuple[ProcessingSettings, tuple[str, ...]]:
    """The settings and the methods of the arguments `settings` and `method`, checked as `rgbd-dic` does.

    Raises:
        RgbdDicError: if a method is unknown, or the settings are refused.
    """
    method = LaunchConfiguration("method").perform(context) or None
    return measurement_settings(Namespace(settings=path_argument(context, "settings"), method=method))


def node_action(spec: NodeSpec, use_sim_time: bool) -> Node:
    """One node of the graph, in the namespace and with the log level of the arguments."""
    parameters = {name: _typed(value) for name, value in spec.parameters.items() if value != []}
    return Node(
        package=spec.package,
        executable=spec.executable,
        name=spec.node_name,
        namespace=LaunchConfiguration("namespace"),
        parameters=[{"use_sim_time": use_sim_time, **parameters}],
        remappings=list(spec.remappings.items()),
        arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
        output="screen",
    )


def _typed(value: Any) -> Any:
    """Text stays text: without this, launch would read it as YAML, and a file named 1 would become a number."""
    return ParameterValue(value, value_type=str) if isinstance(value, str) else value
