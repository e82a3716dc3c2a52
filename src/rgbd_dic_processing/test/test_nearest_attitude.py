"""The attitude that goes along with an image."""

from __future__ import annotations

from rgbd_dic_processing.core.nearest_attitude import KEPT, Attitude, NearestAttitude

MS = 1_000_000
TURNS = ((0.0, 0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0))


def attitudes(*stamps_ms: int) -> NearestAttitude:
    made = NearestAttitude(0.1)
    for index, stamp in enumerate(stamps_ms):
        made.add(Attitude(stamp * MS, TURNS[index % 3]))
    return made


def test_the_nearest_is_taken_whatever_the_order() -> None:
    made = attitudes(1000, 1040, 1020)
    assert made.at(1025 * MS) == Attitude(1020 * MS, TURNS[2])
    assert made.at(1039 * MS) == Attitude(1040 * MS, TURNS[1])
    assert made.at(1030 * MS) == Attitude(1020 * MS, TURNS[2])  # the earlier of two
    assert made.at(900 * MS) == Attitude(1000 * MS, TURNS[0])


def test_none_is_better_than_a_wrong_one() -> None:
    assert NearestAttitude(0.1).at(0) is None
    assert attitudes(1000).at(1101 * MS) is None


def test_a_clock_that_jumps_back() -> None:
    made = attitudes(*range(20_000, 20_000 + 20 * (KEPT + 10), 20))
    for stamp in range(1000, 2000, 20):
        made.add(Attitude(stamp * MS, TURNS[0]))
    assert made.at(1991 * MS).stamp_ns == 1980 * MS
    assert made.at(20_000 * MS) is None
