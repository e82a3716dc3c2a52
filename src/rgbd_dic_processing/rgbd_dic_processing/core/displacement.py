"""Steps 5 to 8 of the method: from where the subsets are to how the panel's points moved."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import RgbdDicError

from .compensation import h_2d, h_3d, h_joint, h_pose, pc_3d
from .compensation.motion import FrameView
from .displacement_field import DisplacementField
from .early_frames import EarlyFrames
from .geometry import Plane, pose_from_homography
from .joining import FrameJoin, JoinedFrame
from .pairing import FramePair
from .plane import PlaneEstimate, PlaneMotion
from .reference_frame import FINDS_SHAPE, NEEDS_PLANE_OF_FRAME, ReferenceFrame
from .regions import Regions
from .sensor_delay import SensorDelay
from .settings import CompensationSettings
from .status import FrameStatus
from .subset_field import Reference, SubsetField

Array = NDArray[np.float64]
NoPlane = tuple[FrameStatus, str]

SOLVERS = {
    "h_pose": h_pose.compensate,
    "h_joint": h_joint.compensate,
    "h_3d": h_3d.compensate,
    "h_2d": h_2d.compensate,
    "pc_3d": pc_3d.compensate,
}


NEEDS_GEOMETRY = ("h_joint", "h_3d", "h_2d", "pc_3d")  # methods that look at where the subsets are on the panel
LEARNT_AGAIN = 32  # early frames, so many at most, are kept until they are learnt from: half a second at 60 Hz
LEAST_SIGMA_PX = 1e-5  # what the DIC's iteration leaves, also where two images are the same


class DisplacementMeasurement:
    """Joins subset fields, pairs and planes, and measures each frame against the reference with one method.

    A method that takes the plane of the reference alone need not wait for the frame's own ToF frame: with a
    `plane_lag_s`, that plane rests on the ToF frames of images at least so much earlier, which have long come. Which
    ones these are depends on the stamps alone, unless it `never_waits` (see `EarlyFrames`).
    """

    def __init__(self, camera: Camera, regions: Regions, settings: CompensationSettings, never_waits: bool = False):
        self._camera, self._regions, self._settings = camera, regions, settings
        self._join = FrameJoin(settings.max_waiting)
        self._plane_motion = PlaneMotion()
        self._references: dict[int, ReferenceFrame] = {}
        early = bool(settings.plane_lag_s) and settings.method not in NEEDS_PLANE_OF_FRAME
        self._early = EarlyFrames(round(settings.plane_lag_s * 1e9), never_waits) if early else None
        self._no_plane: NoPlane | None = None
        self._seen_lately: deque[tuple[SubsetField, Seen]] = deque(maxlen=LEARNT_AGAIN)

    def set_reference(self, reference: Reference) -> list[DisplacementField]:
        """A reference was taken. Fields of it that came earlier wait for it."""
        regions = reference.regions or self._regions
        self._references[reference.stamp_ns] = ReferenceFrame(self._camera, regions, self._settings, reference)
        while len(self._references) > 2:
            self._references.pop(next(iter(self._references)))
        return self._measure_all(self._join.add_reference(reference.stamp_ns))

    def add_field(self, subset_field: SubsetField) -> list[DisplacementField]:
        if self._early is not None:
            self._early.add(subset_field)
        return self._measure_all(self._join.add_field(subset_field))

    def add_pair(self, pair: FramePair) -> list[DisplacementField]:
        return self._measure_all(self._join.add_pair(pair))

    def add_plane(self, plane: PlaneEstimate) -> list[DisplacementField]:
        return self._measure_all(self._join.add_plane(plane))

    def flush(self) -> list[DisplacementField]:
        """No more is coming: measure what waits with what is there."""
        return self._measure_all(self._join.flush())

    def sensor_delay(self) -> SensorDelay:
        """What the frames since the latest reference tell of a delay of the ToF stamps."""
        if not self._references:
            return SensorDelay(reason="there is no reference yet")
        return next(reversed(self._references.values())).sensor_delay()

    def _measure_all(self, frames: list[JoinedFrame]) -> list[DisplacementField]:
        """Of frames that are complete; with `plane_lag_s`, of those that need wait no longer."""
        if self._early is None:
            return [self._measure(frame, self._learn) for frame in frames]
        self._early.complete(frames)
        return [self._measure(frame, self._known) for frame in self._early.leave(self._knows_plane, self._learn_alone)]

    def _knows_plane(self, field: SubsetField) -> bool:
        base = self._references.get(field.reference_stamp_ns)
        return base is not None and base.newest_plane_ns is not None

    def _measure(self, frame: JoinedFrame, planes: Callable[..., Planes]) -> DisplacementField:
        base = self._references.get(frame.field.reference_stamp_ns)
        try:
            seen = self._seen(frame.field, base)
            return self._displacement(frame, seen, planes(frame, seen))
        except _Unmeasured as why:
            return _invalid(frame, self._settings.method, base, why.status, str(why))
        except (RgbdDicError, np.linalg.LinAlgError) as error:
            return _invalid(frame, self._settings.method, base, FrameStatus.NOT_COMPENSATED, str(error))

    def _seen(self, field: SubsetField, base: ReferenceFrame | None) -> Seen:
        for known, seen in self._seen_lately:
            if known is field and seen.base is base:
                return seen
        seen = self._look(field, base)
        if self._early is not None:
            self._seen_lately.append((field, seen))
        return seen

    def _look(self, field: SubsetField, base: ReferenceFrame | None) -> Seen:
        if field.status != FrameStatus.OK:
            raise _Unmeasured(field.status, field.reason)
        if base is None:
            raise _Unmeasured(FrameStatus.NOT_COMPENSATED, "its reference is not known here")
        moved_px = self._camera.undistort(field.moved_px)
        sigma_px = np.maximum(field.sigma_px.astype(float, order="F"), LEAST_SIGMA_PX)  # as `columns` lie in memory
        fixed = np.flatnonzero(base.fixed & np.isfinite(moved_px + sigma_px).all(axis=1))
        if len(fixed) < self._settings.min_subsets:
            raise _Unmeasured(
                FrameStatus.NO_FIXED_REGION,
                f"{len(fixed)} valid subsets in the fixed region, at least {self._settings.min_subsets} needed",
            )
        return Seen(base, moved_px, sigma_px, fixed)

    def _learn(self, frame: JoinedFrame, seen: Seen) -> Planes:
        """Take in what a complete frame tells of the reference's plane, and of how the fixed region moves."""
        base, of_fixed = seen.base, (seen.moved_px[seen.fixed], seen.sigma_px[seen.fixed], seen.fixed)
        tof_plane, no_plane = _plane_of(frame)
        plane = None
        if tof_plane is not None:
            plane = self._plane_motion.at_image(tof_plane, frame.plane.stamp_ns, frame.field.stamp_ns)
            no_plane = base.take_in_plane(frame, plane, *of_fixed) or no_plane
        self._no_plane = no_plane
        return Planes(plane, base.follow(frame, tof_plane, *of_fixed), no_plane)

    def _learn_alone(self, frame: JoinedFrame) -> None:
        """The same of a frame that is measured by itself."""
        with contextlib.suppress(_Unmeasured):
            self._learn(frame, self._seen(frame.field, self._references.get(frame.field.reference_stamp_ns)))

    def _known(self, frame: JoinedFrame, seen: Seen) -> Planes:
        """For a frame that does not wait for its own plane."""
        return Planes(None, None, self._no_plane)

    def _displacement(self, frame: JoinedFrame, seen: Seen, planes: Planes) -> DisplacementField:
        base, moved_px, sigma_px, fixed = seen.base, seen.moved_px, seen.sigma_px, seen.fixed
        plane, pose = planes.of_frame, None
        reference_plane = base.plane_for(self._settings.method)
        if reference_plane is None:
            why = planes.missing[1] if planes.missing else "its image was too far from it in time"
            raise _Unmeasured(FrameStatus.NO_REFERENCE_PLANE, f"no plane of the panel is known yet: {why}")
        if plane is None and self._settings.method in NEEDS_PLANE_OF_FRAME:
            raise _Unmeasured(*planes.missing)
        if planes.carried is not None and plane is not None:
            reference_plane, plane, pose = planes.carried
        surface = known_pose = None
        if base.is_shaped:
            rigid = self._settings.method not in FINDS_SHAPE
            if rigid:
                base.learn_shape(reference_plane, frame.field, moved_px, sigma_px, fixed)
            surface = base.surface(reference_plane)
            reference_plane = surface.plane
            if rigid:
                start = pose_from_homography(self._camera, base.homography(frame.field), reference_plane)
                known_pose = reference_plane, start
                moved_px = moved_px - surface.parallax_px(start)
        view = FrameView(
            self._camera,
            base.ideal_px,
            moved_px,
            sigma_px,
            fixed,
            base.correlation(frame.field),
            reference_plane,
            plane,
            base.homography(frame.field),
            base.panel_geometry(reference_plane) if self._settings.method in NEEDS_GEOMETRY else None,
            pose,
            surface,
            base.plane_changes(frame.field.stamp_ns),
            base.bulge(frame.field.stamp_ns, reference_plane),
            known_pose,
        )
        compensation = SOLVERS[self._settings.method](view, self._settings)
        view, surface = base.with_shape(view, compensation, frame.field.stamp_ns)
        return base.displacement(frame, self._settings.method, view, compensation, surface)


@dataclass(frozen=True)
class Seen:
    """A frame's subsets, of which `fixed` (M,) are those of the fixed region that were found; as in `FrameView`."""

    base: ReferenceFrame
    moved_px: Array
    sigma_px: Array
    fixed: NDArray[np.intp]


@dataclass(frozen=True)
class Planes:
    """of_frame: the plane of a frame's ToF frame at the moment of the image. carried: as of `ReferenceFrame.follow`.
    missing: why there is none."""

    of_frame: Plane | None
    carried: tuple[Plane, Plane, tuple[Array, Array]] | None
    missing: NoPlane | None


class _Unmeasured(Exception):
    def __init__(self, status: FrameStatus, reason: str):
        super().__init__(reason)
        self.status = status


def _plane_of(frame: JoinedFrame) -> tuple[Plane | None, NoPlane | None]:
    """The plane of a frame, or the status and words for why it has none."""
    if frame.pair is None:
        return None, (FrameStatus.NO_DEPTH_FRAME, "it was never paired with a ToF frame")
    if frame.pair.depth_stamp_ns is None:
        return None, (FrameStatus.NO_DEPTH_FRAME, frame.pair.reason)
    if frame.plane is None:
        return None, (FrameStatus.NO_PLANE, "the plane of its ToF frame never came")
    if frame.plane.plane is None:
        return None, (frame.plane.status, frame.plane.reason)
    return frame.plane.plane, None


def _invalid(
    frame: JoinedFrame, method: str, base: ReferenceFrame | None, status: FrameStatus, reason: str
) -> DisplacementField:
    centres = base.reference.drawn_px if base else np.zeros((0, 2))
    count = len(centres)
    return DisplacementField(
        frame.field.stamp_ns,
        frame.field.reference_stamp_ns,
        frame.field.keyframe_stamp_ns,
        method,
        status,
        reason,
        frame.pair.depth_offset_s if frame.pair else math.nan,
        frame.field.subset_px,
        centres.astype(np.float32),
        np.full((count, 2), np.nan),
        np.full((count, 3), np.nan),
        np.full((count, 3), np.nan, np.float32),
        np.zeros((0, 3, 6)),
        np.zeros(0, np.uint8),
        np.zeros((0, 2, 3)),
        math.nan,
        math.nan,
        math.nan,
        frame.field.image_received_ns,
    )
