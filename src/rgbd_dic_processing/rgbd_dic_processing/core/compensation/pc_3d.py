"""pc_3d: the rigid transform applied to the 3D centres themselves; gives the out-of-plane part too (thesis 2.3.3)."""

from __future__ import annotations

from ..geometry import Plane
from ..settings import CompensationSettings
from .motion import Compensation, FrameView, RigidMotion, reprojection_rms
from .rigid import Pose, fit_rigid


def compensate(view: FrameView, settings: CompensationSettings) -> Compensation:
    """X' = R X + t, undone on the points of the frame's own plane.

    Raises:
        MeasurementError: if no rigid transform fits enough subsets.
    """

    def rigid(pose: Pose, reference_plane: Plane, plane: Plane) -> RigidMotion:
        return RigidMotion(view.camera, *pose, reference_plane, plane)

    fit = fit_rigid(view, settings)
    motion = rigid(fit.pose, view.reference_plane, view.plane)
    modes = tuple(rigid(*mode) for mode in fit.modes)
    return Compensation(motion, modes, fit.sources, fit.coupling, reprojection_rms(motion, view, fit.used))
