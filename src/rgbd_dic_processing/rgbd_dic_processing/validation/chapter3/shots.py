"""The images of chapter 3: camera, panel, patterns and poses (thesis 3.1 and 3.2)."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.simulator.motion import Pose, thesis_pose
from rgbd_dic_acquisition.simulator.scene import PanelSettings
from rgbd_dic_acquisition.simulator.speckle import SpeckleSettings

Array = NDArray[np.float64]

# A sensor of 1.6 x 0.9 mm behind 0.8 mm, 1280 x 720 px (3.1.2): f = 640 px, centre in the middle.
CAMERA = Camera(1280, 720, 640.0, 640.0, 639.5, 359.5)
PANEL = PanelSettings(width_m=1.0, height_m=1.0, gap_m=0.0)  # two plates of 0.5 x 1 m (3.1.1)
FOOTPRINT_M = 1 / 640  # of a pixel on the panel, 1 m away

# The dots are 50 px wide in an image that is binned by 10: 5 px. Those of the band-limited pattern are 4 px wide at
# half height, so that nothing is left above the Nyquist frequency, and fill the range of 8 bits without clipping.
PATTERNS = {
    "disks": SpeckleSettings(kind="disks", size_m=5 * FOOTPRINT_M, spacing=1.3, variability=0.49),
    "blobs": SpeckleSettings(
        kind="blobs", size_m=4 * FOOTPRINT_M, spacing=1.45, variability=0.3, dark=5.0, light=250.0
    ),
}
SUPERSAMPLING = {"disks": 10, "blobs": 1}  # rays a pixel in x and in y; a band-limited pattern is sampled at its middle


@dataclass(frozen=True)
class Shot:
    """One image: thesis angles [yaw, pitch, roll] in degrees, camera position in mm, crack in mm.

    series: what varies in it (reference, yaw, pitch, roll, crack A, crack B).
    """

    number: int
    orientation_deg: tuple[float, float, float]
    position_mm: tuple[float, float, float]
    crack_mm: float = 0.0
    series: str = "reference"
    camera: Camera = field(default=CAMERA)

    @property
    def pose(self) -> Pose:
        """T_camera_panel."""
        return thesis_pose(self.orientation_deg, self.position_mm)

    @property
    def angle_deg(self) -> float:
        """The angle that its series varies."""
        return self.orientation_deg[("yaw", "pitch", "roll").index(self.series)]

    def as_dict(self) -> dict[str, Any]:
        """Of all that the image depends on."""
        camera = self.camera
        lens = [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, camera.k1, camera.k2]
        return {
            "orientation": list(self.orientation_deg),
            "position": list(self.position_mm),
            "crack": self.crack_mm,
            "camera": lens,
        }


REFERENCES = tuple(
    Shot(number, *pose)
    for number, pose in enumerate(
        [  # Table 3.1
            ((1.0, -0.5, -1.0), (3.0, 1.0, -2.0)),
            ((5.0, 1.0, 2.0), (-5.0, 10.0, 2.0)),
            ((-5.0, 1.0, -2.0), (-5.0, -12.0, -4.0)),
            ((1.0, 5.0, -2.0), (-35.0, -5.0, -55.0)),
            ((-1.0, -5.0, 1.0), (-22.0, 5.0, 78.0)),
            ((1.0, 2.0, 5.0), (-20.0, 4.0, -15.0)),
            ((1.0, -2.0, -5.0), (-20.0, 4.0, 12.0)),
        ]
    )
)

_YAW = [  # Table 3.2
    ((3, 1, 1), (-4, 10, 6)),
    ((6, 1, 2), (-8, 20, 6)),
    ((9, -1, -2), (-15, 65, -2)),
    ((12, -1, 3), (-25, 105, 42)),
    ((15, 0, 1), (-32, 202, 22)),
    ((-3, 1, -1), (-4, -15, 6)),
    ((-6, 2, -1), (-10, -29, -9)),
    ((-9, 0, -2), (-13, -85, -1)),
    ((-12, 1, -2), (-25, -139, -2)),
    ((-15, 1, -2), (-32, -222, 2)),
]
CRACKS_MM = (2.0, 5.0, 10.0, 20.0, 50.0)
_CRACK_POSES = {  # the thesis does not list the poses of its two sets (3.2.3)
    "crack A": ((4.0, -2.0, 1.5), (-30.0, 40.0, 25.0)),
    "crack B": ((-6.0, 5.0, -2.0), (-45.0, -60.0, -70.0)),
}


def moving_shots() -> tuple[Shot, ...]:
    """The 30 images with a crack of 10 mm: numbers 7 to 36 (3.2.2)."""
    shots = [Shot(7 + i, _floats(angles), _floats(at), 10.0, "yaw") for i, (angles, at) in enumerate(_YAW)]
    random = np.random.default_rng(3)
    for axis, series in ((1, "pitch"), (2, "roll")):
        for angle in (3, 6, 9, 12, 15, -3, -6, -9, -12, -15):
            others = np.round(random.uniform(-2, 2, 3), 1)
            others[axis] = angle
            at = in_view(others, np.round(random.uniform(-8, 8, 2)))
            shots.append(Shot(7 + len(shots), _floats(others), at, 10.0, series))
    return tuple(shots)


def crack_shots() -> tuple[Shot, ...]:
    """The two sets of five images with a growing crack: numbers 37 to 46 (3.2.3)."""
    return tuple(
        Shot(37 + 5 * i + j, *pose, crack, series)
        for i, (series, pose) in enumerate(_CRACK_POSES.items())
        for j, crack in enumerate(CRACKS_MM)
    )


@functools.cache
def all_shots() -> dict[int, Shot]:
    """Every image with a crack, by its number."""
    return {shot.number: shot for shot in moving_shots() + crack_shots()}


def in_view(orientation_deg: Array, aside_mm: Array, camera: Camera = CAMERA) -> tuple[float, float, float]:
    """A position (whole mm) from which the panel, opened by 10 mm, is in the middle of the image and wholly in view."""
    border = np.linspace(-0.5, 0.5, 21)
    half = np.full(len(border), 0.5)
    edges = [(border, -half), (border, half), (-half, border), (half + 0.01, border)]
    panel = np.concatenate([np.column_stack([x, y, np.zeros(len(x))]) for x, y in edges])
    for back_mm in range(0, 3000, 5):
        turn = thesis_pose(orientation_deg, (0, 0, 0)).R
        ahead = turn.T @ np.array([0, 0, 1.0])  # the optical axis in panel coordinates
        distance = 1000.0 + back_mm
        right, down = -distance * ahead[:2] / ahead[2] + aside_mm
        at = (float(-back_mm), float(round(-right)), float(round(-down)))
        pose = thesis_pose(orientation_deg, at)
        seen = camera.distort(camera.project(panel @ pose.R.T + pose.t))
        if np.all((seen > 8) & (seen < [camera.width - 9, camera.height - 9])):
            return at
    raise ValueError(f"no position shows the whole panel at {orientation_deg} degrees")


def _floats(values: Any) -> tuple[float, float, float]:
    return tuple(float(value) for value in values)
