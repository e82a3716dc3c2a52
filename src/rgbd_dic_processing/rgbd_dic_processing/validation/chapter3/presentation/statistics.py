"""What the tables and the figures say about the numbers of a run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from ..chapter import Chapter3
from ..measuring import METHODS

Array = NDArray[np.float64]
CONFIDENCE = 0.95
THESIS_METHODS = ("h_3d", "h_2d", "pc_3d")
ORDER = (*THESIS_METHODS, "h_pose")
assert set(ORDER) == set(METHODS)


@dataclass(frozen=True)
class Slope:
    """Of a straight line through values, with half the width of its 95 % interval."""

    value: float
    half_width: float

    @property
    def is_zero(self) -> bool:
        """Whether zero lies in the interval."""
        return abs(self.value) <= self.half_width

    @classmethod
    def of(cls, x: Array, y: Array) -> Slope:
        fit = stats.linregress(x, y)
        freedom = len(x) - 2
        width = stats.t.ppf((1 + CONFIDENCE) / 2, freedom) * fit.stderr if freedom > 0 else np.inf
        return cls(float(fit.slope), float(width))


def trend(data: Chapter3, pattern: str, variant: str, method: str, series: str, size: bool = False) -> Slope:
    """Of the averages, over all references, against the angle of a series [mm/degree]; `size`: against its size.

    The mean over the references leaves one value an image: what is noise of an image is in it once.
    """
    shots = data.series(series)
    errors = data.errors(pattern, variant, method, shots=tuple(shot.number for shot in shots)).mean(axis=0)
    angles = np.array([shot.angle_deg for shot in shots])
    return Slope.of(np.abs(angles) if size else angles, errors)


def trends_of_references(data: Chapter3, pattern: str, variant: str, method: str, series: str) -> list[Slope]:
    """The same for each reference."""
    shots = data.series(series)
    errors = data.errors(pattern, variant, method, shots=tuple(shot.number for shot in shots))
    return [Slope.of(np.array([shot.angle_deg for shot in shots]), row) for row in errors]


def crack_slopes(data: Chapter3, pattern: str, variant: str, method: str) -> Array:
    """Slope of the error against the crack [1] for each reference and each of the two sets."""
    slopes = []
    for series in ("crack A", "crack B"):
        shots = data.series(series)
        if len(shots) < 2:
            continue
        errors = data.errors(pattern, variant, method, shots=tuple(shot.number for shot in shots))
        slopes += [np.polyfit([shot.crack_mm for shot in shots], row, 1)[0] for row in errors]
    return np.array(slopes)


def coverage(data: Chapter3, noise: float) -> float:
    """Share of the subsets' coordinates whose truth lies within two standard uncertainties."""
    results = data.noisy[noise].values()
    return sum(result["within"] for result in results) / sum(result["of"] for result in results)


def opening_ratios(data: Chapter3, noise: float, method: str) -> Array:
    """Error of each opening over its standard uncertainty."""
    return np.concatenate([result["openings"][method] for result in data.noisy[noise].values()])
