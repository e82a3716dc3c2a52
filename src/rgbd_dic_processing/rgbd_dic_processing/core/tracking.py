"""Step 1 of the method: where each subset of the reference image is in every image."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera

from .correlation import CorrelationSettings, ReferenceSubsets, SubsetStatus
from .geometry import SeedMaps
from .regions import Regions
from .search import Guess, SeedSource, SubsetSearch
from .settings import SearchSettings
from .status import FrameStatus

Array = NDArray[np.float64]
UNKNOWN_HOMOGRAPHY = np.full((3, 3), np.nan)


@dataclass(frozen=True)
class Reference:
    """The reference image and its subsets: centres (N, 2) in raw pixels, row by row."""

    stamp_ns: int
    image: NDArray[np.uint8]
    centres_px: NDArray[np.int32]
    subset_size: int
    step: int


@dataclass(frozen=True)
class SubsetField:
    """The subsets of the reference in one image, in the order of `Reference.centres_px`.

    homography: (3, 3), reference -> image, ideal pixels, that seeded the subsets; NaN if none.
    moved_px: (N, 2) float64, centres in the raw image; NaN unless CONVERGED.
    sigma_px: (N, 2) float32, their standard uncertainty; NaN unless CONVERGED.
    """

    stamp_ns: int
    reference_stamp_ns: int
    status: FrameStatus
    reason: str
    seed_source: SeedSource
    homography: Array
    moved_px: Array
    sigma_px: NDArray[np.float32]
    zncc: NDArray[np.float32]
    iterations: NDArray[np.uint8]
    subset_status: NDArray[np.uint8]
    image_received_ns: int = field(default=0, compare=False)

    @property
    def view(self) -> Array | None:
        """The homography, or None if the panel was not found."""
        return self.homography if self.status == FrameStatus.OK else None


class SubsetTracking:
    """Takes the first image, or the next one after `renew_reference`, as the reference and follows its subsets."""

    def __init__(self, camera: Camera, regions: Regions, correlation: CorrelationSettings, search: SearchSettings):
        self._camera, self._regions = camera, regions
        self._correlation, self._search_settings = correlation, search
        self.reference: Reference | None = None

    def renew_reference(self) -> None:
        """The next good image becomes the reference."""
        self.reference = None

    def track(self, stamp_ns: int, image: NDArray[np.uint8] | None, reason: str = "") -> SubsetField:
        """The subset field of an image (rows, cols); without subsets if there is no reference yet.

        Args:
            image: mono8, or None if it could not be read, with the reason.

        Raises:
            RegionsError: if the regions do not fit the first image; nothing can be measured then.
        """
        size = (self._camera.height, self._camera.width)
        if image is not None and image.dtype != np.uint8:
            reason = f"image has {8 * image.dtype.itemsize} bits a pixel; convert it to mono8"
        elif image is not None and image.shape != size:
            reason = (
                f"image is {image.shape[1]} x {image.shape[0]} px, the calibrated camera has {size[1]} x {size[0]} px"
            )
        if image is None or reason:
            return self._nothing(stamp_ns, FrameStatus.BAD_IMAGE, reason)
        if self.reference is None:
            self._take_reference(stamp_ns, image)
        target = self._subsets.target(image)
        if stamp_ns == self.reference.stamp_ns:
            guess, source = Guess(np.eye(3), np.zeros(self.reference.centres_px.shape)), SeedSource.REFERENCE
        else:
            guess, source = self._search.find(stamp_ns, image, target)
        if guess is None:
            return self._nothing(stamp_ns, FrameStatus.LOST, "the reference pattern was not found in the image")
        moved = self._subsets.correlate(target, self._search.seeds(guess))
        moved = self._search.complete(image, target, guess, moved)
        self._search.remember(stamp_ns, guess, moved)
        return SubsetField(
            stamp_ns,
            self.reference.stamp_ns,
            FrameStatus.OK,
            "",
            source,
            guess.homography,
            np.column_stack([moved.x_px, moved.y_px]),
            np.column_stack([moved.sigma_x_px, moved.sigma_y_px]).astype(np.float32),
            moved.zncc,
            moved.iterations,
            moved.status,
        )

    def _take_reference(self, stamp_ns: int, image: NDArray[np.uint8]) -> None:
        size, step = self._correlation.subset_size, self._correlation.step
        self._regions.check(self._camera.width, self._camera.height, size, step)
        centres = self._regions.subset_centres(self._camera.width, self._camera.height, size, step)
        self._subsets = ReferenceSubsets(image, centres, self._correlation)
        maps = SeedMaps(self._camera, centres, reach_px=size / 2)
        self._search = SubsetSearch(image, self._subsets, maps, self._camera, self._search_settings)
        self.reference = Reference(stamp_ns, image, centres, size, step)

    def _nothing(self, stamp_ns: int, status: FrameStatus, reason: str) -> SubsetField:
        count = len(self.reference.centres_px) if self.reference else 0
        return SubsetField(
            stamp_ns,
            self.reference.stamp_ns if self.reference else 0,
            status,
            reason,
            SeedSource.NONE,
            UNKNOWN_HOMOGRAPHY,
            np.full((count, 2), np.nan),
            np.full((count, 2), np.nan, np.float32),
            np.full(count, np.nan, np.float32),
            np.zeros(count, np.uint8),
            np.full(count, SubsetStatus.SKIPPED, np.uint8),
        )
