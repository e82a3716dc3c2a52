"""A node that is too slow works on the newest messages, leaves the rest out evenly, and counts them."""

from __future__ import annotations

import contextlib
from collections import Counter, deque
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
from rgbd_dic_processing.nodes import keeping_up


class Handle(contextlib.nullcontext):
    """Of a subscription."""

    def __init__(self, arrived: deque) -> None:
        super().__init__()
        self._arrived = arrived

    def take_message(self, kind: type, raw: bool) -> tuple[int, None] | None:
        return (self._arrived.popleft(), None) if self._arrived else None


class Middleware:
    """Messages, numbered, come once a period; the node under test is told of each, or takes it itself."""

    PERIODS_A_SECOND = 60

    def __init__(self, most: int, monkeypatch: pytest.MonkeyPatch) -> None:
        clock = SimpleNamespace(monotonic=lambda: self.now / self.PERIODS_A_SECOND)
        monkeypatch.setattr(keeping_up, "time", clock)
        self.now, self.sent, self.arrived = 0.0, 0, deque()
        self.worked: list[tuple[int, float]] = []
        self.left_out: list[int] = []
        monkeypatch.setattr(keeping_up, "declare", lambda *_: keeping_up.KeepUpSettings(most))
        self.counters: Counter[str] = Counter()
        diagnostics = SimpleNamespace(count=lambda name: self.counters.update([name]))
        self.keep_up = keeping_up.KeepUp(self, diagnostics)

    def create_subscription(self, kind, topic, callback, qos, raw):
        self.callback = callback
        return SimpleNamespace(handle=Handle(self.arrived), msg_type=kind, raw=False)

    def pass_time(self, periods: float) -> None:
        self.now += periods
        while self.sent < self.now:
            self.arrived.append(self.sent)
            self.sent += 1

    def run(self, takes: float | Callable[[int], float], periods: int) -> None:
        """The node takes so many periods for a message, or for that of a number."""

        def callback(number: int) -> None:
            self.pass_time(takes(number) if callable(takes) else takes)
            self.worked.append((number, self.now - number))

        self.keep_up.subscribe(int, "topic", callback, 10, self.left_out.append)
        work = self.keep_up.work()
        while self.now < periods:
            wait_s = next(work)
            if self.arrived:
                self.callback(self.arrived.popleft())
            elif wait_s:
                self.pass_time(0.25)


def test_fast_enough_leaves_nothing_out(monkeypatch) -> None:
    middleware = Middleware(3, monkeypatch)
    middleware.run(takes=0.9, periods=200)
    assert not middleware.left_out and not middleware.keep_up.warning
    assert [number for number, _ in middleware.worked] == list(range(len(middleware.worked)))


@pytest.mark.parametrize("takes", [1.3, 2.0, 3.7, 10.0])
def test_too_slow_leaves_out_evenly(monkeypatch, takes: float) -> None:
    """The gaps differ by one message; each is the newest when its turn comes, so that its age is what it takes itself
    and a period until the next one comes."""
    middleware = Middleware(3, monkeypatch)
    middleware.run(takes, periods=400)
    numbers, ages = np.array(middleware.worked[20:]).T  # before, a few may wait
    gaps = np.diff(numbers)
    assert gaps.max() - gaps.min() <= 1
    assert gaps.mean() == pytest.approx(takes, rel=0.05)
    assert ages.max() <= takes + 1
    assert middleware.counters == {keeping_up.SKIPPED: len(middleware.left_out)}
    handled = sorted([*(number for number, _ in middleware.worked), *middleware.left_out])
    assert handled == list(range(len(handled)))
    assert "too slow" in middleware.keep_up.warning


def test_one_that_is_held_up_for_a_moment_catches_up(monkeypatch) -> None:
    """Three messages come meanwhile, as many as may wait: none is left out, and soon none waits any more."""
    middleware = Middleware(3, monkeypatch)
    middleware.run(lambda number: 3.9 if number % 50 == 20 else 0.5, periods=200)
    assert not middleware.left_out
    waited = [age for number, age in middleware.worked if number % 50 not in range(20, 30)]
    assert max(waited) < 1 + 0.5


def test_one_that_was_held_up_for_long_goes_on_with_the_newest(monkeypatch) -> None:
    """A second later it may catch up again."""
    held_up = {20: 10.9, 40: 2.9, 150: 3.9}
    middleware = Middleware(3, monkeypatch)
    middleware.run(lambda number: held_up.get(number, 0.5), periods=200)
    assert middleware.left_out == [*range(21, 31), 41, 42]


def test_what_comes_together_is_worked_off_together(monkeypatch) -> None:
    """Otherwise a node that gets one message each time its work goes on would stay behind by as many for ever."""
    middleware, worked = Middleware(3, monkeypatch), []
    middleware.keep_up.subscribe(int, "topic", worked.append, 10)
    work = middleware.keep_up.work()
    for number in range(4):
        middleware.callback(number)
    next(work)
    assert worked == [0, 1, 2, 3]


def test_a_replay_leaves_nothing_out(monkeypatch) -> None:
    middleware = Middleware(0, monkeypatch)
    middleware.run(takes=3.0, periods=100)
    assert not middleware.left_out
    assert [number for number, _ in middleware.worked] == list(range(len(middleware.worked)))
