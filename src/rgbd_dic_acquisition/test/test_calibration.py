"""calibration.yaml: what is written comes back, and what is missing or malformed is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rgbd_dic_acquisition.calibration import Calibration, Camera, load_calibration, save_calibration
from rgbd_dic_acquisition.errors import CalibrationError
from scipy.spatial.transform import Rotation

CAMERA = Camera(480, 360, 819.5, 822.0, 239.5, 179.5, 0.0084, 0.0843)
TOF = Camera(160, 120, 130.3, 130.5, 79.5, 59.5)
TURNED = Rotation.from_euler("xyz", (3, -2, 5), degrees=True).as_matrix()
MOVED = np.array([-0.026, -0.067, 0.061])


@pytest.mark.parametrize("tof", [TOF, None])
@pytest.mark.parametrize("R", [TURNED, np.eye(3)])
@pytest.mark.parametrize("t", [MOVED, np.zeros(3)])
def test_written_and_read_back(tmp_path: Path, tof: Camera | None, R: np.ndarray, t: np.ndarray) -> None:
    """Also without intrinsics of the ToF sensor, as for point clouds, and with a translation alone."""
    save_calibration(Calibration(CAMERA, tof, R, t), tmp_path / "c.yaml")
    read = load_calibration(tmp_path / "c.yaml")
    assert (read.camera, read.tof) == (CAMERA, tof)
    np.testing.assert_allclose(read.R_camera_tof, R, atol=1e-15)
    np.testing.assert_array_equal(read.t_camera_tof, t)


def test_thesis_extrinsics_with_four_digits_become_a_rotation(tmp_path: Path) -> None:
    """Table 4.5 is orthonormal to its last digit only."""
    printed = [[0.9996, -0.0036, 0.0271], [0.0044, 0.9995, -0.0309], [-0.0270, 0.0310, 0.9992]]
    save_calibration(Calibration(CAMERA, TOF), tmp_path / "c.yaml")
    text = (tmp_path / "c.yaml").read_text().split("T_camera_tof:\n  rotation")[0].rstrip()
    (tmp_path / "c.yaml").write_text(f"{text}\nT_camera_tof: {{rotation: {printed}, translation_m: [0, 0, 0]}}\n")
    R = load_calibration(tmp_path / "c.yaml").R_camera_tof
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(R, printed, atol=1e-3)


@pytest.mark.parametrize(
    "text, said",
    [
        ("[]", "needs an entry 'camera'"),
        ("camera: {image_size_px: [4, 3], focal_length_px: [0, 0], principal_point_px: [1, 1]}", "uncalibrated"),
        ("camera: {image_size_px: [4, 3]}", "focal_length_px"),
        ("camera: [", "cannot read calibration"),
    ],
)
def test_malformed_files_are_refused_by_name(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "c.yaml").write_text(text)
    with pytest.raises(CalibrationError) as error:
        load_calibration(tmp_path / "c.yaml")
    assert said in str(error.value) and "c.yaml" in str(error.value)


def test_tof_without_extrinsics_is_refused(tmp_path: Path) -> None:
    save_calibration(Calibration(CAMERA, TOF), tmp_path / "c.yaml")
    (tmp_path / "c.yaml").write_text((tmp_path / "c.yaml").read_text().split("\nT_camera_tof:")[0])
    with pytest.raises(CalibrationError, match="T_camera_tof"):
        load_calibration(tmp_path / "c.yaml")


@pytest.mark.parametrize("scale", [-1.0, 2.0])
def test_no_rotation_is_refused(scale: float) -> None:
    with pytest.raises(CalibrationError, match="rotation"):
        Calibration(CAMERA, TOF, scale * np.eye(3), MOVED)
