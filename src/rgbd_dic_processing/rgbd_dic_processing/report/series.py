"""The openings of a run as one history per method, in the units that people read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.crack import CrackOpening
from ..core.status import FrameStatus
from ..results import Truth
from .drawing import method_order

Array = NDArray[np.float64]

STATUS_WORDS = {
    FrameStatus.OK: "valid",
    FrameStatus.BAD_IMAGE: "image not usable",
    FrameStatus.LOST: "pattern not found",
    FrameStatus.NO_DEPTH_FRAME: "no ToF frame in time",
    FrameStatus.BAD_DEPTH: "depth not usable",
    FrameStatus.NO_PLANE: "no plane found",
    FrameStatus.NO_REFERENCE_PLANE: "no reference plane yet",
    FrameStatus.NO_FIXED_REGION: "fixed region not found",
    FrameStatus.NOT_COMPENSATED: "motion not removed",
    FrameStatus.EMPTY_ZONE: "measuring zone empty",
}


@dataclass(frozen=True)
class Series:
    """One method over the n frames of a run, ordered by time; NaN where a frame has no value.

    time_s: since the first frame of the run. opening_mm, u_mm: opening and its standard uncertainty (k = 1).
    truth_mm: true opening since the reference. n_left, n_right: subsets used in each zone. offset_ms: stamp
    of the image less that of its ToF frame. latency_ms: from the arrival of the image to its opening. status:
    FrameStatus.
    """

    method: str
    openings: tuple[CrackOpening, ...]
    time_s: Array
    opening_mm: Array
    u_mm: Array
    truth_mm: Array
    n_left: Array
    n_right: Array
    offset_ms: Array
    latency_ms: Array
    status: NDArray[np.int64]

    @property
    def valid(self) -> NDArray[np.bool_]:
        return self.status == FrameStatus.OK

    @property
    def error_mm(self) -> Array:
        return self.opening_mm - self.truth_mm


def of_run(openings: Sequence[CrackOpening], truth: Truth | None) -> list[Series]:
    """One series for each method that the run has; none if it has no openings."""
    start_ns = min((opening.stamp_ns for opening in openings), default=0)
    return [
        _series(sorted((o for o in openings if o.method == method), key=lambda o: o.stamp_ns), start_ns, truth)
        for method in method_order({opening.method for opening in openings})
    ]


def true_opening_mm(openings: Sequence[CrackOpening], truth: Truth) -> Array:
    """True opening of each frame less that at its reference; NaN for frames that the truth lacks.

    Where the truth lacks the reference too, the first frame that it holds takes its place.
    """
    index = {int(stamp): i for i, stamp in enumerate(truth.stamps_ns)}
    rows = np.array([index.get(opening.stamp_ns, -1) for opening in openings], int)
    if np.all(rows < 0):
        return np.full(len(rows), np.nan)
    first = rows[rows >= 0][0]
    start = np.array([index.get(opening.reference_stamp_ns, first) for opening in openings], int)
    return np.where(rows < 0, np.nan, truth.jump_m[rows, 0] - truth.jump_m[start, 0]) * 1e3


def _series(openings: list[CrackOpening], start_ns: int, truth: Truth | None) -> Series:
    stamps = np.array([opening.stamp_ns for opening in openings], np.int64)
    status = np.array([opening.status for opening in openings], np.int64)

    def column(name: str, scale: float = 1.0) -> Array:
        values = np.array([getattr(opening, name) for opening in openings], float)
        return values * scale

    def of_valid(values: Array) -> Array:
        return np.where(status == FrameStatus.OK, values, np.nan)

    return Series(
        openings[0].method,
        tuple(openings),
        (stamps - start_ns) * 1e-9,
        of_valid(column("opening_m", 1e3)),
        of_valid(column("u_opening_m", 1e3)),
        np.full(len(stamps), np.nan) if truth is None else true_opening_mm(openings, truth),
        of_valid(column("n_left")),
        of_valid(column("n_right")),
        column("depth_offset_s", 1e3),
        column("latency_s", 1e3),
        status,
    )
