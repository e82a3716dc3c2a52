"""Each sensor by itself, by OpenCV, and how the two see the same boards: where the adjustment starts from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import CalibrationError
from scipy.spatial.transform import Rotation

from .board import Board
from .detection import Found
from .model import Model

Array = NDArray[np.float64]


def calibrate_alone(views: Sequence[Found], board: Board, model: Model) -> tuple[Camera, list[tuple[Array, Array]]]:
    """One sensor by OpenCV (Zhang 2000): the camera, and R, t [m] of each board in it.

    Raises:
        CalibrationError: OpenCV finds no solution.
    """
    points = [board.corners_m[found.ids].astype(np.float32) for found in views]
    pixels = [found.corners_px.astype(np.float32) for found in views]
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3 | cv2.CALIB_USE_INTRINSIC_GUESS
    flags |= 0 if model.free_centre else cv2.CALIB_FIX_PRINCIPAL_POINT
    flags |= 0 if model.distortion else cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2
    size = (model.width, model.height)
    try:
        K = cv2.initCameraMatrix2D(points, pixels, size)
        if not np.all(np.isfinite(K)) or not 0.2 < K[0, 0] / model.width < 20:
            K = np.diag([1.5 * model.width, 1.5 * model.width, 1.0])
        K[:2, 2] = model.middle
        _, K, d, turns, shifts = cv2.calibrateCamera(points, pixels, size, K, np.zeros(5), flags=flags)
    except cv2.error as error:
        raise CalibrationError(f"the boards give no camera ({error.err}): take more images, tilted more") from error
    d = d.ravel()
    camera = Camera(model.width, model.height, K[0, 0], K[1, 1], K[0, 2], K[1, 2], d[0], d[1])
    return camera, [(cv2.Rodrigues(r)[0], t.ravel()) for r, t in zip(turns, shifts, strict=True)]


class RelativePoses(NamedTuple):
    """X_tof = R X_camera + t [m] from poses of the same boards in both sensors.

    Attributes:
        R, t: the typical one, so that some wrong ones do no harm.
        off_rad, off_m: (N,) by how much each board's own turn and shift differ from it.
    """

    R: Array
    t: Array
    off_rad: Array
    off_m: Array


def relative_poses(camera: Sequence[tuple[Array, Array]], tof: Sequence[tuple[Array, Array]]) -> RelativePoses:
    """From R, t [m] of each board in the camera and in the ToF sensor."""
    turns = Rotation.from_matrix([R_t @ R_c.T for (R_c, _), (R_t, _) in zip(camera, tof, strict=True)])
    apart = np.array([np.median((turns * turn.inv()).magnitude()) for turn in turns])
    turn = turns[np.argsort(apart)[: (len(apart) + 1) // 2]].mean()
    shifts = np.array([t_t - turn.apply(t_c) for (_, t_c), (_, t_t) in zip(camera, tof, strict=True)])
    t = np.median(shifts, axis=0)
    return RelativePoses(turn.as_matrix(), t, (turns * turn.inv()).magnitude(), np.linalg.norm(shifts - t, axis=1))
