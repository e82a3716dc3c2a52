"""This project's engine on the common test: 88 x 88 subsets of 31 x 31 px every 10 px of an image of 1000 x 1000 px."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.calibration import Camera
from rgbd_dic_processing.core.correlation import Correlation, CorrelationSettings, ReferenceSubsets
from rgbd_dic_processing.core.regions import Regions
from rgbd_dic_processing.core.seed_maps import SeedMaps
from rgbd_dic_processing.core.settings import SearchSettings
from rgbd_dic_processing.core.tracking import SubsetField, SubsetTracking
from speckle import SIZE

from rgbd_dic_processing import _kernel

SUBSET, STEP = 31, 10  # px
REGION = (50, 50, 950, 950)  # px, x0, y0, x1, y1 inclusive: every subset lies wholly inside
SEED_OFF_PX = (0.21, -0.21)  # a seed is 0.3 px off
CAMERA = Camera(SIZE, SIZE, SIZE, SIZE, (SIZE - 1) / 2, (SIZE - 1) / 2)  # without distortion: raw pixels are ideal


def settings(**wanted: Any) -> CorrelationSettings:
    """The defaults, but for what is wanted, on one thread."""
    return CorrelationSettings(**{"threads": 1, "subset_size": SUBSET, "step": STEP, **wanted})


def instruction_sets() -> list[str]:
    """Those that this machine runs, best first."""
    return _kernel.instruction_sets()


def use_instruction_set(name: str | None) -> None:
    """Run the kernel with one of them; None for the best."""
    _kernel.use_instruction_set(name or instruction_sets()[0])


def regions() -> Regions:
    """The region in which subsets are laid."""
    x0, y0, x1, y1 = REGION
    return Regions(np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], float), (), None, None)


def grid() -> NDArray[np.int32]:
    """Centres of the subsets, (7744, 2)."""
    return regions().subset_centres(SIZE, SIZE, SUBSET, STEP)


def seed_maps(centres_px: NDArray, threads: int = 1) -> SeedMaps:
    """What seeds are made of, once for all frames."""
    return SeedMaps(CAMERA, centres_px, reach_px=SUBSET / 2, threads=threads)


def seeds(homography: NDArray, maps: SeedMaps) -> NDArray[np.float64]:
    """Seed maps (N, 2, 6) of a homography that is SEED_OFF_PX off."""
    off = np.eye(3)
    off[:2, 2] = SEED_OFF_PX
    return maps.seeds(off @ homography)


def found(
    reference: NDArray, target: NDArray, homography: NDArray, centres_px: NDArray, correlation: CorrelationSettings
) -> Correlation:
    """The subsets in the target, from seeds that are 0.3 px off."""
    subsets = ReferenceSubsets(reference, centres_px, correlation)
    return subsets.correlate(subsets.target(target), seeds(homography, seed_maps(centres_px)))


def tracked(reference: NDArray, target: NDArray, correlation: CorrelationSettings) -> SubsetField:
    """The subsets in the target as the first frame after the reference, without any guess from outside."""
    tracking = SubsetTracking(CAMERA, regions(), correlation, SearchSettings())
    tracking.track(1, reference)
    return tracking.track(2, target)
