"""rgbd-dic plane: the files of a plane in the simulated laboratory, against its true pose."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from plyfile import PlyData
from rgbd_dic_acquisition.bag import BagReader, BagWriter
from rgbd_dic_acquisition.simulator.laboratory import Laboratory, LaboratorySettings, laboratory_settings
from rgbd_dic_acquisition.simulator.laboratory_bag import simulate_laboratory
from rgbd_dic_processing.cli import main
from rgbd_dic_processing.core.regions_file import load_regions
from rgbd_dic_processing.core.settings import ProcessingSettings
from rgbd_dic_processing.plane_view import PlaneView, view_plane
from rgbd_dic_processing.recorded import calibration_of

AT_S = 0.1


@pytest.fixture(scope="module")
def settings() -> LaboratorySettings:
    values = {"camera": {"scale": 0.5}, "tof": {"scale": 0.5}, "duration_s": 0.2, "seed": 4}
    return laboratory_settings("laboratory", values)


@pytest.fixture(scope="module")
def bag(settings: LaboratorySettings, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("laboratory") / "bag"
    simulate_laboratory(settings, path)
    return path


@pytest.fixture(scope="module")
def view(bag: Path) -> PlaneView:
    with BagReader(bag) as reader:
        calibration = calibration_of(reader, bag / "calibration.yaml")
        return view_plane(reader, calibration, load_regions(bag / "regions.yaml"), ProcessingSettings(), AT_S)


def test_numbers_against_the_true_pose(view: PlaneView, settings: LaboratorySettings) -> None:
    """Within three of the stated standard deviations; the bow and the bulge move the mean plane by 0.5 mm at most."""
    pose = Laboratory(settings).pose(AT_S)
    normal, distance = pose.R[:, 2], pose.t @ pose.R[:, 2]
    u = view.uncertainty(view.plane.covariance + view.systematic)
    assert abs(-view.plane.d - distance) < 3 * u[0] + 5e-4 and 0.002 < u[0] < 0.006
    true_tilts = np.arctan2(normal[:2], normal[2])
    assert np.all(np.abs(view.tilts_rad - true_tilts) < 3 * u[1:]) and np.all(u[1:] < 0.003)
    assert np.all(view.uncertainty(view.plane.covariance) < u)
    assert view.rms_m == pytest.approx(0.005, abs=0.0007)
    assert np.std(view.residuals_m[view.inliers]) == pytest.approx(view.rms_m, rel=0.01)


def test_files(bag: Path, view: PlaneView, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert main(["plane", str(bag), "--at", str(AT_S), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert f"points on the panel: {len(view.selection_m)}" in said and "standard uncertainty" in said
    ply = {name: PlyData.read(str(tmp_path / "out" / f"{name}.ply")) for name in ("cloud", "selection", "plane")}
    assert ply["cloud"]["vertex"].count == len(view.cloud_m)
    rows = ply["selection"]["vertex"]
    np.testing.assert_allclose(np.column_stack([rows[name] for name in "xyz"]), view.selection_m, atol=1e-6)
    assert rows["red"][0] > 2 * rows["green"][0]
    corners = np.column_stack([ply["plane"]["vertex"][name] for name in "xyz"])
    np.testing.assert_allclose(corners @ view.plane.normal + view.plane.d, 0, atol=1e-6)
    assert ply["plane"]["face"]["vertex_indices"][0].tolist() == [0, 1, 2, 3]
    sides = np.linalg.norm(corners[1] - corners[0]), np.linalg.norm(corners[2] - corners[1])
    np.testing.assert_allclose(sides, (1.14, 0.54), atol=0.05)  # the drawn region
    assert cv2.imread(str(tmp_path / "out" / "plane.png")).shape[1] > 1000


def test_bad_input(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    blind = tmp_path / "blind"
    with BagReader(bag) as source, BagWriter(blind) as target:
        for topic, log_time_ns, message in source.messages(["/camera/image_raw", "/camera/camera_info"]):
            target.add_topic(topic, source.topics[topic].type)
            target.write_message(topic, log_time_ns, message)
    files = ["--regions", str(bag / "regions.yaml"), "--calibration", str(bag / "calibration.yaml")]
    out = ["--out", str(tmp_path / "out")]
    assert main(["plane", str(blind), *files, *out]) == 1
    assert "has no topic tof/depth/image_raw" in capsys.readouterr().err
    assert main(["plane", str(bag), "--at", "7", *out]) == 1
    assert "no readable image at or after that time" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["plane", str(bag), "--at", "-1", *out])
    assert not (tmp_path / "out").exists()
