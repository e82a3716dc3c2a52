"""h_3d: the homography induced by the rigid transform of the 3D centres (thesis 2.3.1)."""

from __future__ import annotations

from ..geometry import Plane, plane_homography
from ..settings import CompensationSettings
from .motion import Compensation, FrameView, HomographyMotion, reprojection_rms
from .rigid import Pose, fit_rigid


def compensate(view: FrameView, settings: CompensationSettings) -> Compensation:
    """H = K (R - t n^T / d) K^-1 with the reference's plane (Eq. 2.3).

    Raises:
        MeasurementError: if no rigid transform fits enough subsets.
    """

    def induced(pose: Pose, plane: Plane) -> HomographyMotion:
        return HomographyMotion(plane_homography(view.camera, *pose, plane))

    fit = fit_rigid(view, settings)
    motion = induced(fit.pose, view.reference_plane)
    modes = tuple(induced(pose, reference_plane) for pose, reference_plane, _ in fit.modes)
    return Compensation(motion, modes, fit.sources, fit.coupling, reprojection_rms(motion, view, fit.used))
