"""Nearest neighbours in time, whatever the order of arrival between the two streams."""

from __future__ import annotations

import itertools

import numpy as np
from rgbd_dic_processing.core.joining import FrameJoin
from rgbd_dic_processing.core.pairing import FramePair, FramePairing
from rgbd_dic_processing.core.plane import PlaneEstimate
from rgbd_dic_processing.core.settings import PairingSettings
from rgbd_dic_processing.core.status import FrameStatus

MS = 1_000_000
IMAGES = [round(i * 1000 / 60) * MS for i in range(60)]
DEPTHS = [round(7 + i * 50.01) * MS for i in range(20)]


def nearest(stamp: int, depths: list[int], limit_ns: int) -> int | None:
    best = min(depths, key=lambda depth: (abs(depth - stamp), depth), default=None)
    return best if best is not None and abs(best - stamp) <= limit_ns else None


def pair_all(events: list[tuple[str, int]]) -> list[FramePair]:
    pairing = FramePairing(PairingSettings())
    pairs = []
    for kind, stamp in events:
        pairs += pairing.add_image(stamp) if kind == "image" else pairing.add_depth(stamp)
    return pairs + pairing.flush()


def merged(images: list[int], depths: list[int], delay_ns: int) -> list[tuple[str, int]]:
    """Both streams in the order of arrival, the ToF frames late by delay_ns."""
    arrivals = [(stamp, "image", stamp) for stamp in images]
    arrivals += [(stamp + delay_ns, "depth", stamp) for stamp in depths]
    return [(kind, stamp) for _, kind, stamp in sorted(arrivals)]


def test_nearest_neighbour_for_any_delay_of_the_tof() -> None:
    expected = [FramePair(stamp, nearest(stamp, DEPTHS, 30 * MS)) for stamp in IMAGES]
    for delay in (-20, 0, 15, 60, 90):
        assert pair_all(merged(IMAGES, DEPTHS, delay * MS)) == expected


def test_a_known_delay_is_taken_off_the_stamps_of_the_tof() -> None:
    pairing = FramePairing(PairingSettings(tof_delay_s=0.04))
    pairs = [pair for image in IMAGES for pair in pairing.add_image(image)]
    pairs += [pair for depth in DEPTHS for pair in pairing.add_depth(depth + 40 * MS)] + pairing.flush()
    settled_without = {image for image in IMAGES if image + 130 * MS < IMAGES[-1]}  # before any ToF frame came
    assert pairs == [
        FramePair(stamp, None if stamp in settled_without else nearest(stamp, DEPTHS, 30 * MS)) for stamp in IMAGES
    ]


def test_no_pair_is_better_than_a_wrong_one() -> None:
    """A gap of 250 ms: images farther than 30 ms from a ToF frame have none, and do not wait for ever."""
    depths = [depth for depth in DEPTHS if not 300 * MS < depth < 540 * MS]
    pairs = pair_all(merged(IMAGES, depths, 0))
    assert pairs == [FramePair(stamp, nearest(stamp, depths, 30 * MS)) for stamp in IMAGES]
    lonely = [pair for pair in pairs if pair.depth_stamp_ns is None]
    assert lonely and all(pair.status == FrameStatus.NO_DEPTH_FRAME for pair in lonely)
    assert all(np.isnan(pair.depth_offset_s) for pair in lonely)


def test_settles_without_the_tof() -> None:
    pairing = FramePairing(PairingSettings(max_offset_s=0.03, settle_s=0.1))
    settled = [pairing.add_image(stamp) for stamp in IMAGES]
    waits = [i for i, pairs in enumerate(settled) if pairs]
    assert waits[0] == 8  # the first image more than 130 ms after image 0


def test_duplicate_and_late_images_are_ignored() -> None:
    pairing = FramePairing(PairingSettings())
    pairing.add_depth(10 * MS)
    assert len(pairing.add_image(5 * MS)) == 1
    assert pairing.add_image(5 * MS) == [] and pairing.add_image(4 * MS) == []
    assert pairing.flush() == []


def test_equally_near_takes_the_earlier() -> None:
    assert pair_all([("depth", 0), ("image", 10 * MS), ("depth", 20 * MS)])[0].depth_stamp_ns == 0


class Field:
    """As much of a subset field as joining looks at."""

    def __init__(self, stamp: int, status: FrameStatus = FrameStatus.OK):
        self.stamp_ns, self.reference_stamp_ns, self.status = stamp, 7, status


def test_join_gives_the_same_frames_for_any_order_of_arrival() -> None:
    depth = PlaneEstimate(2, FrameStatus.NO_PLANE, "none")
    events = [
        ("add_reference", 7),
        ("add_field", Field(1)),
        ("add_pair", FramePair(1, 2)),
        ("add_plane", depth),
    ]
    for order in itertools.permutations(events):
        join = FrameJoin(10)
        left = [frame for name, event in order for frame in getattr(join, name)(event)]
        assert [(f.field.stamp_ns, f.pair, f.plane) for f in left] == [(1, FramePair(1, 2), depth)]
        assert join.flush() == []


def test_join_gives_up_what_never_completes() -> None:
    join = FrameJoin(3)
    join.add_reference(7)
    left = [frame for stamp in range(1, 6) for frame in join.add_field(Field(stamp))]
    assert [frame.field.stamp_ns for frame in left] == [1, 2]
    assert all(frame.pair is None and frame.plane is None for frame in left)
    assert [frame.field.stamp_ns for frame in join.flush()] == [3, 4, 5]


def test_join_lets_what_cannot_be_measured_leave_at_once() -> None:
    """In its turn, but without a pair: a bad image, or one whose stamp comes twice, may never get one."""
    join = FrameJoin(10)
    join.add_reference(7)
    assert [f.field.stamp_ns for f in join.add_field(Field(1, FrameStatus.LOST))] == [1]
    assert join.add_field(Field(2)) == []
    assert join.add_field(Field(3, FrameStatus.BAD_IMAGE)) == []
    left = join.add_pair(FramePair(2, None))
    assert [(f.field.stamp_ns, f.pair is None) for f in left] == [(2, False), (3, True)]
