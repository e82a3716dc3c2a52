"""h_pose: the plane-induced homography of the pose that minimises the reprojection error of the fixed region.

Six parameters with the plane (n, d) of the reference, averaged over many ToF frames: it cannot absorb deformation the
way a free projective fit can, and does not see the ToF noise of single frames.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.columns import columns
from rgbd_dic_acquisition.errors import MeasurementError
from scipy.spatial.transform import Rotation

from rgbd_dic_processing import _kernel

from ..error_sources import ErrorSource
from ..geometry import Plane, apply_homography, plane_homographies, plane_homography
from ..settings import CompensationSettings
from ..uncertainty import independent_modes, linear_modes
from .motion import MEDIAN_LENGTH, Compensation, FrameView, HomographyMotion

Array = NDArray[np.float64]
Pose = tuple[Array, Array]

MAX_ITERATIONS = 30
MISFIT_ITERATIONS = 5  # in which the misfit is estimated along with the pose
CONVERGED_PX = 1e-7  # RMS change of the reprojection at which the iteration ends


def compensate(view: FrameView, settings: CompensationSettings) -> Compensation:
    """Robust (Huber) Gauss-Newton on the pose; residuals are weighted by the DIC's own uncertainty.

    Raises:
        MeasurementError: if the iteration does not converge or the fixed region does not move like a plane.
    """
    fixed = view.fixed
    source, target = view.reference_px[fixed], view.moved_px[fixed]
    data = (view.camera, source, target, view.sigma_px[fixed])
    pose, jacobian, weights, misfit_px = fit_pose(*data, view.reference_plane, view.seed_pose, settings.robust_sigmas)
    motion = HomographyMotion(plane_homography(view.camera, *pose, view.reference_plane))
    sigma_px = np.hypot(view.sigma_px, misfit_px)
    squared = (target - motion.move(source)) ** 2
    agreeing = np.sum(squared / sigma_px[fixed] ** 2, axis=1) <= (3 * settings.robust_sigmas) ** 2
    residual_px = np.sqrt(squared[agreeing].sum() / agreeing.sum()) if agreeing.any() else np.inf
    if residual_px > settings.inlier_px or agreeing.sum() < settings.min_subsets:
        raise MeasurementError(
            f"h_pose: the fixed region moves unlike a rigid plane (residual {residual_px:.2f} px RMS, "
            f"at most {settings.inlier_px:g} px): it may hold the crack, or the reference plane is wrong"
        )
    by_pixel = sensitivity(jacobian, weights)
    dic_modes, coupling = linear_modes(by_pixel, sigma_px, view.correlation, fixed)
    pi = view.reference_plane.inverse_depth
    planes = pi + independent_modes(view.reference_plane.inverse_depth_covariance())
    seen = apply_homography(plane_homographies(view.camera, *pose, planes), source)
    follow = (target - seen).reshape(len(planes), 2 * len(fixed)) @ by_pixel.reshape(6, -1).T  # the fits, to 1st order
    poses = displaced(pose, np.concatenate([dic_modes, follow]))
    of_poses = np.concatenate([np.broadcast_to(pi, (len(dic_modes), 3)), planes])
    modes = tuple(HomographyMotion(moved) for moved in plane_homographies(view.camera, *poses, of_poses))
    sources = [ErrorSource.MOTION] * len(dic_modes) + [ErrorSource.REFERENCE_PLANE] * len(planes)
    return Compensation(motion, modes, tuple(sources), coupling, float(residual_px), misfit_px)


def fit_pose(
    camera: Camera,
    source_px: Array,
    target_px: Array,
    sigma_px: Array,
    plane: Plane,
    start: Pose,
    robust_sigmas: float,
) -> tuple[Pose, Array, Array, float]:
    """Pose (R, t) that moves points of a known plane onto where they are seen.

    Minimises sum rho(|m' - project(R X + t)| / s), X on the plane; rho is Huber's, s^2 = sigma^2 + misfit^2 with the
    misfit that the residuals' median length asks for.

    Args:
        source_px, target_px: (M, 2) ideal pixels of the frame of the plane and of the other frame.
        sigma_px: (M, 2) standard uncertainty of target_px.

    Returns:
        R (3, 3) and t (3,) [m]; the Jacobian (6, M, 2) of the pixels by (rotation vector, translation); the weights
        (M, 2) [1/px^2]; the misfit [px].

    Raises:
        MeasurementError: if it does not converge.
    """
    fitted = _kernel.fit_pose(
        *(np.ascontiguousarray(a, float) for a in (plane.points(camera.rays(source_px)), target_px, sigma_px, *start)),
        (camera.fx, camera.fy, camera.cx, camera.cy),
        robust_sigmas=robust_sigmas,
        median_length=MEDIAN_LENGTH,
        converged_px=CONVERGED_PX,
        max_iterations=MAX_ITERATIONS,
        misfit_iterations=MISFIT_ITERATIONS,
    )
    if fitted is None:
        raise MeasurementError("the pose of the fixed region did not converge")
    R, t, jacobian, weights, misfit_px = fitted
    return (R, t), jacobian, weights, misfit_px


def sensitivity(jacobian: Array, weights: Array) -> Array:
    """d (rotation vector, translation) / d pixel, (6, M, 2), of a fit with the Jacobian and weights of `fit_pose`."""
    by_pose = jacobian.reshape(6, -1)
    weighted = by_pose * weights.ravel()
    return np.linalg.solve(weighted @ by_pose.T, weighted).reshape(jacobian.shape)


def pose_jacobian(focal: Array, turned: Array, moved: Array) -> Array:
    """d pixel / d (rotation vector, translation), (6, M, 2), for R <- exp(w) R, t <- t + dt."""
    (x, y, z), depth = turned.T, moved[:, 2]
    u, v = moved[:, 0] / depth, moved[:, 1] / depth
    by_pose = np.empty((6, 2, len(depth)))  # each coordinate together in memory, as in `columns`
    by_pose[0] = -u * y, -z - v * y
    by_pose[1] = z + u * x, v * x
    by_pose[2] = -y, x
    by_pose[3:5] = np.eye(2)[..., None]
    by_pose[5] = -u, -v
    by_pose *= focal[:, None] / depth
    return by_pose.transpose(0, 2, 1)


def pixel_jacobian(focal: Array, steps: Array, moved: Array) -> Array:
    """(k, M, 2), by how many pixels points (M, 3) in the camera's frame move with steps (k, M, 3)."""
    x, y, z = moved.T
    by_x, by_y, by_z = np.moveaxis(steps, -1, 0)
    return columns((by_x - (x / z) * by_z) / z * focal[0], (by_y - (y / z) * by_z) / z * focal[1])


def displaced(pose: Pose, step: Array) -> Pose:
    """A pose after a step (6,), or after each of several (k, 6): R (k, 3, 3) and t (k, 3)."""
    return Rotation.from_rotvec(step[..., :3]).as_matrix() @ pose[0], pose[1] + step[..., 3:]
