"""What a panel that bulges does to the places of its subsets, and that h_joint tells it from strain."""

from __future__ import annotations

import numpy as np
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_processing.core.bulge import Bulge
from rgbd_dic_processing.core.geometry import Plane
from scipy.spatial.transform import Rotation

CAMERA = Camera(1440, 1080, 2600.0, 2600.0, 719.5, 539.5)
DISTANCE_M = 2.0
X, Y = (grid.ravel() for grid in np.meshgrid(np.linspace(-0.5, 0.5, 21), np.linspace(-0.3, 0.3, 13)))
FACING = Plane(np.array([0.0, 0.0, 1.0]), -DISTANCE_M, np.zeros((4, 4)))
RAYS = np.column_stack([X / DISTANCE_M, Y / DISTANCE_M, np.ones_like(X)])
POSE = Rotation.from_rotvec([0.1, -0.05, 0.2]).as_matrix(), np.array([0.02, 0.01, 0.1])


def test_height_of_a_curvature() -> None:
    """k_xx = 0.002 1/m is 0.25 mm at 0.5 m, less its mean over the panel; no plane is in it."""
    bulge = Bulge.unknown(RAYS, FACING, 0.001).changed(np.array([0.002, 0.0, 0.0]))
    height = bulge.shifts()[:, 2]
    np.testing.assert_allclose(height, 0.001 * (X**2 - np.mean(X**2)), atol=1e-15)
    np.testing.assert_allclose(np.column_stack([np.ones_like(X), X, Y]).T @ height, 0, atol=1e-15)
    np.testing.assert_allclose(bulge.shifts()[:, :2], 0, atol=1e-18)


def test_what_is_expected_is_a_height_at_the_edge() -> None:
    """A standard deviation of 1 mm at the corners, 0.58 m from the middle, along any diagonal of the curvature."""
    bulge = Bulge.unknown(RAYS, FACING, 0.001)
    np.testing.assert_allclose(np.sqrt(np.diag(bulge.covariance)), 2 * 0.001 / (0.5**2 + 0.3**2))
    assert not bulge.values.any()


def test_subsets_that_the_reference_lacks_change_nothing() -> None:
    rays = np.vstack([RAYS, np.full(3, np.nan)])
    with_gap, without = (Bulge.unknown(some, FACING, 0.001) for some in (rays, RAYS))
    np.testing.assert_allclose(with_gap.heights[:-1], without.heights)
    assert np.isnan(with_gap.heights[-1]).all()


def test_nearer_is_seen_farther_out() -> None:
    """A point that comes nearer by h seems to move out by f x h / (Z (Z - h))."""
    bulge = Bulge.unknown(RAYS, FACING, 0.001).changed(np.array([0.0, 0.0, 0.004]))
    nearer = -bulge.shifts()[:, 2]
    seen = bulge.parallax_px(CAMERA, FACING.points(RAYS), (np.eye(3), np.zeros(3)))
    expected = CAMERA.fx * np.column_stack([X, Y]) * (nearer / (DISTANCE_M * (DISTANCE_M - nearer)))[:, None]
    np.testing.assert_allclose(seen, expected, atol=1e-9)


def test_doubts_are_the_parallax_of_one_standard_deviation() -> None:
    """Independent errors of a curvature that is known to 1e-4 1/m in one combination, against differences."""
    direction = np.array([0.6, -0.5, 0.3]) * 1e-4
    bulge = Bulge.unknown(RAYS, FACING, 0.001).changed(np.zeros(3), np.outer(direction, direction))
    points = FACING.points(RAYS)
    (doubt,) = bulge.doubts_px(CAMERA, points, POSE)
    seen = bulge.changed(direction).parallax_px(CAMERA, points, POSE)
    np.testing.assert_allclose(doubt * np.sign(np.sum(doubt * seen)), seen, rtol=2e-3, atol=1e-6)


def test_none_has_no_curvature() -> None:
    none = Bulge.none(len(X))
    assert none.steps().shape == (0, len(X), 3)
    np.testing.assert_array_equal(none.parallax_px(CAMERA, FACING.points(RAYS), POSE), 0)
    assert none.doubts_px(CAMERA, FACING.points(RAYS), POSE).shape == (0, len(X), 2)
