"""The launch files start what `rgbd-dic up` starts. `launch` is no part of the environment here, so a stand-in records
what it is given."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import rclpy
from rclpy.node import Node
from rgbd_dic_acquisition.errors import RgbdDicError
from rgbd_dic_acquisition.payload import load_payload
from rgbd_dic_processing.core.settings import ProcessingSettings
from rgbd_dic_processing.graph import (
    COMPOSABLE,
    COMPOSED,
    SENSOR_TOPICS,
    GraphFiles,
    NodeSpec,
    all_topics,
    operator_page,
    player,
    processing_nodes,
    recorder,
    viewer,
)
from rgbd_dic_processing.live_sensors import live_sensors
from system import ROOT, SAMPLE

PROCESSING, ACQUISITION = (ROOT / f"src/rgbd_dic_{name}/launch" for name in ("processing", "acquisition"))
FILES = [*PROCESSING.glob("*.launch.py"), *ACQUISITION.glob("*.launch.py")]
SAMPLE_FILES = GraphFiles(SAMPLE / "calibration.yaml", SAMPLE / "regions.yaml")
PLAYED = tuple(topic for topic in SENSOR_TOPICS if topic != "tof/points")  # of the sample bag
NAMED = {"regions": str(SAMPLE_FILES.regions), "calibration": str(SAMPLE_FILES.calibration)}


class Recorded(SimpleNamespace):
    """Any class of launch: keeps the arguments it is made with."""

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(given=given, **named)


class LaunchConfiguration(Recorded):
    def perform(self, context: dict[str, str]) -> str:
        return context[self.given[0]]


class ParameterValue(Recorded):
    """A value that launch must not read as YAML."""


STAND_IN = {
    "launch": {"LaunchContext": dict, "LaunchDescription": list},
    "launch.actions": dict.fromkeys(("DeclareLaunchArgument", "OpaqueFunction"), Recorded),
    "launch.conditions": {"IfCondition": Recorded},
    "launch.substitutions": {
        "LaunchConfiguration": LaunchConfiguration,
        "PathJoinSubstitution": Recorded,
        "PythonExpression": Recorded,
    },
    "launch_ros": {},
    "launch_ros.actions": {"Node": type("Node", (Recorded,), {})},
    "launch_ros.substitutions": {"FindPackageShare": Recorded},
    "launch_ros.parameter_descriptions": {"ParameterValue": ParameterValue},
}


@pytest.fixture
def describe(monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], list[Any]]:
    """Runs a launch file; its description as a list of what it is made of."""
    for name, members in STAND_IN.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delitem(sys.modules, "rgbd_dic_processing.launching", raising=False)
    yield lambda path: runpy.run_path(str(path))["generate_launch_description"]()
    sys.modules.pop("rgbd_dic_processing.launching", None)


def arguments(description: list[Any]) -> dict[str, Any]:
    return {item.given[0]: item for item in description if hasattr(item, "description")}


def nodes(description: list[Any], **given: str) -> list[NodeSpec]:
    """The nodes of a description started with these arguments, told as the graph tells them."""
    defaults = {name: item.default_value for name, item in arguments(description).items() if name not in given}
    (function,) = (item.function for item in description if hasattr(item, "function"))
    return [as_spec(node) for node in function({**defaults, **given})]


def as_spec(node: Any) -> NodeSpec:
    values = {
        name: value.given[0] if isinstance(value, ParameterValue) else value
        for name, value in node.parameters[0].items()
    }
    return NodeSpec(node.package, node.executable, (), (), node.name, values, dict(node.remappings))


def expected(specs: list[NodeSpec], use_sim_time: bool) -> list[NodeSpec]:
    """What of the graph's description a launch file has to hand on."""
    return [
        replace(
            spec,
            takes=(),
            gives=(),
            name=spec.node_name,
            follows_clock=True,
            parameters={
                "use_sim_time": use_sim_time,
                **{name: value for name, value in spec.parameters.items() if value != []},
            },
        )
        for spec in specs
    ]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_argument_is_described(describe, path: Path) -> None:
    found = arguments(describe(path))
    assert {"namespace", "log_level"} <= set(found)
    assert all(item.description for item in found.values())


@pytest.mark.parametrize("method", ["", "h_3d", "h_pose,pc_3d", "all"])
def test_processing(describe, method: str) -> None:
    methods = {"": ("h_pose",), "all": ("h_pose", "h_joint", "h_3d", "h_2d", "pc_3d")}.get(
        method, tuple(method.split(","))
    )
    started = nodes(describe(PROCESSING / "processing.launch.py"), method=method, use_sim_time="True", **NAMED)
    assert started == expected(processing_nodes(SAMPLE_FILES, ProcessingSettings(), methods), use_sim_time=True)


def test_settings_reach_the_nodes(describe, tmp_path: Path) -> None:
    path = tmp_path / "settings.yaml"
    path.write_text("correlation: {step: 7}\ncrack: {min_subsets: 5}\n")
    started = nodes(describe(PROCESSING / "processing.launch.py"), settings=str(path), **NAMED)
    by_name = {spec.node_name: spec.parameters for spec in started}
    assert by_name["dic_node"]["correlation.step"] == 7
    assert by_name["crack_opening_node"]["crack.min_subsets"] == 5
    assert all(parameters["use_sim_time"] is False for parameters in by_name.values())


def test_unknown_method(describe) -> None:
    with pytest.raises(RgbdDicError, match="choose from"):
        nodes(describe(PROCESSING / "processing.launch.py"), method="h_4d", **NAMED)


def test_point_clouds(describe) -> None:
    started = nodes(describe(PROCESSING / "processing.launch.py"), use_points="true", **NAMED)
    graph = processing_nodes(SAMPLE_FILES, ProcessingSettings(), ("h_pose",), use_points=True, live=True)
    assert started == expected(graph, use_sim_time=False)


@pytest.mark.parametrize("name", ["processing", "replay"])
def test_viewers(describe, name: str) -> None:
    files = NAMED if name == "processing" else {"bag": str(SAMPLE)}
    started = nodes(describe(PROCESSING / f"{name}.launch.py"), viewers="true", use_sim_time="true", **files)
    (found,) = (spec for spec in started if spec.executable == "viewer_node")
    assert [found] == expected([viewer(SAMPLE_FILES)], use_sim_time=True)


@pytest.mark.parametrize("rate, answers", [("1.0", ()), ("0", ("crack_opening",))])
def test_replay(describe, rate: str, answers: tuple[str, ...]) -> None:
    """The files come from the bag; all but the player follow /clock; at rate 0 the player waits for the openings."""
    graph = processing_nodes(SAMPLE_FILES, ProcessingSettings(), ("h_pose",))
    started = nodes(describe(PROCESSING / "replay.launch.py"), bag=str(SAMPLE), rate=rate)
    playing = started.pop(0)
    assert started == expected(graph, use_sim_time=True)
    assert playing.parameters.pop("start_delay_s") > 0
    assert [playing] == expected([player(SAMPLE, PLAYED, graph, answers, float(rate), 16)], use_sim_time=False)


def test_replay_recorded(describe, tmp_path: Path) -> None:
    started = nodes(describe(PROCESSING / "replay.launch.py"), bag=str(SAMPLE), output=str(tmp_path / "bag"))
    recording = next(spec for spec in started if spec.executable == "recorder_node")
    assert recording.parameters["output"] == str(tmp_path / "bag")
    recorded = {entry.split()[0] for entry in recording.parameters["topics"]}
    assert {*PLAYED, "reference", "subset_field", "displacement_field", "crack_opening"} <= recorded


PAYLOAD = """
/**:
  camera_node:
    ros__parameters: {source: aravis, calibration: elsewhere.yaml, aravis: {transport: gige, address: 10.0.0.2}}
  tof_node:
    ros__parameters: {source: pylon, publish_points: true, tof: {depth_min_m: 1.0}}
"""


@pytest.fixture
def payload(tmp_path: Path) -> Path:
    path = tmp_path / "payload.yaml"
    path.write_text(PAYLOAD)
    return path


def test_live(describe, payload: Path, tmp_path: Path) -> None:
    """Sensors by the payload's parameters and one calibration, the rest as ever; recorder and page if asked for."""
    graph = [
        *processing_nodes(SAMPLE_FILES, ProcessingSettings(), ("h_pose",), live=True),
        *live_sensors(load_payload(payload), SAMPLE_FILES.calibration),
    ]
    started = nodes(describe(PROCESSING / "live.launch.py"), payload=str(payload), **NAMED)
    assert started == expected(graph, use_sim_time=False)
    camera, tof = (spec.parameters for spec in started[-2:])
    assert camera["aravis.address"] == "10.0.0.2" and camera["calibration"] == str(SAMPLE_FILES.calibration)
    assert tof["tof.depth_min_m"] == 1.0 and tof["calibration"] == str(SAMPLE_FILES.calibration)
    page = operator_page("127.0.0.1", 8420, SAMPLE_FILES, ProcessingSettings(), Path("regions_drawn.yaml"))
    graph += [page, recorder(tmp_path / "bag", all_topics([*graph, page]))]
    named = {"payload": str(payload), "output": str(tmp_path / "bag"), "page": "8420", **NAMED}
    assert nodes(describe(PROCESSING / "live.launch.py"), **named) == expected(graph, use_sim_time=False)
    assert {"tof/points", "camera/time_reference"} <= set(graph[-1].takes)


def test_live_composed(describe, payload: Path) -> None:
    """ROS reads the parameters and names of the graph from what each node of the one process is given."""
    description = describe(PROCESSING / "live.launch.py")
    given = {"payload": str(payload), "composed": "true", "namespace": "left", "method": "h_pose,pc_3d", **NAMED}
    defaults = {name: item.default_value for name, item in arguments(description).items() if name not in given}
    (function,) = (item.function for item in description if hasattr(item, "function"))
    after_dic, *apart = function({**defaults, **given, "composed": "after_dic"})
    assert after_dic.arguments[:2] == ["--node", "pairing_node"] and apart[0].executable == "dic_node"
    with pytest.raises(RgbdDicError, match="true, all, after_dic"):
        function({**defaults, **given, "composed": "some"})
    composed, *apart = function({**defaults, **given})
    assert composed.executable == COMPOSED
    assert [node.executable for node in apart] == ["plane_node", "camera_node", "tof_node"]
    words = composed.arguments
    begins = [index for index, word in enumerate(words) if word == "--node"]
    graph = processing_nodes(SAMPLE_FILES, ProcessingSettings(), ("h_pose", "pc_3d"), live=True)
    together = [spec for spec in graph if spec.executable in COMPOSABLE]
    assert [words[begin + 1] for begin in begins] == [spec.executable for spec in together]
    for spec, begin, end in zip(together, begins, [*begins[1:], len(words)], strict=True):
        context = rclpy.Context()
        rclpy.init(context=context)
        node = Node(
            "unnamed",
            context=context,
            cli_args=words[begin + 2 : end],
            automatically_declare_parameters_from_overrides=True,
            start_parameter_services=False,
        )
        read = {name: node.get_parameter(name).value for name in spec.parameters}
        named = node.get_fully_qualified_name(), node.resolve_topic_name("crack_opening")
        node.destroy_node()
        rclpy.shutdown(context=context)
        assert {name: (type(value), value) for name, value in read.items()} == {
            name: (type(value), value) for name, value in spec.parameters.items()
        }
        assert named == (f"/left/{spec.node_name}", f"/left/{spec.remappings.get('crack_opening', 'crack_opening')}")


def test_live_with_an_autopilot(describe, payload: Path) -> None:
    payload.write_text(f"{PAYLOAD}  mavlink_node: {{ros__parameters: {{link: {{attitude_rate_hz: 50.0}}}}}}\n")
    started = nodes(describe(PROCESSING / "live.launch.py"), payload=str(payload), **NAMED)
    assert started[-1].executable == "mavlink_node" and started[-1].parameters["link.attitude_rate_hz"] == 50.0


@pytest.mark.parametrize(
    "before, after, message",
    [
        ("source: pylon, ", "", "tof_node has no parameter 'source'"),
        ("source: pylon", "source: pylon, reliability: best_effort", "needs reliable"),
        ("ros__parameters", "parameters", "no entry ros__parameters"),
    ],
)
def test_live_refuses(describe, payload: Path, before: str, after: str, message: str) -> None:
    payload.write_text(PAYLOAD.replace(before, after))
    with pytest.raises(RgbdDicError, match=message):
        nodes(describe(PROCESSING / "live.launch.py"), payload=str(payload), **NAMED)


def test_replay_of_a_bag_without_regions(describe, edited, tmp_path: Path) -> None:
    bag = edited(lambda topic, index, message: message)
    (bag / "regions.yaml").unlink()
    with pytest.raises(RgbdDicError, match=r"no regions\.yaml"):
        nodes(describe(PROCESSING / "replay.launch.py"), bag=str(bag))
