"""What the pages of all chapters have: numbers to reach, tables, figures, each in a file of its own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..report.drawing import Picture

TABLES = "tables.md"
NONE = "–"


@dataclass(frozen=True)
class Criterion:
    """what: in words. measured, limit: the worst of all images and the number that it must not exceed."""

    what: str
    measured: float
    limit: float
    unit: str = "mm"
    low: float = -np.inf

    @property
    def met(self) -> bool:
        return self.low <= self.measured <= self.limit


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """In Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def criteria_table(criteria: Iterable[Criterion]) -> str:
    """What was asked, what was measured."""
    rows = []
    for one in criteria:
        asked = f"{one.low:g} to {one.limit:g}" if np.isfinite(one.low) else f"at most {one.limit:g}"
        digits = 3 if one.limit >= 0.1 else 5 if one.limit >= 1e-4 else 7
        measured = f"{one.measured:.{digits}f} {one.unit}".strip()
        rows.append((one.what, f"{asked} {one.unit}".strip(), measured, "met" if one.met else "**not met**"))
    return table(("what", "asked", "measured", ""), rows)


def write_page(folder: Path, facts: str, tables: Mapping[str, str], pictures: Sequence[Picture]) -> None:
    """Write `tables.md` with all tables and figures, a file for each table, and the captions."""
    blocks = folder / "tables"
    blocks.mkdir(parents=True, exist_ok=True)
    for name, text in tables.items():
        (blocks / f"{name}.md").write_text(text + "\n")
    parts = [facts, *(f"## {name}\n\n{text}" for name, text in tables.items())]
    parts += [f"![{picture.alt}]({picture.path.name})\n\n{picture.caption}" for picture in pictures]
    (folder / TABLES).write_text("\n\n".join(parts) + "\n")
    (blocks / "captions.md").write_text("\n".join(f"{p.path.name}: {p.caption}" for p in pictures) + "\n")
