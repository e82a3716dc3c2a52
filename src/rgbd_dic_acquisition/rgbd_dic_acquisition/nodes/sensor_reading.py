"""The work of a node that reads a sensor which Revival keeps going, and what it says of it on /diagnostics."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

from ..revival import RevivableSource, Revival
from .diagnostics import Diagnostics

READ_S = 0.02
SAY_LOSS_S = 2.0


def read_sensor(
    revival: Revival[Any], health: SensorHealth, publish: Callable[[Any], None], say_that_it_runs: Callable[[], None]
) -> Iterator[float]:
    """The `work()` of a node: frame after frame, for ever."""
    revival.open()
    ran = False
    while True:
        frame = revival.read(READ_S)
        if revival.runs and not ran:
            say_that_it_runs()
        ran = revival.runs
        if frame is not None:
            publish(frame)
            health.took_frame()
        health.report()
        yield 0.0


class SensorHealth:
    """Counters of the source, what it tells, and WARN while nothing comes or shortly after something was lost.

    Args:
        loss: from what has been counted since the last report, what was lost, in words; empty if nothing.
    """

    def __init__(
        self,
        diagnostics: Diagnostics,
        revival: Revival[Any],
        source: RevivableSource[Any],
        loss: Callable[[Counter[str]], str],
    ) -> None:
        self._diagnostics, self._revival, self._source, self._loss_in = diagnostics, revival, source, loss
        self._counted: Counter[str] = Counter()
        self._loss, self._lost_at = "", float("-inf")

    def took_frame(self) -> None:
        """To be called after each frame."""
        self._diagnostics.tell_stamp(self._source.uncertainty_ns)

    def report(self) -> None:
        """To be called after each read."""
        counts = Counter(self._source.counts)
        new = Counter({name: count - self._counted[name] for name, count in counts.items()})
        self._counted = counts
        for name, count in new.items():
            self._diagnostics.count(name, count)
        for name, value in self._source.told.items():
            self._diagnostics.tell(name, value)
        self._diagnostics.tell("reopened", str(self._revival.reopened))
        now = time.monotonic()
        if loss := self._loss_in(new):
            self._loss, self._lost_at = loss, now
        problem = self._revival.problem or (self._loss if now - self._lost_at < SAY_LOSS_S else "")
        if problem:
            self._diagnostics.warn(problem)
        else:
            self._diagnostics.ok()
