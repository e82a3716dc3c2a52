"""Where the panel will be seen next, from how it was seen in the last frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Prediction:
    """The homographies of the last three frames, extrapolated by the parabola in time through them.

    Second order, because a hand sways smoothly: swaying by 2 cm and 20 mrad RMS at 0.3 to 3 Hz, seen from 1.5 m at 60
    Hz with a focal length of 2400 px, the panel moves by 5.9 px a frame (median). The parabola misses its corners by
    0.22 px, a straight line by 0.91 px; with 40 % of the frames dropped by 0.60 and 1.7 px. A cubic is better in the
    median (0.20 and 0.39 px), but not at its worst. Extrapolating corners instead of homographies changes nothing.
    """

    FRAMES = 3
    MAX_SPANS = 4.0  # a gap longer than this many times what the frames span is not extrapolated over

    def __init__(self) -> None:
        self._stamps_ns: list[int] = []
        self._views: list[Array] = []

    @property
    def last(self) -> Array:
        """The homography (3, 3) last seen, reference -> image; that of the reference itself if there is none yet."""
        return self._views[-1] if self._views else np.eye(3)

    def add(self, stamp_ns: int, homography: Array) -> None:
        """The homography of a frame; [2, 2] = 1. A stamp that is not later than the last begins anew."""
        if self._stamps_ns and stamp_ns <= self._stamps_ns[-1]:
            self._stamps_ns, self._views = [], []
        self._stamps_ns = [*self._stamps_ns[1 - self.FRAMES :], stamp_ns]
        self._views = [*self._views[1 - self.FRAMES :], homography]

    def at(self, stamp_ns: int) -> Array:
        """The homography (3, 3) expected at a time: Lagrange's polynomial, for stamps as irregular as they are."""
        stamps = self._stamps_ns
        if len(stamps) < 2 or not 0 < stamp_ns - stamps[-1] <= self.MAX_SPANS * (stamps[-1] - stamps[0]):
            return self.last
        weights = [
            np.prod([(stamp_ns - other) / (stamp - other) for other in stamps if other != stamp]) for stamp in stamps
        ]
        return np.tensordot(weights, self._views, axes=1)
