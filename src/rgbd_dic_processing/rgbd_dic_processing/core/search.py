"""The initial guess of each frame: predicted from the frames before, or recovered from the image itself."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera

from .coarse import CoarseSearch
from .correlation import Correlation, ReferenceSubsets, SubsetStatus, Target
from .features import FeatureMatcher
from .geometry import apply_homography
from .prediction import Prediction
from .seed_maps import SeedMaps
from .settings import SearchSettings
from .subset_grid import SubsetGrid

Array = NDArray[np.float64]

NEWS_PX = 0.5  # an expected position nearer than this to one that was tried tells nothing new
LEAST_AGREEING = 8  # points that a homography must rest on
FITTED = 300  # subsets, spread over the panel, that a frame's homography is fitted to


class SeedSource(IntEnum):
    """Where a frame's initial guess came from. Values as in rgbd_dic_msgs/SubsetField."""

    REFERENCE = 0
    PREDICTION = 1
    FEATURES = 2
    NONE = 3
    COARSE = 4


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

    Guesses come in the order of their cost: the prediction, the coarse image, features. One is taken only if the DIC
    itself, run on a few spread subsets (probes), finds enough of them there, in agreement. The probes also refine its
    homography, so that the full run starts a few hundredths of a pixel away.
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
        self._fitted = usable[_spread(self._centres[usable], FITTED)]
        self._image, self._usable = image, usable
        self._prediction = Prediction()
        self._offsets = np.zeros_like(self._centres)

    # What is not needed while the panel is followed is made when it is first asked for.

    @cached_property
    def _inside(self) -> NDArray[np.bool_]:
        """Which subsets are centred in the reference; one that left it is never found."""
        last = self._camera.width - 1, self._camera.height - 1
        return ((self._centres >= 0) & (self._centres <= last)).all(axis=1)

    @cached_property
    def _grid(self) -> SubsetGrid:
        centres = np.where(self._inside[:, None], self._centres, np.nan)
        return SubsetGrid(centres, self._subsets.settings.step)

    @cached_property
    def _coarse(self) -> CoarseSearch:
        return CoarseSearch(self._image, self._centres[self._usable], self._subsets.settings.subset_size)

    @cached_property
    def _features(self) -> FeatureMatcher:
        return FeatureMatcher(self._image, self._centres[self._usable], self._settings.features)

    def start(self, stamp_ns: int) -> None:
        """Begin with the reference itself, in which nothing has moved."""
        self._prediction.add(stamp_ns, np.eye(3))

    def find(self, stamp_ns: int, image: NDArray[np.uint8], target: Target) -> tuple[Guess | None, SeedSource]:
        """The guess for an image and where it came from; None if the panel was not found."""
        for homography, source in self._candidates(stamp_ns, image):
            guess = None if homography is None else self._confirm(target, homography)
            if guess is not None:
                return guess, source
        return None, SeedSource.NONE

    def moved_px(self) -> float:
        """How far the panel's subsets were, at most, from their places in the reference when they were last found."""
        return float(np.nanmax(np.abs(apply_homography(self._prediction.last, self._ideal) - self._ideal)))

    def seeds(self, guess: Guess, chosen: NDArray[np.intp] | slice = slice(None)) -> Array:
        """The seed maps (N, 2, 6) of a guess; only those of the chosen subsets are filled in."""
        maps = self._maps.seeds(guess.homography, chosen, guess.offsets_px)
        if isinstance(chosen, slice):
            return maps
        seeds = np.zeros((len(self._centres), 2, 6))
        seeds[chosen] = maps
        return seeds

    def complete(self, image: NDArray[np.uint8], target: Target, guess: Guess, moved: Correlation) -> Correlation:
        """Try the subsets that were not found again: from their found neighbours, then from the coarse image."""
        if moved.valid.all():
            return moved
        tried = guess.offsets_px.copy()
        moved = self._from_neighbours(target, guess, moved, tried)
        missing = np.flatnonzero(self._worth_trying(moved) & (moved.status != SubsetStatus.OUTSIDE_IMAGE))
        if len(missing) > self._settings.max_missing * len(self._centres):
            some = missing[np.linspace(0, len(missing) - 1, min(self._settings.probes, len(missing))).astype(int)]
            before, now, found = self._coarse.moved_apart(image, guess.homography, self._centres[some], tried[some])
            away = now - self._expected(guess.homography, self._camera.undistort(before))
            news = np.abs(away - tried[some[found]]).max(axis=1) > NEWS_PX
            if news.any():
                moved = self._try(target, guess, moved, tried, some[found[news]], away[news])
                moved = self._from_neighbours(target, guess, moved, tried)
        return moved

    def remember(self, stamp_ns: int, guess: Guess, moved: Correlation) -> None:
        """Keep what was found, for the next prediction.

        The homography is fitted to what moved since the last frame, not to the panel anew: of two sides of a wide crack
        a new fit would follow now one, now the other, and the prediction would take the change for motion.
        """
        some = self._fitted
        homography, _ = self._fit(self._ideal[some], _positions(moved)[some] - self._offsets[some])
        homography = guess.homography if homography is None else homography
        self._prediction.add(stamp_ns, homography)
        offsets = self._away(homography, moved)
        if moved.valid.all():
            self._offsets = offsets
        elif moved.valid.any():
            self._offsets = offsets[self._grid.nearest(moved.valid)]

    def _candidates(self, stamp_ns: int, image: NDArray[np.uint8]) -> Iterator[tuple[Array | None, SeedSource]]:
        """Homographies to be tried, made as they are asked for; None where nothing was recovered."""
        predicted, last = self._prediction.at(stamp_ns), self._prediction.last
        yield predicted, SeedSource.PREDICTION
        for view in (predicted,) if np.array_equal(predicted, last) else (predicted, last):
            yield self._matched(*self._coarse.jumped(image, view, self._centres[self._probes])), SeedSource.COARSE
        yield self._matched(*self._features.match(image)), SeedSource.FEATURES

    def _confirm(self, target: Target, homography: Array) -> Guess | None:
        """The guess of a homography, refined, if enough probes agree. Those that do may bring others within reach."""
        probes, refined, agreeing = self._probes, None, 0
        positions, tried = np.full((2, len(probes), 2), np.nan)
        rest = np.arange(len(probes))
        while len(rest):
            tried[rest] = self._expected(homography, self._ideal[probes[rest]])
            seeds = self.seeds(Guess(homography, self._offsets), probes[rest])
            positions[rest] = _positions(self._subsets.correlate(target, seeds, probes[rest]))
            homography, count = self._fit(self._ideal[probes], positions - self._offsets[probes])
            if homography is None or count <= agreeing:
                break
            refined, agreeing = homography, count
            news = np.abs(self._expected(refined, self._ideal[probes]) - tried).max(axis=1) > NEWS_PX
            rest = np.flatnonzero(news & np.isnan(positions[:, 0]))
        enough = agreeing >= self._settings.min_found * len(probes)
        return Guess(refined, self._offsets) if enough else None

    def _matched(self, source_px: Array, moved_px: Array) -> Array | None:
        """The homography of points (M, 2) found in the reference and in the image, raw pixels."""
        if len(source_px) < LEAST_AGREEING:
            return None
        nearest = self._grid.nearest(self._inside, source_px)
        return self._fit(self._camera.undistort(source_px), moved_px - self._offsets[nearest])[0]

    def _fit(self, ideal_px: Array, moved_px: Array) -> tuple[Array | None, int]:
        """The homography that the largest part of points (M, 2) agrees with, ideal -> raw pixels, and that part's size.

        Points that are NaN are left out. None if it rests on too few, or does not hold for all subsets.
        """
        moved = self._camera.undistort(moved_px)
        found = np.isfinite(moved + ideal_px).all(axis=1)
        if found.sum() < LEAST_AGREEING:
            return None, 0
        homography, inliers = cv2.findHomography(
            ideal_px[found], moved[found], cv2.USAC_MAGSAC, self._settings.max_residual_px, maxIters=2000
        )
        if homography is None or inliers.sum() < LEAST_AGREEING:
            return None, 0
        homography = homography / homography[2, 2]
        holds = np.isfinite(apply_homography(homography, self._ideal[self._fitted])).all()
        return (homography, int(inliers.sum())) if holds else (None, 0)

    def _from_neighbours(self, target: Target, guess: Guess, moved: Correlation, tried: Array) -> Correlation:
        """Each subset not found, from the median of where its found neighbours are; until that finds no more.

        So a part that moved unlike the rest is filled in from its border. A subset whose neighbours tell nothing new is
        left alone. `tried` (N, 2), the offsets tried so far, is kept up to date.
        """
        for _ in range(self._settings.rounds):
            chosen = np.flatnonzero(self._worth_trying(moved))
            expected = self._grid.median_around(self._away(guess.homography, moved), chosen)
            news = np.abs(expected - tried[chosen]).max(axis=1) > NEWS_PX
            before = np.sum(moved.valid)
            moved = self._try(target, guess, moved, tried, chosen[news], expected[news])
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
        seeds = self.seeds(Guess(guess.homography, tried), chosen)
        again = self._subsets.correlate(target, seeds, chosen)
        return moved.replaced(chosen[again.valid], again.rows(again.valid))

    @staticmethod
    def _worth_trying(moved: Correlation) -> NDArray[np.bool_]:
        """Which subsets were not found, though they have texture."""
        return ~moved.valid & ~np.isin(moved.status, (SubsetStatus.LOW_TEXTURE, SubsetStatus.SKIPPED))

    def _away(self, homography: Array, moved: Correlation) -> Array:
        """How far each subset is from where the homography alone puts it (N, 2) [px]; NaN where not found."""
        return _positions(moved) - self._expected(homography, self._ideal)

    def _expected(self, homography: Array, ideal_px: Array) -> Array:
        """Raw pixels (M, 2) where a homography alone puts points of the reference."""
        return self._camera.distort(apply_homography(homography, ideal_px))


def _positions(moved: Correlation) -> Array:
    return np.column_stack([moved.x_px, moved.y_px])


def _spread(centres_px: Array, count: int) -> NDArray[np.intp]:
    """Indices of about `count` subsets spread evenly over the grid: the one nearest to the middle of each cell."""
    x, y = (values - values.min() for values in centres_px.T.copy())
    width, height = max(x.max(), 1), max(y.max(), 1)
    columns = max(round(float(np.sqrt(count * width / height))), 1)
    rows = max(round(count / columns), 1)
    x, y = x / width * columns, y / height * rows
    column, row = np.minimum(x.astype(int), columns - 1), np.minimum(y.astype(int), rows - 1)
    middle = (x - column - 0.5) ** 2 + (y - row - 0.5) ** 2
    number = column + columns * row
    least = np.full(columns * rows, np.inf)
    np.minimum.at(least, number, middle)
    nearest = np.flatnonzero(middle == least[number])
    _, first = np.unique(number[nearest], return_index=True)
    return np.sort(nearest[first])
