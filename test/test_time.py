"""Planes carried in time, and ToF stamps that are known to be late: the graph gives the same numbers as offline."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import pytest
import yaml
from rgbd_dic_acquisition.message_types import make_message
from rgbd_dic_acquisition.messages import stamp_message, stamp_to_ns
from rgbd_dic_processing.core.sensor_delay import TOLD_AS
from system import rgbd_dic

SETTINGS = {
    "correlation": {"step": 20},
    "compensation": {"plane_in_time": "carried", "plane_window_s": 0.2, "method": "h_3d"},
}
DELAY_NS = 40_000_000


def late(topic: str, _: int, message: Any) -> Any:
    """The ToF frames arrive when they do, but say that they were exposed later."""
    if topic.startswith("/tof/"):
        message.header.stamp = stamp_message(make_message, stamp_to_ns(message.header.stamp) + DELAY_NS)
    return message


@pytest.mark.timeout(120)
def test_carried_planes_and_a_known_delay(flight: Path, edited: Any, tmp_path: Path) -> None:
    """With the delay taken off, a flight with late stamps gives the rows of the flight itself, offline and online."""

    def run(name: str, command: str, bag: Path, delay_s: float, *options: str) -> list[dict[str, str]]:
        settings, out = tmp_path / f"{name}.yaml", tmp_path / name
        settings.write_text(yaml.safe_dump({**SETTINGS, "pairing": {"tof_delay_s": delay_s}}))
        done = rgbd_dic(command, bag, "--settings", settings, "--out", out, *options)
        assert done.returncode == 0, done.stderr
        with (out / "crack_opening.csv").open(newline="") as file:
            return [{name: value for name, value in row.items() if name != "latency_s"} for row in csv.DictReader(file)]

    right = run("right", "process", flight, 0.0)
    bag, delay_s = edited(late), DELAY_NS * 1e-9
    assert len(right) == 30 and all(row["valid"] == "1" for row in right)
    assert run("offline", "process", bag, delay_s) == right
    assert run("online", "up", bag, delay_s, "--as-fast-as-possible", "--domain", "83") == right
    facts = yaml.safe_load((tmp_path / "offline" / "run.yaml").read_text())["facts"]
    assert facts[TOLD_AS] == "unknown: 10 ToF planes, at least 20 needed"
