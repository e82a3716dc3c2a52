"""Which ToF frame belongs to an image: the nearest in time, no interpolation (thesis 4.3.1)."""

from __future__ import annotations

import bisect
import math
from collections import deque
from dataclasses import dataclass

from .settings import PairingSettings
from .status import FrameStatus


@dataclass(frozen=True)
class FramePair:
    """One image and its ToF frame: its stamp less the known delay, or None if no frame was near enough."""

    stamp_ns: int
    depth_stamp_ns: int | None

    @property
    def status(self) -> FrameStatus:
        return FrameStatus.NO_DEPTH_FRAME if self.depth_stamp_ns is None else FrameStatus.OK

    @property
    def depth_offset_s(self) -> float:
        """Image stamp minus ToF stamp [s]; NaN without a ToF frame."""
        return math.nan if self.depth_stamp_ns is None else (self.stamp_ns - self.depth_stamp_ns) * 1e-9


class FramePairing:
    """Pairs stamps as they come. The decision depends on the stamps alone, as long as the ToF frames of a moment come
    before the images of `max_offset_s + settle_s` later.

    An image is settled as soon as a ToF frame at or after it is known (then its nearest neighbour is), or once
    later images show that the ToF frame is missing. The earlier of two equally near frames wins.
    """

    def __init__(self, settings: PairingSettings):
        self._settings = settings
        self._images: deque[int] = deque()
        self._depths: list[int] = []
        self._newest_image = -1

    def add_image(self, stamp_ns: int) -> list[FramePair]:
        """An image came; returns the pairs that are settled now, in the order of the images.

        An image that is not later than the one before it is never paired (the DIC refuses it too).
        """
        if stamp_ns <= self._newest_image:
            return []
        self._images.append(stamp_ns)
        self._newest_image = stamp_ns
        return self._settle()

    def add_depth(self, stamp_ns: int) -> list[FramePair]:
        """A ToF frame came, with its stamp as it is; returns the pairs that are settled now."""
        stamp_ns -= self._settings.tof_delay_ns
        if stamp_ns not in self._depths:
            bisect.insort(self._depths, stamp_ns)
        return self._settle()

    def flush(self) -> list[FramePair]:
        """No more is coming: settle everything with what is there."""
        pairs = [self._nearest(stamp) for stamp in self._images]
        self._images.clear()
        return pairs

    def _settle(self) -> list[FramePair]:
        pairs = []
        patience_ns = (self._settings.max_offset_s + self._settings.settle_s) * 1e9
        while self._images:
            stamp = self._images[0]
            known = bool(self._depths) and self._depths[-1] >= stamp
            if not known and self._newest_image - stamp <= patience_ns:
                break
            pairs.append(self._nearest(self._images.popleft()))
        oldest_needed = (self._images[0] if self._images else self._newest_image) - patience_ns
        while len(self._depths) > 1 and self._depths[0] < oldest_needed:
            self._depths.pop(0)
        return pairs

    def _nearest(self, stamp_ns: int) -> FramePair:
        limit_ns = self._settings.max_offset_s * 1e9
        index = bisect.bisect_left(self._depths, stamp_ns)
        near = [d for d in self._depths[max(index - 1, 0) : index + 1] if abs(d - stamp_ns) <= limit_ns]
        return FramePair(stamp_ns, min(near, key=lambda depth: abs(depth - stamp_ns), default=None))
