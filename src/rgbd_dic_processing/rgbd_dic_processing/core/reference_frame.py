"""Steps 7 and 8 of the method: displacement in the panel frame, against one reference."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import MeasurementError
from scipy.sparse import csr_matrix

from .bulge import Bulge
from .compensation.h_pose import fit_pose, sensitivity
from .compensation.motion import Compensation, FrameView, PanelGeometry, panel_points_of
from .curvature import Curvature
from .displacement_field import DisplacementField
from .error_sources import ErrorSource
from .geometry import Plane, apply_homography, pose_from_homography
from .joining import JoinedFrame
from .panel_motion import PanelMotion, Pose
from .panel_surface import Surface
from .plane import PlaneEstimate
from .plane_change import PlaneChange, PlaneChanges
from .plane_in_time import CarriedPlanes
from .realignment import Realignment, realign_to_axis, realign_to_principal_axes
from .reference_plane import ReferencePlane
from .regions import CrackZones, Regions
from .sensor_delay import DelayEstimate, SensorDelay
from .settings import CompensationSettings
from .status import FrameStatus
from .subset_field import Reference, SubsetField
from .surface_estimate import SurfaceEstimate
from .uncertainty import least_squares, linear_modes, overlap_correlation, overlaps, quadratic_terms

Array = NDArray[np.float64]
SHAPED = ("h_pose", "h_joint")  # methods that are told the panel's shape
FINDS_SHAPE = ("h_joint",)  # those of them that estimate it along with the motion
CRACK_PX = 3  # by which a crack may leave its line
SHAPING = 800  # subsets that the panel's shape is estimated from: they overlap, and more tell hardly more
SPREAD = 250  # subsets that what the shape leaves open is told by: it is as smooth as the shape
NEEDS_PLANE_OF_FRAME = ("h_3d", "pc_3d")  # as in the thesis: from the ToF frames of the two images alone


class ReferenceFrame:
    """One reference: what is computed once for it, its plane as it becomes known, and displacements against it.

    ideal_px: (N, 2), undistorted subset centres; NaN for those that it lacks. fixed: (N,) mask of the fixed region.
    is_shaped: whether the panel is not taken for flat.
    """

    def __init__(self, camera: Camera, regions: Regions, settings: CompensationSettings, reference: Reference):
        self.camera, self.regions, self.settings, self.reference = camera, regions, settings, reference
        drawn, crack = reference.drawn_px, regions.crack
        self.ideal_px = camera.undistort(reference.centres_px)
        self.fixed = regions.fixed_members(drawn)
        self.zones = crack.members(drawn) if crack is not None else ()
        self.right = crack.beyond(drawn) if crack is not None else np.zeros(len(drawn), bool)
        self._astride = _astride(crack, drawn, reference.subset_size)
        self._from_drawing = np.linalg.inv(reference.homography)
        if regions.x_axis is not None:
            self._x_axis_px = apply_homography(reference.homography, camera.undistort(regions.x_axis))
        self._grid_px = _grid(self.ideal_px)
        self._step_at_reference: PlaneEstimate | None = None
        self._correlation: tuple[float, csr_matrix] | None = None
        self._realigned: Realignment | None = None
        self._planes = ReferencePlane(camera, settings.robust_sigmas)
        self._carried = CarriedPlanes(settings.plane_window_s)
        self._motion, self._delay = PanelMotion(), DelayEstimate()
        self._follows, self._shapes = (itertools.cycle([True] + [False] * (settings.learn_every - 1)) for _ in range(2))
        self._accuracy: float | None = None  # of the sensor, relative to the distance
        shaped = bool(settings.bow_m) and settings.method in SHAPED
        self.is_shaped, self._tof_tells_bow = shaped, shaped and settings.bow_from == "images_and_tof"
        self._bulges = shaped and settings.method in FINDS_SHAPE and settings.bulge_m > 0
        asks = settings.method in FINDS_SHAPE and settings.tof_slope < 1
        self._rays = camera.rays(self.ideal_px)
        self._changes = PlaneChanges(self._rays, settings.tof_slope, self._delay.estimate) if asks else None
        self._surface = SurfaceEstimate(camera, self.ideal_px, settings.bow_m, settings.robust_sigmas)

    @property
    def newest_plane_ns(self) -> int | None:
        """Stamp of the latest ToF frame that the reference plane rests on; None before the first."""
        return self._planes.latest_ns

    def depth_offset_s(self, frame: JoinedFrame) -> float:
        """From the ToF frame that a frame was paired with, or else from the latest in the reference plane, to the
        image [s]; NaN without one."""
        if frame.pair is not None:
            return frame.pair.depth_offset_s
        return math.nan if self.newest_plane_ns is None else (frame.field.stamp_ns - self.newest_plane_ns) * 1e-9

    def homography(self, field: SubsetField) -> Array:
        """(3, 3), ideal pixels of the reference -> of an image."""
        return field.homography @ self._from_drawing

    def correlation(self, field: SubsetField) -> csr_matrix:
        """(N, N), of the errors of overlapping subsets."""
        if self._correlation is None or self._correlation[0] != field.subset_px:
            self._correlation = field.subset_px, overlap_correlation(self.reference.drawn_px, field.subset_px)
        return self._correlation[1]

    def take_in_plane(
        self, frame: JoinedFrame, plane: Plane, moved_px: Array, sigma_px: Array, fixed: NDArray[np.intp]
    ) -> tuple[FrameStatus, str] | None:
        """The plane of the frame's ToF frame, for the reference plane, if the two are near enough in time.

        Args:
            moved_px, sigma_px: (M, 2) of the found subsets of the fixed region, whose indices are `fixed` (M,).

        Returns:
            Why it could not be carried back to the reference; None if it could, or was not needed.
        """
        near = abs(frame.pair.depth_offset_s) <= self.settings.carry_offset_s or self._planes.first is None
        if near and not self._planes.knows(frame.plane.stamp_ns):
            if self._accuracy is None:
                self._accuracy = frame.plane.accuracy
            try:
                seed, bow = self.homography(frame.field), frame.plane.curvature if self._tof_tells_bow else None
                back = None if bow is None else self._back(plane, bow, seed, moved_px, sigma_px, fixed)
                self._planes.add(frame.plane.stamp_ns, plane, self.ideal_px[fixed], moved_px, sigma_px, seed, bow, back)
            except (MeasurementError, np.linalg.LinAlgError) as error:
                return FrameStatus.NO_PLANE, f"the plane of its ToF frame does not fit the motion ({error})"
        return None

    def _back(
        self, plane: Plane, bow: Curvature, seed: Array, moved_px: Array, sigma_px: Array, fixed: NDArray[np.intp]
    ) -> Pose:
        """The motion of a bowed panel from a frame to the reference; arguments as of `take_in_plane`."""
        settings, seen_px, sigma = self.settings, apply_homography(seed, self.ideal_px), np.zeros_like(self.ideal_px)
        seen_px[fixed], sigma[fixed] = moved_px, sigma_px
        shape = SurfaceEstimate(self.camera, seen_px, settings.bow_m, settings.robust_sigmas).surface(plane, bow)
        return shape.fit_pose(self.ideal_px, sigma, fixed, np.linalg.inv(seed), settings.robust_sigmas)[0]

    def follow(
        self, frame: JoinedFrame, plane: Plane | None, moved_px: Array, sigma_px: Array, fixed: NDArray[np.intp]
    ) -> tuple[Plane, Plane, Pose] | None:
        """Note how the fixed region moved; arguments as of `take_in_plane`, but the plane at its own moment.

        Returns:
            The reference plane, the plane in this image, and the pose along which it was carried, for a method that
            asks for it by `plane_in_time`; None if no plane could be carried.
        """
        if self._changes is not None and plane is not None:
            self._changes.add(frame.plane.stamp_ns, plane)
        known = self._planes.mean
        carries = self.settings.plane_in_time == "carried" and self.settings.method in NEEDS_PLANE_OF_FRAME
        if known is None or not (next(self._follows) or carries):
            return None
        start = pose_from_homography(self.camera, self.homography(frame.field), known)
        points = self.ideal_px[fixed], moved_px, sigma_px
        try:
            pose, jacobian, weights, misfit_px = fit_pose(
                self.camera, *points, known, start, self.settings.robust_sigmas
            )
            self._motion.add(frame.field.stamp_ns, pose)
            if plane is not None:
                self._delay.add(frame.plane.stamp_ns, plane)
            if not carries:
                return None
            if plane is not None:
                self._carried.add(frame.plane.stamp_ns, plane)
            sigma = np.zeros((len(self.ideal_px), 2))
            sigma[fixed] = np.hypot(sigma_px, misfit_px)
            modes, _ = linear_modes(sensitivity(jacobian, weights), sigma, self.correlation(frame.field), fixed)
            seen = self._carried.at_image(frame.field.stamp_ns, self._motion, pose, modes.T @ modes)
        except (MeasurementError, np.linalg.LinAlgError):
            return None
        return (self._carried.reference, seen, pose) if seen is not None else None

    def sensor_delay(self) -> SensorDelay:
        """What the frames since this reference tell of a delay of the ToF stamps."""
        return self._delay.estimate(self._motion)

    def plane_changes(self, stamp_ns: int) -> Callable[[Pose, Array, Array], PlaneChange | None] | None:
        """For the view of an image: how the plane has changed since the reference, for a method that asks."""
        return None if self._changes is None else partial(self._changes.at_image, stamp_ns)

    def bulge(self, stamp_ns: int, plane: Plane) -> Bulge | None:
        """What a loaded panel may stand out in an image; None if the method does not ask, in the reference itself, and
        where the fixed region does not lie on both sides of a crack: one side does not tell how the other bulges."""
        right = self.right[self.fixed]
        if not self._bulges or stamp_ns == self.reference.stamp_ns or right.all() or not right.any():
            return None
        return Bulge.unknown(self._rays, plane, self.settings.bulge_m)

    def plane_for(self, method: str) -> Plane | None:
        """The reference plane that a method works with; None if none is known yet.

        Raises:
            MeasurementError: if the method takes the plane of the first ToF frame and later ones contradict it.
        """
        if method not in NEEDS_PLANE_OF_FRAME or self.settings.plane_in_time == "carried":
            return self._planes.mean
        if not self._planes.first_agrees:
            raise MeasurementError(
                "the plane of the first ToF frame contradicts those of later ones: take a new reference"
            )
        return self._planes.first

    def surface(self, plane: Plane) -> Surface:
        """The panel's shape as it is known now: from the ToF sensor's plane, from the parallax of the fixed region,
        and, by `bow_from`, from the curvature that the sensor saw."""
        return self._surface.surface(plane, self._planes.curvature)

    def learn_shape(
        self, plane: Plane, field: SubsetField, moved_px: Array, sigma_px: Array, fixed: NDArray[np.intp]
    ) -> None:
        """Take in the parallax of a rigid fixed region (N, 2).

        Raises:
            MeasurementError: if the motion of the fixed region cannot be estimated.
        """
        if field.stamp_ns == self.reference.stamp_ns or not next(self._shapes):
            return
        some = fixed[:: math.ceil(len(fixed) / SHAPING)]
        shared = overlaps(self.correlation(field), some) / len(some)
        seed = self.homography(field)
        self._surface.learn(plane, self._planes.curvature, moved_px, sigma_px, some, shared, seed)

    def with_shape(
        self, view: FrameView, compensation: Compensation, stamp_ns: int
    ) -> tuple[FrameView, Surface | None]:
        """A view on the surface that its solver found, which is taken in, and this; None if the panel is taken for
        flat. The view of a solver that does not look for the shape stays as it is."""
        told = compensation.shape
        if told is None:
            return view, view.surface
        moved_px = view.moved_px - told.surface.parallax_px(compensation.pose)
        if compensation.bulge is not None:
            moved_px = moved_px - compensation.bulge.parallax_px(self.camera, told.surface.points(), compensation.pose)
        view = replace(view, reference_plane=told.surface.plane, moved_px=moved_px)
        if not self.is_shaped:
            return view, None
        if stamp_ns != self.reference.stamp_ns:
            self._surface.learn_beside_deformation(told.view, stamp_ns)
        return view, told.surface

    def displacement(
        self,
        frame: JoinedFrame,
        method: str,
        view: FrameView,
        compensation: Compensation,
        surface: Surface | None = None,
    ) -> DisplacementField:
        """The displacement of all found subsets of a frame whose motion was compensated, and whose pixels were freed of
        what the panel stands out of the view's reference plane, if its surface is given."""
        plane = view.reference_plane
        realignment = self._realignment(plane)
        motion = compensation.motion
        start = motion.reference_points(self.ideal_px, realignment)

        shifted = np.concatenate([view.moved_px + shift for shift in np.array([(0, 0), (1, 0), (0, 1)])])
        moved, by_x, by_y = np.split(motion.panel_points(shifted, realignment), 3)
        step_m, u_step_m = self._step(frame, method)
        displacement_m = moved - start
        displacement_m[self.right, 2] += step_m
        per_x, per_y = by_x - moved, by_y - moved
        sigma_px = np.hypot(view.sigma_px, compensation.misfit_px)
        sigma = np.sqrt((per_x * sigma_px[:, :1]) ** 2 + (per_y * sigma_px[:, 1:]) ** 2)
        modes, sources = _modes(compensation, realignment, self._grid_px), list(compensation.sources)
        if surface is not None:
            found, fixed = _spread(np.flatnonzero(np.isfinite(moved[:, 0]))), _spread(view.fixed)
            chosen = np.concatenate([fixed, found])
            bulge = None if compensation.bulge is None else compensation.bulge.part(chosen)
            shifts = surface.part(chosen).doubts_px(view.seed_pose, np.arange(len(fixed)), bulge)[:, len(fixed) :]
            errors = shifts[..., :1] * per_x[found] + shifts[..., 1:] * per_y[found]
            modes = np.concatenate([modes, _quadratic(start[found], errors)])
            sources += [ErrorSource.SHAPE] * len(shifts)
        pi_variance = plane.normal @ plane.inverse_depth_covariance() @ plane.normal
        return DisplacementField(
            frame.field.stamp_ns,
            frame.field.reference_stamp_ns,
            frame.field.keyframe_stamp_ns,
            method,
            FrameStatus.OK,
            "",
            self.depth_offset_s(frame),
            frame.field.subset_px,
            self.reference.drawn_px.astype(np.float32),
            start[:, :2],
            displacement_m,
            sigma.astype(np.float32),
            modes,
            np.array(sources, np.uint8),
            self._zone_coupling(compensation.coupling, per_x, per_y),
            float(np.hypot(-plane.d * np.sqrt(pi_variance), self._accuracy)),
            u_step_m,
            compensation.residual_px,
            frame.field.image_received_ns,
        )

    def panel_geometry(self, plane: Plane) -> PanelGeometry:
        """Where the subsets are on the reference's plane, in axes of the crack; without one, of the panel."""
        points = plane.points(self._rays)
        realignment = self._realignment(plane)
        axes, origin = realignment.R_panel_camera[:2].T, np.nanmean(points, axis=0)
        if self.regions.crack is not None:
            zones = self.regions.crack
            drawn = zones.point + np.outer((-0.5, 0, 0.5), zones.direction)
            seen = apply_homography(self.reference.homography, self.camera.undistort(drawn))
            above, origin, below = plane.points(self.camera.rays(seen))
            along = (below - above) / np.linalg.norm(below - above)
            axes = np.column_stack([np.cross(along, plane.normal), along])
        return PanelGeometry((points - origin) @ axes, self.right, self._astride, axes)

    def _realignment(self, plane: Plane) -> Realignment:
        if self._realigned is None or self._realigned.plane is not plane:  # the same for several images
            if self.regions.x_axis is not None:
                self._realigned = realign_to_axis(self.camera, plane, self._x_axis_px)
            else:
                known_px = self.ideal_px[np.isfinite(self.ideal_px[:, 0])]
                self._realigned = realign_to_principal_axes(self.camera, plane, known_px)
        return self._realigned

    def _step(self, frame: JoinedFrame, method: str) -> tuple[float, float]:
        """Change of the step across the crack since the reference's own ToF frame, and its uncertainty [m] (pc_3d).

        All points of a frame lie on its one plane, so a step between the sides is not in them; it is added here. NaN if
        the reference has no ToF frame with a step.
        """
        if method != "pc_3d" or frame.plane is None:
            return math.nan, math.nan
        if frame.field.stamp_ns == self.reference.stamp_ns:
            self._step_at_reference = frame.plane
        if self._step_at_reference is None:
            return math.nan, math.nan
        if frame.plane.stamp_ns == self._step_at_reference.stamp_ns:
            return 0.0, 0.0
        return frame.plane.step_m - self._step_at_reference.step_m, math.hypot(
            frame.plane.u_step_m, self._step_at_reference.u_step_m
        )

    def _zone_coupling(self, coupling: Array, per_x: Array, per_y: Array) -> Array:
        """The coupling (k, N, 2) [px], carried to panel displacements and averaged over the found subsets of a zone."""
        means = np.zeros((len(coupling), 2, 3))
        for side, zone in enumerate(self.zones):
            found = zone[np.isfinite(per_x[zone, 0])]
            if len(found):
                sums = coupling[:, found, 0] @ per_x[found] + coupling[:, found, 1] @ per_y[found]
                means[:, side] = sums / len(found)
        return means


def _astride(crack: CrackZones | None, drawn_px: Array, subset_px: float) -> NDArray[np.bool_]:
    """(N,), the subsets that see both sides of the crack, which may leave its line a little."""
    if crack is None:
        return np.zeros(len(drawn_px), bool)
    reach_px = subset_px / 2 * np.abs(crack.normal).sum() + CRACK_PX
    return np.abs((drawn_px - crack.point) @ crack.normal) < reach_px


def _modes(compensation: Compensation, realignment: Realignment, grid_px: Array) -> Array:
    """The displacement error of each mode, as a quadratic in panel coordinates: exact to first order in the error."""
    seen = compensation.motion.move(grid_px)
    nominal = compensation.motion.panel_points(seen, realignment)
    return _quadratic(nominal, panel_points_of(compensation.modes, seen, realignment) - nominal)


def _quadratic(points_m: Array, errors_m: Array) -> Array:
    """(k, 3, 6), the quadratics in panel coordinates nearest to errors (k, M, 3) at points (M, 2 or more)."""
    columns = np.moveaxis(errors_m, 1, 0).reshape(len(points_m), -1)
    return least_squares(quadratic_terms(points_m), columns).T.reshape(len(errors_m), -1, 6)


def _grid(points_px: Array) -> Array:
    """(25, 2), a grid over where the points are; NaN is left out."""
    low, high = np.nanmin(points_px, axis=0), np.nanmax(points_px, axis=0)
    return np.stack(np.meshgrid(*np.linspace(low, high, 5).T), axis=-1).reshape(-1, 2)


def _spread(chosen: NDArray[np.intp]) -> NDArray[np.intp]:
    """Of subsets that lie row by row at most SPREAD, evenly taken, but not column by column."""
    return chosen[np.linspace(0, len(chosen) - 1, min(len(chosen), SPREAD)).astype(int)]
