"""The initial guess: a homography reference -> image, predicted from the frames before or recovered by features."""

from __future__ import annotations

from enum import IntEnum

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera

from .correlation import ReferenceSubsets, SubsetStatus
from .geometry import SeedMaps, apply_homography
from .settings import SearchSettings

Array = NDArray[np.float64]


class SeedSource(IntEnum):
    """Where a frame's initial guess came from. Values as in rgbd_dic_msgs/SubsetField."""

    REFERENCE = 0
    PREDICTION = 1
    FEATURES = 2
    NONE = 3


class HomographySearch:
    """Follows the panel from frame to frame, and finds it again when it was lost.

    A guess is taken only if the DIC itself, run on a few spread subsets (probes), finds them where one homography
    says. The probes also refine the guess, so that the full run starts a few hundredths of a pixel away.
    """

    def __init__(
        self,
        image: NDArray[np.uint8],
        subsets: ReferenceSubsets,
        maps: SeedMaps,
        centres_px: Array,
        camera: Camera,
        settings: SearchSettings,
    ):
        self._subsets, self._maps, self._camera, self._settings = subsets, maps, camera, settings
        self._ideal = camera.undistort(centres_px)
        self._probes = _spread(centres_px, settings.probes)
        self._features = cv2.SIFT_create(nfeatures=settings.features)
        low, high = centres_px.min(axis=0).astype(int), centres_px.max(axis=0).astype(int) + 1
        mask = np.zeros(image.shape, np.uint8)
        mask[low[1] : high[1], low[0] : high[0]] = 255
        self._reference_features = self._features.detectAndCompute(image, mask)
        self._history: list[tuple[int, Array]] = []

    def find(
        self, stamp_ns: int, image: NDArray[np.uint8], target: object
    ) -> tuple[Array | None, SeedSource]:
        """The homography (3, 3) in ideal pixels and where it came from; None if the panel was not found."""
        for guess in self._predictions(stamp_ns):
            refined = self._confirm(target, guess)
            if refined is not None:
                return refined, SeedSource.PREDICTION
        guess = self._match_features(image)
        refined = self._confirm(target, guess) if guess is not None else None
        return (refined, SeedSource.FEATURES) if refined is not None else (None, SeedSource.NONE)

    def remember(self, stamp_ns: int, homography: Array) -> None:
        """The frame's final homography, for the next prediction."""
        self._history = [*self._history[-1:], (stamp_ns, homography)]

    def fit(self, moved_px: Array, chosen: NDArray[np.intp] | None = None) -> Array | None:
        """The homography that most of the subsets (raw pixels (N, 2), NaN where not found) agree with, or None."""
        source = self._ideal if chosen is None else self._ideal[chosen]
        moved = self._camera.undistort(moved_px)
        found = np.isfinite(moved).all(axis=1)
        if found.sum() < 8:
            return None
        homography, agreed = cv2.findHomography(
            source[found], moved[found], cv2.RANSAC, self._settings.max_residual_px
        )
        enough = homography is not None and agreed.sum() >= self._settings.min_found * len(source)
        return homography / homography[2, 2] if enough else None

    def _predictions(self, stamp_ns: int) -> list[Array]:
        """The last homography plus its recent change, scaled by the time that passed; then the last one alone."""
        if not self._history:
            return [np.eye(3)]
        last_ns, last = self._history[-1]
        before_ns, before = self._history[0]
        if not before_ns < last_ns < stamp_ns:
            return [last]
        return [last + (last - before) * (stamp_ns - last_ns) / (last_ns - before_ns), last]

    def _confirm(self, target: object, guess: Array) -> Array | None:
        moved = self._subsets.correlate(target, self._maps.seeds(guess), self._probes)
        if np.mean(moved.status == SubsetStatus.CONVERGED) < self._settings.min_found:
            return None
        return self.fit(np.column_stack([moved.x_px, moved.y_px]), self._probes)

    def _match_features(self, image: NDArray[np.uint8]) -> Array | None:
        points, descriptors = self._features.detectAndCompute(image, None)
        reference_points, reference_descriptors = self._reference_features
        if (
            reference_descriptors is None
            or descriptors is None
            or min(len(points), len(reference_points)) < 8
        ):
            return None
        matches = cv2.BFMatcher(cv2.NORM_L2).knnMatch(reference_descriptors, descriptors, k=2)
        good = [pair[0] for pair in matches if len(pair) == 2 and pair[0].distance < 0.8 * pair[1].distance]
        if len(good) < 8:
            return None
        source = self._camera.undistort(np.array([reference_points[m.queryIdx].pt for m in good], float))
        moved = self._camera.undistort(np.array([points[m.trainIdx].pt for m in good], float))
        homography, _ = cv2.findHomography(source, moved, cv2.RANSAC, 3.0, maxIters=5000)
        if homography is None or not np.isfinite(apply_homography(homography, self._ideal)).all():
            return None
        return homography / homography[2, 2]


def _spread(centres_px: Array, count: int) -> NDArray[np.int32]:
    """Indices of about `count` subsets spread evenly over the grid."""
    low, extent = centres_px.min(axis=0), np.maximum(np.ptp(centres_px, axis=0), 1)
    columns = max(round(float(np.sqrt(count * extent[0] / extent[1]))), 1)
    cells = np.array([columns, max(round(count / columns), 1)])
    cell = np.minimum(((centres_px - low) / extent * cells).astype(int), cells - 1)
    middle = np.sum(np.square((centres_px - low) / extent * cells - cell - 0.5), axis=1)
    order = np.lexsort([middle, cell[:, 0] + columns * cell[:, 1]])
    _, first = np.unique((cell[:, 0] + columns * cell[:, 1])[order], return_index=True)
    return np.sort(order[first]).astype(np.int32)
