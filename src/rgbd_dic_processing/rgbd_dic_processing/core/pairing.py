"""Which ToF frame belongs to an image: the nearest in time, no interpolation (thesis 4.3.1)."""

from __future__ import annotations

import bisect
import math
from collections import deque
from dataclasses import dataclass, field

from .settings import PairingSettings
from .stamps import Place, Stretches
from .status import FrameStatus

TOO_FAR = "no ToF frame near enough in time"
CLOCK_JUMPED = f"{TOO_FAR}: the clock of a sensor jumped"


@dataclass(frozen=True)
class FramePair:
    """One image and its ToF frame: its stamp less the known delay, or None if no frame was near enough, and why."""

    stamp_ns: int
    depth_stamp_ns: int | None
    reason: str = field(default="", compare=False)

    @property
    def status(self) -> FrameStatus:
        return FrameStatus.NO_DEPTH_FRAME if self.depth_stamp_ns is None else FrameStatus.OK

    @property
    def depth_offset_s(self) -> float:
        """Image stamp minus ToF stamp [s]; NaN without a ToF frame."""
        return math.nan if self.depth_stamp_ns is None else (self.stamp_ns - self.depth_stamp_ns) * 1e-9


class FramePairing:
    """Pairs stamps as they come. The decision depends on the stamps alone, as long as frames of one moment come within
    `max_offset_s + settle_s` of each other.

    An image is settled as soon as a ToF frame at or after it is known (then its nearest neighbour is), or once
    later images show that the ToF frame is missing. The earlier of two equally near frames wins.

    If the clocks of both sensors jump back, pairing goes on after it. If only one does, or the ToF sensor's jumps
    ahead, no stamp tells any more which frames belong together, and none are paired. What looked like a jump ahead was
    none, but images that came late, once one comes that is newer than the newest ToF frame.
    """

    def __init__(self, settings: PairingSettings):
        self._limit_ns = settings.max_offset_s * 1e9
        self._patience_ns = (settings.max_offset_s + settings.settle_s) * 1e9
        self._delay_ns = settings.tof_delay_ns
        self._of_images, self._of_depths = Stretches(), Stretches()
        self._images: deque[Place] = deque()
        self._depths: list[Place] = []
        self._stretch_began_ns = -1  # first image since the camera's clock jumped
        self._silence: tuple[Place, Place] | None = None  # ToF frames before and after the latest long gap
        self._doubtful: tuple[int, float] = (0, -1)  # up to here stamps may be of ToF frames from before a small jump
        self._alone: set[Place] = set()  # waiting images whose stamps are doubtful
        self._ahead = -1  # stretch in which the ToF sensor's clock jumped ahead

    def add_image(self, stamp_ns: int) -> list[FramePair]:
        """An image came; returns the pairs that are settled now, in the order of the images.

        An image that came late or twice is never paired (the DIC refuses it too).
        """
        before = self._of_images.newest
        image = self._of_images.place(stamp_ns)
        if image <= before:
            if image < before:
                self._doubtful = _later(before, 2 * self._limit_ns)
            return []
        if image[0] > before[0]:
            self._stretch_began_ns = stamp_ns
        if self._silence and self._silence[0] < image < _later(self._silence[1], -self._patience_ns):
            self._ahead = self._silence[1][0]  # images go on as if there was no gap: it was the clock
        elif image > self._of_depths.newest:
            self._ahead = -1
        self._images.append(image)
        if image <= self._doubtful:
            self._alone.add(image)
        return self._settle()

    def add_depth(self, stamp_ns: int) -> list[FramePair]:
        """A ToF frame came, with its stamp as it is; returns the pairs that are settled now."""
        before = self._of_depths.newest
        depth = self._of_depths.place(stamp_ns - self._delay_ns)
        if depth[0] == before[0] and depth > _later(before, self._patience_ns):
            self._silence = before, depth
        # a frame that came late casts doubt on the stamps that are later than its own
        self._depths = [*self._depths[: bisect.bisect_left(self._depths, depth)], depth]
        return self._settle()

    def flush(self) -> list[FramePair]:
        """No more is coming: settle everything with what is there."""
        pairs = [self._nearest(image) for image in self._images]
        self._images.clear()
        return pairs

    def _settle(self) -> list[FramePair]:
        pairs = []
        while self._images:
            known = bool(self._depths) and self._depths[-1] >= self._images[0]
            if not known and self._waited_ns(self._images[0]) <= self._patience_ns:
                break
            pairs.append(self._nearest(self._images.popleft()))
        oldest_needed = _later(self._images[0] if self._images else self._of_images.newest, -self._patience_ns)
        while len(self._depths) > 1 and self._depths[0] < oldest_needed:
            self._depths.pop(0)
        return pairs

    def _waited_ns(self, image: Place) -> float:
        stretch, newest_ns = self._of_images.newest
        return newest_ns - (image[1] if image[0] == stretch else self._stretch_began_ns)

    def _nearest(self, image: Place) -> FramePair:
        stretch, stamp_ns = image
        index = bisect.bisect_left(self._depths, image)
        around = self._depths[max(index - 1, 0) : index + 1]
        if stretch == self._ahead or image in self._alone:
            self._alone.discard(image)
            return FramePair(stamp_ns, None, CLOCK_JUMPED)
        near = [depth[1] for depth in around if depth[0] == stretch and abs(depth[1] - stamp_ns) <= self._limit_ns]
        if not near:
            jumped = any(depth[0] != stretch for depth in around)
            return FramePair(stamp_ns, None, CLOCK_JUMPED if jumped else TOO_FAR)
        return FramePair(stamp_ns, min(near, key=lambda depth_ns: abs(depth_ns - stamp_ns)))


def _later(place: Place, by_ns: float) -> tuple[int, float]:
    return place[0], place[1] + by_ns
