"""Imports run one way: numerical code never imports ROS, acquisition never imports processing."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest
from system import ROOT, environment

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


@pytest.mark.parametrize(
    "path",
    files(PROCESSING / "core") + files(PROCESSING / "history") + files(ACQUISITION, without="nodes"),
    ids=lambda p: p.stem,
)
def test_no_ros_in_numerical_code(path: Path) -> None:
    assert not imported(path) & ROS


@pytest.mark.parametrize("path", files(ACQUISITION), ids=lambda p: p.stem)
def test_acquisition_does_not_know_processing(path: Path) -> None:
    assert "rgbd_dic_processing" not in imported(path)


def test_core_does_not_know_nodes() -> None:
    for path in files(PROCESSING / "core"):
        assert ".nodes" not in path.read_text() and "from ..graph" not in path.read_text()


def test_offline_tool_needs_no_ros(flight: Path, tmp_path: Path) -> None:
    """`rgbd-dic process` where rclpy and the message packages cannot be imported."""
    hidden = "; ".join(f"sys.modules['{name}'] = None" for name in sorted(ROS))
    program = f"import sys; {hidden}; from rgbd_dic_processing.cli import main; sys.exit(main(sys.argv[1:]))"
    done = subprocess.run(
        [sys.executable, "-c", program, "process", flight, "--out", tmp_path / "out"],
        capture_output=True,
        text=True,
        env=environment(),
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "crack_opening.csv").exists()
