"""How far planes of the simulated laboratory are from the true panel, against what they say of themselves."""

from __future__ import annotations

import numpy as np
import pytest
from rgbd_dic_acquisition.simulator.laboratory import Laboratory, laboratory_settings
from rgbd_dic_processing.core.geometry import Plane
from rgbd_dic_processing.core.plane import PanelPlane, PlaneEstimate
from rgbd_dic_processing.core.regions import Regions
from rgbd_dic_processing.core.settings import PlaneSettings
from rgbd_dic_processing.core.status import FrameStatus

POSES = (
    {"distance_m": 2.2},
    {"distance_m": 1.75, "yaw_rad": 0.02, "pitch_rad": 0.01},
    {"distance_m": 2.4, "yaw_rad": 0.3, "pitch_rad": 0.2},
    {"distance_m": 2.3, "yaw_rad": -0.5, "pitch_rad": 0.1},
)
CLEAN = {"wiggle_m": 0.0, "dark_offset_m": 0.0, "fixed_pattern_m": 0.0}


def laboratory(seed: int, **groups: dict) -> Laboratory:
    groups["tof"] = {"scale": 0.5, **groups.get("tof", {})}
    return Laboratory(laboratory_settings("laboratory", {"seed": seed, "camera": {"scale": 0.25}, **groups}))


def truth(lab: Laboratory, time_s: float) -> Plane:
    """Least squares plane through the panel's true surface, in the camera frame."""
    s, pose = lab.settings.panel, lab.pose(time_s)
    x, y = np.meshgrid(np.linspace(-0.48, 0.48, 60) * s.width_m, np.linspace(-0.46, 0.46, 30) * s.height_m)
    points = lab.panel.points(x.ravel(), y.ravel(), lab.stroke_m(time_s)) @ pose.R.T + pose.t
    normal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][2]
    normal *= np.sign(normal[2])
    return Plane(normal, float(-normal @ points.mean(axis=0)), np.zeros((4, 4)))


def measured(lab: Laboratory, time_s: float, index: int) -> PlaneEstimate:
    """The plane of a ToF frame, in a panel region drawn around the panel as it is then."""
    s = lab.settings.panel
    x, y = s.width_m / 2 - 0.03, s.height_m / 2 - 0.03
    panel = lab.project(np.array([-x, x, x, -x]), np.array([-y, -y, y, y]), time_s)
    step = PanelPlane(lab.calibration, Regions(panel, (), None, None), PlaneSettings())
    step.add_view(1, np.eye(3))
    (estimate,) = step.add_depth(1, lab.depth(time_s, index).depth_m.astype(np.float32))
    assert estimate.status == FrameStatus.OK, estimate.reason
    return estimate


def chi2(estimate: PlaneEstimate, true: Plane, covariance: np.ndarray) -> float:
    """Normalised squared error; its expectation is 3 for an honest covariance."""
    plane = Plane(estimate.plane.normal, estimate.plane.d, covariance)
    error = plane.inverse_depth - true.inverse_depth
    return float(error @ np.linalg.solve(plane.inverse_depth_covariance(), error))


def test_covariance_with_all_errors_of_the_sensor() -> None:
    """Wiggle, dark spots farther, fixed pattern, dropouts, a bow of 0.8 mm; four poses, six sensors.

    Of 24 errors of three components the mean chi^2 / 3 of an honest covariance has a standard deviation of 0.17. The
    default is made for a sensor that is off by 4 mm, this one is by 3.2 mm: that gives 0.6. Without the sensor's
    accuracy it would be in the thousands.
    """
    found = []
    for seed in range(1, 7):
        for pose in POSES:
            lab = laboratory(seed, motion=pose)
            estimate, true = measured(lab, 0.4, 3), truth(lab, 0.4)
            assert estimate.residual_rms_m == pytest.approx(0.005, abs=0.0007)
            found.append(chi2(estimate, true, estimate.plane.covariance + estimate.systematic) / 3)
    assert 0.35 < np.mean(found) < 1.25


def test_covariance_without_what_frames_share() -> None:
    """Noise alone, of spots darker and lighter, and the bow: the frame's own covariance is enough."""
    found = []
    for seed in range(1, 5):
        for pose in POSES:
            lab = laboratory(seed, motion=pose, tof=CLEAN)
            estimate = measured(lab, 0.4, 3)
            found.append(chi2(estimate, truth(lab, 0.4), estimate.plane.covariance) / 3)
    assert 0.3 < np.mean(found) < 1.3


@pytest.mark.parametrize("in_front_m", [0.1, 0.8])
@pytest.mark.parametrize("time_s", [0.55, 1.0, 1.4])
def test_object_in_front(in_front_m: float, time_s: float) -> None:
    """A bar that hides up to 40 % of a flat panel, with flying pixels along it: the plane stays within four of its own
    standard deviations, some 0.1 mm and 0.4 mrad, of the one without the bar."""
    width = 0.4 * 1.14 * (2.2 - in_front_m) / 2.2
    bar = {"distance_m": in_front_m, "start_s": 0.0, "crossing_s": 2.0}
    flat = {"bow_m": 0.0, "bulge": 0.0, "step": 0.0}
    free, barred = (
        measured(laboratory(5, tof=CLEAN, deformation=flat, obstacle={**bar, "width_m": w}), time_s, 3)
        for w in (0.0, width)
    )
    assert barred.inliers < 0.91 * free.inliers
    if time_s == 1.0:  # all of the bar is before the panel
        assert barred.inliers == pytest.approx(0.6 * free.inliers, rel=0.05)
    moved = np.append(barred.plane.normal - free.plane.normal, barred.plane.d - free.plane.d)
    within = 4 * np.sqrt(np.diag(barred.plane.covariance))
    assert np.all(np.abs(moved) < within) and within[3] < 2e-3


def test_object_in_front_is_in_the_accuracy() -> None:
    """The same with all errors of the sensor, and the bow, which tilts what is left of the panel by a mrad."""
    bar = {"distance_m": 0.1, "start_s": 0.0, "crossing_s": 2.0, "width_m": 0.43}
    for time_s in (0.55, 1.0, 1.4):
        lab = laboratory(5, obstacle=bar)
        estimate = measured(lab, time_s, 3)
        both = estimate.plane.covariance + estimate.systematic
        assert chi2(estimate, truth(lab, time_s), both) < 11.3  # 1 % of chi^2 with three degrees is above


def test_dark_spots_shift_the_distance_alone() -> None:
    """Black reads 6 mm farther: the plane moves by the mean of it, 3 mm, and that is within its stated uncertainty."""
    dark, plain = (measured(laboratory(2, tof={**CLEAN, "dark_offset_m": offset}), 0.4, 3) for offset in (0.006, 0.0))
    shift = plain.plane.d - dark.plane.d
    assert 0.002 < shift < 0.004
    assert shift < np.sqrt(dark.systematic[3, 3])
    np.testing.assert_allclose(dark.plane.normal[:2], plain.plane.normal[:2], atol=2e-4)
