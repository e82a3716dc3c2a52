"""The nodes of the graph as actions of ROS' launch system: the launch files are wired with these.

Needs `launch` and `launch_ros`, which a full ROS 2 has; `rgbd-dic up` starts the same graph without them.
"""

from __future__ import annotations

import json
from argparse import Namespace
from pathlib import Path
from typing import Any

from launch import LaunchContext
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from rgbd_dic_acquisition.errors import RgbdDicError

from .commands.options import measurement_settings
from .core.displacement import SOLVERS
from .core.settings import ProcessingSettings
from .graph import ALL, COMPOSED, PROCESSING, SHARING, NodeSpec

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


def composed_action(context: LaunchContext, specs: list[NodeSpec]) -> Node:
    """The nodes of the graph that can be composed, in one process, as `rgbd-dic up --composed` starts them; in the
    namespace and with the log level of the arguments, by the computer's clock."""
    namespace, log_level = (LaunchConfiguration(name).perform(context) for name in ("namespace", "log_level"))
    arguments = []
    for spec in specs:
        arguments += ["--node", spec.executable, "--ros-args", "--log-level", log_level]
        names = {"__node": spec.node_name, **({"__ns": f"/{namespace.lstrip('/')}"} if namespace else {})}
        for before, after in {**names, **spec.remappings}.items():
            arguments += ["-r", f"{before}:={after}"]
        for name, value in spec.parameters.items():
            arguments += ["-p", f"{name}:={json.dumps(value)}"]  # quoted, so that text stays text
    return Node(package=PROCESSING, executable=COMPOSED, arguments=arguments, output="screen")


def live_actions(context: LaunchContext, specs: list[NodeSpec]) -> list[Node]:
    """All nodes of a live graph: each by itself, or those in one process that the argument `composed` names.

    Raises:
        RgbdDicError: if it names none.
    """
    said = LaunchConfiguration("composed").perform(context).lower()
    sharing = {"false": (), "true": SHARING[ALL], **SHARING}
    if said not in sharing:
        raise RgbdDicError(f"composed:={said} is not known: give one of {', '.join(sharing)}")
    together = [spec for spec in specs if spec.executable in sharing[said]]
    apart = [node_action(spec, use_sim_time=False) for spec in specs if spec not in together]
    return [*([composed_action(context, together)] if together else []), *apart]


def _typed(value: Any) -> Any:
    """Text stays text: without this, launch would read it as YAML, and a file named 1 would become a number."""
    return ParameterValue(value, value_type=str) if isinstance(value, str) else value
