"""Brings together what belongs to one image: its subset field, its reference, its frame pair, and the plane of its ToF
frame."""

from __future__ import annotations

from dataclasses import dataclass

from .pairing import FramePair
from .plane import PlaneEstimate
from .status import FrameStatus
from .subset_field import SubsetField


@dataclass(frozen=True)
class JoinedFrame:
    """One image with all that was found out about it; `pair` or `plane` is None if it never came."""

    field: SubsetField
    pair: FramePair | None
    plane: PlaneEstimate | None


class FrameJoin:
    """Frames leave in the order of their images, each when it is complete, whatever the order of arrival.

    A frame whose image could not be measured waits for nothing, but for those before it.

    A frame that is still incomplete when more than `max_waiting` wait behind it leaves as it is.
    """

    def __init__(self, max_waiting: int):
        self._max_waiting = max_waiting
        self._references: set[int] = set()
        self._fields: dict[int, SubsetField] = {}
        self._pairs: dict[int, FramePair] = {}
        self._planes: dict[int, PlaneEstimate] = {}

    def add_reference(self, stamp_ns: int) -> list[JoinedFrame]:
        """The reference itself is known: its fields may leave."""
        self._references.add(stamp_ns)
        return self._leave()

    def add_field(self, field: SubsetField) -> list[JoinedFrame]:
        self._fields[field.stamp_ns] = field
        return self._leave()

    def add_pair(self, pair: FramePair) -> list[JoinedFrame]:
        self._pairs[pair.stamp_ns] = pair
        return self._leave()

    def add_plane(self, plane: PlaneEstimate) -> list[JoinedFrame]:
        self._planes[plane.stamp_ns] = plane
        return self._leave()

    def flush(self) -> list[JoinedFrame]:
        """No more is coming: all frames leave."""
        return self._leave(keep=0)

    def _leave(self, keep: int | None = None) -> list[JoinedFrame]:
        keep = self._max_waiting if keep is None else keep
        frames = []
        while self._fields:
            stamp = next(iter(self._fields))
            if self._fields[stamp].status != FrameStatus.OK:
                frames.append(JoinedFrame(self._fields.pop(stamp), None, None))
                continue
            pair = self._pairs.get(stamp)
            plane = self._planes.get(pair.depth_stamp_ns) if pair and pair.depth_stamp_ns is not None else None
            paired = pair is not None and (pair.depth_stamp_ns is None or plane is not None)
            complete = paired and self._fields[stamp].reference_stamp_ns in self._references
            if not complete and len(self._fields) <= keep:
                break
            frames.append(JoinedFrame(self._fields.pop(stamp), pair, plane))
            self._forget_before(stamp, pair)
        return frames

    def _forget_before(self, stamp_ns: int, pair: FramePair | None) -> None:
        self._pairs = {key: value for key, value in self._pairs.items() if key > stamp_ns}
        if pair and pair.depth_stamp_ns is not None:
            self._planes = {key: value for key, value in self._planes.items() if key >= pair.depth_stamp_ns}
        while len(self._planes) > self._max_waiting:
            self._planes.pop(next(iter(self._planes)))
