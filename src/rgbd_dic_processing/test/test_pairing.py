"""Nearest neighbours in time, whatever the order of arrival between the two streams."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from rgbd_dic_processing.core.joining import FrameJoin
from rgbd_dic_processing.core.pairing import CLOCK_JUMPED, FramePair, FramePairing
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


def test_join_goes_on_after_a_plane_that_never_came() -> None:
    """Two ToF frames an image, and room for ten images: while the first one waits, more planes come than that."""
    join = FrameJoin(10)
    join.add_reference(7)
    left = []
    for number in range(40):
        stamp = number * 100 * MS
        for depth in (stamp + 2 * MS, stamp + 52 * MS):
            if number:
                left += join.add_plane(PlaneEstimate(depth, FrameStatus.NO_PLANE, "none"))
        left += join.add_field(Field(stamp)) + join.add_pair(FramePair(stamp, stamp + 2 * MS))
    assert [frame.field.stamp_ns for frame in left] == [number * 100 * MS for number in range(40)]
    assert [frame.plane is None for frame in left] == [True] + 39 * [False]


def test_join_lets_what_cannot_be_measured_leave_at_once() -> None:
    """In its turn, but without a pair: a bad image, or one whose stamp comes twice, may never get one."""
    join = FrameJoin(10)
    join.add_reference(7)
    assert [f.field.stamp_ns for f in join.add_field(Field(1, FrameStatus.LOST))] == [1]
    assert join.add_field(Field(2)) == []
    assert join.add_field(Field(3, FrameStatus.BAD_IMAGE)) == []
    left = join.add_pair(FramePair(2, None))
    assert [(f.field.stamp_ns, f.pair is None) for f in left] == [(2, False), (3, True)]


def true_pairs(image_error_ns, depth_error_ns, images=IMAGES, depths=DEPTHS, delay=15 * MS):
    """All pairs of streams whose clocks err by a function of the true time: (true image, true ToF time or None, pair).

    Stamps are told apart by nanoseconds that they are odd by, so that each leads back to its true time.
    """
    arrivals = [(time, "image", number, time + image_error_ns(time)) for number, time in enumerate(images)]
    arrivals += [(time + delay, "depth", number, time + depth_error_ns(time)) for number, time in enumerate(depths)]
    events = [(kind, stamp + number) for _, kind, number, stamp in sorted(arrivals)]
    image_of = {stamp + number: images[number] for _, kind, number, stamp in arrivals if kind == "image"}
    depth_of = {stamp + number: depths[number] for _, kind, number, stamp in arrivals if kind == "depth"}
    return [(image_of[pair.stamp_ns], depth_of.get(pair.depth_stamp_ns), pair) for pair in pair_all(events)]


def jump(after_ns: int, by_ns: int):
    return lambda time: by_ns if time >= after_ns else 0


@pytest.mark.parametrize("by", [-600, -140, -120, -80, -60, 200, 500])
@pytest.mark.parametrize("delay", [-20, 15, 60])
def test_the_clock_of_both_jumps(by: int, delay: int) -> None:
    """By so many ms. Frames of before and after are never paired, and pairing goes on at once: only images whose own
    nearest frame is on the other side of the jump have none, and after a small jump back four whose stamps are in
    doubt. Of 60 ms, three images came late and are refused."""
    error = jump(510 * MS, by * MS)
    pairs = true_pairs(error, error, delay=delay * MS)
    assert all(depth is None or abs(depth - image) <= 30 * MS for image, depth, _ in pairs)
    without = [image for image, depth, _ in pairs if depth is None]
    assert all(480 * MS <= image <= 670 * MS for image in without) and len(without) <= 4
    assert len(pairs) == len(IMAGES) - (-by * 60 // 1000 if -100 < by < 0 else 0)


@pytest.mark.parametrize("by", [-600, -200, 200, 500])
@pytest.mark.parametrize("jumping", ["camera", "tof"])
def test_the_clock_of_one_jumps(by: int, jumping: str) -> None:
    """No stamp tells then what belongs together: none are paired, and never wrongly."""
    errors = [jump(510 * MS, by * MS), lambda time: 0]
    pairs = true_pairs(*(errors if jumping == "camera" else errors[::-1]))
    assert len(pairs) == len(IMAGES)
    assert all(depth is None or abs(depth - image) <= 30 * MS for image, depth, _ in pairs)
    assert sum(depth is not None for _, depth, _ in pairs) >= 28
    later = [pair for image, _, pair in pairs if image > 540 * MS]
    assert all(pair.depth_stamp_ns is None and pair.reason for pair in later)
    if by < 0:
        assert {pair.reason for pair in later[3:]} == {CLOCK_JUMPED}


@pytest.mark.parametrize("images, depths", [(True, True), (False, True), (True, False)])
def test_a_silence_is_not_a_jump(images: bool, depths: bool) -> None:
    """One sensor or both are silent for 400 ms: afterwards all is as before."""
    kept = [
        [t for t in times if not (gone and 300 * MS < t < 700 * MS)]
        for gone, times in ((images, IMAGES), (depths, DEPTHS))
    ]
    still = jump(0, 0)
    for delay in (-20, 15, 60):
        pairs = true_pairs(still, still, *kept, delay=delay * MS)
        assert all(depth == nearest(image, kept[1], 30 * MS) for image, depth, _ in pairs)


@pytest.mark.parametrize("until", [710, 760, 900])
def test_images_that_come_late_after_a_silence_are_no_jump(until: int) -> None:
    """The ToF sensor is silent for 400 ms, and a busy computer hands out all that came by then at once, its frames
    first. Pairing goes on, at the latest, with the first image that is newer than all of them."""
    depths = [t for t in DEPTHS if not 300 * MS < t < 700 * MS]
    arrivals = [(max(t, until * MS), "image", t) for t in IMAGES] + [(t, "depth", t) for t in depths]
    events = [(kind, stamp) for _, kind, stamp in sorted(arrivals)]
    pairs = pair_all(events)
    assert [pair.stamp_ns for pair in pairs] == IMAGES
    assert all(pair.depth_stamp_ns in (None, nearest(pair.stamp_ns, depths, 30 * MS)) for pair in pairs)
    later = [pair for pair in pairs if pair.stamp_ns > (until + 60) * MS]
    assert later and all(pair.depth_stamp_ns is not None for pair in later)


def test_join_does_not_mix_what_has_one_stamp_before_and_after_a_jump() -> None:
    """The pair of the second image 1000 and the plane of its ToF frame come late; those of the first are long there."""
    join, start = FrameJoin(10), 10**9
    join.add_reference(7)
    for stamp in (start, start + 200 * MS):
        join.add_field(Field(stamp))
        join.add_plane(PlaneEstimate(stamp + 5, FrameStatus.NO_PLANE, "first"))
        join.add_pair(FramePair(stamp, stamp + 5))
    assert join.add_field(Field(start)) == []
    assert join.add_pair(FramePair(start, start + 5)) == []
    left = join.add_plane(PlaneEstimate(start + 5, FrameStatus.NO_PLANE, "second"))
    assert [(frame.field.stamp_ns, frame.plane.reason) for frame in left] == [(start, "second")]
