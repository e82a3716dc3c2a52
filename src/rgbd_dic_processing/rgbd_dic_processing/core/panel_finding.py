"""The panel's outline from one ToF frame, where nobody drew it: the plane that dominates the image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Calibration, Camera
from rgbd_dic_acquisition.errors import MeasurementError
from rgbd_dic_acquisition.settings import Settings, setting

from .open3d_import import open3d

Array = NDArray[np.float64]

VOXEL_M = 0.02  # points become one per voxel: even in area, and less noisy
ITERATIONS = 1000  # of the sample consensus, for each plane
SETTLING = 30  # times that a plane is fitted to the points near it
PLANES = 8  # tried at most
LEAST_FILLED = 0.5  # part of the points within the panel's outline that must lie on it
LEAST_POINTS = 30  # of a cluster, after thinning
OUTSIDE = 0.02  # part of a plane's points that may lie outside the image, as noise and flying pixels do
DRAW = "draw the panel into regions.yaml (docs/files.md)"


@dataclass(frozen=True)
class PanelFindingSettings(Settings):
    """The search for the panel where regions.yaml has no `panel` (no node does that)."""

    thickness_m: float = setting(
        0.02, unit="m", low=0.001, high=0.5, doc="Farthest that a point of the panel is from its plane."
    )
    gap_m: float = setting(0.05, unit="m", low=0.005, high=1.0, doc="Pieces of a plane that are farther apart are two.")
    min_share: float = setting(0.1, low=0.01, high=1.0, doc="Smallest part of the image that the panel covers.")
    rival_share: float = setting(0.7, low=0.05, high=1.0, doc="Another plane of this part of its size is a rival.")
    edge_px: float = setting(
        2.0, unit="ToF px", low=0.0, high=50.0, doc="Left out along the outline for flying pixels."
    )


@dataclass(frozen=True)
class FoundPanel:
    """outline_px: polygon (M, 2) in the raw image, smaller than the panel by the margins. share: part of the image that
    the whole panel covers. distance_m: of its plane from the camera."""

    outline_px: Array
    share: float
    distance_m: float


@dataclass(frozen=True)
class _Piece:
    """A connected piece of a plane n . X + d = 0: its middle (3,) [m], where it covers the image (rows, cols), the part
    of the image that this is, and the part of its points that lies inside the image."""

    normal: Array
    d: float
    middle_m: Array
    mask: NDArray[np.uint8]
    share: float
    inside: float

    @property
    def whole(self) -> bool:
        """Whether all of it is in the image."""
        return self.inside >= 1 - OUTSIDE

    def hides(self, other: _Piece) -> bool:
        """Whether it stands, whole, before a plane that goes on beyond the image: that one is its background."""
        return self.whole and not other.whole and bool(self.middle_m @ other.normal < -other.d)


def find_panel(
    points_m: Array, calibration: Calibration, subset_size: int, settings: PanelFindingSettings
) -> FoundPanel:
    """The panel in a ToF cloud, from the frame of the reference image.

    Planes are split off one by one by sample consensus (Open3D), each falls into connected pieces, and each piece is
    projected into the image (Eq. 4.1). The panel is the piece that covers most of it; a wall behind it that goes on
    beyond the image does not count. Its outline is shrunk by half a subset and by the width of flying pixels.

    Args:
        points_m: (N, 3), finite, in the camera frame.

    Raises:
        MeasurementError: if no plane is large enough, if two are about as likely, or if the outline leaves the image.
    """
    pieces = _pieces(points_m, calibration, settings)
    pieces = [piece for piece in pieces if piece.share >= settings.min_share]
    if not pieces:
        raise MeasurementError(
            f"no panel found: no plane covers {settings.min_share:.0%} of the image; come nearer, or {DRAW}"
        )
    pieces = [piece for piece in pieces if not any(other.hides(piece) for other in pieces)]
    pieces.sort(key=lambda piece: -piece.share)
    panel = pieces[0]
    rivals = [piece for piece in pieces[1:] if piece.share >= settings.rival_share * panel.share]
    if rivals:
        raise MeasurementError(
            f"no panel found: two planes are about as likely, {_words(panel)} and {_words(rivals[0])}; {DRAW}"
        )
    if not panel.whole:
        raise MeasurementError(
            f"no panel found: the largest plane, {_words(panel)}, leaves the image with {1 - panel.inside:.0%} of its "
            f"points; step back, or {DRAW}"
        )
    return FoundPanel(_outline(panel, points_m, calibration.camera, subset_size, settings), panel.share, -panel.d)


def _words(piece: _Piece) -> str:
    return f"{piece.share:.0%} of the image at {-piece.d:.2f} m"


def _pieces(points_m: Array, calibration: Calibration, settings: PanelFindingSettings) -> list[_Piece]:
    """All connected pieces of planes, those of the largest plane first."""
    o3d = open3d()
    o3d.utility.random.seed(0)
    rest = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points_m)).voxel_down_sample(VOXEL_M)
    pieces = []
    for _ in range(PLANES):
        if len(rest.points) < LEAST_POINTS:
            break
        chosen = _settled(np.asarray(rest.points), rest.segment_plane(settings.thickness_m, 3, ITERATIONS)[1], settings)
        on_plane, rest = rest.select_by_index(chosen), rest.select_by_index(chosen, invert=True)
        labels = np.asarray(on_plane.cluster_dbscan(settings.gap_m, 4))
        for label in range(labels.max(initial=-1) + 1):
            points = np.asarray(on_plane.points)[labels == label]
            if len(points) >= LEAST_POINTS:
                pieces.append(_piece(points, calibration))
    return pieces


def _settled(points_m: Array, chosen: NDArray[np.intp], settings: PanelFindingSettings) -> NDArray[np.intp]:
    """The points near the plane through them: the same from every run, as the sample consensus on threads is not."""
    for _ in range(SETTLING):
        normal, d = _plane_through(points_m[chosen])
        nearer = np.flatnonzero(np.abs(points_m @ normal + d) <= settings.thickness_m)
        if np.array_equal(nearer, chosen):
            break
        chosen = nearer
    return chosen


def _plane_through(points_m: Array) -> tuple[Array, float]:
    """Least squares: n (3,) and d < 0 of n . X + d = 0."""
    middle = points_m.mean(axis=0)
    normal = np.linalg.svd(points_m - middle, full_matrices=False)[2][2]
    normal = normal * np.sign(normal @ middle)
    return normal, float(-normal @ middle)


def _piece(points_m: Array, calibration: Calibration) -> _Piece:
    camera, middle = calibration.camera, points_m.mean(axis=0)
    normal, d = _plane_through(points_m)
    pixels, inside = _seen(points_m, camera)
    mask = _mask(pixels[inside], VOXEL_M * camera.fx / middle[2], camera)
    return _Piece(normal, d, middle, mask, float(mask.mean()), float(inside.mean()))


def _seen(points_m: Array, camera: Camera) -> tuple[Array, NDArray[np.bool_]]:
    """Raw pixels (N, 2), and which of them lie in the image."""
    pixels = camera.distort(camera.project(points_m))
    with np.errstate(invalid="ignore"):
        return pixels, np.all((pixels >= 0) & (pixels <= [camera.width - 1, camera.height - 1]), axis=1)


def _mask(pixels: Array, spacing_px: float, camera: Camera) -> NDArray[np.uint8]:
    """(rows, cols), 1 where pixels about that far apart cover the image; specks and holes of one point are gone."""
    mask = np.zeros((camera.height, camera.width), np.uint8)
    column, row = np.rint(pixels).astype(int).T
    mask[row, column] = 1
    across = int(np.ceil(1.5 * spacing_px)) | 1
    mask = cv2.dilate(mask, np.ones((across, across)))
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((across, across)))
    mask = cv2.erode(mask, np.ones((across, across)), borderType=cv2.BORDER_CONSTANT, borderValue=1)
    return cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((2 * across + 1, 2 * across + 1)))


def _outline(panel: _Piece, points_m: Array, camera: Camera, subset_size: int, settings: PanelFindingSettings) -> Array:
    """Polygon (M, 2) of the panel, from all its points, less the margins.

    Raises:
        MeasurementError: if most points within it are not on the plane, or nothing is left.
    """
    pixels, inside = _seen(points_m, camera)
    pixels, points_m = pixels[inside], points_m[inside]
    column, row = np.rint(pixels).astype(int).T
    within = panel.mask[row, column] > 0
    near = within & (np.abs(points_m @ panel.normal + panel.d) <= settings.thickness_m)
    if np.sum(near) < LEAST_FILLED * np.sum(within):
        raise MeasurementError(
            f"no panel found: of the points within the outline of the largest plane, {_words(panel)}, only "
            f"{np.sum(near) / np.sum(within):.0%} lie on it; {DRAW}"
        )
    pixels = pixels[near]
    spacing_px = float(np.sqrt(panel.mask.sum() / len(pixels)))
    margin = settings.edge_px * spacing_px + subset_size / 2
    straight = margin / 3  # so far may a corner of the polygon be from the outline
    mask = np.pad(_mask(pixels, spacing_px, camera), 1)
    mask = (cv2.distanceTransform(mask, cv2.DIST_L2, 5) > margin + straight)[1:-1, 1:-1].astype(np.uint8)
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        raise MeasurementError(
            f"no panel found: the largest plane, {_words(panel)}, is narrower than its margins of "
            f"{margin:.0f} px; {DRAW}"
        )
    largest = max(contours, key=cv2.contourArea)
    return cv2.approxPolyDP(largest, straight, True).reshape(-1, 2).astype(float)
