"""M-estimator sample consensus (Torr and Zisserman 2000): RANSAC that scores residuals up to the threshold."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from rgbd_dic_acquisition.errors import MeasurementError

Model = TypeVar("Model")
Indices = NDArray[np.intp]


def msac(
    count: int,
    sample_size: int,
    fit: Callable[[Indices], Model | None],
    residuals: Callable[[Model], NDArray[np.float64]],
    threshold: float,
    max_trials: int,
    confidence: float = 0.999,
) -> tuple[Model, NDArray[np.bool_]]:
    """The model with the least truncated sum of squared residuals, refitted to its inliers until these stay the same.

    Args:
        count: number of data.
        sample_size: data of a minimal sample.
        fit: makes a model from the data of these indices (any number >= sample_size), or None if degenerate.
        residuals: distances (count,) of all data from a model; NaN counts as an outlier.
        threshold: largest residual of an inlier.
        max_trials: most samples drawn.
        confidence: chance of one sample without outliers at which drawing ends.

    Returns:
        The model and the mask (count,) of its inliers. The seed is fixed: the same data give the same model.

    Raises:
        MeasurementError: if no sample gives a model with enough inliers.
    """
    if count < sample_size:
        raise MeasurementError(f"{count} points are too few for a sample of {sample_size}")
    random = np.random.default_rng(0)
    best, best_cost, best_inliers, needed, trial = None, math.inf, None, max_trials, 0
    while trial < min(needed, max_trials):
        trial += 1
        model = fit(random.choice(count, sample_size, replace=False))
        if model is None:
            continue
        squared = np.square(np.nan_to_num(residuals(model), nan=np.inf))
        cost = float(np.minimum(squared, threshold**2).sum())
        if cost < best_cost:
            best, best_cost, best_inliers = model, cost, squared <= threshold**2
            needed = _trials(best_inliers.mean(), sample_size, confidence)
    if best is None or best_inliers.sum() < sample_size:
        raise MeasurementError(f"no model fits {sample_size} of {count} points within {threshold:g}")
    for _ in range(10):
        refitted = fit(np.flatnonzero(best_inliers))
        if refitted is None:
            break
        inliers = np.nan_to_num(residuals(refitted), nan=np.inf) <= threshold
        if inliers.sum() < sample_size:
            break
        best, unchanged = refitted, np.array_equal(inliers, best_inliers)
        best_inliers = inliers
        if unchanged:
            break
    return best, best_inliers


def _trials(inlier_share: float, sample_size: int, confidence: float) -> float:
    """Samples after which one without outliers was drawn with this confidence."""
    clean = inlier_share**sample_size
    if clean <= 0:
        return math.inf
    return 1 if clean >= 1 else math.log(1 - confidence) / math.log(1 - clean)
