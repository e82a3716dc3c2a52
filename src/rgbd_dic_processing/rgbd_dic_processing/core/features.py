"""Features of the reference found again in an image, for when the prediction fails."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class FeatureMatcher:
    """SIFT features of the reference (Lowe 2004), matched to those of other images by the ratio test."""

    RATIO = 0.8

    def __init__(self, reference: NDArray[np.uint8], centres_px: Array, count: int):
        """Features are taken where the subsets are, at most `count`."""
        self._detector = cv2.SIFT_create(nfeatures=count)
        low, high = centres_px.min(axis=0).astype(int), centres_px.max(axis=0).astype(int) + 1
        mask = np.zeros(reference.shape, np.uint8)
        mask[low[1] : high[1], low[0] : high[0]] = 255
        self._points, self._descriptors = self._detector.detectAndCompute(reference, mask)

    def match(self, image: NDArray[np.uint8]) -> tuple[Array, Array]:
        """Raw pixels (M, 2) in the reference and in the image of what matched; some of it wrongly."""
        points, descriptors = self._detector.detectAndCompute(image, None)
        if self._descriptors is None or descriptors is None:
            return np.zeros((0, 2)), np.zeros((0, 2))
        pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(self._descriptors, descriptors, k=2)
        good = [pair[0] for pair in pairs if len(pair) == 2 and pair[0].distance < self.RATIO * pair[1].distance]
        source = np.array([self._points[match.queryIdx].pt for match in good], float).reshape(-1, 2)
        moved = np.array([points[match.trainIdx].pt for match in good], float).reshape(-1, 2)
        return source, moved
