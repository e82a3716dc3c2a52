"""Frames that do not wait for their own ToF frame: what they are measured with depends on the stamps alone."""

from __future__ import annotations

import numpy as np
import pytest
from rgbd_dic_processing.core.early_frames import EarlyFrames
from rgbd_dic_processing.core.joining import JoinedFrame
from rgbd_dic_processing.core.status import FrameStatus
from rgbd_dic_processing.core.subset_field import SubsetField

LAG, PERIOD = 100, 10
FIRST_PLANE = 4  # number of the frame from which on a plane is known


def field(stamp: int, status: FrameStatus = FrameStatus.OK) -> SubsetField:
    return SubsetField.without_subsets(stamp, 0, 0, status, "", 1, 31.0)


class Measuring:
    """Writes down, for each frame, how many had been learnt from when it was measured."""

    def __init__(self, never_waits: bool = False) -> None:
        self.frames = EarlyFrames(LAG, never_waits)
        self.learnt: list[int] = []
        self.known_by: dict[int, int] = {}

    def step(self) -> None:
        for frame in self.frames.leave(lambda _: len(self.learnt) > FIRST_PLANE, self._learn):
            self.known_by[frame.field.stamp_ns] = len(self.learnt)

    def _learn(self, frame: JoinedFrame) -> None:
        self.learnt.append(frame.field.stamp_ns)


@pytest.mark.parametrize("seed", range(20))
def test_what_is_known_depends_on_the_stamps_alone(seed: int) -> None:
    """60 frames, each complete up to 30 frames after its field: whenever that is, the same frames are learnt from."""
    random, fields = np.random.default_rng(seed), [field(PERIOD * index) for index in range(60)]
    complete_after = np.maximum.accumulate(np.arange(60) + random.integers(0, 30, 60))
    measuring, completed = Measuring(), 0
    for moment in range(100):
        if moment < 60:
            measuring.frames.add(fields[moment])
        while completed < 60 and complete_after[completed] <= moment:
            measuring.frames.complete([JoinedFrame(fields[completed], None, None)])
            completed += 1
            if random.random() < 0.5:
                measuring.step()
        measuring.step()
    assert list(measuring.known_by) == [one.stamp_ns for one in fields]
    lagging = LAG // PERIOD - 1  # a frame exactly LAG earlier counts
    expected = [max(index - lagging, min(index, FIRST_PLANE) + 1) for index in range(60)]
    assert list(measuring.known_by.values()) == expected
    assert measuring.learnt == sorted(measuring.learnt)


def test_a_frame_does_not_wait_for_its_own_tof_frame() -> None:
    measuring = Measuring()
    for index in range(30):
        measuring.frames.add(field(PERIOD * index))
        if index >= 10:
            measuring.frames.complete([JoinedFrame(field(PERIOD * (index - 10)), None, None)])
        measuring.step()
    assert len(measuring.known_by) == 30


def test_one_that_never_waits_goes_on_where_planes_are_late() -> None:
    """30 fields come; the parts of 5 of them, so that a plane is known, then none for long, then all others. Each is
    measured when it comes, once a plane is known (before, when it is complete itself), and all are learnt from in the
    end, in their order."""
    measuring = Measuring(never_waits=True)
    for index in range(30):
        measuring.frames.add(field(PERIOD * index))
        if FIRST_PLANE <= index < 2 * FIRST_PLANE + 1:
            measuring.frames.complete([JoinedFrame(field(PERIOD * (index - FIRST_PLANE)), None, None)])
        measuring.step()
        complete = max(0, index + 1 - FIRST_PLANE)
        assert len(measuring.known_by) == (complete if complete <= FIRST_PLANE else index + 1)
    assert measuring.learnt == [PERIOD * index for index in range(FIRST_PLANE + 1)]
    measuring.frames.complete([JoinedFrame(field(PERIOD * index), None, None) for index in range(FIRST_PLANE + 1, 30)])
    measuring.frames.add(field(PERIOD * 30))
    measuring.step()
    lag = LAG // PERIOD
    assert measuring.learnt == [PERIOD * index for index in range(30 - lag + 1)]


def test_images_without_the_panel_keep_nothing_waiting() -> None:
    measuring = Measuring()
    for index in range(500):
        lost = field(PERIOD * index, FrameStatus.LOST)
        measuring.frames.add(lost)
        measuring.frames.complete([JoinedFrame(lost, None, None)])
        measuring.step()
        assert len(measuring.frames._complete) <= LAG / PERIOD
    assert len(measuring.known_by) == 500


def test_the_clock_jumps_back() -> None:
    """What came before the jump is learnt from at once, and nothing waits for it."""
    measuring = Measuring()
    for stamp in [*range(1000, 1300, PERIOD), *range(0, 300, PERIOD)]:
        measuring.frames.add(field(stamp))
        measuring.frames.complete([JoinedFrame(field(stamp), None, None)])
        measuring.step()
    assert len(measuring.known_by) == 60
    assert measuring.known_by[0] == 30
