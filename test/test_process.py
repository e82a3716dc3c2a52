"""rgbd-dic process: deterministic, and frank about what it cannot measure."""

from __future__ import annotations

from pathlib import Path

import pytest
from system import rgbd_dic


def test_same_bytes_for_any_thread_count(flight: Path, tmp_path: Path) -> None:
    outputs = []
    for name, threads in (("a", "1"), ("b", "2"), ("c", "2")):
        done = rgbd_dic("process", flight, "--method", "all", "--threads", threads, "--out", tmp_path / name)
        assert done.returncode == 0, done.stderr
        outputs.append((tmp_path / name / "crack_opening.csv").read_bytes())
    assert outputs[0] == outputs[1] == outputs[2]
    assert outputs[0].count(b"\n") == 1 + 5 * 30


def test_help_names_units_and_defaults() -> None:
    text = rgbd_dic("process", "--help").stdout
    assert "default" in text and "[mm]" in text
    for command in ("up", "process", "simulate", "import", "report", "info", "validate"):
        assert command in rgbd_dic("--help").stdout


@pytest.mark.parametrize("arguments", [["process"], ["nonsense"], ["up", "--rate", "x", "y"]])
def test_wrong_command_line_exits_with_2(arguments: list[str]) -> None:
    assert rgbd_dic(*arguments).returncode == 2
