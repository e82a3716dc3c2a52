"""Tells a person which sensor is waited for and why, and when it is well again."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

REPEAT_S = 10.0  # between two texts of one sensor that is not well


class SensorStates:
    """Takes what nodes say of themselves, and hands on what changes of some of them."""

    def __init__(self, names: Iterable[str], say: Callable[[str], None]):
        self._names, self._say = set(names), say
        self._told: dict[str, tuple[str, float]] = {}  # node -> what was said last, and when

    def take(self, name: str, warning: str) -> None:
        """A node says how it is; warning: empty if all is well."""
        before, said_at = self._told.get(name, ("", -REPEAT_S))
        if name not in self._names or warning == before:
            return
        now = time.monotonic()
        if before and warning and now - said_at < REPEAT_S:
            return
        self._told[name] = warning, now
        self._say(f"{name}: {warning or 'is well'}")
