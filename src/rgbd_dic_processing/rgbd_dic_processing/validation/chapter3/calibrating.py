"""The simulated camera calibrated as in the thesis: 28 views of a checkerboard of 15 x 20 squares of 50 mm (3.1.3)."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import MeasurementError
from rgbd_dic_acquisition.simulator.motion import CrackState, thesis_pose
from rgbd_dic_acquisition.simulator.scene import CrackedPanel, PanelSettings
from rgbd_dic_acquisition.simulator.sensors import CameraModel, CameraSettings
from rgbd_dic_acquisition.simulator.speckle import Checkerboard

from .rendering import exposed
from .shots import CAMERA

Array = NDArray[np.float64]

VIEWS = 28
BOARD = Checkerboard(rows=15, cols=20, square_m=0.05)
MARGIN_M = 0.05  # light border around the squares
SUPERSAMPLING = 10
CORNERS = (BOARD.cols - 1, BOARD.rows - 1)


def board_poses() -> list[tuple[tuple[float, float, float], tuple[float, float, float]]]:
    """Thesis angles [degrees] and positions [mm] of the views: tilted, and all over the image."""
    random = np.random.default_rng(28)
    half = np.array([BOARD.cols, BOARD.rows]) * BOARD.square_m / 2 + MARGIN_M
    corners = np.array([(x, y, 0) for x in (-half[0], half[0]) for y in (-half[1], half[1])])
    poses = []
    while len(poses) < VIEWS:
        angles = np.round(random.uniform((-30, -30, -20), (30, 30, 20)), 1)
        distance, aim = random.uniform(900, 1900), random.uniform((100, 60), (1180, 660))
        turn = thesis_pose(angles, (0, 0, 0)).R
        towards = turn.T @ CAMERA.rays(aim[None])[0]
        x, y = distance * towards[:2] / towards[2]
        at = (float(round(1000 - distance)), float(round(x)), float(round(y)))
        pose = thesis_pose(angles, at)
        seen = CAMERA.project(corners @ pose.R.T + pose.t)
        if np.all((seen > 4) & (seen < [CAMERA.width - 5, CAMERA.height - 5])):
            poses.append((tuple(float(angle) for angle in angles), at))
    return poses


def board_image(number: int) -> NDArray[np.uint8]:
    """One view, supersampled and rounded to 8 bits."""
    half = np.array([BOARD.cols, BOARD.rows]) * BOARD.square_m / 2 + MARGIN_M
    sheet = PanelSettings(width_m=float(2 * half[0]), height_m=float(2 * half[1]), gap_m=0.0)
    model = CameraModel(CAMERA, CameraSettings(CAMERA.width, CAMERA.height, SUPERSAMPLING), workers=1)
    pose = thesis_pose(*board_poses()[number])
    return exposed(model.radiance(CrackedPanel(sheet, BOARD), pose, CrackState()))


def board_corners(number: int) -> Array:
    """The inner corners (N, 2) found in a view [px], row by row.

    Raises:
        MeasurementError: if they are not found.
    """
    image = board_image(number)
    found, corners = cv2.findChessboardCornersSB(image, CORNERS, flags=cv2.CALIB_CB_ACCURACY)
    if not found:
        raise MeasurementError(f"the checkerboard was not found in view {number}")
    grid = corners.reshape(CORNERS[1], CORNERS[0], 2)
    square = min(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1))
    half = int(min(0.45 * square, 7))  # the sector method of the search is biased; this is not, within one square
    corners = cv2.cornerSubPix(image, corners, (half, half), (-1, -1), (3, 200, 1e-5)).reshape(-1, 2).astype(float)
    # the board looks the same upside down: the first corner is the one nearest to where the board's first is
    pose = thesis_pose(*board_poses()[number])
    true = CAMERA.project(np.column_stack([BOARD.corners_m, np.zeros(len(BOARD.corners_m))]) @ pose.R.T + pose.t)
    return corners if np.linalg.norm(corners[0] - true[0]) < np.linalg.norm(corners[-1] - true[0]) else corners[::-1]


def calibrate(corners: list[Array]) -> dict[str, Any]:
    """Camera matrix, k1 and k2 from the corners of all views (Zhang 2000, by OpenCV); no tangential distortion."""
    board = np.column_stack([BOARD.corners_m, np.zeros(len(BOARD.corners_m))]).astype(np.float32)
    rms, K, distortion, *_, deviations, _, _ = cv2.calibrateCameraExtended(
        [board] * len(corners),
        [points.astype(np.float32).reshape(-1, 1, 2) for points in corners],
        (CAMERA.width, CAMERA.height),
        None,
        None,
        flags=cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3,
    )
    k1, k2 = distortion.ravel()[:2]
    values = [K[0, 0], K[1, 1], K[0, 2], K[1, 2], k1, k2]
    return {
        "values": [float(v) for v in values],
        "sigma": [float(v) for v in deviations.ravel()[:6]],
        "rms_px": float(rms),
    }


def calibrated_camera(calibration: dict[str, Any]) -> Camera:
    return Camera(CAMERA.width, CAMERA.height, *calibration["values"])
