"""How numbers look in the tables of docs/benchmark.md."""

from __future__ import annotations

import sys

from workers import ROOT

sys.path.insert(0, str(ROOT / "tools/docs"))

from blocks import table

__all__ = ["DEGREES", "instructions", "motion", "px", "ratio", "share", "table"]

DEGREES = {3: "cubic", 5: "quintic"}


def px(value: float | None, digits: int = 5) -> str:
    """Pixels; nothing where there is no number."""
    if value is None or value != value:
        return ""
    return f"{value:.{digits}f}" if value < 0.1 else f"{value:.3g}"


def ratio(value: float, other: float | None) -> str:
    """How many times another number, if there is one."""
    return "" if other is None else f"{value / other:.2f}" if value < other else f"{value / other:.1f}"


def share(value: float) -> str:
    """Per cent; a plain 0 where nothing is lost."""
    return f"{value:.1%}" if value else "0"


def motion(name: str) -> str:
    """A motion's name as the tables have it."""
    return name.replace("homography", "warp").replace("(0.5, 0.5)", "0.5").replace("(0.3, 0.6)", "0.3, 0.6")


def instructions(row: dict) -> str:
    """The instruction set that a row was measured with."""
    return row["instruction_set"]
