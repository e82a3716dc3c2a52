"""One simulated flight in front of a cracking panel: scene, motion, both sensors; the same in every run."""

# ruff: noqa: RUF009  (the groups of settings are frozen)

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..settings import Settings, setting
from .motion import CrackSettings, CrackState, HandheldMotion, MotionSettings, Pose, crack_state
from .scene import CrackedPanel, PanelSettings
from .sensors import CameraModel, CameraSettings, TofImage, TofModel, TofSettings, sensor_rig
from .speckle import SpeckleSettings, make_pattern
from .timing import Ticks, TimingSettings, ticks

CAMERA_FRAME = "camera_optical_frame"
TOF_FRAME = "tof_optical_frame"

# What each stream of random numbers is for; a stream is never shared, so that nothing depends on order.
_PATTERN, _MOTION, _CAMERA, _TOF, _IMU, _CAMERA_TICKS, _TOF_TICKS, _IMU_TICKS = range(8)


@dataclass(frozen=True)
class FlightSettings(Settings):
    """All of a simulated flight, in groups."""

    seed: int = setting(1, low=0, high=2**31 - 1, doc="of every random number; the same gives the same flight")
    duration_s: float = setting(2.0, unit="s", low=0.05, high=3600.0, doc="length of the recording")
    attitude_noise_rad: float = setting(
        0.002, unit="rad", low=0.0, high=1.0, doc="standard deviation of the IMU's attitude about each axis"
    )
    compression: str = setting("zstd", doc="of the bag", choices=("none", "zstd"))
    panel: PanelSettings = setting(PanelSettings(), doc="plates, gap and wall")
    speckle: SpeckleSettings = setting(SpeckleSettings(), doc="the pattern on the panel")
    motion: MotionSettings = setting(MotionSettings(), doc="of the camera")
    crack: CrackSettings = setting(CrackSettings(), doc="how it moves")
    camera: CameraSettings = setting(CameraSettings(), doc="the greyscale camera")
    tof: TofSettings = setting(TofSettings(), doc="the ToF sensor")
    timing: TimingSettings = setting(TimingSettings(), doc="rates, clocks and latencies")


def sample_flight_settings() -> FlightSettings:
    """The flight of bags/sample: two seconds, a third of the camera's columns and a quarter of the ToF's."""
    return FlightSettings()


class Flight:
    """What there is to see and to know at each moment of a flight.

    Attributes:
        calibration: of both sensors, exact.
        scene: what they look at.
        tof_model, camera_model: the sensors.
    """

    def __init__(self, settings: FlightSettings, workers: int | None = None) -> None:
        s = self.settings = settings
        pattern = make_pattern(s.speckle, s.panel.width_m, s.panel.height_m, self._random(_PATTERN))
        self.scene = CrackedPanel(s.panel, pattern)
        self.calibration = sensor_rig(s.camera, s.tof)
        self.camera_model = CameraModel(self.calibration.camera, s.camera, workers)
        self.tof_model = TofModel(self.calibration, s.tof)
        self._motion = HandheldMotion(s.motion, self._random(_MOTION))

    def pose(self, time_s: float) -> Pose:
        """T_camera_panel."""
        return self._motion.pose(time_s)

    def crack(self, time_s: float) -> CrackState:
        """The true displacement of the right plate since the start."""
        return crack_state(self.settings.crack, time_s, self.settings.duration_s)

    def image(self, time_s: float, index: int) -> NDArray[np.uint8]:
        """Image (rows, cols) at a time; the noise depends on the index alone."""
        noise = self._random(_CAMERA, index)
        return self.camera_model.expose(self.scene, self.pose(time_s), self.crack(time_s), noise)

    def depth(self, time_s: float, index: int) -> TofImage:
        """ToF frame at a time; the noise depends on the index alone."""
        noise = self._random(_TOF, index)
        return self.tof_model.expose(self.scene, self.pose(time_s), self.crack(time_s), noise)

    def attitude_error(self, index: int) -> NDArray[np.float64]:
        """Rotation vector (3,) about the world's axes that the IMU is wrong by [rad]."""
        return self.settings.attitude_noise_rad * self._random(_IMU, index).standard_normal(3)

    def camera_ticks(self) -> Ticks:
        t = self.settings.timing
        return ticks(
            self._count(t.camera_rate_hz),
            t.camera_rate_hz,
            self._random(_CAMERA_TICKS),
            skew_ppm=t.camera_skew_ppm,
            jitter_s=t.jitter_s,
            latency_s=t.camera_latency_s,
        )

    def tof_ticks(self) -> Ticks:
        t = self.settings.timing
        return ticks(
            self._count(t.tof_rate_hz),
            t.tof_rate_hz,
            self._random(_TOF_TICKS),
            phase_s=t.tof_phase_s + 0.25 / t.camera_rate_hz - 0.25 / t.tof_rate_hz,
            skew_ppm=t.tof_skew_ppm,
            jitter_s=t.jitter_s,
            latency_s=t.tof_latency_s,
        )

    def imu_ticks(self) -> Ticks:
        t = self.settings.timing
        count, latency_s = self._count(t.imu_rate_hz), t.imu_latency_s
        return ticks(count, t.imu_rate_hz, self._random(_IMU_TICKS), jitter_s=t.jitter_s, latency_s=latency_s)

    def _count(self, rate_hz: float) -> int:
        return max(1, int(np.floor(self.settings.duration_s * rate_hz + 1e-9)))

    def _random(self, *stream: int) -> np.random.Generator:
        return np.random.default_rng([self.settings.seed, *stream])
