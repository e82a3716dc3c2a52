"""The result of step 1 of the method for one image, and the reference that it counts from."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .correlation import SubsetStatus
from .regions import Regions
from .search import SeedSource
from .status import FrameStatus

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Reference:
    """The image that displacements count from, and its N subsets.

    centres_px: (N, 2), in its raw image; NaN for a subset that does not lie in it.
    drawn_px: (N, 2), the same in the raw image that the regions were drawn on, the first reference; row by row.
    homography: (3, 3), ideal pixels of that image -> of this one.
    regions: those that hold from this reference on; None for the ones that the measurement began with.
    """

    stamp_ns: int
    image: NDArray[np.uint8]
    centres_px: Array
    subset_size: int
    step: int
    drawn_px: Array
    homography: Array
    regions: Regions | None = field(default=None, compare=False)

    @classmethod
    def first(
        cls, stamp_ns: int, image: NDArray[np.uint8], centres_px: NDArray, subset_size: int, step: int
    ) -> Reference:
        """The one that the regions are drawn on."""
        centres = np.asarray(centres_px, float)
        return cls(stamp_ns, image, centres, subset_size, step, centres, np.eye(3))


@dataclass(frozen=True)
class SubsetField:
    """The subsets of the reference in one image, in the order of `Reference.centres_px`.

    keyframe_stamp_ns: of the image that they were followed from: the reference, or a later one.
    subset_px: side of a subset in the image that the regions were drawn on [px]; the errors of nearer ones correlate.
    homography: (3, 3), image that the regions were drawn on -> image, ideal pixels; NaN if none.
    moved_px: (N, 2) float64, centres in the raw image; NaN unless CONVERGED.
    sigma_px: (N, 2) float32, their standard uncertainty since the reference; NaN unless CONVERGED.
    """

    stamp_ns: int
    reference_stamp_ns: int
    keyframe_stamp_ns: int
    status: FrameStatus
    reason: str
    seed_source: SeedSource
    subset_px: float
    homography: Array
    moved_px: Array
    sigma_px: NDArray[np.float32]
    zncc: NDArray[np.float32]
    iterations: NDArray[np.uint8]
    subset_status: NDArray[np.uint8]
    image_received_ns: int = field(default=0, compare=False)

    @classmethod
    def without_subsets(
        cls,
        stamp_ns: int,
        reference_stamp_ns: int,
        keyframe_stamp_ns: int,
        status: FrameStatus,
        reason: str,
        count: int,
        subset_px: float,
    ) -> SubsetField:
        """Of an image that could not be used: all N = count subsets are SKIPPED."""
        return cls(
            stamp_ns,
            reference_stamp_ns,
            keyframe_stamp_ns,
            status,
            reason,
            SeedSource.NONE,
            subset_px,
            np.full((3, 3), np.nan),
            np.full((count, 2), np.nan),
            np.full((count, 2), np.nan, np.float32),
            np.full(count, np.nan, np.float32),
            np.zeros(count, np.uint8),
            np.full(count, SubsetStatus.SKIPPED, np.uint8),
        )

    @property
    def view(self) -> Array | None:
        """The homography, or None if the panel was not found."""
        return self.homography if self.status == FrameStatus.OK else None
