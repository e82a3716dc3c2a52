"""A bag through the processing nodes, by /clock, and, if asked for, a recorder of all that is said."""

from dataclasses import replace

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_processing.commands.options import required_file
from rgbd_dic_processing.commands.up import WINDOW
from rgbd_dic_processing.graph import (
    SENSOR_TOPICS,
    GraphFiles,
    all_topics,
    opening_topic,
    player,
    processing_nodes,
    recorder,
    viewer,
)
from rgbd_dic_processing.launching import COMMON_ARGUMENTS, chosen, is_true, node_action, path_argument
from rgbd_dic_processing.recorded import check_topics, has_clouds

START_DELAY_S = 3.0  # the player sees who listens to it; the nodes find each other meanwhile

ARGUMENTS = (
    DeclareLaunchArgument("bag", description="bag to play: a directory, or a .mcap file; required"),
    DeclareLaunchArgument("regions", default_value="", description="regions.yaml; empty: the one in the bag"),
    DeclareLaunchArgument("calibration", default_value="", description="calibration.yaml; empty: the one in the bag"),
    DeclareLaunchArgument(
        "rate", default_value="1.0", description="speed of the bag; 0: as fast as the graph answers, no frame is lost"
    ),
    DeclareLaunchArgument("output", default_value="", description="directory of the bag to record; empty: none"),
    *COMMON_ARGUMENTS,
)


def _nodes(context: LaunchContext) -> list[Node]:
    settings, methods = chosen(context)
    bag = path_argument(context, "bag")
    files = GraphFiles(
        required_file(path_argument(context, "calibration"), bag, "calibration.yaml"),
        required_file(path_argument(context, "regions"), bag, "regions.yaml"),
    )
    with BagReader(bag) as reader:
        check_topics(reader)
        use_points = has_clouds(reader)
        recorded = {name.lstrip("/") for name in reader.topics}
    topics = tuple(topic for topic in SENSOR_TOPICS if topic in recorded)
    nodes = processing_nodes(files, settings, methods, use_points)
    if is_true(context, "viewers"):
        nodes.append(viewer(files, use_points))
    output = path_argument(context, "output")
    if output is not None:
        nodes.append(recorder(output, tuple(dict.fromkeys((*topics, *all_topics(nodes))))))
    rate = float(LaunchConfiguration("rate").perform(context))
    answers = tuple(opening_topic(method, methods) for method in methods) if rate == 0 else ()
    playing = player(bag, topics, nodes, answers, rate, WINDOW)
    playing = replace(playing, parameters={**playing.parameters, "start_delay_s": START_DELAY_S})
    return [node_action(playing, use_sim_time=False), *(node_action(spec, use_sim_time=True) for spec in nodes)]


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=_nodes)])
