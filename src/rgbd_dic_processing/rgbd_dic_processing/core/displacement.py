"""Steps 5 to 8 of the method: from where the subsets are to how the panel's points moved."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import MeasurementError

from .compensation import h_2d, h_3d, h_pose, pc_3d
from .compensation.motion import Compensation, FrameView
from .geometry import Plane
from .joining import FrameJoin, JoinedFrame
from .pairing import FramePair
from .plane import PlaneEstimate, PlaneMotion
from .realignment import Realignment, realign_to_axis, realign_to_principal_axes
from .reference_plane import ReferencePlane
from .regions import Regions
from .settings import CompensationSettings
from .status import FrameStatus
from .tracking import Reference, SubsetField
from .uncertainty import overlap_correlation, quadratic_terms

Array = NDArray[np.float64]

SOLVERS = {
    "h_pose": h_pose.compensate,
    "h_3d": h_3d.compensate,
    "h_2d": h_2d.compensate,
    "pc_3d": pc_3d.compensate,
}
NEEDS_PLANE_OF_FRAME = ("h_3d", "pc_3d")


@dataclass(frozen=True)
class DisplacementField:
    """Displacement of the N subset centres in the panel frame since the reference, camera motion removed.

    centres_px: (N, 2) raw reference pixels. position_m: (N, 2) panel coordinates in the reference.
    displacement_m: (N, 3), NaN where invalid; z is NaN for all methods but pc_3d.
    sigma_m: (N, 3) float32, standard uncertainty from the DIC alone, NaN like the displacement.
    modes: (k, 3, 6) independent errors of the compensation of one standard deviation each: mode m displaces (x, y) by
        modes[m] @ [1, x, y, x^2, x y, y^2] metres.
    zone_coupling: (j, 2, 3), for the first j modes, which come from the DIC's noise: covariance of the mode's unit
        error with the mean error of the left and the right measuring zone [m].
    scale_uncertainty: relative standard uncertainty of all lengths, from the distance of the reference plane.
    u_step_m: pc_3d: standard uncertainty of the step in z across the crack; else NaN.
    """

    stamp_ns: int
    reference_stamp_ns: int
    method: str
    status: FrameStatus
    reason: str
    depth_offset_s: float
    subset_size: int
    centres_px: NDArray[np.float32]
    position_m: Array
    displacement_m: Array
    sigma_m: NDArray[np.float32]
    modes: Array
    zone_coupling: Array
    scale_uncertainty: float
    u_step_m: float
    image_received_ns: int = field(default=0, compare=False)


class DisplacementMeasurement:
    """Joins subset fields, pairs and planes, and measures each frame against the reference with one method."""

    def __init__(self, camera: Camera, regions: Regions, settings: CompensationSettings):
        self._camera, self._regions, self._settings = camera, regions, settings
        self._join = FrameJoin(settings.max_waiting)
        self._plane_motion = PlaneMotion()
        self._references: dict[int, _ReferenceState] = {}

    def set_reference(self, reference: Reference) -> list[DisplacementField]:
        """A reference was taken. Fields of it that came earlier wait for it."""
        self._references[reference.stamp_ns] = _ReferenceState(self._camera, self._regions, self._settings, reference)
        while len(self._references) > 2:
            self._references.pop(next(iter(self._references)))
        return self._measure_all(self._join.add_reference(reference.stamp_ns))

    def add_field(self, subset_field: SubsetField) -> list[DisplacementField]:
        return self._measure_all(self._join.add_field(subset_field))

    def add_pair(self, pair: FramePair) -> list[DisplacementField]:
        return self._measure_all(self._join.add_pair(pair))

    def add_plane(self, plane: PlaneEstimate) -> list[DisplacementField]:
        return self._measure_all(self._join.add_plane(plane))

    def flush(self) -> list[DisplacementField]:
        """No more is coming: measure what waits with what is there."""
        return self._measure_all(self._join.flush())

    def _measure_all(self, frames: list[JoinedFrame]) -> list[DisplacementField]:
        return [self._measure(frame) for frame in frames]

    def _measure(self, frame: JoinedFrame) -> DisplacementField:
        state = self._references.get(frame.field.reference_stamp_ns)
        invalid = partial(_invalid, frame, self._settings.method, state)
        if frame.field.status != FrameStatus.OK:
            return invalid(frame.field.status, frame.field.reason)
        if state is None:
            return invalid(FrameStatus.NOT_COMPENSATED, "its reference is not known here")
        moved_px = self._camera.undistort(frame.field.moved_px)
        sigma_px = np.maximum(frame.field.sigma_px.astype(float), 1e-9)
        fixed = np.flatnonzero(state.fixed & np.isfinite(moved_px).all(axis=1))
        if len(fixed) < self._settings.min_subsets:
            return invalid(
                FrameStatus.NO_FIXED_REGION,
                f"{len(fixed)} valid subsets in the fixed region, at least {self._settings.min_subsets} needed",
            )
        plane, no_plane = _plane_of(frame)
        if plane is not None:
            plane = self._plane_motion.at_image(plane, frame.plane.stamp_ns, frame.field.stamp_ns)
        try:
            if plane is not None:
                state.take_in_plane(frame, plane, moved_px[fixed], sigma_px[fixed], fixed)
            reference_plane = state.plane_for(self._settings.method)
            if reference_plane is None:
                why = no_plane[1] if no_plane else "its image was too far from it in time"
                return invalid(FrameStatus.NO_REFERENCE_PLANE, f"no plane of the panel is known yet: {why}")
            if plane is None and self._settings.method in NEEDS_PLANE_OF_FRAME:
                return invalid(*no_plane)
            view = FrameView(
                self._camera,
                state.ideal_px,
                moved_px,
                sigma_px,
                fixed,
                state.correlation,
                reference_plane,
                plane,
                frame.field.homography,
            )
            compensation = SOLVERS[self._settings.method](view, self._settings)
        except (MeasurementError, np.linalg.LinAlgError) as error:
            return invalid(FrameStatus.NOT_COMPENSATED, str(error))
        return state.displacement(frame, self._settings.method, view, compensation, reference_plane)


class _ReferenceState:
    """What is computed once per reference."""

    def __init__(self, camera: Camera, regions: Regions, settings: CompensationSettings, reference: Reference):
        self.camera, self.regions, self.settings, self.reference = camera, regions, settings, reference
        centres = reference.centres_px.astype(float)
        self.ideal_px = camera.undistort(centres)
        self.fixed = regions.fixed_members(centres)
        self.zones = regions.crack.members(centres) if regions.crack is not None else ()
        self.right = regions.crack.beyond(centres) if regions.crack is not None else np.zeros(len(centres), bool)
        self._first_step: tuple[float, float] | None = None
        self.correlation = overlap_correlation(centres, reference.subset_size)
        self._planes = ReferencePlane(camera, settings.robust_sigmas)

    def take_in_plane(
        self, frame: JoinedFrame, plane: Plane, moved_px: Array, sigma_px: Array, fixed: NDArray[np.intp]
    ) -> None:
        near = abs(frame.pair.depth_offset_s) <= self.settings.carry_offset_s or self._planes.first is None
        if near and not self._planes.knows(frame.plane.stamp_ns):
            self._planes.add(
                frame.plane.stamp_ns, plane, self.ideal_px[fixed], moved_px, sigma_px, frame.field.homography
            )

    def _step(self, frame: JoinedFrame, method: str) -> tuple[float, float]:
        """Change of the step across the crack since the first ToF frame, and its uncertainty [m] (pc_3d).

        All points of a frame lie on its one plane, so a step between the sides is not in them; it is added here.
        """
        if method != "pc_3d" or frame.plane is None:
            return math.nan, math.nan
        if self._first_step is None and not math.isnan(frame.plane.step_m):
            self._first_step = frame.plane.step_m, frame.plane.u_step_m
            self._first_stamp_ns = frame.plane.stamp_ns
        if self._first_step is None:
            return math.nan, math.nan
        if frame.plane.stamp_ns == self._first_stamp_ns:
            return 0.0, 0.0
        return frame.plane.step_m - self._first_step[0], math.hypot(frame.plane.u_step_m, self._first_step[1])

    def plane_for(self, method: str) -> Plane | None:
        return self._planes.mean if method == "h_pose" else self._planes.first

    def realignment(self, plane: Plane) -> Realignment:
        if self.regions.x_axis is not None:
            return realign_to_axis(self.camera, plane, self.regions.x_axis)
        return realign_to_principal_axes(self.camera, plane, self.ideal_px)

    def displacement(
        self, frame: JoinedFrame, method: str, view: FrameView, compensation: Compensation, plane: Plane
    ) -> DisplacementField:
        realignment = self.realignment(plane)
        motion = compensation.motion
        start = motion.reference_points(self.ideal_px, realignment)

        def now(points_px: Array) -> Array:
            return motion.panel_points(points_px, realignment)

        moved = now(view.moved_px)
        step_m, u_step_m = self._step(frame, method)
        displacement_m = moved - start
        displacement_m[self.right, 2] += step_m
        per_x, per_y = (now(view.moved_px + shift) - moved for shift in np.eye(2))
        sigma = np.sqrt((per_x * view.sigma_px[:, :1]) ** 2 + (per_y * view.sigma_px[:, 1:]) ** 2)
        pi_variance = plane.normal @ plane.inverse_depth_covariance() @ plane.normal
        return DisplacementField(
            frame.field.stamp_ns,
            frame.field.reference_stamp_ns,
            method,
            FrameStatus.OK,
            "",
            frame.pair.depth_offset_s if frame.pair else math.nan,
            self.reference.subset_size,
            self.reference.centres_px.astype(np.float32),
            start[:, :2],
            displacement_m,
            sigma.astype(np.float32),
            _modes(compensation, realignment, self.ideal_px),
            self._zone_coupling(compensation.coupling, per_x, per_y),
            float(-plane.d * np.sqrt(pi_variance)),
            u_step_m,
            frame.field.image_received_ns,
        )

    def _zone_coupling(self, coupling: Array, per_x: Array, per_y: Array) -> Array:
        """The coupling (k, N, 2) [px], carried to panel displacements and averaged over the found subsets of a zone."""
        means = np.zeros((len(coupling), 2, 3))
        for side, zone in enumerate(self.zones):
            found = zone[np.isfinite(per_x[zone, 0])]
            if len(found):
                means[:, side] = (coupling[:, found, :1] * per_x[found] + coupling[:, found, 1:] * per_y[found]).mean(
                    axis=1
                )
        return means


def _modes(compensation: Compensation, realignment: Realignment, ideal_px: Array) -> Array:
    """The displacement error of each mode, as a quadratic in panel coordinates: exact to first order in the error."""
    low, high = ideal_px.min(axis=0), ideal_px.max(axis=0)
    grid = np.stack(np.meshgrid(*np.linspace(low, high, 5).T), axis=-1).reshape(-1, 2)
    seen = compensation.motion.move(grid)
    nominal = compensation.motion.panel_points(seen, realignment)
    terms = np.linalg.pinv(quadratic_terms(nominal[:, :2]))
    errors = [mode.panel_points(seen, realignment) - nominal for mode in compensation.modes]
    return np.array([(terms @ error).T for error in errors]).reshape(-1, 3, 6)


def _plane_of(frame: JoinedFrame) -> tuple[Plane | None, tuple[FrameStatus, str] | None]:
    """The plane of a frame, or the status and words for why it has none."""
    if frame.pair is None:
        return None, (FrameStatus.NO_DEPTH_FRAME, "it was never paired with a ToF frame")
    if frame.pair.depth_stamp_ns is None:
        return None, (FrameStatus.NO_DEPTH_FRAME, "no ToF frame near enough in time")
    if frame.plane is None:
        return None, (FrameStatus.NO_PLANE, "the plane of its ToF frame never came")
    return frame.plane.plane, None if frame.plane.plane is not None else (
        frame.plane.status,
        frame.plane.reason,
    )


def _invalid(
    frame: JoinedFrame, method: str, state: _ReferenceState | None, status: FrameStatus, reason: str
) -> DisplacementField:
    centres = state.reference.centres_px if state else np.zeros((0, 2))
    count = len(centres)
    return DisplacementField(
        frame.field.stamp_ns,
        frame.field.reference_stamp_ns,
        method,
        status,
        reason,
        frame.pair.depth_offset_s if frame.pair else math.nan,
        state.reference.subset_size if state else 0,
        centres.astype(np.float32),
        np.full((count, 2), np.nan),
        np.full((count, 3), np.nan),
        np.full((count, 3), np.nan, np.float32),
        np.zeros((0, 3, 6)),
        np.zeros((0, 2, 3)),
        math.nan,
        math.nan,
        frame.field.image_received_ns,
    )
