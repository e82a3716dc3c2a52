"""What a process costs, from /proc: processor time, and memory of its own."""

from __future__ import annotations

import os
from pathlib import Path

TICKS = os.sysconf("SC_CLK_TCK")


def processor_s(of: int | Path) -> float:
    """User and system time so far [s] of a process (its number), or of a process or thread (its folder in /proc)."""
    folder = of if isinstance(of, Path) else Path(f"/proc/{of}")
    fields = (folder / "stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def own_memory_mb(process: int) -> float:
    """Without the segments that it shares with other processes."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("RssAnon")) / 1024
