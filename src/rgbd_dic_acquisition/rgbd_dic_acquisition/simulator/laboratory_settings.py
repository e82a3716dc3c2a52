"""Everything about the simulated laboratory that can be chosen, and the presets."""

# ruff: noqa: RUF009  (the groups of settings are frozen)

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..settings import Settings, setting
from .laboratory_camera import LaboratoryCameraSettings
from .laboratory_fields import DeformationSettings
from .laboratory_motion import HAND, LossSettings, ObstacleSettings, OrbitSettings
from .laboratory_panel import LaboratoryPanelSettings
from .laboratory_pattern import PatternSettings
from .laboratory_press import PressSettings
from .laboratory_reference import StereoSettings
from .laboratory_tof import LaboratoryTofSettings
from .motion import MotionSettings
from .timing import TimingSettings


@dataclass(frozen=True)
class LaboratorySettings(Settings):
    """All of a laboratory, in groups."""

    seed: int = setting(1, low=0, high=2**31 - 1, doc="of every random number; the same gives the same recording")
    duration_s: float = setting(10.0, unit="s", low=0.05, high=3600.0, doc="length of the recording: five cycles")
    attitude_noise_rad: float = setting(
        0.002, unit="rad", low=0.0, high=1.0, doc="standard deviation of the IMU's attitude about each axis"
    )
    compression: str = setting("zstd", doc="of the bag", choices=("none", "zstd"))
    panel: LaboratoryPanelSettings = setting(LaboratoryPanelSettings(), doc="size, crack and wall")
    pattern: PatternSettings = setting(PatternSettings(), doc="the speckle")
    deformation: DeformationSettings = setting(DeformationSettings(), doc="how the panel deforms")
    press: PressSettings = setting(PressSettings(), doc="the load")
    motion: MotionSettings = setting(HAND, doc="of the hand")
    orbit: OrbitSettings = setting(OrbitSettings(), doc="slow swing around the panel")
    obstacle: ObstacleSettings = setting(ObstacleSettings(), doc="what passes in front")
    camera: LaboratoryCameraSettings = setting(LaboratoryCameraSettings(), doc="the greyscale camera and the lamps")
    tof: LaboratoryTofSettings = setting(LaboratoryTofSettings(), doc="the ToF sensor")
    timing: TimingSettings = setting(TimingSettings(jitter_s=3e-4), doc="rates, clocks and latencies")
    loss: LossSettings = setting(LossSettings(), doc="lost frames, a gap, a clock that is off")
    stereo: StereoSettings = setting(StereoSettings(), doc="the 3D DIC reference")


# What differs from the defaults.
PRESETS: dict[str, dict[str, Any]] = {
    "laboratory": {},
    "laboratory_hard": {
        "motion": {**HAND.as_dict(), "distance_m": 2.5, "yaw_rad": 0.0, "pitch_rad": 0.0, "roll_rad": 0.0},
        "orbit": {"yaw_rad": 0.26, "pitch_rad": 0.26, "roll_rad": 0.52},
        "obstacle": {"width_m": 0.12},
        "camera": {"exposure_factor": 0.7},
        "loss": {"camera_drops": 0.05, "tof_drops": 0.1, "gap_s": 1.0, "tof_delay_s": 0.04},
    },
}


def laboratory_settings(
    preset: str = "laboratory", values: Mapping[str, Any] | None = None, where: str = "settings"
) -> LaboratorySettings:
    """A preset with what differs from it, a mapping of groups as a YAML file gives it.

    Raises:
        SettingsError: an unknown name, or a value out of range.
    """
    base = LaboratorySettings.from_mapping(PRESETS[preset])
    return base.updated(values or {}, where)
