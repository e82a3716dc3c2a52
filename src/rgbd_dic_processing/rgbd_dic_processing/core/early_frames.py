"""Frames that are measured before their own ToF frame has come (`plane_lag_s`)."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator

from .joining import JoinedFrame
from .status import FrameStatus
from .subset_field import SubsetField


class EarlyFrames:
    """Tells which frames can be measured, and what has to be learnt from complete ones before.

    Before an image is measured, all frames at least `lag_ns` earlier are learnt from, and no others; but as long as no
    plane is known, those up to the image itself, one after another. So what an image is measured with depends on the
    stamps, never on how soon its ToF frame came.

    If it `never_waits`, an image is measured as soon as a plane is known, also where earlier frames are not complete
    yet, as when what makes the planes is held up; they are learnt from when they are.
    """

    def __init__(self, lag_ns: int, never_waits: bool = False):
        self._lag_ns, self._never_waits = lag_ns, never_waits
        self._count = 0
        self._unmeasured: deque[tuple[int, SubsetField]] = deque()
        self._unlearnt: deque[tuple[int, int]] = deque()  # number and stamp
        self._complete: deque[JoinedFrame] = deque()

    def add(self, field: SubsetField) -> None:
        """The next image's."""
        self._unmeasured.append((self._count, field))
        self._unlearnt.append((self._count, field.stamp_ns))
        self._count += 1

    def complete(self, frames: list[JoinedFrame]) -> None:
        """Frames of which no more will come; each image's, in their order."""
        self._complete.extend(frames)

    def leave(
        self, knows_plane: Callable[[SubsetField], bool], learn: Callable[[JoinedFrame], None]
    ) -> Iterator[JoinedFrame]:
        """Those that can be measured now, in the order of the images, without pair and plane."""
        while self._unmeasured:
            number, field = self._unmeasured[0]
            if not self._learnt(number, field, knows_plane, learn) and field.status == FrameStatus.OK:
                return
            self._unmeasured.popleft()
            yield JoinedFrame(field, None, None)

    def _learnt(
        self,
        number: int,
        field: SubsetField,
        knows_plane: Callable[[SubsetField], bool],
        learn: Callable[[JoinedFrame], None],
    ) -> bool:
        """Learn from what an image is measured with; whether that is all."""
        while self._unlearnt and self._unlearnt[0][0] <= number:
            stamp_ns = self._unlearnt[0][1]
            recent = field.stamp_ns - self._lag_ns < stamp_ns <= field.stamp_ns  # later: of before a jump back
            if recent and knows_plane(field):
                return True
            if not self._complete:
                return self._never_waits and knows_plane(field)
            self._unlearnt.popleft()
            learn(self._complete.popleft())
        return True
