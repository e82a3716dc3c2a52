"""Nodes in one process, and the settings for measuring live: the numbers are those of the offline tool."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_share_directory
from rgbd_dic_acquisition.bag import BagReader
from rgbd_dic_processing.graph import COMPOSABLE, SHARING
from rgbd_dic_processing.results import compare, read_openings, read_truth
from system import SAMPLE, rgbd_dic

pytestmark = pytest.mark.timeout(280)


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "crack_opening.csv").open(newline="") as file:
        return [{name: value for name, value in row.items() if name != "latency_s"} for row in csv.DictReader(file)]


@pytest.mark.parametrize("composed", SHARING)
def test_same_numbers_as_offline(tmp_path: Path, composed: str) -> None:
    settings = Path(get_package_share_directory("rgbd_dic_processing"), "config", "live.yaml")
    common = (SAMPLE, "--settings", settings, "--method", "h_pose,h_3d")
    up = rgbd_dic(
        "up", *common, "--composed", composed, "--as-fast-as-possible", "--domain", "91", "--out", tmp_path / "graph"
    )  # fmt: skip
    assert up.returncode == 0, up.stderr
    process = rgbd_dic("process", *common, "--out", tmp_path / "offline")
    assert process.returncode == 0, process.stderr
    assert rows(tmp_path / "graph") == rows(tmp_path / "offline")
    logs = {path.stem for path in (tmp_path / "graph" / "logs").glob("*.log")}
    apart = set(COMPOSABLE) - set(SHARING[composed])
    assert "composed_nodes" in logs and logs & set(COMPOSABLE) == apart
    with BagReader(tmp_path / "graph" / "bag") as bag:
        assert {bag.topics[f"/{name}"].count for name in ("camera/image_raw", "subset_field", "crack_opening")} == {120}
    h_pose = next(
        c
        for c in compare(read_openings(tmp_path / "graph" / "crack_opening.csv"), read_truth(SAMPLE / "truth.csv"))
        if c.method == "h_pose"
    )
    assert h_pose.valid == 120 and h_pose.rms_m < 3e-5  # 0.02 px of 1.46 mm, as with the defaults
