"""The kernel's fit of a pose: a slow twin in NumPy, and what is exactly known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import MeasurementError
from rgbd_dic_processing.core.compensation import h_pose
from rgbd_dic_processing.core.compensation.h_pose import displaced, fit_pose, pose_jacobian
from rgbd_dic_processing.core.compensation.motion import misfit_of
from rgbd_dic_processing.core.geometry import Plane
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
CAMERA = Camera(1440, 1080, 2400.0, 2395.0, 719.5, 539.5, 0.0, 0.0)
PLANE = Plane(np.array([0.1, -0.05, np.sqrt(1 - 0.0125)]), -1.5, np.zeros((4, 4)))
ROBUST_SIGMAS = 2.0


def twin(source_px: Array, target_px: Array, sigma_px: Array, start: tuple[Array, Array]):
    """As `fit_pose`, step by step as it is described there."""
    points = PLANE.points(CAMERA.rays(source_px))
    focal = np.array([CAMERA.fx, CAMERA.fy])
    pose, misfit = start, 0.0
    for iteration in range(h_pose.MAX_ITERATIONS):
        turned = points @ pose[0].T
        moved = turned + pose[1]
        residual = target_px - CAMERA.project(moved)
        if iteration < h_pose.MISFIT_ITERATIONS:
            misfit = misfit_of(residual, sigma_px)
        variance = sigma_px**2 + misfit**2
        lengths = np.sqrt(np.sum(residual**2 / variance, axis=1, keepdims=True))
        weights = np.minimum(1, ROBUST_SIGMAS / np.maximum(lengths, 1e-12)) / variance
        jacobian = pose_jacobian(focal, turned, moved)
        by_pose = jacobian.reshape(6, -1)
        weighted = by_pose * weights.ravel()
        step = np.linalg.solve(weighted @ by_pose.T, weighted @ residual.ravel())
        pose = displaced(pose, step)
        if np.sqrt(np.mean((step @ by_pose) ** 2)) < h_pose.CONVERGED_PX:
            return pose, jacobian, weights, misfit
    raise AssertionError("did not converge")


def seen(count: int, turn: float, noise_px: float, wrong: int) -> tuple[Array, Array, Array, tuple[Array, Array]]:
    """Points of the plane in the reference and after a motion, with noise; some of them far off. And that motion."""
    rng = np.random.default_rng(count)
    source = rng.uniform((100, 100), (1340, 980), (count, 2))
    R = Rotation.from_rotvec(turn * np.array([0.5, -0.7, 0.5])).as_matrix()
    t = np.array([0.02, -0.03, 0.05])
    target = CAMERA.project(PLANE.points(CAMERA.rays(source)) @ R.T + t)
    sigma = rng.uniform(0.5, 2.0, (count, 2)) * max(noise_px, 1e-5)
    target += noise_px * rng.normal(size=(count, 2))
    target[:wrong] += rng.uniform(1, 3, (wrong, 2))
    return source, target, sigma, (R, t)


@pytest.mark.parametrize(
    ("count", "turn", "noise_px", "wrong"),
    [(800, 0.1, 0.01, 60), (801, 0.3, 0.02, 0), (9, 0.02, 0.05, 1), (4, 0.0, 0.0, 0)],
)
def test_same_as_in_numpy(count: int, turn: float, noise_px: float, wrong: int) -> None:
    """Both end where a step moves pixels by less than 1e-7, which it does by far: what is left is rounding, of numbers
    that are sums over thousands."""
    source, target, sigma, (R, t) = seen(count, turn, noise_px, wrong)
    start = displaced((R, t), np.array([1e-3, -2e-3, 1e-3, 2e-3, 1e-3, -3e-3]))
    (R1, t1), jacobian1, weights1, misfit1 = twin(source, target, sigma, start)
    (R2, t2), jacobian2, weights2, misfit2 = fit_pose(CAMERA, source, target, sigma, PLANE, start, ROBUST_SIGMAS)
    np.testing.assert_allclose(R2, R1, atol=1e-11)
    np.testing.assert_allclose(t2, t1, atol=1e-11)
    np.testing.assert_allclose(jacobian2, jacobian1, rtol=1e-7, atol=1e-7 * CAMERA.fx)
    np.testing.assert_allclose(weights2, weights1, rtol=1e-6)
    assert misfit2 == pytest.approx(misfit1, rel=1e-7, abs=1e-9)
    np.testing.assert_allclose(R2 @ R2.T, np.eye(3), atol=1e-13)


@pytest.mark.parametrize("turn", [0.0, 1e-6, 1e-3, 0.5, 1.2])
def test_exact_points_give_the_motion(turn: float) -> None:
    """From farther away than a guess ever is; 1e-9 is what pixels exact to 1e-12 and the last step leave."""
    source, target, sigma, (R, t) = seen(200, turn, 0.0, 0)
    start = displaced((R, t), np.array([0.05, 0.05, -0.1, 0.05, -0.05, 0.1]))
    (found_R, found_t), *_, misfit_px = fit_pose(CAMERA, source, target, sigma, PLANE, start, ROBUST_SIGMAS)
    np.testing.assert_allclose(found_R, R, atol=1e-9)
    np.testing.assert_allclose(found_t, t, atol=1e-9)
    assert misfit_px < 1e-9


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("which", range(3))
def test_numbers_that_are_not_finite(which: int, value: float) -> None:
    """In the places in the reference or in the image, or in the uncertainty."""
    *arrays, start = seen(200, 0.1, 0.01, 0)
    arrays[which][100, 1] = value
    with pytest.raises(MeasurementError, match="did not converge"):
        fit_pose(CAMERA, *arrays, PLANE, start, ROBUST_SIGMAS)


@pytest.mark.parametrize(("count", "away_m"), [(0, 0.0), (200, 3.0)], ids=["no points", "behind"])
def test_what_gives_no_pose(count: int, away_m: float) -> None:
    """No points, or a start from which the panel is behind the camera."""
    source, target, sigma, (R, t) = seen(200, 0.1, 0.01, 0)
    points = source[:count], target[:count], sigma[:count]
    with pytest.raises(MeasurementError, match="did not converge"):
        fit_pose(CAMERA, *points, PLANE, (R, t - (0, 0, away_m)), ROBUST_SIGMAS)
