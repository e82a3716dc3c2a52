"""What the recorder says about itself on /diagnostics."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable

from ..recording import Recording
from .diagnostics import PERIOD_S, Diagnostics

SAY_LOSS_S = 5.0
RATE_OVER_S = 5.0


class RecorderHealth:
    """Tells what is recorded and lost, and how long the disk will do; ERROR when the bag has ended.

    Args:
        warning_s: below this time until the disk is full the level is WARN.
    """

    def __init__(self, diagnostics: Diagnostics, recording: Recording, warning_s: float) -> None:
        self._diagnostics, self._recording, self._warning_s = diagnostics, recording, warning_s
        self._not_recorded: list[str] = []
        self._numbers: dict[str, int] = {}
        self._missed: Counter[str] = Counter()
        self._lost, self._lost_at = 0, float("-inf")
        self._seen = (time.monotonic(), 0)
        self._rate = 0.0  # of the bag [bytes/s]

    def not_recorded(self, reason: str) -> None:
        """A topic cannot be recorded; the level stays WARN."""
        self._not_recorded.append(reason)
        self.report()

    def arrived(self, topic: str, number: int, publishers: Callable[[str], int]) -> None:
        """A message got here. Its publisher has numbered it, and what is missing before it was lost on the way.

        Args:
            publishers: how many a topic has; of several, each numbers its own.
        """
        missing = number - self._numbers.get(topic, number) - 1
        self._numbers[topic] = number
        if missing > 0 and publishers(topic) == 1:
            self._missed[topic] += missing

    def report(self) -> None:
        """To be called once a second."""
        recording, tell = self._recording, self._diagnostics.tell
        for name, counts in (
            ("recorded", recording.recorded),
            ("dropped", recording.dropped),
            ("missed", self._missed),
        ):
            for topic, count in list(counts.items()):
                tell(f"{name} {topic}", str(count))
        self._measure_rate()
        tell("rate [MB/s]", f"{self._rate / 1e6:.1f}")
        tell("waiting for the disk [MB]", f"{recording.buffered_bytes / 1e6:.1f}")
        tell("room on the disk [MB]", f"{recording.free_bytes / 1e6:.0f}")
        left_s = recording.free_bytes / self._rate if self._rate > 1.0 else float("inf")
        tell("time left [s]", f"{left_s:.0f}")
        if recording.ended:
            self._diagnostics.error(recording.ended)
        elif warning := self._loss() or self._low_disk(left_s) or "; ".join(self._not_recorded):
            self._diagnostics.warn(warning)
        else:
            self._diagnostics.ok()

    def _measure_rate(self) -> None:
        now, size = time.monotonic(), self._recording.bag.size
        since, before = self._seen
        if now - since < 0.9 * PERIOD_S:
            return
        self._seen = (now, size)
        self._rate += min(1.0, (now - since) / RATE_OVER_S) * ((size - before) / (now - since) - self._rate)

    def _loss(self) -> str:
        dropped, missed = sum(self._recording.dropped.values()), sum(self._missed.values())
        if dropped + missed > self._lost:
            self._lost, self._lost_at = dropped + missed, time.monotonic()
        if time.monotonic() - self._lost_at > SAY_LOSS_S:
            return ""
        return (
            f"{dropped} messages were dropped, as the disk is too slow, and {missed} did not get here, as the computer "
            "is too busy: record to a faster disk, or fewer topics"
        )

    def _low_disk(self, left_s: float) -> str:
        if left_s > self._warning_s:
            return ""
        rounded_s = max(10.0, round(left_s, -1))  # so that not every second has a text of its own
        return f"the disk is full in about {rounded_s:.0f} s; the bag then ends: make room, or finish before"
