"""How the fixed region moved, image by image, and the panel's planes carried along that motion."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from .geometry import skew

Array = NDArray[np.float64]
Pose = tuple[Array, Array]
REMEMBERED = 1800  # images: half a minute at 60 Hz
LONGEST_GAP_S = 0.1  # between two images; across a longer one nothing is interpolated


class PanelMotion:
    """Poses X_image = R X_reference + t of the fixed region in the latest images, and at any time between two."""

    def __init__(self) -> None:
        self._stamps: deque[int] = deque(maxlen=REMEMBERED)
        self._poses: deque[Array] = deque(maxlen=REMEMBERED)

    def add(self, stamp_ns: int, pose: Pose) -> None:
        """The pose in the next image; one that is not later than those before begins anew, as its clock jumped back."""
        if self._stamps and stamp_ns <= self._stamps[-1]:
            self._stamps.clear()
            self._poses.clear()
        self._stamps.append(stamp_ns)
        self._poses.append(np.append(Rotation.from_matrix(pose[0]).as_rotvec(), pose[1]))

    def at(self, times_ns: Array, latest: int = REMEMBERED) -> tuple[Array, Array]:
        """R (M, 3, 3) and t (M, 3) [m] at times (M,) [ns], by a cubic spline through the latest images.

        t is NaN outside of what the images cover, and in gaps longer than LONGEST_GAP_S.
        """
        stamps = np.array(self._stamps, np.int64)[-latest:]
        poses = np.array(self._poses).reshape(-1, 6)[-latest:]
        found = np.full((len(times_ns), 6), np.nan)
        if len(stamps):
            times_s, images_s = (np.asarray(times_ns) - stamps[0]) * 1e-9, (stamps - stamps[0]) * 1e-9
            for run in np.split(np.arange(len(stamps)), np.flatnonzero(np.diff(images_s) > LONGEST_GAP_S) + 1):
                inside = (times_s >= images_s[run[0]]) & (times_s <= images_s[run[-1]])
                if len(run) > 1 and inside.any():
                    found[inside] = CubicSpline(images_s[run], poses[run])(times_s[inside])
        return Rotation.from_rotvec(np.nan_to_num(found[:, :3])).as_matrix(), found[:, 3:]


def carried_back(pi: Array, R: Array, t: Array) -> Array:
    """Planes pi . X = 1 (M, 3) [1/m] seen from poses R (M, 3, 3), t (M, 3), in the reference frame (M, 3)."""
    return np.einsum("mji,mj->mi", R, pi) / (1 - np.sum(pi * t, axis=1))[:, None]


def pose_sensitivity(pi: Array, pose: Pose) -> Array:
    """(3, 6): how a plane pi (3,) of the reference, carried to an image by a pose, moves with an error of that pose.

    The error is a rotation vector before R, and a shift of t. The plane is seen as q / (1 + q . t), q = R pi.
    """
    q, t = pose[0] @ pi, pose[1]
    length = 1 + q @ t
    by_q = np.eye(3) / length - np.outer(q, t) / length**2
    return np.hstack([by_q @ -skew(q), -np.outer(q, q) / length**2])
