"""Imports run one way: numerical code never imports ROS, acquisition never imports processing."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from system import ROOT

ROS = {
    "rclpy",
    "rcl_interfaces",
    "rosidl_runtime_py",
    "sensor_msgs",
    "std_msgs",
    "rgbd_dic_msgs",
    "diagnostic_msgs",
}
PROCESSING = ROOT / "src/rgbd_dic_processing/rgbd_dic_processing"
ACQUISITION = ROOT / "src/rgbd_dic_acquisition/rgbd_dic_acquisition"


def imported(path: Path) -> set[str]:
    """First words of all that a file imports, wherever in it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add(node.module.split(".")[0])
    return names


def files(folder: Path, *, without: str = "") -> list[Path]:
    found = [path for path in folder.rglob("*.py") if not without or without not in path.relative_to(folder).parts]
    assert found
    return found


@pytest.mark.parametrize("path", files(PROCESSING / "core") + files(ACQUISITION, without="nodes"), ids=lambda p: p.stem)
def test_no_ros_in_numerical_code(path: Path) -> None:
    assert not imported(path) & ROS


@pytest.mark.parametrize("path", files(ACQUISITION), ids=lambda p: p.stem)
def test_acquisition_does_not_know_processing(path: Path) -> None:
    assert "rgbd_dic_processing" not in imported(path)


def test_core_does_not_know_nodes() -> None:
    for path in files(PROCESSING / "core"):
        assert ".nodes" not in path.read_text() and "from ..graph" not in path.read_text()
