"""Real images, where they are at hand: a crack that grows, and a specimen with a hole under tension.

They are not part of the repository; the tests look for them beside it and say so when they are not there.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from rgbd_dic_processing.runs import Run
from system import ROOT, rgbd_dic

DATA = ROOT.parent / "shared" / "data"

CRACK_REGIONS = """
panel: [[242, 30], [780, 20], [780, 1140], [280, 1150], [280, 640], [242, 560]]
fixed: [[[620, 450], [780, 450], [780, 750], [620, 750]]]
x_axis: [[300, 600], [700, 600]]
crack: {{point: [{column}, 605], direction: [1, 0], size: [60, 80], gap: 30}}
"""
HOLE_REGIONS = """
panel: [[48, 20], [345, 20], [345, 1020], [48, 1020]]
fixed: [[[48, 700], [345, 700], [345, 900], [48, 900]]]
x_axis: [[50, 800], [340, 800]]
"""


def needs(name: str) -> Path:
    folder = DATA / name
    if not folder.is_dir():
        pytest.skip(f"the images of {name} are not beside the project (looked for ../shared/data/{name})")
    return folder


def openings_px(bag: Path, regions: str, out: Path) -> np.ndarray:
    """Opening of each frame; imported without depth, a millimetre stands for a pixel."""
    path = out.with_suffix(".yaml")
    path.write_text(regions)
    done = rgbd_dic("process", bag, "--regions", path, "--out", out)
    assert done.returncode == 0, done.stderr
    with (out / "crack_opening.csv").open(newline="") as file:
        return np.array([float(row["opening_mm"]) for row in csv.DictReader(file)])


def test_sides_of_a_real_crack_part_and_the_whole_side_does_not(tmp_path: Path) -> None:
    done = rgbd_dic("import", needs("real_crack"), "--out", tmp_path / "bag")
    assert done.returncode == 0 and "the scale is unknown" in done.stdout
    mouth = openings_px(tmp_path / "bag", CRACK_REGIONS.format(column=300), tmp_path / "mouth")
    whole = openings_px(tmp_path / "bag", CRACK_REGIONS.format(column=700), tmp_path / "whole")
    assert len(mouth) == len(whole) == 12
    assert (np.diff(mouth) > 0).all()  # it grows from each image to the next
    assert mouth[-1] > 4
    assert np.abs(whole).max() < 0.05 * mouth[-1]


def test_strain_of_a_real_specimen(tmp_path: Path) -> None:
    """No crack, so no openings, but maps: away from the hole the specimen stretches along y, evenly across it."""
    assert rgbd_dic("import", needs("open_hole"), "--out", tmp_path / "bag").returncode == 0
    (tmp_path / "regions.yaml").write_text(HOLE_REGIONS)
    done = rgbd_dic("process", tmp_path / "bag", "--regions", tmp_path / "regions.yaml", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    last = Run.load(tmp_path / "out").maps["h_pose"]["last"]
    found = np.isfinite(last.displacement_m[:, 1])
    assert found.mean() > 0.85  # all but the hole and its rim
    far = found & (last.centres_px[:, 1] < 300)
    left, right = far & (last.centres_px[:, 0] < 150), far & (last.centres_px[:, 0] > 250)
    strains = [np.polyfit(last.position_m[side, 1], last.displacement_m[side, 1], 1)[0] for side in (left, right)]
    assert min(strains) > 1e-3 and max(strains) < 2 * min(strains)
