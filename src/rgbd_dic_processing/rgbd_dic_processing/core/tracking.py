"""Step 1 of the method: where each subset of the reference image is in every image."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_acquisition.errors import MeasurementError

from .correlation import CorrelationSettings, ReferenceSubsets, SubsetStatus
from .geometry import SeedMaps
from .regions import Regions
from .search import Guess, SeedSource, SubsetSearch
from .settings import SearchSettings
from .status import FrameStatus

Array = NDArray[np.float64]
RENEWAL_PX = 5.0  # how far the view may have moved from the reference when a new one is taken with the same regions
LEAST_TEXTURED = 0.25  # share of each region's subsets that must have texture in a reference
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
        self._newest_ns = -1
        self._centres: NDArray[np.int32] | None = None
        self.reference: Reference | None = None

    def renew_reference(self) -> None:
        """The next good image becomes the reference.

        Raises:
            MeasurementError: if the view has moved, so that the regions, which are pixels of the first reference, would
                lie elsewhere on the panel.
        """
        if self.reference is None:
            return
        moved_px = self._search.moved_px()
        if moved_px > RENEWAL_PX:
            raise MeasurementError(
                f"the view has moved by {moved_px:.0f} px since the reference (at most {RENEWAL_PX:g} px): the regions "
                "are pixels of that image. Move back, or draw new regions and start again"
            )
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
        if stamp_ns <= self._newest_ns:
            reason = f"its stamp is not later than that of the image before it ({self._newest_ns} ns)"
        self._newest_ns = max(self._newest_ns, stamp_ns)
        if self.reference is None and image is not None and not reason:
            reason = self._take_reference(stamp_ns, image)
        if image is None or reason:
            return self._nothing(stamp_ns, FrameStatus.BAD_IMAGE, reason)
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

    def _take_reference(self, stamp_ns: int, image: NDArray[np.uint8]) -> str:
        """Make an image the reference; or say why it cannot be one."""
        size, step = self._correlation.subset_size, self._correlation.step
        if self._centres is None:
            grid = (self._camera.width, self._camera.height, size, step)
            self._regions.check(*grid)
            centres = self._regions.subset_centres(*grid)
            self._centres = centres[np.isfinite(self._camera.undistort(centres)).all(axis=1)]
        centres = self._centres
        subsets = ReferenceSubsets(image, centres, self._correlation)
        maps = SeedMaps(self._camera, centres, reach_px=size / 2)
        itself = subsets.correlate(subsets.target(image), maps.seeds(np.eye(3)))
        named = [("panel", np.ones(len(centres), bool)), ("fixed region", self._regions.fixed_members(centres))]
        if self._regions.crack is not None:
            named += [
                (f"{side} zone", np.isin(np.arange(len(centres)), zone))
                for side, zone in zip(("left", "right"), self._regions.crack.members(centres), strict=True)
            ]
        for name, members in named:
            textured = np.mean(itself.valid[members]) if members.any() else 0.0
            if textured < LEAST_TEXTURED:
                return f"no reference: only {textured:.0%} of the {name}'s subsets have texture (light? focus?)"
        self._subsets = subsets
        self._search = SubsetSearch(image, subsets, maps, self._camera, self._search_settings, itself.valid)
        self.reference = Reference(stamp_ns, image, centres, size, step)
        return ""

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
