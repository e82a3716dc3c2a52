"""How the hand moves the rig, when frames are lost, and what passes in front of the panel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..settings import Settings, setting
from .motion import HandheldMotion, MotionSettings, Pose
from .timing import Ticks

# The thesis' distance is about 2 m; at 2.2 m all of the panel stays in the image of Table 4.4 while the hand sways.
HAND = MotionSettings(
    distance_m=2.2, yaw_rad=0.05, pitch_rad=-0.04, roll_rad=0.02, sway_m=0.010, sway_rad=0.006, low_hz=0.3, high_hz=3.0
)


@dataclass(frozen=True)
class OrbitSettings(Settings):
    """A slow swing around the panel's middle, on top of the hand's sway; it starts at zero."""

    yaw_rad: float = setting(0.0, unit="rad", low=-1.2, high=1.2, doc="largest angle about the panel's y")
    pitch_rad: float = setting(0.0, unit="rad", low=-1.2, high=1.2, doc="largest angle about the panel's x")
    roll_rad: float = setting(0.0, unit="rad", low=-3.2, high=3.2, doc="largest angle about the panel's z")
    frequency_hz: float = setting(
        0.11, unit="Hz", low=0.001, high=3.0, doc="of yaw; pitch has 1.3 times, roll 0.7 times of it"
    )


class LaboratoryMotion:
    """T_camera_panel over time: `HandheldMotion`, and the panel turned about its middle by the swing."""

    def __init__(self, hand: MotionSettings, orbit: OrbitSettings, rng: np.random.Generator) -> None:
        self._hand, self._orbit = HandheldMotion(hand, rng), orbit

    def pose(self, time_s: float) -> Pose:
        """T_camera_panel at a time of the flight."""
        pose, o = self._hand.pose(time_s), self._orbit
        largest = np.array([o.yaw_rad, o.pitch_rad, o.roll_rad])
        angles = largest * np.sin(2 * np.pi * o.frequency_hz * np.array([1.0, 1.3, 0.7]) * time_s)
        return replace(pose, R=pose.R @ Rotation.from_euler("yxz", angles).as_matrix())


@dataclass(frozen=True)
class ObstacleSettings(Settings):
    """A plain upright bar that crosses the view once, between the sensors and the panel."""

    width_m: float = setting(0.0, unit="m", low=0.0, high=2.0, doc="of the bar; 0: there is none")
    distance_m: float = setting(0.8, unit="m", low=0.05, high=5.0, doc="in front of the panel")
    start_s: float = setting(2.0, unit="s", low=0.0, high=1e4, doc="when it comes into view")
    crossing_s: float = setting(1.5, unit="s", low=0.05, high=1e4, doc="time from one edge of the panel to the other")
    grey: float = setting(70.0, unit="grey levels", low=0.0, high=255.0, doc="of its surface")

    def span_m(self, time_s: float, panel_width_m: float) -> tuple[float, float] | None:
        """x of its edges in the panel frame, at z = -distance_m; None while it is out of the way."""
        part = (time_s - self.start_s) / self.crossing_s
        if self.width_m == 0 or not 0 <= part <= 1:
            return None
        reach = panel_width_m / 2 + self.width_m
        middle = -reach + 2 * reach * part
        return middle - self.width_m / 2, middle + self.width_m / 2


@dataclass(frozen=True)
class LossSettings(Settings):
    """Frames that never arrive, and a clock that is off."""

    camera_drops: float = setting(0.0, low=0.0, high=0.9, doc="part of the images that are lost, at random")
    tof_drops: float = setting(0.0, low=0.0, high=0.9, doc="part of the ToF frames that are lost, at random")
    gap_start_s: float = setting(4.0, unit="s", low=0.0, high=1e4, doc="when both sensors fall silent")
    gap_s: float = setting(0.0, unit="s", low=0.0, high=1e4, doc="for how long; 0: never")
    tof_delay_s: float = setting(
        0.0, unit="s", low=-1.0, high=1.0, doc="constant error of the ToF stamps: later than the exposure by this"
    )


def lossy(ticks: Ticks, settings: LossSettings, drops: float, rng: np.random.Generator) -> Ticks:
    """The frames that arrive. The first always does."""
    silent = (ticks.exposed_ns >= settings.gap_start_s * 1e9) & (
        ticks.exposed_ns < (settings.gap_start_s + settings.gap_s) * 1e9
    )
    kept = (rng.random(len(ticks.exposed_ns)) >= drops) & ~silent
    kept[0] = True
    return replace(ticks, exposed_ns=ticks.exposed_ns[kept], arrived_ns=ticks.arrived_ns[kept])
