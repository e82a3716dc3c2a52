"""Progress of long work on stderr: a bar on a terminal, a line every few seconds elsewhere."""

from __future__ import annotations

import sys

from tqdm import tqdm


def progress(total: int | None, unit: str) -> tqdm:
    """A tqdm bar; a context manager."""
    terminal = sys.stderr.isatty()
    return tqdm(
        total=total,
        unit=unit,
        file=sys.stderr,
        mininterval=0.1 if terminal else 2.0,
        maxinterval=10.0,
        ncols=None if terminal else 100,
    )
