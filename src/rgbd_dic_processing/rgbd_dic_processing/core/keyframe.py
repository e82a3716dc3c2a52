"""An image whose subsets are looked for in others: the reference, or a later one that they were carried to.

A carried subset is centred where its material was found, to the fraction of a pixel. What is found from there is again
the place of the reference's material; the steps after the DIC see a keyframe in the uncertainty alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera

from .correlation import Correlation, CorrelationSettings, ReferenceSubsets
from .search import Guess, SeedSource, SubsetSearch
from .seed_maps import SeedMaps
from .settings import SearchSettings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Chain:
    """What the way of M subsets to a keyframe adds to the uncertainty of what is found from there.

    variance_px2: (M, 2), of their centres as places of the reference's material [px^2].
    link_px: (M, 2), standard uncertainty of the last link alone, from the keyframe before.
    shared: how much of the keyframe's noise acts on the last link and on the next one alike, 0 to 1.
    subset_px: side of a subset in the image that the regions were drawn on [px], the largest of the keyframes.
    """

    variance_px2: Array
    link_px: Array
    shared: float
    subset_px: float

    @classmethod
    def start(cls, count: int) -> Chain:
        """Of the reference."""
        return cls(*np.zeros((2, count, 2)), 0.0, 0.0)

    def uncertainty(self, jacobian: Array, sigma_px: Array) -> Array:
        """(M, 2) standard uncertainty [px] of subsets in an image, as places of the reference's material.

        The links add up in quadrature. But half of each one's variance is noise of the keyframe between them, which
        moves a subset one way when it is found there, and the other way when it is followed from there.

        Args:
            jacobian: (M, 2, 2), keyframe -> image.
            sigma_px: (M, 2), standard uncertainty of the link from the keyframe to the image.
        """
        if not (self.variance_px2.any() or self.link_px.any()):  # there is no link but the one to the image
            return sigma_px
        squared = jacobian**2
        carried = np.einsum("mij,mj->mi", squared, self.variance_px2)
        last = np.sqrt(np.einsum("mij,mj->mi", squared, self.link_px**2))
        return np.sqrt(carried + sigma_px**2 - self.shared * last * sigma_px)


@dataclass(frozen=True)
class Found:
    """The M subsets of a keyframe in an image.

    moved_px: (M, 2), centres in the raw image; link_px, sigma_px: (M, 2), their standard uncertainty since the keyframe
    and since the reference. NaN unless CONVERGED. jacobian: (M, 2, 2), keyframe -> image.
    """

    guess: Guess
    source: SeedSource
    correlation: Correlation
    moved_px: Array
    link_px: Array
    sigma_px: Array
    jacobian: Array


class Keyframe:
    """The subsets of one image, ready to be found in others.

    members: (M,), which of the N subsets it has. centres_px: (M, 2), in its raw image. homography: (3, 3), ideal pixels
    of the image that the regions were drawn on -> of this one. textured: (M,), which of them can be found at all.
    subset_px: as of `Chain`, its own side included.
    """

    def __init__(
        self,
        stamp_ns: int,
        image: NDArray[np.uint8],
        members: NDArray[np.intp],
        centres_px: Array,
        homography: Array,
        chain: Chain,
        camera: Camera,
        correlation: CorrelationSettings,
        search: SearchSettings,
    ):
        self.stamp_ns, self.members, self.centres_px, self.homography = stamp_ns, members, centres_px, homography
        self._image, self._chain, self._camera, self._search_settings = image, chain, camera, search
        side_px, scale = correlation.subset_size, _scale(homography, camera.undistort(centres_px))
        self.subset_px = max(chain.subset_px, side_px / scale)
        settings = replace(correlation, step=max(1, round(correlation.step * scale)))
        self._subsets = ReferenceSubsets(image, centres_px, settings)
        self._maps = SeedMaps(camera, np.rint(centres_px), reach_px=side_px / 2, threads=correlation.threads)
        self._itself = self._subsets.itself()
        self.textured = self._itself.valid

    @cached_property
    def _search(self) -> SubsetSearch:
        search = SubsetSearch(
            self._image, self._subsets, self._maps, self._camera, self._search_settings, self.textured
        )
        search.start(self.stamp_ns)
        return search

    @property
    def _start(self) -> Guess:
        return Guess(np.eye(3), np.zeros_like(self.centres_px))

    def itself(self) -> Found:
        """Its subsets in its own image."""
        unmoved = np.broadcast_to(np.eye(2), (len(self.members), 2, 2))
        return self._found(self._start, SeedSource.REFERENCE, self._itself, unmoved)

    def find(self, stamp_ns: int, image: NDArray[np.uint8]) -> Found | None:
        """Its subsets in another image; None if the pattern was not found."""
        target = self._subsets.target(image)
        guess, source = self._search.find(stamp_ns, image, target)
        if guess is None:
            return None
        seeds = self._search.seeds(guess)
        moved = self._subsets.correlate(target, seeds)
        moved = self._search.complete(image, target, guess, moved)
        self._search.remember(stamp_ns, guess, moved)
        return self._found(guess, source, moved, seeds[:, :, 1:3])

    def _found(self, guess: Guess, source: SeedSource, moved: Correlation, jacobian: Array) -> Found:
        link = np.column_stack([moved.sigma_x_px, moved.sigma_y_px]).astype(float)
        return Found(
            guess,
            source,
            moved,
            np.column_stack([moved.x_px, moved.y_px]),
            link,
            self._chain.uncertainty(jacobian, link),
            jacobian,
        )

    def chain_from(self, found: Found, chosen: NDArray[np.bool_]) -> Chain:
        """Of the chosen (M,) subsets, to the image in which they were found."""
        link_px = found.link_px[chosen]
        shared = _shared_pixels(found.jacobian[chosen].mean(axis=0), self._subsets.settings.subset_size)
        return Chain(found.sigma_px[chosen] ** 2, link_px, shared, self.subset_px)


def stretch(jacobian: Array) -> float:
    """By how much a map (2, 2) stretches or shrinks, at most, in any direction; at least 1."""
    along, across = np.linalg.svd(jacobian, compute_uv=False)
    return float(max(along, 1 / across))


def _scale(homography: Array, points_px: Array) -> float:
    """By how much the homography enlarges lengths around points (M, 2) of its target, median."""
    back = np.linalg.inv(homography)
    w = points_px @ back[2, :2] + back[2, 2]
    return float(np.sqrt(np.median(np.abs(w) ** 3) / abs(np.linalg.det(back))))


def _shared_pixels(jacobian: Array, side_px: int) -> float:
    """Correlation of sums of white noise over a subset seen under a map (2, 2), and over one that is centred there:
    their common area over the root of the product.

    Half a pixel in x and in y is not common: the second is centred on a whole pixel, and the first takes in only a part
    of the pixels on its border.
    """
    half = side_px / 2
    square = half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    seen = (square @ jacobian.T).astype(np.float32)
    common, _ = cv2.intersectConvexConvex(seen, square.astype(np.float32) + 0.5)
    return float(common / (side_px**2 * np.sqrt(abs(np.linalg.det(jacobian)))))
