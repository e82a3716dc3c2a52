"""h_joint: the pose together with a low-order deformation of the panel on each side of the crack and the jump across it.

A panel without a rigid part deforms and opens while the camera moves, and to the six parameters of a pose some of that
looks like motion: an opening like coming nearer, bending like turning. Here both are estimated at once. What no image
can tell apart, a deformation that looks exactly like a motion, goes to the motion but for what the energy of the rest
makes likely: of all that explain the image the least deformed panel is taken, and what was left to that choice is in the
uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import MeasurementError

from ..deformation import DeformationBasis
from ..geometry import Plane, plane_homography, pose_from_homography
from ..settings import CompensationSettings
from ..uncertainty import independent_modes, linear_modes
from .h_pose import CONVERGED_PX, Pose, displaced, fit_pose, pixel_jacobian, pose_jacobian
from .motion import Compensation, FrameView, HomographyMotion, misfit_of

Array = NDArray[np.float64]

ITERATIONS = 30
ENERGY_ITERATIONS = 20  # of the strain's size, in each of them
LEAST_STRAIN = 1e-8  # a panel is not believed to be stiffer


@dataclass(frozen=True)
class JointFit:
    """Pose and deformation of the fixed region's M subsets, at their most likely.

    coefficients: (q,) of the basis. strain: the standard deviation that its coefficients were given [1].
    gain: (6, M, 2), change of the pose (rotation vector, translation) by the subsets' pixels.
    confounded: (6, 6), covariance of the pose from what the images cannot tell from deformation.
    residual_px, misfit_px: (M, 2) and the standard deviation on each axis that is left beside the DIC's noise.
    """

    pose: Pose
    coefficients: Array
    strain: float
    gain: Array
    confounded: Array
    residual_px: Array
    misfit_px: float


def compensate(view: FrameView, settings: CompensationSettings) -> Compensation:
    """Pose and deformation by robust Gauss-Newton, with the deformation's own size as prior.

    Raises:
        MeasurementError: if it does not converge, or the fixed region moves unlike a smoothly deformed plane.
    """
    fit = fit_joint(view, view.reference_plane, settings)
    fixed, sigma_px = view.fixed, np.hypot(view.sigma_px, fit.misfit_px)
    motion = HomographyMotion(plane_homography(view.camera, *fit.pose, view.reference_plane))
    agreeing = np.linalg.norm(fit.residual_px / sigma_px[fixed], axis=1) <= 3 * settings.robust_sigmas
    residual_px = float(np.sqrt(np.mean(np.sum(fit.residual_px[agreeing] ** 2, axis=1)))) if agreeing.any() else np.inf
    if residual_px > settings.inlier_px or agreeing.sum() < settings.min_subsets:
        raise MeasurementError(
            f"h_joint: the fixed region moves unlike a smoothly deformed plane (residual {residual_px:.2f} px RMS, "
            f"at most {settings.inlier_px:g} px): the crack's line may be wrong, or there is another crack"
        )
    dic_modes, coupling = linear_modes(fit.gain, sigma_px, view.correlation, fixed)
    steps = [*dic_modes, *independent_modes(fit.confounded)]
    poses = [(displaced(fit.pose, step), view.reference_plane) for step in steps]
    for mode in independent_modes(view.reference_plane.inverse_depth_covariance()):
        plane = Plane.from_inverse_depth(view.reference_plane.inverse_depth + mode)
        poses.append((fit_joint(view, plane, settings).pose, plane))
    modes = tuple(HomographyMotion(plane_homography(view.camera, *pose, plane)) for pose, plane in poses)
    return Compensation(motion, modes, coupling, residual_px, fit.misfit_px)


def fit_joint(view: FrameView, plane: Plane, settings: CompensationSettings) -> JointFit:
    """The most likely pose and deformation.

    Minimises sum rho(|m' - project(R (X + U D c) + t)| / s) / k + c^T E c / T^2 over R, t and c: rho is Huber's; s^2 =
    sigma^2 + misfit^2 as for h_pose; k is how many subsets see the same noise, as they overlap; D are the basis' modes
    and E its energy, U the panel's axes. T^2, the variance of the strains, is what makes the images most likely
    (expectation maximisation, Dempster, Laird and Rubin 1977): E[c^T E c] over the number of penalised coefficients. So
    a rigid panel is found to be rigid, and the pose as exact as that of h_pose.

    Raises:
        MeasurementError: if it does not converge.
    """
    camera, fixed = view.camera, view.fixed
    sigma_px, target = view.sigma_px[fixed], view.moved_px[fixed]
    start = pose_from_homography(camera, view.seed, plane)
    (R, t), *_ = fit_pose(camera, view.reference_px[fixed], target, sigma_px, plane, start, settings.robust_sigmas)
    right, on_panel = view.panel.right[fixed], view.panel.points_m[fixed]
    if right.all() or not right.any():
        on_panel = on_panel - on_panel.mean(axis=0)
    basis = DeformationBasis.of(on_panel, right, settings.deformation_order)
    modes = np.einsum("qmk,ik->qmi", basis.modes, view.panel.axes)
    points = plane.points(camera.rays(view.reference_px[fixed]))
    focal = np.array([camera.fx, camera.fy])
    shared = view.correlation[fixed][:, fixed].sum() / len(fixed)
    c, strain = np.zeros(len(modes)), 1e-3
    for _ in range(ITERATIONS):
        turned = (points + np.tensordot(c, modes, 1)) @ R.T
        moved = turned + t
        residual = target - camera.project(moved)
        jacobian = np.concatenate([pose_jacobian(focal, turned, moved), pixel_jacobian(focal, modes @ R.T, moved)])
        misfit_px = misfit_of(residual, sigma_px)
        variance = sigma_px**2 + misfit_px**2
        huber = np.minimum(1, settings.robust_sigmas / np.maximum(np.sqrt(np.sum(residual**2 / variance, axis=1)), 1e-12))
        weighted = jacobian * (huber[:, None] / variance / shared)
        flat, flat_weighted = jacobian.reshape(len(jacobian), -1), weighted.reshape(len(jacobian), -1)
        normal, by_data = flat_weighted @ flat.T, flat_weighted @ residual.ravel()
        by_data[6:] += normal[6:, 6:] @ c  # solved for the coefficients themselves, not for their step
        by_data[:6] += normal[:6, 6:] @ c
        solution, covariance, prior, strain = _most_likely(normal, by_data, basis, strain)
        (R, t), change = displaced((R, t), solution[:6]), solution[6:] - c
        c = solution[6:]
        step = np.concatenate([solution[:6], change])
        if np.sqrt(np.mean(np.square(np.tensordot(step, jacobian, 1)))) < CONVERGED_PX:
            break
    else:
        raise MeasurementError("h_joint: pose and deformation of the fixed region did not converge")
    gain = np.tensordot(covariance[:6], weighted, 1)
    confounded = (covariance @ prior @ covariance)[:6, :6]
    return JointFit((R, t), c, strain, gain, confounded, residual, misfit_px)


def _most_likely(normal: Array, by_data: Array, basis: DeformationBasis, strain: float) -> tuple[Array, Array, Array, float]:
    """Solution and covariance of the linear problem at the strain that makes it most likely; the prior's weight too."""
    prior = np.zeros_like(normal)
    for _ in range(ENERGY_ITERATIONS):
        prior[6:, 6:] = basis.energy / strain**2
        covariance = np.linalg.inv(normal + prior)
        solution = covariance @ by_data
        c = solution[6:]
        energy = c @ basis.energy @ c + np.sum(basis.energy * covariance[6:, 6:])
        strain = max(float(np.sqrt(energy / basis.penalised)), LEAST_STRAIN)
    return solution, covariance, prior, strain
