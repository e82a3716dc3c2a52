"""What the stated uncertainty of one opening is made of."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .crack import CrackOpening
from .displacement_field import DisplacementField
from .error_sources import ErrorSource

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OpeningBudget:
    """One valid opening of one method.

    parts_m2: (sources,), parts of the variance by `ErrorSource`; u_opening_m squared is their sum.
    residual_px: RMS reprojection error of the fixed region's subsets that agree with the motion.
    """

    stamp_ns: int
    method: str
    u_opening_m: float
    parts_m2: Array
    residual_px: float

    @classmethod
    def of(cls, field: DisplacementField, opening: CrackOpening, parts_m2: Array) -> OpeningBudget:
        return cls(field.stamp_ns, field.method, opening.u_opening_m, parts_m2, field.residual_px)


def root_of_part(part: float) -> float:
    """The square root of a part of a variance, with the sign of the part."""
    return math.copysign(math.sqrt(abs(part)), part)


def mean_parts(budgets: Sequence[OpeningBudget]) -> Array:
    """(sources,), mean over openings [m^2]; NaN if there are none."""
    if not budgets:
        return np.full(len(ErrorSource), np.nan)
    return np.mean([budget.parts_m2 for budget in budgets], axis=0)
