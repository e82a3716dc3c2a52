"""The panel found by its depth in the simulated laboratory, where its outline is known; and scenes without one."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from rgbd_dic_acquisition.errors import MeasurementError
from rgbd_dic_acquisition.simulator.laboratory import Laboratory, laboratory_settings
from rgbd_dic_acquisition.simulator.laboratory_bag import simulate_laboratory
from rgbd_dic_processing.cli import main
from rgbd_dic_processing.core.panel_finding import PanelFindingSettings, find_panel
from rgbd_dic_processing.core.regions_file import load_regions

SUBSET = 31
needs_open3d = pytest.mark.skipif(find_spec("open3d") is None, reason="open3d-cpu is not installed")


def laboratory(**groups: dict) -> Laboratory:
    groups = {"camera": {"scale": 0.5}, "tof": {"scale": 0.5}, **groups}
    return Laboratory(laboratory_settings("laboratory", {"seed": 3, **groups}))


def cloud(lab: Laboratory, time_s: float) -> np.ndarray:
    """ToF points in the camera frame."""
    depth, calibration = lab.depth(time_s, 1).depth_m, lab.calibration
    seen = np.isfinite(depth)
    points = lab.tof_model.rays[seen] * depth[seen][:, None]
    return points @ calibration.R_camera_tof.T + calibration.t_camera_tof


def found(lab: Laboratory, time_s: float = 0.4):
    return find_panel(cloud(lab, time_s), lab.calibration, SUBSET, PanelFindingSettings())


def true_outline(lab: Laboratory, time_s: float) -> np.ndarray:
    """Of the panel in the raw image, (N, 1, 2)."""
    s, along = lab.settings.panel, np.linspace(-1, 1, 30)
    side = np.ones(30)
    x = np.concatenate([along, side, -along, -side]) * s.width_m / 2
    y = np.concatenate([-side, along, side, -along]) * s.height_m / 2
    return lab.project(x, y, time_s).astype(np.float32)[:, None]


@needs_open3d
@pytest.mark.parametrize(
    "groups",
    [
        {},
        {"motion": {"distance_m": 2.6, "yaw_rad": 0.3, "pitch_rad": 0.2, "roll_rad": 0.3}, "panel": {"width_m": 1.0}},
        {"panel": {"width_m": 0.6, "height_m": 0.5, "wall_offset_m": 0.3}},
    ],
    ids=["square", "slanting", "small"],
)
def test_outline_lies_inside_the_panel(groups: dict) -> None:
    """At least half a subset and the flying pixels, two of 9.4 px, inside; and no farther than twice as much."""
    lab = laboratory(**groups)
    panel, true = found(lab), true_outline(lab, 0.4)
    inside = [cv2.pointPolygonTest(true, tuple(map(float, corner)), True) for corner in panel.outline_px]
    margin = SUBSET / 2 + 2 * 9.4 * 0.8  # pixels lie closer where the panel is farther or slants
    assert min(inside) > margin
    assert max(inside) < 2.5 * margin * np.sqrt(2)  # at a corner, both sides count
    assert len(panel.outline_px) <= 8
    share = cv2.contourArea(true) / (lab.calibration.camera.width * lab.calibration.camera.height)
    assert panel.share == pytest.approx(share, rel=0.15)
    assert panel.distance_m == pytest.approx(lab.pose(0.4).t @ lab.pose(0.4).R[:, 2], abs=0.006)


@needs_open3d
@pytest.mark.parametrize(
    ("groups", "said"),
    [
        ({"motion": {"distance_m": 1.5}}, "leaves the image with"),
        ({"obstacle": {"width_m": 0.2, "start_s": 0.0, "crossing_s": 0.8}}, "two planes are about as likely"),
        ({"panel": {"width_m": 0.2, "height_m": 0.2, "wall_offset_m": 5.0}}, "no plane covers 10% of the image"),
    ],
    ids=["too near", "bar before it", "too small"],
)
def test_refused(groups: dict, said: str) -> None:
    with pytest.raises(MeasurementError, match=said) as refusal:
        found(laboratory(**groups))
    assert "draw the panel into regions.yaml" in str(refusal.value)


@needs_open3d
@pytest.mark.parametrize(("every", "said"), [(1, "lie on it"), (4, "no plane covers")])
def test_no_plane_at_all(every: int, said: str) -> None:
    """Points all over the space. If they are dense, a slice of them covers the image, but most are not on it."""
    lab = laboratory()
    points = cloud(lab, 0.4)[::every]
    scattered = points * np.random.default_rng(1).uniform(0.5, 1.2, (len(points), 1))
    with pytest.raises(MeasurementError, match=said):
        find_panel(scattered, lab.calibration, SUBSET, PanelFindingSettings())


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A quarter of a second in the laboratory, without regions."""
    path = tmp_path_factory.mktemp("laboratory") / "bag"
    small = {"camera": {"scale": 0.5}, "tof": {"scale": 0.5}, "duration_s": 0.15, "seed": 3}
    simulate_laboratory(laboratory_settings("laboratory", small), path)
    (path / "regions.yaml").rename(path.parent / "drawn.yaml")
    return path


@needs_open3d
def test_process_without_a_panel(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """The found panel is written into the results, the other entries are kept, and the run can be repeated with it."""
    drawn = yaml.safe_load((bag.parent / "drawn.yaml").read_text())
    del drawn["panel"]
    (tmp_path / "crack_only.yaml").write_text(yaml.safe_dump(drawn))
    options = ["--regions", str(tmp_path / "crack_only.yaml"), "--out", str(tmp_path / "one")]
    assert main(["process", str(bag), *options]) == 0
    assert "panel found: 5" in capsys.readouterr().out
    written = tmp_path / "one" / "regions.yaml"
    assert yaml.safe_load(written.read_text())["crack"] == drawn["crack"]
    assert main(["process", str(bag), "--regions", str(written), "--out", str(tmp_path / "two")]) == 0
    first, second = ((tmp_path / name / "crack_opening.csv").read_bytes() for name in ("one", "two"))
    assert first == second


@needs_open3d
def test_find_panel_command(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    out = tmp_path / "regions.yaml"
    assert main(["find-panel", str(bag), "--out", str(out)]) == 0
    assert cv2.imread(str(tmp_path / "regions.png")).shape == (540, 720, 3)
    panel = load_regions(out).panel
    drawn = load_regions(bag.parent / "drawn.yaml").panel
    overlap, _ = cv2.intersectConvexConvex(panel.astype(np.float32), drawn.astype(np.float32))
    assert overlap > 0.95 * cv2.contourArea(panel.astype(np.float32))
    assert main(["find-panel", str(bag), "--out", str(out)]) == 1
    assert "exists already" in capsys.readouterr().err


def test_without_open3d(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    assert main(["process", str(bag), "--out", str(tmp_path / "out")]) == 1
    message = capsys.readouterr().err
    assert "pip install open3d-cpu" in message and "draw the panel into regions.yaml" in message
