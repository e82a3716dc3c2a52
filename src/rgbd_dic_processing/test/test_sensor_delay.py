"""The delay of the ToF stamps, from exact poses of a hand-held camera and planes with known noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rgbd_dic_acquisition.simulator.laboratory_motion import HAND
from rgbd_dic_acquisition.simulator.motion import HandheldMotion, MotionSettings
from rgbd_dic_processing.core.geometry import Plane
from rgbd_dic_processing.core.panel_motion import PanelMotion
from rgbd_dic_processing.core.sensor_delay import DelayEstimate, SensorDelay
from scipy.spatial.transform import Rotation

TILT, DISTANCE_M, POSE = 1.2e-4, 5e-5, (1e-5, 2e-5)  # noise of a ToF plane, and of a pose (rotation, shift)
STILL = replace(HAND, sway_m=0.0, sway_rad=0.0)


def found(
    delay_s: float,
    seed: int,
    hand: MotionSettings = HAND,
    duration_s: float = 5.0,
    drops: float = 0.0,
    gap_s: tuple[float, float] = (0.0, 0.0),
    wiggle_m: float = 0.0,
) -> SensorDelay:
    """What is found of a delay: images at 60 Hz, ToF frames at 20 Hz with jitter, `drops` of both lost at random.

    gap_s: between these times all images are lost. wiggle_m: the ToF sensor's error that repeats in distance.
    """
    random = np.random.default_rng(seed)
    flight = HandheldMotion(hand, random)
    times = []
    for rate_hz, phase_s in ((60, 0.0), (20, 0.0073)):
        exposed_s = np.arange(1, round(duration_s * rate_hz)) / rate_hz + phase_s
        jittered = exposed_s + random.normal(0, 3e-4, len(exposed_s))
        times.append(jittered[random.random(len(jittered)) >= drops])
    motion, estimate, first = PanelMotion(), DelayEstimate(), flight.pose(times[0][0])
    for time_s in times[0]:
        if not gap_s[0] <= time_s < gap_s[1]:
            pose = flight.pose(time_s)
            R = Rotation.from_rotvec(random.normal(0, POSE[0], 3)).as_matrix() @ pose.R @ first.R.T
            motion.add(round(time_s * 1e9), (R, pose.t - R @ first.t + random.normal(0, POSE[1], 3)))
    covariance = np.diag([TILT, TILT, DISTANCE_M / hand.distance_m]) ** 2 / hand.distance_m**2
    for time_s in times[1]:
        pose = flight.pose(time_s)
        normal = pose.R[:, 2]
        distance = normal @ pose.t
        off = wiggle_m * np.sin(2 * np.pi * distance / 0.375)
        pi = random.multivariate_normal(normal / (distance + off), covariance)
        estimate.add(round((time_s + delay_s) * 1e9), Plane.from_inverse_depth(pi, covariance))
    return estimate.estimate(motion)


@pytest.mark.parametrize("delay_s", [0.0, 0.012, 0.04, -0.04])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_delay_is_found(delay_s: float, seed: int) -> None:
    """Within 5 ms, as promised, and three stated standard uncertainties; 5 s of a hand's motion tell it to 0.2 ms."""
    delay = found(delay_s, seed)
    assert abs(delay.delay_s - delay_s) < min(3 * delay.u_s, 0.005)
    assert delay.u_s < 5e-4 and delay.reason == ""
    assert bool(delay.warning) == (delay_s != 0)


@pytest.mark.parametrize(
    "flaws", [{"drops": 0.2}, {"gap_s": (2.0, 3.0)}, {"wiggle_m": 0.002}], ids=["drops", "gap", "wiggle"]
)
def test_it_is_found_in_bad_recordings_too(flaws: dict) -> None:
    """Lost frames, a gap of a second, and a distance that is wrong by 2 mm back and forth as the camera moves."""
    for seed in range(5):
        delay = found(0.04, seed, **flaws)
        assert abs(delay.delay_s - 0.04) < min(3 * delay.u_s, 0.005)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.02])
def test_a_camera_that_hardly_moves_tells_nothing(share: float) -> None:
    """Up to 0.2 mm and 0.1 mrad: less than the noise of the planes."""
    for seed in range(10):
        delay = found(0.04, seed, replace(HAND, sway_m=share * HAND.sway_m, sway_rad=share * HAND.sway_rad))
        assert np.isnan(delay.delay_s) and np.isnan(delay.u_s) and "moved too little" in delay.reason
        assert delay.warning == "" and "unknown" in str(delay)


def test_a_regular_vibration_leaves_several_delays() -> None:
    """At 8 Hz, 40 ms too late look like 85 ms too early."""
    vibration = replace(HAND, low_hz=8.0, high_hz=8.0001)
    assert "too regularly" in found(0.04, 1, vibration).reason


def test_too_few_planes() -> None:
    assert "at least 20 needed" in found(0.0, 1, duration_s=0.8).reason
    assert "at least 20 needed" in found(0.0, 1, duration_s=1.2).reason  # those amid images are fewer


def test_what_a_user_is_told() -> None:
    late = SensorDelay(0.0402, 0.0003, 90)
    assert "40.2 ms too late" in late.warning and "add 0.0402 to pairing.tof_delay_s" in late.warning
    assert "40.0 ms too early" in replace(late, delay_s=-0.04, u_s=0.001).warning
    assert str(late) == "40.2, standard uncertainty 0.3"
    assert SensorDelay(0.006, 0.0021, 90).warning == ""  # less than three standard uncertainties
    assert SensorDelay(-0.0049, 0.0001, 90).warning == ""  # negligible
