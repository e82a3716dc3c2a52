"""Features of the reference found again in an image, for when nothing is known of the view."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class FeatureMatcher:
    """SIFT features of the reference (Lowe 2004), matched to those of other images by the ratio test.

    Both images are reduced until the panel is PANEL_PX long. Speckle keeps enough contrast in that: Gaussian speckle of
    sigma 1.5 to 5 px in images of 1000 x 1000 and 1440 x 1080 px was found at any turn, at scales of 0.7 to 1.4, and
    with 12 % of the panel in view. It takes a fifth of the time of the full size: 20 to 60 ms.
    """

    RATIO = 0.8
    PANEL_PX = 400

    def __init__(self, reference: NDArray[np.uint8], centres_px: Array, count: int):
        """Features are taken where the subsets are, at most `count`; not before they are first asked for."""
        self._reference = reference
        self._low, self._high = centres_px.min(axis=0).astype(int), centres_px.max(axis=0).astype(int) + 1
        self._scale = min(1.0, self.PANEL_PX / float((self._high - self._low).max()))
        self._detector = cv2.SIFT_create(nfeatures=count, enable_precise_upscale=True)
        self._known: tuple[Array, NDArray[np.float32]] | None = None

    def match(self, image: NDArray[np.uint8]) -> tuple[Array, Array]:
        """Raw pixels (M, 2) in the reference and in the image of what matched; some of it wrongly."""
        if self._known is None:
            (left, top), (right, bottom) = self._low, self._high
            mask = np.zeros(self._reference.shape, np.uint8)
            mask[top:bottom, left:right] = 255
            self._known = self._features(self._reference, mask)
        points, descriptors = self._known
        moved, others = self._features(image)
        if len(points) < 1 or len(moved) < 2:
            return np.zeros((0, 2)), np.zeros((0, 2))
        pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(descriptors, others, k=2)
        good = [first for first, second in pairs if first.distance < self.RATIO * second.distance]
        return points[[match.queryIdx for match in good]], moved[[match.trainIdx for match in good]]

    def _features(
        self, image: NDArray[np.uint8], mask: NDArray[np.uint8] | None = None
    ) -> tuple[Array, NDArray[np.float32]]:
        """Points (M, 2) [px of the full image] and descriptors (M, 128)."""
        size = tuple(max(round(self._scale * side), 1) for side in image.shape[::-1])
        cell = np.array(image.shape[::-1]) / size
        if mask is not None:
            mask = cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST)
        found, descriptors = self._detector.detectAndCompute(
            cv2.resize(image, size, interpolation=cv2.INTER_AREA), mask
        )
        points = np.array([key.pt for key in found], float).reshape(-1, 2)
        return (points + 0.5) * cell - 0.5, np.zeros((0, 128), np.float32) if descriptors is None else descriptors
