"""Parameters and messages that are made from descriptions, in this process."""

from __future__ import annotations

import array
import os
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import pytest
import rclpy
import yaml
from rclpy.node import Node
from rclpy.parameter import Parameter
from rgbd_dic_acquisition.drivers.aravis_connection import AravisSettings
from rgbd_dic_acquisition.drivers.mavlink import MavlinkSettings
from rgbd_dic_acquisition.drivers.tof_settings import TofSettings
from rgbd_dic_acquisition.errors import RgbdDicError, SettingsError
from rgbd_dic_acquisition.nodes.camera_node import CameraNodeSettings
from rgbd_dic_acquisition.nodes.mavlink_node import MavlinkNodeSettings
from rgbd_dic_acquisition.nodes.parameters import declare, declare_path
from rgbd_dic_acquisition.nodes.recorder_node import RecorderSettings
from rgbd_dic_acquisition.nodes.ros_messages import make
from rgbd_dic_acquisition.nodes.tof_node import TofNodeSettings
from rgbd_dic_acquisition.settings import Settings, setting
from rgbd_dic_acquisition.simulator.flight import FlightSettings


@dataclass(frozen=True)
class Inner(Settings):
    gain: float = setting(1.5, doc="how much", unit="dB", low=0.0, high=40.0)


@dataclass(frozen=True)
class Outer(Settings):
    count: int = setting(3, doc="how many", unit="px", low=1, high=9)
    name: str = setting("a", doc="which", choices=("a", "b"))
    lines: tuple[str, ...] = setting((), doc="what")
    fast: bool = setting(False, doc="whether")
    inner: Inner = setting(Inner(), doc="more")  # noqa: RUF009 - as every setting is


@pytest.fixture
def node():
    """A node made with the given parameters."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=9)
    made = []

    def build(**values):
        overrides = [Parameter(name.replace("__", "."), value=value) for name, value in values.items()]
        made.append(Node("test_node", context=context, parameter_overrides=overrides))
        return made[-1]

    yield build
    for each in made:
        each.destroy_node()
    rclpy.shutdown(context=context)


def test_defaults_and_given_values(node):
    assert declare(node(), Outer) == Outer()
    given = node(stage__count=5, stage__lines=["x y"], stage__inner__gain=2, stage__fast=True)
    settings = declare(given, Outer, "stage")
    assert settings == Outer(count=5, lines=("x y",), fast=True, inner=Inner(gain=2.0))
    assert given.get_parameter("stage.inner.gain").value == 2.0


def test_descriptors_tell_unit_range_and_choices(node):
    made = node()
    declare(made, Outer)
    count = made.describe_parameter("count")
    assert count.description == "how many [px]"
    assert (count.integer_range[0].from_value, count.integer_range[0].to_value) == (1, 9)
    gain = made.describe_parameter("inner.gain")
    assert (gain.floating_point_range[0].from_value, gain.floating_point_range[0].to_value) == (0.0, 40.0)
    assert made.describe_parameter("name").description == "which; one of a, b"


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        (
            {"count": 10},
            r"/test_node: Outer.count = 10 px is out of range: must be at least 1 px and at most 9",
        ),
        ({"count": 2.5}, r"Outer.count = 2.5: expected int"),
        ({"name": "c"}, r"Outer.name = 'c': choose one of a, b"),
        ({"inner__gain": 41.0}, r"Inner.gain = 41.0 dB is out of range"),
        ({"inner__gain": float("nan")}, r"must be a finite number"),
        ({"lines": "x"}, r"Outer.lines = 'x': expected tuple"),
    ],
)
def test_a_wrong_value_is_refused_with_the_reason(node, values, reason):
    with pytest.raises(SettingsError, match=reason):
        declare(node(**values), Outer)


def test_nothing_changes_while_a_node_runs(node):
    made = node()
    declare(made, Outer)
    (result,) = made.set_parameters([Parameter("count", value=4)])
    assert not result.successful and "read-only" in result.reason
    assert made.get_parameter("count").value == 3


def test_paths(node):
    assert declare_path(node(), "calibration", "the file", required=False) is None
    assert declare_path(node(calibration="/a/b.yaml"), "calibration", "the file") == Path("/a/b.yaml")
    with pytest.raises(SettingsError, match=r"parameter calibration is missing: the file\. Give it with"):
        declare_path(node(), "calibration", "the file")


def test_the_example_file_has_the_defaults():
    """config/acquisition.yaml says that it shows defaults: hold it to that."""
    text = (Path(__file__).parents[1] / "config" / "acquisition.yaml").read_text()
    groups = {
        "camera_node": (CameraNodeSettings, {"aravis": AravisSettings, "flight": FlightSettings}),
        "tof_node": (TofNodeSettings, {"tof": TofSettings, "flight": FlightSettings}),
        "mavlink_node": (MavlinkNodeSettings, {"link": MavlinkSettings}),
        "recorder_node": (RecorderSettings, {}),
    }
    content = yaml.safe_load(text)["/**"]
    assert set(content) == set(groups)
    for name, (own, nested) in groups.items():
        values = dict(content[name]["ros__parameters"])
        values.pop("calibration", None)
        for group, kind in nested.items():
            assert kind.from_mapping(values.pop(group)) == kind()
        assert set(values) <= {field.name for field in fields(own)}
        assert own.from_mapping(values) == own()


@pytest.mark.parametrize(("dtype", "code"), [(np.float64, "d"), (np.float32, "f"), (np.int64, "d"), (np.uint8, "d")])
def test_sequences_take_any_array(dtype, code):
    message = make("rgbd_dic_msgs/msg/SubsetField", x=np.arange(6, dtype=dtype).reshape(2, 3))
    assert message.x == array.array(code, range(6)) or list(message.x) == list(range(6))
    assert isinstance(message.x, array.array) and message.x.typecode == "d"


def test_fixed_arrays_scalars_and_bytes():
    message = make("rgbd_dic_msgs/msg/SubsetField", homography=np.eye(3), seed_source=np.uint8(2))
    np.testing.assert_array_equal(message.homography, np.eye(3).ravel())
    assert message.seed_source == 2 and type(message.seed_source) is int
    image = make("sensor_msgs/msg/Image", data=b"\x01\x02")
    assert image.data == array.array("B", [1, 2])


def test_an_unknown_type_names_what_to_install():
    with pytest.raises(RgbdDicError, match="install the package 'no_such_msgs'"):
        make("no_such_msgs/msg/Thing")
