"""The shape of the panel from views that all share the noise of the reference image, against exact truth."""

from __future__ import annotations

import numpy as np
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_processing.core.geometry import Plane, plane_homography
from rgbd_dic_processing.core.panel_surface import Surface
from rgbd_dic_processing.core.reference_noise import SharedReference
from rgbd_dic_processing.core.surface_estimate import SurfaceEstimate
from scipy.spatial.transform import Rotation

CAMERA = Camera(480, 360, 820.0, 820.0, 240.0, 180.0)
PLANE = Plane(np.array([0.05, -0.03, 1.0]) / np.linalg.norm([0.05, -0.03, 1.0]), -1.1, 1e-6 * np.eye(4))
GRID = np.stack(np.meshgrid(np.arange(30.0, 240, 15), np.arange(30.0, 340, 15)), axis=-1).reshape(-1, 2)
SIGMA_PX = 0.005
REFERENCE_PART = 0.5  # of the variance is noise of the reference
VIEWS, FLIGHTS = 60, 12


def estimated(seed: int, reference_px: np.ndarray = GRID) -> Surface:
    """From views of a flat panel by a camera that stays turned to one side of where it took the reference."""
    rng = np.random.default_rng(seed)
    estimate, every = SurfaceEstimate(CAMERA, reference_px, 0.005, 3.0), np.arange(len(reference_px))
    sigma = np.full_like(reference_px, SIGMA_PX)
    rays = CAMERA.rays(reference_px + rng.normal(0, SIGMA_PX * np.sqrt(REFERENCE_PART), reference_px.shape))
    for _ in range(VIEWS):
        R = Rotation.from_rotvec(np.radians(rng.normal([2.0, -1.5, 8.0], 1.0))).as_matrix()
        t = PLANE.d * (R - np.eye(3)) @ [0, 0, 1] + rng.normal(0, 0.01, 3)  # about the middle of the panel
        own = rng.normal(0, SIGMA_PX * np.sqrt(1 - REFERENCE_PART), reference_px.shape)
        seen = CAMERA.project(PLANE.points(rays) @ R.T + t) + own
        estimate.learn(PLANE, None, seen, sigma, every, 1.0, plane_homography(CAMERA, R, t, PLANE))
    return estimate.surface(PLANE, None)


def test_the_shape_is_known_as_well_as_is_stated() -> None:
    """Three numbers of 12 flights: their mean of chi^2 / 3 is 1 +- 0.24. Views that are taken for independent, though
    half of their noise is the reference's, give 39."""
    errors = [estimated(seed) for seed in range(FLIGHTS)]
    curved = [(surface.inverse_depth[3:], surface.covariance[3:, 3:]) for surface in errors]
    chi2 = np.mean([error @ np.linalg.solve(covariance, error) / 3 for error, covariance in curved])
    assert 0.3 < chi2 < 1.75, chi2


def test_eight_subsets_are_enough_to_go_on() -> None:
    """Fewer than the coefficients of their errors."""
    surface = estimated(1, np.array([(30.0 + 40 * k, y) for k in range(4) for y in (100.0, 200.0)]))
    assert np.all(np.isfinite(surface.covariance)) and np.all(np.linalg.eigvalsh(surface.covariance) > 0)


def test_an_error_that_all_views_share_is_found() -> None:
    """Two parameters and a smooth error of 0.01 px, without noise: both are what they were."""
    rng = np.random.default_rng(1)
    shared = SharedReference(GRID, 2)
    every, upright = np.arange(len(GRID)), np.broadcast_to(np.eye(2), (len(GRID), 2, 2))
    by_error = shared.by_error(every, upright)
    error = np.tensordot(rng.normal(0, 0.01, len(by_error)), by_error, 1)
    true = np.array([0.3, -0.2])
    for _ in range(4):
        by_parameter = rng.normal(0, 1, (2, 1, 1)) * by_error[[3, 17]]
        seen = np.tensordot(true, by_parameter, 1) + error
        rows = np.concatenate([by_parameter, by_error]).reshape(2 + len(by_error), -1)
        weight = 1e8
        shared.add(weight * rows @ rows.T, weight * rows @ seen.ravel(), every, np.ones_like(GRID))
    np.testing.assert_allclose(np.linalg.solve(shared.information, shared.weighed), true, atol=1e-5)
