"""TIMESYNC and the stamps that rest on it, on simulated links and clocks whose true relation is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from rgbd_dic_acquisition.clock import NS
from rgbd_dic_acquisition.drivers.autopilot_clock import AutopilotClock
from rgbd_dic_acquisition.drivers.timesync import Timesync

START_NS = 1_700_000_000 * NS
BOOT_S = 100.0
ATTITUDE_HZ, TIMESYNC_HZ = 50.0, 10.0


class Link:
    """One simulated autopilot: its clock, and the delays on the way to it and back [s]."""

    def __init__(self, seed=1, drift=40e-6, there=0.002, back=0.002, jitter_there=0.0, jitter_back=0.0, boot_s=BOOT_S):
        self.rng = np.random.default_rng(seed)
        self.drift, self.boot_s = drift, boot_s
        self.there = lambda: there + self.rng.exponential(jitter_there)
        self.back = lambda: back + self.rng.exponential(jitter_back)

    def boot_ns(self, t_s):
        return round((self.boot_s + t_s * (1 + self.drift)) * NS)

    def exchange(self, timesync, t_s, host_step_s=0.0):
        """A request at t_s and its reply."""
        host = host_of(t_s + host_step_s)
        at_autopilot_s = t_s + self.there()
        arrival_s = at_autopilot_s + self.back()
        ts1 = timesync.request(host)
        return timesync.reply(self.boot_ns(at_autopilot_s), ts1, host_of(arrival_s + host_step_s))


def host_of(t_s):
    return START_NS + round(t_s * NS)


def _offset_errors_s(timesync, link, seconds=120.0):
    """Error of the offset at every request of a flight, NaN before it is known."""
    errors = []
    for t_s in np.arange(0, seconds, 1 / TIMESYNC_HZ):
        link.exchange(timesync, t_s)
        offset_ns = timesync.offset_ns(host_of(t_s + 0.05))
        truth_ns = host_of(t_s + 0.05) - link.boot_ns(t_s + 0.05)
        errors.append(math.nan if offset_ns is None else (offset_ns - truth_ns) / NS)
    return np.array(errors)


def _fly(clock, link, start_s, seconds, delivery_s, host_step_s=0.0, is_answered=True):
    """Attitude at 50 Hz, TIMESYNC at 10 Hz; true host times, stamps and their uncertainties [s]."""
    rows = []
    for k in range(int(seconds * ATTITUDE_HZ)):
        t_s = start_s + k / ATTITUDE_HZ
        if is_answered and k % round(ATTITUDE_HZ / TIMESYNC_HZ) == 0:
            link.exchange(clock.timesync, t_s - 0.01, host_step_s)
        arrival_ns = host_of(t_s + host_step_s + delivery_s + link.rng.exponential(1e-3))
        stamp = clock.stamp(link.boot_ns(t_s) // 1_000_000, arrival_ns)
        assert host_step_s or stamp.stamp_ns <= arrival_ns
        rows.append((t_s, (stamp.stamp_ns - host_of(host_step_s)) / NS, stamp.uncertainty_ns / NS))
    return np.array(rows).T


def test_the_offset_is_exact_when_both_ways_take_the_same_time():
    errors_s = _offset_errors_s(Timesync(50_000_000), Link(drift=0.0, there=0.02, back=0.02))
    assert np.all(np.isnan(errors_s[:4])) and not np.isnan(errors_s[4])
    assert np.nanmax(np.abs(errors_s)) < 2e-9  # whole nanoseconds


@pytest.mark.parametrize("drift", [-100e-6, 0.0, 40e-6])
def test_a_drifting_clock_is_followed_through_jitter(drift):
    link = Link(seed=2, drift=drift, jitter_there=1e-3, jitter_back=1e-3)
    timesync = Timesync(50_000_000)
    errors_s = _offset_errors_s(timesync, link)
    # The halved difference of two exponential delays of 1 ms scatters by 0.7 ms, and by less where neither is long;
    # the least gain that averages it is that of the first 500 samples, 0.05 to 0.003.
    assert np.nanmax(np.abs(errors_s)) < 0.5e-3
    assert np.sqrt(np.mean(errors_s[-500:] ** 2)) < 0.1e-3
    assert timesync.round_trip_ns == pytest.approx(4.2e6, rel=0.1)
    assert np.sqrt(np.mean(errors_s[-500:] ** 2)) < timesync.uncertainty_ns / NS < 2e-3


def test_a_busy_autopilot_answers_late_and_only_its_fast_replies_count():
    """Jitter on one way alone biases every reply by half of it; those that count have a part of it."""
    errors_s = _offset_errors_s(Timesync(50_000_000), Link(seed=3, drift=0.0, jitter_back=4e-3))
    # 2 ms is the mean of all. Of an exponential delay of 4 ms what is below 2 ms has the mean 0.92 ms; half of it.
    assert np.mean(errors_s[-500:]) == pytest.approx(0.46e-3, abs=0.15e-3)


class FilterOfMavros:
    """What plugins/sys_time.cpp does with its default parameters, but for the jump of the clock."""

    def __init__(self):
        self.samples, self.base, self.offset, self.skew = 0, None, 0.0, 0.0

    def request(self, now_ns):
        return now_ns

    def reply(self, tc1_ns, ts1_ns, arrival_ns):
        if arrival_ns - ts1_ns >= 10_000_000:
            return
        self.base = self.base or (ts1_ns + arrival_ns) // 2 - tc1_ns
        observed = (ts1_ns + arrival_ns) // 2 - tc1_ns - self.base
        gain = 0.003
        if self.samples < 500:
            part = 1 - math.exp(0.5 * (1 - 1 / (1 - self.samples / 500)))
            gain = part * 0.003 + (1 - part) * 0.05
        before = self.offset
        self.offset = gain * observed + (1 - gain) * (self.offset + self.skew) if self.samples else observed
        self.skew = gain * (self.offset - before) + (1 - gain) * self.skew
        self.samples += 1

    def offset_ns(self, now_ns):
        return None if self.base is None else self.base + round(self.offset)


@pytest.mark.parametrize(
    ("link", "least_gain"),
    [
        ({"jitter_there": 1e-3, "jitter_back": 1e-3}, 1.0),
        ({"jitter_back": 4e-3}, 1.5),  # a busy autopilot
        ({"there": 8e-3, "back": 8e-3, "jitter_there": 2e-3, "jitter_back": 2e-3}, math.inf),  # 57600 baud
    ],
)
def test_the_offset_is_no_worse_than_that_of_mavros(link, least_gain):
    def rms_s(make):
        errors = np.concatenate([_offset_errors_s(make(), Link(seed=seed, **link))[100:] for seed in range(4)])
        return math.inf if np.isnan(errors).any() else np.sqrt(np.mean(errors**2))

    ours_s, theirs_s = rms_s(lambda: Timesync(50_000_000)), rms_s(FilterOfMavros)
    assert ours_s < 0.7e-3
    assert theirs_s / ours_s >= least_gain


def test_replies_that_are_held_up_for_seconds_count_for_nothing():
    """As by garbage on a serial line, which makes the parser wait for the end of a message that is none."""
    timesync, link = Timesync(50_000_000), Link(drift=0.0)
    _offset_errors_s(timesync, link, seconds=30)
    before = timesync.offset_ns(host_of(30))
    link.back = lambda: 0.002 + 0.005 + link.rng.exponential(0.01)
    for k in range(40):
        assert not link.exchange(timesync, 30 + k / 10)
    assert timesync.offset_ns(host_of(34)) == before
    assert sum(link.exchange(timesync, 34 + k / 10) for k in range(100)) > 10, "if it stays like that, they have to do"


def test_on_a_busy_computer_the_few_fast_replies_are_enough():
    """Nine of ten round trips take tens of milliseconds, and the first of them look like all there is."""
    link = Link(drift=20e-6, there=0.2e-3, back=0.1e-3)
    ways = iter(link.rng.exponential(0.03, 2000) * (link.rng.random(2000) < 0.9))
    link.there = lambda: 0.2e-3 + next(ways)
    errors_s = _offset_errors_s(Timesync(50_000_000), link, seconds=60)
    assert np.sum(np.isnan(errors_s)) < 100
    # A fast reply is right to within (0.3 ms + slack) / 2; it takes a few, and of some there is nothing but slow ones.
    assert np.nanmax(np.abs(errors_s[100:])) < 0.6e-3


def test_only_replies_to_own_requests_count():
    timesync, link = Timesync(50_000_000), Link()
    for k in range(200):
        timesync.request(host_of(k / 10))
        assert not timesync.reply(link.boot_ns(k / 10), host_of(k / 10) + 1, host_of(k / 10 + 0.002))
    assert timesync.offset_ns(host_of(20)) is None
    assert timesync.problem == "TIMESYNC is not answered"
    ts1 = timesync.request(host_of(20))
    assert timesync.reply(link.boot_ns(20), ts1, host_of(20.002))
    assert not timesync.reply(link.boot_ns(20), ts1, host_of(20.002)), "the same again"
    assert timesync.problem == ""


def test_slow_replies_are_not_used_and_said():
    timesync, link = Timesync(10_000_000), Link(there=0.01, back=0.01)
    assert np.all(np.isnan(_offset_errors_s(timesync, link, seconds=10)))
    assert "takes 20.0 ms there and back, more than the 10 ms that are allowed" in timesync.problem


def test_an_offset_without_replies_expires():
    timesync, link = Timesync(50_000_000), Link()
    _offset_errors_s(timesync, link, seconds=10)
    assert timesync.offset_ns(host_of(15)) is not None
    assert timesync.offset_ns(host_of(25)) is None


def test_lone_outliers_are_left_aside_and_a_jump_is_followed():
    timesync, link = Timesync(50_000_000), Link(drift=0.0)
    _offset_errors_s(timesync, link, seconds=30)
    before = timesync.offset_ns(host_of(30))
    for k in range(5):
        assert not link.exchange(timesync, 30 + k / 10, host_step_s=7.0)
    assert timesync.offset_ns(host_of(31)) == before and timesync.jumps == 0
    for k in range(11):
        link.exchange(timesync, 31 + k / 10, host_step_s=7.0)
    assert timesync.jumps == 1
    assert timesync.offset_ns(host_of(34 + 7)) == pytest.approx(before + 7 * NS, abs=10)


def test_stamps_know_of_the_delivery_that_arrivals_cannot_see():
    """30 ms from measurement to arrival, as on a slow serial line that carries much else."""
    clock, link = AutopilotClock(50_000_000), Link(seed=4, jitter_there=0.5e-3, jitter_back=0.5e-3)
    truth_s, stamp_s, uncertainty_s = _fly(clock, link, 0.0, 60.0, delivery_s=0.03)
    errors_s = stamp_s - truth_s
    late = truth_s > 10
    # time_boot_ms is cut off: 0.29 ms by itself; the rest is the jitter of TIMESYNC.
    assert np.max(np.abs(errors_s[late])) < 1.2e-3
    assert np.sqrt(np.mean(errors_s[late] ** 2)) < 0.5e-3
    assert np.all(np.sqrt(np.mean(errors_s[late] ** 2)) < uncertainty_s[late])
    assert clock.is_synchronised and clock.delivery_ns == pytest.approx(30e6, abs=1e6)


def test_stamps_that_are_still_late_say_so():
    """What TIMESYNC says of the delivery is taken off bit by bit; until then it is part of the uncertainty."""
    clock, link = AutopilotClock(50_000_000), Link(seed=10)
    late = []
    for start_s in np.arange(0.0, 10.0, 0.1):
        truth_s, stamp_s, uncertainty_s = _fly(clock, link, start_s, 0.1, delivery_s=0.03)
        if clock.is_synchronised:
            errors_s = (stamp_s - truth_s)[1:]  # the first may be from before it was
            assert np.all(np.abs(errors_s) < 3 * uncertainty_s[1:])
            late.append(np.max(errors_s))
    assert late[0] > 0.02 and late[-1] < 2e-3


def test_stamps_do_not_step_while_they_converge():
    clock, link = AutopilotClock(50_000_000), Link(seed=5, drift=0.0)
    _, stamp_s, _ = _fly(clock, link, 0.0, 30.0, delivery_s=0.03)
    # HostClock may fall at half the device's pace, the correction takes a twentieth more; a millisecond is the
    # step of the time stamps themselves.
    assert np.min(np.diff(stamp_s)) > 0.45 / ATTITUDE_HZ - 1e-3
    settled = np.diff(stamp_s[250:])
    assert np.max(np.abs(settled - 1 / ATTITUDE_HZ)) < 1.05e-3 + 0.05 / ATTITUDE_HZ


def test_without_timesync_stamps_go_by_arrival():
    clock = AutopilotClock(50_000_000)
    truth_s, stamp_s, _ = _fly(clock, Link(seed=6), 0.0, 20.0, delivery_s=0.03, is_answered=False)
    assert np.mean((stamp_s - truth_s)[500:]) == pytest.approx(0.03, abs=1e-3)
    assert not clock.is_synchronised


def test_a_timesync_of_another_clock_is_refused_and_said():
    """An autopilot, or something that answers for it, whose TIMESYNC counts since 1970."""
    clock, link = AutopilotClock(50_000_000), Link(seed=7)
    other = Link(boot_s=START_NS / NS)
    for k in range(500):
        t_s = k / ATTITUDE_HZ
        if k % 5 == 0:
            other.exchange(clock.timesync, t_s)
        stamp = clock.stamp(link.boot_ns(t_s) // 1_000_000, host_of(t_s + 0.001))
        assert abs(stamp.stamp_ns - host_of(t_s)) < 2_000_000
    assert not clock.is_synchronised
    assert "s apart: stamps go by the arrival of messages" in clock.problem


@pytest.mark.parametrize("heard_s", [1.0, 120.0])
@pytest.mark.parametrize("silence_s", [3.0, 45.0])
def test_a_restarted_autopilot_is_noticed_at_once(heard_s, silence_s):
    """Also if it was heard for so short a time that its time since boot has not gone back."""
    clock = AutopilotClock(50_000_000)
    link = Link(boot_s=0.5)
    _fly(clock, link, 0.0, heard_s, delivery_s=0.002)
    again = heard_s + silence_s
    link.boot_s = 2.0 - again * (1 + link.drift)  # two seconds after its start it is heard again
    truth_s, stamp_s, _ = _fly(clock, link, again, 5.0, delivery_s=0.002)
    assert clock.restarts == 1
    assert np.max(np.abs(stamp_s - truth_s)) < 15e-3  # as its first messages jitter


def test_a_link_that_stalls_is_no_restart():
    """For eight seconds nothing arrives, and then all of it at once."""
    clock, link = AutopilotClock(50_000_000), Link(boot_s=300.0)
    _fly(clock, link, 0.0, 20.0, delivery_s=0.002)
    for k in range(400):
        t_s = 20 + k / ATTITUDE_HZ
        stamp = clock.stamp(link.boot_ns(t_s) // 1_000_000, host_of(28.002))
        assert abs(stamp.stamp_ns - host_of(t_s)) < 2_000_000
    assert clock.restarts == 0


@pytest.mark.parametrize("step_s", [-20.0, 20.0])
def test_a_host_clock_that_is_set_is_followed(step_s):
    clock, link = AutopilotClock(50_000_000), Link(seed=8)
    _fly(clock, link, 0.0, 30.0, delivery_s=0.01)
    _fly(clock, link, 30.0, 5.0, delivery_s=0.01, host_step_s=step_s)
    truth_s, stamp_s, _ = _fly(clock, link, 35.0, 10.0, delivery_s=0.01, host_step_s=step_s)
    assert np.max(np.abs(stamp_s - truth_s)) < 2e-3
