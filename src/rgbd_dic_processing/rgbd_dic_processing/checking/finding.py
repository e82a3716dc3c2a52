"""What a check found."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class Level(enum.Enum):
    PASS = "pass"
    WARN = "WARN"
    FAIL = "FAIL"
    NOT_CHECKED = "-"


@dataclass(frozen=True)
class Finding:
    """One line of the checklist.

    text: what was seen, or why nothing was. remedy: what to do; empty if all is well.
    """

    name: str
    level: Level
    text: str
    remedy: str = ""


def passed(name: str, text: str) -> Finding:
    return Finding(name, Level.PASS, text)


def not_checked(name: str, why: str) -> Finding:
    return Finding(name, Level.NOT_CHECKED, f"not checked: {why}")


def graded(name: str, text: str, remedy: str, good: bool, bearable: bool = False) -> Finding:
    """PASS if it is good, WARN if it is bearable, else FAIL."""
    if good:
        return passed(name, text)
    return Finding(name, Level.WARN if bearable else Level.FAIL, text, remedy)
