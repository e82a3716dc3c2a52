"""What the field's viewers are shown of a measured image: regions and subsets, in a picture and on the panel in 3D."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import MeasurementError

from .carried_regions import carried_ideal
from .crack_line import CrackLine
from .displacement_field import DisplacementField
from .geometry import Plane, apply_homography
from .plane import PlaneEstimate
from .regions import Regions
from .status import FrameStatus

Array = NDArray[np.float64]
Outlines = dict[str, list[Array]]
PLANE_NEAR_S = 0.1  # between an image and a plane that is shown with it
NARROWEST_M = 1e-6  # half the width of the colour scale at least, so that rounding does not look like displacement
BLUE, WHITE, RED = (0.0, 0.45, 0.70), (0.96, 0.96, 0.96), (0.84, 0.37, 0.0)  # Okabe and Ito 2008: for the colour-blind


@dataclass(frozen=True)
class View:
    """One image as viewers show it.

    camera: that of the picture, without distortion. picture: (rows, cols) uint8.
    outlines_px, outlines_m: name -> polygons, (M, 2) pixels of the picture and (M, 3) in the camera frame [m], named as
        by `carried_regions`; the latter is empty without a plane.
    subsets_px, subsets_m: (N, 2) and (N, 3) of the subsets that were measured; NaN without a plane.
    displacement_m: (N, 3), normal to the crack, along it, into the wall, since the reference; NaN if not known.
    sigma_m: (N,), standard uncertainty of the first from the DIC alone.
    """

    camera: Camera
    picture: NDArray[np.uint8]
    outlines_px: Outlines
    outlines_m: Outlines
    subsets_px: Array
    subsets_m: Array
    displacement_m: Array
    sigma_m: Array


class Viewing:
    """Makes views of the images of a camera."""

    def __init__(self, camera: Camera):
        self._camera = camera
        self._centres = self._ideal = np.zeros((0, 2))
        self._maps: dict[tuple[int, ...], tuple[Camera, NDArray, NDArray]] = {}

    def view(
        self,
        small: NDArray[np.uint8],
        homography: Array,
        regions: Regions | None,
        field: DisplacementField,
        plane: Plane | None,
    ) -> View:
        """The picture is the small one without its distortion, so that viewers that know none show all in its place.

        Subsets are shown where the homography carries them: off by what they moved, which no viewer resolves.

        Args:
            small: (rows, cols), the whole image with any number of pixels.
            homography: (3, 3), image that the regions are drawn on -> image, ideal pixels; NaN if it was not found.
            plane: the panel's in the camera frame, near in time; None if not known.
        """
        camera, *maps = self._maps_for(small.shape)
        picture = cv2.remap(small, *maps, cv2.INTER_LINEAR)
        outlines = carried_ideal(regions, self._camera, homography) if regions is not None else {}
        rays = {name: [self._camera.rays(polygon) for polygon in polygons] for name, polygons in outlines.items()}
        displacement, sigma = _in_crack_axes(self._camera, regions, field)
        if not np.array_equal(field.centres_px, self._centres):  # the same for all images of a reference
            self._centres, self._ideal = field.centres_px, self._camera.undistort(field.centres_px.astype(float))
        moved = apply_homography(homography, self._ideal)
        shown = np.isfinite(displacement[:, 0]) & np.isfinite(moved).all(axis=1)
        subset_rays = self._camera.rays(moved[shown])
        return View(
            camera,
            picture,
            {name: [camera.project(polygon) for polygon in polygons] for name, polygons in rays.items()},
            _placed(rays, plane) if plane is not None else {},
            camera.project(subset_rays),
            plane.points(subset_rays) if plane is not None else np.full((len(subset_rays), 3), np.nan),
            displacement[shown],
            sigma[shown],
        )

    def _maps_for(self, shape: tuple[int, ...]) -> tuple[Camera, NDArray, NDArray]:
        if shape not in self._maps:
            raw = self._camera.scaled_to(shape[1], shape[0])
            ideal = replace(raw, k1=0.0, k2=0.0)
            coefficients = np.array([raw.k1, raw.k2, 0.0, 0.0])
            size = (raw.width, raw.height)
            maps = cv2.initUndistortRectifyMap(raw.matrix, coefficients, None, ideal.matrix, size, cv2.CV_16SC2)
            self._maps = {shape: (ideal, *maps)}
        return self._maps[shape]


class ColourScale:
    """Blue, white, orange for displacements from -limit to limit; the limit grows as long as the reference stays.

    Attributes:
        limit_m: what the strongest colours stand for.
    """

    def __init__(self) -> None:
        self._reference_ns, self.limit_m = 0, NARROWEST_M

    def widen(self, reference_stamp_ns: int, displacement_m: Array) -> None:
        """Take the displacements (N,) of an image in; but for the largest hundredth, which may be wrong."""
        if reference_stamp_ns != self._reference_ns:
            self._reference_ns, self.limit_m = reference_stamp_ns, NARROWEST_M
        if len(displacement_m):
            self.limit_m = max(self.limit_m, float(np.percentile(np.abs(displacement_m), 99)))

    def colours(self, displacement_m: Array) -> Array:
        """(N,) -> (N, 3), red, green and blue from 0 to 1."""
        at = displacement_m / self.limit_m
        return np.stack([np.interp(at, (-1, 0, 1), levels) for levels in zip(BLUE, WHITE, RED, strict=True)], axis=-1)


def made_small(image: NDArray[np.uint8], most_width_px: int) -> NDArray[np.uint8]:
    """An image (rows, cols) with so many times fewer pixels, a whole number of times, that it is not wider."""
    height, width = image.shape
    factor = -(-width // most_width_px)
    if factor == 1:
        return image
    return cv2.resize(image, (width // factor, height // factor), interpolation=cv2.INTER_AREA)


def nearest_plane(estimates: Iterable[PlaneEstimate], stamp_ns: int) -> Plane | None:
    """Of the planes that were found, the one nearest in time; None if none is within PLANE_NEAR_S."""
    away = {abs(e.stamp_ns - stamp_ns): e.plane for e in estimates if e.plane is not None}
    nearest = min(away, default=None)
    return away[nearest] if nearest is not None and nearest < PLANE_NEAR_S * 1e9 else None


def _placed(rays: Outlines, plane: Plane) -> Outlines:
    """Where the outlines meet the plane; those that do not are left out."""
    met = {name: [plane.points(polygon) for polygon in polygons] for name, polygons in rays.items()}
    return {name: [p for p in polygons if np.isfinite(p).all()] for name, polygons in met.items()}


def _in_crack_axes(camera: Camera, regions: Regions | None, field: DisplacementField) -> tuple[Array, Array]:
    """(N, 3) displacement along the crack's axes, those of the panel without a crack, and (N,) sigma of the first."""
    axes = np.eye(2)
    nothing = np.full((len(field.centres_px), 3), np.nan), np.full(len(field.centres_px), np.nan)
    if field.status != FrameStatus.OK:
        return nothing
    if regions is not None and regions.crack is not None:
        try:
            axes = CrackLine(camera, regions.crack, field.centres_px.astype(float)).axes(field.position_m)
        except MeasurementError:
            return nothing
    displacement = np.column_stack([field.displacement_m[:, :2] @ axes.T, field.displacement_m[:, 2]])
    sigma = np.sqrt(field.sigma_m[:, :2].astype(float) ** 2 @ axes[0] ** 2)
    return displacement, sigma
