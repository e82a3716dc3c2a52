"""Planes, homographies and seeds against exact projections."""

from __future__ import annotations

import numpy as np
import pytest
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_processing.core import geometry
from rgbd_dic_processing.core.compensation.h_pose import displaced, pose_jacobian
from rgbd_dic_processing.core.compensation.motion import HomographyMotion, panel_points_of
from rgbd_dic_processing.core.geometry import Plane, apply_homography, plane_homography
from rgbd_dic_processing.core.homography import fit_homography
from rgbd_dic_processing.core.realignment import realign_to_axis, realign_to_principal_axes
from rgbd_dic_processing.core.seed_maps import SeedMaps
from scipy.spatial.transform import Rotation

CAMERA = Camera(640, 480, 800.0, 815.0, 310.0, 250.0, -0.2, 0.06)
POINTS = np.random.default_rng(1).uniform((60, 60), (580, 420), (50, 2))


def random_plane(seed: int) -> Plane:
    random = np.random.default_rng(seed)
    pi = np.array([*random.normal(0, 0.3, 2), 1 + random.random()])
    spread = random.normal(0, 0.01, (3, 3))
    return Plane.from_inverse_depth(pi, spread @ spread.T)


def random_motion(seed: int) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    return Rotation.from_rotvec(random.normal(0, 0.15, 3)).as_matrix(), random.normal(0, 0.05, 3)


@pytest.mark.parametrize("seed", range(5))
def test_plane_homography_moves_points_of_the_plane(seed: int) -> None:
    plane, (R, t) = random_plane(seed), random_motion(seed)
    points = plane.points(CAMERA.rays(POINTS))
    np.testing.assert_allclose(points @ plane.normal + plane.d, 0, atol=1e-12)
    np.testing.assert_allclose(CAMERA.project(points), POINTS, atol=1e-9)
    moved = apply_homography(plane_homography(CAMERA, R, t, plane), POINTS)
    np.testing.assert_allclose(moved, CAMERA.project(points @ R.T + t), atol=1e-9)


def test_several_homographies_at_once() -> None:
    motions, planes = [random_motion(seed) for seed in range(4)], [random_plane(seed) for seed in range(4)]
    R, t = (np.array(values) for values in zip(*motions, strict=True))
    every = geometry.plane_homographies(CAMERA, R, t, np.array([plane.inverse_depth for plane in planes]))
    moved = apply_homography(every, POINTS)
    assert moved.shape == (4, len(POINTS), 2)
    realignment = realign_to_principal_axes(CAMERA, planes[0], POINTS)
    on_panel = panel_points_of([HomographyMotion(H) for H in every], POINTS, realignment)
    for k, (motion, plane) in enumerate(zip(motions, planes, strict=True)):
        alone = plane_homography(CAMERA, *motion, plane)
        np.testing.assert_allclose(every[k], alone, rtol=1e-13, atol=1e-13)
        np.testing.assert_allclose(moved[k], apply_homography(alone, POINTS), rtol=1e-12)
        np.testing.assert_allclose(on_panel[k], HomographyMotion(alone).panel_points(POINTS, realignment), atol=1e-12)


def test_pose_jacobian_by_differences() -> None:
    """To 1e-5 px for a step of 1: what central differences of 1e-5 leave is of the order of its square."""
    (R, t), focal = random_motion(1), np.array([CAMERA.fx, CAMERA.fy])
    points = random_plane(1).points(CAMERA.rays(POINTS))
    jacobian = pose_jacobian(focal, points @ R.T, points @ R.T + t)
    poses = [displaced((R, t), sign * 1e-5 * np.eye(6)) for sign in (1, -1)]
    ahead, behind = (CAMERA.project(points @ np.swapaxes(R, 1, 2) + t[:, None]) for R, t in poses)
    np.testing.assert_allclose(jacobian, (ahead - behind) / 2e-5, atol=1e-5)


@pytest.mark.parametrize("scale", [1.0, -3.7])
@pytest.mark.parametrize("seed", range(5))
def test_pose_from_homography_is_its_inverse(seed: int, scale: float) -> None:
    plane, (R, t) = random_plane(seed), random_motion(seed)
    H = scale * plane_homography(CAMERA, R, t, plane)
    found_R, found_t = geometry.pose_from_homography(CAMERA, H, plane)
    np.testing.assert_allclose(found_R, R, atol=1e-12)
    np.testing.assert_allclose(found_t, t, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_moved_plane_holds_the_moved_points(seed: int) -> None:
    plane, (R, t) = random_plane(seed), random_motion(seed)
    moved = plane.moved(R, t)
    points = plane.points(CAMERA.rays(POINTS)) @ R.T + t
    np.testing.assert_allclose(points @ moved.normal + moved.d, 0, atol=1e-12)


def test_plane_covariance_by_sampling() -> None:
    """The covariance of (n, d) and of the moved plane against 20,000 drawn planes: 5 % of the largest entry, which
    is 7 standard deviations of a sampled variance."""
    plane, (R, t) = random_plane(3), random_motion(3)
    random = np.random.default_rng(0)
    small = Plane.from_inverse_depth(plane.inverse_depth, plane.inverse_depth_covariance() * 1e-2)
    drawn = random.multivariate_normal(small.inverse_depth, small.inverse_depth_covariance(), 20000)
    for expected, change in ((small, lambda p: p), (small.moved(R, t), lambda p: p.moved(R, t))):
        planes = [change(Plane.from_inverse_depth(pi)) for pi in drawn]
        sampled = np.cov(np.array([np.append(p.normal, p.d) for p in planes]).T)
        np.testing.assert_allclose(expected.covariance, sampled, atol=0.05 * np.abs(sampled).max())


def test_distortion_and_back() -> None:
    np.testing.assert_allclose(CAMERA.distort(CAMERA.undistort(POINTS)), POINTS, atol=1e-10)
    with np.errstate(all="raise"):
        assert np.isnan(CAMERA.undistort(np.array([[1e5, 1e5]]))).all()  # beyond the fold of k1 < 0


def test_seed_maps_follow_the_exact_map() -> None:
    """Against distortion o homography o undistortion at the subset's corners, on a view turned by 20 degrees.

    What is left is of third order: 4e-3 px at 15 px of the centre here, nothing at the centre itself."""
    plane = random_plane(1)
    R = Rotation.from_euler("xyz", (12, -20, 30), degrees=True).as_matrix()
    H = plane_homography(CAMERA, R, np.array([0.05, -0.02, 0.1]), plane)
    centres = np.round(POINTS)
    seeds = SeedMaps(CAMERA, centres, 15.5).seeds(H)

    def exact(points: np.ndarray) -> np.ndarray:
        return CAMERA.distort(apply_homography(H, CAMERA.undistort(points)))

    np.testing.assert_allclose(seeds[:, :, 0], exact(centres), atol=1e-9)
    for xi, eta in ((15, 15), (-15, 15), (0, -15), (7, 3)):
        basis = np.array([1, xi, eta, xi * xi, xi * eta, eta * eta])
        np.testing.assert_allclose(seeds @ basis, exact(centres + np.array([xi, eta])), atol=6e-3)


def test_fit_homography_is_exact_and_refuses_a_line() -> None:
    H = plane_homography(CAMERA, *random_motion(2), random_plane(2))
    moved = apply_homography(H, POINTS)
    found = fit_homography(POINTS, moved)
    np.testing.assert_allclose(found, H / H[2, 2], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(apply_homography(fit_homography(POINTS[:4], moved[:4]), POINTS), moved, atol=1e-6)
    line = np.column_stack([np.arange(9.0), 2 * np.arange(9.0)])
    assert fit_homography(line, line) is None


def test_fit_homography_minimises_the_reprojection_error() -> None:
    """With noise, no small change of an entry makes the sum of squares smaller."""
    H = plane_homography(CAMERA, *random_motion(2), random_plane(2))
    moved = apply_homography(H, POINTS) + np.random.default_rng(5).normal(0, 0.5, POINTS.shape)
    found = fit_homography(POINTS, moved)

    def cost(homography: np.ndarray) -> float:
        return float(np.sum((apply_homography(homography, POINTS) - moved) ** 2))

    for index in np.ndindex(3, 3):
        for sign in (-1, 1):
            changed = found.copy()
            changed[index] *= 1 + sign * 1e-5
            if index != (2, 2):
                assert cost(changed) > cost(found)


@pytest.mark.parametrize("angles", [(0, 0, 0), (10, -15, 3), (-12, 20, -4)])
def test_both_realignments_agree_on_a_straight_panel(angles: tuple[float, float, float]) -> None:
    """A wide rectangle on the panel: its principal axis is the x axis that a user would click."""
    R = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    t = np.array([0.01, 0.02, 1.2])
    plane = Plane(R[:, 2], float(-R[:, 2] @ t), np.zeros((4, 4)))
    x, y = np.meshgrid(np.linspace(-0.2, 0.2, 21), np.linspace(-0.1, 0.1, 11))
    panel = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    pixels = CAMERA.project(panel @ R.T + t)
    axis = CAMERA.project(np.array([[-0.2, 0, 0], [0.2, 0, 0]]) @ R.T + t)
    for realignment in (
        realign_to_axis(CAMERA, plane, axis),
        realign_to_principal_axes(CAMERA, plane, pixels),
    ):
        np.testing.assert_allclose(realignment.R_panel_camera, R.T, atol=1e-9)
        in_plane = realignment.from_pixels(pixels)
        np.testing.assert_allclose(in_plane - in_plane[0], panel[:, :2] - panel[0, :2], atol=1e-9)
        np.testing.assert_allclose(
            realignment.from_points(plane.points(CAMERA.rays(pixels)))[:, :2], in_plane, atol=1e-9
        )


def test_realignment_of_a_high_panel_puts_its_length_along_y() -> None:
    plane = Plane(np.array([0, 0, 1.0]), -1.0, np.zeros((4, 4)))
    x, y = np.meshgrid(np.linspace(250, 350, 11), np.linspace(50, 450, 41))
    pixels = np.column_stack([x.ravel(), y.ravel()])
    np.testing.assert_allclose(realign_to_principal_axes(CAMERA, plane, pixels).R_panel_camera, np.eye(3), atol=1e-9)
