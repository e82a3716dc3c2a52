"""One image measured against one reference: regions, DIC, and all methods, with ideal depth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import MeasurementError

from ...core.correlation import CorrelationSettings, ReferenceSubsets
from ...core.crack import CrackMeasurement, CrackOpening
from ...core.displacement import DisplacementMeasurement
from ...core.displacement_field import DisplacementField
from ...core.geometry import Plane, apply_homography
from ...core.homography import fit_homography
from ...core.pairing import FramePair
from ...core.plane import PlaneEstimate
from ...core.regions import CrackZones, Regions
from ...core.seed_maps import SeedMaps
from ...core.settings import CompensationSettings, CrackSettings, RenewalSettings, SearchSettings
from ...core.status import FrameStatus
from ...core.subset_field import Reference, SubsetField
from ...core.tracking import SubsetTracking
from .shots import PANEL, Shot

Array = NDArray[np.float64]

METHODS = ("h_pose", "h_3d", "h_2d", "pc_3d")
REFERENCE_NS, IMAGE_NS = 1, 2
INSET_PX = 10  # of a subset's border from the edges of the plates, whose sharp step would ring in the spline
DEPTH_SIGMA = 1e-7  # of the exact planes, n/-d [1/m]: they need some uncertainty


@dataclass(frozen=True)
class Tracked:
    """The DIC of one image: its fields in the reference and in the image."""

    reference: Reference
    fields: tuple[SubsetField, SubsetField]

    @property
    def moved_px(self) -> Array:
        return self.fields[1].moved_px


@dataclass(frozen=True)
class Measured:
    """One image measured with one method."""

    field: DisplacementField
    opening: CrackOpening


def panel_regions(shot: Shot, subset_px: int) -> Regions:
    """Both plates; subsets that touch an edge of one or the crack are left out. The left plate is the fixed region."""
    footprint = footprint_m(shot)
    edge = INSET_PX * footprint
    beside = (subset_px / 2 + INSET_PX) * footprint
    x, y = PANEL.width_m / 2, PANEL.height_m / 2

    def polygon(x0: float, y0: float, x1: float, y1: float) -> Array:
        return _in_image(shot.camera, project(shot, np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])))

    panel = polygon(-x + edge, -y + edge, x - edge, y - edge)
    left, right = polygon(-x, -y, -beside, y), polygon(beside, -y, x, y)
    axis, crack = (project(shot, np.array(ends) * 0.4) for ends in ([(-1, 0), (1, 0)], [(0, -0.1), (0, 0.1)]))
    direction = (crack[1] - crack[0]) / np.linalg.norm(crack[1] - crack[0])
    return Regions(panel, (left,), axis, CrackZones(left, right, crack.mean(axis=0), direction))


def project(shot: Shot, points_m: Array, opening_m: float = 0.0) -> Array:
    """Points (N, 2) of the panel at the reference [m] -> raw pixels (N, 2); those right of the crack opened."""
    moved = np.column_stack(
        [points_m[:, 0] + opening_m * (points_m[:, 0] > 0), points_m[:, 1], np.zeros(len(points_m))]
    )
    return shot.camera.distort(shot.camera.project(moved @ shot.pose.R.T + shot.pose.t))


def exact_plane(shot: Shot) -> Plane:
    """The panel in the camera's frame."""
    pose = shot.pose
    plane = Plane(pose.R[:, 2], float(-pose.R[:, 2] @ pose.t), np.zeros((4, 4)))
    return Plane.from_inverse_depth(plane.inverse_depth, DEPTH_SIGMA**2 * np.eye(3))


def true_px(reference: Shot, shot: Shot, centres_px: Array) -> Array:
    """Where the material under pixels (N, 2) of the raw reference is in the raw image."""
    rays = reference.camera.rays(reference.camera.undistort(centres_px))
    material = (exact_plane(reference).points(rays) - reference.pose.t) @ reference.pose.R
    return project(shot, material[:, :2], shot.crack_mm * 1e-3)


def track(
    reference: Shot,
    images: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    settings: CorrelationSettings,
    camera: Camera | None = None,
) -> Tracked:
    """The reference and one image, which the DIC has to find without a hint.

    Args:
        camera: calibration to work with; None for the true one.

    Raises:
        MeasurementError: if the panel is not found.
    """
    regions = panel_regions(reference, settings.subset_size)
    tracking = SubsetTracking(
        camera or reference.camera, regions, settings, SearchSettings(), RenewalSettings(after_frames=0)
    )
    fields = tracking.track(REFERENCE_NS, images[0]), tracking.track(IMAGE_NS, images[1])
    if tracking.reference is None or fields[1].status != FrameStatus.OK:
        raise MeasurementError(f"image against reference {reference.number}: {fields[1].reason}")
    return Tracked(tracking.reference, fields)


def track_again(
    tracked: Tracked,
    reference: Shot,
    images: tuple[NDArray, NDArray],
    settings: CorrelationSettings,
    maps: str = "of each plate",
) -> Tracked:
    """The same subsets in other pictures of the same two views, from where they were found; grey values of any type.

    Args:
        maps: the second-order maps that predict the subsets' shapes. "of each plate" follow from a homography fitted to
            where the subsets of that plate were found, so that the opened crack does not bend them; "of the image" from
            the homography that the tracking found for all of the panel; "affine" are those of each plate without their
            second-order terms.
    """
    camera, centres = reference.camera, tracked.reference.centres_px
    subsets = ReferenceSubsets(images[0], centres, settings)
    predicted = SeedMaps(camera, np.rint(centres), reach_px=settings.subset_size / 2)
    ideal, moved = camera.undistort(centres), camera.undistort(tracked.moved_px)
    if maps == "of the image":
        H = tracked.fields[1].homography
        seeds = predicted.seeds(H)
        seeds[:, :, 0] += tracked.moved_px - camera.distort(apply_homography(H, ideal))
    else:
        crack = panel_regions(reference, settings.subset_size).crack
        seeds = np.full((len(centres), 2, 6), np.nan)
        for plate, zone in zip((~crack.beyond(centres), crack.beyond(centres)), crack.members(centres), strict=True):
            found = zone[np.isfinite(moved[zone, 0])]
            seeds[plate] = predicted.seeds(fit_homography(ideal[found], moved[found]), plate)
    if maps == "affine":
        seeds[:, :, 3:] = 0
    result = subsets.correlate(subsets.target(images[1]), seeds)
    field = replace(
        tracked.fields[1],
        moved_px=np.column_stack([result.x_px, result.y_px]),
        sigma_px=np.column_stack([result.sigma_x_px, result.sigma_y_px]),
        zncc=result.zncc,
        iterations=result.iterations,
        subset_status=result.status,
    )
    return Tracked(tracked.reference, (tracked.fields[0], field))


def measure(
    tracked: Tracked, reference: Shot, shot: Shot, camera: Camera | None = None, methods: tuple[str, ...] = METHODS
) -> dict[str, Measured]:
    """All methods, with the exact planes of both views.

    Args:
        camera: calibration to work with; None for the true one.

    Raises:
        MeasurementError: if a method cannot measure the image.
    """
    camera = camera or reference.camera
    regions = panel_regions(reference, int(tracked.reference.subset_size))
    measured = {}
    for method in methods:
        settings = CompensationSettings(method=method, bow_m=0.0)  # the depth is ideal, and the panel flat
        step = DisplacementMeasurement(camera, regions, settings)
        step.set_reference(tracked.reference)
        for stamp, view, field in zip((REFERENCE_NS, IMAGE_NS), (reference, shot), tracked.fields, strict=True):
            step.add_plane(PlaneEstimate(stamp, FrameStatus.OK, "", exact_plane(view), step_m=0.0, u_step_m=0.0))
            step.add_field(field)
            (displaced,) = step.add_pair(FramePair(stamp, stamp))
        opening = CrackMeasurement(camera, regions.crack, CrackSettings()).measure(displaced)
        if not opening.valid:
            raise MeasurementError(f"image {shot.number}, {method}: {opening.reason}")
        measured[method] = Measured(displaced, opening)
    return measured


def moving_part_mm(measured: Measured, reference: Shot) -> Array:
    """(M,) lengths of the in-plane displacement of the moving part's subsets [mm] (thesis 2.5)."""
    _, right = panel_regions(reference, int(measured.field.subset_px)).crack.members(
        measured.field.centres_px.astype(float)
    )
    lengths = 1e3 * np.hypot(*measured.field.displacement_m[right, :2].T)
    return lengths[np.isfinite(lengths)]


def footprint_m(shot: Shot) -> float:
    """Length on the panel of a pixel's side [m]: the root of its area, in the middle."""
    return float(1 / np.sqrt(abs(np.linalg.det(pixels_per_m(shot)))))


def panel_per_pixel(shot: Shot, ideal_px: Array) -> Array:
    """d panel coordinate / d ideal pixel (N, 2, 2) [m/px]."""

    def on_panel(points_px: Array) -> Array:
        return ((exact_plane(shot).points(shot.camera.rays(points_px)) - shot.pose.t) @ shot.pose.R)[:, :2]

    return np.stack([on_panel(ideal_px + step) - on_panel(ideal_px - step) for step in np.eye(2) / 2], axis=-1)


def pixels_per_m(shot: Shot) -> Array:
    """d pixel / d panel coordinate (2, 2) in the middle of the panel [px/m]."""
    ends = project(shot, 1e-4 * np.vstack([np.eye(2), -np.eye(2)]) - [[1e-3, 0]])
    return (ends[:2] - ends[2:]).T / 2e-4


def _in_image(camera: Camera, corners_px: Array) -> Array:
    """The part of a convex polygon (M, 2) that lies in the image."""
    width, height = camera.width - 1, camera.height - 1
    border = np.array([(0, 0), (width, 0), (width, height), (0, height)], np.float32)
    _, common = cv2.intersectConvexConvex(corners_px.astype(np.float32), border)
    return common.reshape(-1, 2).astype(float)
