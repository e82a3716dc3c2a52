"""h_joint: the pose together with a low-order deformation on each side of the crack and the jump across it.

A panel without a rigid part deforms and opens while the camera moves, and to the six parameters of a pose some of that
looks like motion: an opening like coming nearer, bending like turning. Here both are estimated at once. What no image
can tell apart, a deformation that looks exactly like a motion, is shared out by the energy that it costs: of all that
explains the image, the least deformed panel is taken, and what was left to that choice is in the uncertainty.

Seen from the side, a panel whose plane is not quite known looks strained too. So its shape is estimated along, as far
as it is not known from the ToF sensor and earlier images. A loaded panel bulges, too, and what comes nearer looks
stretched, by the third power of the place: a few numbers tell that from what polynomials of the sides would have to do.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import MeasurementError
from scipy.linalg import block_diag

from ..bulge import Bulge
from ..deformation import DeformationBasis
from ..error_sources import ErrorSource
from ..geometry import Plane, plane_homography, pose_from_homography
from ..panel_surface import Surface
from ..settings import CompensationSettings
from ..surface_estimate import ShapeEvidence, ShapeView
from ..uncertainty import independent_modes, linear_modes, overlaps
from .h_pose import Pose, displaced, fit_pose, pixel_jacobian, pose_jacobian
from .joint_fit import JointFit
from .joint_problem import CONCENTRATED, POSE, JointProblem
from .motion import Compensation, FrameView, HomographyMotion, misfit_of

Array = NDArray[np.float64]

PLANE = 3  # parameters of the shape, the first ones
MOST_SUBSETS = 800  # of the fixed region that are used: they overlap, and more tell hardly more
MAX_ITERATIONS = 20
SETTLING = 5  # iterations in which the misfit and the strains are estimated along
CONVERGED_PX = 1e-5  # RMS change of the reprojection at which the iteration ends


def compensate(view: FrameView, settings: CompensationSettings) -> Compensation:
    """The homography of the most likely pose.

    Raises:
        MeasurementError: if it does not converge, or the fixed region moves unlike a smoothly deformed plane.
    """
    surface = view.surface or Surface.flat(view.camera, view.reference_px, view.reference_plane)
    fit = fit_joint(view, settings, surface)
    if view.changes is not None:
        change = view.changes(fit.pose, *(each[:POSE, :POSE] for each in (fit.by_deformation, fit.confounded)))
        fit = fit if change is None else fit.beside(change)
    used, sigma_px = fit.used, np.hypot(view.sigma_px, fit.misfit_px)
    agreeing = np.linalg.norm(fit.residual_px / sigma_px[used], axis=1) <= 3 * settings.robust_sigmas
    residual_px = float(np.sqrt(np.mean(np.sum(fit.residual_px[agreeing] ** 2, axis=1)))) if agreeing.any() else np.inf
    if residual_px > settings.inlier_px or agreeing.sum() < min(settings.min_subsets, len(used)):
        raise MeasurementError(
            f"h_joint: the fixed region moves unlike a smoothly deformed plane (residual {residual_px:.2f} px RMS, "
            f"at most {settings.inlier_px:g} px): the crack's line may be wrong, or there is another crack"
        )
    found = fit.shape.surface.plane

    def motion(step: Array) -> HomographyMotion:
        plane = Plane.from_inverse_depth(found.inverse_depth + step[POSE:])
        return HomographyMotion(plane_homography(view.camera, *displaced(fit.pose, step[:POSE]), plane))

    moved = POSE + PLANE
    dic_modes, coupling = linear_modes(fit.gain[:moved], sigma_px, view.correlation, used)
    confounded = independent_modes(fit.confounded[:moved, :moved])
    by_tof = independent_modes(fit.by_tof[:moved, :moved])
    modes = tuple(motion(step) for step in (*dic_modes, *confounded, *by_tof))
    sources = (ErrorSource.MOTION,) * len(dic_modes) + (ErrorSource.DEFORMATION,) * len(confounded)
    sources += (ErrorSource.FRAME_PLANE,) * len(by_tof)
    best = motion(np.zeros(moved))
    return Compensation(best, modes, sources, coupling, residual_px, fit.misfit_px, fit.shape, fit.pose, fit.bulge)


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


def fit_joint(view: FrameView, settings: CompensationSettings, surface: Surface | None = None) -> JointFit:
    """The most likely pose, shape and deformation of the fixed region.

    Minimises sum rho(|m' - project(R (X(s) + U D c + n h . b) + t)| / e) / k + sum c^T E_d c / T_d^2 + |s - s_0|^2
    + |b|^2 over R, t, c, s and b. rho is Huber's loss; e^2 = sigma^2 + misfit^2 as for h_pose; k is how many subsets
    see the same noise, as they overlap; D are the basis' modes, U the panel's axes, E_d the energy of degree d. T_d,
    the size of the strains, is what makes the image most likely (`JointProblem.likely_strains`). X are the points on
    the surface, whose parameters s_0 are known with their covariance, which weighs the term; without a surface they are
    those of the reference plane. b is the bulge along the normal n (`Bulge`), weighed by what is expected. Subsets that
    see both sides of the crack follow neither, and are left out. A rigid panel is found to be rigid, and its pose is
    that of h_pose.

    Raises:
        MeasurementError: if it does not converge, or too few subsets lie beside the crack.
    """
    camera, plane, used = view.camera, view.reference_plane, view.fixed[~view.panel.astride[view.fixed]]
    if len(used) < settings.min_subsets:
        raise MeasurementError(
            f"h_joint: {len(used)} valid subsets of the fixed region lie beside the crack, at least "
            f"{settings.min_subsets} needed"
        )
    if len(used) > MOST_SUBSETS:
        used = np.sort(np.random.default_rng(0).permutation(used)[:MOST_SUBSETS])
    seen_px, target_px, sigma_px = view.reference_px[used], view.moved_px[used], view.sigma_px[used]
    start = pose_from_homography(camera, view.seed, plane)
    (R, t), *_ = fit_pose(camera, seen_px, target_px, sigma_px, plane, start, settings.robust_sigmas)
    basis = _basis(view, used, settings.deformation_order)
    modes = basis.modes @ view.panel.axes.T
    before = (surface or Surface.flat(camera, view.reference_px, plane)).part(used)
    of_surface = np.zeros((0, 0)) if surface is None else np.linalg.inv(before.covariance)
    bulge = Bulge.none(len(view.reference_px)) if surface is None or view.bulge is None else view.bulge
    of_used = bulge.part(used)
    known = block_diag(of_surface, np.linalg.inv(bulge.covariance))
    curved, shaped = len(of_surface), len(known)
    focal = np.array([camera.fx, camera.fy])
    shared = overlaps(view.correlation, used) / len(used)
    x, strains, misfit_px = np.zeros(shaped + len(modes)), np.full(settings.deformation_order, 1e-3), 0.0
    for iteration in range(MAX_ITERATIONS):
        now = before.changed(x[:curved]) if curved else before
        bulging = of_used.changed(x[curved:shaped]).shifts()
        turned = (now.points() + bulging + np.tensordot(x[shaped:], modes, 1)) @ R.T
        moved = turned + t
        residual = target_px - camera.project(moved)
        if not np.isfinite(residual).all():
            break
        steps = np.concatenate([now.steps()[:curved], of_used.steps(), modes]) @ R.T
        jacobian = np.concatenate([pose_jacobian(focal, turned, moved), pixel_jacobian(focal, steps, moved)])
        settling = iteration < SETTLING
        if settling:
            misfit_px = misfit_of(residual, sigma_px)
        variance = sigma_px**2 + misfit_px**2
        lengths = np.sqrt(np.sum(residual**2 / variance, axis=1))
        huber = np.minimum(1, settings.robust_sigmas / np.maximum(lengths, 1e-12))
        weights = huber[:, None] / variance / shared
        weighted = jacobian * weights
        flat, flat_weighted = (each.reshape(len(jacobian), -1) for each in (jacobian, weighted))
        normal = flat_weighted @ flat.T
        data = residual + np.tensordot(x, jacobian[POSE:], 1)  # for what is sought, not for its step
        by_data = flat_weighted @ data.ravel()
        linear = JointProblem(normal, by_data, known, basis)
        if settling and iteration > 0:  # not before a first fit: what it would explain is in the misfit still
            strains = linear.likely_strains(strains)
        solution, covariance = linear.solve(strains)
        step = np.concatenate([solution[:POSE], solution[POSE:] - x])
        (R, t), x = displaced((R, t), solution[:POSE]), solution[POSE:]
        if not settling and np.sqrt(np.mean(np.square(step @ flat))) < CONVERGED_PX:
            told = POSE + shaped
            gain = np.tensordot(covariance[:told], weighted, 1)
            by_deformation = (covariance @ linear.stiffness(strains) @ covariance)[:told, :told]
            by_shape = (covariance @ linear.known_before() @ covariance)[:told, :told]
            confounded = CONCENTRATED * by_deformation + by_shape
            shape = None
            if surface is not None:
                of_shape = slice(POSE, POSE + curved)
                found = surface.changed(x[:curved], covariance[of_shape, of_shape])
                others = np.r_[:POSE, of_shape.stop : len(jacobian)]
                known_of_others = linear.known_before() + linear.stiffness(strains) / CONCENTRATED
                evidence = ShapeView(
                    before=surface.inverse_depth,
                    subsets=used,
                    seed=view.seed,
                    sigma_px=sigma_px * np.sqrt(shared),
                    residual_px=data,
                    weights=weights,
                    by_shape=jacobian[of_shape],
                    by_others=jacobian[others],
                    stiffness=known_of_others[np.ix_(others, others)],
                )
                shape = ShapeEvidence(found, evidence)
            nothing, of_bulge = np.zeros_like(confounded), slice(POSE + curved, told)
            return JointFit(
                (R, t),
                used,
                x[shaped:],
                strains,
                gain,
                confounded,
                by_deformation,
                nothing,
                residual,
                misfit_px,
                shape,
                bulge.changed(x[curved:shaped], covariance[of_bulge, of_bulge]),
            )
    raise MeasurementError("h_joint: pose and deformation of the fixed region did not converge")


def _basis(view: FrameView, used: NDArray[np.intp], order: int) -> DeformationBasis:
    right, on_panel = view.panel.right[used], view.panel.points_m[used]
    if right.all() or not right.any():  # the crack is not in the region: turns are about its middle
        on_panel = on_panel - on_panel.mean(axis=0)
    return DeformationBasis.of(on_panel, right, order)
