"""What moves: the hand-held rig in front of the panel, and the crack."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..settings import Settings, setting

Array = NDArray[np.float64]

SINES = 8  # a degree of freedom

# The wall faces south: the panel's x is east, its y is down, its z is north.
R_WORLD_PANEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
# Camera looks along the body's x (forward, left, up); columns are the body's axes in the optical frame.
R_CAMERA_BODY = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


@dataclass(frozen=True)
class Pose:
    """Of the panel in a sensor's optical frame: X_sensor = R X_panel + t [m]."""

    R: Array
    t: Array


@dataclass(frozen=True)
class CrackState:
    """Displacement of the right plate against the left one since the reference, in the crack's axes [m]."""

    opening_m: float = 0.0
    sliding_m: float = 0.0
    out_of_plane_m: float = 0.0


@dataclass(frozen=True)
class MotionSettings(Settings):
    """Where the camera is on average and how it sways: band-limited, in six degrees of freedom."""

    distance_m: float = setting(1.2, unit="m", low=0.1, high=100.0, doc="average distance from the panel")
    yaw_rad: float = setting(0.08, unit="rad", low=-1.2, high=1.2, doc="average angle about the camera's y")
    pitch_rad: float = setting(-0.05, unit="rad", low=-1.2, high=1.2, doc="average angle about its x")
    roll_rad: float = setting(0.02, unit="rad", low=-3.2, high=3.2, doc="average angle about its z")
    sway_m: float = setting(0.008, unit="m", low=0.0, high=10.0, doc="RMS shift along each camera axis")
    sway_rad: float = setting(0.010, unit="rad", low=0.0, high=1.0, doc="RMS turn about each camera axis")
    low_hz: float = setting(0.3, unit="Hz", low=0.01, high=100.0, doc="lowest frequency of the sway")
    high_hz: float = setting(3.0, unit="Hz", low=0.01, high=100.0, doc="highest frequency of the sway")


@dataclass(frozen=True)
class CrackSettings(Settings):
    """How the crack ends. On the way it opens, closes a little and opens again."""

    opening_m: float = setting(1.0e-3, unit="m", low=-1.0, high=1.0, doc="final opening")
    sliding_m: float = setting(0.3e-3, unit="m", low=-1.0, high=1.0, doc="final sliding")
    out_of_plane_m: float = setting(0.2e-3, unit="m", low=-1.0, high=1.0, doc="final step into the wall")
    still_s: float = setting(0.1, unit="s", low=0.0, high=1e4, doc="time without motion at the start")


class HandheldMotion:
    """T_camera_panel over time: an average pose and, for each degree of freedom, a sum of sines as 1/f."""

    def __init__(self, settings: MotionSettings, rng: np.random.Generator) -> None:
        s = settings
        tilt = Rotation.from_euler("yxz", [s.yaw_rad, s.pitch_rad, s.roll_rad])
        self._average = Pose(tilt.as_matrix(), np.array([0.0, 0.0, s.distance_m]))
        low, high = np.log(s.low_hz), np.log(max(s.high_hz, s.low_hz))
        self._frequency = np.exp(rng.uniform(low, high, (6, SINES)))
        self._phase = rng.uniform(0, 2 * np.pi, (6, SINES))
        weight = 1.0 / self._frequency
        rms = np.repeat([s.sway_m, s.sway_rad], 3)
        self._amplitude = weight * (rms / np.sqrt(np.sum(weight**2, axis=1) / 2))[:, None]

    def pose(self, time_s: float) -> Pose:
        """T_camera_panel at a time of the flight."""
        sway = np.sum(self._amplitude * np.sin(2 * np.pi * self._frequency * time_s + self._phase), axis=1)
        turn = Rotation.from_rotvec(sway[3:]).as_matrix()
        return Pose(turn @ self._average.R, turn @ self._average.t + sway[:3])


def thesis_pose(orientation_deg: Array, position_mm: Array, panel_distance_m: float = 1.0) -> Pose:
    """T_camera_panel from the numbers of the thesis' simulator (Tables 3.1 and 3.2).

    Yaw, pitch and roll are left-handed on a body (forward, left, up) in a world x forward, y left, z up:
    R_world_body = Rz(-yaw) Ry(-pitch) Rx(-roll). The panel's origin, on the crack, is at world (1, 0, 0) m.
    """
    yaw, pitch, roll = orientation_deg
    R_world_body = Rotation.from_euler("ZYX", [-yaw, -pitch, -roll], degrees=True).as_matrix()
    R_camera_world = R_CAMERA_BODY @ R_world_body.T
    to_panel = np.array([panel_distance_m, 0.0, 0.0]) - np.asarray(position_mm, float) * 1e-3
    return Pose(R_camera_world @ R_CAMERA_BODY.T, R_camera_world @ to_panel)


def crack_state(settings: CrackSettings, time_s: float, duration_s: float) -> CrackState:
    """The crack at a time of a flight of this duration: exactly 0 at first, the final values at its end."""
    moving_s = max(duration_s - settings.still_s, 1e-9)
    part = float(np.clip((time_s - settings.still_s) / moving_s, 0.0, 1.0))
    rise = part**3 * (10 + part * (6 * part - 15))
    return CrackState(
        settings.opening_m * rise * (0.72 + 0.28 * np.cos(4 * np.pi * part)),
        settings.sliding_m * rise * (0.85 + 0.15 * np.cos(6 * np.pi * part)),
        settings.out_of_plane_m * rise * (0.80 + 0.20 * np.cos(2 * np.pi * part)),
    )


def attitude(pose: Pose) -> Array:
    """R_world_body (3, 3) of the vehicle: world east, north, up; body forward, left, up."""
    return R_WORLD_PANEL @ pose.R.T @ R_CAMERA_BODY
