"""What is estimated: the parameters of both cameras, the transform between them and the boards' poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera

from .detection import Found

Array = NDArray[np.float64]

LENS = ("fx", "fy", "cx", "cy", "k1", "k2")


@dataclass(frozen=True)
class Model:
    """What of a camera is estimated; the principal point is else the middle of the image, the distortion 0."""

    width: int
    height: int
    free_centre: bool
    distortion: bool

    @property
    def free(self) -> NDArray[np.int64]:
        """Indices into LENS."""
        return np.array([0, 1] + [2, 3] * self.free_centre + [4, 5] * self.distortion)

    @property
    def middle(self) -> tuple[float, float]:
        return (self.width - 1) / 2, (self.height - 1) / 2

    def camera(self, lens: Array) -> Camera:
        return Camera(self.width, self.height, *map(float, lens))


@dataclass(frozen=True)
class View:
    """One pose of the board, seen by the camera, the ToF sensor or both at once."""

    name: str
    camera: Found | None
    tof: Found | None = None

    def of(self, sensor: str) -> Found | None:
        return getattr(self, sensor)


class Projection(NamedTuple):
    """Raw pixels (N, 2), and their derivatives (2 N, k) by the k parameters in these columns; by others they are 0."""

    pixels: Array
    jacobian: Array
    columns: NDArray[np.int64]


class Layout:
    """Where what is among the adjustment's parameters: lenses, T_tof_camera, then a pose T_camera_board for each view.

    Rotations are rotation vectors [rad], translations metres.
    """

    def __init__(self, models: dict[str, Model], views: int) -> None:
        self.models = models
        self.lens: dict[str, slice] = {}
        at = 0
        for sensor, model in models.items():
            self.lens[sensor] = slice(at, at + len(model.free))
            at += len(model.free)
        self.transform = slice(at, at + 6 * ("tof" in models))
        self._poses_at = self.transform.stop
        self.size = self._poses_at + 6 * views

    def pose(self, view: int) -> slice:
        return slice(self._poses_at + 6 * view, self._poses_at + 6 * view + 6)

    def lens_of(self, parameters: Array, sensor: str) -> Array:
        """All six of LENS."""
        model = self.models[sensor]
        lens = np.array([0, 0, *model.middle, 0, 0], float)
        lens[model.free] = parameters[self.lens[sensor]]
        return lens

    def project(self, parameters: Array, view: int, sensor: str, points_m: Array) -> Projection:
        """Board points (N, 3) as a sensor sees them in a view."""
        pose, lens = parameters[self.pose(view)], self.lens_of(parameters, sensor)
        turn, shift, places, to_sensor = pose[:3], pose[3:], [self.pose(view)], [np.eye(6)]
        if sensor == "tof":
            T = parameters[self.transform]
            turn, shift, *d = cv2.composeRT(turn, shift, T[:3], T[3:])
            places.append(self.transform)
            d = np.array(d).reshape(2, 4, 3, 3)  # of turn and shift, by turn and shift of the one and of the other
            to_sensor = [d[:, part].transpose(0, 2, 1, 3).reshape(6, 6) for part in (np.s_[:2], np.s_[2:])]
        K = np.array([[lens[0], 0, lens[2]], [0, lens[1], lens[3]], [0, 0, 1]])
        pixels, d = cv2.projectPoints(points_m, turn, shift, K, np.array([lens[4], lens[5], 0, 0]))
        jacobian = np.hstack([*(d[:, :6] @ by for by in to_sensor), d[:, 6:12][:, self.models[sensor].free]])
        columns = np.concatenate([np.arange(place.start, place.stop) for place in (*places, self.lens[sensor])])
        return Projection(pixels.reshape(-1, 2), jacobian, columns)
