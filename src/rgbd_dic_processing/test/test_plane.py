"""The panel's plane from noisy ToF points with outliers, in the right part of the view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rgbd_dic_acquisition.calibration import Calibration, Camera
from rgbd_dic_acquisition.errors import MeasurementError
from rgbd_dic_processing.core.geometry import Plane, plane_homography
from rgbd_dic_processing.core.plane import PanelPlane, PlaneMotion, cloud_of_depth, fit_plane
from rgbd_dic_processing.core.plane_uncertainty import systematic_covariance
from rgbd_dic_processing.core.regions import CrackZones, Regions
from rgbd_dic_processing.core.settings import PlaneSettings
from rgbd_dic_processing.core.status import FrameStatus
from scipy import ndimage
from scipy.spatial.transform import Rotation

TOF = Camera(160, 120, 130.0, 131.0, 79.5, 59.5)
CAMERA = Camera(480, 360, 820.0, 825.0, 239.5, 179.5, -0.05, 0.0)
TRUE = Plane.from_inverse_depth(np.array([0.12, -0.2, 0.8]))


def rays(camera: Camera) -> np.ndarray:
    x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return camera.rays(np.column_stack([x.ravel(), y.ravel()]).astype(float))


def noisy_points(random: np.random.Generator, sigma_m: float = 0.005) -> np.ndarray:
    points = TRUE.points(rays(TOF)[::5])
    return points * (1 + random.normal(0, sigma_m, len(points)) / points[:, 2])[:, None]


def test_exact_points_give_the_exact_plane() -> None:
    plane, inliers, rms = fit_plane(TRUE.points(rays(TOF)), PlaneSettings())
    np.testing.assert_allclose(plane.normal, TRUE.normal, atol=1e-9)
    assert plane.d == pytest.approx(TRUE.d, abs=1e-9)
    assert inliers.all() and rms < 1e-9


def test_covariance_is_honest() -> None:
    """Over 200 noisy clouds with a tenth of outliers: the normalised squared error is chi^2 of 3 degrees, whose mean
    over 200 has a standard deviation of 0.17, and a tenth more, as 100 blocks estimate the covariance."""
    random = np.random.default_rng(2)
    chi2 = []
    for _ in range(200):
        points = noisy_points(random)
        outliers = random.random(len(points)) < 0.1
        points[outliers] *= random.uniform(0.5, 1.5, (outliers.sum(), 1))
        plane, _, _ = fit_plane(points, PlaneSettings())
        error = plane.inverse_depth - TRUE.inverse_depth
        chi2.append(error @ np.linalg.solve(plane.inverse_depth_covariance(), error))
    assert np.mean(chi2) == pytest.approx(3.3, abs=0.6)


def test_a_third_of_the_points_on_an_object_in_front() -> None:
    random = np.random.default_rng(3)
    points = noisy_points(random)
    points[: len(points) // 3] *= 0.7
    plane, inliers, rms = fit_plane(points, PlaneSettings())
    assert np.degrees(np.arccos(plane.normal @ TRUE.normal)) < 0.1
    assert plane.d == pytest.approx(TRUE.d, abs=2e-3)
    assert not inliers[: len(points) // 3].any()
    assert rms == pytest.approx(0.005, rel=0.1)


def test_no_common_plane_is_refused() -> None:
    random = np.random.default_rng(4)
    with pytest.raises(MeasurementError, match="lie on one plane"):
        fit_plane(rays(TOF) * random.uniform(0.5, 3, (TOF.width * TOF.height, 1)), PlaneSettings())


def panel_depth(plane: Plane, behind_m: float = 0.6) -> np.ndarray:
    """ToF depth image of a panel before a wall behind it."""
    grid = rays(TOF)
    depth = plane.depths(grid)
    points = grid * depth[:, None]
    panel = (np.abs(points[:, 0]) < 0.35) & (np.abs(points[:, 1]) < 0.3)
    return np.where(panel, depth, depth + behind_m).reshape(TOF.height, TOF.width).astype(np.float32)


def square_plane() -> Plane:
    return Plane.from_inverse_depth(np.array([0.0, 0, 1 / 1.2]))


REGIONS = Regions(np.array([(130.0, 100), (350, 100), (350, 260), (130, 260)]), (), None, None)


def test_region_is_carried_into_the_view() -> None:
    """The panel seen after the camera turned by 9 degrees: with the homography its plane is found, without it the
    region holds the wall as well."""
    calibration = Calibration(CAMERA, TOF)
    R = Rotation.from_euler("y", 9, degrees=True).as_matrix()
    reference = square_plane()
    moved = reference.moved(R, np.zeros(3))
    grid = rays(TOF)
    panel = reference.points(grid @ R)  # the rays, back in the reference frame
    inside = (np.abs(panel[:, 0]) < 0.18) & (np.abs(panel[:, 1]) < 0.14)
    depth = np.where(inside, moved.depths(grid), 2.5).reshape(TOF.height, TOF.width).astype(np.float32)

    step = PanelPlane(calibration, REGIONS, PlaneSettings())
    step.add_view(1, plane_homography(CAMERA, R, np.zeros(3), reference))
    (right,) = step.add_depth(1, depth)
    assert right.status == FrameStatus.OK and right.inliers == right.points > 400
    np.testing.assert_allclose(right.plane.normal, moved.normal, atol=1e-6)

    step = PanelPlane(calibration, REGIONS, PlaneSettings())
    step.add_view(1, np.eye(3))
    (wrong,) = step.add_depth(1, depth)
    assert wrong.inliers < wrong.points


def test_only_the_part_around_the_panel_is_looked_at_and_that_changes_nothing() -> None:
    """A noisy depth image gives the very plane of its whole cloud."""
    random, calibration = np.random.default_rng(5), Calibration(CAMERA, TOF)
    depth = panel_depth(square_plane())
    depth = (depth + random.normal(0, 0.005, depth.shape)).astype(np.float32)
    depth[random.random(depth.shape) < 0.05] = np.nan
    estimates = []
    for give in (
        PanelPlane.add_depth,
        lambda step, stamp, depth_m: step.add_points(stamp, cloud_of_depth(depth_m, TOF)),
    ):
        step = PanelPlane(calibration, REGIONS, PlaneSettings())
        step.add_view(1, np.eye(3))
        estimates += give(step, 1, depth)
    from_depth, from_cloud = estimates
    assert from_depth.points == from_cloud.points > 500
    np.testing.assert_array_equal(from_depth.plane.inverse_depth, from_cloud.plane.inverse_depth)


def test_fewer_points() -> None:
    """A third of the points: the plane is as good as the covariance says (4 standard deviations)."""
    random = np.random.default_rng(6)
    depth = panel_depth(square_plane())
    depth = (depth + random.normal(0, 0.005, depth.shape)).astype(np.float32)
    step = PanelPlane(Calibration(CAMERA, TOF), REGIONS, PlaneSettings(max_points=400))
    step.add_view(1, np.eye(3))
    (estimate,) = step.add_depth(1, depth)
    assert 200 < estimate.points <= 400
    error = estimate.plane.inverse_depth - square_plane().inverse_depth
    assert error @ np.linalg.solve(estimate.plane.inverse_depth_covariance(), error) < 16


def test_extrinsics() -> None:
    R = Rotation.from_euler("xyz", (3, -2, 5), degrees=True).as_matrix()
    t = np.array([-0.026, -0.067, 0.061])
    in_tof = square_plane()
    step = PanelPlane(Calibration(CAMERA, TOF, R, t), REGIONS, PlaneSettings())
    step.add_view(5, np.eye(3))
    (estimate,) = step.add_depth(5, panel_depth(in_tof))
    expected = in_tof.moved(R, t)
    np.testing.assert_allclose(estimate.plane.normal, expected.normal, atol=1e-6)
    assert estimate.plane.d == pytest.approx(expected.d, abs=1e-6)


def test_waits_for_the_view_nearest_in_time() -> None:
    step = PanelPlane(Calibration(CAMERA, TOF), REGIONS, PlaneSettings())
    assert step.add_view(100, np.eye(3)) == []
    assert step.add_depth(110, panel_depth(square_plane())) == []
    assert len(step.add_view(117, None)) == 1  # the nearest view is 117, in which the panel was lost
    step.add_depth(120, panel_depth(square_plane()))
    (late,) = step.flush()
    assert late.status == FrameStatus.NO_PLANE and "in which the panel was found" in late.reason


def test_a_known_delay_is_taken_off_the_stamp() -> None:
    """Exposed at 110, stamped 150: the view at 117 is the nearest, and the plane is that of the moment 110."""
    step = PanelPlane(Calibration(CAMERA, TOF), REGIONS, PlaneSettings(), tof_delay_ns=40)
    step.add_view(117, np.eye(3))
    step.add_view(150, None)
    (estimate,) = step.add_depth(150, panel_depth(square_plane()))
    assert estimate.status == FrameStatus.OK and estimate.stamp_ns == 110


def test_bad_depth_frames_say_why() -> None:
    step = PanelPlane(Calibration(CAMERA, TOF), REGIONS, PlaneSettings())
    step.add_view(9, np.eye(3))
    empty = np.full((TOF.height, TOF.width), np.nan, np.float32)
    (nothing,) = step.add_depth(1, empty)
    (wrong_size,) = step.add_depth(2, empty[:50])
    (unread,) = step.add_depth(3, None, "encoding 'yuv422'")
    few = empty.copy()
    few[55:60, 75:80] = 1.2
    (too_few,) = step.add_depth(4, few)
    assert [e.status for e in (nothing, wrong_size, unread, too_few)] == [
        FrameStatus.BAD_DEPTH,
        FrameStatus.BAD_DEPTH,
        FrameStatus.BAD_DEPTH,
        FrameStatus.NO_PLANE,
    ]
    assert "no valid pixel" in nothing.reason and "160 x 50 px" in wrong_size.reason
    assert "yuv422" in unread.reason and "25 ToF points" in too_few.reason


def test_plane_is_less_certain_away_from_its_frame() -> None:
    """A plane that tilts by 0.02 /(m s): 10 ms later it is uncertain by 2e-4 in that component, not at once."""
    motion, tight = PlaneMotion(), 1e-12 * np.eye(3)
    rate = np.array([0.02, 0, 0])
    for stamp in (0, 50_000_000):
        pi = np.array([0, 0, 0.8]) + rate * stamp * 1e-9
        now = motion.at_image(Plane.from_inverse_depth(pi, tight), stamp, stamp)
    later = motion.at_image(Plane.from_inverse_depth(pi, tight), 50_000_000, 60_000_000)
    np.testing.assert_allclose(now.inverse_depth_covariance(), tight, atol=1e-15)
    assert np.sqrt(later.inverse_depth_covariance()[0, 0]) == pytest.approx(2e-4, rel=1e-3)
    np.testing.assert_allclose(later.inverse_depth, pi, rtol=1e-12)


def test_step_between_the_sides() -> None:
    """The right side 3 mm farther: the step is found within its stated uncertainty, over 40 noisy frames."""
    crack = CrackZones.from_point(np.array([240.0, 180]), np.array([0.0, 1]), 60, 80, 20)
    step = PanelPlane(Calibration(CAMERA, TOF), replace(REGIONS, crack=crack), PlaneSettings())
    step.add_view(1000, np.eye(3))
    random = np.random.default_rng(6)
    columns = np.arange(TOF.width) > 79.5
    ratios = []
    for _ in range(40):
        depth = panel_depth(square_plane()) + random.normal(0, 0.005, (TOF.height, TOF.width)) + 3e-3 * columns
        (estimate,) = step.add_depth(1, depth.astype(np.float32))
        assert 1e-4 < estimate.u_step_m < 1e-3
        ratios.append((estimate.step_m - 3e-3) / estimate.u_step_m)
    # 40 ratios of standard deviation 1: their mean is known to 0.16, their standard deviation to 0.11
    assert abs(np.mean(ratios)) < 0.5 and np.std(ratios) == pytest.approx(1, abs=0.33)


def test_no_step_without_a_crack() -> None:
    step = PanelPlane(Calibration(CAMERA, TOF), REGIONS, PlaneSettings())
    step.add_view(1, np.eye(3))
    (estimate,) = step.add_depth(1, panel_depth(square_plane()))
    assert estimate.status == FrameStatus.OK and np.isnan([estimate.step_m, estimate.u_step_m]).all()


def test_waiting_frames_are_bounded() -> None:
    """ToF frames without any image: the oldest leave, so that memory does not grow."""
    step = PanelPlane(Calibration(CAMERA, TOF), REGIONS, PlaneSettings())
    left = [estimate for stamp in range(100) for estimate in step.add_depth(stamp, panel_depth(square_plane()))]
    assert [estimate.stamp_ns for estimate in left] == list(range(100 - 32))
    assert all(estimate.status == FrameStatus.NO_PLANE for estimate in left)


def test_covariance_of_noise_that_neighbours_share() -> None:
    """Noise smoothed over 3 x 3 pixels: a covariance of white noise would give a chi^2 of 27. The mean over 150 frames
    has a standard deviation of 0.2; a tenth comes to it, as 100 blocks estimate the covariance."""
    random = np.random.default_rng(8)
    grid = rays(TOF)
    depth, found = TRUE.depths(grid), []
    for _ in range(150):
        noise = 3 * ndimage.uniform_filter(random.normal(0, 0.004, (TOF.height, TOF.width)), 3, mode="wrap")
        plane, _, _ = fit_plane(grid * (depth + noise.ravel())[:, None], PlaneSettings())
        error = plane.inverse_depth - TRUE.inverse_depth
        found.append(error @ np.linalg.solve(plane.inverse_depth_covariance(), error))
    assert np.mean(found) == pytest.approx(3.3, abs=0.6)


def test_systematic_covariance_of_a_constant_error() -> None:
    """With a length far beyond the panel the error is the same along all rays: the plane moves as it does here."""
    sensor, points = np.array([-0.03, -0.07, 0.06]), TRUE.points(rays(TOF))
    settings = PlaneSettings(systematic_m=1e-4, systematic_length_m=100.0)
    stated = systematic_covariance(points, TRUE, sensor, settings)
    along = (points - sensor) / np.linalg.norm(points - sensor, axis=1, keepdims=True)
    shifted, _, _ = fit_plane(points + 1e-4 * along, settings)
    moved = np.append(shifted.normal, shifted.d) - np.append(TRUE.normal, TRUE.d)
    np.testing.assert_allclose(np.sqrt(np.diag(stated)), np.abs(moved), rtol=0.05, atol=2e-7)


def test_systematic_covariance_of_an_error_that_changes_with_distance() -> None:
    """200 random functions of the distance, half constant, half with a length of 0.1 m: chi^2 of 3 degrees; the mean
    has a standard deviation of 0.17."""
    random = np.random.default_rng(4)
    sensor, points = np.array([-0.03, -0.07, 0.06]), TRUE.points(rays(TOF))[::7]
    settings = PlaneSettings(systematic_m=1e-4)
    stated = Plane(TRUE.normal, TRUE.d, systematic_covariance(points, TRUE, sensor, settings))
    precision = np.linalg.inv(stated.inverse_depth_covariance())
    distance = np.linalg.norm(points - sensor, axis=1)
    at = np.linspace(distance.min(), distance.max(), 200)
    correlation = 0.5 + 0.5 * np.exp(-0.5 * np.square((at[:, None] - at) / 0.1))
    root = np.linalg.cholesky(correlation + 1e-9 * np.eye(200))
    found = []
    for _ in range(200):
        error = np.interp(distance, at, 1e-4 * root @ random.standard_normal(200))
        shifted, _, _ = fit_plane(points + (error / distance)[:, None] * (points - sensor), settings)
        off = shifted.inverse_depth - TRUE.inverse_depth
        found.append(off @ precision @ off)
    assert np.mean(found) == pytest.approx(3, abs=0.6)
