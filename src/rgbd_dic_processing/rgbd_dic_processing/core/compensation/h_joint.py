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
from .h_pose import Pose, displaced, fit_pose, pixel_jacobian, pose_jacobian
from .motion import Compensation, FrameView, HomographyMotion, misfit_of

Array = NDArray[np.float64]

POSE = 6  # parameters: rotation vector and translation; the deformation's follow
MOST_SUBSETS = 800  # of the fixed region that are used: they overlap, and more tell hardly more
MAX_ITERATIONS = 20
MISFIT_ITERATIONS = 4  # in which the misfit is estimated along
CONVERGED_PX = 1e-5  # RMS change of the reprojection at which the iteration ends
STRAIN_ITERATIONS = 30  # of the strain's size, in each of them
LEAST_STRAIN = 1e-8  # a panel is not believed to be stiffer
POOLED = 0.3  # how much the strain of all degrees counts in that of each, as a part of its number of coefficients


@dataclass(frozen=True)
class JointFit:
    """Pose and deformation of the fixed region, at their most likely.

    used: (M,), indices of its subsets that were used.
    coefficients: (q,) of the basis. strain: the standard deviation that its coefficients were given [1].
    gain: (6, M, 2), change of the pose (rotation vector, translation) by the subsets' pixels.
    confounded: (6, 6), covariance of the pose from what the images cannot tell from deformation.
    residual_px, misfit_px: (M, 2) and the standard deviation on each axis that is left beside the DIC's noise.
    """

    pose: Pose
    used: NDArray[np.intp]
    coefficients: Array
    strains: Array
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
    fixed, sigma_px = fit.used, np.hypot(view.sigma_px, fit.misfit_px)
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
    if len(fixed) > MOST_SUBSETS:
        fixed = np.sort(np.random.default_rng(0).permutation(fixed)[:MOST_SUBSETS])
    sigma_px, target = view.sigma_px[fixed], view.moved_px[fixed]
    start = pose_from_homography(camera, view.seed, plane)
    (R, t), *_ = fit_pose(camera, view.reference_px[fixed], target, sigma_px, plane, start, settings.robust_sigmas)
    right, on_panel = view.panel.right[fixed], view.panel.points_m[fixed]
    if right.all() or not right.any():
        on_panel = on_panel - on_panel.mean(axis=0)
    basis = DeformationBasis.of(on_panel, right, settings.deformation_order)
    modes = basis.modes @ view.panel.axes.T
    points = plane.points(camera.rays(view.reference_px[fixed]))
    focal = np.array([camera.fx, camera.fy])
    shared = view.correlation[fixed][:, fixed].sum() / len(fixed)
    c, strains, misfit_px = np.zeros(len(modes)), np.full(settings.deformation_order, 1e-3), 0.0
    for iteration in range(MAX_ITERATIONS):
        turned = (points + np.tensordot(c, modes, 1)) @ R.T
        moved = turned + t
        residual = target - camera.project(moved)
        jacobian = np.concatenate([pose_jacobian(focal, turned, moved), pixel_jacobian(focal, modes @ R.T, moved)])
        if 0 < iteration < MISFIT_ITERATIONS:  # before, the deformation is in the residual
            misfit_px = misfit_of(residual, sigma_px)
        variance = sigma_px**2 + (misfit_px if iteration else misfit_of(residual, sigma_px)) ** 2
        lengths = np.sqrt(np.sum(residual**2 / variance, axis=1))
        huber = np.minimum(1, settings.robust_sigmas / np.maximum(lengths, 1e-12))
        weighted = jacobian * (huber[:, None] / variance / shared)
        flat = jacobian.reshape(len(jacobian), -1)
        flat_weighted = weighted.reshape(flat.shape)
        normal = flat_weighted @ flat.T
        by_data = flat_weighted @ residual.ravel() + normal[:, POSE:] @ c  # for the coefficients, not for their step
        solution, covariance, prior, strains = _most_likely(normal, by_data, basis, strains)
        step = np.concatenate([solution[:POSE], solution[POSE:] - c])
        (R, t), c = displaced((R, t), solution[:POSE]), solution[POSE:]
        if iteration >= MISFIT_ITERATIONS and np.sqrt(np.mean(np.square(step @ flat))) < CONVERGED_PX:
            gain = np.tensordot(covariance[:POSE], weighted, 1)
            confounded = (covariance @ prior @ covariance)[:POSE, :POSE]
            return JointFit((R, t), fixed, c, strains, gain, confounded, residual, misfit_px)
    raise MeasurementError("h_joint: pose and deformation of the fixed region did not converge")


def _most_likely(
    normal: Array, by_data: Array, basis: DeformationBasis, strains: Array
) -> tuple[Array, Array, Array, Array]:
    """Solution and covariance of the linear problem at the strains that make it most likely; the prior's weight too."""
    prior = np.zeros_like(normal)
    for _ in range(STRAIN_ITERATIONS):
        prior[POSE:, POSE:] = np.tensordot(strains**-2, basis.energies, 1)
        covariance = np.linalg.inv(normal + prior)
        solution = covariance @ by_data
        c = solution[POSE:]
        unknown = np.einsum("dpq,pq->d", basis.energies, covariance[POSE:, POSE:]) / strains**2
        before, energy = strains, np.maximum(np.einsum("p,dpq,q->d", c, basis.energies, c), 0)
        known = np.maximum(basis.counts - unknown, 0)
        pooled = energy.sum() / max(known.sum(), 1.0)
        trust = POOLED * basis.counts
        strains = np.maximum(np.sqrt((energy + trust * pooled) / (known + trust)), LEAST_STRAIN)
        if np.all(np.abs(strains - before) < 1e-2 * before):
            break
    return solution, covariance, prior, strains
