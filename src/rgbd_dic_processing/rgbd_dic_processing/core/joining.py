"""Brings together what belongs to one image: its subset field, its reference, its frame pair, and the plane of its ToF
frame."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from .pairing import FramePair
from .plane import PlaneEstimate
from .stamps import Place, Stretches
from .status import FrameStatus
from .subset_field import SubsetField

NEAR_NS = 1_000_000_000  # a plane that is older than its image by so much belongs to none


@dataclass(frozen=True)
class JoinedFrame:
    """One image with all that was found out about it; `pair` or `plane` is None if it never came."""

    field: SubsetField
    pair: FramePair | None
    plane: PlaneEstimate | None


class FrameJoin:
    """Frames leave in the order of their images, each when it is complete, whatever the order of arrival.

    A frame whose image could not be measured waits for nothing, but for those before it.

    A frame that is still incomplete when more than `max_waiting` wait behind it leaves as it is. What came before a
    jump back of the clocks is never taken for what has the same stamp after it.
    """

    def __init__(self, max_waiting: int):
        self._max_waiting = max_waiting
        self._references: set[int] = set()
        self._of_fields, self._of_pairs, self._of_planes = Stretches(), Stretches(), Stretches()
        self._fields: deque[tuple[Place, SubsetField]] = deque()
        self._pairs: dict[Place, FramePair] = {}
        self._planes: dict[Place, PlaneEstimate] = {}

    def add_reference(self, stamp_ns: int) -> list[JoinedFrame]:
        """The reference itself is known: its fields may leave."""
        self._references.add(stamp_ns)
        return self._leave()

    def add_field(self, field: SubsetField) -> list[JoinedFrame]:
        self._fields.append((self._of_fields.place(field.stamp_ns), field))
        return self._leave()

    def add_pair(self, pair: FramePair) -> list[JoinedFrame]:
        self._pairs[self._of_pairs.place(pair.stamp_ns)] = pair
        return self._leave()

    def add_plane(self, plane: PlaneEstimate) -> list[JoinedFrame]:
        self._planes[self._of_planes.place(plane.stamp_ns)] = plane
        return self._leave()

    def flush(self) -> list[JoinedFrame]:
        """No more is coming: all frames leave."""
        return self._leave(keep=0)

    def _leave(self, keep: int | None = None) -> list[JoinedFrame]:
        keep = self._max_waiting if keep is None else keep
        frames = []
        while self._fields:
            place, field = self._fields[0]
            if field.status != FrameStatus.OK:
                frames.append(JoinedFrame(field, None, None))
                self._fields.popleft()
                continue
            pair = self._pairs.get(place)
            depth = None if pair is None or pair.depth_stamp_ns is None else (place[0], pair.depth_stamp_ns)
            plane = self._planes.get(depth)
            paired = pair is not None and (depth is None or plane is not None)
            complete = paired and field.reference_stamp_ns in self._references
            if not complete and len(self._fields) <= keep:
                break
            frames.append(JoinedFrame(field, pair, plane))
            self._fields.popleft()
            self._forget_before(place, depth)
        return frames

    def _forget_before(self, place: Place, depth: Place | None) -> None:
        self._pairs = {key: value for key, value in self._pairs.items() if key > place}
        if depth is not None:
            self._planes = {key: value for key, value in self._planes.items() if key >= depth}
        stretch, waiting_ns = self._fields[0][0] if self._fields else place
        while len(self._planes) > self._max_waiting and next(iter(self._planes)) < (stretch, waiting_ns - NEAR_NS):
            self._planes.pop(next(iter(self._planes)))
