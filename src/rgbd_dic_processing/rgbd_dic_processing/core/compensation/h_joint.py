"""h_joint: the pose together with a low-order deformation on each side of the crack and the jump across it.

A panel without a rigid part deforms and opens while the camera moves, and to the six parameters of a pose some of that
looks like motion: an opening like coming nearer, bending like turning. Here both are estimated at once. What no image
can tell apart, a deformation that looks exactly like a motion, is shared out by the energy that it costs: of all that
explains the image, the least deformed panel is taken, and what was left to that choice is in the uncertainty.
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
SETTLING = 5  # iterations in which the misfit and the strains are estimated along
CONVERGED_PX = 1e-5  # RMS change of the reprojection at which the iteration ends
STRAIN_ITERATIONS = 30  # of the strains, in each of them
CONCENTRATED = 4.0  # a real field puts its energy into few of the coefficients: a quarter of them is taken to carry it
LEAST_STRAIN = 1e-8  # a panel is not believed to be stiffer
POOLED = 0.3  # how much the strain of all degrees counts in that of each, as a part of its number of coefficients


@dataclass(frozen=True)
class JointFit:
    """Pose and deformation of the fixed region, at their most likely.

    used: (M,), indices of the subsets that were used.
    coefficients, strains: (q,) of the basis, and the standard deviation that those of each degree have (order,).
    gain: (6, M, 2), change of the pose (rotation vector, translation) by the subsets' pixels.
    confounded: (6, 6), covariance of the pose from what the image cannot tell from deformation.
    residual_px, misfit_px: (M, 2), and the standard deviation on each axis that is left beside the DIC's noise.
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
    """The homography of the most likely pose.

    Raises:
        MeasurementError: if it does not converge, or the fixed region moves unlike a smoothly deformed plane.
    """
    fit = fit_joint(view, settings)
    used, sigma_px = fit.used, np.hypot(view.sigma_px, fit.misfit_px)
    agreeing = np.linalg.norm(fit.residual_px / sigma_px[used], axis=1) <= 3 * settings.robust_sigmas
    residual_px = float(np.sqrt(np.mean(np.sum(fit.residual_px[agreeing] ** 2, axis=1)))) if agreeing.any() else np.inf
    if residual_px > settings.inlier_px or agreeing.sum() < min(settings.min_subsets, len(used)):
        raise MeasurementError(
            f"h_joint: the fixed region moves unlike a smoothly deformed plane (residual {residual_px:.2f} px RMS, "
            f"at most {settings.inlier_px:g} px): the crack's line may be wrong, or there is another crack"
        )

    def motion(pose: Pose, plane: Plane) -> HomographyMotion:
        return HomographyMotion(plane_homography(view.camera, *pose, plane))

    best = motion(fit.pose, view.reference_plane)
    dic_modes, coupling = linear_modes(fit.gain, sigma_px, view.correlation, used)
    steps = [*dic_modes, *independent_modes(fit.confounded)]
    modes = [motion(displaced(fit.pose, step), view.reference_plane) for step in steps]
    for mode in independent_modes(view.reference_plane.inverse_depth_covariance()):
        plane = Plane.from_inverse_depth(view.reference_plane.inverse_depth + mode)
        at = view.reference_px[used]
        shift = motion(fit.pose, plane).move(at) - best.move(at)
        modes.append(motion(displaced(fit.pose, -np.tensordot(fit.gain, shift, 2)), plane))
    return Compensation(best, tuple(modes), coupling, residual_px, fit.misfit_px)


def pose_beside_deformation(view: FrameView, settings: CompensationSettings) -> Pose | None:
    """The most likely pose, for methods that take the fixed region as rigid: how far theirs is from it is what the
    deformation may do to them. None if the region moves like a rigid plane to within the DIC's noise.

    Raises:
        MeasurementError: if it does not converge.
    """
    fixed, plane = view.fixed, view.reference_plane
    start = pose_from_homography(view.camera, view.seed, plane)
    sigma_px = view.sigma_px[fixed]
    *_, misfit_px = fit_pose(
        view.camera, view.reference_px[fixed], view.moved_px[fixed], sigma_px, plane, start, settings.robust_sigmas
    )
    return fit_joint(view, settings).pose if misfit_px > np.median(sigma_px) else None


def fit_joint(view: FrameView, settings: CompensationSettings) -> JointFit:
    """The most likely pose and deformation of the fixed region.

    Minimises sum rho(|m' - project(R (X + U D c) + t)| / s) / k + sum c^T E_d c / T_d^2 over R, t and c. rho is Huber's
    loss; s^2 = sigma^2 + misfit^2 as for h_pose; k is how many subsets see the same noise, as they overlap; D are the
    basis' modes, U the panel's axes, E_d the energy of degree d. T_d, the size of the strains, is what makes the image
    most likely; see `_most_likely`. A rigid panel is found to be rigid, and its pose is that of h_pose.

    Raises:
        MeasurementError: if it does not converge.
    """
    camera, plane, used = view.camera, view.reference_plane, view.fixed
    if len(used) > MOST_SUBSETS:
        used = np.sort(np.random.default_rng(0).permutation(used)[:MOST_SUBSETS])
    seen_px, target_px, sigma_px = view.reference_px[used], view.moved_px[used], view.sigma_px[used]
    start = pose_from_homography(camera, view.seed, plane)
    (R, t), *_ = fit_pose(camera, seen_px, target_px, sigma_px, plane, start, settings.robust_sigmas)
    basis = _basis(view, used, settings.deformation_order)
    modes, points = basis.modes @ view.panel.axes.T, plane.points(camera.rays(seen_px))
    focal = np.array([camera.fx, camera.fy])
    shared = view.correlation[used][:, used].sum() / len(used)
    c, strains, misfit_px = np.zeros(len(modes)), np.full(settings.deformation_order, 1e-3), 0.0
    for iteration in range(MAX_ITERATIONS):
        turned = (points + np.tensordot(c, modes, 1)) @ R.T
        moved = turned + t
        residual = target_px - camera.project(moved)
        jacobian = np.concatenate([pose_jacobian(focal, turned, moved), pixel_jacobian(focal, modes @ R.T, moved)])
        settling = iteration < SETTLING
        if settling:
            misfit_px = misfit_of(residual, sigma_px)
        variance = sigma_px**2 + misfit_px**2
        lengths = np.sqrt(np.sum(residual**2 / variance, axis=1))
        huber = np.minimum(1, settings.robust_sigmas / np.maximum(lengths, 1e-12))
        weighted = jacobian * (huber[:, None] / variance / shared)
        flat, flat_weighted = (each.reshape(len(jacobian), -1) for each in (jacobian, weighted))
        normal = flat_weighted @ flat.T
        by_data = flat_weighted @ residual.ravel() + normal[:, POSE:] @ c  # for the coefficients, not for their step
        if settling:
            strains = _likely_strains(normal, by_data, basis, strains)
        solution, covariance, prior = _solve(normal, by_data, basis, strains)
        step = np.concatenate([solution[:POSE], solution[POSE:] - c])
        (R, t), c = displaced((R, t), solution[:POSE]), solution[POSE:]
        if not settling and np.sqrt(np.mean(np.square(step @ flat))) < CONVERGED_PX:
            gain = np.tensordot(covariance[:POSE], weighted, 1)
            confounded = CONCENTRATED * (covariance @ prior @ covariance)[:POSE, :POSE]
            return JointFit((R, t), used, c, strains, gain, confounded, residual, misfit_px)
    raise MeasurementError("h_joint: pose and deformation of the fixed region did not converge")


def _basis(view: FrameView, used: NDArray[np.intp], order: int) -> DeformationBasis:
    right, on_panel = view.panel.right[used], view.panel.points_m[used]
    if right.all() or not right.any():  # the crack is not in the region: turns are about its middle
        on_panel = on_panel - on_panel.mean(axis=0)
    return DeformationBasis.of(on_panel, right, order)


def _solve(normal: Array, by_data: Array, basis: DeformationBasis, strains: Array) -> tuple[Array, Array, Array]:
    """Solution (6 + q,) and covariance of the linear problem, and the weight of the prior (6 + q, 6 + q)."""
    prior = np.zeros_like(normal)
    prior[POSE:, POSE:] = np.tensordot(strains**-2, basis.energies, 1)
    covariance = np.linalg.inv(normal + prior)
    return covariance @ by_data, covariance, prior


def _likely_strains(normal: Array, by_data: Array, basis: DeformationBasis, strains: Array) -> Array:
    """The strains (order,) that make the image most likely.

    T_d^2 is the energy of degree d over the number of its coefficients that the image determines (MacKay, Bayesian
    interpolation, Neural Computation 4 (1992) 415). Few coefficients leave it uncertain, and a degree that is not seen
    would be taken as absent; so some of the energy of all degrees is added to each.
    """
    for _ in range(STRAIN_ITERATIONS):
        solution, covariance, _ = _solve(normal, by_data, basis, strains)
        c = solution[POSE:]
        undetermined = np.einsum("dpq,pq->d", basis.energies, covariance[POSE:, POSE:]) / strains**2
        known = np.maximum(basis.counts - undetermined, 0)
        energy = np.maximum(np.einsum("p,dpq,q->d", c, basis.energies, c), 0)
        common, trust = energy.sum() / max(known.sum(), 1.0), POOLED * basis.counts
        before, strains = strains, np.sqrt((energy + trust * common) / (known + trust))
        strains = np.maximum(strains, LEAST_STRAIN)
        if np.all(np.abs(strains - before) < 1e-2 * before):
            break
    return strains
