"""What h_joint found in one frame, and how the ToF sensor's plane tells motion from deformation beside it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..bulge import Bulge
from ..geometry import Plane
from ..panel_motion import pose_sensitivity
from ..plane_change import PlaneChange
from ..surface_estimate import ShapeEvidence
from .h_pose import Pose, displaced
from .joint_problem import POSE

Array = NDArray[np.float64]

CONTRADICTION = 4.0  # standard deviations by which the plane and the image may differ


@dataclass(frozen=True)
class JointFit:
    """Pose, shape and deformation of the fixed region, at their most likely. The shape has k parameters, those of the
    surface and of the bulge; none if fixed.

    used: (M,), indices of the subsets that were used.
    coefficients, strains: (q,) of the basis, and the standard deviation that those of each degree have (order,).
    gain: (6 + k, M, 2), change of pose (rotation vector, translation) and shape by the subsets' pixels.
    confounded: (6 + k, 6 + k), their covariance from what the image cannot tell from deformation, and from what was
        known of the shape before.
    by_deformation: (6 + k, 6 + k), the first part of it, for energy that lies in all coefficients evenly.
    by_tof: (6 + k, 6 + k), from the ToF sensor's planes that tell the two apart.
    residual_px, misfit_px: (M, 2), and the standard deviation on each axis that is left beside the DIC's noise.
    shape: the surface that was found, and what this view tells of it; None if it was fixed.
    bulge: since the reference, of all subsets.
    """

    pose: Pose
    used: NDArray[np.intp]
    coefficients: Array
    strains: Array
    gain: Array
    confounded: Array
    by_deformation: Array
    by_tof: Array
    residual_px: Array
    misfit_px: float
    shape: ShapeEvidence | None
    bulge: Bulge

    def beside(self, change: PlaneChange) -> JointFit:
        """With how the ToF sensor saw the panel's plane move; without it, if the two contradict each other.

        The plane tells a motion from the deformation that looks like it: the update of a Kalman filter, to first order.
        """
        apart = change.image - Plane.from_inverse_depth(change.reference).moved(*self.pose).inverse_depth
        by_told = np.zeros((3, len(self.confounded)))
        by_told[:, :POSE] = pose_sensitivity(change.reference, self.pose)
        possible, likely = self.confounded, self.by_deformation
        widest, expected = (by_told @ each @ by_told.T + change.covariance for each in (possible, likely))
        if apart @ np.linalg.solve(widest, apart) > CONTRADICTION**2:
            return self
        kept = np.linalg.solve(expected, by_told @ likely).T
        step, left = kept @ apart, np.eye(len(kept)) - kept @ by_told
        bulging = POSE + len(self.shape.surface.inverse_depth)
        return replace(
            self,
            pose=displaced(self.pose, step[:POSE]),
            gain=np.tensordot(left, self.gain, 1),
            confounded=left @ self.confounded @ left.T,
            by_tof=kept @ change.covariance @ kept.T,
            shape=replace(self.shape, surface=self.shape.surface.changed(step[POSE:bulging])),
            bulge=self.bulge.changed(step[bulging:]),
        )
