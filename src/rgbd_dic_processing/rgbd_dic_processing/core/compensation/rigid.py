"""The rigid transform between the fixed region's 3D centres in the reference and in a frame: h_3d and pc_3d."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import MeasurementError
from scipy.spatial.transform import Rotation

from ..error_sources import ErrorSource
from ..geometry import Plane, rigid_transform, skew
from ..msac import msac
from ..settings import CompensationSettings
from ..uncertainty import independent_modes, linear_modes
from .h_joint import pose_beside_deformation
from .motion import FrameView

Array = NDArray[np.float64]
Pose = tuple[Array, Array]


@dataclass(frozen=True)
class RigidFit:
    """R, t of X' = R X + t; the subsets used; and the fit again for each independent error.

    Each of `modes` is (pose, reference plane, plane) with one error of one standard deviation: of the DIC centres, of
    the reference's plane, of this frame's plane, and of what a deformation of the fixed region does to the pose;
    `sources` tells which.
    `coupling` is that of `Compensation`.
    """

    pose: Pose
    used: NDArray[np.intp]
    modes: tuple[tuple[Pose, Plane, Plane], ...]
    sources: tuple[ErrorSource, ...]
    coupling: Array


def fit_rigid(view: FrameView, settings: CompensationSettings) -> RigidFit:
    """Rigid MSAC on the 3D centres, which the two planes give (Eq. 2.1, 2.2); the thesis' estimateGeometricTransform3D.

    Raises:
        MeasurementError: if no rigid transform fits enough subsets.
    """
    source = view.reference_plane.points(view.camera.rays(view.reference_px[view.fixed]))
    target = view.plane.points(view.camera.rays(view.moved_px[view.fixed]))
    footprint = -view.plane.d / view.camera.fx

    def residuals(pose: Pose) -> Array:
        return np.linalg.norm(target - source @ pose[0].T - pose[1], axis=1)

    pose, inliers = msac(
        len(source),
        3,
        lambda chosen: rigid_transform(source[chosen], target[chosen]),
        residuals,
        settings.inlier_px * footprint,
        settings.max_trials,
    )
    if inliers.sum() < settings.min_subsets:
        raise MeasurementError(
            f"rigid fit: {inliers.sum()} subsets of the fixed region agree, at least {settings.min_subsets} needed"
        )
    used = view.fixed[inliers]
    modes, sources, coupling = _modes(view, pose, used)
    likely = pose_beside_deformation(view, settings)
    if likely is not None:
        modes.append((likely, view.reference_plane, view.reference_plane.moved(*likely)))
        sources.append(ErrorSource.DEFORMATION)
    return RigidFit(pose, used, tuple(modes), tuple(sources), coupling)


def _modes(
    view: FrameView, pose: Pose, used: NDArray[np.intp]
) -> tuple[list[tuple[Pose, Plane, Plane]], list[ErrorSource], Array]:
    centre_modes, coupling = _centre_modes(view, pose, used)
    modes = [(moved, view.reference_plane, view.plane) for moved in centre_modes]
    sources = [ErrorSource.MOTION] * len(modes)
    for plane in _plane_modes(view.reference_plane):
        seen = view.with_reference_plane(plane)
        modes.append((_refit(seen, used), plane, seen.plane))
        sources.append(ErrorSource.REFERENCE_PLANE)
    for plane in _plane_modes(view.plane):
        modes.append((_refit(replace(view, plane=plane), used), view.reference_plane, plane))
        sources.append(ErrorSource.FRAME_PLANE)
    return modes, sources, coupling


def _refit(view: FrameView, used: NDArray[np.intp]) -> Pose:
    return rigid_transform(
        view.reference_plane.points(view.camera.rays(view.reference_px[used])),
        view.plane.points(view.camera.rays(view.moved_px[used])),
    )


def _plane_modes(plane: Plane) -> list[Plane]:
    return [
        Plane.from_inverse_depth(plane.inverse_depth + mode)
        for mode in independent_modes(plane.inverse_depth_covariance())
    ]


def _centre_modes(view: FrameView, pose: Pose, used: NDArray[np.intp]) -> tuple[list[Pose], Array]:
    """The pose displaced by each independent error that the DIC's uncertainty causes, and their coupling.

    To first order the fit solves sum |dX' - w x (R X) - dt|^2 with dX' = (z/f) (du, dv, 0).
    """
    R, t = pose
    turned = view.reference_plane.points(view.camera.rays(view.reference_px[used])) @ R.T
    jacobian = np.concatenate([-skew(turned), np.broadcast_to(np.eye(3), (len(used), 3, 3))], axis=2)
    depth = (turned + t)[:, 2]
    normal_matrix = np.einsum("mip,miq->pq", jacobian, jacobian)
    per_pixel = np.stack([depth / view.camera.fx, depth / view.camera.fy], axis=1)
    sensitivity = np.einsum("pq,miq,mi->pmi", np.linalg.inv(normal_matrix), jacobian[:, :2], per_pixel)
    modes, coupling = linear_modes(sensitivity, view.sigma_px, view.correlation, used)
    return [(Rotation.from_rotvec(mode[:3]).as_matrix() @ R, t + mode[3:]) for mode in modes], coupling
