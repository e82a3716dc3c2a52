"""What the measurement of each image and of each ToF frame rests on, in a few numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .correlation import SubsetStatus
from .pairing import FramePair
from .plane import PlaneEstimate
from .search import SeedSource
from .stamps import Place, Stretches
from .status import FrameStatus
from .subset_field import SubsetField

LOW = 0.05  # quantile of the ZNCC beside its median


@dataclass(frozen=True)
class ImageQuality:
    """One image: how well its subsets were found, and the ToF frame it was paired with.

    status: of the DIC alone. seed: where the first guess came from. subsets: of the reference; found: of these,
    those that converged. zncc_median, zncc_low: of the found ones, the median and the 5th percentile. sigma_px:
    median standard uncertainty of a coordinate of the found ones. NaN if none was found.
    depth_offset_s: stamp of the image minus that of its ToF frame; NaN if it has none.
    """

    stamp_ns: int
    status: FrameStatus
    seed: SeedSource
    subsets: int
    found: int
    zncc_median: float
    zncc_low: float
    sigma_px: float
    depth_offset_s: float = math.nan


@dataclass(frozen=True)
class PlaneQuality:
    """The plane of one ToF frame.

    points: on the panel; inliers: of these, those on the plane; residual_rms_m: of the inliers. distance_m: of the
    plane from the camera; tilt_rad: between its normal and the camera's axis. NaN if there is no plane.
    """

    stamp_ns: int
    status: FrameStatus
    reason: str
    points: int
    inliers: int
    residual_rms_m: float
    distance_m: float
    tilt_rad: float


def image_quality(field: SubsetField) -> ImageQuality:
    found = field.subset_status == SubsetStatus.CONVERGED
    zncc, sigma = field.zncc[found].astype(float), field.sigma_px[found].astype(float)
    median, low = np.quantile(zncc, (0.5, LOW)) if found.any() else (math.nan, math.nan)
    return ImageQuality(
        field.stamp_ns,
        field.status,
        field.seed_source,
        len(found),
        int(found.sum()),
        float(median),
        float(low),
        float(np.median(sigma)) if found.any() else math.nan,
    )


def plane_quality(estimate: PlaneEstimate) -> PlaneQuality:
    plane = estimate.plane
    return PlaneQuality(
        estimate.stamp_ns,
        estimate.status,
        estimate.reason,
        estimate.points,
        estimate.inliers,
        estimate.residual_rms_m,
        math.nan if plane is None else -plane.d,
        math.nan if plane is None else math.acos(min(plane.normal[2], 1.0)),
    )


class QualityRecord:
    """Gathers it from what the steps of the method give, in the order in which each gives it.

    Attributes:
        planes: one for each ToF frame.
    """

    def __init__(self) -> None:
        self.planes: list[PlaneQuality] = []
        self._of_fields, self._of_pairs = Stretches(), Stretches()
        self._images: list[tuple[Place, ImageQuality]] = []
        self._pairs: dict[Place, FramePair] = {}

    def add(
        self, field: SubsetField | None, pairs: Sequence[FramePair] = (), planes: Sequence[PlaneEstimate] = ()
    ) -> None:
        if field is not None:
            self._images.append((self._of_fields.place(field.stamp_ns), image_quality(field)))
        self._pairs.update((self._of_pairs.place(pair.stamp_ns), pair) for pair in pairs)
        self.planes += [plane_quality(plane) for plane in planes]

    def images(self) -> list[ImageQuality]:
        """One for each image."""
        return [
            replace(image, depth_offset_s=self._pairs[place].depth_offset_s) if place in self._pairs else image
            for place, image in self._images
        ]
