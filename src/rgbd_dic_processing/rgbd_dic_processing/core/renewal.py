"""When the subsets should be carried to a newer keyframe: while the old one is still good, but less and less so."""

from __future__ import annotations

from collections import deque

import numpy as np

from .keyframe import Found, stretch
from .settings import RenewalSettings


class RenewalNeed:
    """Judges how well the images fit one keyframe.

    Subsets that go missing ask for nothing: what hides them goes away again, and in a new keyframe they would be lost.
    """

    def __init__(self, settings: RenewalSettings):
        self._settings = settings
        self._best_zncc = -1.0
        self._asking: deque[float] = deque(maxlen=settings.after_frames)

    def postpone(self) -> None:
        """The image that was chosen cannot be a keyframe: count anew."""
        self._asking.clear()

    def judge(self, found: Found) -> bool:
        """Whether this image should become the keyframe.

        That is so when enough images in a row have asked for it, and this one is not among the poorer half of them.
        """
        valid = found.correlation.valid
        if not self._settings.after_frames or not valid.any():
            return False
        zncc = float(np.median(found.correlation.zncc[valid]))
        self._best_zncc = max(self._best_zncc, zncc)
        fading = zncc < self._best_zncc - self._settings.zncc_drop
        stretched = stretch(found.jacobian[valid].mean(axis=0)) > self._settings.max_stretch
        if not (fading or stretched):
            self._asking.clear()
            return False
        self._asking.append(zncc)
        return len(self._asking) == self._asking.maxlen and zncc >= np.median(self._asking)
