"""A calibration board in front of both sensors: images, ToF intensity and depth with exactly known geometry."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..calibration import Calibration, Camera, pixel_rays
from ..settings import Settings, setting
from .motion import CrackState, Pose
from .scene import CrackedPanel, PanelSettings
from .sensors import CameraModel, CameraSettings, TofModel, TofSettings
from .speckle import FlatPattern

Array = NDArray[np.float64]

CELLS = 8  # a side of a ChArUco square; its marker, with border, has six
STILL = CrackState()


class CharucoPattern:
    """A ChArUco board centred on the origin: `rows` x `cols` squares, markers of 4 x 4 bits in the light ones.

    A marker's side is 6/8 of a square's, so that its bits fall on a lattice of an eighth of a square.
    """

    def __init__(self, rows: int, cols: int, square_m: float, dark: float = 20.0, light: float = 225.0) -> None:
        self.rows, self.cols, self.square_m = rows, cols, square_m
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250)
        board = cv2.aruco.CharucoBoard((cols, rows), square_m, self.marker_m, dictionary)
        cells = board.generateImage((cols * CELLS, rows * CELLS), marginSize=0, borderBits=1)
        self._cells = np.where(np.pad(cells, CELLS, constant_values=255) > 127, light, dark)  # the margin is light

    @property
    def marker_m(self) -> float:
        return self.square_m * 6 / CELLS

    def grey(self, x_m: Array, y_m: Array) -> Array:
        col, row = self._position(x_m, y_m)
        rows, cols = self._cells.shape
        return self._cells[
            np.clip(np.floor(row).astype(int) + CELLS, 0, rows - 1),
            np.clip(np.floor(col).astype(int) + CELLS, 0, cols - 1),
        ]

    def uniform(self, x_m: Array, y_m: Array, reach_m: Array) -> NDArray[np.bool_]:
        col, row = self._position(x_m, y_m)
        reach = reach_m * CELLS / self.square_m
        return (np.abs(col - np.rint(col)) > reach) & (np.abs(row - np.rint(row)) > reach)

    def _position(self, x_m: Array, y_m: Array) -> tuple[Array, Array]:
        """In cells from the upper left corner of the squares."""
        return (
            x_m * CELLS / self.square_m + self.cols * CELLS / 2,
            y_m * CELLS / self.square_m + self.rows * CELLS / 2,
        )


@dataclass(frozen=True)
class BoardSettings(Settings):
    """How the sensors see a board."""

    margin_m: float = setting(0.04, unit="m", low=0.0, high=1.0, doc="light margin around the squares")
    camera_blur_px: float = setting(0.7, unit="px", low=0.0, high=100.0, doc="Gaussian blur of the camera's lens")
    tof_blur_px: float = setting(0.5, unit="px", low=0.0, high=100.0, doc="Gaussian blur of the ToF sensor's lens")
    camera_noise: float = setting(1.5, unit="grey levels", low=0.0, high=100.0, doc="standard deviation of a pixel")
    tof_noise: float = setting(2.0, unit="grey levels", low=0.0, high=100.0, doc="standard deviation of a pixel")
    range_noise_m: float = setting(0.005, unit="m", low=0.0, high=1.0, doc="standard deviation along a ToF ray")
    range_bias_m: float = setting(0.0, unit="m", low=-1.0, high=1.0, doc="added to every range along a ToF ray")


@dataclass(frozen=True)
class BoardFrame:
    """What both sensors saw at once: (rows, cols) grey levels, and depth along z [m], NaN for none."""

    camera: NDArray[np.uint8]
    tof: NDArray[np.uint8]
    depth_m: Array


class BoardRig:
    """Renders a board, in the plane z = 0 of its pose and centred on its origin."""

    def __init__(self, calibration: Calibration, pattern: FlatPattern, settings: BoardSettings | None = None) -> None:
        if calibration.tof is None:
            raise ValueError("a rig needs the calibration of its ToF sensor")
        self.calibration, self.settings = calibration, settings or BoardSettings()
        s, tof = self.settings, calibration.tof
        self.width_m, self.height_m = (n * pattern.square_m + 2 * s.margin_m for n in (pattern.cols, pattern.rows))
        self._scene = CrackedPanel(PanelSettings(self.width_m, self.height_m, gap_m=0.0), pattern)
        self._camera, self._intensity = (
            CameraModel(c, CameraSettings(c.width, c.height, supersampling=8)) for c in (calibration.camera, tof)
        )
        self._tof = TofModel(calibration, TofSettings(tof.width, tof.height, range_noise_m=s.range_noise_m))
        self._ray_length = np.linalg.norm(pixel_rays(tof), axis=-1)

    def expose(self, T_camera_board: Pose, rng: np.random.Generator) -> BoardFrame:
        """Both images and the depth of a board at rest."""
        s, T_tof_board = self.settings, self._tof.pose(T_camera_board)
        frame = self._tof.expose(self._scene, T_camera_board, STILL, rng)
        return BoardFrame(
            self._exposed(self._camera, T_camera_board, s.camera_blur_px, s.camera_noise, rng),
            self._exposed(self._intensity, T_tof_board, s.tof_blur_px, s.tof_noise, rng),
            frame.depth_m + s.range_bias_m / self._ray_length,
        )

    def _exposed(
        self, model: CameraModel, pose: Pose, blur_px: float, noise: float, rng: np.random.Generator
    ) -> NDArray[np.uint8]:
        light = model.radiance(self._scene, pose, STILL)
        if blur_px > 0:
            light = cv2.GaussianBlur(light, (0, 0), blur_px)
        return np.clip(np.rint(light + noise * rng.standard_normal(light.shape)), 0, 255).astype(np.uint8)


def board_poses(
    camera: Camera,
    size_m: tuple[float, float],
    count: int,
    rng: np.random.Generator,
    distance_m: tuple[float, float] = (1.2, 2.0),
    tilt_rad: tuple[float, float] = (0.2, 0.5),
) -> list[Pose]:
    """T_camera_board of boards of this size (width, height), wholly in the camera's view: spread over it, tilted in
    turn about both axes and to both sides."""
    half = np.array([camera.width, camera.height]) / 2
    outline = 0.5 * np.array([(x * size_m[0], y * size_m[1], 0) for x in (-1, 1) for y in (-1, 1)])
    poses = []
    for index in range(count):
        side = np.array([(-1, -1), (1, -1), (-1, 1), (1, 1), (0, 0)][index % 5], float)
        lean = np.array([(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1)][index % 7], float)
        yaw, pitch = lean * rng.uniform(*tilt_rad, 2)
        turn = Rotation.from_euler("yxz", [yaw, pitch, rng.uniform(-0.3, 0.3)]).as_matrix()
        distance = rng.uniform(*distance_m)
        for outward in np.linspace(rng.uniform(0.7, 1.0), 0.0, 50):
            centre = np.array([[camera.cx, camera.cy]]) + outward * side * half
            pose = Pose(turn, distance * camera.rays(centre)[0])
            seen = camera.distort(camera.project(outline @ turn.T + pose.t))
            if np.all((seen > 4) & (seen < [camera.width - 5, camera.height - 5])):
                break
        poses.append(pose)
    return poses
