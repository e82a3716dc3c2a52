"""The initial guess of each frame: predicted from the frames before, or recovered by matching features."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from scipy.spatial import cKDTree

from .correlation import Correlation, ReferenceSubsets, SubsetStatus, Target
from .features import FeatureMatcher
from .geometry import SeedMaps, apply_homography
from .settings import SearchSettings

Array = NDArray[np.float64]

NEWS_PX = 0.5  # an expected position nearer than this to one that was tried tells nothing new
RETRY_FRAMES = 10  # how often features are asked while a part of the panel stays missing


class SeedSource(IntEnum):
    """Where a frame's initial guess came from. Values as in rgbd_dic_msgs/SubsetField."""

    REFERENCE = 0
    PREDICTION = 1
    FEATURES = 2
    NONE = 3


@dataclass(frozen=True)
class Guess:
    """Where the subsets are expected: a homography, and how far each one is away from it.

    homography: (3, 3), reference -> image, ideal pixels. offsets_px: (N, 2), raw pixels: what the crack and the
    deformation of the panel add.
    """

    homography: Array
    offsets_px: Array


class SubsetSearch:
    """Follows the panel from frame to frame, and finds it again when it was lost.

    A guess is taken only if the DIC itself, run on a few spread subsets (probes), finds enough of them there. The
    probes also refine its homography, so that the full run starts a few hundredths of a pixel away.
    """

    def __init__(
        self,
        image: NDArray[np.uint8],
        subsets: ReferenceSubsets,
        maps: SeedMaps,
        camera: Camera,
        settings: SearchSettings,
        textured: NDArray[np.bool_],
    ):
        self._subsets, self._maps, self._camera, self._settings = subsets, maps, camera, settings
        self._centres = subsets.centres_px.astype(float)
        self._ideal = camera.undistort(self._centres)
        usable = np.flatnonzero(textured)
        self._probes = usable[_spread(self._centres[usable], settings.probes)]
        self._features = FeatureMatcher(image, self._centres, settings.features)
        self._around = cKDTree(self._centres).query_ball_point(self._centres, 1.5 * subsets.settings.step)
        self._missing_before, self._frames_missing = 0.0, 0
        self._history: list[tuple[int, Array]] = []
        self._offsets = np.zeros_like(self._centres)

    def find(self, stamp_ns: int, image: NDArray[np.uint8], target: Target) -> tuple[Guess | None, SeedSource]:
        """The guess for an image and where it came from; None if the panel was not found."""
        for homography in self._predictions(stamp_ns):
            refined = self._confirm(target, Guess(homography, self._offsets))
            if refined is not None:
                return refined, SeedSource.PREDICTION
        guess = self._match_features(image, None)
        refined = self._confirm(target, guess) if guess is not None else None
        return refined, SeedSource.NONE if refined is None else SeedSource.FEATURES

    def moved_px(self) -> float:
        """How far the panel's subsets were, at most, from their places in the reference when they were last found."""
        if not self._history:
            return 0.0
        return float(np.abs(apply_homography(self._history[-1][1], self._ideal) - self._ideal).max())

    def seeds(self, guess: Guess) -> Array:
        """The seed maps (N, 2, 6) of a guess."""
        seeds = self._maps.seeds(guess.homography)
        seeds[:, :, 0] += guess.offsets_px
        return seeds

    def complete(self, image: NDArray[np.uint8], target: Target, guess: Guess, moved: Correlation) -> Correlation:
        """Try the subsets that were not found again: from their found neighbours, then from matched features.

        Features cost much more, so they are asked only when a part of the panel went missing since the last frame, and
        now and then while it stays missing.
        """
        tried = guess.offsets_px.copy()
        moved = self._from_neighbours(target, guess, moved, tried)
        missing = np.mean(self._worth_trying(moved))
        self._frames_missing = self._frames_missing + 1 if missing > self._settings.max_missing else 0
        if missing - self._missing_before > self._settings.max_missing or self._frames_missing >= RETRY_FRAMES:
            self._frames_missing = 0
            matched = self._match_features(image, guess.homography)
            if matched is not None:
                away = np.abs(matched.offsets_px - tried).max(axis=1)
                chosen = np.flatnonzero(self._worth_trying(moved) & (away > NEWS_PX))
                moved = self._try(target, guess, moved, tried, chosen, matched.offsets_px[chosen])
                moved = self._from_neighbours(target, guess, moved, tried)
                missing = np.mean(self._worth_trying(moved))
        self._missing_before = missing
        return moved

    def _from_neighbours(self, target: Target, guess: Guess, moved: Correlation, tried: Array) -> Correlation:
        """Each subset not found, from the median of where its found neighbours are; until that finds no more.

        So a part that moved unlike the rest is filled in from its border. A subset whose neighbours tell nothing new is
        left alone. `tried` (N, 2), the offsets tried so far, is kept up to date.
        """
        for _ in range(self._settings.rounds):
            offsets = self._away(guess.homography, moved)
            found = np.isfinite(offsets[:, 0])
            chosen, expected = [], []
            for index in np.flatnonzero(self._worth_trying(moved)):
                near = offsets[[other for other in self._around[index] if found[other]]]
                if len(near) and np.abs(np.median(near, axis=0) - tried[index]).max() > NEWS_PX:
                    chosen.append(index)
                    expected.append(np.median(near, axis=0))
            before = np.sum(moved.valid)
            moved = self._try(target, guess, moved, tried, np.array(chosen, int), np.array(expected).reshape(-1, 2))
            if np.sum(moved.valid) == before:
                break
        return moved

    def _try(
        self,
        target: Target,
        guess: Guess,
        moved: Correlation,
        tried: Array,
        chosen: NDArray[np.intp],
        offsets_px: Array,
    ) -> Correlation:
        if not len(chosen):
            return moved
        tried[chosen] = offsets_px
        return moved.replaced(
            chosen, self._subsets.correlate(target, self.seeds(Guess(guess.homography, tried)), chosen)
        )

    @staticmethod
    def _worth_trying(moved: Correlation) -> NDArray[np.bool_]:
        """Which subsets were not found, though they have texture."""
        return ~moved.valid & ~np.isin(moved.status, (SubsetStatus.LOW_TEXTURE, SubsetStatus.SKIPPED))

    def remember(self, stamp_ns: int, guess: Guess, moved: Correlation) -> None:
        """Keep what was found, for the next prediction."""
        homography = self._fit(np.column_stack([moved.x_px, moved.y_px]))
        homography = guess.homography if homography is None else homography
        self._history = [*self._history[-1:], (stamp_ns, homography)]
        offsets = self._away(homography, moved)
        found = np.isfinite(offsets[:, 0])
        if found.any():
            nearest = cKDTree(self._centres[found]).query(self._centres)[1]
            self._offsets = offsets[found][nearest]

    def _predictions(self, stamp_ns: int) -> list[Array]:
        """The last homography plus its recent change, scaled by the time that passed; then the last one alone."""
        if not self._history:
            return [np.eye(3)]
        last_ns, last = self._history[-1]
        before_ns, before = self._history[0]
        if not before_ns < last_ns < stamp_ns:
            return [last]
        return [last + (last - before) * (stamp_ns - last_ns) / (last_ns - before_ns), last]

    def _confirm(self, target: Target, guess: Guess) -> Guess | None:
        moved = self._subsets.correlate(target, self.seeds(guess), self._probes)
        if np.mean(moved.valid) < self._settings.min_found:
            return None
        homography = self._fit(np.column_stack([moved.x_px, moved.y_px]) - guess.offsets_px[self._probes], self._probes)
        return None if homography is None else Guess(homography, guess.offsets_px)

    def _fit(self, moved_px: Array, chosen: NDArray[np.intp] | slice = slice(None)) -> Array | None:
        """The homography that the largest part of the subsets (raw pixels, NaN where not found) agrees with."""
        moved = self._camera.undistort(moved_px)
        found = np.isfinite(moved).all(axis=1)
        if found.sum() < 8:
            return None
        source = self._ideal[chosen][found]
        homography, _ = cv2.findHomography(source, moved[found], cv2.RANSAC, self._settings.max_residual_px)
        usable = homography is not None and np.isfinite(apply_homography(homography, self._ideal)).all()
        return homography / homography[2, 2] if usable else None

    def _away(self, homography: Array, moved: Correlation) -> Array:
        """How far each subset is from where the homography alone puts it (N, 2) [px]; NaN where not found."""
        expected = self._camera.distort(apply_homography(homography, self._ideal))
        return np.column_stack([moved.x_px, moved.y_px]) - expected

    def _match_features(self, image: NDArray[np.uint8], homography: Array | None) -> Guess | None:
        """A guess from features alone, or, with a known homography, only the offsets from it."""
        source, moved = self._features.match(image)
        if len(source) < 8:
            return None
        ideal = self._camera.undistort(source)
        if homography is None:
            homography, _ = cv2.findHomography(ideal, self._camera.undistort(moved), cv2.RANSAC, 3.0, maxIters=5000)
        if homography is None or not np.isfinite(apply_homography(homography, self._ideal)).all():
            return None
        away = moved - self._camera.distort(apply_homography(homography, ideal))
        near = cKDTree(source).query(self._centres, k=min(7, len(source)))[1]
        return Guess(homography / homography[2, 2], np.median(away[near], axis=1))


def _spread(centres_px: Array, count: int) -> NDArray[np.intp]:
    """Indices of about `count` subsets spread evenly over the grid."""
    low, extent = centres_px.min(axis=0), np.maximum(np.ptp(centres_px, axis=0), 1)
    columns = max(round(float(np.sqrt(count * extent[0] / extent[1]))), 1)
    cells = np.array([columns, max(round(count / columns), 1)])
    cell = np.minimum(((centres_px - low) / extent * cells).astype(int), cells - 1)
    middle = np.sum(np.square((centres_px - low) / extent * cells - cell - 0.5), axis=1)
    number = cell[:, 0] + columns * cell[:, 1]
    order = np.lexsort([middle, number])
    _, first = np.unique(number[order], return_index=True)
    return np.sort(order[first])
